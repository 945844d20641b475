"""Points of a lattice and the areas that they are in."""

from __future__ import annotations

import numpy as np

from backhoe_planner.job import lattice_within


def test_the_points_of_a_lattice_in_a_triangle_are_those_below_its_slope() -> None:
    """Row k of the lattice has the points with x + y <= 0.4, and the corners on the border count."""
    x, y = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5]), np.array([0.0, 0.1, 0.2, 0.3])
    found = lattice_within(x, y, np.array([[0.0, 0.0], [0.4, 0.0], [0.0, 0.4]]))
    assert found.tolist() == [[column + row <= 4 for column in range(6)] for row in range(4)]
