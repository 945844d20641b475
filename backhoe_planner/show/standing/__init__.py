"""The map of a site by where a machine stands: a picture and a page."""
