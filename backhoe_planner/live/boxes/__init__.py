"""The boxes that represent the cells of clusters near the links."""
