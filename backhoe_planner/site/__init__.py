"""What stands around the machine: the scene file, obstacles, and distances to them."""
