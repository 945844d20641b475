"""The drive of a machine, its limits, and how much of every limit a motion uses.

Torques follow from inverse dynamics with payload and soil; they are bounded by the
joints' effort and, with hydraulics, by the relief pressure. Speeds are bounded by the
valves, the shared pump and the engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags
from backhoe_planner.machine import BothWays, Dynamics, Hydraulics, Kinematics, Robot
from backhoe_planner.motion.legs import leg_parts
from backhoe_planner.motion.problem import Problem
from backhoe_planner.motion.timing.moment_slopes import moment_slopes
from backhoe_planner.motion.trajectory import Moments, Trajectory
from backhoe_planner.site import Ground, Soil, SoilReaction

# the part by which a sampled motion may exceed a limit of the drive: its accelerations are differences of velocities
DRIVE_TOLERANCE = 0.01
SLOWED_TO = 0.5 * DRIVE_TOLERANCE  # part of a limit by which motions that are slowed to it may exceed it
_BRISK = 1.0  # rad/s or m/s of the fastest joint; chosen: fast enough for the soil's full force
_REMEMBERED = 4  # latest uses that are kept; chosen: two curves are in use at a time
_MOST = 1e6  # ratio to a limit: greater ones count as this, so that none is infinite


@dataclass(frozen=True, eq=False)
class DriveUse:
    """How much of the limits of its drive a motion uses, at K moments; ratios are 1 at the limit.

    Attributes
    ----------
    torque: (K, n) the torques [N m or N].
    effort: (K, n) torque over the greatest torque of the joint in that direction.
    rod_speed: (K, n) speed of each joint over what valves and pump allow in that direction.
    flow, power: (K,) of all cylinders over those of pump and engine.
    """

    torque: Array
    effort: Array
    rod_speed: Array
    flow: Array
    power: Array

    @property
    def most(self) -> float:
        """The greatest use of any limit."""
        return max(float(np.max(self.effort)), float(np.max(self.speeds)))

    @property
    def speeds(self) -> Array:
        """(K, n + 2) rod speed of each joint, flow, power; at most `_MOST`."""
        return np.minimum(np.column_stack((self.rod_speed, self.flow, self.power)), _MOST)


class Drive:
    """The drive of one machine with its load.

    It owns its working memory: do not share one between threads.

    Parameters
    ----------
    effort: (n,) greatest torque of each joint either way [N m or N], the machine's own by
        default; infinite for no limit.
    payload, payload_at: as for `Dynamics`.
    soil: the soil in which the tip moves.
    ground: where the soil is; by default level at the soil's `surface`.

    Raises
    ------
    InputError: see `SoilReaction`.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        effort: Array | None = None,
        payload: float = 0.0,
        payload_at: Sequence[float] | None = None,
        soil: Soil | None = None,
        ground: Ground | None = None,
    ) -> None:
        self.joint_names = robot.joint_names
        self.hydraulics: Hydraulics | None = robot.hydraulics
        self._effort = robot.limits.effort if effort is None else effort
        self._dynamics = Dynamics(robot, payload=payload, payload_at=payload_at)
        self._soil = None if soil is None else SoilReaction(robot, soil, ground)
        self._known: dict[tuple[bytes, ...], DriveUse] = {}  # the latest uses, by the moments

    @property
    def limited(self) -> bool:
        """Whether there is any limit at all."""
        return self.hydraulics is not None or bool(np.any(np.isfinite(self._effort)))

    @property
    def digs(self) -> bool:
        """Whether there is soil."""
        return self._soil is not None

    def torque_limits(self, q: Array) -> BothWays:
        """(..., n) the greatest torques either way at q (..., n) [N m or N]."""
        if self.hydraulics is None:
            own = np.broadcast_to(self._effort, np.shape(q))
            return BothWays(own, own)
        oil = self.hydraulics.torque_limits(q)
        return BothWays(np.minimum(self._effort, oil.positive), np.minimum(self._effort, oil.negative))

    def rigid_torques(self, q: Array, v: Array, a: Array) -> Array:
        """(K, n) torques against inertia and gravity at q, v, a (K, n) [N m or N]."""
        return self._dynamics.torques_along(q, v, a)

    def gravity_torques(self, q: Array) -> Array:
        """(K, n) torques that hold the machine and its payload still at q (K, n) [N m or N]."""
        return self._dynamics.gravity_torques(q)

    def rigid_torque_slopes(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """`rigid_torques`, and (K, n, 3 n) their derivatives with respect to q, v and a."""
        return self._dynamics.torque_slopes(q, v, a)

    def soil_torques(self, q: Array, v: Array) -> Array:
        """(K, n) torques against the soil at q, v (K, n) [N m or N]."""
        return np.zeros(np.shape(q)) if self._soil is None else -self._soil.torques(q, v)

    def torque_slopes(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """(K, n) torques against inertia, gravity and soil at q, v, a (K, n), and (K, n, 3 n) their derivatives.

        Along the last axis, derivatives with respect to q come first, then those to v and to a. Those against the soil
        are differences.
        """
        torque, slopes = self.rigid_torque_slopes(q, v, a)
        if self._soil is None:
            return torque, slopes
        of_soil, soil_slopes = moment_slopes(lambda q, v, _: self.soil_torques(q, v), q, v, a)
        return torque + of_soil, slopes + soil_slopes

    def soil_torques_towards(self, q: Array, direction: Array) -> Array:
        """(K, n) torques against the soil for a fast motion at q in `direction` dq/ds (K, n) [N m or N].

        For a slower motion they are a part of these.
        """
        if self._soil is None:
            return np.zeros(np.shape(q))
        return self.soil_torques(q, direction * (_BRISK / np.maximum(np.max(np.abs(direction)), 1e-12)))

    def rod_speed_use(self, q: Array, v: Array) -> Array:
        """(..., n) speed of each joint over what valves and pump allow it alone, at q, v (..., n)."""
        if self.hydraulics is None:
            return np.zeros(np.shape(q))
        limits = self.hydraulics.velocity_limits(q)
        return np.asarray(np.abs(v) / np.where(v > 0.0, limits.positive, limits.negative))

    def flow_use(self, q: Array, v: Array) -> Array:
        """(...) flow over the pump's, at q, v (..., n)."""
        if self.hydraulics is None:
            return np.zeros(np.shape(q)[:-1])
        return np.asarray(self.hydraulics.total_flow(q, v) / self.hydraulics.pump_flow)

    def effort_use(self, q: Array, torque: Array) -> Array:
        """(..., n) `torque` (..., n) [N m or N] over the greatest of each joint in that direction, at q (..., n)."""
        there = self._torque_limits_towards(q, torque)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(torque == 0.0, 0.0, np.minimum(np.abs(torque) / there, _MOST)))

    def static_use(self, q: Array) -> Array:
        """(K, n) the `gravity_torques` at q (K, n), over the greatest of each joint in that direction."""
        return self.effort_use(q, self.gravity_torques(q))

    def power_use(self, q: Array, v: Array, torque: Array) -> Array:
        """(...) power in the oil over the engine's, at q, v (..., n) with `torque` (..., n) [N m or N]."""
        if self.hydraulics is None:
            return np.zeros(np.shape(q)[:-1])
        return np.asarray(self.hydraulics.power(q, v, torque) / self.hydraulics.power_limit)

    def use(self, q: Array, v: Array, a: Array) -> DriveUse:
        """The use of the drive by a motion at q, v, a (K, n); its arrays are read-only."""
        # a descent needs it of a curve twice: for the duration, and for the limits of the next step
        key = q.tobytes(), v.tobytes(), a.tobytes()
        found = self._known.get(key)
        if found is None:
            found = self._use(q, v, a)
            for field in fields(found):
                getattr(found, field.name).setflags(write=False)
            if len(self._known) >= _REMEMBERED:
                self._known.clear()
            self._known[key] = found
        return found

    def _use(self, q: Array, v: Array, a: Array) -> DriveUse:
        torque = self.rigid_torques(q, v, a) + self.soil_torques(q, v)
        return DriveUse(
            torque=torque,
            effort=self.effort_use(q, torque),
            rod_speed=self.rod_speed_use(q, v),
            flow=self.flow_use(q, v),
            power=self.power_use(q, v, torque),
        )

    def ratios(self, q: Array, v: Array, a: Array) -> Array:
        """(K, U) how much of each limit a motion uses at q, v, a (K, n).

        The effort of each joint; with hydraulics, also the rod speed of each joint, the flow and the power.
        """
        found = self.use(q, v, a)
        return found.effort if self.hydraulics is None else np.hstack((found.effort, found.speeds))

    def ratio_slopes(self, q: Array, v: Array, a: Array) -> Array:
        """(K, U, 3 n) the derivatives of `ratios` with respect to q, v and a, one after the other, at (K, n) each.

        Where a joint is at rest, they are those for a positive velocity.
        """
        joints = np.arange(q.shape[1])
        torque, of_torque = self.torque_slopes(q, v, a)
        limit = self._torque_limits_towards(q, torque)
        of_limit = self._limit_slopes_towards(q, torque, limit)
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(torque < 0.0, -1.0, 1.0) / limit
            effort = part[:, :, None] * of_torque
            effort[:, joints, joints] -= np.abs(torque) / limit**2 * of_limit
        effort[np.abs(torque) >= _MOST * limit] = 0.0
        if self.hydraulics is None:
            return np.asarray(effort)
        return np.concatenate((effort, self._speed_slopes(self.hydraulics, q, v, torque, of_torque)), axis=1)

    def _torque_limits_towards(self, q: Array, torque: Array) -> Array:
        """(..., n) the greatest torques in the direction of `torque` (..., n), at q (..., n) [N m or N]."""
        limits = self.torque_limits(q)
        return np.where(torque < 0.0, limits.negative, limits.positive)

    def _limit_slopes_towards(self, q: Array, torque: Array, limit: Array) -> Array:
        """(K, n) the derivatives of these limits, which are `limit` (K, n), by each joint's own position."""
        if self.hydraulics is None:
            return np.zeros_like(limit)
        slopes = self.hydraulics.torque_limit_slopes(q)
        return np.where(limit < self._effort, np.where(torque < 0.0, slopes.negative, slopes.positive), 0.0)

    @staticmethod
    def _speed_slopes(hydraulics: Hydraulics, q: Array, v: Array, torque: Array, of_torque: Array) -> Array:
        """(K, n + 2, 3 n) the derivatives of `DriveUse.speeds` at q, v (K, n), where torques have derivatives."""
        n = q.shape[1]
        joints, back = np.arange(n), v < 0.0
        limits, slopes = hydraulics.velocity_limits(q), hydraulics.velocity_limit_slopes(q)
        limit = np.where(back, limits.negative, limits.positive)
        found = np.zeros((len(q), n + 2, 3 * n))
        of_limit = np.where(back, slopes.negative, slopes.positive)
        found[:, joints, joints] = -np.abs(v) / limit**2 * of_limit
        found[:, joints, n + joints] = np.where(back, -1.0, 1.0) / limit
        for part, slope in enumerate(hydraulics.flow_slopes(q, v)):
            found[:, n, part * n : (part + 1) * n] = slope / hydraulics.pump_flow
        # of a joint that moves against its load, the cylinders take the power torque v together
        against = hydraulics.has_cylinder & (np.where(back, -torque, torque) > 0.0)
        power = np.sum(np.where(against, v, 0.0)[:, :, None] * of_torque, axis=1)
        power[:, n : 2 * n] += np.where(against, torque, 0.0)
        found[:, n + 1] = power / hydraulics.power_limit
        return found

    def use_along(self, moments: Moments) -> DriveUse:
        """The use of the drive at `moments`.

        Speeds and flow are also checked halfway between them; torques and power also at corners
        with the velocities on both sides. A torque is that of the greater effort.
        """
        use = self.use(moments.q, moments.v, moments.a)
        if len(moments.time) < 2:
            return use
        torque, effort, power = use.torque, use.effort, use.power.copy()
        for side in (moments.before, moments.after):
            corner = np.any(side != moments.v, axis=1)
            if corner.any():
                there = self.use(moments.q[corner], side[corner], moments.a[corner])
                torque, effort = _with_greater(torque, effort, corner, there.torque, there.effort)
                power[corner] = np.maximum(power[corner], there.power)
        middle = 0.5 * (moments.q[:-1] + moments.q[1:])
        v = np.diff(moments.q, axis=0) / np.diff(moments.time)[:, None]
        return replace(
            use,
            torque=torque,
            effort=effort,
            power=power,
            rod_speed=np.maximum(use.rod_speed, _beside(self.rod_speed_use(middle, v))),
            flow=np.maximum(use.flow, _beside(self.flow_use(middle, v))),
        )


def _with_greater(
    torque: Array, effort: Array, rows: Flags | list[int], torque_there: Array, effort_there: Array
) -> tuple[Array, Array]:
    """(K, n), (K, n) torques and efforts, in some rows those `there` (R, n) where that effort is greater."""
    torque, effort = torque.copy(), effort.copy()
    greater = effort_there > effort[rows]
    torque[rows] = np.where(greater, torque_there, torque[rows])
    effort[rows] = np.where(greater, effort_there, effort[rows])
    return torque, effort


def _beside(between: Array) -> Array:
    """(K + 1, ...) for each of K + 1 moments, the greater of the values (K, ...) before and after it."""
    return np.maximum(np.concatenate((between[:1], between)), np.concatenate((between, between[-1:])))


def drive_of(problem: Problem) -> Drive:
    """The drive of a problem's machine with the scene's payload and soil."""
    scene = problem.scene
    return Drive(
        problem.robot,
        effort=problem.limits.effort,
        payload=scene.payload,
        payload_at=scene.payload_at,
        soil=scene.soil,
        ground=problem.ground,
    )


@dataclass(frozen=True, eq=False)
class LimitUsage:
    """How much of L limits a motion uses at M moments.

    Attributes
    ----------
    moments: the samples, and further ones inside long segments.
    limits: L kinds with the joint that each belongs to: ``velocity``, ``acceleration``, ``torque`` and
        ``rod speed`` of every joint; ``pump flow``, ``engine power`` and ``tip speed``, with no joint.
    ratio: (M, L) 1 at the limit.
    torque: (M, n) the torques that the ratios of the torques are those of [N m or N]; 0 if none is limited.
    """

    moments: Moments
    limits: tuple[tuple[str, str], ...]
    ratio: Array
    torque: Array

    @property
    def names(self) -> tuple[str, ...]:
        """L, such as ``velocity boom``."""
        return tuple(f"{kind} {joint}".strip() for kind, joint in self.limits)

    @property
    def binding(self) -> NDArray[np.int64]:
        """(M,) index of the limit that is used most."""
        return np.asarray(np.argmax(self.ratio, axis=1), dtype=np.int64)

    @property
    def greatest(self) -> Array:
        """(M,) ratio of the limit that is used most."""
        return np.asarray(np.max(self.ratio, axis=1))

    def worst(self, *kinds: str) -> tuple[int, int]:
        """Indices of the moment and of the limit with the greatest ratio, among limits of these `kinds`.

        At least one limit must be of these kinds.
        """
        columns = [index for index, (kind, _) in enumerate(self.limits) if kind in kinds]
        row, column = np.unravel_index(int(np.argmax(self.ratio[:, columns])), (len(self.ratio), len(columns)))
        return int(row), columns[int(column)]


def limit_usage(problem: Problem, trajectory: Trajectory, *, tip_speed: bool = True) -> LimitUsage:
    """How much of the limits of joints, drive and tip speed a motion uses.

    Velocities are those of the faster of the two segments beside a sample, accelerations
    and torques those of `Trajectory.corner_accelerations`. Where the motion begins or ends at rest, the torque that
    holds the machine still counts too: an arm that drops at once takes less. The tip's speed counts where the tip is
    on the path, if the scene limits it.

    Parameters
    ----------
    tip_speed: whether to include the tip's speed.
    """
    if problem.legs:
        return _usage_of_legs(problem, trajectory)
    joints, moments = problem.robot.joint_names, trajectory.moments()
    velocity = np.zeros_like(trajectory.q)
    if len(trajectory) > 1:
        velocity = _beside(np.abs(trajectory.segment_velocities())[moments.segment[:-1]])
        for row, beside in ((0, trajectory.before), (-1, trajectory.after)):
            if beside is not None:
                velocity[row] = np.maximum(velocity[row], np.abs(beside.velocity))
    kinds = ["velocity", "acceleration"]
    columns = [velocity / problem.limits.velocity, np.abs(moments.a) / problem.limits.acceleration]
    drive, torque = drive_of(problem), np.zeros_like(moments.q)
    if drive.limited:
        use = drive.use_along(moments)
        resting = [row for row, beside in ((0, trajectory.before), (-1, trajectory.after)) if beside is None]
        gravity = drive.gravity_torques(moments.q[resting])
        at_rest = drive.effort_use(moments.q[resting], gravity)
        torque, effort = _with_greater(use.torque, use.effort, resting, gravity, at_rest)
        kinds.append("torque")
        columns.append(effort)
        if drive.hydraulics is not None:
            kinds.append("rod speed")
            columns.append(use.speeds)
    limits = [(kind, joint) for kind in kinds for joint in joints]
    if drive.hydraulics is not None:
        limits += [("pump flow", ""), ("engine power", "")]
    task = problem.scene.task.path
    if tip_speed and task is not None and task.speed is not None and problem.path is not None:
        kinematics = Kinematics(problem.robot)
        tips = np.array([kinematics.at(q).tip_position for q in moments.q])
        near = np.array([problem.path.nearest(tip)[1] <= task.tolerance for tip in tips])
        speed = np.zeros(1)
        if len(tips) > 1:
            moved = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(moments.time)
            speed = _beside(np.where(near[1:] & near[:-1], moved, 0.0))
        limits.append(("tip speed", ""))
        columns.append(speed[:, None] / task.speed)
    return LimitUsage(moments, tuple(limits), np.hstack(columns), torque)


def _usage_of_legs(problem: Problem, trajectory: Trajectory) -> LimitUsage:
    """The limit usage of all legs of a sequence in order; the moment at which two meet belongs to the later one."""
    parts = leg_parts(problem, trajectory)
    found = [limit_usage(part.problem, part.motion, tip_speed=False) for part in parts]
    last = len(found) - 1
    kept = [slice(0, len(use.moments.time) - (k < last)) for k, use in enumerate(found)]
    own = {field.name: [getattr(use.moments, field.name) for use in found] for field in fields(Moments)}
    own["time"] = [time + part.begins for time, part in zip(own["time"], parts, strict=True)]
    own["segment"] = [rows + part.first for rows, part in zip(own["segment"], parts, strict=True)]
    moments = Moments(
        **{name: np.concatenate([v[s] for v, s in zip(values, kept, strict=True)]) for name, values in own.items()}
    )
    ratio, torque = (
        np.vstack([getattr(use, name)[rows] for use, rows in zip(found, kept, strict=True)])
        for name in ("ratio", "torque")
    )
    return LimitUsage(moments, found[0].limits, ratio, torque)
