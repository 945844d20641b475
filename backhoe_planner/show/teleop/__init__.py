"""Driving a machine from a page in the browser."""
