"""The world that every planner is given, and the outcome that it hands back."""
