"""A lower bound of the work of every motion to a goal: the gain in potential energy.

From rest to rest the joints give the machine and its payload at least the gain in potential
energy, and no energy is recovered. The least gain over the configurations on the goal is found by branch
and bound over boxes as in `least_duration`, with the potential energy to second order:

    U(q) = U(c) + grad U . d + d^T H d / 2 + R,    d = q - c,

from the first moments of what each joint carries, treated as one point (`goal_features`).

The work of a motion is summed up over its samples, at which v is the mean of the adjacent segments,
and 0 at the ends. With the period S of `SAMPLE_PERIOD` the first and the last segment are
no faster than a S, so half of each, a S^2 / 2, and the kinetic energy of the first are not
counted. The bound is lowered by that.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import GRAVITY, BatchKinematics, Dynamics
from backhoe_planner.motion import SAMPLE_PERIOD, Problem
from backhoe_planner.proof.box_tests import DirectionTest, Quadratic, bends, best_directions, contracted
from backhoe_planner.proof.goal_features import GoalRegion, cross, goal_regions, vector_terms
from backhoe_planner.proof.limits import JOINTS_WITHIN

_NEAR = 0.01  # part of the gain to a known configuration: a bound nearer to it than this is near enough; chosen
_SAMPLED = 0.99  # of the bound: between the ends the work of the samples is that of the motion to within a thousandth
_BESIDE = 1e-6  # rad or m by which the certificate lets a joint be outside of its range
_AT_ONCE = 64  # boxes that are halved together; chosen, as in `least_duration`


def least_work(problem: Problem, start: Vector, *, end: Vector, boxes: int) -> float | None:
    """A lower bound of the work of every motion from rest at `start` to rest on the goal [J]; None in soil.

    It is 0 if the goal may be as low as the start.

    Parameters
    ----------
    start, end: (n,) the configuration at rest at the start, and one on the goal [rad or m].
    boxes: the greatest number of boxes to examine.
    """
    if problem.scene.soil is not None:
        return None
    energy = _PotentialEnergy(problem)
    least = (1.0 - _NEAR) * (energy.at(end) - energy.at(start))
    for goal, given in zip(goal_regions(problem), problem.goals, strict=True):
        if least <= 0.0:
            return 0.0
        limits, middle = problem.limits, start if given.q is None else given.q
        # one turn more or less gives the same height
        lower = np.where(np.isfinite(limits.lower), limits.lower, middle - np.pi) - _BESIDE
        upper = np.where(np.isfinite(limits.upper), limits.upper, middle + np.pi) + _BESIDE
        base = energy.at(start)
        least = _search(energy, goal, lower[None], upper[None], base, target=least, boxes=boxes)
    return max(_SAMPLED * least - energy.unsampled(problem, start), 0.0)


class _PotentialEnergy:
    """The potential energy of a problem's machine with its payload [J], up to a constant."""

    def __init__(self, problem: Problem) -> None:
        robot = problem.robot
        self._kinematics = BatchKinematics(robot)
        self._hinge = np.where(robot.prismatic, 0.0, 1.0)
        self._dynamics = Dynamics(robot, payload=problem.scene.payload, payload_at=problem.scene.payload_at)
        self._mass, self._centre = self._dynamics.bodies()

    def at(self, q: Vector) -> float:
        """At q (n,)."""
        at = self._kinematics.at(q[None])
        return GRAVITY * float((self._moments(at.rotations, at.origins)[0, :, 2]).sum())

    def least(self, lower: Matrix, upper: Matrix) -> Vector:
        """(B,) a lower bound in the boxes `lower` .. `upper` (B, n)."""
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        at = self._kinematics.at(middle)
        own = self._moments(at.rotations, at.origins)
        # a joint moves its own body and all bodies further out
        mass = np.cumsum(self._mass[::-1])[::-1]
        moment = np.cumsum(own[:, ::-1], axis=1)[:, ::-1]
        turning = cross(at.axes, moment - mass[:, None] * at.origins)
        first = np.where(self._hinge[:, None] > 0.0, turning, mass[:, None] * at.axes)
        terms = vector_terms(first, at.axes, half, hinge=self._hinge)
        lift = Quadratic(-terms.J[:, 2], -terms.H[:, 2]).greatest(-half, half)
        return np.asarray(GRAVITY * (own[:, :, 2].sum(axis=1) - lift - terms.rest))

    def unsampled(self, problem: Problem, start: Vector) -> float:
        """The work that the samples of a motion from `start` (n,) may leave out at its ends [J]."""
        limits, model = problem.limits, problem.robot.model
        speed = np.minimum(limits.velocity, limits.acceleration * SAMPLE_PERIOD) * (1.0 + JOINTS_WITHIN)
        offset = np.array([float(np.linalg.norm(model.jointPlacements[k + 1].translation)) for k in range(len(start))])
        slide = np.where(self._hinge > 0.0, 0.0, np.maximum(np.abs(limits.lower), np.abs(limits.upper)))
        before = np.cumsum(offset) + np.cumsum(slide)  # from the base to each joint's frame, at most
        away = np.linalg.norm(self._centre, axis=1) + before
        # the greatest derivative of the potential energy by each joint [J/rad or N]
        arm = np.where(self._hinge[:, None] > 0.0, away - before[:, None], 1.0)
        load = GRAVITY * np.triu(arm * self._mass).sum(axis=1)
        inertia = np.abs(self._dynamics.mass_matrices(start[None])[0])
        return float(load @ speed) * SAMPLE_PERIOD + 0.5 * float(speed @ inertia @ speed)

    def _moments(self, rotations: Array, origins: Array) -> Array:
        """(B, n, 3) first moments of the bodies about the world's origin [kg m]."""
        return np.asarray(self._mass[:, None] * (origins + np.einsum("bnij,nj->bni", rotations, self._centre)))


def _search(
    energy: _PotentialEnergy, goal: GoalRegion, lower: Matrix, upper: Matrix, base: float, *, target: float, boxes: int
) -> float:
    """The least potential energy above `base` on the goal, within the box lower .. upper (1, n), up to `target` [J]."""
    gain, joint = np.full(1, -np.inf), np.zeros(1, dtype=np.intp)
    looked = 0
    while len(gain) and looked < boxes:
        count = min(_AT_ONCE, len(gain))
        order = np.argpartition(gain, count - 1)
        lowest, rest = order[:count], order[count:]
        rows = np.arange(count)
        low, high = lower[lowest], upper[lowest]
        middle = 0.5 * (low[rows, joint[lowest]] + high[rows, joint[lowest]])
        below, above = high.copy(), low.copy()
        below[rows, joint[lowest]] = above[rows, joint[lowest]] = middle
        low, high = np.vstack((low, above)), np.vstack((below, high))
        looked += len(low)
        found = np.maximum(np.tile(gain[lowest], 2), energy.least(low, high) - base)
        features = goal.features(low, high)
        half = 0.5 * (high - low)
        missed = DirectionTest(features, best_directions(features, -half, half)).misses(-half, half)
        least, most = contracted(*features.tests, half)
        left = np.flatnonzero(~missed & (least <= most).all(axis=1) & (found < target))
        next_joint = np.argmax(bends(features, 0.5 * (most - least)), axis=1)
        low, high = (features.middle + least)[left], (features.middle + most)[left]
        lower, upper = np.vstack((lower[rest], low)), np.vstack((upper[rest], high))
        gain, joint = np.append(gain[rest], found[left]), np.append(joint[rest], next_joint[left])
    return float(np.min(gain, initial=target))
