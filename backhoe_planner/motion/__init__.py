"""A motion: its path, its timing under all limits, what it costs."""
