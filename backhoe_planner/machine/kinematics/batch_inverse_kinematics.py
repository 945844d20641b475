"""Newton-Raphson inverse kinematics of many targets at once, each from its own guess.

The iteration is that of `inverse_kinematics`, without restarts: who calls it chooses
the guesses, so that one batch yields all branches of the solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine.kinematics.batch_kinematics import BatchKinematics, ConfigurationBatch
from backhoe_planner.machine.kinematics.target import TipTarget

__all__ = ["TargetBatch", "solve_batch"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ITERATIONS = 40
_LARGEST_STEP = 0.6  # rad or m
_IMMOVABLE = 1e-9


@dataclass(frozen=True, eq=False)
class TargetBatch:
    """B targets of the tip.

    Attributes
    ----------
    position: (B, 3) [m], world.
    rotation: (B, 3, 3) R_world_tip; the identity where `turned` is false.
    turned: (B,) whether the orientation is asked.
    pitch_middle, pitch_half: (B,) the asked range of the pitch [rad].
    pitched: (B,) whether a pitch is asked.
    """

    position: Array
    rotation: Array
    turned: Mask
    pitch_middle: Array
    pitch_half: Array
    pitched: Mask

    @classmethod
    def of(cls, targets: Sequence[TipTarget]) -> TargetBatch:
        """The same targets as one batch."""
        ranges = [target.pitch for target in targets]
        turned = np.array([target.rotation is not None for target in targets], dtype=bool)
        return cls(
            position=np.array([target.position for target in targets]).reshape(-1, 3),
            rotation=np.array([np.eye(3) if t.rotation is None else t.rotation for t in targets]).reshape(-1, 3, 3),
            turned=turned,
            pitch_middle=np.array([0.0 if r is None else 0.5 * (r[0] + r[1]) for r in ranges]),
            pitch_half=np.array([0.0 if r is None else 0.5 * (r[1] - r[0]) for r in ranges]),
            # where both are given the orientation says it all, as in `TipTarget`
            pitched=np.array([r is not None for r in ranges], dtype=bool) & ~turned,
        )

    def __len__(self) -> int:
        return len(self.position)

    def take(self, rows: NDArray[np.intp] | Mask) -> TargetBatch:
        """The targets at `rows`."""
        return TargetBatch(
            self.position[rows], self.rotation[rows], self.turned[rows],
            self.pitch_middle[rows], self.pitch_half[rows], self.pitched[rows],
        )  # fmt: skip

    def at_pitch(self, pitch: Array) -> TargetBatch:
        """The same positions, each with exactly the `pitch` (B,) [rad]."""
        return TargetBatch(
            self.position, self.rotation, np.zeros(len(self), dtype=bool),
            np.array(pitch), np.zeros(len(self)), np.ones(len(self), dtype=bool),
        )  # fmt: skip

    def errors(self, at: ConfigurationBatch) -> Array:
        """(B, 7) target minus actual: position [m], rotation vector [rad], pitch [rad]; 0 where not asked."""
        found = np.zeros((len(self), 7))
        found[:, :3] = self.position - at.tip_position
        if self.turned.any():
            vector = _rotation_vectors(self.rotation @ np.swapaxes(at.tip_rotation, 1, 2))
            found[:, 3:6] = np.where(self.turned[:, None], vector, 0.0)
        if self.pitched.any():
            off = _wrap(at.pitch() - self.pitch_middle)
            excess = np.sign(off) * np.maximum(np.abs(off) - self.pitch_half, 0.0)
            found[:, 6] = np.where(self.pitched, -excess, 0.0)
        return found

    def jacobians(self, at: ConfigurationBatch) -> Array:
        """(B, 7, n) of `errors`: to first order, jacobian @ dq reduces the error by as much."""
        found = np.zeros((len(self), 7, at.q.shape[1]))
        found[:, :3] = at.position_jacobian()
        if self.turned.any():
            found[:, 3:6] = np.where(self.turned[:, None, None], at.rotation_jacobian(), 0.0)
        if self.pitched.any():
            found[:, 6] = np.where(self.pitched[:, None], at.pitch_rows(), 0.0)
        return found


def solve_batch(
    kinematics: BatchKinematics,
    targets: TargetBatch,
    guesses: Array,
    *,
    tolerance: float = 1e-8,
    iterations: int = _ITERATIONS,
) -> tuple[Array, Mask]:
    """Configurations within the limits that put the tip on B targets.

    Parameters
    ----------
    targets: B of them.
    guesses: (B, n) where each search begins.
    tolerance: on the position error [m] and the angle errors [rad].

    Returns
    -------
    (B, n) where each search ended, and (B,) whether it arrived.
    """
    limits = kinematics.robot.limits
    q = np.clip(np.array(guesses, dtype=float), limits.lower, limits.upper)
    reached = np.zeros(len(q), dtype=bool)
    going = np.arange(len(q))
    cost_before = np.full(len(q), np.inf)
    stalled = np.zeros(len(q), dtype=int)
    for iteration in range(iterations + 1):
        if not len(going):
            break
        here = targets.take(going)
        at = kinematics.at(q[going])
        error = here.errors(at)
        cost = np.einsum("bi,bi->b", error, error)
        arrived = np.sqrt(cost) <= tolerance
        reached[going[arrived]] = True
        stalled[going] = np.where(cost > 0.98 * cost_before[going], stalled[going] + 1, 0)
        cost_before[going] = cost
        left = ~arrived & (stalled[going] <= 8)
        if iteration == iterations or not left.any():
            break
        going, error = going[left], error[left]
        J = here.jacobians(at)[left]
        rows = np.max(np.abs(J), axis=(0, 2)) > _IMMOVABLE
        J, error = J[:, rows], error[:, rows]
        free = np.ones((len(going), q.shape[1]), dtype=bool)
        step = _limited_step(J, error, free, q[going], limits.lower, limits.upper)
        q[going] = np.clip(q[going] + step, limits.lower, limits.upper)
    return q, reached


def _limited_step(J: Array, error: Array, free: Mask, q: Array, lower: Array, upper: Array) -> Array:
    """(B, n) damped Newton steps; joints that a step drives beyond a limit at which they stand are taken out."""
    cost = np.einsum("bi,bi->b", error, error)
    damping = np.minimum(cost, 1e-2) * 1e-1 + 1e-12
    step = np.zeros_like(q)
    todo = np.arange(len(q))
    for _ in range(q.shape[1]):
        part = J[todo] * free[todo][:, None, :]
        square = part @ np.swapaxes(part, 1, 2)
        square[:, range(J.shape[1]), range(J.shape[1])] += damping[todo, None]
        step[todo] = np.einsum("bij,bi->bj", part, np.linalg.solve(square, error[todo][..., None])[..., 0])
        hit = free & (((q <= lower) & (step < 0.0)) | ((q >= upper) & (step > 0.0)))
        todo = np.flatnonzero(hit.any(axis=1))
        if not len(todo):
            break
        free = free & ~hit
    step = np.where(free, step, 0.0)
    return np.asarray(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))


def _wrap(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _rotation_vectors(R: Array) -> Array:
    """(B, 3) rotation vectors [rad] of (B, 3, 3) rotations."""
    # scipy's needs proper rotations; products of them are to within rounding
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R).as_rotvec())
