"""Descents: a joint-space curve is bent until its cost stops falling."""
