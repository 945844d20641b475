"""Known bounds of every distance, and the check of a braking path."""
