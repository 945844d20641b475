"""One cycle after the other: its motions, the ground that they leave, and where the soil goes."""
