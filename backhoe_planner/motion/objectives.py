"""What a motion along a bucket path costs, step by step, by the names of the objectives.

For a step from joints q_a to q_b over the arc length h the tip is taken to move at an
even speed u, slower only where a joint or a rod cannot follow:

    dt = max(h / u, |dq_j| / v_j)        dq = q_b - q_a

u is the scene's speed, or where it gives none a nominal one. With tau the torques that
hold the machine still against gravity, payload and soil, the mean of both ends,

    velocity_norm   |dq|^2 / dt                       integral of v . v
    kinetic         dq^T M dq / (2 dt)                integral of the kinetic energy
    effort          |tau|^2 dt                        integral of tau . tau
    work            sum_i max(tau_i dq_i, 0)          integral of the power that joints put in
    hydraulic       max_c p_c sum_c A_c |dl_c|        a load-sensing pump: highest pressure times flow
    time            dt                                with the flow of valves and pump too

The sums are the trapezoidal rule for what `motion_costs` reports of a finished plan, but
for one thing: torques of inertia are left out, for they hang on three neighbouring
samples and on how the motion gathers speed. `work` and `hydraulic` do not depend on u.

All costs come in one unit, that of the turning of a joint [rad], so that they can be
weighed against the turning of the joints on a detour.

What the search makes small holds the joints back in more ways, none of which is in what is
told of a motion. Objectives that do not hold every motion back by themselves (where loads
drive the joints, work is 0 whatever they do) get

    a small part of |dq|^2 / dt,
    the time that is lost, at a part of the typical load times the typical rate: where a
    joint cannot follow u, and where rates change, max_j |v_j' - v_j| / a_j from step to step,
    of `hydraulic`, the margin by which a load-sensing pump's pressure is above the highest
    load, on all of the oil.

Without the last two `hydraulic` has the joints go to and fro. Its pressure is that of the
rods that move, so that two rods one after the other cost less than both at once, and the
search does not see what the changes between them cost. `time` is the time that is lost and
nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError
from backhoe_planner.machine import BatchKinematics, Dynamics, MotionEnergy, motion_costs, motion_energy
from backhoe_planner.motion.problem import Problem
from backhoe_planner.motion.trajectory import Trajectory
from backhoe_planner.site import SoilReaction

__all__ = ["OBJECTIVES", "UNITS", "Nodes", "Objective", "trajectory_costs", "trajectory_energy"]

Array = NDArray[np.float64]

OBJECTIVES = ("velocity_norm", "kinetic", "effort", "work", "hydraulic", "time")
UNITS = {
    "velocity_norm": "rad^2/s", "kinetic": "J s", "effort": "N^2 m^2 s", "work": "J", "hydraulic": "J", "time": "s",
}  # fmt: skip

WIDEST_STEP = 0.7  # rad or m that one joint may move in a step
_SMOOTHING = 3e-3  # part of |dq|^2 / (v dt) that is added
# of the typical load at the typical rate: what a second costs that is lost
_TIME_SHARE = {"effort": 0.1, "work": 0.1, "hydraulic": 1.0, "time": 1.0}
_MARGIN_PRESSURE = 2e6  # Pa by which a load-sensing pump exceeds the highest load
_TYPICAL = 64  # seeded postures over which loads are averaged
_SHORTEST = 1e-9  # s


@dataclass(frozen=True, eq=False)
class Nodes:
    """Configurations and the loads on them, over any leading shape.

    Attributes
    ----------
    q: (..., n).
    before, after: (..., n) torques that hold the machine still, with the soil as it acts
        on the step that ends here and on the one that begins here [N m or N].
    M: (..., n, n) mass matrices, where the objective needs them.
    lengths: (..., m) of the cylinders [m]; forces_before, forces_after: (..., m) theirs [N].
    """

    q: Array
    before: Array
    after: Array
    M: Array | None = None
    lengths: Array | None = None
    forces_before: Array | None = None
    forces_after: Array | None = None

    def __getitem__(self, key: Any) -> Nodes:
        return self._each(lambda part: part[key])

    def shaped(self, *shape: int) -> Nodes:
        """The same with the first axis split into `shape`."""
        return self._each(lambda part: part.reshape(*shape, *part.shape[1:]))

    def _each(self, change: Callable[[Array], Array]) -> Nodes:
        rest = (self.M, self.lengths, self.forces_before, self.forces_after)
        return Nodes(
            change(self.q),
            change(self.before),
            change(self.after),
            *(None if part is None else change(part) for part in rest),
        )


class Objective:
    """One objective for one problem.

    Attributes
    ----------
    name: one of `OBJECTIVES`.
    speed: u, the tip's [m/s]; infinite for `time` where the scene gives none.
    unit: of the objective for 1 rad of cost, such as the J of work.

    Raises
    ------
    InputError: no such objective, or the machine lacks what it needs.
    """

    def __init__(self, problem: Problem, name: str | None = None) -> None:
        self.name = problem.scene.objective if name is None else name
        robot = problem.robot
        if self.name not in OBJECTIVES:
            raise InputError("no such objective", key="objective", found=self.name, allowed=", ".join(OBJECTIVES))
        if self.name == "hydraulic" and robot.hydraulics is None:
            raise InputError(
                "the machine has no hydraulic description: a file beside its URDF that ends in .hydraulics.yaml",
                key="objective",
                found=self.name,
                allowed=", ".join(name for name in OBJECTIVES if name != "hydraulic"),
            )
        self._problem = problem
        self._dynamics = Dynamics(robot, payload=problem.scene.payload)
        self._soil = None if problem.scene.soil is None else SoilReaction(robot, problem.scene.soil)
        self._kinematics = BatchKinematics(robot)
        self._hydraulics = robot.hydraulics
        self._velocity = np.where(np.isfinite(problem.limits.velocity), problem.limits.velocity, 1e6)
        acceleration = problem.limits.acceleration
        self._acceleration = np.where(np.isfinite(acceleration), acceleration, 1e6)
        task = problem.scene.task.path
        asked = None if task is None else task.speed
        nominal, rate, load, inertia = self._typical()
        self.speed = asked if asked is not None else (np.inf if self.name == "time" else nominal)
        self._rate = rate
        self.unit = {
            "velocity_norm": rate,
            "kinetic": 0.5 * inertia * rate,
            "effort": load * load / rate,
            "work": load,
            "hydraulic": load,
            "time": 1.0 / rate,
        }[self.name]
        quiet = self.name in ("velocity_norm", "kinetic")
        self._smoothing = 0.0 if quiet else _SMOOTHING
        self._time_price = 0.0 if quiet else rate * _TIME_SHARE[self.name]
        if not self.unit > 0.0:  # a machine without mass costs nothing, whatever it does
            self.unit, self._smoothing = 1.0, 1.0

    # --- what it costs ----------------------------------------------------------------

    def step_costs(self, a: Array, b: Array, span: float) -> Array:
        """(A, B) of the steps from each of a (A, n) to each of b (B, n) over `span` of the path [m], in rad.

        Infinite where a joint would move too far for one step.
        """
        if not len(a) or not len(b):
            return np.zeros((len(a), len(b)))
        velocity = None
        if self._soil is not None:  # the tip of all of a is at one place, and that of all of b
            tips = self._kinematics.at(np.vstack((a[:1], b[:1]))).tip_position
            velocity = self.tip_velocity(tips)
        before, after = self.nodes(a, after=velocity), self.nodes(b, before=velocity)
        cost = self.between(before[:, None], after[None, :], np.asarray(span))
        widest = np.zeros(cost.shape)
        for joint in range(a.shape[1]):
            np.maximum(widest, np.abs(b[None, :, joint] - a[:, None, joint]), out=widest)
        return np.where(widest > WIDEST_STEP, np.inf, cost)

    def along(self, stations: Array, q: Array) -> float:
        """Of a resolved stretch, q (K, n) at `stations` (K,) [m], in rad."""
        return self._sum(stations, q, smoothing=self._smoothing)

    def driven(self, stations: Array, q: Array) -> float:
        """The same, from rest to rest, and what the changes of the joints' rates take, which hang on three samples."""
        cost = self.along(stations, q)
        if len(q) < 3 or not self.holds_rates:
            return cost
        rates = self.rates(q[:-1], q[1:], np.diff(stations))
        rest = np.zeros((q.shape[1], 1))
        return cost + float(np.sum(self.turning(np.hstack((rest, rates)), np.hstack((rates, rest)))))

    @property
    def holds_rates(self) -> bool:
        """Whether changes of the joints' rates count."""
        return self._time_price > 0.0

    def value(self, stations: Array, q: Array) -> float:
        """The same in the objective's own unit, without what is added to keep the joints quiet."""
        return self.unit * self._sum(stations, q, smoothing=0.0)

    def _sum(self, stations: Array, q: Array, *, smoothing: float) -> float:
        if len(q) < 2:
            return 0.0
        before = after = None
        if self._soil is not None:
            velocity = self.tip_velocity(self._kinematics.at(q).tip_position)
            before, after = np.vstack((velocity[:1], velocity)), np.vstack((velocity, velocity[-1:]))
        nodes = self.nodes(q, before=before, after=after)
        return float(np.sum(self._between(nodes[:-1], nodes[1:], np.diff(stations), smoothing)))

    def nodes(self, q: Array, *, before: Array | None = None, after: Array | None = None) -> Nodes:
        """Configurations q (B, n) with their loads.

        Parameters
        ----------
        before, after: (B, 3) or (3,) velocity of the tip on the step that ends and on the
            one that begins there [m/s]; they matter in soil only.
        """
        if self.name in ("velocity_norm", "time"):
            nothing = np.zeros_like(q)
            lengths = None
            if self.name == "time" and self._hydraulics is not None:
                lengths = self._hydraulics.lengths(q)
            return Nodes(q, nothing, nothing, lengths=lengths)
        if self.name == "kinetic":
            nothing = np.zeros_like(q)
            return Nodes(q, nothing, nothing, M=self._dynamics.mass_matrices(q))
        held = self._dynamics.gravity_torques(q)
        tau_before, tau_after = (
            held if velocity is None or self._soil is None else held - self._soil.torques_at(q, velocity)
            for velocity in (before, after)
        )
        if self.name != "hydraulic" or self._hydraulics is None:
            return Nodes(q, tau_before, tau_after)
        forces_before, forces_after = (
            np.nan_to_num(self._hydraulics.cylinder_forces(q, own), posinf=0.0, neginf=0.0)  # at a dead centre
            for own in (tau_before, tau_after)
        )
        lengths = self._hydraulics.lengths(q)
        return Nodes(q, tau_before, tau_after, lengths=lengths, forces_before=forces_before, forces_after=forces_after)

    def between(self, a: Nodes, b: Nodes, span: Array) -> Array:
        """(...) of the steps from a to b over `span` (...) [m], all broadcast, in rad."""
        return self._between(a, b, span, self._smoothing)

    def _between(self, a: Nodes, b: Nodes, span: Array, smoothing: float) -> Array:
        n = a.q.shape[-1]
        shape = np.broadcast_shapes(a.q.shape[:-1], b.q.shape[:-1])
        dq = [b.q[..., j] - a.q[..., j] for j in range(n)]
        squared = np.zeros(shape)
        dt = np.zeros(shape) if np.isinf(self.speed) else np.broadcast_to(span / self.speed, shape).copy()
        for joint, change in enumerate(dq):
            squared += change * change
            np.maximum(dt, np.abs(change) / self._velocity[joint], out=dt)
        if self.name == "time" and self._hydraulics is not None:
            np.maximum(dt, self._oil_time(a, b), out=dt)
        dt = np.maximum(dt, _SHORTEST)
        if not smoothing > 0.0:
            return self._of_step(a, b, dq, squared, dt) / self.unit
        held = smoothing / self._rate * squared / dt + self._held_back(a, b, dt, span)
        if self.name == "time":  # of which only what is lost can be had
            return np.asarray(held)
        return self._of_step(a, b, dq, squared, dt) / self.unit + held

    def _held_back(self, a: Nodes, b: Nodes, dt: Array, span: Array) -> Array:
        """(...) of the margin pressure, and of the time that is lost, in rad."""
        lost = dt if np.isinf(self.speed) else np.maximum(dt - span / self.speed, 0.0)
        cost = self._time_price * lost
        if self.name == "hydraulic":
            cost = cost + (_MARGIN_PRESSURE / self.unit) * self._oil(a, b)
        return np.asarray(cost)

    def rates(self, a: Array, b: Array, span: Array) -> Array:
        """(n, ...) of the joints on the steps from a to b (..., n) over `span` (...) [m], in seconds of
        their acceleration limits: how long each takes to gather its rate.
        """
        dq = [b[..., joint] - a[..., joint] for joint in range(a.shape[-1])]
        dt = np.full(dq[0].shape, _SHORTEST)
        if np.isfinite(self.speed):
            np.maximum(dt, span / self.speed, out=dt)
        for joint, change in enumerate(dq):
            np.maximum(dt, np.abs(change) / self._velocity[joint], out=dt)
        return np.array([change / (dt * limit) for change, limit in zip(dq, self._acceleration, strict=True)])

    def turning(self, before: Array, after: Array) -> Array:
        """(...) the time that a change of `rates` (n, ...) from step to step takes, in rad."""
        longest = np.zeros(np.broadcast_shapes(before.shape[1:], after.shape[1:]))
        for one, other in zip(before, after, strict=True):
            change = other - one
            np.maximum(longest, np.abs(change, out=change), out=longest)
        longest *= self._time_price
        return longest

    def _of_step(self, a: Nodes, b: Nodes, dq: list[Array], squared: Array, dt: Array) -> Array:
        if self.name == "velocity_norm":
            return squared / dt
        if self.name == "time":
            return dt
        cost = np.zeros_like(dt)
        if self.name == "kinetic":
            assert a.M is not None
            assert b.M is not None
            for i, left in enumerate(dq):
                for j, right in enumerate(dq):
                    cost += (0.25 * (a.M[..., i, j] + b.M[..., i, j])) * left * right
            return cost / dt
        if self.name == "effort":
            ends = np.sum(a.after * a.after, axis=-1) + np.sum(b.before * b.before, axis=-1)
            return np.asarray(0.5 * ends * dt)
        if self.name == "work":
            for joint, change in enumerate(dq):
                cost += np.maximum((0.5 * (a.after[..., joint] + b.before[..., joint])) * change, 0.0)
            return cost
        return self._oil_energy(a, b, cost)

    def _oil_energy(self, a: Nodes, b: Nodes, highest: Array) -> Array:
        """(...) the highest pressure that any rod moves against, times the oil that all take [J]."""
        hydraulics = self._hydraulics
        assert hydraulics is not None
        assert a.lengths is not None
        assert b.lengths is not None
        assert a.forces_after is not None
        assert b.forces_before is not None
        for c, cylinder in enumerate(hydraulics.cylinders):
            change = b.lengths[..., c] - a.lengths[..., c]
            area = np.where(change > 0.0, cylinder.cap_area, cylinder.annulus_area)
            force = 0.5 * (a.forces_after[..., c] + b.forces_before[..., c])
            # against its load a rod pushes where it extends, and pulls where it retracts
            np.maximum(highest, np.where(force * change > 0.0, np.abs(force) / area, 0.0), out=highest)
        return np.asarray(highest * self._oil(a, b))

    def _oil(self, a: Nodes, b: Nodes) -> Array:
        """(...) that all cylinders take on a step [m^3]."""
        assert self._hydraulics is not None
        assert a.lengths is not None
        assert b.lengths is not None
        oil = np.zeros(1)
        for c, cylinder in enumerate(self._hydraulics.cylinders):
            change = b.lengths[..., c] - a.lengths[..., c]
            oil = oil + np.where(change > 0.0, cylinder.cap_area, cylinder.annulus_area) * np.abs(change)
        return oil

    def _oil_time(self, a: Nodes, b: Nodes) -> Array:
        """(...) how long valves and pump take to feed a step [s]."""
        hydraulics = self._hydraulics
        assert hydraulics is not None
        assert a.lengths is not None
        assert b.lengths is not None
        longest, oil = np.zeros(1), np.zeros(1)
        for c, cylinder in enumerate(hydraulics.cylinders):
            change = b.lengths[..., c] - a.lengths[..., c]
            own = np.abs(change) * np.where(change > 0.0, cylinder.cap_area, cylinder.annulus_area)
            longest, oil = np.maximum(longest, own / cylinder.flow), oil + own
        return np.asarray(np.maximum(longest, oil / hydraulics.pump_flow))

    # --- what is usual ---------------------------------------------------------------

    def _typical(self) -> tuple[float, float, float, float]:
        """A tip speed [m/s], a joint rate [rad/s], a torque [N m] and an inertia [kg m^2] of this machine."""
        robot = self._problem.robot
        rng = np.random.default_rng(0)
        q = np.array([robot.random_q(rng) for _ in range(_TYPICAL)])
        J = self._kinematics.at(q).position_jacobian()
        arm = np.sqrt(np.mean(np.sum(J * J, axis=1), axis=0))
        moving = arm > 1e-3 * float(np.max(arm, initial=0.0))
        speed = 0.5 * float(np.median((arm * self._velocity)[moving])) if moving.any() else 1.0
        reach = float(np.max(arm, initial=0.0)) or 1.0
        asked = None if self._problem.scene.task.path is None else self._problem.scene.task.path.speed
        rate = (asked if asked is not None else speed) / reach
        load = float(np.mean(np.linalg.norm(self._dynamics.gravity_torques(q), axis=1)))
        inertia = float(np.mean(np.trace(self._dynamics.mass_matrices(q), axis1=1, axis2=2)))
        return speed, rate, load, inertia

    def tip_velocity(self, tips: Array) -> Array:
        """(..., 3) between neighbours, at the speed u; still where the tip stands."""
        change = np.diff(tips, axis=0)
        length = np.linalg.norm(change, axis=-1, keepdims=True)
        speed = self.speed if np.isfinite(self.speed) else 1.0
        return np.asarray(speed * np.where(length > 1e-6, change / np.maximum(length, 1e-6), 0.0))


def trajectory_energy(problem: Problem, trajectory: Trajectory) -> MotionEnergy:
    """Torque, power and energy over the samples of a motion, with payload and soil."""
    return motion_energy(
        problem.robot, trajectory.time, q=trajectory.q, v=trajectory.v, a=trajectory.accelerations(),
        payload=problem.scene.payload, tip_force=_soil_on_tip(problem, trajectory),
    )  # fmt: skip


def _soil_on_tip(problem: Problem, trajectory: Trajectory) -> Array | None:
    """(T, 3) [N], world; None where the scene has no soil."""
    soil = problem.scene.soil
    return None if soil is None else SoilReaction(problem.robot, soil).force(trajectory.q, trajectory.v)


def trajectory_costs(problem: Problem, trajectory: Trajectory) -> dict[str, float]:
    """What a motion costs by each objective that the machine has, in `UNITS`.

    By full inverse dynamics, with the payload, and the soil where the scene has one.
    """
    costs = motion_costs(
        problem.robot, trajectory.time, trajectory.q, trajectory.v, trajectory.accelerations(),
        payload=problem.scene.payload, tip_force=_soil_on_tip(problem, trajectory),
    )  # fmt: skip
    return costs | {"time": trajectory.duration}
