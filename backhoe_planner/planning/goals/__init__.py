"""Motions to a goal: postures, searches for the best motion, and the law where they find none."""
