"""The files that describe a machine."""
