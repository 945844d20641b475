"""The cheapest way through all resolutions of a path."""
