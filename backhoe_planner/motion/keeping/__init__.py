"""What is to be kept along a whole motion: conditions with their margins, gradients and proven bounds."""
