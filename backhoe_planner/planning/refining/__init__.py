"""What becomes of the best motions of a search for another cost than the time, after the search."""
