"""Where the links are, and the joints for a pose of the tip."""
