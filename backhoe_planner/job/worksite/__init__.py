"""A job combined with its machine: what is dug with what, where the arm can dig, and where it cannot."""
