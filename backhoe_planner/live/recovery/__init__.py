"""Out of what is violated."""
