"""A machine's limits along a path q(s), as bounds on its speed and acceleration along it.

With v = q' s', a = q' s'' + q'' s'^2, u = s'' and x = s'^2 the torques are

    tau = (M q') u + (M q'' + C(q, q') q') x + g + lambda tau_soil,   0 <= lambda <= 1

where the part lambda of the soil grows with the speed to 1. Limits on speed and flow bound x;
those on acceleration and torque are rows linear in (u, x). The engine's power,

    sqrt(x) sum_j max(q'_j tau_j, 0) <= P,

is a row for every set of joints that may be driving, with P / sqrt(x) replaced by its
tangent at a reference speed: that function is convex, so the tangent never allows more.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from backhoe_planner.arrays import Array
from backhoe_planner.machine import Hydraulics, JointLimits
from backhoe_planner.motion.timing.drive import DRIVE_TOLERANCE, Drive
from backhoe_planner.motion.timing.time_optimal import Rows, TimeLaw, fastest

_SPARE = 0.9998  # part of every limit to be used; chosen: the samples of the motion may use slightly more
_WITHIN = 5e-4  # part of a limit that may be exceeded between the points of the grid; chosen
_CORRECTIONS = 5  # runs at most, each slower where the previous one exceeded a limit; chosen
_MOST_CORRECTED = 1.2  # greatest factor by which one correction lowers a limit; chosen
_POWER_PASSES = 8  # tangents at most, each at the speed of the previous run; chosen
_POWER_SETTLED = 1e-3  # part of the duration: the next change is far smaller, since the passes converge quadratically
_POWER_HALVINGS = 60  # of the range of x: more than a float's digits
_UP_TO = 1.45  # times the speed at which a load takes all power; a tangent there leaves 1.5 / 1.45 of it at rest
_NO_CAP = 1e6  # of x, in place of infinity
_LEAST_ROOM = 0.02  # part of a load that cannot be held, left as room so that the path can be timed; chosen
_MOST_DRIVING = 6  # joints every combination of which may drive: 2^6 - 1 = 63 rows


@dataclass(frozen=True, eq=False)
class PathShape:
    """A path on a grid. The path and its slope are continuous; the bend may jump at the points.

    Attributes
    ----------
    grid: (N + 1,) increasing values of s.
    q: (N + 1, n) joints there; slope: (N + 1, n) dq/ds.
    bend_after: (N, n) d2q/ds2 at the beginning of each interval; bend_before: (N, n) at its end.
    tip_slope: (N + 1,) how far the tip moves per unit of s [m]; None if its speed is not limited.
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
    """The fastest run along a path within the limits of the joints and of their drive.

    If a load cannot be held even at rest, the run is timed as if it just could.

    Parameters
    ----------
    shape: the path.
    limits: of the joints.
    drive: of the joints; None for no limits other than those of the joints.
    tip_speed: the greatest speed of the tip [m/s]; it requires `tip_slope`.
    most: the greatest ds/dt.
    rests: see `fastest`.

    Returns
    -------
    The run; None if there is none.
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
        # slower where a limit is exceeded, and beside that
        wide = np.maximum(over, np.maximum(np.append(over[1:], 0.0), np.append(0.0, over[:-1])))
        part = part / np.where(wide > 1.0 + _WITHIN, np.minimum(wide, _MOST_CORRECTED) * (1.0 + 0.2 * _WITHIN), 1.0)
    return law


class _Loads:
    """The coefficients of a path's limits on its grid."""

    def __init__(self, shape: PathShape, limits: JointLimits, drive: Drive | None) -> None:
        self._shape, self._limits = shape, limits
        self._drive = drive if drive is not None and drive.limited else None
        self._power: _Power | None = None
        if self._drive is None:
            return
        q, slope = shape.q, shape.slope
        self._gravity = self._drive.gravity_torques(q)
        self._inertia = self._drive.rigid_torques(q, np.zeros_like(q), slope) - self._gravity
        if np.array_equal(shape.bend_before[:-1], shape.bend_after[1:]):  # the bend does not jump at the points
            bend = np.concatenate((shape.bend_after, shape.bend_before[-1:]))
            turning = self._drive.rigid_torques(q, slope, bend) - self._gravity
            self._turning = turning[:-1], turning[1:]
        else:
            own = self._drive.rigid_torques(q[:-1], slope[:-1], shape.bend_after)
            last = self._drive.rigid_torques(q[1:], slope[1:], shape.bend_before)
            self._turning = own - self._gravity[:-1], last - self._gravity[1:]
        self._soil = self._drive.soil_torques_towards(q, slope)
        # (N + 1, n) static loads, without the soil and with all of it
        self._loads = [self._gravity, self._gravity + self._soil] if self._drive.digs else [self._gravity]
        self._torque_limits = self._drive.torque_limits(q)
        if self._drive.hydraulics is not None:
            self._power = _Power(self._drive.hydraulics, shape, self._inertia, self._turning, self._loads)

    # --- solving ------------------------------------------------------------------

    def solve(self, part: Array, *, tip_speed: float | None, most: float, rests: bool) -> TimeLaw | None:
        """The fastest run with `part` (N,) of every limit to be used."""
        shape = self._shape
        caps = self._caps(part, tip_speed, most)
        before, after = self._rows(part, 0), self._rows(part, 1)
        law = fastest(shape.grid, caps, before, after, rests=rests)
        power = self._power
        if law is None or power is None or float(np.max(power.use(law), initial=0.0)) <= 1.0 + 0.2 * _WITHIN:
            return law
        at_even_speed, at_rest = power.ceilings()
        x = np.minimum(law.x, at_even_speed)
        for _ in range(_POWER_PASSES):
            reference = np.minimum(np.maximum(x, 1e-6 * float(np.max(x))), at_rest)
            begin, end = power.rows(part, reference, 0), power.rows(part, reference, 1)
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
        """(N + 1,) the greatest x within the limits on speed and flow."""
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
        """The rows of acceleration and torque at the beginning (0) or end (1) of every interval."""
        shape = self._shape
        here = slice(end, len(shape.grid) - 1 + end)
        slope = shape.slope[here]
        bend = shape.bend_before if end else shape.bend_after
        room = part[:, None] * self._limits.acceleration
        found = [Rows(slope, bend, room), Rows(-slope, -bend, room)]
        if self._drive is None:
            return Rows.stacked(found)
        inertia, turning = self._inertia[here], self._turning[end]
        for load in self._loads:
            for sign, limit in ((1.0, self._torque_limits.positive), (-1.0, self._torque_limits.negative)):
                room = _room(limit[here], sign * load[here], part)
                which = np.any(np.isfinite(room), axis=0)
                found.append(Rows(sign * inertia[:, which], sign * turning[:, which], room[:, which]))
        return Rows.stacked(found)

    @property
    def _held(self) -> bool:
        """Whether every static load can be held everywhere."""
        limits = self._torque_limits
        return all(bool(np.all((load <= limits.positive) & (-load <= limits.negative))) for load in self._loads)


class _Power:
    """The engine's power along a path, for the joints that cylinders move, but at most the six that move most."""

    def __init__(
        self, hydraulics: Hydraulics, shape: PathShape, inertia: Array, turning: tuple[Array, Array], loads: list[Array]
    ) -> None:
        joints = np.array(sorted(set(hydraulics.joint_of.tolist())))
        busy = np.max(np.abs(shape.slope[:, joints]), axis=0)
        driving = joints[busy > 0.0][np.argsort(-busy[busy > 0.0], kind="stable")][:_MOST_DRIVING]
        self._limit = hydraulics.power_limit
        self._slope, self._inertia = shape.slope[:, driving], inertia[:, driving]
        self._turning = [part[:, driving] for part in turning]
        self._loads = [load[:, driving] for load in loads]

    def use(self, law: TimeLaw) -> Array:
        """(2, N) the power of a run over the engine's, at both ends of every interval."""
        found = []
        for end, turning in enumerate(self._turning):
            here = slice(end, len(law.grid) - 1 + end)
            x = law.x[here, None]
            rigid = self._inertia[here] * law.u[:, None] + turning * x
            of_loads = [
                np.sum(np.maximum(self._slope[here] * (rigid + load[here]), 0.0), axis=1) for load in self._loads
            ]
            found.append(np.sqrt(x[:, 0]) * np.max(of_loads, axis=0) / self._limit)
        return np.array(found)

    def ceilings(self) -> tuple[Array, Array]:
        """(N + 1,) the greatest x that the engine can sustain; and (N + 1,) the x beyond which a tangent
        would leave nothing for the load at rest.
        """
        slope, turning = self._slope, np.vstack((self._turning[0], self._turning[1][-1:]))
        even, rest = np.full(len(slope), _NO_CAP), np.full(len(slope), _NO_CAP)
        for load in self._loads:
            low, high = np.zeros(len(slope)), np.full(len(slope), _NO_CAP)
            for _ in range(_POWER_HALVINGS):
                x = 0.5 * (low + high)
                power = np.sum(np.maximum(slope * (turning * x[:, None] + load), 0.0), axis=1) * np.sqrt(x)
                low, high = np.where(power <= self._limit, x, low), np.where(power <= self._limit, high, x)
            even = np.minimum(even, high)
            held = np.sum(np.maximum(slope * load, 0.0), axis=1)
            with np.errstate(divide="ignore"):
                rest = np.minimum(rest, (_UP_TO * self._limit / held) ** 2)
        return np.minimum(even, _NO_CAP), np.minimum(rest, _NO_CAP)

    def rows(self, part: Array, reference: Array, end: int) -> Rows:
        """The rows of power with tangents at `reference` (N + 1,), at the beginning (0) or end (1) of each interval."""
        here = slice(end, len(self._slope) - 1 + end)
        slope, r = self._slope[here], reference[here, None]
        sets = np.array(list(product((0.0, 1.0), repeat=slope.shape[1])))[1:].T  # (joints, sets)
        limit = (part * self._limit)[:, None]
        alpha = (slope * self._inertia[here]) @ sets
        beta = (slope * self._turning[end]) @ sets + 0.5 * limit * r**-1.5
        return Rows.stacked(
            [Rows(alpha, beta, 1.5 * limit * r**-0.5 - (slope * load[here]) @ sets) for load in self._loads]
        )


def _room(limit: Array, load: Array, part: Array) -> Array:
    """(N, n) torque that a static load leaves of a limit; a little if it leaves none.

    A load that exceeds the limit within `DRIVE_TOLERANCE` counts as held: the motion has half of what is left of that.
    """
    with np.errstate(invalid="ignore"):
        left = limit - load
        spared = np.maximum(part[:, None] * limit - load, 0.2 * left)
        within = 0.5 * (left + DRIVE_TOLERANCE * limit)
    return np.where(left > 0.0, spared, np.where(within > 0.0, within, _LEAST_ROOM * np.abs(load)))
