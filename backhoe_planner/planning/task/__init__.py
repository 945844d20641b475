"""What is to be done: the problem, its path, and motions as samples."""
