"""The way out if the machine is closer to something than allowed."""
