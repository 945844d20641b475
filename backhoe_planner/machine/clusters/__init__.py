"""Scans, terrains and fine meshes: many cells, one obstacle, measured through a tree."""
