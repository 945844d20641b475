"""The arm in its upright plane: joints that put the teeth at a given radius, height and pitch.

With the plane turned to the swing angle, r is the horizontal distance of the teeth from the swing axis and z their
height. An arm of three hinges normal to that plane (boom, stick and bucket) has at most two solutions, in closed
form: the pin of the bucket follows from the pitch, the angle at the elbow from the law of cosines. Of the two
elbows, the one that is within the limits at more places is kept. For any other arm the joints are found place by
place by Newton's method, each search starting from a neighbour's joints; whole cuts then take about ten times as
long.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from backhoe_planner.arrays import Array, Flags, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.machine import BatchKinematics, JointLimits, Robot, TargetBatch, TipTarget, solve_batch

_Angle = TypeVar("_Angle", float, Array)

_SAME = 1e-6  # m, or a sine: rounding of the numbers in a URDF
_ROUNDING = 1e-9  # rad beyond a limit that count as rounding
_PASSES = 3  # along the places and back, in which a search starts from its neighbours' results; chosen


@dataclass(frozen=True, eq=False)
class _Hinges:
    """An arm of three hinges: lengths [m] and angles [rad] of its parts with all joints at 0, and senses of rotation.

    Attributes
    ----------
    foot: (2,) r, z of the first hinge.
    lengths, angles, senses: (3,).
    """

    foot: Vector
    lengths: Vector
    angles: Vector
    senses: Vector


class ArmPlane:
    """The plane in which an arm digs.

    Parameters
    ----------
    robot: the machine.
    limits: limits of its joints; its own by default.

    Attributes
    ----------
    axis: (2,) x, y of the swing axis [m], world; that of the root link if nothing swings.
    swings: whether the first joint turns the plane.
    closed: whether its joints have a closed form.

    Raises
    ------
    InputError: pitch is not defined for the machine; or its plane is not upright through the swing axis.
    """

    def __init__(self, robot: Robot, *, limits: JointLimits | None = None) -> None:
        if not robot.has_pitch:
            problem = "cuts are dug in an upright plane: the axis of the last joint must stay horizontal"
            raise InputError(problem, key="robot", found=robot.name)
        self.robot = robot
        self.limits = robot.limits if limits is None else limits
        self._kinematics = BatchKinematics(robot)
        self._zero = robot.nearest_zero
        at = self._kinematics.at(self._zero[None, :])
        self.swings = bool(abs(at.axes[0, 0, 2]) > 1.0 - _SAME and not robot.prismatic[0] and robot.n > 1)
        self._sense = float(np.sign(at.axes[0, 0, 2])) if self.swings else 0.0
        self.axis = at.origins[0, 0, :2].copy() if self.swings else np.array(robot.base.position)
        across = at.pitch_sense * at.axes[0, -1]
        forward = np.array([-across[1], across[0]])
        self._zero_heading = float(np.arctan2(forward[1], forward[0]))
        off = at.tip_position[0, :2] - self.axis
        self._beside = float(forward[0] * off[1] - forward[1] * off[0])
        self._hinges = self._three_hinges()

    @property
    def closed(self) -> bool:
        """Whether the joints have a closed form."""
        return self._hinges is not None

    @cached_property
    def arm(self) -> tuple[str, ...]:
        """The links that move in the plane: those that not only the swing moves."""
        swing = 1 if self.swings else 0
        return tuple(dict.fromkeys(one.link for one in self.robot.pieces if one.joint > swing))

    @cached_property
    def swung(self) -> tuple[str, ...]:
        """The links that only the swing moves, such as a swing post; none if nothing swings."""
        return tuple(link for link in self.robot.moving_links if link not in self.arm)

    @property
    def kinematics(self) -> BatchKinematics:
        """The kinematics of the machine."""
        return self._kinematics

    def heading(self, swing: _Angle) -> _Angle:
        """Direction of the plane at a swing angle, or at each of an array [rad], world, about z from x."""
        return self._zero_heading + self._sense * (swing - float(self._zero[0]))

    def directions(self, swing: float) -> tuple[Vector, Vector]:
        """(2,), (2,) unit vectors outward along the plane at a swing angle [rad], and to its left, world."""
        turn = self.heading(swing)
        return np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])

    def world(self, swing: float, r: Array, z: Array) -> Array:
        """(..., 3) the places at radius r and height z [m] of the plane at a swing angle, world."""
        out, left = self.directions(swing)
        flat = self.axis + np.asarray(r)[..., None] * out + self._beside * left
        return np.concatenate((flat, np.asarray(z, dtype=float)[..., None]), axis=-1)

    def place(self, q: Array) -> tuple[Array, Array, Array]:
        """(K,) radius [m], height [m] and pitch [rad] of the teeth at q (K, n)."""
        at = self._kinematics.at(q)
        across = at.pitch_sense * at.axes[:, -1]
        off = at.tip_position[:, :2] - self.axis
        return off[:, 1] * across[:, 0] - off[:, 0] * across[:, 1], at.tip_position[:, 2], at.pitch()

    def joints(self, swing: float, r: Array, z: Array, pitch: Array) -> Array:
        """(..., K, n) joints with the teeth at r, z [m] and `pitch` [rad], all (..., K); nan where none are allowed.

        Each row of K places is one arm with its elbow on one side throughout: the side that serves most places.
        """
        r, z, pitch = (np.asarray(values, dtype=float) for values in np.broadcast_arrays(r, z, pitch))
        if self._hinges is None:
            if r.ndim == 1:
                return self._searched(swing, r, z, pitch)
            return np.stack([self.joints(swing, *row) for row in zip(r, z, pitch, strict=True)])
        one, other = self._by_elbow(r, z, pitch)
        kept, kept_by_other = (np.count_nonzero(~np.isnan(found[0]), axis=-1) for found in (one, other))
        q = np.empty((*r.shape, self.robot.n))
        q[..., -3:] = np.moveaxis(np.where((kept_by_other > kept)[..., None], other, one), 0, -1)
        if self.swings:
            q[..., 0] = swing
            if not self._swings_to(swing):
                q[:] = np.nan
        q[np.isnan(q[..., -1])] = np.nan
        return q

    def reaches(self, swing: float, r: Array, z: Array, pitch: Array) -> Flags:
        """(K,) whether joints within the limits put the teeth at r, z [m] with `pitch` [rad], all (K,).

        If joints are searched, there is one search per place from the middle of the ranges: it may miss solutions.
        """
        if self._hinges is not None:
            one, other = (~np.isnan(found[0]) for found in self._by_elbow(r, z, pitch))
            found = other if np.count_nonzero(other) > np.count_nonzero(one) else one
            return np.asarray(found & self._swings_to(swing))
        places = self.world(swing, r, z)
        targets = [TipTarget(place, pitch=(float(p), float(p))) for place, p in zip(places, pitch, strict=True)]
        q, reached = solve_batch(self._kinematics, TargetBatch.of(targets), np.tile(self._guess(swing), (len(r), 1)))
        within = np.all((q >= self.limits.lower - _ROUNDING) & (q <= self.limits.upper + _ROUNDING), axis=1)
        return np.asarray(reached & within)

    def _swings_to(self, swing: float) -> bool:
        lower, upper = float(self.limits.lower[0]), float(self.limits.upper[0])
        return not self.swings or lower - _ROUNDING <= swing <= upper + _ROUNDING

    def _guess(self, swing: float) -> Vector:
        guess = np.clip(self.robot.middle, self.limits.lower, self.limits.upper)
        if self.swings:
            guess[0] = swing
        return guess

    def _by_elbow(self, r: Array, z: Array, pitch: Array) -> tuple[Array, Array]:
        """(3, ...), (3, ...) the hinges, with the elbow on one side and on the other; nan where none are allowed."""
        assert self._hinges is not None
        (first, second, third), hinges = self._hinges.lengths, self._hinges
        x = r - third * np.cos(pitch) - hinges.foot[0]
        y = z - third * np.sin(pitch) - hinges.foot[1]
        far = x * x + y * y
        cosine = (far - first**2 - second**2) / (2.0 * first * second)
        with np.errstate(invalid="ignore"):
            bent = np.arccos(np.where(np.abs(cosine) <= 1.0 + _ROUNDING, np.clip(cosine, -1.0, 1.0), np.nan))
        ahead, beside = np.arctan2(y, x), np.arctan2(second * np.sin(bent), first + second * np.cos(bent))
        return self._within(ahead + beside, -bent, pitch), self._within(ahead - beside, bent, pitch)

    def _within(self, one: Array, elbow: Array, pitch: Array) -> Array:
        """(3, ...) the hinges of links at angles `one`, `one + elbow` and `pitch` (...) to the ground [rad].

        They are nan where one of them is beyond its limits.
        """
        hinges = self._hinges
        assert hinges is not None
        angles = (one, one + elbow, pitch)
        found, within, before = np.empty((3, *one.shape)), np.ones(one.shape, dtype=bool), 0.0
        lower, upper = self.limits.lower[-3:].tolist(), self.limits.upper[-3:].tolist()
        for joint, (angle, low, high) in enumerate(zip(angles, lower, upper, strict=True)):
            turned = angle - hinges.angles[joint]
            middle = 0.5 * (low + high) if np.isfinite(low) and np.isfinite(high) else 0.0
            q = (turned - before) * hinges.senses[joint]
            q -= 2.0 * np.pi * np.rint((q - middle) / (2.0 * np.pi))
            before = turned
            within &= (q >= low - _ROUNDING) & (q <= high + _ROUNDING)  # false for nan
            np.clip(q, low, high, out=found[joint])
        found[:, ~within] = np.nan
        return found

    def _searched(self, swing: float, r: Array, z: Array, pitch: Array) -> Array:
        places = self.world(swing, r, z)
        targets = [TipTarget(place, pitch=(float(p), float(p))) for place, p in zip(places, pitch, strict=True)]
        q, fine = np.full((len(r), self.robot.n), np.nan), np.zeros(len(r), dtype=bool)
        guess = self._guess(swing)
        for _ in range(_PASSES):
            for order in (range(len(r)), range(len(r) - 1, -1, -1)):
                near = guess
                for k in order:
                    if not fine[k]:
                        ends, reached = solve_batch(self._kinematics, TargetBatch.of([targets[k]]), near[None, :])
                        fine[k] = reached[0]
                        q[k] = ends[0] if reached[0] else np.nan
                    near = q[k] if fine[k] else near
            if fine.all():
                break
        within = np.all((q >= self.limits.lower - _ROUNDING) & (q <= self.limits.upper + _ROUNDING), axis=1)
        q[~within] = np.nan
        return q

    def _three_hinges(self) -> _Hinges | None:
        """The arm as three hinges normal to its plane; None if it is another kind of arm."""
        robot = self.robot
        if robot.n != 3 + self.swings or robot.prismatic.any():
            return None
        at = self._kinematics.at(np.zeros((1, robot.n)))
        across = at.pitch_sense * at.axes[0, -1]
        axes = at.axes[0, -3:]
        if np.max(np.linalg.norm(np.cross(axes, across), axis=1)) > _SAME or robot.pitch_pin is not None:
            return None
        points = np.vstack((at.origins[0, -3:], at.tip_position[0]))
        forward = np.array([-across[1], across[0]])
        flat = np.column_stack(((points[:, :2] - self.axis) @ forward, points[:, 2]))
        parts = np.diff(flat, axis=0)
        lengths = np.linalg.norm(parts, axis=1)
        if float(np.min(lengths)) < _SAME:
            return None
        return _Hinges(flat[0], lengths, np.arctan2(parts[:, 1], parts[:, 0]), np.sign(axes @ across))
