"""The ground profile in the arm's plane from a grid of heights, and the cuts to choose from."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.job import Cut, Digger, Profile, find_cut
from backhoe_planner.machine import Dynamics
from backhoe_planner.site import Soil


@pytest.fixture(scope="module")
def digger(backhoe: bp.Robot) -> Digger:
    return Digger(backhoe, Soil())


@dataclass(frozen=True)
class Grid:
    """Heights on a grid that begins at x = -1, y = -4 m."""

    bank: Matrix
    loose: Matrix
    low: Vector
    cell: float = 0.05

    @classmethod
    def of(cls, bank: Array) -> Grid:
        return cls(bank, np.zeros_like(bank), np.array([-1.0, -4.0]))


X, Y = np.meshgrid(-1.0 + 0.05 * np.arange(141), -4.0 + 0.05 * np.arange(161))


@pytest.mark.parametrize("swing", [0.0, 0.4, -0.7])
def test_sloping_ground_has_a_straight_profile(digger: Digger, swing: float) -> None:
    profile = Profile.of_terrain(Grid.of(0.1 * X - 0.05 * Y + 0.2), digger.plane, swing, width=0.61)
    expected = profile.r * (0.1 * np.cos(swing) - 0.05 * np.sin(swing)) + 0.2
    np.testing.assert_allclose(profile.mean, expected, atol=1e-9)
    slope = 0.1 * np.cos(swing) - 0.05 * np.sin(swing)
    np.testing.assert_allclose(profile.slope, slope, atol=1e-9)


@pytest.mark.parametrize("swing", [0.0, 0.35])
def test_the_profile_of_a_trench_has_upright_walls_and_the_right_volume(digger: Digger, swing: float) -> None:
    """A trench of 1.03 m depth and 2.013 m length in the plane, on a grid that has only mean heights of columns."""
    along = np.array([np.cos(swing), np.sin(swing)])
    fine = (np.arange(5) - 2.0) * 0.01
    dug = np.zeros_like(X)
    for dx in fine:
        for dy in fine:
            r = (X + dx) * along[0] + (Y + dy) * along[1]
            across = (Y + dy) * along[0] - (X + dx) * along[1]
            dug += ((r > 2.5) & (r < 4.513) & (np.abs(across) < 0.305)) / 25.0
    profile = Profile.of_terrain(Grid.of(-1.03 * dug), digger.plane, swing, width=0.61)
    area = float(np.sum(0.5 * (profile.mean[1:] + profile.mean[:-1]) * np.diff(profile.r)))
    assert -area == pytest.approx(1.03 * 2.013, rel=0.01)
    drawn_out = (profile.mean < -0.02) & (profile.mean > -1.01)
    assert np.count_nonzero(drawn_out) * 0.0125 < 0.08  # plain interpolation gives 0.2 m at both walls together


def test_a_grid_outside_the_arms_plane_is_an_error(digger: Digger) -> None:
    with pytest.raises(bp.InputError, match=r"swing: .*no ground under the blade"):
        Profile.of_terrain(Grid(X, 0.0 * X, np.array([2.0, 2.0])), digger.plane, -0.7, width=0.61)


def test_invalid_profiles_are_refused() -> None:
    r, flat = np.array([1.0, 2.0, 3.0]), np.zeros((3, 1))
    for bad in (
        (r[::-1], flat, flat), (r, flat[:2], flat), (r, flat, flat - 0.1), (r, flat * np.nan, flat), (r[:1], flat, flat)
    ):  # fmt: skip
        with pytest.raises(bp.InputError, match="profile"):
            Profile(*bad)


def test_a_short_swing_is_estimated_as_by_hand(digger: Digger) -> None:
    """The swing accelerates over half of the way and brakes over the other: the work is the energy in the middle.

    At half the speed it takes twice as long and a quarter of the work.
    """
    machine = Dynamics(digger.robot, payload=200.0)
    start, way = np.array([0.1, 0.5, -1.0, -1.5]), 0.05
    q = start + np.linspace(0.0, 1.0, 26)[:, None] * np.array([way, 0.0, 0.0, 0.0])
    torque = machine.gravity_torques(q)
    acceleration = float(digger.limits.acceleration[0])
    fastest = np.array([math.sqrt(acceleration * way), 0.0, 0.0, 0.0])
    duration, work = digger.estimated_run(q, torque, inertia=machine, part=1.0)
    assert duration == pytest.approx(2.0 * math.sqrt(way / acceleration), rel=1e-2)
    assert work == pytest.approx(machine.kinetic_energy(start, fastest), rel=0.05)
    slow_duration, slow_work = digger.estimated_run(q, torque, inertia=machine, part=1.0, pace=0.5)
    assert slow_duration == pytest.approx(2.0 * duration)
    assert slow_work == pytest.approx(work / 4.0)
    assert digger.estimated_run(q, torque)[1] == pytest.approx(0.0, abs=1e-6)


def test_the_estimated_duration_is_near_the_timed_one(digger: Digger) -> None:
    rng = np.random.default_rng(11)
    ratios = []
    for _ in range(6):
        ground = Profile.level(float(rng.uniform(-1.0, 0.0)), 1.0, 6.0)
        depth, start = float(rng.uniform(0.1, 0.3)), float(rng.uniform(3.5, 5.0))
        cut = find_cut(digger, ground, swing=0.3, start=start, end=1.8, depth=depth)
        assert isinstance(cut, Cut)
        ratios.append(digger.motion(cut).duration / cut.time)
    assert min(ratios) > 0.9
    assert max(ratios) < 1.2
