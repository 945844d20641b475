"""Detours: the plan as a reference with a clock, what is proven of its rest, and ways around what is on it and back."""
