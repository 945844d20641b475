"""The braking path, and the bounds on the joints that keep it clear."""
