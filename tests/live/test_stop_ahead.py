"""Coming to rest at a place on a plan: how far the machine goes, that it keeps its accelerations, and which place."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.live import Approach, Blockage, Reference, first_rest, stop_before
from backhoe_planner.machine import JointLimits, Robot

PART = 0.97  # of the accelerations, that an approach uses


@pytest.fixture(scope="module")
def even(backhoe: Robot) -> tuple[Reference, JointLimits]:
    """The swing alone turns at 0.5 rad/s for 8 s; it may slow down by 0.25 rad/s^2."""
    time = np.linspace(0.0, 8.0, 401)
    limits = replace(backhoe.limits, acceleration=np.full(4, 0.25))
    motion = bp.Trajectory.from_steps(time, np.outer(time, [0.5, 0.0, 0.0, 0.0]))
    return Reference(motion, limits), limits


@pytest.fixture(scope="module")
def least_time(planar4: Robot) -> tuple[Reference, JointLimits]:
    """A plan of least time: at each moment a joint is at its limit of rate or acceleration."""
    joints = dict(zip(planar4.joint_names, [0.3, 0.4, 0.5, 0.2], strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [1.5, 1.5, 0.0]}}}
    plan = bp.plan(planar4, bp.scene_from_dict(content), effort="quick")
    return Reference(plan.trajectory, plan.problem.limits), plan.problem.limits


def test_an_even_turn_is_slowed_down_by_the_acceleration(even: tuple[Reference, JointLimits]) -> None:
    """From rate v at the deceleration b it takes v / b and v^2 / 2 b: half the time at the even rate."""
    reference, limits = even
    slowing = 0.5 / (PART * 0.25)  # s
    approach = Approach(copy(reference), limits, place=4.0)
    assert approach.end == pytest.approx(4.0 + 0.5 * slowing, abs=0.02)
    assert approach.at(1.0) == pytest.approx(reference.at(1.0), abs=1e-12)
    np.testing.assert_allclose(
        approach.at(approach.end - 0.5 * slowing), [2.0 - 0.125 * 0.5 * slowing, 0, 0, 0], atol=5e-3
    )
    np.testing.assert_array_equal(approach.last_q, reference.at(4.0))
    np.testing.assert_array_equal(approach.at(approach.end + 1.0), reference.at(4.0))


def test_the_first_place_of_rest_is_the_stopping_distance_ahead(even: tuple[Reference, JointLimits]) -> None:
    """At the pace p the distance is p^2 as long; a machine at rest rests where it is."""
    reference, limits = copy(even[0]), even[1]
    reference.clock = 3.0
    distance = 0.5 * 0.5 / (PART * 0.25)  # s of the plan
    for pace in (1.0, 0.5, 0.0):
        assert first_rest(reference, limits, pace) == pytest.approx(3.0 + pace**2 * distance, abs=0.01)
    reference.clock = 7.8
    assert first_rest(reference, limits, 1.0) == np.inf  # what is left of the plan is shorter


@pytest.mark.parametrize("part", [0.3, 0.55, 0.8])
def test_an_approach_keeps_the_accelerations_and_the_path(
    least_time: tuple[Reference, JointLimits], part: float
) -> None:
    reference, limits = least_time
    approach = Approach(copy(reference), limits, place=part * reference.end)
    step = 0.001
    places = np.array([approach.at(moment) for moment in np.arange(0.0, approach.end + 3.0 * step, step).tolist()])
    rates = np.diff(places, axis=0) / step
    assert (np.abs(rates) <= limits.velocity * (1.0 + 1e-6)).all()
    changes = np.abs(np.diff(rates, axis=0)) / step
    assert (changes <= limits.acceleration * (1.0 + 1e-6)).all()
    assert (changes[round((approach.end - 0.1) / step) :] > 0.9 * PART * limits.acceleration).any()  # it is not slower
    fine = np.array([reference.at(moment) for moment in np.linspace(0.0, approach.place, 20_000).tolist()])
    assert max(float(np.abs(fine - q).max(axis=1).min()) for q in places[::50]) < 2e-4


def test_its_clock_is_that_of_the_reference(least_time: tuple[Reference, JointLimits]) -> None:
    reference = copy(least_time[0])
    approach = Approach(reference, least_time[1], place=0.6 * reference.end)
    for moment in np.random.default_rng(3).uniform(0.0, approach.end, 50).tolist():
        approach.clock = moment
        assert approach.clock == pytest.approx(moment, abs=1e-6)
        np.testing.assert_array_equal(approach.q, reference.q)
    alone = copy(approach)
    alone.advance(10.0)
    assert alone.ended
    assert reference.clock < approach.place  # a copy has a clock of its own
    approach.advance(10.0)
    assert reference.clock == approach.place


def test_the_machine_stops_as_far_on_as_there_is_room(even: tuple[Reference, JointLimits]) -> None:
    """The stopping distance from 3 s on is 1.03 s: places before 4.03 s are out of reach."""
    reference, limits = copy(even[0]), even[1]
    reference.clock = 3.0

    def place(time: list[float], margin: list[float]) -> float | None:
        found = stop_before(reference, limits, 1.0, Blockage(time[-1], "crate", True, np.array(time), np.array(margin)))
        return None if found is None else found.place

    assert place([5.0, 5.1, 5.2, 5.3], [0.12, 0.06, 0.03, 0.0]) == 5.0  # with most room
    assert place([3.9, 4.1, 4.2, 4.3], [0.12, 0.06, 0.03, 0.0]) == 4.1  # the one with most room is too near
    assert place([3.9, 4.0, 4.2, 4.3], [0.12, 0.06, 0.03, 0.0]) == 4.2
    assert place([3.8, 3.9, 4.0, 4.2], [0.12, 0.06, 0.03, 0.0]) is None
