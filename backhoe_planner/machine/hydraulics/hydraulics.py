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

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags, as_rows
from backhoe_planner.errors import InputError
from backhoe_planner.machine.hydraulics.linkage import Linkage

_REMEMBERED = 8  # latest arrays of moment arms and of their slopes that are kept; chosen: five are in use at a time
SAME_LENGTH = 1e-7  # m: an angle whose length is further off belongs to another branch; chosen, far above rounding
_BESIDE = SAME_LENGTH  # rad, at a lever of 1 m: this far beyond the end of the stroke still counts as the end


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
        arms = self._arms(q)
        matrix = np.zeros((*arms.shape, len(self.joint_names)))
        matrix[..., np.arange(len(self.cylinders)), self.joint_of] = arms
        return matrix

    def arm_slopes(self, q: Array) -> Array:
        """(..., m) dr/dq of each cylinder's moment arm along its own joint [m/rad^2], at q (..., n)."""
        return self._remembered("slopes", lambda linkage, angle: linkage.arm_slope(angle), q)

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
        arms = self._arms(q)
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
        arms = self._arms(q)
        sides = []
        for sign in (1.0, -1.0):
            area = np.where(sign * arms > 0.0, self._cap, self._annulus)
            swept = area * np.abs(arms)  # m^3/rad
            share = self._by_joint(swept)
            with np.errstate(divide="ignore"):
                limit = np.where(share > 0.0, self.pump_flow / share, np.inf)
                for i, joint in enumerate(self.joint_of):
                    own = np.where(swept[..., i] > 0.0, self._valve_flow[i] / swept[..., i], np.inf)
                    limit[..., joint] = np.minimum(limit[..., joint], own)
            sides.append(limit)
        return BothWays(*sides)

    def velocity_limit_slopes(self, q: Array) -> BothWays:
        """(..., n) the derivatives of `velocity_limits` by each joint's own position, at q (..., n) [1/s].

        They are 0 where there is no limit.
        """
        arms, arm_slopes, limits = self._arms(q), self.arm_slopes(q), self.velocity_limits(q)
        sides = []
        for sign, limit in ((1.0, limits.positive), (-1.0, limits.negative)):
            area = np.where(sign * arms > 0.0, self._cap, self._annulus)
            swept, swept_slopes = area * np.abs(arms), area * np.sign(arms) * arm_slopes
            of_inverse = self._by_joint(swept_slopes) / self.pump_flow
            with np.errstate(divide="ignore", invalid="ignore"):
                for i, joint in enumerate(self.joint_of):
                    by_valve = self._valve_flow[i] / swept[..., i] == limit[..., joint]
                    of_valve = swept_slopes[..., i] / self._valve_flow[i]
                    of_inverse[..., joint] = np.where(by_valve, of_valve, of_inverse[..., joint])
                sides.append(np.where(np.isfinite(limit), -(limit**2) * of_inverse, 0.0))
        return BothWays(*sides)

    def flow_slopes(self, q: Array, v: Array) -> tuple[Array, Array]:
        """(..., n) each: the derivatives of `total_flow` by q [m^3/s/rad] and by v [m^3/rad], at q, v (..., n).

        At rest they are those for a positive velocity.
        """
        arms, own = self._arms(q), as_rows(v, len(self.joint_names), key="v")[..., self.joint_of]
        way = np.where(own < 0.0, -1.0, 1.0)
        area = np.where(way * arms > 0.0, self._cap, self._annulus)
        by_q = self._by_joint(np.abs(own) * area * np.sign(arms) * self.arm_slopes(q))
        return by_q, self._by_joint(way * area * np.abs(arms))

    # --- force and pressure -----------------------------------------------------

    def joint_torques(self, q: Array, force: Array) -> Array:
        """(..., n) tau = r^T F [N m] at q (..., n) for the cylinders' force F (..., m) [N], push positive."""
        arms = self._arms(q)
        return self._by_joint(arms * as_rows(force, len(self.cylinders), key="force", beside=arms))

    def cylinder_forces(self, q: Array, tau: Array) -> Array:
        """(..., m) the forces F [N] that give the torques tau (..., n) [N m], push positive.

        If several cylinders move one joint, these are the forces of least norm: F = r tau / (r . r).
        A torque on a joint without a cylinder is ignored.
        """
        arms = self._arms(q)
        tau = as_rows(tau, len(self.joint_names), key="tau", beside=arms)
        share = self._by_joint(arms * arms)[..., self.joint_of]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(arms * tau[..., self.joint_of] / share)

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
        arms = self._arms(q)
        push, pull = self.force_limits.positive, self.force_limits.negative
        sides = []
        for sign in (1.0, -1.0):
            limit = self._by_joint(np.abs(arms) * np.where(sign * arms > 0.0, push, pull))
            sides.append(np.where(self.has_cylinder, limit, np.inf))
        return BothWays(*sides)

    def torque_limit_slopes(self, q: Array) -> BothWays:
        """(..., n) the derivatives of `torque_limits` by each joint's own position, at q (..., n) [N m/rad].

        They are 0 where there is no limit.
        """
        arms, arm_slopes = self._arms(q), self.arm_slopes(q)
        push, pull = self.force_limits.positive, self.force_limits.negative
        sides = [
            self._by_joint(np.sign(arms) * arm_slopes * np.where(sign * arms > 0.0, push, pull)) for sign in (1.0, -1.0)
        ]
        return BothWays(*sides)

    # --- power ------------------------------------------------------------------

    def power(self, q: Array, v: Array, tau: Array) -> Array:
        """(...) power that the oil must deliver: the sum of p A |l'| [W]; a load that drives its cylinder counts as 0.

        It is for q, v (..., n) with the torques tau (..., n) [N m], and must stay within `power_limit`.
        """
        return np.asarray(np.sum(self._driving_pressures(q, v, tau) * self.flows(q, v), axis=-1))

    def load_sensing_power(self, q: Array, v: Array, tau: Array) -> Array:
        """(...) power of a load-sensing pump: the highest pressure that is needed, times the whole flow [W].

        It is for q, v (..., n) with the torques tau (..., n) [N m]. The flow to the lighter loads is
        throttled down from that pressure, so the result is never less than `power`.
        """
        highest = np.max(self._driving_pressures(q, v, tau), axis=-1, initial=0.0)
        return np.asarray(highest * self.total_flow(q, v))

    def _driving_pressures(self, q: Array, v: Array, tau: Array) -> Array:
        """(..., m) pressures of the cylinders that move against their load, 0 for the others [Pa]."""
        against = self.cylinder_forces(q, tau) * self.rod_speeds(q, v) > 0.0
        return np.where(against, self.pressures(q, tau), 0.0)

    def _arms(self, q: Array) -> Array:
        """(..., m) dl/dq of each cylinder along its own joint [m/rad]."""
        return self._remembered("arms", lambda linkage, angle: linkage.arm(angle), q)

    def _remembered(self, what: str, compute: Callable[[Linkage, Array], Array], q: Array) -> Array:
        """(..., m) the result of `_of_linkages`, which cannot be written to."""
        # speed, flow, force and power are computed one after another at the same q
        q = as_rows(q, len(self.joint_names), key="q")
        key = (what, q.shape, q.tobytes())
        found = self._known.get(key)
        if found is None:
            found = self._of_linkages(compute, q)
            found.setflags(write=False)
            if len(self._known) >= _REMEMBERED:
                self._known.clear()
            self._known[key] = found
        return found

    @cached_property
    def _known(self) -> dict[tuple[str, tuple[int, ...], bytes], Array]:
        """The latest results of `_remembered`, by what they are, and by shape and content of q."""
        return {}

    def _of_linkages(self, compute: Callable[[Linkage, Array], Array], q: Array) -> Array:
        """(..., m) the result of `compute` for each cylinder's linkage and its joint's angle, at q (..., n)."""
        q = as_rows(q, len(self.joint_names), key="q")
        found = np.empty((*q.shape[:-1], len(self.cylinders)))
        for column, (cylinder, joint) in enumerate(zip(self.cylinders, self.joint_of, strict=True)):
            found[..., column] = compute(cylinder.linkage, q[..., joint])
        return found

    def _by_joint(self, values: Array) -> Array:
        """(..., n) sums of (..., m) over the cylinders of each joint."""
        total = np.zeros((*values.shape[:-1], len(self.joint_names)))
        for i, joint in enumerate(self.joint_of):
            total[..., joint] += values[..., i]
        return total
