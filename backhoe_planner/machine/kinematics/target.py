"""What the tip is asked to do: a position, and perhaps a pitch or an orientation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from backhoe_planner.machine.kinematics.kinematics import Configuration, wrap_angle

__all__ = ["TipTarget", "movable_rows"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_IMMOVABLE = 1e-9


@dataclass(frozen=True)
class TipTarget:
    """A pose of the tip, as much of it as is specified.

    Attributes
    ----------
    position: (3,) [m], world.
    pitch: (low, high) [rad], equal where one angle is asked; None where it is free.
    rotation: (3, 3) R_world_tip; None where orientation is free.
    """

    position: Vector
    pitch: tuple[float, float] | None = None
    rotation: Matrix | None = None

    def pitch_excess(self, pitch: float) -> float:
        """How far `pitch` lies above (+) or below (-) the asked range [rad]; 0 inside."""
        if self.pitch is None:
            return 0.0
        low, high = self.pitch
        middle = 0.5 * (low + high)
        off = wrap_angle(pitch - middle)
        half = 0.5 * (high - low)
        return float(np.sign(off) * max(abs(off) - half, 0.0))

    def error(self, at: Configuration) -> Vector:
        """(m,) what is missing: target minus actual, position [m] then angles [rad].

        Rows: 3 of position; then 1 of pitch (0 inside the asked range) or 3 of the
        rotation vector, in world axes.
        """
        rows = [self.position - at.tip_position]
        if self.rotation is not None:
            rows.append(at.tip_rotation @ pin.log3(at.tip_rotation.T @ self.rotation))
        elif self.pitch is not None:
            rows.append(np.array([-self.pitch_excess(at.pitch)]))
        return np.concatenate(rows)

    def jacobian(self, at: Configuration) -> Matrix:
        """(m, n) so that, to first order, jacobian @ dq reduces `error` by as much."""
        if self.rotation is not None:
            return at.jacobian
        if self.pitch is not None:
            return np.vstack((at.jacobian[:3], at.pitch_row))
        return at.jacobian[:3]

    def distances(self, at: Configuration) -> tuple[float, float]:
        """(position error [m], angle error [rad])."""
        error = self.error(at)
        return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))


def movable_rows(jacobian: Matrix) -> NDArray[np.bool_]:
    """(m,) which task rows any joint can move at all; z on a planar arm is none."""
    return np.asarray(np.max(np.abs(jacobian), axis=1) > _IMMOVABLE)
