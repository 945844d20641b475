"""Descents: a curve of the joints is bent until it costs least."""
