"""What is known of a braking path before it is taken."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Proof"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class Proof(NamedTuple):
    """What is known of a braking path.

    Attributes
    ----------
    free: whether every pair that was looked at keeps the buffer too.
    clear: whether every pair that was looked at keeps what is required.
    stands_clear: the same for the pairs whose obstacle stands still.
    bound: (K,) proven distance [m].
    gaps: (S, K, V) of the corners.
    closely: (K,) which were measured at every part of the path.
    """

    free: bool
    clear: bool
    stands_clear: bool
    bound: Vector
    gaps: Matrix
    closely: NDArray[np.bool_]
