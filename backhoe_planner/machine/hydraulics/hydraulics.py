"""The hydraulics of a machine: cylinders between the joints, and the pump that drives them.

With l the pin-to-pin lengths of m cylinders and q the n joint positions,

    r = dl/dq,    l' = r v,    tau = r^T F,    F . l' = tau . v   (virtual work).

A cylinder extends with the oil on the piston (A_cap) and retracts with the oil on the
piston less the rod (A_ann), so that every limit of speed and force has two sides.
A pushing force and a growing length are positive.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, as_rows
from backhoe_planner.errors import InputError
from backhoe_planner.machine.hydraulics.linkage import Linkage, Triangle
from backhoe_planner.machine.hydraulics.linkage_arms import linkage_arm_slopes, linkage_arms, linkage_constants
from backhoe_planner.machine.hydraulics.rods import (
    oil_taken,
    rod_flow_slopes,
    rod_forces,
    rod_limit_slopes,
    rod_limits,
    sum_by_joint,
)

_REMEMBERED = 12  # latest results at some q that are kept; chosen: about eight are in use at a time
_AT_REST = 1e-9  # rad/s or m/s: a slower joint is at rest but for rounding; chosen, far above that of any curve
SAME_LENGTH = 1e-7  # m: an angle whose length is further off belongs to another branch; chosen, far above rounding
_BESIDE = SAME_LENGTH  # rad, at a lever of 1 m: this far beyond the end of the stroke still counts as the end

_Found = TypeVar("_Found")


@dataclass(frozen=True)
class BothWays:
    """A limit with two sides, both as magnitudes, of the same shape.

    Attributes
    ----------
    positive: for a joint that turns or is driven in its positive direction; for a cylinder that extends.
    negative: for a joint in the negative direction; for a cylinder that retracts.
    """

    positive: Array
    negative: Array


@dataclass(frozen=True)
class Cylinder:
    """A double-acting cylinder, and the linkage by which it moves its joint.

    Attributes
    ----------
    name: unique.
    joint: the joint that it moves.
    bore, rod: diameters [m].
    closed, open: shortest and longest pin-to-pin length [m].
    linkage: length and moment arm over the joint's angle.
    flow: the greatest flow through its valve [m^3/s].
    """

    name: str
    joint: str
    bore: float
    rod: float
    closed: float
    open: float
    linkage: Linkage
    flow: float

    @property
    def stroke(self) -> float:
        """[m]"""
        return self.open - self.closed

    @property
    def cap_area(self) -> float:
        """Area of the piston, on which oil presses to extend [m^2]."""
        return 0.25 * math.pi * self.bore**2

    @property
    def annulus_area(self) -> float:
        """Area of the piston less the rod, on which oil presses to retract [m^2]."""
        return 0.25 * math.pi * (self.bore**2 - self.rod**2)


@dataclass(frozen=True, eq=False, repr=False)
class Hydraulics:
    """The cylinders of a machine; every method is vectorised over (..., n) arrays of q.

    A joint that no cylinder moves has a moment arm of 0, no lengths, and no hydraulic
    limit: its entries are infinite in limits, and nan in `joints`.

    Attributes
    ----------
    file: the description from which it was read.
    joint_names: the n joints.
    joint_ranges: (m, 2) the range of each cylinder's joint that its strokes allow [rad].
    cylinders: the m cylinders.
    pump_flow: the greatest flow of the pump [m^3/s].
    pressure: the pressure at which relief valves open [Pa].
    engine_power: [W]; efficiency: the part of it that reaches the oil, 0 to 1.
    """

    file: Path
    joint_names: tuple[str, ...]
    joint_ranges: Array
    cylinders: tuple[Cylinder, ...]
    pump_flow: float
    pressure: float
    engine_power: float
    efficiency: float

    def __repr__(self) -> str:
        return f"Hydraulics({', '.join(self.cylinder_names)})"

    @property
    def cylinder_names(self) -> tuple[str, ...]:
        """The m names."""
        return tuple(cylinder.name for cylinder in self.cylinders)

    @cached_property
    def joint_of(self) -> NDArray[np.int64]:
        """(m,) index of the joint that each cylinder moves."""
        return np.array([self.joint_names.index(cylinder.joint) for cylinder in self.cylinders], dtype=np.int64)

    @cached_property
    def force_limits(self) -> BothWays:
        """(m,) push (positive) and pull (negative) at relief pressure [N]."""
        return BothWays(self.pressure * self._cap, self.pressure * self._annulus)

    @property
    def areas(self) -> tuple[Array, Array]:
        """(m,) each: on which the oil acts as a cylinder extends, and as it retracts [m^2]."""
        return self._cap, self._annulus

    @property
    def power_limit(self) -> float:
        """Power that the engine can give to the oil [W]."""
        return self.efficiency * self.engine_power

    @cached_property
    def _cap(self) -> Array:
        return np.array([cylinder.cap_area for cylinder in self.cylinders])

    @cached_property
    def _annulus(self) -> Array:
        return np.array([cylinder.annulus_area for cylinder in self.cylinders])

    @cached_property
    def _valve_flow(self) -> Array:
        return np.array([cylinder.flow for cylinder in self.cylinders])

    @cached_property
    def has_cylinder(self) -> Flags:
        """(n,) which joints a cylinder moves."""
        return np.isin(np.arange(len(self.joint_names)), self.joint_of)

    # --- geometry ---------------------------------------------------------------

    def lengths(self, q: Array) -> Array:
        """(..., m) pin-to-pin lengths [m] at q (..., n)."""
        return self._of_linkages(lambda linkage, angle: linkage.length(angle), q)

    def moment_arms(self, q: Array) -> Array:
        """(..., m, n) r = dl/dq [m/rad] at q (..., n)."""
        arms = self.arms(q)
        matrix = np.zeros((*arms.shape, len(self.joint_names)))
        matrix[..., np.arange(len(self.cylinders)), self.joint_of] = arms
        return matrix

    def arms(self, q: Array) -> Array:
        """(..., m) dl/dq of each cylinder along its own joint [m/rad], at q (..., n); read-only."""
        return self._remembered("arms", lambda q: self._of_arms(linkage_arms, q), q)

    def arm_slopes(self, q: Array) -> Array:
        """(..., m) dr/dq of each cylinder's moment arm along its own joint [m/rad^2], at q (..., n)."""
        return self._remembered("slopes", lambda q: self._of_arms(linkage_arm_slopes, q), q)

    def joints(self, lengths: Array) -> Array:
        """(..., n) the joint positions [rad] with these `lengths` (..., m) [m]; the inverse of the method `lengths`.

        Positions are within `joint_range`. They are nan if the cylinders of one joint do not
        agree, or if no position in the joint's range has this length.
        """
        lengths = as_rows(lengths, len(self.cylinders), key="lengths")
        q = np.full((*lengths.shape[:-1], len(self.joint_names)), np.nan)
        for joint in np.flatnonzero(self.has_cylinder):
            mine = np.flatnonzero(self.joint_of == joint)
            own = lengths[..., mine]
            found = np.concatenate([self.cylinders[i].linkage.angles(own[..., k]) for k, i in enumerate(mine)])
            lower, upper = self.joint_ranges[mine[0]]
            found = found + 2.0 * np.pi * np.round((0.5 * (lower + upper) - found) / (2.0 * np.pi))
            off = sum(np.abs(self.cylinders[i].linkage.length(found) - own[..., k]) for k, i in enumerate(mine))
            outside = np.maximum(lower - found, found - upper) > _BESIDE
            off = np.where(np.isnan(off) | outside | (off > SAME_LENGTH), np.inf, off)
            best = np.argmin(off, axis=0, keepdims=True)
            value = np.take_along_axis(found, best, axis=0)[0]
            q[..., joint] = np.where(np.isinf(np.take_along_axis(off, best, axis=0)[0]), np.nan, value)
        return q

    def joint_range(self, joint: str) -> tuple[float, float]:
        """Lowest and highest position of a joint that its cylinders' strokes allow [rad].

        Raises
        ------
        InputError: no cylinder moves this joint.
        """
        for cylinder, (lower, upper) in zip(self.cylinders, self.joint_ranges, strict=True):
            if cylinder.joint == joint:
                return float(lower), float(upper)
        names = dict.fromkeys(cylinder.joint for cylinder in self.cylinders)
        raise InputError.unknown_name("no cylinder moves this joint", joint, names=names, key="joint")

    # --- speed and flow ---------------------------------------------------------

    def rod_speeds(self, q: Array, v: Array) -> Array:
        """(..., m) l' = r v [m/s], extending positive, at q, v (..., n)."""
        arms = self.arms(q)
        return np.asarray(arms * as_rows(v, len(self.joint_names), key="v", beside=arms)[..., self.joint_of])

    def flows(self, q: Array, v: Array) -> Array:
        """(..., m) oil that the pump feeds into each cylinder [m^3/s], 0 or more, at q, v (..., n)."""
        speed = self.rod_speeds(q, v)
        return np.asarray(np.abs(speed) * np.where(speed > 0.0, self._cap, self._annulus))

    def total_flow(self, q: Array, v: Array) -> Array:
        """(...) oil that the pump feeds [m^3/s] at q, v (..., n); to be kept within `pump_flow`."""
        return np.asarray(np.sum(self.flows(q, v), axis=-1))

    def velocity_limits(self, q: Array) -> BothWays:
        """(..., n) the greatest speed of each joint either way [rad/s], with the others at rest, at q (..., n).

        It is limited by the valves of the joint's cylinders and by the pump that these share. It is infinite
        if no cylinder moves the joint or all of them are at a dead centre.
        """
        return self._limits(q)[1]

    def velocity_limit_slopes(self, q: Array) -> BothWays:
        """(..., n) the derivatives of `velocity_limits` by each joint's own position, at q (..., n) [1/s].

        They are 0 where there is no limit.
        """
        return self._limit_slopes(q)[1]

    def flow_slopes(self, q: Array, v: Array) -> tuple[Array, Array]:
        """(..., n) each: the derivatives of `total_flow` by q [m^3/s/rad] and by v [m^3/rad], at q, v (..., n).

        At rest they are those for a positive velocity.
        """
        arms, v = self.arms(q), as_rows(v, len(self.joint_names), key="v")
        shape = np.broadcast_shapes(arms.shape[:-1], v.shape[:-1])
        slopes, areas = self.arm_slopes(q), (self._cap, self._annulus)
        by_q, by_v = rod_flow_slopes(_rows(arms, shape), _rows(slopes, shape), self.joint_of, *areas, _rows(v, shape))
        return by_q.reshape(*shape, len(self.joint_names)), by_v.reshape(*shape, len(self.joint_names))

    # --- force and pressure -----------------------------------------------------

    def joint_torques(self, q: Array, force: Array) -> Array:
        """(..., n) tau = r^T F [N m] at q (..., n) for the cylinders' force F (..., m) [N], push positive."""
        arms = self.arms(q)
        return self._by_joint(arms * as_rows(force, len(self.cylinders), key="force", beside=arms))

    def cylinder_forces(self, q: Array, tau: Array) -> Array:
        """(..., m) the forces F [N] that give the torques tau (..., n) [N m], push positive.

        If several cylinders move one joint, these are the forces of least norm: F = r tau / (r . r).
        A torque on a joint without a cylinder is ignored.
        """
        arms = self.arms(q)
        tau = as_rows(tau, len(self.joint_names), key="tau", beside=arms)
        shape = np.broadcast_shapes(arms.shape[:-1], tau.shape[:-1])
        return rod_forces(_rows(arms, shape), self.joint_of, _rows(tau, shape)).reshape(*shape, arms.shape[-1])

    def pressures(self, q: Array, tau: Array) -> Array:
        """(..., m) pressure [Pa] in the chamber that bears the torques tau (..., n) [N m] at q (..., n).

        The other chamber is at tank pressure, 0.
        """
        force = self.cylinder_forces(q, tau)
        return np.asarray(np.abs(force) / np.where(force > 0.0, self._cap, self._annulus))

    def torque_limits(self, q: Array) -> BothWays:
        """(..., n) the greatest joint torque either way at relief pressure [N m], at q (..., n).

        All cylinders of a joint act together, each pushing or pulling according to its lever.
        The limit is infinite if no cylinder moves the joint.
        """
        return self._limits(q)[0]

    def torque_limit_slopes(self, q: Array) -> BothWays:
        """(..., n) the derivatives of `torque_limits` by each joint's own position, at q (..., n) [N m/rad].

        They are 0 where there is no limit.
        """
        return self._limit_slopes(q)[0]

    # --- power ------------------------------------------------------------------

    def power(self, q: Array, v: Array, tau: Array) -> Array:
        """(...) power that the oil must deliver: the sum of p A |l'| [W]; a load that drives its cylinder counts as 0.

        It is for q, v (..., n) with the torques tau (..., n) [N m], and must stay within `power_limit`.
        """
        return self._oil(q, v, tau)[1]

    def load_sensing_power(self, q: Array, v: Array, tau: Array) -> Array:
        """(...) power of a load-sensing pump: the highest pressure that is needed, times the whole flow [W].

        It is for q, v (..., n) with the torques tau (..., n) [N m]. The flow to the lighter loads is
        throttled down from that pressure, so the result is never less than `power`.
        """
        flow, _, highest = self._oil(q, v, tau)
        return np.asarray(highest * flow)

    def _oil(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array, Array]:
        """(...) each: see `oil_taken`."""
        arms = self.arms(q)
        v, tau = (as_rows(each, len(self.joint_names), key=key, beside=arms) for each, key in ((v, "v"), (tau, "tau")))
        v = np.where(np.abs(v) > _AT_REST, v, 0.0)
        shape = np.broadcast_shapes(arms.shape[:-1], v.shape[:-1], tau.shape[:-1])
        rows = [_rows(each, shape) for each in (arms, v, tau)]
        found = oil_taken(rows[0], self.joint_of, self._cap, self._annulus, *rows[1:])
        flow, power, highest = (each.reshape(shape) for each in found)
        return flow, power, highest

    def _limits(self, q: Array) -> tuple[BothWays, BothWays]:
        """(..., n) the greatest torques and speeds of the joints, read-only."""
        return self._remembered("limits", lambda q: self._both_ways(rod_limits, self.arms(q)), q)

    def _limit_slopes(self, q: Array) -> tuple[BothWays, BothWays]:
        """(..., n) the derivatives of `_limits` by each joint's own position, read-only."""
        return self._remembered(
            "limit slopes", lambda q: self._both_ways(rod_limit_slopes, self.arms(q), self.arm_slopes(q)), q
        )

    def _both_ways(self, compute: Callable[..., tuple[Array, ...]], *of_arms: Array) -> tuple[BothWays, BothWays]:
        shape = of_arms[0].shape[:-1]
        found = compute(
            *(_rows(each, shape) for each in of_arms), self.joint_of, self._cap, self._annulus, self._valve_flow,
            self.pressure, self.pump_flow, len(self.joint_names),
        )  # fmt: skip
        for each in found:
            each.setflags(write=False)
        torque, back_torque, speed, back_speed = (each.reshape(*shape, len(self.joint_names)) for each in found)
        return BothWays(torque, back_torque), BothWays(speed, back_speed)

    def _of_arms(self, compute: Callable[[Matrix, Indices, Matrix], Matrix], q: Array) -> Array:
        """(..., m) the result of `compute` for the cylinders' linkages, at q (..., n); read-only."""
        rows = compute(q.reshape(-1, q.shape[-1]), self.joint_of, self._linkage_constants)
        rows.setflags(write=False)
        return rows.reshape(*q.shape[:-1], rows.shape[1])

    @cached_property
    def _linkage_constants(self) -> Matrix:
        return linkage_constants([cylinder.linkage for cylinder in self.cylinders])

    def _remembered(self, what: str, compute: Callable[[Array], _Found], q: Array) -> _Found:
        """The result of `compute` at q (..., n), or that of an earlier call at the same q."""
        # speed, flow, force and power are computed one after another at the same q
        q = as_rows(q, len(self.joint_names), key="q")
        key = (what, q.shape, q.tobytes())
        found: _Found | None = self._known.get(key)
        if found is None:
            found = compute(q)
            if len(self._known) >= _REMEMBERED:
                self._known.clear()
            self._known[key] = found
        return found

    @cached_property
    def _known(self) -> dict[tuple[str, tuple[int, ...], bytes], Any]:
        """The latest results of `_remembered`, by what they are, and by shape and content of q."""
        return {}

    @cached_property
    def _together(self) -> tuple[tuple[Linkage, int | list[int], int | list[int]], ...]:
        """Linkages that are computed at once: with their columns, and the joints that they move."""
        each = [(cylinder.linkage, column) for column, cylinder in enumerate(self.cylinders)]
        triangles = [(linkage, column) for linkage, column in each if isinstance(linkage, Triangle)]
        joint_of = self.joint_of.tolist()
        found: list[tuple[Linkage, int | list[int], int | list[int]]] = [
            (linkage, column, joint_of[column]) for linkage, column in each if not isinstance(linkage, Triangle)
        ]
        if triangles:
            columns = [column for _, column in triangles]
            found.append((Triangle.all_of([one for one, _ in triangles]), columns, [joint_of[k] for k in columns]))
        return tuple(found)

    def _of_linkages(self, compute: Callable[[Linkage, Array], Array], q: Array) -> Array:
        """(..., m) the result of `compute` for each cylinder's linkage and its joint's angle, at q (..., n)."""
        q = as_rows(q, len(self.joint_names), key="q")
        found = np.empty((*q.shape[:-1], len(self.cylinders)))
        for linkage, columns, joints in self._together:
            found[..., columns] = compute(linkage, q[..., joints])
        return found

    def _by_joint(self, values: Array) -> Array:
        """(..., n) sums of (..., m) over the cylinders of each joint."""
        total = sum_by_joint(values.reshape(-1, values.shape[-1]), self.joint_of, len(self.joint_names))
        return total.reshape(*values.shape[:-1], len(self.joint_names))


def _rows(values: Array, shape: tuple[int, ...]) -> Array:
    """(K, m) the rows of values (..., m), broadcast to the leading axes `shape`."""
    if values.shape[:-1] != shape:
        values = np.broadcast_to(values, (*shape, values.shape[-1]))
    return values.reshape(-1, values.shape[-1])
