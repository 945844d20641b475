"""Inverse dynamics: torques, power and energy."""
