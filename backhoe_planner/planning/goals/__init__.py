"""Motions to a goal: postures, routes, and the best motion that is found."""
