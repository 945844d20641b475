"""The objectives that a plan can minimise: one class each, and the list of them all.

A new objective is a new class here, an entry in `OBJECTIVES`, and a name in the scene file's
schema (`ObjectiveName`), which is below this package and cannot look it up.

A step goes from joints q_a to q_b, dq = q_b - q_a, in the time dt. Torques tau and rod
forces are those that hold the machine still against gravity, payload and soil, the mean
of both ends. Torques of inertia are left out: they depend on three neighbouring samples
and on how the motion speeds up.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from backhoe_planner.arrays import Array
from backhoe_planner.errors import SceneError
from backhoe_planner.machine import Dynamics, Hydraulics, MotionEnergy, Robot
from backhoe_planner.site import SoilReaction

# (B, 3) or (3,) of the tip on the step that ends at a node and on the one that begins there [m/s], None if at rest
TipVelocities = tuple[Array | None, Array | None]
Parts = TypeVar("Parts", bound="Nodes")

_MARGIN_PRESSURE = 2e6  # Pa by which a load-sensing pump's pressure exceeds the highest load; 15 to 25 bar is usual


@dataclass(frozen=True)
class LoadedMachine:
    """A machine that holds its payload and moves its tip in the soil.

    Attributes
    ----------
    dynamics: including the payload.
    soil, hydraulics: None if there is none.
    """

    dynamics: Dynamics
    soil: SoilReaction | None
    hydraulics: Hydraulics | None

    def holding_torques(self, q: Array, tip: TipVelocities) -> tuple[Array, Array]:
        """(B, n), (B, n) torques that hold the machine at q (B, n) [N m or N], on the steps before and after."""
        held = self.dynamics.gravity_torques(q)
        before, after = (held if self.soil is None or v is None else held - self.soil.torques_at(q, v) for v in tip)
        return before, after

    def rods(self, a: _Rods, b: _Rods) -> Iterator[tuple[Array, Array]]:
        """For each cylinder on the steps from a to b, how far it moves [m], and the area that takes oil [m^2]."""
        for c, cylinder in enumerate(() if self.hydraulics is None else self.hydraulics.cylinders):
            change = b.lengths[..., c] - a.lengths[..., c]
            yield change, np.where(change > 0.0, cylinder.cap_area, cylinder.annulus_area)

    def oil(self, a: _Rods, b: _Rods) -> Array:
        """(...) oil that all cylinders take on the steps from a to b [m^3]."""
        return sum((area * np.abs(change) for change, area in self.rods(a, b)), np.zeros(1))


@dataclass(frozen=True)
class Usual:
    """Usual figures of one machine: means over seeded postures.

    Attributes
    ----------
    rate: of the joints [rad/s]; load: torque that holds the machine [N m]; inertia: trace of its mass matrix [kg m^2].
    """

    rate: float
    load: float
    inertia: float


@dataclass(frozen=True, eq=False)
class Nodes:
    """Configurations, and what an objective needs to know of each, in any leading shape.

    Attributes
    ----------
    q: (..., n).
    """

    q: Array

    def __getitem__(self: Parts, key: Any) -> Parts:
        return self._each(lambda part: part[key])

    def reshape(self: Parts, *shape: int) -> Parts:
        """The same with the first axis split into `shape`."""
        return self._each(lambda part: part.reshape(*shape, *part.shape[1:]))

    def _each(self: Parts, change: Callable[[Array], Array]) -> Parts:
        return type(self)(*(change(getattr(self, field.name)) for field in fields(self)))


@dataclass(frozen=True, eq=False)
class _Masses(Nodes):
    M: Array  # (..., n, n) mass matrices


@dataclass(frozen=True, eq=False)
class _Torques(Nodes):
    before: Array  # (..., n) hold the machine still [N m or N] against the soil on the step that ends here
    after: Array  # the same on the step that begins here


@dataclass(frozen=True, eq=False)
class _Rods(Nodes):
    lengths: Array  # (..., m) of the cylinders [m]


@dataclass(frozen=True, eq=False)
class _Forces(_Rods):
    before: Array  # (..., m) of the cylinders [N], as for torques
    after: Array


@dataclass(frozen=True, eq=False)
class Step(Generic[Parts]):
    """Steps from nodes to nodes.

    Attributes
    ----------
    a, b: the nodes.
    dq: n of (...) how far each joint moves [rad or m]; squared: (...) the sum of their squares.
    dt: (...) [s].
    """

    a: Parts
    b: Parts
    dq: list[Array]
    squared: Array
    dt: Array


class Objective(ABC, Generic[Parts]):
    """An objective defines the cost of a step and of a finished motion.

    Attributes
    ----------
    name, unit: of its value.
    needs_hydraulics: whether it is defined only for a machine with a hydraulic description.
    is_time: whether it is the duration itself.
    is_positive_power: whether its rate is the sum of the positive powers of the joints.
    is_squared_torque: whether its rate is the sum of the squared torques of the joints.
    lifts: whether lifting counts, so that its value is at least the gain of potential energy.
    is_quadratic: whether it grows with the squared rates, and so penalises every motion.
    jumps: whether its rate jumps when a rod begins to move, so that no small step shows how to lower it.
    time_share: if it is not quadratic, the price of a lost second, as a part of the
        usual load at the usual rate.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    needs_hydraulics: ClassVar[bool] = False
    is_time: ClassVar[bool] = False
    is_positive_power: ClassVar[bool] = False
    is_squared_torque: ClassVar[bool] = False
    lifts: ClassVar[bool] = False
    is_quadratic: ClassVar[bool] = False
    jumps: ClassVar[bool] = False
    time_share: ClassVar[float] = 0.1

    def suits(self, robot: Robot) -> bool:
        """Whether a machine has what the objective needs."""
        return not self.needs_hydraulics or robot.hydraulics is not None

    @abstractmethod
    def per_radian(self, usual: Usual) -> float:
        """The usual cost of turning a joint by 1 rad, in `unit`."""

    @abstractmethod
    def nodes(self, q: Array, machine: LoadedMachine, tip: TipVelocities) -> Parts:
        """Configurations q (B, n) with what `of_step` needs.

        Parameters
        ----------
        tip: its velocities before and after; they matter only in soil.
        """

    @abstractmethod
    def of_step(self, step: Step[Parts], machine: LoadedMachine) -> Array:
        """(...) the cost of each step, in `unit`."""

    @abstractmethod
    def rate(self, v: Array, energy: MotionEnergy) -> Array:
        """(T,) cost rate at each moment, in `unit` per second, by full inverse dynamics.

        A rate depends on its own moment alone: the moments may be any, also none, and are not a motion's samples in
        their order.

        Parameters
        ----------
        v: (T, n) velocities of the joints there [rad/s or m/s].
        energy: torques and powers there; its time, work and hydraulic energy say nothing here.
        """

    def duration(self, dt: Array, a: Parts, b: Parts, machine: LoadedMachine) -> Array:
        """(...) duration of the steps from a to b [s], given that tip and joints need `dt` (...) [s]."""
        return dt

    def overhead(self, step: Step[Parts], machine: LoadedMachine, per_radian: float) -> Array | float:
        """(...) the cost that the search adds so that joints do not go to and fro [rad]."""
        return 0.0


class VelocityNorm(Objective[Nodes]):
    """|dq|^2 / dt: the integral of v . v, what the pseudo-inverse minimises."""

    name, unit, is_quadratic = "velocity_norm", "rad^2/s", True

    def per_radian(self, usual: Usual) -> float:
        return usual.rate

    def nodes(self, q: Array, machine: LoadedMachine, tip: TipVelocities) -> Nodes:
        return Nodes(q)

    def of_step(self, step: Step[Nodes], machine: LoadedMachine) -> Array:
        return np.asarray(step.squared / step.dt)

    def rate(self, v: Array, energy: MotionEnergy) -> Array:
        return np.asarray(np.sum(v * v, axis=1))


class Kinetic(Objective[_Masses]):
    """dq^T M dq / (2 dt): the integral of the kinetic energy."""

    name, unit, is_quadratic = "kinetic", "J s", True

    def per_radian(self, usual: Usual) -> float:
        return 0.5 * usual.inertia * usual.rate

    def nodes(self, q: Array, machine: LoadedMachine, tip: TipVelocities) -> _Masses:
        return _Masses(q, machine.dynamics.mass_matrices(q))

    def of_step(self, step: Step[_Masses], machine: LoadedMachine) -> Array:
        cost = np.zeros_like(step.dt)
        for i, left in enumerate(step.dq):
            for j, right in enumerate(step.dq):
                cost += (0.25 * (step.a.M[..., i, j] + step.b.M[..., i, j])) * left * right
        return cost / step.dt

    def rate(self, v: Array, energy: MotionEnergy) -> Array:
        return np.asarray(energy.kinetic)


class _OfTorques(Objective[_Torques]):
    def nodes(self, q: Array, machine: LoadedMachine, tip: TipVelocities) -> _Torques:
        return _Torques(q, *machine.holding_torques(q, tip))


class Effort(_OfTorques):
    """|tau|^2 dt: the integral of tau . tau, to which the heat in electric motors is proportional."""

    name, unit, is_squared_torque = "effort", "N^2 m^2 s", True

    def per_radian(self, usual: Usual) -> float:
        return usual.load * usual.load / usual.rate

    def of_step(self, step: Step[_Torques], machine: LoadedMachine) -> Array:
        ends = np.sum(step.a.after * step.a.after, axis=-1) + np.sum(step.b.before * step.b.before, axis=-1)
        return np.asarray(0.5 * ends * step.dt)

    def rate(self, v: Array, energy: MotionEnergy) -> Array:
        return np.asarray(np.sum(energy.torque * energy.torque, axis=1))


class Work(_OfTorques):
    """sum_i max(tau_i dq_i, 0): the integral of the power that joints deliver; none is recovered."""

    name, unit, is_positive_power, lifts = "work", "J", True, True

    def per_radian(self, usual: Usual) -> float:
        return usual.load

    def of_step(self, step: Step[_Torques], machine: LoadedMachine) -> Array:
        cost = np.zeros_like(step.dt)
        for joint, change in enumerate(step.dq):
            cost += np.maximum((0.5 * (step.a.after[..., joint] + step.b.before[..., joint])) * change, 0.0)
        return cost

    def rate(self, v: Array, energy: MotionEnergy) -> Array:
        return np.asarray(energy.power)


class Hydraulic(Objective[_Forces]):
    """max_c p_c sum_c A_c |dl_c|: the work of a load-sensing pump, the highest pressure times all flow.

    Only rods that move count, so two rods cost less one after the other than both at once.
    Changing between them costs nothing here, so this objective alone would make the joints go
    to and fro. In the search, therefore, a lost second costs as much as the usual load, and all
    oil costs the margin by which the pump's pressure exceeds the highest load.
    """

    name, unit, needs_hydraulics, lifts, jumps, time_share = "hydraulic", "J", True, True, True, 1.0

    def per_radian(self, usual: Usual) -> float:
        return usual.load

    def nodes(self, q: Array, machine: LoadedMachine, tip: TipVelocities) -> _Forces:
        assert machine.hydraulics is not None
        own, other = (
            np.nan_to_num(machine.hydraulics.cylinder_forces(q, torques), posinf=0.0, neginf=0.0)  # at a dead centre
            for torques in machine.holding_torques(q, tip)
        )
        return _Forces(q, machine.hydraulics.lengths(q), own, other)

    def of_step(self, step: Step[_Forces], machine: LoadedMachine) -> Array:
        highest = np.zeros_like(step.dt)
        for c, (change, area) in enumerate(machine.rods(step.a, step.b)):
            force = 0.5 * (step.a.after[..., c] + step.b.before[..., c])
            # a rod works against its load if it pushes and extends, or pulls and retracts
            np.maximum(highest, np.where(force * change > 0.0, np.abs(force) / area, 0.0), out=highest)
        return np.asarray(highest * machine.oil(step.a, step.b))

    def overhead(self, step: Step[_Forces], machine: LoadedMachine, per_radian: float) -> Array:
        return np.asarray((_MARGIN_PRESSURE / per_radian) * machine.oil(step.a, step.b))

    def rate(self, v: Array, energy: MotionEnergy) -> Array:
        assert energy.hydraulic_power is not None
        return np.asarray(energy.hydraulic_power)


class Time(Objective[_Rods]):
    """dt, which valves and pump may prolong."""

    name, unit, is_time, time_share = "time", "s", True, 1.0

    def per_radian(self, usual: Usual) -> float:
        return 1.0 / usual.rate

    def nodes(self, q: Array, machine: LoadedMachine, tip: TipVelocities) -> _Rods:
        return _Rods(q, np.zeros((len(q), 0)) if machine.hydraulics is None else machine.hydraulics.lengths(q))

    def duration(self, dt: Array, a: _Rods, b: _Rods, machine: LoadedMachine) -> Array:
        if machine.hydraulics is None:
            return dt
        longest, oil = np.zeros(1), np.zeros(1)
        for cylinder, (change, area) in zip(machine.hydraulics.cylinders, machine.rods(a, b), strict=True):
            own = np.abs(change) * area
            longest, oil = np.maximum(longest, own / cylinder.flow), oil + own
        return np.maximum(dt, np.maximum(longest, oil / machine.hydraulics.pump_flow))

    def of_step(self, step: Step[_Rods], machine: LoadedMachine) -> Array:
        return step.dt

    def rate(self, v: Array, energy: MotionEnergy) -> Array:
        return np.ones(len(v))


OBJECTIVES: Mapping[str, Objective[Any]] = {
    objective.name: objective
    for objective in (VelocityNorm(), Kinetic(), Effort(), Work(), Hydraulic(), Time())
}  # fmt: skip


def find_objective(name: str, robot: Robot, *, file: Path | None = None) -> Objective[Any]:
    """The objective of the given name for a machine.

    Parameters
    ----------
    file: the scene file that names it, for the message.

    Raises
    ------
    SceneError: no such objective, or the machine lacks what it needs.
    """
    objective = OBJECTIVES.get(name)
    if objective is None:
        problem = "no such objective"
    elif not objective.suits(robot):
        problem = "the machine has no hydraulic description (a file beside its URDF, NAME.hydraulics.yaml)"
    else:
        return objective
    allowed = ", ".join(known for known, other in OBJECTIVES.items() if other.suits(robot))
    raise SceneError(problem, file=file, key="objective", found=name, allowed=allowed)
