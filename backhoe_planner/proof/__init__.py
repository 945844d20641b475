"""The certificate: from machine, site and motion alone."""
