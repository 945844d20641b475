"""The boxes that stand for the cells of clusters near the links."""
