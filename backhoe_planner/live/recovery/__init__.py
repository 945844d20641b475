"""The way out where the machine is closer to something than allowed."""
