"""Planes between the machine and what it must not touch, and the distances along a path that they prove."""
