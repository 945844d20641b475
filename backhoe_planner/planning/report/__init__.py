"""What is reported of a plan beside its proof."""
