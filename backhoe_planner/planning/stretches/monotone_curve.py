"""Smooth curves through points without overshoot (pchip), on many legs at once."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector


def monotone_curve(x: Vector, y: Matrix, at: Vector, *, legs: Indices) -> Matrix:
    """(K, n) a curve through y (M, n) at x (M,), evaluated at `at` (K,): smooth on each leg, without overshoot.

    The slopes are those of Fritsch and Butland (SIAM J. Sci. Stat. Comput. 5, 1984), as in scipy's pchip, which
    takes as long for each leg as this function for all of them.

    Parameters
    ----------
    x: increasing. at: not decreasing, from x[0] to x[-1].
    legs: (L + 1,) indices of x at which legs begin and end; the first is 0, the last M - 1.
    """
    h, rise = np.diff(x)[:, None], np.diff(y, axis=0)
    slope = rise / h
    first, last = slope.copy(), slope.copy()  # of the curve at both ends of every step
    inner = np.ones(len(x), dtype=bool)
    inner[legs] = False
    knots = np.flatnonzero(inner)
    before, after = slope[knots - 1], slope[knots]
    w_before, w_after = 2.0 * h[knots] + h[knots - 1], h[knots] + 2.0 * h[knots - 1]
    same = np.sign(before) * np.sign(after) > 0.0
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # where y hardly changes
        mean = np.where(same, (w_before + w_after) / (w_before / before + w_after / after), 0.0)
    first[knots] = last[knots - 1] = mean
    begins, ends = legs[:-1], legs[1:] - 1
    long = ends > begins
    for steps, beside, slopes in ((begins, begins + 1, first), (ends, ends - 1, last)):
        rows, others = steps[long], beside[long]
        slopes[rows] = _end_slopes(h[rows], h[others], slope[rows], slope[others])
    step = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(h) - 1)
    t = (at[:, None] - x[step][:, None]) / h[step]
    bend = first[step] + last[step] - 2.0 * slope[step]
    turn = 3.0 * slope[step] - 2.0 * first[step] - last[step]
    return np.asarray(y[step] + h[step] * t * (first[step] + t * (turn + t * bend)))


def _end_slopes(h: Matrix, h_beside: Matrix, slope: Matrix, slope_beside: Matrix) -> Matrix:
    """(L, n) slopes at the ends of legs, from their last two steps: those of a parabola, limited against overshoot."""
    found = ((2.0 * h + h_beside) * slope - h * slope_beside) / (h + h_beside)
    found = np.where(np.sign(found) == np.sign(slope), found, 0.0)
    turns = (np.sign(slope) != np.sign(slope_beside)) & (np.abs(found) > 3.0 * np.abs(slope))
    return np.asarray(np.where(turns, 3.0 * slope, found))
