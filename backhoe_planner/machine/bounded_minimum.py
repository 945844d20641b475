"""Minima of smooth functions within joint ranges, by SLSQP."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from backhoe_planner.arrays import Vector

_MOST_ITERATIONS = 200  # chosen


def minimum_within(
    function: Callable[[Vector], Any], start: Vector, lower: Vector, upper: Vector, *, ftol: float, **more: Any
) -> Vector:
    """(n,) where a function of (n,) joints is least near a start; it may leave the bounds by rounding.

    Parameters
    ----------
    start, lower, upper: (n,) where the search begins, and the bounds [rad or m].
    ftol: change of the function at which the search ends.
    more: `jac`, `constraints`, as for ``scipy.optimize.minimize``.
    """
    from scipy.optimize import minimize

    with warnings.catch_warnings():
        # scipy 1.15, the last for Python 3.10, warns of its own steps that leave the bounds by rounding
        warnings.filterwarnings("ignore", "Values in x were outside bounds", RuntimeWarning)
        found = minimize(
            function, start, method="SLSQP", bounds=np.column_stack((lower, upper)),
            options={"ftol": ftol, "maxiter": _MOST_ITERATIONS}, **more,
        )  # fmt: skip
    return np.asarray(found.x)
