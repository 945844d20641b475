"""Local optimisation from many starts: where descents to a goal begin, the descents, and the best of their motions."""
