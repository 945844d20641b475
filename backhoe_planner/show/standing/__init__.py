"""The map of a site by the place of the machine: a picture and a page."""
