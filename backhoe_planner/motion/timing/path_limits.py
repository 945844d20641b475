"""A machine's limits along a path q(s), as bounds on its speed and acceleration along it.

With v = q' s', a = q' s'' + q'' s'^2, u = s'' and x = s'^2 the torques are

    tau = (M q') u + (M q'' + C(q, q') q') x + g + lambda tau_soil,   0 <= lambda <= 1

where the soil's part lambda grows with the speed to 1. Limits on speed and flow bound x;
those on acceleration and torque are rows linear in (u, x). The engine's power,

    sqrt(x) sum_j max(q'_j tau_j, 0) <= P,

is a row for every set of joints that may be driving, with P / sqrt(x) replaced by its
tangent at a reference speed: that function is convex, so the tangent never allows more.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import JointLimits
from backhoe_planner.motion.timing.drive import Drive
from backhoe_planner.motion.timing.time_optimal import Rows, TimeLaw, fastest

__all__ = ["PathShape", "time_path"]

Array = NDArray[np.float64]

_SPARE = 0.9998  # of every limit: what the sampling of the motion may add
_WITHIN = 5e-4  # over a limit between the points of the grid that is let be
_CORRECTIONS = 5
_POWER_PASSES = 8
_POWER_SETTLED = 1e-3  # change of the duration; it converges quadratically
_UP_TO = 1.45  # times the speed at which a load takes all power; a tangent there leaves 1.5 / 1.45 of it at rest
_NO_CAP = 1e6
_LEAST_ROOM = 0.02  # of a load that cannot be held: room that is left to time the path all the same
_MOST_DRIVING = 6  # joints whose every combination may drive


@dataclass(frozen=True, eq=False)
class PathShape:
    """A path on a grid, continuous with its slope; the bend may jump at the points.

    Attributes
    ----------
    grid: (N + 1,) increasing places s.
    q: (N + 1, n) joints there; slope: (N + 1, n) dq/ds.
    bend_after: (N, n) d2q/ds2 at the begin of each interval; bend_before: (N, n) at its end.
    tip_slope: (N + 1,) how far the tip goes per s [m], None where its speed is not limited.
    """

    grid: Array
    q: Array
    slope: Array
    bend_after: Array
    bend_before: Array
    tip_slope: Array | None = None


def time_path(
    shape: PathShape,
    limits: JointLimits,
    *,
    drive: Drive | None,
    tip_speed: float | None = None,
    most: float = np.inf,
    rests: bool = True,
) -> TimeLaw | None:
    """The fastest run along a path within the limits of the joints and of what drives them.

    Where a load cannot be held even at rest, the run is timed as if it just could.

    Parameters
    ----------
    tip_speed: at most [m/s], with `tip_slope`.
    most: greatest ds/dt.
    rests: see `fastest`.

    Returns
    -------
    None where there is none.
    """
    use = _Loads(shape, limits, drive)
    part = np.full(len(shape.grid) - 1, _SPARE)
    law: TimeLaw | None = None
    for _ in range(_CORRECTIONS):
        law = use.solve(part, tip_speed=tip_speed, most=most, rests=rests)
        if law is None:
            return None
        over = use.over_between(law)
        if not np.any(over > 1.0 + _WITHIN):
            break
        # slower where it is over, and beside it
        wide = np.maximum(over, np.maximum(np.append(over[1:], 0.0), np.append(0.0, over[:-1])))
        part = part / np.where(wide > 1.0 + _WITHIN, np.minimum(wide, 1.2) * (1.0 + 0.2 * _WITHIN), 1.0)
    return law


class _Loads:
    """The coefficients of a path's limits on its grid."""

    def __init__(self, shape: PathShape, limits: JointLimits, drive: Drive | None) -> None:
        self._shape, self._limits = shape, limits
        self._drive = drive if drive is not None and drive.limited else None
        if self._drive is None:
            return
        q, slope = shape.q, shape.slope
        still = np.zeros_like(q)
        self._gravity = self._drive.rigid_torques(q, still, still)
        self._inertia = self._drive.rigid_torques(q, still, slope) - self._gravity
        own = self._drive.rigid_torques(q[:-1], slope[:-1], shape.bend_after)
        last = self._drive.rigid_torques(q[1:], slope[1:], shape.bend_before)
        self._turning_after, self._turning_before = own - self._gravity[:-1], last - self._gravity[1:]
        self._soil = self._drive.soil_torques_towards(q, slope)
        self._torque_limits = self._drive.torque_limits(q)

    # --- solving ------------------------------------------------------------------

    def solve(self, part: Array, *, tip_speed: float | None, most: float, rests: bool) -> TimeLaw | None:
        """The fastest run with `part` (N,) of every limit to be used."""
        shape = self._shape
        caps = self._caps(part, tip_speed, most)
        before, after = self._rows(part, 0), self._rows(part, 1)
        law = fastest(shape.grid, caps, before, after, rests=rests)
        if law is None or self._drive is None or self._drive.hydraulics is None:
            return law
        if float(np.max(self._power_use(law), initial=0.0)) <= 1.0 + 0.2 * _WITHIN:
            return law
        at_even_speed, at_rest = self._power_ceilings()
        x = np.minimum(law.x, at_even_speed)
        for _ in range(_POWER_PASSES):
            reference = np.minimum(np.maximum(x, 1e-6 * float(np.max(x))), at_rest)
            begin, end = self._power_rows(part, reference, 0), self._power_rows(part, reference, 1)
            tried = fastest(shape.grid, caps, Rows.stacked([before, begin]), Rows.stacked([after, end]), rests=rests)
            if tried is None:
                return None
            settled = abs(tried.duration - law.duration) <= _POWER_SETTLED * law.duration
            law, x = tried, tried.x
            if settled:
                break
        return law

    def over_between(self, law: TimeLaw) -> Array:
        """(N,) the greatest use of any limit halfway between the points of the grid."""
        shape, limits = self._shape, self._limits
        step = np.diff(shape.grid)[:, None]
        half = 0.5 * step
        bend = 0.5 * (shape.bend_after + shape.bend_before)
        # cubic between the points: its middle from both ends
        q = 0.5 * (shape.q[:-1] + shape.q[1:]) - step**2 / 8.0 * bend
        slope = 0.5 * (shape.slope[:-1] + shape.slope[1:]) - half * (shape.bend_before - shape.bend_after) / 4.0
        x, u = 0.5 * (law.x[:-1] + law.x[1:])[:, None], law.u[:, None]
        v, a = slope * np.sqrt(x), slope * u + bend * x
        over = np.maximum(np.max(np.abs(v) / limits.velocity, axis=1), np.max(np.abs(a) / limits.acceleration, axis=1))
        if self._drive is None:
            return np.asarray(over)
        soil = 0.5 * (self._soil[:-1] + self._soil[1:]) if self._drive.digs else 0.0
        torque = self._drive.rigid_torques(q, v, a) + soil
        effort = np.max(self._drive.effort_use(q, torque), axis=1) if self._held else 0.0
        oil = np.maximum(self._drive.flow_use(q, v), self._drive.power_use(q, v, torque))
        return np.asarray(
            np.maximum(np.maximum(over, effort), np.maximum(oil, np.max(self._drive.rod_speed_use(q, v), axis=1)))
        )

    # --- speed --------------------------------------------------------------------

    def _caps(self, part: Array, tip_speed: float | None, most: float) -> Array:
        """(N + 1,) the greatest x by what bounds speed alone."""
        shape = self._shape
        use = np.max(np.abs(shape.slope) / self._limits.velocity, axis=1)
        if self._drive is not None:
            use = np.maximum(use, np.max(self._drive.rod_speed_use(shape.q, shape.slope), axis=1))
            use = np.maximum(use, self._drive.flow_use(shape.q, shape.slope))
        if tip_speed is not None and shape.tip_slope is not None:
            use = np.maximum(use, np.abs(shape.tip_slope) / tip_speed)
        at = np.minimum(np.append(part, 1.0), np.append(1.0, part))
        with np.errstate(divide="ignore"):
            return np.asarray(np.minimum(np.minimum((at / use) ** 2, most**2), _NO_CAP))

    # --- acceleration and torque --------------------------------------------------

    def _rows(self, part: Array, end: int) -> Rows:
        """Of acceleration and torque at the begin (0) or end (1) of every interval."""
        shape = self._shape
        here = slice(end, len(shape.grid) - 1 + end)
        slope = shape.slope[here]
        bend = shape.bend_before if end else shape.bend_after
        room = part[:, None] * self._limits.acceleration
        found = [Rows(slope, bend, room), Rows(-slope, -bend, room)]
        if self._drive is None:
            return Rows.stacked(found)
        inertia = self._inertia[here]
        turning = self._turning_before if end else self._turning_after
        loads = [self._gravity[here]]
        if self._drive.digs:
            loads.append(loads[0] + self._soil[here])
        for load in loads:
            for sign, limit in ((1.0, self._torque_limits.positive), (-1.0, self._torque_limits.negative)):
                room = _room(limit[here], sign * load, part)
                which = np.any(np.isfinite(room), axis=0)
                found.append(Rows(sign * inertia[:, which], sign * turning[:, which], room[:, which]))
        return Rows.stacked(found)

    @property
    def _held(self) -> bool:
        """Whether every static load can be held everywhere."""
        limits = self._torque_limits
        return all(bool(np.all((load <= limits.positive) & (-load <= limits.negative))) for load in self._loads())

    # --- power --------------------------------------------------------------------

    def _driving(self) -> NDArray[np.int64]:
        """Joints that cylinders move along the path; the busiest, if there are very many."""
        assert self._drive is not None
        assert self._drive.hydraulics is not None
        joints = np.unique(self._drive.hydraulics.joint_of)
        busy = np.max(np.abs(self._shape.slope[:, joints]), axis=0)
        moving = joints[busy > 0.0]
        return np.asarray(moving[np.argsort(-busy[busy > 0.0], kind="stable")][:_MOST_DRIVING])

    def _loads(self) -> list[Array]:
        """(N + 1, n) static loads, without the soil and with all of it."""
        assert self._drive is not None
        return [self._gravity, self._gravity + self._soil] if self._drive.digs else [self._gravity]

    def _power_use(self, law: TimeLaw) -> Array:
        """(2, N) power over the engine's, at both ends of every interval."""
        assert self._drive is not None
        assert self._drive.hydraulics is not None
        found = []
        for end, turning in ((0, self._turning_after), (1, self._turning_before)):
            here = slice(end, len(law.grid) - 1 + end)
            x = law.x[here, None]
            rigid = self._inertia[here] * law.u[:, None] + turning * x
            of_loads = [
                np.sum(np.maximum(self._shape.slope[here] * (rigid + load[here]), 0.0)[:, self._driving()], axis=1)
                for load in self._loads()
            ]
            found.append(np.sqrt(x[:, 0]) * np.max(of_loads, axis=0) / self._drive.hydraulics.power_limit)
        return np.array(found)

    def _power_ceilings(self) -> tuple[Array, Array]:
        """(N + 1,) the x at which the engine can only just keep the speed up; and that beyond
        which a tangent would leave nothing for the load at rest.
        """
        assert self._drive is not None
        assert self._drive.hydraulics is not None
        limit = self._drive.hydraulics.power_limit
        driving = self._driving()
        slope = self._shape.slope[:, driving]
        turning = np.vstack((self._turning_after, self._turning_before[-1:]))[:, driving]
        even, rest = np.full(len(slope), _NO_CAP), np.full(len(slope), _NO_CAP)
        for load in self._loads():
            low, high = np.zeros(len(slope)), np.full(len(slope), _NO_CAP)
            for _ in range(60):
                x = 0.5 * (low + high)
                power = np.sum(np.maximum(slope * (turning * x[:, None] + load[:, driving]), 0.0), axis=1) * np.sqrt(x)
                low, high = np.where(power <= limit, x, low), np.where(power <= limit, high, x)
            even = np.minimum(even, high)
            held = np.sum(np.maximum(slope * load[:, driving], 0.0), axis=1)
            with np.errstate(divide="ignore"):
                rest = np.minimum(rest, (_UP_TO * limit / held) ** 2)
        return np.minimum(even, _NO_CAP), np.minimum(rest, _NO_CAP)

    def _power_rows(self, part: Array, reference: Array, end: int) -> Rows:
        """Of the engine's power at the begin (0) or end (1) of every interval."""
        assert self._drive is not None
        assert self._drive.hydraulics is not None
        driving = self._driving()
        here = slice(end, len(self._shape.grid) - 1 + end)
        turning = self._turning_before if end else self._turning_after
        slope, r = self._shape.slope[here][:, driving], reference[here, None]
        sets = np.array(list(product((0.0, 1.0), repeat=len(driving))))[1:].T  # (joints, sets)
        limit = (part * self._drive.hydraulics.power_limit)[:, None]
        alpha = (slope * self._inertia[here][:, driving]) @ sets
        beta = (slope * turning[:, driving]) @ sets + 0.5 * limit * r**-1.5
        return Rows.stacked(
            [
                Rows(alpha, beta, 1.5 * limit * r**-0.5 - (slope * load[here][:, driving]) @ sets)
                for load in self._loads()
            ]
        )


def _room(limit: Array, load: Array, part: Array) -> Array:
    """(N, n) torque that a static load leaves of a limit; a little where it leaves none."""
    with np.errstate(invalid="ignore"):
        left = limit - load
        spared = np.maximum(part[:, None] * limit - load, 0.2 * left)
    return np.where(left > 0.0, spared, _LEAST_ROOM * np.abs(load))
