"""Separating planes that prove that pairs stay apart on a motion, checked against distances along it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from crowds import crowd, lead_at

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import Robot
from backhoe_planner.proof import segment_is_clear
from backhoe_planner.site import Proximity, build_obstacles, scene_from_dict
from backhoe_planner.site.pairs.pair_geometry import PairGeometry

SAMPLES = 15


@pytest.mark.parametrize(("moving", "earlier"), [(False, 0.0), (True, 0.0), (True, 1.0)])
@pytest.mark.parametrize("name", ["planar4", "backhoe", pytest.param("panda", marks=pytest.mark.long)])
def test_pairs_proven_apart_by_a_plane_stay_apart_along_the_whole_motion(
    name: str, moving: bool, earlier: float, request: pytest.FixtureRequest
) -> None:
    """Random motions; most pairs that stay apart by more than the curvature of the motion are proven."""
    robot: Robot = request.getfixturevalue(name)
    proximity, oracle = (crowd(robot, 30, 21, moving=moving, earlier=earlier) for _ in range(2))
    rng = np.random.default_rng(22)
    proven = holds = 0
    for _ in range(60):
        q, time = robot.random_q(rng), float(rng.uniform(0.0, 2.0)) if moving else 0.0
        lead = lead_at(robot, np.zeros(robot.n))
        near = proximity.at_unchecked(q, time=time, margin=0.3, **lead)
        if not len(near):
            continue
        dq, dt = rng.choice([0.003, 0.03, 0.3]) * rng.uniform(-1.0, 1.0, robot.n), 0.02 if moving else 0.0
        parts = np.linspace(0.0, 1.0, SAMPLES)
        there = np.array([oracle.distances_of(near.pair, q + s * dq, time=time + s * dt) for s in parts])
        least = there.min(axis=0) + rng.normal(0.0, 0.01, len(near))
        said = proximity.stay_apart_unchecked(near.pair, least, q + dq, time=time + dt)
        assert (there[:, said] >= least[said] - 1e-9).all()
        to_spare = (there.min(axis=0) > least + 0.003) & (oracle.owner[near.pair] >= 0) & (np.abs(dq).max() < 0.01)
        to_spare &= oracle.appears_at[near.pair] <= time
        proven, holds = proven + int((said & to_spare).sum()), holds + int(to_spare.sum())
    assert holds > 20
    assert proven > 0.7 * holds


def test_motion_along_a_floor_is_proven_where_the_travel_bound_cannot(planar4: Robot) -> None:
    """By hand: the arm turns about its base above a floor and does not come nearer to it."""
    floor = {"name": "floor", "shape": "halfspace", "point": [0, 0, -0.2], "normal": [0, 0, 1], "clearance": 0.0}
    box = {"name": "box", "shape": "box", "size": [20, 20, 1], "position": [0, 0, -0.7], "clearance": 0.0}
    entries: list[dict[str, Any]] = [floor, box]
    scene = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [0, 0, 0]}}, "obstacles": entries}
    proximity = Proximity(planar4, build_obstacles(scene_from_dict(scene), planar4), self_collision=False)
    q_a, q_b = np.zeros(4), np.array([0.1, 0.0, 0.0, 0.0])
    near = proximity.at(q_a)
    spare = float(near.distance.min()) - 0.02  # the far end of the arm moves 0.4 m on an arc that bends by 5 mm
    measured = proximity.measured
    assert segment_is_clear(proximity, q_a, q_b, depth=0, spare=spare)
    assert proximity.measured == measured
    assert not segment_is_clear(proximity, q_a, q_b, spare=spare + 0.03)


def test_measuring_lower_bounds_discards_the_planes(planar4: Robot) -> None:
    proximity = crowd(planar4, 20, 5, moving=False)
    q = np.zeros(4)
    near = proximity.at(q)
    pairs = near.pair[proximity.owner[near.pair] >= 0]
    assert proximity.stay_apart_unchecked(pairs, np.full(len(pairs), -1e3), q, time=0.0).all()
    proximity.lower_bounds(q + 0.1, time=0.0, floor=np.full(len(proximity.pairs), np.inf))
    assert not proximity.stay_apart_unchecked(pairs, np.full(len(pairs), -1e3), q, time=0.0).any()


def test_planes_without_a_unit_normal_prove_nothing(planar4: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """A box inside the arm and a motion of length 0: with a normal of 0 all gaps between corners are 0."""
    entries: list[dict[str, Any]] = [{"name": "box", "shape": "box", "size": [0.2, 0.2, 0.2], "position": [2.5, 0, 0]}]
    scene = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [0, 0, 0]}}, "obstacles": entries}
    proximity = Proximity(planar4, build_obstacles(scene_from_dict(scene), planar4), self_collision=False)
    measured = PairGeometry.measure_each
    for normal in (np.zeros(3), np.full(3, np.nan), 0.5 * np.ones(3), np.array([0.0, 0.0, 2.0])):

        def with_normal(geometry: PairGeometry, pairs: Indices, normal: Vector = normal) -> Matrix:
            found = measured(geometry, pairs)
            found[:, 1:4] = normal
            return found

        monkeypatch.setattr(PairGeometry, "measure_each", with_normal)
        near = proximity.at(np.zeros(4), within=0.5)
        assert near.distance.min() < 0.0
        for least in (0.0, -10.0):
            assert not proximity.stay_apart_unchecked(near.pair, np.full(len(near), least), np.zeros(4), time=0.0).any()
