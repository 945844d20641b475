"""Planes between the machine and what it must not touch, and what they say of distances along a path."""
