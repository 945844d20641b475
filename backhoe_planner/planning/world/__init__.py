"""The world that every planner gets, and the outcome that it returns."""
