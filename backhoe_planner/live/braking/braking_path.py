"""The braking path: where the machine goes if it brakes from now on.

The machine brakes in proportion: all joints slow down together, on a straight line in the
joints. With T = max_j |v_j| / a_j, a step of dt at v and then braking lead from q to

    e = q + v (dt + T / 2)

Wherever braking begins, what is left of it is a part of that line. So if the braking path is
proven clear at one step, the motion can always be ended without touching anything.
"""

from __future__ import annotations

import math
from operator import truediv
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.live.braking.gaps import Gaps
from backhoe_planner.machine import Robot, bend_weights, joint_poses
from backhoe_planner.native import compiled

MOST_PARTS = 8  # of a braking path; chosen, so that the work of a step is bounded
FINEST_PARTS = 2 * MOST_PARTS  # of one that is looked at in halves of its parts
BUFFER = 0.002  # m kept on top of every clearance, for what the linear rows leave out; chosen, far below any clearance
_PARTS = [np.arange(1, parts + 1)[:, None] / max(parts, 1) for parts in range(FINEST_PARTS + 1)]
_BEND = BUFFER  # m that a point may deviate from the chord of a part: the chords miss no more than the rows do


class JointState(NamedTuple):
    """The joints at the beginning of a step.

    Attributes
    ----------
    q, v: (n,) positions [rad or m], and velocities of the last step [rad/s or m/s].
    end: (n,) where the braking path that was proven ends [rad or m].
    """

    q: Vector
    v: Vector
    end: Vector


class PathClearance(NamedTuple):
    """What is proven of a braking path before it is taken, for K pairs that could come too close.

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

    Of a path that is not the first of its step, `gaps` and `closely` are of the pairs whose obstacle stands still.
    """

    free: bool
    clear: bool
    stands_clear: bool
    bound: Vector
    gaps: Gaps
    closely: Indices


class Placements:
    """Where the bodies are at several configurations at once; working memory.

    Parameters
    ----------
    most: how many configurations it holds, S.

    Attributes
    ----------
    T: (S, joints, 4, 4) pose of every joint's frame in the world, homogeneous; joint 0 is the world.
    R, t: (S, joints, 3, 3) and (S, joints, 3), views of it.
    J: (S, 6, n) Pinocchio's joint Jacobians, linear part taken at the world's origin.
    """

    def __init__(self, robot: Robot, most: int) -> None:
        model = robot.model
        self._model = model
        self._data = model.createData()
        count, n = model.njoints, robot.n
        self.T = np.zeros((most, count, 4, 4))
        self.T[..., 3, 3] = 1.0
        self.R, self.t = self.T[..., :3, :3], self.T[..., :3, 3]
        self.J = np.zeros((most, 6, n))
        # views of Pinocchio's own memory, which is never allocated anew
        self._poses = joint_poses(self._data)
        self._jacobian = self._data.J.reshape(6, n)
        self._rows = [(self.T[sample, :, :3], self.J[sample]) for sample in range(most)]

    def place(self, sample: int, q: Vector) -> None:
        """Fill row `sample` with the placements at q (n,)."""
        pin.computeJointJacobians(self._model, self._data, q)
        T, J = self._rows[sample]
        keep_placements(self._poses, self._jacobian, T, J)

    def spread(self, count: int) -> None:
        """Let rows 1 to `count` become 2, 4, ... to twice that."""
        for sample in range(count, 0, -1):
            self.T[2 * sample], self.J[2 * sample] = self.T[sample], self.J[sample]


@compiled
def keep_placements(poses: Array, J: Matrix, own_poses: Array, own_J: Matrix, /) -> None:
    """Copy poses (joints, 3, 4) and Jacobians (6, n) to `own_poses` and `own_J`."""
    own_poses[...], own_J[...] = poses, J


class BrakingPath:
    """The line from q to e, looked at in equal parts.

    Parameters
    ----------
    q: (n,) where the joints are [rad or m].
    v: (n,) velocity of the step that is about to be taken [rad/s or m/s].
    dt: length of the step [s]; 0 for braking from now on.
    acceleration: n numbers that braking is planned with [rad/s^2 or m/s^2].
    furthest: (n,) the largest travel radius of any pair, see `travel_bounds`.
    turning: (n,) 1 for hinges, 0 for slides.

    Attributes
    ----------
    delta: (n,) e - q [rad or m].
    end: (n,) e [rad or m].
    time: until the machine stands [s].
    look: the time that the path is worth at v, dt + T / 2 [s].
    """

    def __init__(
        self, q: Vector, v: Vector, dt: float, *, acceleration: list[float], furthest: Vector, turning: Vector
    ) -> None:
        times: list[float] = list(map(truediv, map(abs, v.tolist()), acceleration))
        braking = max(times)
        look = dt + 0.5 * braking
        self.q = q
        self.v = v
        self.delta = v * look
        self.end = q + self.delta
        self.look = look
        self.time = dt + braking
        self._times, self._acceleration = times, acceleration
        self._furthest, self._turning = furthest, turning
        self._parts = 0  # not known yet: most paths have no pair that could come too close

    @property
    def parts(self) -> int:
        """How many parts it has; `parts + 1` rows of the placements belong to it."""
        if self._parts == 0:
            self._bend = bend_weights(self.delta, self._turning)
            most = float(self._bend.dot(self._furthest))  # no point of any pair bends more than this
            self._parts = min(max(math.ceil(math.sqrt(most / (8.0 * _BEND))), 1), MOST_PARTS)
        return self._parts

    def halve(self, placements: Placements | None = None) -> None:
        """Look at halves of its parts from now on; placements that hold the path are filled anew."""
        parts = self.parts
        self._parts = 2 * parts
        if placements is not None:
            placements.spread(parts)
            for part, q in enumerate(self.q + _PARTS[2 * parts][::2] * self.delta):
                placements.place(2 * part + 1, q)

    def off_chord(self, travel: Matrix) -> Vector:
        """(K,) how far points may be off the chord of a part, for radii (K, n) [m]."""
        parts = self.parts
        return np.asarray(travel.dot(self._bend) / (8.0 * parts * parts))

    @property
    def D(self) -> Matrix:
        """(n, n) derivative of the end by v [s]."""
        n = len(self.v)
        D = np.zeros((n, n))
        D.reshape(-1)[:: n + 1] = self.look
        braking = max(self._times)
        if braking > 0.0:
            slowest = self._times.index(braking)
            D[:, slowest] += self.v * math.copysign(0.5 / self._acceleration[slowest], self.v[slowest])
        return D

    def place(self, placements: Placements) -> None:
        """Fill the placements at the ends of the parts. Row 0, at q, must already be there."""
        for part, q in enumerate(self.q + _PARTS[self.parts] * self.delta, 1):
            placements.place(part, q)
