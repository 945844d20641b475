"""Moment arms of all cylinders of a machine at once, from the constants of their linkages.

Each row of `constants` (m, 11) is one linkage: a, b, phi0 and the offset of a `Triangle`, or of the triangle that
drives a `FourBar`; of a four-bar also both coordinates of the pivot, rocker, link, pin, pin angle and side. The side is
0 for a triangle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from backhoe_planner.arrays import Indices, Matrix
from backhoe_planner.machine.hydraulics.linkage import FourBar, Linkage, Triangle
from backhoe_planner.native import compiled

_OF_TRIANGLE, _COLUMNS = 4, 11


def linkage_constants(linkages: Sequence[Linkage]) -> Matrix:
    """(m, 11), see above, of triangles and four-bars."""
    found = np.zeros((len(linkages), _COLUMNS))
    for row, one in zip(found, linkages, strict=True):
        triangle = one.drive if isinstance(one, FourBar) else one
        assert isinstance(triangle, Triangle)
        row[:_OF_TRIANGLE] = triangle.a, triangle.b, triangle.phi0, triangle.offset
        if isinstance(one, FourBar):
            row[_OF_TRIANGLE:] = *one.pivot, one.rocker, one.link, one.pin, one.pin_angle, one.side
    return found


@compiled
def linkage_arms(q: Matrix, joint_of: Indices, constants: Matrix, /) -> Matrix:
    """(K, m) dl/dq of each cylinder by its own joint `joint_of` (m,) [m/rad], at q (K, n)."""
    found = np.empty((len(q), len(constants)))
    for linkage, columns in _linkages(constants):
        found[:, columns] = linkage.arm(q[:, joint_of[columns]])
    return found


@compiled
def linkage_arm_slopes(q: Matrix, joint_of: Indices, constants: Matrix, /) -> Matrix:
    """(K, m) the derivatives of `linkage_arms` by the same joints [m/rad^2]."""
    found = np.empty((len(q), len(constants)))
    for linkage, columns in _linkages(constants):
        found[:, columns] = linkage.arm_slope(q[:, joint_of[columns]])
    return found


def _linkages(constants: Matrix) -> Iterator[tuple[Linkage, Indices]]:
    """All triangles at once, then each four-bar, with their columns."""
    crossing = constants[:, -1] == 0.0
    if crossing.any():
        yield Triangle(*constants[crossing, :_OF_TRIANGLE].T), np.flatnonzero(crossing)
    for column in np.flatnonzero(~crossing).tolist():
        *drive, x, y, rocker, link, pin, pin_angle, side = constants[column].tolist()
        yield FourBar((x, y), rocker, link, pin, pin_angle, side, Triangle(*drive)), np.array([column])
