"""Cylinders, linkages, pump and engine."""
