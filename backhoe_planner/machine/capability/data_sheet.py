"""The figures of a data sheet: how far, how deep and how high the machine reaches, and how hard it digs.

The working envelope of a machine that works in one upright plane follows from the URDF alone (after
ISO 7135 and SAE J1193):

- digging depth: the greatest depth of the tip below the ground z = 0;
- reach at ground level: the greatest horizontal distance of the tip from the first
  joint's axis while the tip is on the ground;
- loading height: height of the tip with every joint but the last at its upper limit and
  the bucket tipped to the dump pitch; loading reach: the tip's distance from the axis there;
- bucket rotation and swing arc: the ranges of the last and the first joint.

Data sheets do not give the dump pitch; -80 degrees is chosen here.

Digging forces at relief pressure follow from geometry alone (after ISO 6015 and SAE J1179):

- bucket: the greatest force at the tooth tip, across the line from bucket pin to tip, that the
  bucket's cylinders give by curling, over the range of the bucket;
- stick: the same for the stick's cylinders, across the line from stick pin to tip, over the
  range of the stick, with the bucket where its own force is greatest.

All other cylinders hold, the machine neither tips nor slides, and weights are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import check_kind
from backhoe_planner.machine.bounded_minimum import minimum_within
from backhoe_planner.machine.kinematics.kinematics import Configuration, Kinematics, wrap_angle
from backhoe_planner.machine.robot import Robot

_DUMP_PITCH = np.radians(-80.0)  # rad; chosen, see above
_REACHABLE = 20_000  # points of a picture of the envelope; chosen
_GRID = 9  # points per joint from which the search starts; chosen
_SAMPLES = 4001  # of a joint's range: a thousandth of a radian apart, and the torque is flat at its maximum
_AT_PIN = 1e-3  # m: a tip this near the last pin has no lever to dig with
_SEEDS = 4  # best points of the grid from which to search: the best one may be beside a lesser maximum
_ON_GROUND = 1e-6  # m of height that counts as 0: a thousandth of the millimetre of a data sheet


@dataclass(frozen=True)
class Envelope:
    """Figures of a machine that works in an upright plane; see the module's text.

    Attributes
    ----------
    digging_depth, reach_at_ground, loading_height, loading_reach: [m]; None if the
        machine cannot reach the configuration that defines it.
    largest_reach: greatest horizontal distance of the tip from the axis [m].
    largest_height: greatest height of the tip [m].
    bucket_rotation, swing_arc: [rad]
    """

    digging_depth: float
    reach_at_ground: float | None
    loading_height: float | None
    loading_reach: float | None
    largest_reach: float
    largest_height: float
    bucket_rotation: float
    swing_arc: float | None


def working_envelope(robot: Robot) -> Envelope | None:
    """The envelope; None for a machine that does not work in an upright plane, or whose swing or bucket is held."""
    if not robot.has_pitch or _ends_held(robot):
        return None
    plane = _Plane(robot.at_origin)
    loading = plane.loading()
    limits = robot.limits
    return Envelope(
        digging_depth=-plane.largest(1, sign=-1.0),
        reach_at_ground=plane.reach_at_ground(),
        loading_height=None if loading is None else loading[1],
        loading_reach=None if loading is None else loading[0],
        largest_reach=plane.largest(0),
        largest_height=plane.largest(1),
        bucket_rotation=float(limits.upper[-1] - limits.lower[-1]),
        swing_arc=float(limits.upper[0] - limits.lower[0]) if plane.swings else None,
    )


def _ends_held(robot: Robot) -> bool:
    """Whether the swing or the bucket is held."""
    return robot.first_held_at is not None or robot.pitch_pin is not None


def reachable_points(robot: Robot) -> Matrix:
    """(K, 3) positions of the tip [m], world, at random joint positions, always the same."""
    kinematics, rng = Kinematics(robot), np.random.default_rng(0)
    return np.array([kinematics.at(robot.random_q(rng)).tip_position for _ in range(_REACHABLE)])


class _Plane:
    """The tip in the upright plane: radius from the first axis, and height."""

    def __init__(self, robot: Robot) -> None:
        self._kinematics = Kinematics(robot)
        self._level = robot.nearest_zero
        at = self._kinematics.at(self._level)
        # a first joint with an upright axis swings the plane
        self.swings = bool(abs(at.J_world[5, 0]) > 0.99)
        self._first = 1 if self.swings else 0
        finite = np.isfinite(robot.limits.lower) & np.isfinite(robot.limits.upper)
        self._lower = np.where(finite, robot.limits.lower, -np.pi)[self._first :]
        self._upper = np.where(finite, robot.limits.upper, np.pi)[self._first :]
        self._axis = at.points[0][:2]

    def _at(self, angles: Vector) -> Configuration:
        """The machine with the joints in the plane at `angles`."""
        q = self._level.copy()
        q[self._first :] = angles
        return self._kinematics.at(q)

    def point(self, angles: Vector) -> Vector:
        """(2,) radius and height [m] for the joints in the plane."""
        tip = self._at(angles).tip_position
        return np.array([tip[0] - self._axis[0], tip[2]])

    def largest(self, axis: int, *, sign: float = 1.0) -> float:
        """The largest (sign 1) or smallest (-1) radius (axis 0) or height (axis 1) [m]."""
        return float(self.point(self._best(axis, sign))[axis])

    def reach_at_ground(self) -> float | None:
        """Greatest radius with the tip on the ground [m]."""
        radius, height = self.point(self._best(0, 1.0, on_ground=True))
        return float(radius) if abs(height) < _ON_GROUND else None

    def loading(self) -> tuple[float, float] | None:
        """Radius and height of the tip, raised and with the bucket tipped [m]."""
        angles = self._upper.copy()
        for turn in (0.0, -2.0 * np.pi, 2.0 * np.pi):
            angles[-1] = 0.0
            last = wrap_angle(_DUMP_PITCH - self._at(angles).pitch) + turn
            if self._lower[-1] <= last <= self._upper[-1]:
                angles[-1] = last
                radius, height = self.point(angles)
                return float(radius), float(height)
        return None

    def _best(self, axis: int, sign: float, *, on_ground: bool = False) -> Vector:
        """(k,) joints with the largest sign * point[axis]: from a grid's best, then SLSQP."""
        axes = [np.linspace(lo, hi, _GRID) for lo, hi in zip(self._lower, self._upper, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        points = np.array([self.point(row) for row in grid])
        score = sign * points[:, axis] - (np.abs(points[:, 1]) if on_ground else 0.0)
        constraints = [{"type": "eq", "fun": lambda angles: self.point(angles)[1]}] if on_ground else []
        best, value = grid[int(np.argmax(score))], -np.inf
        for row in np.argsort(-score)[:_SEEDS]:
            found = minimum_within(
                lambda angles: -sign * self.point(angles)[axis], grid[row], self._lower, self._upper,
                ftol=1e-12, constraints=constraints,
            )  # fmt: skip
            reached = self.point(found)
            if on_ground and abs(reached[1]) > _ON_GROUND:
                continue
            if sign * reached[axis] > value:
                best, value = found, sign * reached[axis]
        return np.asarray(np.clip(best, self._lower, self._upper))


@dataclass(frozen=True)
class DiggingForces:
    """Forces at the tooth tip; see the module's text.

    Attributes
    ----------
    bucket: force of the last joint's cylinders [N]; bucket_at: position of that joint [rad].
    stick: force of the cylinders of the joint before [N]; stick_at: its position [rad].
    """

    bucket: float
    bucket_at: float
    stick: float
    stick_at: float


def digging_forces(robot: Robot) -> DiggingForces | None:
    """The digging forces; None without cylinders on the last two joints or a pitch, or with the tip on a pin.

    They are None, too, if the swing or the bucket is held.
    """
    check_kind(robot, Robot, key="robot")
    if robot.hydraulics is None or robot.n < 2 or not robot.has_pitch or _ends_held(robot):
        return None
    if {robot.n - 2, robot.n - 1} - set(robot.hydraulics.joint_of.tolist()):
        return None
    kinematics = Kinematics(robot)
    q = robot.nearest_zero.copy()
    curl, q[-1] = _strongest(robot, q, robot.n - 1)
    points = kinematics.at(q).points
    pull, stick_at = _strongest(robot, q, robot.n - 2)
    to_bucket_pin, to_stick_pin = np.linalg.norm(points[-1] - points[[-2, -3]], axis=1)
    if to_bucket_pin < _AT_PIN:
        return None
    return DiggingForces(curl / float(to_bucket_pin), float(q[-1]), pull / float(to_stick_pin), stick_at)


def _strongest(robot: Robot, q: Vector, joint: int) -> tuple[float, float]:
    """The greatest torque that curls the joint [N m], and the joint's position there [rad]."""
    assert robot.hydraulics is not None
    angles = np.linspace(robot.limits.lower[joint], robot.limits.upper[joint], _SAMPLES)
    postures = np.tile(q, (_SAMPLES, 1))
    postures[:, joint] = angles
    limits = robot.hydraulics.torque_limits(postures)
    # curling lowers the tip of an arm that reaches out, and so lowers the pitch
    lifts = Kinematics(robot).at(robot.nearest_zero).pitch_row[joint] > 0.0
    torque = (limits.negative if lifts else limits.positive)[:, joint]
    best = int(np.argmax(torque))
    return float(torque[best]), float(angles[best])
