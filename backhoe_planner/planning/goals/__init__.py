"""Motions to a goal: postures, ways, and the best motion that is found among them."""
