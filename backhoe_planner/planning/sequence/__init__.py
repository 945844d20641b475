"""Sequences of legs, planned together; and `plan`, for every task of a scene."""
