"""The cost of a motion: step by step along a bucket path, and as a whole over its samples.

On a step from joints q_a to q_b over the arc length h the tip is assumed to move at a
constant speed u, slower only where a joint or a rod cannot follow:

    dt = max(h / u, |dq_j| / v_j)        dq = q_b - q_a

u is the scene's speed, or a nominal one if the scene gives none. The classes of `objectives`
define the cost of a step. The sums approximate what `trajectory_costs` reports of a finished
plan by the trapezoidal rule, without torques of inertia. `work` and `hydraulic` do not depend
on u.

All costs are in one unit, that of the turning of a joint [rad], so that they can be weighed
against the turning of the joints on a detour.

Some objectives do not penalise every motion: where loads drive the joints, work is 0 however
they move. The search adds terms to these, which are not part of their reported value:

    a small part of |dq|^2 / dt,
    a price on the time that is lost where a joint cannot follow u, and where rates
    change, max_j |v_j' - v_j| / a_j from step to step,
    and the objective's own overhead.

`time` counts only the lost time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Indices
from backhoe_planner.machine import BatchKinematics, Dynamics, MotionEnergy, motion_energy
from backhoe_planner.motion.legs import leg_parts
from backhoe_planner.motion.objectives import (
    OBJECTIVES,
    LoadedMachine,
    Nodes,
    Objective,
    Step,
    TipVelocities,
    Usual,
)
from backhoe_planner.motion.problem import Problem
from backhoe_planner.motion.trajectory import SAMPLE_PERIOD, Trajectory
from backhoe_planner.site import SoilReaction

WIDEST_STEP = 0.7  # rad or m that one joint may move in a step; chosen, 40 degrees
_SMOOTHING = 3e-3  # part of |dq|^2 / (v dt) that is added; chosen: decides between motions that cost nothing
_TYPICAL = 64  # seeded postures over which loads are averaged; chosen
_SHORTEST = 1e-9  # s: the least duration of a step, so that rates are finite
_UNLIMITED = 1e6  # rad/s and rad/s^2, in place of infinity
_MANY_NEAR = 0.5  # part of all pairs of nodes; chosen: if fewer are near, only those are evaluated
_PORTION = 20_000  # pairs of nodes at once; chosen: their mass matrices take some megabytes
_PART = 0.025  # rad or m that a joint moves between two moments of a long segment: 0.1 % of the work of a lift
_MOST_PARTS = 20_000  # of one motion; chosen, so that a very long one takes seconds
_APPROACH_PARTS = 8  # steps of a motion to the path; chosen: its loads are within 1 % of those with 64 steps
_STILL = 1e-6  # m between neighbours on a path: below this the tip stands still


class PathCost:
    """The cost of motions along a path by one objective.

    Parameters
    ----------
    problem: machine, scene and path.

    Attributes
    ----------
    objective: the problem's, which defines the cost.
    speed: u, the tip's speed [m/s]; infinite for `time` if the scene gives none.
    per_radian: value of the objective that counts as 1 rad of cost, such as the J of work.
    """

    def __init__(self, problem: Problem) -> None:
        robot, scene = problem.robot, problem.scene
        self.objective = problem.objective
        self._machine = LoadedMachine(
            Dynamics(robot, payload=scene.payload, payload_at=scene.payload_at),
            None if scene.soil is None else SoilReaction(robot, scene.soil, problem.ground),
            robot.hydraulics,
        )
        self._kinematics = BatchKinematics(robot)
        self._continuous = robot.continuous.tolist()
        self._velocity, self._acceleration = (
            np.where(np.isfinite(limit), limit, _UNLIMITED)
            for limit in (problem.limits.velocity, problem.limits.acceleration)
        )
        asked = None if scene.task.path is None else scene.task.path.speed
        nominal, usual = self._typical(problem, asked)
        self.speed = asked if asked is not None else (np.inf if self.objective.is_time else nominal)
        self._rate = usual.rate
        self.per_radian = self.objective.per_radian(usual)
        quiet = self.objective.is_quadratic
        self._smoothing = 0.0 if quiet else _SMOOTHING
        self.time_price = 0.0 if quiet else usual.rate * self.objective.time_share
        if not self.per_radian > 0.0:  # a machine without mass costs nothing, whatever it does
            self.per_radian, self._smoothing = 1.0, 1.0

    # --- costs ------------------------------------------------------------------------

    def step_costs(self, a: Array, b: Array, span: float) -> Array:
        """(A, B) cost of the steps from each of a (A, n) to each of b (B, n) over `span` of the path [m], in rad.

        Infinite where a joint would move by more than `WIDEST_STEP`.
        """
        if not len(a) or not len(b):
            return np.zeros((len(a), len(b)))
        # the tip is at the same place for all of a, and for all of b
        velocity = None if self._machine.soil is None else self._tip_velocity(np.vstack((a[:1], b[:1])))
        before, after = self.nodes(a, (None, velocity)), self.nodes(b, (velocity, None))
        cost = np.full((len(a), len(b)), np.inf)
        near = self._near_pairs(a, b)
        if near is None:
            widest = np.zeros(cost.shape)
            for change in self._changes(a[:, None], b[None, :]):
                np.maximum(widest, np.abs(change, out=change), out=widest)
            within = widest <= WIDEST_STEP
            cost[within] = self.between(before[:, None], after[None, :], np.asarray(span))[within]
            return cost
        first, second = near
        for begin in range(0, len(first), _PORTION):
            rows, columns = first[begin : begin + _PORTION], second[begin : begin + _PORTION]
            cost[rows, columns] = self.between(before[rows], after[columns], np.full(len(rows), span))
        return cost

    def _near_pairs(self, a: Array, b: Array) -> tuple[Indices, Indices] | None:
        """(K,), (K,) the rows of a (A, n) and b (B, n) between which no joint moves by more than `WIDEST_STEP`.

        They are in the order of the rows of a, then b. None if they are more than `_MANY_NEAR` of all.
        """
        # each joint leaves few pairs to the next, the one with the widest range fewest
        widest, *others = np.argsort(-np.ptp(b, axis=0), kind="stable").tolist()
        apart = np.abs(self._change(widest, a[:, None, widest], b[None, :, widest]))
        first, second = np.divmod(np.flatnonzero(apart <= WIDEST_STEP), len(b))
        for joint in others:
            near = np.flatnonzero(np.abs(self._change(joint, a[first, joint], b[second, joint])) <= WIDEST_STEP)
            first, second = first[near], second[near]
        return None if len(first) > _MANY_NEAR * len(a) * len(b) else (first, second)

    def of_steps(self, stations: Array, q: Array) -> float:
        """Cost of the steps through q (K, n) at `stations` (K,) [m], in rad."""
        return self._sum(stations, q, as_reported=False)

    def of_run(self, stations: Array, q: Array) -> float:
        """Cost of a run from rest to rest through q (K, n) at `stations` (K,) [m], with changes of rates, in rad."""
        cost = self.of_steps(stations, q)
        if len(q) < 3 or not self.counts_rate_changes:
            return cost
        rates = self.rates(q[:-1], q[1:], np.diff(stations))
        rest = np.zeros((q.shape[1], 1))
        return cost + float(np.sum(self.rate_changes(np.hstack((rest, rates)), np.hstack((rates, rest)))))

    @property
    def counts_rate_changes(self) -> bool:
        """Whether changes of the joints' rates cost anything."""
        return self.time_price > 0.0

    def value(self, stations: Array, q: Array) -> float:
        """Value of the steps through q (K, n) at `stations` (K,) [m], in the objective's unit, as reported."""
        return self.per_radian * self._sum(stations, q, as_reported=True)

    def _sum(self, stations: Array, q: Array, *, as_reported: bool) -> float:
        if len(q) < 2:
            return 0.0
        nodes = self.nodes(q, self.tip_velocities(q))
        return float(np.sum(self.between(nodes[:-1], nodes[1:], np.diff(stations), as_reported=as_reported)))

    def nodes(self, q: Array, tip: TipVelocities) -> Nodes:
        """Configurations q (B, n) with what the objective needs to know of them, see `Objective.nodes`."""
        found: Nodes = self.objective.nodes(q, self._machine, tip)
        return found

    def between(self, a: Nodes, b: Nodes, span: Array, *, as_reported: bool = False) -> Array:
        """(...) cost of the steps from a to b over `span` (...) [m], all broadcast, in rad.

        If `as_reported`, the terms that the search adds are left out.
        """
        dq, dt = self._joint_steps(a.q, b.q, span)
        return self._of_steps(a, b, dq, dt, span, as_reported=as_reported)

    def of_approaches(self, start: Array, q: Array) -> Array:
        """(N,) cost of the straight motions from rest at `start` (n,) to rest at each of q (N, n), in rad.

        Each has an even pace and takes the least time that the limits of the joints' rates and accelerations allow.
        """
        part = np.linspace(0.0, 1.0, _APPROACH_PARTS + 1)[:, None, None]
        change = np.stack(self._changes(start, q), axis=-1)
        nodes = self.nodes((start + part * change).reshape(-1, len(start)), (None, None))
        along = nodes.reshape(len(part), len(q))
        before, after = along[:-1], along[1:]
        dq = [np.broadcast_to(each / _APPROACH_PARTS, (_APPROACH_PARTS, len(q))) for each in change.T]
        fastest = np.max(np.abs(change) / self._velocity, axis=1) / _APPROACH_PARTS
        dt = np.maximum(self.objective.duration(np.broadcast_to(fastest, dq[0].shape), before, after, self._machine),
                        _SHORTEST)  # fmt: skip
        # T s at full rates and D / T s of speeding up, with D = max |dq_j| / a_j: the sum is least at T^2 = D
        full, speeding_up = np.sum(dt, axis=0), np.max(np.abs(change) / self._acceleration, axis=1)
        even = np.maximum(full, np.sqrt(speeding_up))
        dt = dt * (even + speeding_up / even) / full
        return np.asarray(np.sum(self._of_steps(before, after, dq, dt, np.zeros(1)), axis=0))

    def _of_steps(
        self, a: Nodes, b: Nodes, dq: list[Array], dt: Array, span: Array, *, as_reported: bool = False
    ) -> Array:
        """(...) cost of the steps from a to b over `span` (...) [m], all broadcast, in rad.

        Parameters
        ----------
        dq, dt: as `_joint_steps` gives them.
        as_reported: as for `between`.
        """
        squared = np.zeros(np.broadcast_shapes(a.q.shape[:-1], b.q.shape[:-1]))
        for change in dq:
            squared += change * change
        dt = np.maximum(self.objective.duration(dt, a, b, self._machine), _SHORTEST)
        step = Step(a, b, dq, squared, dt)
        if as_reported or not self._smoothing > 0.0:
            return np.asarray(self.objective.of_step(step, self._machine) / self.per_radian)
        lost = dt if np.isinf(self.speed) else np.maximum(dt - span / self.speed, 0.0)
        held = self.time_price * lost + self.objective.overhead(step, self._machine, self.per_radian)
        held = self._smoothing / self._rate * squared / dt + held
        if self.objective.is_time:  # only the lost time can be saved
            return np.asarray(held)
        return np.asarray(self.objective.of_step(step, self._machine) / self.per_radian + held)

    # --- changes of rates ----------------------------------------------------------------

    def rates(self, a: Array, b: Array, span: Array) -> Array:
        """(n, ...) rates of the joints on the steps from a to b (..., n) over `span` (...) [m], in seconds.

        Each is divided by the joint's acceleration limit: the time that the joint takes to reach its rate from rest.
        """
        dq, dt = self._joint_steps(a, b, span)
        dt = np.maximum(dt, _SHORTEST)
        return np.array([change / (dt * limit) for change, limit in zip(dq, self._acceleration, strict=True)])

    def _joint_steps(self, a: Array, b: Array, span: Array) -> tuple[list[Array], Array]:
        """How far each joint moves from a to b (..., n), as n of (...) [rad or m], and (...) the step's time [s]."""
        dq = self._changes(a, b)
        dt = np.zeros(dq[0].shape)
        if np.isfinite(self.speed):
            np.maximum(dt, span / self.speed, out=dt)
        for joint, change in enumerate(dq):
            np.maximum(dt, np.abs(change) / self._velocity[joint], out=dt)
        return dq, dt

    def _changes(self, a: Array, b: Array) -> list[Array]:
        """The n changes (...) of the joints from a to b (..., n) [rad or m]; continuous ones the shorter way round."""
        return [self._change(joint, a[..., joint], b[..., joint]) for joint in range(a.shape[-1])]

    def _change(self, joint: int, a: Array, b: Array) -> Array:
        """(...) how far one joint moves from a to b (...) [rad or m]; a continuous one the shorter way round."""
        change = np.asarray(b - a)
        if self._continuous[joint]:
            change -= 2.0 * np.pi * np.round(change / (2.0 * np.pi))
        return change

    def rate_changes(self, before: Array, after: Array) -> Array:
        """(...) cost of the time in which `rates` change from `before` to `after` (n, ...), in rad."""
        longest = np.zeros(np.broadcast_shapes(before.shape[1:], after.shape[1:]))
        for one, other in zip(before, after, strict=True):
            change = other - one
            np.maximum(longest, np.abs(change, out=change), out=longest)
        longest *= self.time_price
        return longest

    # --- how the tip moves --------------------------------------------------------------

    def _tip_velocity(self, q: Array) -> Array:
        """(K - 1, 3) the tip's velocity between neighbours of q (K, n) at the speed u [m/s]; 0 where it is still."""
        change = np.diff(self._kinematics.at(q).tip_position, axis=0)
        length = np.linalg.norm(change, axis=-1, keepdims=True)
        speed = self.speed if np.isfinite(self.speed) else 1.0
        return np.asarray(speed * np.where(length > _STILL, change / np.maximum(length, _STILL), 0.0))

    def tip_velocities(self, q: Array) -> TipVelocities:
        """(K, 3), (K, 3) the tip's velocities before and after each of q (K, n) [m/s]; None, None without soil."""
        if self._machine.soil is None:
            return None, None
        velocity = self._tip_velocity(q)
        return np.vstack((velocity[:1], velocity)), np.vstack((velocity, velocity[-1:]))

    def _typical(self, problem: Problem, asked: float | None) -> tuple[float, Usual]:
        """A nominal tip speed [m/s], and the usual figures of this machine at the `asked` speed [m/s]."""
        rng = np.random.default_rng(0)
        q = np.array([problem.robot.random_q(rng) for _ in range(_TYPICAL)])
        J = self._kinematics.at(q).position_jacobian()
        arm = np.sqrt(np.mean(np.sum(J * J, axis=1), axis=0))
        moving = arm > 1e-3 * float(np.max(arm, initial=0.0))
        speed = 0.5 * float(np.median((arm * self._velocity)[moving])) if moving.any() else 1.0
        reach = float(np.max(arm, initial=0.0)) or 1.0
        return speed, Usual(
            rate=(asked if asked is not None else speed) / reach,
            load=float(np.mean(np.linalg.norm(self._machine.dynamics.gravity_torques(q), axis=1))),
            inertia=float(np.mean(np.trace(self._machine.dynamics.mass_matrices(q), axis1=1, axis2=2))),
        )


@dataclass(frozen=True, eq=False)
class _Inside:
    """R moments inside the long segments of a motion, with their weights in an integral over time.

    `Trajectory.v` is the mean of the velocities beside a sample, and 0 at the ends. If samples are no
    further apart than `SAMPLE_PERIOD`, the trapezoidal rule has small errors with it; on a hand-written
    motion it would leave out half of the first and of the last segment. So a longer segment
    counts with its own velocity, and each corner, rounded off within `SAMPLE_PERIOD`, with the torques
    that change that velocity: potential and kinetic energy add up. Up to twice the period, the two rules blend.

    Attributes
    ----------
    time: (R,) [s]; q, v, a: (R, n); weight: (R,) [s], those of one segment add up to its duration.
    segment: (R,) index of the segment, ascending.
    """

    time: Array
    q: Array
    v: Array
    a: Array
    weight: Array
    segment: NDArray[np.int64]

    @classmethod
    def of(cls, motion: Trajectory) -> _Inside:
        steps, n = np.diff(motion.time), motion.q.shape[1]
        long = np.flatnonzero(steps > SAMPLE_PERIOD * (1.0 + 1e-6))
        half = 0.5 * np.minimum(steps, SAMPLE_PERIOD)  # how much of each segment beside it a corner uses
        if not len(long):
            none = np.zeros((0, n))
            return cls(np.zeros(0), none, none, none, np.zeros(0), long)
        velocity = motion.segment_velocities()
        widths = np.append(half, half[-1]) + np.insert(half, 0, half[0])
        change = motion.velocity_changes() / widths[:, None]
        turned = np.abs(np.diff(motion.q, axis=0)).max(axis=1)
        coarser = max(1.0, float(np.sum(turned[long])) / (_PART * _MOST_PARTS))
        found = []
        for k in long.tolist():
            begin, end, v = motion.time[k], motion.time[k + 1], velocity[k]
            sharp = min(steps[k] / SAMPLE_PERIOD - 1.0, 1.0)
            beside = [at + sharp * (v - at) for at in motion.v[k : k + 2]]
            middle = [
                at if 0 < j < len(steps) else one
                for j, at, one in zip((k, k + 1), motion.v[k : k + 2], beside, strict=True)
            ]
            parts = max(int(np.ceil(turned[k] / (_PART * coarser))), 1)
            straight = np.linspace(begin + half[k], end - half[k], parts + 1)
            each = np.full(parts + 1, (steps[k] - 2.0 * half[k]) / parts)
            each[[0, -1]] *= 0.5
            corner = [0.5 * half[k]] * 2
            found.append((
                np.concatenate(([begin, begin + half[k]], straight, [end - half[k], end])),
                np.vstack((middle[0], beside[0], np.tile(v, (parts + 1, 1)), beside[1], middle[1])),
                np.vstack((np.tile(change[k], (2, 1)), np.zeros((parts + 1, n)), np.tile(change[k + 1], (2, 1)))),
                np.concatenate((corner, each, corner)),
                np.full(parts + 5, k),
            ))  # fmt: skip
        time, v, a, weight, segment = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return cls(time, motion.at(time), v, a, weight, segment)

    def integral(self, time: Array, at_samples: Array, inside: Array) -> Array:
        """(T,) the integral up to each `time` (T,) of a rate given `at_samples` (T,) and `inside` (R,)."""
        parts = 0.5 * np.diff(time) * (at_samples[1:] + at_samples[:-1])
        parts[self.segment] = 0.0
        np.add.at(parts, self.segment, self.weight * inside)
        return np.concatenate(([0.0], np.cumsum(parts)))


def trajectory_energy(problem: Problem, trajectory: Trajectory) -> MotionEnergy:
    """Torque, power and energy over the samples of a motion, with payload and soil.

    Between samples that are far apart, `work` and `hydraulic` also count what the samples alone do not show. Where
    two legs of a sequence meet, the sample is that of the later leg; potential energy counts from its beginning.
    """
    parts = leg_parts(problem, trajectory)
    found = [_whole_energy(part.problem, part.motion, _Inside.of(part.motion))[0] for part in parts]
    if len(found) == 1:
        return found[0]
    last = len(found) - 1
    rows: dict[str, Any] = {"time": trajectory.time}
    for field in fields(MotionEnergy)[1:]:
        values = [getattr(one, field.name) for one in found]
        if any(value is None for value in values):
            rows[field.name] = None
            continue
        if field.name in ("work", "hydraulic"):
            done = np.cumsum([0.0, *(value[-1] for value in values[:-1])])
            values = [value + before for value, before in zip(values, done, strict=True)]
        rows[field.name] = np.concatenate([v[: len(v) - (k < last)] for k, v in enumerate(values)])
    return MotionEnergy(**rows)


def _whole_energy(problem: Problem, motion: Trajectory, more: _Inside) -> tuple[MotionEnergy, MotionEnergy]:
    """The energy over the samples of a motion, and over the moments inside its long segments."""
    energy = _energy(problem, motion.time, motion.q, motion.v, motion.accelerations())
    inside = _energy(problem, more.time, more.q, more.v, more.a)
    work = more.integral(motion.time, energy.power, inside.power)
    hydraulic = None
    if energy.hydraulic_power is not None and inside.hydraulic_power is not None:
        hydraulic = more.integral(motion.time, energy.hydraulic_power, inside.hydraulic_power)
    return replace(energy, work=work, hydraulic=hydraulic), inside


def cost_rate(problem: Problem, q: Array, v: Array, a: Array) -> Array:
    """(K,) cost rate of moments with joints at q, v, a (K, n) by the problem's objective, in its unit per second."""
    return problem.objective.rate(v, _energy(problem, np.arange(len(q), dtype=float), q, v, a))


def motion_cost(problem: Problem, trajectory: Trajectory) -> float:
    """The cost of a motion by the problem's objective, in its unit."""
    if problem.objective.is_time:
        return trajectory.duration
    if problem.legs:
        return trajectory_costs(problem, trajectory)[problem.objective.name]
    return _costs(problem, trajectory, [problem.objective])[0]


def _costs(problem: Problem, motion: Trajectory, objectives: Sequence[Objective[Any]]) -> list[float]:
    """The cost of a motion by each of `objectives`: the integral of its rate, in its unit."""
    more = _Inside.of(motion)
    energy, inside = _whole_energy(problem, motion, more)
    return [
        float(more.integral(motion.time, one.rate(motion.v, energy), one.rate(more.v, inside))[-1])
        for one in objectives
    ]


def _energy(problem: Problem, time: Array, q: Array, v: Array, a: Array) -> MotionEnergy:
    robot, scene, soil = problem.robot, problem.scene, problem.scene.soil
    outside = None if soil is None else SoilReaction(robot, soil, problem.ground).torques(q, v)
    return motion_energy(
        robot, time, q=q, v=v, a=a, payload=scene.payload, payload_at=scene.payload_at, outside=outside
    )


def trajectory_costs(problem: Problem, trajectory: Trajectory) -> dict[str, float]:
    """The cost of a motion by each objective that suits the machine, by name, in its unit.

    It is computed by full inverse dynamics, with payload and soil.
    """
    found = {name: objective for name, objective in OBJECTIVES.items() if objective.suits(problem.robot)}
    costs = [_costs(part.problem, part.motion, list(found.values())) for part in leg_parts(problem, trajectory)]
    return dict(zip(found, np.sum(costs, axis=0).tolist(), strict=True))
