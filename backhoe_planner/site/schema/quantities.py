"""The numbers that a scene file may hold, and orientations made of them."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import AfterValidator, BeforeValidator

from backhoe_planner.arrays import Matrix
from backhoe_planner.files.numbers import FURTHEST, LARGEST, number

Finite = Annotated[float, number(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, number(gt=0.0, le=LARGEST)]
NonNegative = Annotated[float, number(ge=0.0, le=LARGEST)]
# s of a motion, which waits and slow joints may make longer than any single number of a scene
Moment = Annotated[float, number(ge=0.0, le=1e12)]
_SMALLEST = 1e-6  # m: distances are measured to 1e-9 m, and a thinner body is too close to that
Length = Annotated[float, number(ge=_SMALLEST, le=LARGEST)]
Vector3 = Annotated[tuple[float, float, float], number(ge=-LARGEST, le=LARGEST, count=3)]
MapPoint = Annotated[tuple[float, float, float], number(ge=-FURTHEST, le=FURTHEST, count=3)]
Quaternion = Annotated[tuple[float, float, float, float], number(ge=-LARGEST, le=LARGEST, count=4)]
PitchRange = Annotated[tuple[float, float], number(ge=-LARGEST, le=LARGEST, count=2)]
AnyLength = Annotated[float, number()]


def _radians(rpy: tuple[float, float, float]) -> tuple[float, float, float]:
    if max(map(abs, rpy)) > 2.0 * math.pi:
        raise ValueError(f"angles are in radians, within one turn either way; {list(rpy)} looks like degrees")
    return rpy


def _one_turn(angle: float) -> float:
    if abs(angle) > 2.0 * math.pi:
        raise ValueError(f"the angle is in radians, within one turn either way; {angle} looks like degrees")
    return angle


_SURELY_DEGREES = 5.0  # for an acute angle: nobody who thinks in radians writes that


def _slope(angle: Any) -> Any:
    if isinstance(angle, (int, float)) and _SURELY_DEGREES <= angle < 90.0:
        raise ValueError(
            f"the angle is in radians, below {math.pi / 2.0:.4g}; {angle:g} degrees are {math.radians(angle):.4g} rad"
        )
    return angle


def _not_degrees(angle: Any) -> Any:
    if isinstance(angle, (int, float)) and math.pi <= angle < 180.0:
        raise ValueError(
            f"the angle is in radians, below {math.pi:.4g}; {angle:g} degrees are {math.radians(angle):.4g} rad"
        )
    return angle


Angle = Annotated[float, number(gt=0.0, lt=math.pi), BeforeValidator(_not_degrees)]
Turn = Annotated[Finite, AfterValidator(_one_turn)]
Slope = Annotated[float, number(ge=0.0, lt=math.pi / 2.0), BeforeValidator(_slope)]
RollPitchYaw = Annotated[Vector3, AfterValidator(_radians)]

_ROUNDING = 1e-14  # a length this near 1 is 1, so that a normalised quaternion stays as it is
_UNIT_WITHIN = 1e-3  # a quaternion is given to three decimals or more; further off it is a mistake
_NO_LENGTH = 1e-12  # of a vector, in any unit: a shorter one is 0 but for rounding


def unit_quaternion(quaternion: Quaternion | None) -> Quaternion | None:
    """A quaternion [w, x, y, z] normalised to length 1; ValueError if its length is more than 1e-3 off."""
    if quaternion is None:
        return None
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > _UNIT_WITHIN:
        raise ValueError(f"a quaternion [w, x, y, z] has length 1, this one {norm:.4g}")
    if abs(norm - 1.0) < _ROUNDING:
        return quaternion
    w, x, y, z = (part / norm for part in quaternion)
    return (w, x, y, z)


def rotation_matrix(rpy: RollPitchYaw | None, quaternion: Quaternion | None) -> Matrix | None:
    """(3, 3) from `rpy`, roll, pitch and yaw [rad], or a unit `quaternion` [w, x, y, z]; None if both are None."""
    if quaternion is not None:
        w, x, y, z = quaternion
        return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())
    if rpy is not None:
        return np.asarray(pin.rpy.rpyToMatrix(*rpy))
    return None


def direction(vector: Vector3) -> Vector3:
    """A vector of any length but 0, normalised to length 1; ValueError if it is shorter than 1e-12."""
    norm = math.hypot(*vector)
    if norm < _NO_LENGTH:
        raise ValueError("a vector of length 0 has no direction")
    if abs(norm - 1.0) < _ROUNDING:
        return vector
    x, y, z = (part / norm for part in vector)
    return (x, y, z)


Direction = Annotated[Vector3, AfterValidator(direction)]
