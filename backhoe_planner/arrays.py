"""Names for arrays of numbers, as annotations; the shape stands where one is used."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Of any shape."""
Matrix: TypeAlias = NDArray[np.float64]
"""With two axes."""
Vector: TypeAlias = NDArray[np.float64]
"""With one axis."""
Indices: TypeAlias = NDArray[np.intp]
"""Indices of rows, with one axis."""
Flags: TypeAlias = NDArray[np.bool_]
"""Truth values, of any shape."""
