"""The servo: from a wish to the nearest safe motion, step by step."""
