"""The page of a job: its motions, the ground as it is dug, a section of it, and its cycles."""
