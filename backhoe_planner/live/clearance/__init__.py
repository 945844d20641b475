"""Known bounds of every distance, the check of a braking path, and the rows for giving way to what moves."""
