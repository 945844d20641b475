"""What is computed in a quick way for a job equals its plain definition."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label
from small_jobs import TINY, small_job, tiny_plan

from backhoe_planner.arrays import Array, Vector
from backhoe_planner.job import (
    PatternEstimate,
    Profile,
    Terrain,
    build_worksite,
    estimate_job,
    job_from_dict,
    plan_estimated,
)
from backhoe_planner.job.cuts import finding
from backhoe_planner.job.cuts.edge_path import Descent, Underground
from backhoe_planner.job.cycles import patterns
from backhoe_planner.job.cycles.patterns import NextCut, Pattern, next_cut
from backhoe_planner.job.ground.heaps import _cone  # before soil slumps, which the door does not show
from backhoe_planner.job.worksite.lanes import lanes_of

DEEP: dict[str, Any] = {
    "ground": {"low": [0.5, -4.5], "high": [6.0, 1.5]},
    "dig": {"trench": {"from": [4.4, 0.0], "to": [2.8, 0.0], "width": 0.6, "depth": 0.7}},
    "site": {"clearance": 0.1},
}


def test_lanes_are_interpolated_as_each_by_itself() -> None:
    """To the last bit, at radii of the profile, between them, and beyond its ends."""
    rng = np.random.default_rng(11)
    r = np.cumsum(rng.uniform(0.01, 0.02, 200))
    profile = Profile(r, rng.uniform(-1.0, 0.0, (200, 7)), rng.uniform(0.0, 0.1, (200, 7)))
    at = np.concatenate((rng.uniform(-0.5, r[-1] + 0.5, 300), r[::9], [r[0], r[-1]]))
    z = rng.uniform(-1.2, 0.2, len(at))
    lanes = np.stack([np.interp(at, r, lane) for lane in profile.surface.T], axis=-1) - z[:, None]
    within = np.mean(np.maximum(lanes, 0.0), axis=-1)
    assert np.array_equal(profile.depth(at, z), np.where(within > 0.0, within, np.max(lanes, axis=-1)))
    inward = np.sort(at)[::-1]
    bank, loose = np.zeros(len(at)), np.zeros(len(at))
    for own, on_it in zip(profile.bank.T, profile.loose.T, strict=True):
        height, over = np.interp(inward, r, own), np.interp(inward, r, on_it)
        bank += np.maximum(height - z, 0.0)
        loose += np.clip(height + over - z, 0.0, over)
    expected = [
        0.6 * np.append(0.0, np.cumsum(0.5 * (depth[1:] + depth[:-1]) * -np.diff(inward)))
        for depth in (bank / 7, loose / 7)
    ]
    assert np.array_equal(profile.taken(inward, z, width=0.6), expected)


@pytest.mark.parametrize("spacing", [0.004, 0.025, 0.3])
def test_the_floor_of_an_edge_is_the_highest_within_a_step(spacing: float) -> None:
    rng = np.random.default_rng(3)
    own_r = np.arange(1.0, 5.0, spacing)
    own_z = rng.uniform(-1.0, 0.0, len(own_r))
    under = Underground(Profile.level(0.0, 0.5, 6.0), (own_r, own_z), end=1.7, start=4.3)
    step = under.step
    expected = np.maximum(*(np.interp(under.r + off, own_r, own_z) for off in (-step, step)))
    for r, z in zip(own_r.tolist(), own_z.tolist(), strict=True):
        near = np.abs(under.r - r) <= step
        expected[near] = np.maximum(expected[near], z)
    assert np.array_equal(under.floor, expected)
    assert (under.line(3.0, 1.7, Descent(1.4, 1.2)) >= expected - 1e-12).all()


def _plain_heap(terrain: Terrain, place: Vector, total: float) -> Array:
    """(rows, columns) the thickness of a heap before it slumps; the apex is halved 40 times over all columns."""
    start = terrain.surface + np.tan(terrain.repose) * np.hypot(
        terrain.x[None, :] - place[0], terrain.y[:, None] - place[1]
    )
    own = np.unravel_index(int(np.argmin(start - terrain.surface)), start.shape)
    step, is_open = 2.5 * np.tan(terrain.repose) * terrain.cell, np.ones(start.shape, dtype=bool)
    for axis in (0, 1):
        rise = np.diff(terrain.surface, axis=axis)
        for side, steep in (((slice(None, -1)), rise > step), ((slice(1, None)), rise < -step)):
            is_open[(slice(None),) * axis + (side,)] &= ~steep
    is_open[own] = True

    def part(apex: float) -> Array:
        numbers, _ = label((start < apex) & is_open, np.ones((3, 3), dtype=int))
        return np.asarray((numbers == numbers[own]) & (numbers > 0))

    low, high = float(start[own]), float(start[own]) + total
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if (middle - start[part(middle)]).sum() < total else (low, middle)
    covered = part(high)
    # the level at which these columns hold the total, by halving
    low, high = float(start[covered].min()), float(start[covered].min()) + total
    for _ in range(80):
        middle = 0.5 * (low + high)
        enough = np.maximum(middle - start[covered], 0.0).sum() >= total
        low, high = (low, middle) if enough else (middle, high)
    return np.asarray(np.where(covered, np.maximum(high - start, 0.0), 0.0))


@pytest.mark.parametrize("seed", range(6))
def test_a_heap_beside_a_wall_of_a_trench_is_that_of_the_plain_search(seed: int) -> None:
    """Level ground with waves of 2 cm and a trench with upright walls, beside which the heap ends."""
    rng = np.random.default_rng(seed)
    terrain = Terrain.level(0.0, [0.0, 0.0], [5.0, 4.0], cell=0.1, repose=0.6)
    waves = 0.02 * rng.standard_normal(terrain.shape)
    waves[:, 20:26] -= 1.0
    terrain = terrain.with_layers(terrain.bank + waves, terrain.loose)
    place = np.array([rng.uniform(2.9, 3.3), rng.uniform(1.5, 2.5)])
    volume = float(rng.uniform(0.1, 0.6))
    total = volume / terrain.cell**2
    heap = _plain_heap(terrain, place, total)
    assert heap.sum() == pytest.approx(total, rel=1e-9)
    assert _cone(terrain, place, total) == pytest.approx(heap, abs=1e-9)
    # somewhere the heap ends at the trench
    assert (heap[:, 26:28] > 0.1).any()
    assert not heap[:, :26].any()


def test_the_same_cut_is_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two beginnings of a cut coincide at the far end of a lane; cuts that are refused there were searched twice."""
    site = build_worksite(small_job(**DEEP))
    asked: list[tuple[float, float, object, int]] = []
    plain = finding.find_cut

    def noted(*args: Any, **keys: Any) -> Any:
        asked.append((keys["start"], keys["depth"], keys.get("entry"), id(keys["floor"][1])))
        return plain(*args, **keys)

    monkeypatch.setattr(patterns, "find_cut", noted)
    monkeypatch.setattr(patterns._LaneGround, "is_cleared_by", lambda *_: False)
    found = next_cut(site, lanes_of(site), Pattern("face", 0.3), site.ground)
    assert not isinstance(found, NextCut)
    plainly = [one for one in asked if one[2] is None]
    half = len(plainly) // 2  # once as it is, once with the bucket drawn in
    assert half > 3
    assert len(set(plainly[:half])) == half


def test_the_sweep_of_a_cut_is_that_of_its_blade() -> None:
    site = build_worksite(small_job(**DEEP))
    found = next_cut(site, lanes_of(site), Pattern("layers", 0.3), site.ground)
    assert isinstance(found, NextCut)
    assert found.sweep is not None
    assert np.array_equal(found.sweep.bank, patterns.sweep_of(found.cut, site.ground).bank)


def test_a_plan_after_an_estimate_is_that_of_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one pattern prescribed, nothing is left to estimate."""
    plain, estimate = tiny_plan(), estimate_job(job_from_dict(TINY))

    def never(*_: object) -> PatternEstimate:
        raise AssertionError("the pattern was estimated again")

    monkeypatch.setattr("backhoe_planner.job.estimates.estimate_pattern", never)
    plan = plan_estimated(estimate, effort="quick", seed=0)
    assert plan.compared == plain.compared
    assert plan.compared[0].cost == estimate.best.cost
    assert (plan.duration, plan.bank, plan.verdict) == (plain.duration, plain.bank, plain.verdict)
