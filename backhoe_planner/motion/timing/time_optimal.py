"""The fastest run along a path, in the plane of path parameter s and squared speed x = (ds/dt)^2.

With u = d2s/dt2, every limit on velocity bounds x, and every limit on acceleration or
torque is a row  alpha u + beta x <= gamma.  A backward pass over the grid finds the
greatest x from which the rest of the path can still be run; a forward pass takes the
greatest u that stays below it (H. Pham and Q.-C. Pham, A new approach to time-optimal
path parameterization based on reachability analysis, IEEE T-RO 34, 2018). Between two
points of the grid u is constant and x is linear in s; rows hold at both ends of the interval.

toppra solves the same rows with the same result (durations within 5e-7 of these on the six
runs of four scenes, 300 to 1,100 points with 16 or 24 rows each). But it takes 2.3 times as
long (1.2 s instead of 0.5 s), needs a constraint class for every limit, requires matplotlib,
and reports that there is no run by None and a log line. So the tests check this file against
toppra, and planning does not need it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array
from backhoe_planner.native import compiled

_STEPS = 60  # of Newton's method at most; on a concave piecewise linear function it terminates by itself
_ROUNDING = 1e-10  # relative: coefficients and room below this are rounding


@dataclass(frozen=True, eq=False)
class Rows:
    """alpha u + beta x <= gamma: R rows at one end of each of N intervals; all arrays (N, R)."""

    alpha: Array
    beta: Array
    gamma: Array

    @classmethod
    def stacked(cls, parts: list[Rows]) -> Rows:
        """The rows of all `parts`."""
        return cls(*(np.hstack([getattr(part, name) for part in parts]) for name in ("alpha", "beta", "gamma")))


@dataclass(frozen=True, eq=False)
class TimeLaw:
    """A run along a path: the path parameter over time.

    Attributes
    ----------
    grid: (N + 1,) values of s, in any unit.
    x: (N + 1,) squared speed there [1/s^2 times the square of that unit].
    time: (N + 1,) when each value of s is reached [s].
    """

    grid: Array
    x: Array
    time: Array

    @property
    def duration(self) -> float:
        """Time from the beginning to the end of the grid [s]."""
        return float(self.time[-1])

    @property
    def u(self) -> Array:
        """(N,) d2s/dt2 on each interval."""
        return np.asarray(0.5 * np.diff(self.x) / np.diff(self.grid))

    def at(self, time: Array) -> Array:
        """The path parameter s at each `time` [s], in the same shape."""
        interval = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.grid) - 2)
        since = np.clip(time - self.time[interval], 0.0, None)
        s = self.grid[interval] + since * (np.sqrt(self.x[interval]) + 0.5 * since * self.u[interval])
        return np.clip(s, self.grid[0], self.grid[-1])


def fastest(grid: Array, caps: Array, before: Rows, after: Rows, *, rests: bool = True) -> TimeLaw | None:
    """The fastest run along the grid within caps on x and rows at both ends of every interval.

    Parameters
    ----------
    grid: (N + 1,) increasing values of s.
    caps: (N + 1,) the greatest x there, finite.
    before, after: rows at the beginning and at the end of each of the N intervals.
    rests: whether the run is at rest at both ends; if not, it is as fast there as the limits allow.

    Returns
    -------
    The run; None if the path cannot be run from end to end.
    """
    found = fastest_run(
        grid, caps, before.alpha, before.beta, before.gamma, after.alpha, after.beta, after.gamma, rests
    )
    return None if found is None else TimeLaw(grid, *found)


@compiled
def fastest_run(
    grid: Array, caps: Array, alpha_before: Array, beta_before: Array, gamma_before: Array,
    alpha_after: Array, beta_after: Array, gamma_after: Array, rests: bool, /,
) -> tuple[Array, Array] | None:  # fmt: skip
    """The squared speeds (N + 1,) and times (N + 1,) [s] of a `TimeLaw`, as `fastest`, from separate row arrays."""
    steps = np.diff(grid)
    # at the end of an interval x has become x + 2 step u
    rows = Rows(
        np.hstack((alpha_before, alpha_after + 2.0 * steps[:, None] * beta_after)),
        np.hstack((beta_before, beta_after)),
        np.hstack((gamma_before, gamma_after)),
    )
    highest = np.array(caps, dtype=float)
    highest[:-1] = np.minimum(highest[:-1], _level_caps(rows, steps))
    if rests:
        highest[0] = highest[-1] = 0.0
    cells = _cells(*_slanted(rows, steps), highest[:-1])
    for i in range(len(steps) - 1, -1, -1):
        found = cells[i].greatest(float(highest[i]), 2.0 * float(steps[i]), float(highest[i + 1]))
        if found is None:
            return None
        highest[i] = found
    x = np.empty_like(highest)
    x[0] = highest[0]
    for i, step in enumerate(steps):
        reached = x[i] + 2.0 * step * cells[i].hardest(float(x[i]))
        x[i + 1] = min(max(reached, 0.0), highest[i + 1])
    speed = np.sqrt(x)
    mean = 0.5 * (speed[:-1] + speed[1:])
    if not np.all(mean > 0.0) or not np.all(np.isfinite(mean)):
        return None
    return x, np.concatenate(([0.0], np.cumsum(steps / mean)))


def _flat(rows: Rows, steps: Array) -> NDArray[np.bool_]:
    """(N, R) which rows hardly depend on u, within the range of u possible on an interval."""
    room = np.abs(rows.alpha) / steps[:, None]
    return np.asarray(room <= _ROUNDING * np.maximum(np.abs(rows.beta), 1e-9))


def _level_caps(rows: Rows, steps: Array) -> Array:
    """(N,) the greatest x that rows without u allow."""
    binding = _flat(rows, steps) & (rows.beta > 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(np.min(np.where(binding, rows.gamma / rows.beta, np.inf), axis=1, initial=np.inf))


def _slanted(rows: Rows, steps: Array) -> tuple[Array, Array, Array, Array]:
    """Rows as u <= top + rise x and u >= bottom + fall x, infinite where a row is not such a bound."""
    flat = _flat(rows, steps)
    above, below = ~flat & (rows.alpha > 0.0), ~flat & (rows.alpha < 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        at, slope = rows.gamma / rows.alpha, -rows.beta / rows.alpha
    return (
        np.where(above, at, np.inf), np.where(above, slope, 0.0),
        np.where(below, at, -np.inf), np.where(below, slope, 0.0),
    )  # fmt: skip


_Bounds = tuple[float, float, float, float]  # at some x: the greatest u and its slope over x, then the least u and its


def _cells(tops: Array, rises: Array, bottoms: Array, falls: Array, highest: Array) -> list[_Cell]:
    """The intervals with their bounds of u at the `highest` x (N,) within the caps, found for all of them at once."""
    top, bottom, count = tops + rises * highest[:, None], bottoms + falls * highest[:, None], np.arange(len(highest))
    high, low = top.argmin(axis=1), bottom.argmax(axis=1)
    bounds = (top[count, high], rises[count, high], bottom[count, low], falls[count, low])
    at_highest = zip(*(one.tolist() for one in bounds), strict=True)
    return [_Cell(*parts) for parts in zip(tops, rises, bottoms, falls, highest.tolist(), at_highest, strict=True)]


class _Cell:
    """The rows of one interval, and the bounds of u at the x that was evaluated last."""

    def __init__(self, top: Array, rise: Array, bottom: Array, fall: Array, x: float, bounds: _Bounds) -> None:
        self._top, self._rise, self._bottom, self._fall = top, rise, bottom, fall
        self._x, self._bounds = x, bounds

    def hardest(self, x: float) -> float:
        """The greatest u at x, even if rounding puts it below the least."""
        return self._bounds[0] if x == self._x else float((self._top + self._rise * x).min(initial=np.inf))

    def _bounds_at(self, x: float) -> _Bounds:
        if x != self._x:
            tops, bottoms = self._top + self._rise * x, self._bottom + self._fall * x
            high, low = tops.argmin(), bottoms.argmax()  # a method of an array costs a fifth of numpy's function
            self._x = x
            self._bounds = float(tops[high]), float(self._rise[high]), float(bottoms[low]), float(self._fall[low])
        return self._bounds

    def greatest(self, x: float, twice: float, ahead: float) -> float | None:
        """The greatest x, at most as given, with a u so that 0 <= x + twice u <= ahead.

        The range of u is concave in x, so Newton's method from above finds its zero.
        """
        for _ in range(_STEPS):
            top, rise, bottom, fall = self._bounds_at(x)
            if (ahead - x) / twice < top:
                top, rise = (ahead - x) / twice, -1.0 / twice
            if -x / twice > bottom:
                bottom, fall = -x / twice, -1.0 / twice
            room = top - bottom
            if room >= -_ROUNDING * (abs(top) + abs(bottom)):
                return x
            slope = rise - fall
            if slope >= 0.0 or x <= 0.0:
                return None
            x = max(x - room / slope, 0.0)
        return x
