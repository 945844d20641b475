"""The clearance screen gives the verdict of measuring every pair."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Cluster, TerrainSolid, VoxelSolid, self_pieces
from backhoe_planner.machine.shape.shapes import Piece
from backhoe_planner.native import find_compiled
from backhoe_planner.site import ClearanceScreen, build_obstacles, sweep
from backhoe_planner.site.pairs.certainly_clear import CertainlyClear

TASK = {"path": {"waypoints": [{"position": [1.0, 0.0, 0.0]}, {"position": [1.0, 0.1, 0.0]}]}}
OBSTACLES: list[dict[str, Any]] = [
    {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [0.6, 0.4, 0.5]},
    {"name": "box", "shape": "box", "size": [0.5, 0.2, 1.0], "position": [-0.4, 0.9, 0.4], "rpy": [0.3, 0.2, 0.5]},
    {"name": "pipe", "shape": "capsule", "radius": 0.1, "from": [-3, -1, 0.2], "to": [3, -1.2, 0.1], "clearance": 0.2},
    {"name": "post", "shape": "cylinder", "radius": 0.1, "length": 2.0, "position": [1.5, -0.6, 0.5]},
    {"name": "ground", "shape": "halfspace", "point": [0, 0, -0.3], "normal": [0, 0, 1], "clearance": 0.0},
    {
        "name": "walker", "shape": "capsule", "radius": 0.2, "from": [2, 2, 0], "to": [2, 2, 1.5],
        "velocity": [0, -0.5, 0], "appears_at": 1.0,
    },
]  # fmt: skip


@pytest.mark.parametrize("time", [0.0, 3.0])
def test_the_screen_agrees_with_measuring_every_pair(any_robot: bp.Robot, time: float) -> None:
    scene = bp.scene_from_dict({"version": 1, "task": TASK, "clearance": 0.05, "obstacles": OBSTACLES})
    proximity = bp.Proximity(any_robot, build_obstacles(scene, any_robot))
    rng = np.random.default_rng(1)
    q = np.array([any_robot.random_q(rng) for _ in range(150)])
    distances = np.array([proximity.distances(joints, time=time) for joints in q])
    expected = np.all(distances >= proximity.clearance + 0.01, axis=1)
    assert 0.05 < np.mean(expected) < 0.95
    screen = ClearanceScreen(proximity, time=time, spare=0.01)
    np.testing.assert_array_equal(screen.keeps(q), expected)


@pytest.mark.parametrize("time", [0.0, 3.0])
def test_pairs_called_apart_are_apart(any_robot: bp.Robot, time: float) -> None:
    """Compared with coal, also at neighbouring configurations, where the screen reuses bounds of the last one."""
    scene = bp.scene_from_dict({"version": 1, "task": TASK, "clearance": 0.05, "obstacles": OBSTACLES})
    proximity = bp.Proximity(any_robot, build_obstacles(scene, any_robot))
    screen, rng = ClearanceScreen(proximity, time=time, spare=0.01), np.random.default_rng(3)
    ends = [any_robot.random_q(rng) for _ in range(12)]
    for a, b in itertools.pairwise(ends):
        q = np.linspace(a, b, 8)
        for joints in q:
            apart = proximity.distances(joints, time=time) >= proximity.clearance + 0.01
            not_apart = screen.pairs_not_apart_unchecked(joints)
            if find_compiled():  # which decides all pairs but those of obstacles that appear later
                np.testing.assert_array_equal(not_apart, np.flatnonzero(~apart & (proximity.appears_at <= time)))
            apart[not_apart] = True
            assert apart.all()
        kept = screen.keeps(q).tolist()
        assert screen.first_not_kept_unchecked(q) == [*kept, False].index(False)


@pytest.mark.parametrize(
    "any_robot", ["planar4", "backhoe", "panda", pytest.param("ur5", marks=pytest.mark.long)], indirect=True
)
def test_verdicts_without_coal_equal_those_of_coals_distances(any_robot: bp.Robot) -> None:
    """Balls, boxes, capsules, prisms and half-spaces that overlap the machine, nearly touch it, and are far from it."""
    scene = bp.scene_from_dict({"version": 1, "task": TASK, "clearance": 0.0, "obstacles": OBSTACLES[:-1]})
    proximity = bp.Proximity(any_robot, build_obstacles(scene, any_robot))
    rng, told = np.random.default_rng(6), []
    bodies = [piece for obstacle in proximity.obstacles for piece in obstacle.pieces]
    own = len(self_pieces(any_robot))
    for first, second in itertools.product(range(own), range(own + len(bodies))):
        certainly = CertainlyClear(
            any_robot, bodies, np.zeros((len(bodies), 3)), first=np.array([first]), second=np.array([second]),
            least=np.array([least := rng.uniform(0.001, 0.6)]),
        )  # fmt: skip
        for q in (any_robot.random_q(rng) for _ in range(4 if first != second else 0)):
            distance = _measured(any_robot, q, first, second, bodies)
            told.append(distance >= least)
            if find_compiled():
                assert certainly.first_not_apart(q[None]) == ((1, False) if told[-1] else (0, True))
    assert 20 < sum(told) < len(told) - 20


def _measured(robot: bp.Robot, q: Vector, first: int, second: int, bodies: Sequence[Piece]) -> float:
    """The distance of two pieces by coal [m]; numbers after those of the machine's pieces count through `bodies`."""
    own, data = self_pieces(robot), robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    found = []
    for number in (first, second):
        if number >= len(own):
            found.append((bodies[number - len(own)].shape, bodies[number - len(own)].placement))
            continue
        piece = own[number].piece
        found.append((piece.shape, data.oMi[own[number].joint] * piece.placement))
    transforms = [coal.Transform3s(placement.rotation, placement.translation) for _, placement in found]
    result = coal.DistanceResult()
    coal.distance(found[0][0], transforms[0], found[1][0], transforms[1], coal.DistanceRequest(), result)
    return float(result.min_distance)


def test_the_verdict_changes_within_0_1_um_of_the_clearance(any_robot: bp.Robot) -> None:
    """One pair at a time must keep its own distance less or plus 0.1 um; the others need not keep any."""
    scene = bp.scene_from_dict({"version": 1, "task": TASK, "clearance": 0.05, "obstacles": OBSTACLES[:-1]})
    proximity = bp.Proximity(any_robot, build_obstacles(scene, any_robot))
    rng = np.random.default_rng(4)
    for _ in range(40):
        q = any_robot.random_q(rng)
        distances = proximity.distances(q)
        pair = int(rng.integers(len(distances)))
        spare = np.full(len(distances), -np.inf)
        for more in (-1e-7, 1e-7):
            spare[pair] = distances[pair] - proximity.clearance[pair] + more
            screen = ClearanceScreen(proximity, spare=spare)
            assert screen.keeps(q[None, :]).tolist() == [more < 0.0]


@pytest.mark.parametrize("pieces", [10, 100])
def test_the_screen_agrees_with_measuring_among_few_and_many_obstacles(backhoe: bp.Robot, pieces: int) -> None:
    """Few and many pieces are compared in different ways."""
    rng = np.random.default_rng(5)
    boxes = [
        {
            "name": f"box {number}", "shape": "box", "size": rng.uniform(0.1, 0.5, 3).tolist(),
            "position": rng.uniform([-5.0, -5.0, -1.0], [5.0, 5.0, 4.0]).tolist(),
            "rpy": rng.uniform(-3.0, 3.0, 3).tolist(),
        }
        for number in range(pieces)
    ]  # fmt: skip
    scene = bp.scene_from_dict({"version": 1, "task": TASK, "clearance": 0.1, "obstacles": boxes + OBSTACLES[4:5]})
    proximity = bp.Proximity(backhoe, build_obstacles(scene, backhoe))
    q = np.array([backhoe.random_q(rng) for _ in range(100)])
    expected = [bool((proximity.distances(joints) >= proximity.clearance).all()) for joints in q]
    assert 5 < sum(expected) < 95
    assert ClearanceScreen(proximity).keeps(q).tolist() == expected


@pytest.mark.parametrize("name", ["ball", "box", "pipe", "post", "ground", "walker"])
def test_the_swept_shape_of_an_obstacle_contains_it_at_every_time(backhoe: bp.Robot, name: str) -> None:
    moving = next(one for one in OBSTACLES if one["name"] == name) | {"velocity": [0.3, -0.5, 0.4], "appears_at": 1.0}
    scene = bp.scene_from_dict({"version": 1, "task": TASK, "obstacles": [moving]})
    [obstacle] = build_obstacles(scene, backhoe)
    over_time = bp.Proximity(backhoe, [obstacle], self_collision=False)
    still = bp.Proximity(backhoe, [sweep(obstacle, 2.0, 5.0)], self_collision=False)
    rng = np.random.default_rng(2)
    for _ in range(30):
        q = backhoe.random_q(rng)
        nearest = np.min([over_time.distances(q, time=moment) for moment in (2.0, 2.7, 3.5, 4.4, 5.0)], axis=0)
        apart = still.distances(q)
        # the swept shape is as near as at every time, or nearer, since its round parts are enlarged
        assert np.all((apart <= nearest + 1e-6) | (nearest < 0.0))


def test_a_machine_without_shapes_is_always_clear(tmp_path: Path) -> None:
    file = tmp_path / "bare.urdf"
    file.write_text(
        '<robot name="bare"><link name="base"/><link name="tip"/>'
        '<joint name="turn" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    robot = bp.load_robot(file)
    screen = ClearanceScreen(bp.Proximity(robot, []))
    assert screen.keeps(np.zeros((3, 1))).all()


def test_the_screen_agrees_with_measuring_where_most_obstacles_are_out_of_reach(backhoe: bp.Robot) -> None:
    """More obstacles than coal gets at once; those that no configuration comes near are skipped."""
    rng = np.random.default_rng(6)
    places = [rng.normal(size=3) * [3.0, 3.0, 1.0] * (1.0 if k % 13 == 0 else 15.0) for k in range(520)]
    balls = [
        {"name": f"b{k}", "shape": "sphere", "radius": 0.4, "position": place.tolist(), "clearance": 0.1}
        for k, place in enumerate(places)
    ]
    balls[7] |= {"velocity": [0.0, -1.0, 0.0]}
    scene = bp.scene_from_dict({"version": 1, "task": TASK, "obstacles": balls})
    proximity = bp.Proximity(backhoe, build_obstacles(scene, backhoe))
    q = np.array([backhoe.random_q(rng) for _ in range(30)])
    expected = [bool((proximity.distances(joints, time=2.0) >= proximity.clearance).all()) for joints in q]
    assert 3 <= sum(expected) <= 27
    assert ClearanceScreen(proximity, time=2.0).keeps(q).tolist() == expected


def test_the_screen_agrees_with_measuring_beside_terrain_and_voxels_one_by_one_and_in_batches(
    backhoe: bp.Robot,
) -> None:
    rng = np.random.default_rng(7)
    heights = -1.2 + 0.1 * np.sin(np.arange(61) / 3.0)[:, None] + rng.normal(0.0, 0.03, (61, 61))
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.05, -0.1, 0.4), np.array([0.5, 0.2, 0.0]))
    ground = Cluster(TerrainSolid(heights, (14.0, 14.0), depth=2.0, most=10**6), turned)
    keys = np.unique(rng.integers([35, 10, 0], [45, 20, 10], (300, 3)), axis=0)
    heap = Cluster(VoxelSolid(keys, 0.1, most=10**6), pin.SE3.Identity())
    scene = bp.scene_from_dict({"version": 1, "task": TASK, "clearance": 0.1, "obstacles": OBSTACLES[:1]})
    [ball] = build_obstacles(scene, backhoe)
    proximity = bp.Proximity(backhoe, [ball, *(replace(ball, pieces=(), cluster=one) for one in (ground, heap))])
    q = np.array([backhoe.random_q(rng) for _ in range(120)])
    expected = [bool((proximity.distances(joints) >= proximity.clearance).all()) for joints in q]
    assert 15 < sum(expected) < 105
    screen = ClearanceScreen(proximity)
    assert screen.keeps(q).tolist() == expected
    assert [screen.keeps_unchecked(joints) for joints in q] == expected
    clear = np.array(expected)
    assert screen.keeps_all_unchecked(q[clear])
    assert not screen.keeps_all_unchecked(np.vstack((q[clear], q[~clear][:1])))
