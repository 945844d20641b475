"""The result of a job: its cycles, its figures, and its file."""
