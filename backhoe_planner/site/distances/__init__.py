"""Distances between the machine and what is around it: pair by pair, for many configurations, and to zones."""
