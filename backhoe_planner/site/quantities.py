"""Numbers as a scene file may hold them, and orientations made of them."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import Field

# strict: neither true nor "0.3" is a number
LARGEST = 1e5  # m, kg, s, ...: no site is larger, and products of a few such numbers are still finite
Finite = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0.0, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(strict=True, ge=0.0, le=LARGEST, allow_inf_nan=False)]
_SMALLEST = 1e-6  # m: distances are measured to 1e-9 m; a thinner body is rounding to them
Length = Annotated[float, Field(strict=True, ge=_SMALLEST, le=LARGEST, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
Quaternion = tuple[Finite, Finite, Finite, Finite]
PitchRange = tuple[Finite, Finite]
AnyLength = Annotated[float, Field(strict=True, allow_inf_nan=False)]

_ROUNDING = 1e-14  # a length this near 1 is 1: what was normalised once stays as it is


def unit_quaternion(quaternion: Quaternion | None) -> Quaternion | None:
    """A quaternion [w, x, y, z] brought to length 1; ValueError where it is more than 1e-3 off."""
    if quaternion is None:
        return None
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > 1e-3:
        raise ValueError(f"a quaternion [w, x, y, z] has length 1, this one {norm:.4g}")
    if abs(norm - 1.0) < _ROUNDING:
        return quaternion
    w, x, y, z = (part / norm for part in quaternion)
    return (w, x, y, z)


def rotation_matrix(rpy: Vector3 | None, quaternion: Quaternion | None) -> NDArray[np.float64] | None:
    """(3, 3) of roll, pitch, yaw [rad] or of a unit quaternion [w, x, y, z]; None of neither."""
    if quaternion is not None:
        w, x, y, z = quaternion
        return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())
    if rpy is not None:
        return np.asarray(pin.rpy.rpyToMatrix(*rpy))
    return None


def direction(vector: Vector3) -> Vector3:
    """A vector of any length but 0, brought to length 1; ValueError where it is shorter than 1e-12."""
    norm = math.hypot(*vector)
    if norm < 1e-12:
        raise ValueError("a normal of length 0 has no direction")
    if abs(norm - 1.0) < _ROUNDING:
        return vector
    x, y, z = (part / norm for part in vector)
    return (x, y, z)
