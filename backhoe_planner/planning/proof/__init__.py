"""What is said of a motion after the fact."""
