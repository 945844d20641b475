"""A job brought together with its machine: what is dug with what, where the arm can dig, and what cannot be."""
