"""Halved parts of a braking path, and planes kept from one look to the next."""

import math

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner import Proximity, Robot, build_obstacles
from backhoe_planner.arrays import Vector
from backhoe_planner.live import (
    BrakingPath,
    Placements,
    Separation,
    is_exact_bound,
    least_gaps_at,
    look_closely,
    measure_pair,
    renew_plane,
)

ROUND = {"name": "round", "shape": "sphere", "radius": 0.4, "position": [4.5, 1.0, 0.8]}


def braking(robot: Robot, separation: Separation, q: Vector, v: Vector) -> BrakingPath:
    return BrakingPath(
        q, v, 0.001,
        acceleration=tuple(robot.limits.acceleration.tolist()),
        furthest=separation.furthest, turning=separation.turning,
    )  # fmt: skip


def test_halved_parts_are_placed_on_the_same_line(backhoe: Robot) -> None:
    """Rows 0 .. 2p hold q + k / (2 p) delta; the deviation from a chord falls with the square of its length."""
    separation, at = Separation(backhoe, self_collision=False), Placements(backhoe, 18)
    q = np.array([0.1, 0.3, -0.9, -0.5])
    path = braking(backhoe, separation, q, 0.6 * backhoe.limits.velocity)
    at.place(0, q)
    path.place(at)
    parts, off = path.parts, path.off_chord(separation.travel)
    path.halve(at)
    assert path.parts == 2 * parts
    np.testing.assert_allclose(path.off_chord(separation.travel), off / 4.0, rtol=1e-12)
    other = Placements(backhoe, 1)
    for sample in range(2 * parts + 1):
        other.place(0, q + sample / (2 * parts) * path.delta)
        np.testing.assert_allclose(at.T[sample], other.T[0], atol=1e-12)
        np.testing.assert_allclose(at.J[sample], other.J[0], atol=1e-12)


def test_kept_planes_bound_other_paths_until_the_obstacle_moves(backhoe: Robot) -> None:
    """Against 60 configurations along each path, measured one by one. The second look needs no measurement."""
    joints = dict(zip(backhoe.joint_names, [0.0, 0.3, -0.9, -0.5], strict=True))
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": joints},
            "task": {"goal": {"position": [4.0, 2.0, 0.5]}},
            "obstacles": [ROUND],
        }
    )
    built = build_obstacles(scene, backhoe)
    separation, at = Separation(backhoe, self_collision=False), Placements(backhoe, 18)
    pairs = separation.add({0: built[0]})
    shift = np.zeros(3)
    separation.place_at(0, shift)
    proximity = Proximity(backhoe, built, self_collision=False)
    rng = np.random.default_rng(11)
    tightest = np.inf
    q, v = np.array([-0.3, 0.1, -0.9, -0.5]), np.array([0.5, -0.1, 0.2, 0.1])
    for turn in range(8):
        path = braking(backhoe, separation, q, v + 0.02 * rng.normal(size=4))
        at.place(0, q)
        path.place(at)
        true = np.min([proximity.distances(q + s * path.delta) for s in np.linspace(0.0, 1.0, 60)], axis=0)
        for pair, least in zip(pairs.tolist(), true.tolist(), strict=True):
            enough = least - 0.03 if turn else math.inf
            before = separation.measured
            bound, _ = look_closely(separation, pair, path, at, 0.0, enough=enough)
            assert bound <= least + 2e-6
            if turn and bound >= enough and separation.measured == before:
                tightest = min(tightest, least - bound)
    assert tightest < 0.03  # kept planes did prove paths
    shift[:] = 0.0, 0.0, 0.3
    before = separation.measured
    look_closely(separation, int(pairs[0]), path, at, 0.0, enough=-1.0)
    assert separation.measured > before


def test_a_bound_counts_as_exact_only_if_it_misses_less_than_the_tolerance(backhoe: Robot) -> None:
    """Checked by another measurement; after small moves most bounds are exact."""
    joints = dict(zip(backhoe.joint_names, [0.0, 0.3, -0.9, -0.5], strict=True))
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": joints},
            "task": {"goal": {"position": [4.0, 2.0, 0.5]}},
            "obstacles": [ROUND],
        }
    )
    separation, at = Separation(backhoe), Placements(backhoe, 1)
    separation.add({0: build_obstacles(scene, backhoe)[0]})
    separation.place_at(0, np.zeros(3))
    rng, said = np.random.default_rng(12), []
    for turn in range(16):
        q, small = rng.uniform(-0.4, 0.4, 4) + np.array([0.2, 0.3, -0.9, -0.5]), turn < 8
        at.place(0, q)
        pairs = range(len(separation))
        before = [renew_plane(separation, pair, at, 0) for pair in pairs]
        assert all(is_exact_bound(separation, pair, at, 0, before[pair], 1e-6) for pair in pairs if before[pair] > 0.0)
        at.place(0, q + (0.003 if small else 0.1) * rng.normal(size=4))
        for pair, bound in zip(pairs, least_gaps_at(separation, np.array(pairs), at, 0).tolist(), strict=True):
            true, *_ = measure_pair(separation, pair, at, 0)
            exact = is_exact_bound(separation, pair, at, 0, bound, 1e-3)
            assert not exact or bound >= true - 1e-3 - 2e-6
            if small and true > 0.0:
                said.append(exact)
    assert np.mean(said) > 0.5
    separation.velocity[:] = 0.1
    assert not any(is_exact_bound(separation, pair, at, 0, np.inf, 1e-3) for pair in pairs)


@pytest.mark.parametrize(
    "flat",
    [
        {"name": "ground", "shape": "halfspace", "point": [0, 0, -2.0], "normal": [0, 0, 1]},
        {"name": "slab", "shape": "box", "size": [40.0, 40.0, 1.0], "position": [0, 0, -2.5]},
    ],
    ids=["halfspace", "box"],
)
def test_the_planes_of_links_that_swing_over_level_ground_stay_exact(backhoe: Robot, flat: dict[str, object]) -> None:
    """Their points keep their heights, so none has to be measured again; a bound that is 1 cm lower is not exact."""
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": 0.0, "boom": 0.5, "stick": -1.2, "bucket": -0.6}},
            "task": {"goal": {"position": [4.0, 2.0, 0.5]}},
            "obstacles": [flat],
        }
    )
    separation, at = Separation(backhoe), Placements(backhoe, 1)
    pairs = separation.add({0: build_obstacles(scene, backhoe)[0]})
    separation.place_at(0, np.zeros(3))
    q = np.array([0.0, 0.5, -1.2, -0.6])
    at.place(0, q)
    before = [renew_plane(separation, pair, at, 0) for pair in pairs.tolist()]
    q[0] = 0.8
    at.place(0, q)
    for pair, distance in zip(pairs.tolist(), before, strict=True):
        assert measure_pair(separation, pair, at, 0)[0] == pytest.approx(distance, abs=1e-6)
        assert is_exact_bound(separation, pair, at, 0, distance, 1e-5)
        assert not is_exact_bound(separation, pair, at, 0, distance - 0.01, 1e-5)
