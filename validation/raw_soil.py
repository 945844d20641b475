"""The force of the soil on the teeth, from the equilibrium of the wedge that they push.

The wedge lies between the blade, the ground and a plane of failure at an angle beta. It carries its weight and the load
on it, adhesion along the blade and cohesion along the plane; blade and plane push at their angles of friction. Two
equations give the two forces, and the soil fails at the beta for which the blade's is least, which is looked for among
all angles. Neither the factors of the earthmoving equation, its angle of failure nor kinematics of the package take
part. The ground of a job's cut is that of its problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.motion import Problem
from backhoe_planner.site import GroundContact, Soil
from validation.held_loads import GRAVITY
from validation.raw_urdf import Placements, RawMachine, RawShape

# what the docs and docstrings of the soil model say of it
_PLATE = 0.73  # rad from the line through bucket pin and teeth down to the cutting plate
_FADES = 0.01  # m/s of the plate through the soil, below which the force fades
_RAKES = np.radians([10.0, 90.0])  # between which the rake counts as it is
_STEEPEST = 0.9  # part of the rake at which no wedge can slide up the blade
_HOLDS = 0.9  # part of the angle of friction as which ground that falls ahead counts at most

_ANGLES = 60  # of failure at once, between the neighbours of the best of those before
_FINER = 6  # times: angles are then known to 1e-7 of their range, and forces to 1e-13
_NUDGE = 1e-5  # rad or m of the differences by joint
_POSTURES = 400  # random, of which the one that reaches out furthest tells where forward is


def soil_torques(machine: RawMachine, problem: Problem, q: Matrix, v: Matrix) -> Matrix:
    """(T, n) torques that the joints give against the soil, and for the soil in the bucket, at q, v (T, n) [N m or N].

    They are the work of the force on a small motion of each joint.
    """
    soil = problem.scene.soil
    if soil is None:
        return np.zeros(q.shape)
    arm = _Arm.of(machine, problem)
    at = arm.placed(q)
    still = np.max(np.abs(v), axis=1) == 0.0
    h = _NUDGE / np.where(still, 1.0, np.max(np.abs(v), axis=1))[:, None]
    velocity = (arm.placed(q + h * v).tip - arm.placed(q - h * v).tip) / (2.0 * h)
    ground = problem.ground
    contact = GroundContact(soil.surface - at.tip[:, 2]) if ground is None else ground.contact(at.tip)
    width = arm.width if soil.width is None else soil.width
    force = _force(at.pitch, at.forward, velocity, contact, soil, width)
    held = np.zeros(len(q)) if contact.held is None else contact.held
    load_at = None if ground is None else ground.held_at
    found = np.zeros(q.shape)
    for joint in range(q.shape[1]):
        nudge = _NUDGE * np.eye(q.shape[1])[joint]
        before, after = arm.placed(q - nudge), arm.placed(q + nudge)
        moved = (after.tip - before.tip) / (2.0 * _NUDGE)
        lifted = (after.held(load_at) - before.held(load_at)) / (2.0 * _NUDGE)
        found[:, joint] = -np.sum(force * moved, axis=1) + GRAVITY * held * lifted[:, 2]
    return found


def blade_force(
    depth: Vector, rake: Vector, soil: Soil, *, width: float, slope: Array | float = 0.0, load: Array | float = 0.0
) -> Vector:
    """(T,) the least force on a blade with which a wedge of soil moves [N].

    Parameters
    ----------
    depth: (T,) of the edge below the ground, across it, above 0 [m]; rake: (T,) of the blade from the ground [rad].
    slope: by which the ground rises ahead [rad]; load: on the ground [Pa].
    """
    phi, delta = soil.friction, _blade_friction(soil)
    depth, rake, slope, load = (each[:, None] for each in np.broadcast_arrays(depth, rake, slope, load))
    low, high = np.zeros_like(rake), np.pi - rake - phi - delta
    best = np.zeros_like(rake)
    for _ in range(_FINER):
        beta = low + (high - low) * (np.arange(1, _ANGLES) / _ANGLES)
        across = depth * (1.0 / np.tan(rake) + 1.0 / np.tan(beta))  # m of the ground above the wedge
        weight = (0.5 * soil.density * GRAVITY * depth + soil.surcharge + load) * across
        stuck, sheared = soil.adhesion * depth / np.sin(rake), soil.cohesion * depth / np.sin(beta)
        # equilibrium along the line that the force of the failure plane does not enter
        along, up = np.cos(beta + phi), np.sin(beta + phi)
        resists = weight * (np.sin(slope) * along + np.cos(slope) * up)
        resists += sheared * (np.cos(beta) * along + np.sin(beta) * up)
        resists += stuck * (np.sin(rake) * up - np.cos(rake) * along)
        pushes = np.sin(rake + delta) * along + np.cos(rake + delta) * up
        force = np.maximum(resists, 0.0) / pushes
        least = np.argmin(force, axis=1)[:, None]
        best = np.take_along_axis(force, least, axis=1)
        step = (high - low) / _ANGLES
        middle = np.take_along_axis(beta, least, axis=1)
        low, high = np.maximum(middle - step, 0.0), np.minimum(middle + step, high)
    return np.asarray(width * best[:, 0])


def _force(
    pitch: Vector, forward: Matrix, velocity: Matrix, contact: GroundContact, soil: Soil, width: float
) -> Matrix:
    """(T, 3) the force of the soil on the teeth [N], world."""
    plate = pitch - _PLATE
    ahead = np.sum(velocity * forward, axis=1)
    cut = np.sign(ahead)[:, None] * forward
    slope = np.zeros(len(pitch))
    if contact.gradient is not None:
        slope = np.arctan(np.sum(contact.gradient * cut[:, :2], axis=1))
    depth = np.maximum(contact.depth, 0.0) * np.cos(slope)
    # if the back leads, as if the plate leaned as much the other way
    lean = np.where(np.cos(plate) <= 0.0, 1.0, -1.0) * np.abs(np.cos(plate))
    delta = _blade_friction(soil)
    steepest = min(_RAKES[1], _STEEPEST * (np.pi - soil.friction - delta))
    rake = np.clip(np.arccos(np.clip(lean, -1.0, 1.0)) + slope, min(_RAKES[0], 0.5 * steepest), steepest)
    through = np.sin(plate) * ahead
    part = np.abs(through) / np.sqrt(through**2 + _FADES**2)
    load = 0.0 if contact.surcharge is None else contact.surcharge
    found, deep = np.zeros((len(pitch), 3)), depth > 0.0
    if not deep.any():
        return found
    leaning = np.maximum(slope, -_HOLDS * soil.friction)
    load = np.broadcast_to(load, depth.shape)
    push = np.zeros(len(pitch))
    push[deep] = part[deep] * blade_force(
        depth[deep], rake[deep], soil, width=width, slope=leaning[deep], load=load[deep]
    )  # fmt: skip
    stuck = part * soil.adhesion * width * depth / np.sin(rake)
    # on the blade: against the wedge, and up along the plate
    x = -push * np.sin(rake + delta) - stuck * np.cos(rake)
    z = -push * np.cos(rake + delta) + stuck * np.sin(rake)
    found = (x * np.cos(slope) - z * np.sin(slope))[:, None] * cut
    found[:, 2] += x * np.sin(slope) + z * np.cos(slope)
    # no force drives the motion
    drives = np.maximum(np.sum(found * velocity, axis=1), 0.0)
    squared = np.sum(velocity**2, axis=1)
    return np.asarray(found - (drives / np.where(squared > 0.0, squared, 1.0))[:, None] * velocity)


def _blade_friction(soil: Soil) -> float:
    return soil.friction * 2.0 / 3.0 if soil.tool_friction is None else soil.tool_friction


@dataclass(frozen=True)
class _Placed:
    """T postures of the bucket: (T, 3) teeth and forward, (T,) pitch, and the frame of the last joint; world."""

    tip: Matrix
    forward: Matrix
    pitch: Vector
    bucket: Placements

    def held(self, centre: Vector | None) -> Matrix:
        """(T, 3) the centre of the soil in the bucket, given in the frame of the last joint; at the teeth if None."""
        return self.tip if centre is None else self.bucket[0] @ centre + self.bucket[1]


@dataclass(frozen=True)
class _Arm:
    """The teeth, the bucket's pin and the plane of an arm.

    Attributes
    ----------
    last: child link of the last joint that moves; axis: (3,) of that joint, in the frame of the link, towards the side
        from which a turn lifts the teeth.
    pin: the link at whose frame the bucket's pin is.
    """

    machine: RawMachine
    problem: Problem
    last: str
    axis: Vector
    pin: str

    @classmethod
    def of(cls, machine: RawMachine, problem: Problem) -> _Arm:
        robot = problem.robot
        named = {joint.name: joint for joint in machine.joints}
        hinge = named[robot.joint_names[-1]]
        arm = cls(machine, problem, hinge.child, hinge.axis, hinge.child)
        pin, link = hinge.child, robot.tip
        turn = arm.root(np.zeros((1, robot.n)), hinge.child)[0][0]
        while link != hinge.child:
            joint = machine.joint_above[link]
            own = arm.root(np.zeros((1, robot.n)), link)[0][0] @ joint.axis
            if joint.name in robot.hold and np.linalg.norm(np.cross(own, turn @ hinge.axis)) < 1e-6:
                pin = link
                break
            link = joint.parent
        arm = cls(machine, problem, hinge.child, hinge.axis, pin)
        rng = np.random.default_rng(1)
        low, high = np.clip((problem.limits.lower, problem.limits.upper), -np.pi, np.pi)
        q = rng.uniform(low, high, size=(_POSTURES, robot.n))
        at = arm.placed(q)
        out = at.tip - arm.root(q, named[robot.joint_names[0]].child)[1]
        reach = np.sum(out * at.forward, axis=1)
        sense = np.sign(reach[np.argmax(np.abs(reach))])
        return cls(machine, problem, hinge.child, sense * hinge.axis, pin)

    def root(self, q: Matrix, link: str) -> Placements:
        """The placements of a link in the world, which is the frame of the root but for the scene's base."""
        joints = dict(zip(self.problem.robot.joint_names, q.T, strict=True))
        R, p = self.machine.placements(joints, len(q), link)[link]
        base = self.problem.robot.base
        cosine, sine = np.cos(base.heading), np.sin(base.heading)
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return turn @ R, p @ turn.T + np.array([*base.position, 0.0])

    def placed(self, q: Matrix) -> _Placed:
        bucket = self.root(q, self.last)
        axis = bucket[0] @ self.axis
        forward = np.stack((-axis[:, 1], axis[:, 0], np.zeros(len(q))), axis=1)
        forward /= np.linalg.norm(forward, axis=1)[:, None]
        tip = self.root(q, self.problem.robot.tip)[1]
        line = tip - self.root(q, self.pin)[1]
        return _Placed(tip, forward, np.arctan2(line[:, 2], np.sum(line * forward, axis=1)), bucket)

    @property
    def width(self) -> float:
        """The extent of the shapes that the last joint moves, along its axis [m]."""
        bodies = self.machine.bodies(self.problem.robot.joint_names)
        at = np.zeros((1, self.problem.robot.n))
        R_last, p_last = (each[0] for each in self.root(at, self.last))
        ends: list[float] = []
        for link, joint in bodies.items():
            if joint != self.problem.robot.joint_names[-1]:
                continue
            R, p = (each[0] for each in self.root(at, link))
            for shape in self.machine.shapes[link]:
                middle = (R @ shape.translation + p - p_last) @ R_last @ self.axis
                low, high = _extent(shape, self.axis @ R_last.T @ R @ shape.rotation)
                ends += [middle + low, middle + high]
        return max(ends) - min(ends)


def _extent(shape: RawShape, along: Vector) -> tuple[float, float]:
    """How far a shape reaches along a unit vector in its own frame, from its origin [m]."""
    if shape.kind == "mesh":
        places = shape.vertices @ along
        return float(places.min()), float(places.max())
    if shape.kind == "box":
        half = 0.5 * float(np.abs(along) @ np.array(shape.size))
    elif shape.kind == "sphere":
        half = shape.size[0]
    else:
        half = 0.5 * shape.size[1] * abs(float(along[2])) + shape.size[0] * float(np.hypot(along[0], along[1]))
    return -half, half
