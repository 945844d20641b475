"""How far the numbers of files may go: scene files, surveys, meshes."""

LARGEST = 1e5  # m, kg, s, ...: no site is larger, and products of a few such numbers are finite
FURTHEST = 1e7  # m or a file's units: map coordinates go no further
