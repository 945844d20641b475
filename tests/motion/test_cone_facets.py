"""Rows of a cone in several directions, and wider cones."""

from __future__ import annotations

import numpy as np
import pytest
from cones import CONES, Data, keep_of, within

import backhoe_planner as bp
from backhoe_planner.machine import BatchKinematics


@pytest.mark.parametrize("kept", CONES)
def test_the_first_facet_is_the_row_and_all_are_planes_around_the_cone(panda: bp.Robot, kept: Data) -> None:
    """No configuration in the cone misses a facet, and the least margin of all facets is that of the cone."""
    keep = keep_of(panda, kept)
    rng = np.random.default_rng(0)
    q = np.array([panda.random_q(rng) for _ in range(40)] + within(panda, keep, 20))
    margins, gradients, owner = keep.facets_each(q)
    row, slope = keep.rows_each(q)
    np.testing.assert_allclose(margins[:, 0], row[:, 0], atol=1e-12)
    np.testing.assert_allclose(margins.min(axis=1), row[:, 0], atol=1e-12)
    np.testing.assert_allclose(gradients[:, 0], slope[:, 0], atol=1e-9)
    np.testing.assert_array_equal(owner, 0)


def test_the_row_of_one_configuration_is_that_of_many(panda: bp.Robot) -> None:
    keep = keep_of(panda, CONES[0])
    rng = np.random.default_rng(2)
    q = np.array([panda.random_q(rng) for _ in range(20)] + within(panda, keep, 10))
    margins, gradients = keep.rows_each(q)
    for at, margin, gradient in zip(q, margins, gradients, strict=True):
        one, slope = keep.rows_each(at[None])
        np.testing.assert_allclose(one[0], margin, atol=1e-12)
        np.testing.assert_allclose(slope[0], gradient, atol=1e-9)


def test_wider_cones_are_as_wide_as_asked_and_wide_ones_stay(panda: bp.Robot) -> None:
    keep = keep_of(panda, CONES[0])
    assert keep.with_wider_cones(0.2).cones[0].usable == pytest.approx(0.2)
    assert keep.with_wider_cones(0.01).cones[0].usable == pytest.approx(0.05)
    tip = BatchKinematics(panda).at(np.array(within(panda, keep, 5))).tip_rotation
    np.testing.assert_allclose(keep.with_wider_cones(0.2).cones[0].angles(tip), keep.cones[0].angles(tip), atol=1e-12)
