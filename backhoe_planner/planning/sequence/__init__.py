"""Sequences of legs, planned together; and `plan`, for whatever a scene asks for."""
