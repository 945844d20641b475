"""Cuts that can be dug: what the bucket takes, what resists it, and where its edge goes."""
