"""The cheapest resolution of a path."""
