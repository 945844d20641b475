"""The rows of a study: the values that differ, their places in the template, and the figures that are kept."""
