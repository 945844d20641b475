"""The page of a study: how often it succeeds, where it is best, what is traded for what."""
