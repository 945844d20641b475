"""Planning rows by processes of this computer, or by a cluster."""
