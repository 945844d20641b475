"""Curves on many legs at once equal scipy's pchip on each."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from backhoe_planner.planning.stretches.monotone_curve import (
    monotone_curve,  # no plan shows the curve between two knots
)


@pytest.mark.parametrize("seed", range(20))
def test_each_leg_equals_scipys_pchip(seed: int) -> None:
    rng = np.random.default_rng(seed)
    legs = np.concatenate(([0], np.cumsum(rng.integers(1, 5, size=6))))  # some have a single step
    x = np.cumsum(rng.uniform(0.01, 1.0, size=legs[-1] + 1))
    y = np.round(rng.standard_normal((len(x), 3)), 1 if seed % 2 else 6)  # with one digit, some steps are level
    y[:, 2] = 1e-12 * y[:, 2]
    at = np.sort(np.concatenate((x, rng.uniform(x[0], x[-1], size=200))))
    found = monotone_curve(x, y, at, legs=legs)
    for first, last in pairwise(legs.tolist()):
        own = (at > x[first]) & (at < x[last])
        expected = PchipInterpolator(x[first : last + 1], y[first : last + 1])(at[own])
        np.testing.assert_allclose(found[own], expected, rtol=1e-9, atol=1e-12 * np.max(np.abs(y)))
    np.testing.assert_allclose(found[np.searchsorted(at, x)], y, atol=1e-15)
