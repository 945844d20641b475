"""Pairs that count because the machine moves: none that could slow it is left out, and most are not measured."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from crowds import DT, crowd, lead_at
from numpy.typing import NDArray

from backhoe_planner.law import Shield
from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.site import Nearby, Proximity


def rows_that_count(proximity: Proximity, plain: Nearby, lead: dict[str, Any], margin: float) -> NDArray[np.bool_]:
    """Chosen from all rows as the docstring of `Proximity.at_unchecked` says."""
    change = lead["fastest"] - np.abs(lead["v"])
    low, high = lead["v"] - change, lead["v"] + change
    ever = proximity.travel @ lead["fastest"] + proximity.speed
    corners = np.array([np.where(pick, low, high) for pick in itertools.product((True, False), repeat=len(low))])
    here = np.max(-plain.gradient @ corners.T, axis=1) - plain.drift
    within_reach = (proximity.floor - proximity.clearance <= margin)[plain.pair]
    ahead = within_reach & (plain.margin <= lead["stop"] * ever[plain.pair]) & (plain.margin < lead["longest"] * here)
    return np.asarray((plain.margin <= margin) | ahead)


@pytest.mark.parametrize(("moving", "earlier"), [(False, 0.0), (True, 0.0), (True, 1.0)])
@pytest.mark.parametrize("name", ["planar4", "backhoe", pytest.param("panda", marks=pytest.mark.long)])
def test_rows_along_a_walk_equal_those_chosen_from_all_measured_pairs(
    name: str, moving: bool, earlier: float, request: pytest.FixtureRequest
) -> None:
    robot: Robot = request.getfixturevalue(name)
    proximity, oracle = (crowd(robot, 40, 3, moving=moving, earlier=earlier) for _ in range(2))
    rng = np.random.default_rng(5)
    q, part, found, beyond = robot.random_q(rng), np.zeros(robot.n), 0, 0
    steps = 60
    for step in range(steps):
        part = np.clip(part + rng.uniform(-0.3, 0.3, robot.n), -1.0, 1.0)
        v, margin = part * robot.limits.velocity, float(rng.choice([0.01, 0.5]))
        q = robot.random_q(rng) if step % 20 == 19 else np.clip(q + DT * v, robot.limits.lower, robot.limits.upper)
        time, lead = float(rng.uniform(0.0, 2.0)) if moving else 0.0, lead_at(robot, v)
        plain = oracle.at(q, time=time)
        expected = plain.only(rows_that_count(oracle, plain, lead, margin))
        near = proximity.at_unchecked(q, time=time, margin=margin, **lead)
        np.testing.assert_array_equal(near.pair, expected.pair)
        for field in ("distance", "margin", "normal", "point_link", "point_obstacle", "gradient", "drift"):
            np.testing.assert_allclose(getattr(near, field), getattr(expected, field), atol=1e-9, err_msg=field)
        found, beyond = found + len(near), beyond + int((near.margin > margin).sum())
    assert found > 20
    assert beyond > 0
    assert proximity.measured < (0.5 if moving else 0.35) * oracle.measured, "pairs were skipped"


@pytest.mark.parametrize("moving", [False, True])
def test_pairs_that_are_not_measured_keep_their_lower_bounds(backhoe: Robot, moving: bool) -> None:
    """Along a walk with jumps: no bound exceeds the distance, and pairs called proven are clear after the step."""
    proximity, oracle = crowd(backhoe, 60, 12, moving=moving), crowd(backhoe, 60, 12, moving=moving)
    assert len(proximity.pairs) > 600, "so many that those around are chosen"
    rng, limits, time, near = np.random.default_rng(13), backhoe.limits, 0.0, 0
    q = backhoe.random_q(rng)
    for step in range(150):
        v = rng.uniform(-1.0, 1.0, 4) * limits.velocity
        near += len(proximity.at_unchecked(q, time=time, margin=0.3, **lead_at(backhoe, v)))
        if step % 40 == 39:
            q = backhoe.random_q(rng)
        else:
            q = np.clip(q + rng.choice([0.2, 1.0, 5.0]) * DT * v, limits.lower, limits.upper)
        time += DT if moving else 0.0
        spare = float(rng.choice([0.0, 0.1, 0.5]))
        unproven = proximity.unproven_unchecked(q, time=time, spare=spare)
        there = oracle.distances_of(np.arange(len(oracle.pairs)), q, time=time)
        # an obstacle that has not appeared yet is elsewhere, but as far away
        missing = (there < oracle.clearance + spare).nonzero()[0]
        assert set(missing.tolist()) <= set(unproven.tolist())
        if step % 10 == 9:
            bounds, measured = proximity.lower_bounds(q, time=time, floor=np.full(len(there), -np.inf))
            assert not measured.any()
            assert (bounds <= there + 1e-9).all()
    assert near > 100


def test_a_step_is_unproven_for_the_pairs_whose_travel_bound_exceeds_their_margin(backhoe: Robot) -> None:
    """The bound is the measured distance less the travel of the step, compared with the clearance."""
    proximity, oracle = crowd(backhoe, 6, 3, moving=False), crowd(backhoe, 6, 3, moving=False)
    rng, limits = np.random.default_rng(21), backhoe.limits
    none = some = 0
    for _ in range(150):
        q, v = backhoe.random_q(rng), rng.uniform(-1.0, 1.0, 4) * limits.velocity
        near = proximity.at_unchecked(q, time=0.0, margin=0.6, **lead_at(backhoe, v))
        there = np.clip(q + rng.choice([1.0, 5.0]) * DT * v, limits.lower, limits.upper)
        spare = float(rng.choice([0.0, 0.05]))
        way = oracle.travel @ np.abs(there - q)
        expected = (oracle.distances(q) - way < oracle.clearance + spare).nonzero()[0]
        unproven = proximity.unproven_unchecked(there, time=0.0, spare=spare)
        assert set(expected.tolist()) <= set(unproven.tolist())
        np.testing.assert_array_equal(np.intersect1d(unproven, near.pair), np.intersect1d(expected, near.pair))
        none, some = none + (len(expected) == 0), some + (len(expected) > 0)
    assert min(none, some) > 10


@pytest.mark.parametrize("earlier", [0.0, 3.0])
def test_no_pair_approaches_faster_than_its_bound(any_robot: Robot, earlier: float) -> None:
    proximity = crowd(any_robot, 20, 4, moving=True, earlier=earlier)
    rng = np.random.default_rng(8)
    slow = checked = 0
    for _ in range(20):
        q, v, time = any_robot.random_q(rng), rng.normal(size=any_robot.n), float(rng.uniform(0.0, 2.0))
        rows = proximity.at(q, time=time)
        apart = rows.only(rows.distance > 0.0)
        bound = proximity.approach_unchecked(apart.pair, v, time)
        assert np.all(-apart.gradient @ v - apart.drift <= bound + 1e-9)
        ever = proximity.travel[apart.pair] @ np.abs(v) + proximity.speed[apart.pair]
        slow, checked = slow + int((bound < 0.5 * ever).sum()), checked + len(apart)
    assert slow > 0.3 * checked, "it says more than how far the link can travel at all"


def test_the_shield_gives_the_same_velocity_as_with_all_rows(backhoe: Robot) -> None:
    """Rows that are left out cannot bind, whatever velocity is wished for within the limits."""
    proximity, oracle = crowd(backhoe, 40, 6, moving=False), crowd(backhoe, 40, 6, moving=False)
    rng = np.random.default_rng(9)
    shield, kinematics, limits = Shield(backhoe.limits), Kinematics(backhoe), backhoe.limits
    held_back = left_out = 0
    for _ in range(60):
        q, v = backhoe.random_q(rng), rng.uniform(-1.0, 1.0, 4) * limits.velocity
        wish = rng.uniform(-1.0, 1.0, 4) * limits.velocity
        near, every = proximity.at_unchecked(q, time=0.0, margin=0.02, **lead_at(backhoe, v)), oracle.at(q)
        J = kinematics.at(q).jacobian[:3]
        found, expected = (
            shield.filter_unchecked(wish, q=q, v_before=v, dt=DT, nearby=rows, J_tip=J) for rows in (near, every)
        )
        np.testing.assert_allclose(found.v, expected.v, atol=1e-6)
        held_back, left_out = held_back + len(expected.binding), left_out + len(every) - len(near)
    assert held_back > 0
    assert left_out > 60 * 100
