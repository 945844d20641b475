"""Velocities, accelerations and torques of a motion, and whether they are within the limits of the machine.

They follow from the samples of the positions, the URDF as written and the scene alone. A torque is the work of inertia
and weight of all links on a small motion of its joint (d'Alembert's principle), with the accelerations of the links
from differences of their placements. Neither inverse dynamics nor limits, velocities or accelerations of the package
take part. Torques in soil are not checked.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import Robot
from backhoe_planner.motion import Problem, Trajectory, leg_parts, trajectory_energy
from backhoe_planner.site import Scene
from validation.held_loads import GRAVITY, greatest_torques
from validation.raw_urdf import RawMachine, read_raw_urdf

_PERIOD = 0.02  # s in which a velocity changes at a corner, at most, as the certificate defines it
_FULL_RATE_AFTER = 0.5  # s, where neither URDF nor scene gives an acceleration, as the scene's documentation says
_USUAL_RATE = 1.0  # rad/s or m/s, where neither gives a velocity, as it says too
_INSTANT = 1e-3  # s of the differences in time: accelerations are right to a part of 1e-6
_NUDGE = 1e-5  # rad or m of the differences by joint, as in `held_loads`
_JOINT_SLACK = 1e-5  # part of a limit of velocity or acceleration, for rounding
_TORQUE_SLACK = 0.0101  # part of a torque limit: the certificate accepts 1 %
_SAME = 1e-4  # part of the largest of its kind by which figures may differ: files have six digits of a torque
_ARTICLES = {"velocity": "a", "acceleration": "an", "torque": "a"}
_PER = {"velocity": "/s", "acceleration": "/s^2"}  # after the unit of a joint


@dataclass(frozen=True, eq=False)
class Use:
    """The use of one kind of limit at the samples of a motion.

    Attributes
    ----------
    kind: ``velocity``, ``acceleration`` or ``torque``.
    value, limit: (T, n) of every joint at every sample, in the units of the joint.
    slack: part of a limit by which it may be exceeded.
    """

    kind: str
    value: Matrix
    limit: Matrix
    slack: float

    @property
    def ratio(self) -> Matrix:
        """(T, n) value over limit."""
        return np.asarray(np.abs(self.value) / self.limit)


def motion_contradictions(plan: bp.Plan) -> list[str]:
    """Describe the limits that a verified plan exceeds, and what its certificate and figures say wrongly of them."""
    claims = {use.kind: use.ratio for use in plan.certificate.uses.values()}
    torque = trajectory_energy(plan.problem, plan.trajectory).torque
    return _contradictions(plan, claims, torque, verified=plan.verified)


def file_contradictions(path: Path) -> list[str]:
    """The same for the verdict, the certificate and the figures as they stand in a plan file."""
    plan, said = bp.load_plan(path), json.loads(path.read_text(encoding="utf-8"))
    claims = {use["kind"]: float(use["ratio"]) for use in said["certificate"]["limits"].values()}
    torque = np.array(said["dynamics"]["torque"], dtype=float)
    return _contradictions(plan, claims, torque, verified=said["verdict"] == "verified")


def _contradictions(plan: bp.Plan, claims: Mapping[str, float], torque: Matrix, *, verified: bool) -> list[str]:
    motion, names = plan.trajectory, plan.robot.joint_names
    if len(motion) < 2:
        return []
    machine = _machine_of(plan.robot)
    found = list(_differences("velocity", motion.v, sample_velocities(motion), motion.time, names))
    for part in leg_parts(plan.problem, motion):
        rows = slice(part.first, part.last + 1)
        for use in _uses(machine, part.problem, motion, rows):
            row, joint = map(int, np.unravel_index(int(np.argmax(use.ratio)), use.ratio.shape))
            most, unit = float(use.ratio[row, joint]), plan.robot.joint_units[joint]
            unit = unit + _PER[use.kind] if use.kind in _PER else {"rad": "N m", "m": "N"}[unit]
            what = f"{_ARTICLES[use.kind]} {use.kind} of {abs(use.value[row, joint]):.6g} {unit}"
            where = f"{names[joint]} at {motion.time[part.first + row]:.3f} s: {what}"
            if verified and most > 1.0 + use.slack:
                found.append(f"{where}, allowed are {use.limit[row, joint]:.6g}")
            said = claims.get(use.kind, 0.0)
            if most > said + use.slack:
                found.append(f"{where} is {100.0 * most:.2f} % of the limit, said are {100.0 * said:.2f} %")
        if not _is_in_soil(part.problem):
            # the sample at which two legs meet has the torque of the later one
            own = slice(part.first, part.last + (part.last == len(motion) - 1))
            v, a = sample_velocities(motion)[own], sample_accelerations(motion)[own]
            expected = torques_of(machine, part.problem, motion.q[own], v, a)
            found += _differences("torque", torque[own], expected, motion.time[own], names)
    return list(dict.fromkeys(found))


def _differences(kind: str, said: Array, found: Array, time: Vector, names: Sequence[str]) -> Iterator[str]:
    """The joint and the sample at which figures (T, n) of one kind differ most, if they do."""
    off = np.abs(said - found)
    row, joint = map(int, np.unravel_index(int(np.argmax(off)), off.shape))
    if off[row, joint] > _SAME * float(np.max(np.abs(found), initial=1.0)):
        given, right = said[row, joint], found[row, joint]
        yield f"{names[joint]} at {time[row]:.3f} s: a {kind} of {given:.6g} is said, of the samples it is {right:.6g}"


def _uses(machine: RawMachine, problem: Problem, motion: Trajectory, rows: slice) -> list[Use]:
    """The uses of the limits of one leg, at its samples, `rows` of the whole motion."""
    robot, names = problem.robot, problem.robot.joint_names
    velocity, acceleration, effort = (
        np.array(limit) for limit in zip(*(_limits(machine, problem.scene, name) for name in names), strict=True)
    )
    segment = np.abs(np.diff(motion.q, axis=0) / np.diff(motion.time)[:, None])
    faster = np.maximum(np.vstack((segment[:1], segment)), np.vstack((segment, segment[-1:])))[rows]
    a = _jumps(motion) / np.minimum(_spans(motion), _PERIOD)[:, None]
    q, shape = motion.q[rows], motion.q[rows].shape
    found = [
        Use("velocity", faster, np.broadcast_to(velocity, shape), _JOINT_SLACK),
        Use("acceleration", a[rows], np.broadcast_to(acceleration, shape), _JOINT_SLACK),
    ]
    if not _is_in_soil(problem) and (robot.hydraulics is not None or np.isfinite(effort).any()):
        torque = torques_of(machine, problem, q, sample_velocities(motion)[rows], a[rows])
        limit = np.array([greatest_torques(robot, *row, effort) for row in zip(q, torque, strict=True)])
        found.append(Use("torque", torque, limit, _TORQUE_SLACK))
    return found


def _is_in_soil(problem: Problem) -> bool:
    return problem.scene.soil is not None or problem.ground is not None


def _limits(machine: RawMachine, scene: Scene, name: str) -> tuple[float, float, float]:
    """Velocity, acceleration and effort of a joint, by URDF and scene, in its units."""
    own, given = machine.limits.get(name, {}), scene.limits
    rate = given.velocity.get(name, own.get("velocity") or _USUAL_RATE)
    acceleration = given.acceleration.get(name, own.get("acceleration") or rate / _FULL_RATE_AFTER)
    effort = given.effort.get(name, own.get("effort") or np.inf)
    return rate * given.velocity_scale, acceleration, effort


# --- the motion at its samples -----------------------------------------------------------


def sample_velocities(motion: Trajectory) -> Matrix:
    """(T, n) the mean of the velocities before and after each sample, 0 at both ends [rad/s or m/s]."""
    segment = np.diff(motion.q, axis=0) / np.diff(motion.time)[:, None]
    rest = np.zeros((1, motion.q.shape[1]))
    return np.vstack((rest, 0.5 * (segment[:-1] + segment[1:]), rest))


def sample_accelerations(motion: Trajectory) -> Matrix:
    """(T, n) the change of velocity at each sample over the half segments beside it [rad/s^2 or m/s^2].

    At the ends it is the change from and to rest over one segment.
    """
    return np.asarray(_jumps(motion) / _spans(motion)[:, None])


def _jumps(motion: Trajectory) -> Matrix:
    rest = np.zeros((1, motion.q.shape[1]))
    segment = np.diff(motion.q, axis=0) / np.diff(motion.time)[:, None]
    return np.asarray(np.diff(np.vstack((rest, segment, rest)), axis=0))


def _spans(motion: Trajectory) -> Vector:
    step = np.diff(motion.time)
    return np.concatenate((step[:1], 0.5 * (step[:-1] + step[1:]), step[-1:]))


# --- torques -----------------------------------------------------------------------------


def _machine_of(robot: Robot) -> RawMachine:
    return read_raw_urdf(robot.urdf.path, find_mesh=robot.urdf.mesh_path, hold=robot.hold)


def torques_of(machine: RawMachine, problem: Problem, q: Matrix, v: Matrix, a: Matrix) -> Matrix:
    """(T, n) the torques that move machine and payload at q, v, a (T, n), without soil [N m or N].

        tau_j = sum over links of  m (c'' + g z) . dc/dq_j  +  (I w' + w x I w) . dphi/dq_j

    with the centre c of a link, its angular velocity w and its rotation dphi, all by differences of placements.
    """
    robot, scene = problem.robot, problem.scene
    offset = np.zeros(3) if scene.payload_at is None else np.array(scene.payload_at)
    loads = [(link, *mass, machine.inertias[link]) for link, mass in machine.masses.items()]
    loads.append((robot.tip, scene.payload, offset, np.zeros((3, 3))))

    def placed(q: Matrix) -> list[tuple[Array, Matrix]]:
        """The rotation (T, 3, 3) of every load and the place (T, 3) of its centre."""
        frames = machine.placements(dict(zip(robot.joint_names, q.T, strict=True)), len(q))
        return [(frames[link][0], frames[link][0] @ centre + frames[link][1]) for link, _, centre, _ in loads]

    here, h = placed(q), _INSTANT
    sooner, later = (placed(q + sign * h * v + 0.5 * h * h * a) for sign in (-1.0, 1.0))
    forces, moments = [], []
    for (_, mass, _, inertia), (R, c), (R_0, c_0), (R_1, c_1) in zip(loads, here, sooner, later, strict=True):
        forces.append(mass * ((c_1 - 2.0 * c + c_0) / h**2 + [0.0, 0.0, GRAVITY]))
        turned = R @ inertia @ R.swapaxes(1, 2)
        w, w_rate = _turn((R_1 - R_0) / (2.0 * h), R), _turn((R_1 - 2.0 * R + R_0) / h**2, R)
        spin = np.einsum("tij,tj->ti", turned, w)
        moments.append(np.einsum("tij,tj->ti", turned, w_rate) + np.cross(w, spin))
    found = np.zeros(q.shape)
    for joint in range(q.shape[1]):
        nudge = _NUDGE * np.eye(q.shape[1])[joint]
        before, after = placed(q - nudge), placed(q + nudge)
        for force, moment, (R, _), (R_0, c_0), (R_1, c_1) in zip(forces, moments, here, before, after, strict=True):
            found[:, joint] += np.sum(force * (c_1 - c_0), axis=1) / (2.0 * _NUDGE)
            found[:, joint] += np.sum(moment * _turn((R_1 - R_0) / (2.0 * _NUDGE), R), axis=1)
    return found


def _turn(change: Array, R: Array) -> Matrix:
    """(T, 3) the vector of the skew part of `change` R^T: of dR, the angular velocity; of ddR, its derivative."""
    W = change @ R.swapaxes(1, 2)
    skew = 0.5 * (W - W.swapaxes(1, 2))
    return np.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), axis=1)
