"""Coordinates that are floats of 32 bits, which are too coarse so far from 0 as on a map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError

_COARSEST = 0.01  # m: what floats of 32 bits may be rounded to, about the noise of a scanner; chosen


def rounding_of(points: Matrix, scale: Vector | float = 1.0) -> float:
    """How far floats of 32 bits are apart at the greatest of coordinates (n, 3), if that is too far [m]; otherwise 0.

    Parameters
    ----------
    scale: from the units of the points to metres; that of each axis (3,), or of all.
    """
    apart = float(np.max(np.spacing(np.float32(np.abs(points).max(initial=0.0))) * scale))
    return apart if apart > _COARSEST else 0.0


def rounded_error(points: Matrix, rounding: float, path: Path) -> InputError:
    """What is wrong with a file whose coordinates are rounded to `rounding` [m]."""
    return InputError(
        f"its coordinates are floats of 32 bits, rounded to {rounding:g} m so far from 0", file=path,
        found=f"coordinates up to {np.abs(points).max():,.0f}", allowed=f"up to {_COARSEST:g} m",
        hint="export it with another origin (CloudCompare: global shift), or with floats of 64 bits",
    )  # fmt: skip
