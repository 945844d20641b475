"""The records of the scene file, by what they describe."""
