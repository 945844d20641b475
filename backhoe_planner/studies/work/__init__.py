"""Rows planned by processes of this machine, or by a cluster."""
