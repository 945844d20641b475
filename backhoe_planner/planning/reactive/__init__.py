"""Motions of the law, step by step."""
