"""Velocities, accelerations, torques and the oil of a motion, and whether they are within the limits of the machine.

They follow from the samples of the positions, the URDF and the hydraulic description as written, and the scene alone. A
torque is the work of inertia and weight of all links on a small motion of its joint (d'Alembert's principle), with the
accelerations of the links from differences of their placements, and of the soil (`raw_soil`). The speed of a rod is a
difference of its lengths in time (`raw_drive`). Neither inverse dynamics nor limits, velocities or accelerations of the
package take part.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.motion import LegPart, Problem, Trajectory, leg_parts, trajectory_energy
from backhoe_planner.site import Scene
from validation.held_loads import GRAVITY, drive_of, greatest_torques
from validation.raw_drive import RawDrive
from validation.raw_soil import soil_torques
from validation.raw_urdf import RawMachine, read_raw_urdf

_PERIOD = 0.02  # s in which a velocity changes at a corner, at most, as the certificate defines it
_FULL_RATE_AFTER = 0.5  # s, where neither URDF nor scene gives an acceleration, as the scene's documentation says
_USUAL_RATE = 1.0  # rad/s or m/s, where neither gives a velocity, as it says too
_INSTANT = 1e-3  # s of the differences in time: accelerations are right to a part of 1e-6
_NUDGE = 1e-5  # rad or m of the differences by joint, as in `held_loads`
_PART = 0.025  # rad or m, the most that a joint moves while a rod's speed is one difference of lengths, as in the docs
_INSIDE = np.linspace(0.0, 1.0, 9)  # parts of what is straight in a long segment at which its torques are looked at
_HARDLY = (1e-10, 1e-5)  # rad/s or m/s between which rounding decides whether a joint needs the pump's pressure
_JOINT_SLACK = 1e-5  # part of a limit of velocity or acceleration, for rounding
_DRIVE_SLACK = 0.0101  # part of a limit of the drive: the certificate accepts 1 %
_UNSAID = 2e-3  # part of a limit of the drive by which a certificate may say less: it has the peaks to 0.1 %
_UNSAID_OIL = 1e-4  # the same of rods and flow, which are looked at from place to place as in a certificate
_SAME = 1e-4  # part of the largest of its kind by which figures may differ: files have six digits of a torque
# the same on the ground of a job: what the bucket holds jumps where its edge goes straight down, and rounding decides
# on which side a sample is there; 1.6e-4 were measured
_SAME_ON_GROUND = 1e-3
_ARTICLES = {"acceleration": "an", "engine power": "an"}
_PER = {"velocity": "/s", "acceleration": "/s^2"}  # after the unit of a joint
_OIL = ("rod speed", "pump flow", "engine power")  # of which a certificate has the one that is used most


@dataclass(frozen=True, eq=False)
class Use:
    """The use of one kind of limit at K moments of a motion.

    Attributes
    ----------
    kind: as in a certificate.
    time: (K,) [s].
    who: names of the joints, or one word for what all of them share.
    value, limit: (K, n) or (K, 1), in `units`.
    slack: part of a limit by which it may be exceeded; unsaid: by which a certificate may say less.
    """

    kind: str
    time: Vector
    who: Sequence[str]
    value: Matrix
    limit: Matrix
    units: Sequence[str]
    slack: float = _DRIVE_SLACK
    unsaid: float = _UNSAID

    @property
    def ratio(self) -> Matrix:
        """(K, n) value over limit."""
        return np.asarray(np.abs(self.value) / self.limit)


@dataclass(frozen=True)
class Said:
    """What a plan says of its motion.

    Attributes
    ----------
    verified: whether all limits are kept.
    uses: greatest part of each kind of limit.
    torque: (T, n); power: (T,) of the joints; pump: (T,) of the pump [W], or None.
    """

    verified: bool
    uses: Mapping[str, float]
    torque: Matrix
    power: Vector
    pump: Vector | None


def motion_contradictions(plan: bp.Plan) -> list[str]:
    """Describe the limits that a verified plan exceeds, and what its certificate and figures say wrongly of them."""
    uses = {use.kind: use.ratio for use in plan.certificate.uses.values()}
    energy = trajectory_energy(plan.problem, plan.trajectory)
    return _contradictions(plan, Said(plan.verified, uses, energy.torque, energy.power, energy.hydraulic_power))


def file_contradictions(path: Path) -> list[str]:
    """The same for the verdict, the certificate and the figures as they stand in a plan file."""
    plan, said = bp.load_plan(path), json.loads(path.read_text(encoding="utf-8"))
    uses = {use["kind"]: float(use["ratio"]) for use in said["certificate"]["limits"].values()}
    figures: dict[str, Any] = said["dynamics"]
    torque, power = (np.array(figures[key], dtype=float) for key in ("torque", "power"))
    pump = None if figures.get("hydraulic_power") is None else np.array(figures["hydraulic_power"], dtype=float)
    return _contradictions(plan, Said(said["verdict"] == "verified", uses, torque, power, pump))


def _contradictions(plan: bp.Plan, said: Said) -> list[str]:
    motion, names = plan.trajectory, plan.robot.joint_names
    if len(motion) < 2:
        return []
    machine = read_raw_urdf(plan.robot.urdf.path, find_mesh=plan.robot.urdf.mesh_path, hold=plan.robot.hold)
    drive = drive_of(plan.robot, machine)
    found = list(_differences("velocity", motion.v, sample_velocities(motion), motion.time, names))
    for part in leg_parts(plan.problem, motion):
        for use in _uses(machine, drive, part, motion):
            found += _broken(use, said)
        found += _figures(machine, drive, part, motion, said)
    return list(dict.fromkeys(found))


def _figures(
    machine: RawMachine, drive: RawDrive | None, part: LegPart, motion: Trajectory, said: Said
) -> Iterator[str]:
    """Where the torques and powers of one leg that a plan gives are not those of its samples."""
    # the sample at which two legs meet has the torque of the later one
    own = slice(part.first, part.last + (part.last == len(motion) - 1))
    q, v, a, time = (
        each[own] for each in (motion.q, sample_velocities(motion), sample_accelerations(motion), motion.time)
    )
    torque = torques_of(machine, part.problem, q, v, a)
    same = _SAME if part.problem.ground is None else _SAME_ON_GROUND
    yield from _differences("torque", said.torque[own], torque, time, part.problem.robot.joint_names, same)
    power = np.sum(np.maximum(torque * v, 0.0), axis=1)
    yield from _differences("power", said.power[own, None], power[:, None], time, ["all joints"], same)
    if drive is None:
        return
    speed = np.abs(v)
    clear = ~np.any((speed > _HARDLY[0]) & (speed < _HARDLY[1]), axis=1)
    pump = drive.pump_rates(q, np.where(speed > _HARDLY[0], v, 0.0), torque)
    given = np.zeros(len(motion)) if said.pump is None else said.pump
    yield from _differences("power", given[own][clear, None], pump[clear, None], time[clear], ["the pump"], same)


def _broken(use: Use, said: Said) -> Iterator[str]:
    """What the greatest use of a limit contradicts."""
    row, column = map(int, np.unravel_index(int(np.argmax(use.ratio)), use.ratio.shape))
    most = float(use.ratio[row, column])
    what = f"{_ARTICLES.get(use.kind, 'a')} {use.kind} of {abs(use.value[row, column]):.6g} {use.units[column]}"
    where = f"{use.who[column]} at {use.time[row]:.3f} s: {what}"
    if said.verified and most > 1.0 + use.slack:
        yield f"{where}, allowed are {use.limit[row, column]:.6g}"
    claim = max(said.uses.get(kind, 0.0) for kind in (_OIL if use.kind in _OIL else (use.kind,)))
    if most > claim + use.unsaid:
        yield f"{where} is {100.0 * most:.2f} % of the limit, said are {100.0 * claim:.2f} %"


def _differences(
    kind: str, said: Array, found: Array, time: Vector, who: Sequence[str], same: float = _SAME
) -> Iterator[str]:
    """The joint and the sample at which figures (T, n) of one kind differ most, if by more than `same`."""
    off = np.abs(said - found)
    if not off.size:
        return
    row, joint = map(int, np.unravel_index(int(np.argmax(off)), off.shape))
    if off[row, joint] > same * float(np.max(np.abs(found), initial=1.0)):
        given, right = said[row, joint], found[row, joint]
        yield f"{who[joint]} at {time[row]:.3f} s: a {kind} of {given:.6g} is said, of the samples it is {right:.6g}"


def _uses(machine: RawMachine, drive: RawDrive | None, part: LegPart, motion: Trajectory) -> Iterator[Use]:
    """The uses of the limits of one leg of a whole motion."""
    problem, rows = part.problem, slice(part.first, part.last + 1)
    robot, names, time = problem.robot, problem.robot.joint_names, motion.time[rows]
    velocity, acceleration, effort = (
        np.array(limit) for limit in zip(*(_limits(machine, problem.scene, name) for name in names), strict=True)
    )
    segment = np.abs(np.diff(motion.q, axis=0) / np.diff(motion.time)[:, None])
    faster = np.maximum(np.vstack((segment[:1], segment)), np.vstack((segment, segment[-1:])))[rows]
    a = (_jumps(motion) / np.minimum(_spans(motion), _PERIOD)[:, None])[rows]
    for kind, value, limit in (("velocity", faster, velocity), ("acceleration", a, acceleration)):
        units = [unit + _PER[kind] for unit in robot.joint_units]
        allowed = np.broadcast_to(limit, value.shape)
        yield Use(kind, time, names, value, allowed, units, slack=_JOINT_SLACK, unsaid=_JOINT_SLACK)
    if drive is None and not np.isfinite(effort).any():
        return
    inside = _inside(motion, part)
    q, v, a, time = (
        np.concatenate((at_samples, between))
        for at_samples, between in zip((motion.q[rows], sample_velocities(motion)[rows], a, time), inside, strict=True)
    )
    torque = torques_of(machine, problem, q, v, a)
    units = [{"rad": "N m", "m": "N"}[unit] for unit in robot.joint_units]
    yield Use("torque", time, names, torque, greatest_torques(drive, q, torque, effort), units)
    if drive is None:
        return
    power = drive.work_rates(v, torque)[:, None]
    yield Use("engine power", time, ["all joints"], power, np.full(power.shape, drive.power), ["W"])
    yield from _rods(drive, motion, part)


def _rods(drive: RawDrive, motion: Trajectory, part: LegPart) -> Iterator[Use]:
    """What the rods of one leg use of valves and pump, by the oil that they take from place to place."""
    if part.last == part.first:
        return
    q, time = motion.q[part.first : part.last + 1], motion.time[part.first : part.last + 1]
    counts = np.ceil(np.max(np.abs(np.diff(q, axis=0)), axis=1) / _PART).astype(int).clip(1)
    index = np.concatenate([k + np.arange(count) / count for k, count in enumerate(counts.tolist())] + [[len(q) - 1]])
    finer = np.interp(index, np.arange(len(q)), time)
    lengths = drive.lengths(np.stack([np.interp(finer, time, column) for column in q.T], axis=1))
    flows = drive.flows(np.diff(lengths, axis=0) / np.diff(finer)[:, None])
    middle = 0.5 * (finer[1:] + finer[:-1])
    rods, flow = drive.rod_use(flows), np.sum(flows, axis=1)[:, None]
    units = ["of the greatest"] * len(drive.joint_names)
    yield Use("rod speed", middle, drive.joint_names, rods, np.ones(rods.shape), units, unsaid=_UNSAID_OIL)
    most = np.full(flow.shape, drive.pump)
    yield Use("pump flow", middle, ["all joints"], flow, most, ["m^3/s"], unsaid=_UNSAID_OIL)


def _inside(motion: Trajectory, part: LegPart) -> tuple[Matrix, Matrix, Matrix, Vector]:
    """q, v, a (K, n) and (K,) times within the segments of a leg that are so long that no joint accelerates there."""
    step = np.diff(motion.time)
    long = part.first + np.flatnonzero(step[part.first : part.last] > 2.0 * _PERIOD)
    if not len(long):
        nothing = np.zeros((0, motion.q.shape[1]))
        return nothing, nothing, nothing, np.zeros(0)
    ahead = np.repeat(long, len(_INSIDE))
    rounded = 0.5 * _PERIOD / step[ahead]
    along = (rounded + np.tile(_INSIDE, len(long)) * (1.0 - 2.0 * rounded))[:, None]
    q = (1.0 - along) * motion.q[ahead] + along * motion.q[ahead + 1]
    v = (np.diff(motion.q, axis=0) / step[:, None])[ahead]
    return q, v, np.zeros(q.shape), motion.time[ahead] + along[:, 0] * step[ahead]


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


def torques_of(machine: RawMachine, problem: Problem, q: Matrix, v: Matrix, a: Matrix) -> Matrix:
    """(T, n) the torques that move machine and payload at q, v, a (T, n), through the soil if there is any [N m or N].

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
    found = soil_torques(machine, problem, q, v)
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
