"""Rooms to look into: pages, the live view, and plots. The planner never imports it."""
