"""What is reported about a plan besides its proof."""
