"""Scans, terrains and fine meshes: one obstacle of many cells, measured through a tree."""
