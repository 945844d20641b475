"""The servo."""
