"""The braking path: where the machine goes if it brakes from now on.

The machine brakes in proportion: all joints slow down together, on a straight line in joint
space. With T = max_j |v_j| / a_j, a step of dt at v followed by braking leads from q to

    e = q + v (dt + T / 2)

Wherever braking begins, the rest of the motion is a part of that line. So if the braking path
is proven clear at one step, the machine can always stop without touching anything.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.live.braking.gaps import Gaps
from backhoe_planner.machine import Robot, bend_weights, chain_factors, chain_placements, joint_poses
from backhoe_planner.native import compiled

MOST_PARTS = 8  # of a braking path; chosen, so that the work of a step is bounded
FINEST_PARTS = 2 * MOST_PARTS  # of a path that is examined in halves of its parts
STEP_END = FINEST_PARTS + 1  # row of the placements, after those of a braking path, for the end of a step
BUFFER = 0.002  # m kept on top of every clearance, for what the linear rows leave out; chosen, far below any clearance
_BEND = BUFFER  # m that a point may deviate from the chord of a part: the chords miss no more than the rows do
_NO_POINTS = np.zeros((4, 3))
_FINE = _BEND, float(MOST_PARTS)


class JointState(NamedTuple):
    """The joints at the beginning of a step.

    Attributes
    ----------
    q, v: (n,) positions [rad or m], and velocities of the last step [rad/s or m/s].
    end: (n,) end of the proven braking path [rad or m].
    """

    q: Vector
    v: Vector
    end: Vector


class PathClearance(NamedTuple):
    """The proven clearance of a braking path before it is taken, for K pairs that could come too close.

    Attributes
    ----------
    free: whether every pair keeps the required distance and the buffer.
    clear: whether every pair keeps the required distance.
    stands_clear: whether every pair whose obstacle stands still keeps it.
    bound: (K,) proven distance over the whole path [m].
    gaps: from every corner of the links to the planes, at the samples of the path; working memory of the
        path that was checked last.
    closely: (K,) for pairs that were measured at several places of the path, the sample at which they were
        tightest, from 1 on; 0 for the others.

    For a path that is not the first of its step, `gaps` and `closely` cover only pairs whose obstacle stands still.
    """

    free: bool
    clear: bool
    stands_clear: bool
    bound: Vector
    gaps: Gaps
    closely: Indices


class Placements:
    """The placements of the bodies at several configurations; working memory.

    Parameters
    ----------
    most: how many configurations it holds, S.

    Attributes
    ----------
    T: (S, joints, 4, 4) pose of every joint's frame in the world, homogeneous; joint 0 is the world.
    R, t: (S, joints, 3, 3) and (S, joints, 3), views of it.
    J: (S, 6, n) Pinocchio's joint Jacobians, linear part taken at the world's origin.
    chain: `factors` and `slides` of `place_on_line`.
    """

    def __init__(self, robot: Robot, most: int) -> None:
        model = robot.model
        self._model = model
        self._data = model.createData()
        count, n = model.njoints, robot.n
        self.T = np.zeros((most, count, 4, 4))
        self.T[:] = np.eye(4)
        self.R, self.t = self.T[..., :3, :3], self.T[..., :3, 3]
        self.J = np.zeros((most, 6, n))
        # views of Pinocchio's own memory, which is never reallocated
        self._poses = joint_poses(self._data)
        self._jacobian = self._data.J.reshape(6, n)
        self._rows = [(self.T[sample, :, :3], self.J[sample]) for sample in range(most)]
        self.chain = chain_factors(robot), robot.prismatic.astype(float)

    def place(self, sample: int, q: Vector) -> None:
        """Fill row `sample` with the placements at q (n,)."""
        pin.computeJointJacobians(self._model, self._data, q)
        T, J = self._rows[sample]
        keep_placements(self._poses, self._jacobian, T, J)

    def place_line(self, q: Vector, delta: Vector, parts: int, *, every: int = 1) -> None:
        """Fill rows i = 1, 1 + `every`, ... up to `parts` with the placements at q + i / parts delta (n,)."""
        place_on_line(q, delta, parts, every, *self.chain, self.T, self.J)

    def place_each(self, q: Matrix) -> None:
        """Fill the first rows of T, and not of J, with the placements at q (S, n)."""
        factors, slides = self.chain
        at = np.ascontiguousarray(q.T)
        _, origins, rotations, *_ = chain_placements(at, np.sin(at), 1.0 - np.cos(at), factors, slides, _NO_POINTS)
        self.R[: len(q), 1:], self.t[: len(q), 1:] = rotations.transpose(3, 0, 2, 1), origins.transpose(2, 0, 1)

    def spread(self, count: int) -> None:
        """Move rows 1 to `count` to rows 2, 4, ... up to twice `count`."""
        for sample in range(count, 0, -1):
            self.T[2 * sample], self.J[2 * sample] = self.T[sample], self.J[sample]


@compiled
def keep_placements(poses: Array, J: Matrix, own_poses: Array, own_J: Matrix, /) -> None:
    """Copy `poses` (joints, 3, 4) and Jacobians J (6, n) to `own_poses` and `own_J`."""
    own_poses[...], own_J[...] = poses, J


@compiled
def braking_line(
    q: Vector, v: Vector, dt: float, acceleration: tuple[float, ...], /
) -> tuple[Vector, Vector, float, float, int, float]:
    """`delta` (n,), `end` (n,), `look`, `time` and `bend_of_end` of a `BrakingPath` with these parameters."""
    times = [abs(rate) / most for rate, most in zip(v.tolist(), acceleration, strict=True)]
    braking = max(times)
    slowest, look = times.index(braking), dt + 0.5 * braking
    delta = v * look
    sharper = math.copysign(0.5 / acceleration[slowest], float(v[slowest])) if braking > 0.0 else 0.0
    return delta, q + delta, look, dt + braking, slowest, sharper


@compiled
def bend_in_parts(delta: Vector, turning: Vector, furthest: Vector, fine: tuple[float, ...], /) -> tuple[Vector, int]:
    """(n,) the `bend_weights` of a motion, and into how many equal parts it is divided.

    Parameters
    ----------
    furthest: (n,) the largest travel radius of any pair: no point bends more than the weights times this radius.
    fine: how far a point may be off the chord of a part [m], and the greatest number of parts.
    """
    bend = bend_weights(delta, turning)
    parts = math.sqrt(float(bend.dot(furthest)) / (8.0 * fine[0]))
    return bend, min(max(math.ceil(parts), 1), int(fine[1]))


@compiled
def place_on_line(
    q: Vector, delta: Vector, parts: int, every: int, factors: Matrix, slides: Vector, T: Array, J: Array, /
) -> None:
    """Write the placements at q + i / parts delta (n,) to rows i = 1, 1 + every, ... up to `parts` of T and J.

    Parameters
    ----------
    factors, slides: (33, n), (n,) of the chain, see `chain_placements`.
    T, J: (S, n + 1, 4, 4), (S, 6, n) see `Placements`.
    """
    rows = np.arange(1, parts + 1, every)
    at = q[:, None] + rows / parts * delta[:, None]
    axes, origins, rotations, *_ = chain_placements(at, np.sin(at), 1.0 - np.cos(at), factors, slides, np.zeros((4, 3)))
    T[rows, 1:, :3, :3], T[rows, 1:, :3, 3] = rotations.transpose(3, 0, 2, 1), origins.transpose(2, 0, 1)
    turns = slides == 0.0
    passing = np.where(turns[:, None, None], np.cross(origins, axes, axis=1), axes)
    J[rows, :3], J[rows, 3:] = passing.transpose(2, 1, 0), (axes * turns[:, None, None]).transpose(2, 1, 0)


class BrakingPath:
    """The line from q to e, divided into equal parts.

    Parameters
    ----------
    q: (n,) joint positions [rad or m].
    v: (n,) velocity of the step that is about to be taken [rad/s or m/s].
    dt: length of the step [s]; 0 for braking from now on.
    acceleration: n numbers that braking is planned with [rad/s^2 or m/s^2].
    furthest: (n,) the largest travel radius of any pair, see `travel_bounds`.
    turning: (n,) 1 for revolute joints, 0 for prismatic ones.

    Attributes
    ----------
    delta: (n,) e - q [rad or m].
    end: (n,) e [rad or m].
    time: until the machine stands still [s].
    look: the time in which v covers the path, dt + T / 2 [s].
    bend: (n,) its `bend_weights`; set once `parts` was read.
    bend_of_end: the joint k that takes longest to brake, and c of de/dv = look I + c v e_k^T; c is 0 at rest [s^2/rad].
    """

    def __init__(
        self, q: Vector, v: Vector, dt: float, *, acceleration: tuple[float, ...], furthest: Vector, turning: Vector
    ) -> None:
        self.q, self.v = q, v
        self.delta, self.end, self.look, self.time, slowest, sharper = braking_line(q, v, dt, acceleration)
        self.bend_of_end = slowest, sharper
        self._furthest, self._turning = furthest, turning
        self._parts = 0  # not known yet: most paths have no pair that could come too close
        self._off: tuple[Matrix, int, Vector] | None = None  # radii, parts, and what follows from them

    @property
    def parts(self) -> int:
        """How many parts it has; `parts + 1` rows of the placements belong to it."""
        if self._parts == 0:
            self.bend, self._parts = bend_in_parts(self.delta, self._turning, self._furthest, _FINE)
        return self._parts

    def halve(self, placements: Placements | None = None) -> None:
        """Divide the path into halves of its parts from now on; update the placements that hold the path."""
        parts = self.parts
        self._parts = 2 * parts
        if placements is not None:
            placements.spread(parts)
            placements.place_line(self.q, self.delta, 2 * parts, every=2)

    def off_chord(self, travel: Matrix) -> Vector:
        """(K,) how far points may be off the chord of a part, for radii `travel` (K, n) [m]; read-only."""
        parts = self.parts
        if self._off is None or self._off[0] is not travel or self._off[1] != parts:
            self._off = travel, parts, travel.dot(self.bend) / (8.0 * parts * parts)
        return self._off[2]

    def keep_off_chord(self, travel: Matrix, off: Vector) -> None:
        """Store the known result `off` (K,) [m] of `off_chord` for radii `travel` (K, n)."""
        self._off = travel, self.parts, off

    def place(self, placements: Placements) -> None:
        """Fill the placements at the ends of the parts. Row 0, at q, must already be there."""
        placements.place_line(self.q, self.delta, self.parts)
