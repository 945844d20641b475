"""Signed distances by hand, their gradients by central differences, and the broad phase by brute force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from machines import TURNING_SLIDE
from numpy.typing import NDArray

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import SceneError
from backhoe_planner.machine import Robot, load_robot, travel_bounds
from backhoe_planner.native import find_compiled
from backhoe_planner.site import (
    Nearby,
    Obstacle,
    Proximity,
    build_obstacle,
    build_obstacles,
    obstacle_from_dict,
    scene_from_dict,
)

needs_native = pytest.mark.skipif(find_compiled() is None, reason="backhoe_planner_native is not installed")
STRETCHED = np.zeros(4)  # link k of planar4 lies along x from k - 1 to k, 8 cm wide and high
STEP = 1e-6


def build(
    robot: Robot, *obstacles: dict[str, Any], folder: Path = Path(), clearance: float = 0.05
) -> tuple[Obstacle, ...]:
    named = [{"name": f"obstacle {index}", **obstacle} for index, obstacle in enumerate(obstacles)]
    scene = {
        "version": 1,
        "start": {"joints": {}},
        "task": {"goal": {"position": [0, 0, 0]}},
        "clearance": clearance,
        "obstacles": named,
    }
    return build_obstacles(scene_from_dict(scene, folder=folder), robot)


def around(robot: Robot, *obstacles: dict[str, Any], folder: Path = Path(), self_collision: bool = False) -> Proximity:
    return Proximity(robot, build(robot, *obstacles, folder=folder), self_collision=self_collision)


def by_link(proximity: Proximity, q: Vector, *, time: float = 0.0) -> dict[str, float]:
    return {pair.link: d for pair, d in zip(proximity.pairs, proximity.distances(q, time=time).tolist(), strict=True)}


def ball(x: float, y: float, z: float = 0.0, radius: float = 0.3, **more: object) -> dict[str, Any]:
    return {"shape": "sphere", "radius": radius, "position": [x, y, z], **more}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with meshes of a block and an L, flat and rough ground, one point and a scan."""
    folder = tmp_path_factory.mktemp("files")
    trimesh.creation.box((0.4, 0.4, 0.4)).export(folder / "block.stl")
    trimesh.util.concatenate(
        [
            trimesh.creation.box((0.6, 0.2, 0.3)),
            trimesh.creation.box((0.2, 0.6, 0.3), pin.SE3(np.eye(3), np.array([0.2, 0.2, 0.0])).homogeneous),
        ]
    ).export(folder / "angle.stl")
    (folder / "flat.csv").write_text("0,0,0\n0,0,0\n")
    rng = np.random.default_rng(0)
    rough = rng.uniform(-0.1, 0.1, (4, 4))
    (folder / "rough.csv").write_text("\n".join(",".join(f"{h:.3f}" for h in row) for row in rough))
    (folder / "point.xyz").write_text("2.55 1.05 0.05\n")
    cloud = rng.uniform(-0.25, 0.25, (40, 3))
    (folder / "scan.xyz").write_text("\n".join(" ".join(f"{c:.4f}" for c in row) for row in cloud))
    return folder


# --- by hand ------------------------------------------------------------------

BY_HAND = {
    "sphere separated": (ball(2.5, 1.0), 1.0 - 0.04 - 0.3),
    "sphere touching": (ball(2.5, 0.34), 0.0),
    "sphere inside": (ball(2.5, 0.2), 0.2 - 0.04 - 0.3),
    "sphere with its centre inside": (ball(2.5, 0.01), 0.01 - 0.04 - 0.3),
    "box separated": ({"shape": "box", "size": [0.4, 0.4, 0.4], "position": [2.5, 1.0, 0.0]}, 1.0 - 0.04 - 0.2),
    "box touching": ({"shape": "box", "size": [0.4, 0.4, 0.4], "position": [2.5, 0.24, 0.0]}, 0.0),
    "box inside": ({"shape": "box", "size": [0.4, 0.4, 0.4], "position": [2.5, 0.1, 0.0]}, 0.1 - 0.04 - 0.2),
    "box on its edge": (
        {"shape": "box", "size": [0.4, 0.4, 0.4], "position": [2.5, 1.0, 0.0], "rpy": [0, 0, np.pi / 4]},
        1.0 - 0.04 - 0.2 * np.sqrt(2.0),
    ),
    "capsule along": ({"shape": "capsule", "from": [2.2, 1.0, 0.0], "to": [2.8, 1.0, 0.0], "radius": 0.1}, 0.86),
    "capsule across": ({"shape": "capsule", "from": [2.5, 1.0, 0.0], "to": [2.5, 2.0, 0.5], "radius": 0.1}, 0.86),
    "capsule upright": ({"shape": "capsule", "from": [2.5, 1.0, -9.0], "to": [2.5, 1.0, 9.0], "radius": 0.1}, 0.86),
    "capsule of no length": ({"shape": "capsule", "from": [2.5, 1.0, 0.0], "to": [2.5, 1.0, 0.0], "radius": 0.1}, 0.86),
    "capsule touching": ({"shape": "capsule", "from": [2.2, 0.14, 0.0], "to": [2.8, 0.14, 0.0], "radius": 0.1}, 0.0),
    "capsule inside": ({"shape": "capsule", "from": [2.2, 0.1, 0.0], "to": [2.8, 0.1, 0.0], "radius": 0.1}, -0.04),
    "half-space separated": ({"shape": "halfspace", "point": [0, -0.5, 0], "normal": [0, 1, 0]}, 0.5 - 0.04),
    "half-space touching": ({"shape": "halfspace", "point": [0, -0.04, 0], "normal": [0, 1, 0]}, 0.0),
    "half-space inside": ({"shape": "halfspace", "point": [0, 0.5, 0], "normal": [0, 2, 0]}, -0.5 - 0.04),
    "half-space overhead": ({"shape": "halfspace", "point": [0, 0, 3], "normal": [0, 0, -1]}, 3.0 - 0.04),
    # measured as the prism of 32 sides around it, one of whose edges faces the link
    "cylinder": (
        {"shape": "cylinder", "radius": 0.2, "length": 2.0, "position": [2.5, 1.0, 0.0]},
        1.0 - 0.04 - 0.2 / np.cos(np.pi / 32),
    ),
    "cylinder from its end": (
        {"shape": "cylinder", "radius": 0.2, "length": 2.0, "position": [2.5, 0.0, 2.0]},
        2.0 - 0.04 - 1.0,
    ),
    "mesh": ({"shape": "mesh", "file": "block.stl", "position": [2.5, 1.0, 0.0]}, 1.0 - 0.04 - 0.2),
    "mesh scaled": ({"shape": "mesh", "file": "block.stl", "position": [2.5, 1.0, 0.0], "scale": 2.0}, 0.96 - 0.4),
    "height map": ({"shape": "heightmap", "file": "flat.csv", "size": [12, 12], "position": [0, 0, -1]}, 1.0 - 0.04),
    "height map inside": ({"shape": "heightmap", "file": "flat.csv", "size": [12, 12]}, -0.04),
    "point cloud": ({"shape": "pointcloud", "file": "point.xyz", "resolution": 0.1}, 1.0 - 0.04),
}


@pytest.mark.parametrize(("obstacle", "expected"), BY_HAND.values(), ids=BY_HAND.keys())
def test_the_signed_distance_to_link3_equals_the_hand_calculation(
    planar4: Robot, files: Path, obstacle: dict[str, Any], expected: float
) -> None:
    assert by_link(around(planar4, obstacle, folder=files), STRETCHED)["link3"] == pytest.approx(expected, abs=1e-6)


def test_distances_to_the_ends_of_other_links_are_those_of_their_corners(planar4: Robot) -> None:
    found = by_link(around(planar4, ball(2.5, 1.0)), STRETCHED)
    assert found["link1"] == pytest.approx(np.hypot(1.5, 0.96) - 0.3, abs=1e-9)
    assert found["link2"] == pytest.approx(np.hypot(0.5, 0.96) - 0.3, abs=1e-9)
    assert found["link4"] == pytest.approx(np.hypot(0.5, 0.96) - 0.3, abs=1e-9)
    assert "base" not in found, "what stands still cannot keep away"


def test_the_record_of_a_pair_equals_the_hand_calculation(planar4: Robot) -> None:
    """The lever arms about joints 1 to 3 are 2.5, 1.5 and 0.5 m; joint 4 is beyond the link."""
    proximity = around(planar4, ball(2.5, 1.0, clearance=0.1))
    near = proximity.at(STRETCHED)
    (row,) = [k for k, index in enumerate(near.pair) if proximity.pairs[index].link == "link3"]
    assert near.distance[row] == pytest.approx(0.66)
    assert near.margin[row] == pytest.approx(0.56)
    np.testing.assert_allclose(near.normal[row], [0.0, 1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(near.point_link[row][:2], [2.5, 0.04], atol=1e-6)
    np.testing.assert_allclose(near.point_obstacle[row], [2.5, 0.7, 0.0], atol=1e-6)
    np.testing.assert_allclose(near.gradient[row], [-2.5, -1.5, -0.5, 0.0], atol=1e-6)
    np.testing.assert_array_equal(proximity.moves[near.pair[row]], [True, True, True, False])
    assert near.drift[row] == 0.0


def test_the_normal_points_from_link_to_obstacle_also_in_overlap(planar4: Robot) -> None:
    for y in (1.0, 0.3, 0.1, 0.01):
        proximity = around(planar4, ball(2.5, y))
        near = proximity.at(STRETCHED)
        row = [proximity.pairs[index].link for index in near.pair].index("link3")
        np.testing.assert_allclose(near.normal[row], [0.0, 1.0, 0.0], atol=1e-6)
        np.testing.assert_allclose(near.gradient[row], [-2.5, -1.5, -0.5, 0.0], atol=1e-5)


def test_the_distance_of_a_folded_arm_to_itself_by_hand(planar4: Robot) -> None:
    """Joints 2 and 3 at right angles: link3 runs back beside link1, 1 m away."""
    proximity = Proximity(planar4, ())
    found = proximity.distances(np.array([0.0, np.pi / 2.0, np.pi / 2.0, 0.0]))
    names = {(pair.obstacle, pair.link): d for pair, d in zip(proximity.pairs, found, strict=True)}
    assert names["link1", "link3"] == pytest.approx(1.0 - 0.08)
    assert names["base", "link3"] == pytest.approx(1.0 - 0.04 - 0.06 / np.cos(np.pi / 32), abs=1e-3)
    assert len(names) == 6
    assert not np.any(proximity.clearance)


# --- gradients ----------------------------------------------------------------

SHAPES: dict[str, dict[str, Any]] = {
    "sphere": {"shape": "sphere", "radius": 0.2},
    "box": {"shape": "box", "size": [0.3, 0.4, 0.5], "rpy": [0.3, -0.5, 0.7]},
    "cylinder": {"shape": "cylinder", "radius": 0.2, "length": 0.6, "rpy": [0.9, 0.2, 0]},
    "capsule": {"shape": "capsule", "radius": 0.15, "from": [-0.2, -0.1, -0.15], "to": [0.2, 0.1, 0.15]},
    "halfspace": {"shape": "halfspace", "point": [0, 0, 0], "normal": [0.2, -0.5, 0.8]},
    "mesh": {"shape": "mesh", "file": "angle.stl", "rpy": [0.4, 0.1, -0.3]},
    "heightmap": {"shape": "heightmap", "file": "rough.csv", "size": [3, 3], "rpy": [0.1, -0.2, 0.3]},
    "pointcloud": {"shape": "pointcloud", "file": "scan.xyz", "resolution": 0.2, "rpy": [0.5, 0.3, 0.1]},
}


def shifted(obstacle: Obstacle, shift: Vector) -> Obstacle:
    pieces = [
        replace(
            piece,
            placement=pin.SE3(piece.placement.rotation, piece.placement.translation + shift),
            hull=piece.hull + shift,
        )
        for piece in obstacle.pieces
    ]
    return replace(obstacle, pieces=tuple(pieces))


def rows_against_differences(proximity: Proximity, q: Vector) -> tuple[Nearby, Vector, NDArray[np.bool_]]:
    """The rows at q, the central differences of their distances, and which rows have no kink here.

    A kink (another pair of features becomes the nearest) shows in one-sided differences
    that disagree; the distance has no derivative there.
    """
    near = proximity.at(q)
    here = proximity.distances(q)[near.pair]
    central = np.zeros_like(near.gradient)
    smooth = np.ones(len(near), dtype=bool)
    for joint in range(len(q)):
        step = np.zeros(len(q))
        step[joint] = STEP
        ahead, behind = proximity.distances(q + step)[near.pair], proximity.distances(q - step)[near.pair]
        central[:, joint] = (ahead - behind) / (2.0 * STEP)
        smooth &= np.abs((ahead - here) - (here - behind)) < 1e-4 * STEP
    return near, central, smooth


def bodies_at(robot: Robot, q: Vector) -> list[Vector]:
    """The middle of every moving piece in the world frame."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return [data.oMi[p.joint].act(p.piece.hull.mean(axis=0)) for p in robot.pieces if p.joint > 0]


@pytest.mark.parametrize("name", ["planar4", "backhoe", "panda"])
@pytest.mark.parametrize("shape", SHAPES)
def test_gradient_agrees_with_central_differences_separated_touching_and_inside(
    name: str, shape: str, files: Path, request: pytest.FixtureRequest
) -> None:
    robot: Robot = request.getfixturevalue(name)
    rng = np.random.default_rng(8)
    (obstacle,) = build(robot, SHAPES[shape], folder=files)
    checked, kinks, states = 0, 0, {"separated": 0, "touching": 0, "inside": 0}
    for sample in range(9):
        q = robot.random_q(rng)
        bodies = bodies_at(robot, q)
        body = bodies[rng.integers(len(bodies))]
        off = rng.normal(size=3)
        at = body + off * (0.05, 0.3, 1.0)[sample % 3] / np.linalg.norm(off)
        proximity = Proximity(robot, [shifted(obstacle, at)], self_collision=False)
        if sample % 3 == 1:  # push it along the normal until the nearest pair touches
            near = proximity.at(q)
            row = int(np.argmin(near.distance))
            at = at - near.distance[row] * near.normal[row]
            proximity = Proximity(robot, [shifted(obstacle, at)], self_collision=False)
        near, central, smooth = rows_against_differences(proximity, q)
        difference = np.abs(near.gradient - central)[smooth]
        assert np.max(difference, initial=0.0) < 1e-6
        checked, kinks = checked + len(near), kinks + int(np.sum(~smooth))
        states["touching"] += int(np.sum(np.abs(near.distance) < 1e-6))
        states["separated"] += int(np.sum(near.distance >= 1e-6))
        states["inside"] += int(np.sum(near.distance <= -1e-6))
    assert kinks <= 0.03 * checked
    assert min(states.values()) > 0, states


@pytest.mark.parametrize("name", ["planar4", "backhoe", "panda"])
def test_gradient_of_self_collision_pairs_agrees_with_central_differences(
    name: str, request: pytest.FixtureRequest
) -> None:
    robot: Robot = request.getfixturevalue(name)
    proximity = Proximity(robot, ())
    rng = np.random.default_rng(9)
    postures = [robot.random_q(rng) for _ in range(400)]
    folded = [q for q in postures if np.min(proximity.distances(q)) < 0.0]
    checked, kinks, inside = 0, 0, 0
    for q in (*postures[:5], *folded[:5]):
        near, central, smooth = rows_against_differences(proximity, q)
        assert np.max(np.abs(near.gradient - central)[smooth], initial=0.0) < 1e-6
        checked, kinks = checked + len(near), kinks + int(np.sum(~smooth))
        inside += int(np.sum(near.distance < 0.0))
    assert checked == 10 * len(proximity.pairs)
    assert kinks <= 0.03 * checked
    assert inside > 0


def test_a_step_along_the_gradient_increases_the_distance(any_robot: Robot) -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = any_robot.random_q(rng)
        middle = np.mean(bodies_at(any_robot, q), axis=0)
        proximity = around(any_robot, {"shape": "sphere", "radius": 0.1, "position": middle.tolist()})
        near = proximity.at(q)
        for row in range(len(near)):
            size = float(np.linalg.norm(near.gradient[row]))
            if size < 1e-6:
                continue
            moved = proximity.distance_of(int(near.pair[row]), q + 1e-6 * near.gradient[row] / size)
            assert moved > near.distance[row]


def test_joints_beyond_a_link_have_gradient_0(any_robot: Robot) -> None:
    proximity = around(any_robot, ball(0.7, 0.4, 0.5, radius=0.1))
    near = proximity.at(any_robot.random_q(np.random.default_rng(0)))
    assert not np.any(near.gradient[~proximity.moves[near.pair]])
    joints = np.array([any_robot.pieces[proximity.pairs[index].piece].joint for index in near.pair])
    np.testing.assert_array_equal(proximity.moves[near.pair].sum(axis=1), joints)


def test_the_distance_changes_by_at_most_the_travel_bound(any_robot: Robot) -> None:
    """The inequality behind the broad phase and the certificate, for obstacles and self-collision pairs."""
    rng = np.random.default_rng(6)
    proximity = around(
        any_robot,
        ball(0.6, 0.5, 0.4),
        {"shape": "box", "size": [1, 1, 1], "position": [1.5, -1, 0.5]},
        self_collision=True,
    )
    for _ in range(60):
        q = any_robot.random_q(rng)
        dq = rng.uniform(-0.4, 0.4, any_robot.n)
        change = np.abs(proximity.distances(q + dq) - proximity.distances(q))
        assert np.all(change <= proximity.travel @ np.abs(dq) + 1e-9)


# --- broad phase --------------------------------------------------------------


def cluttered(robot: Robot, seed: int, count: int = 25) -> Proximity:
    rng = np.random.default_rng(seed)
    built = build(robot, *(SHAPES[name] for name in ("sphere", "box", "capsule", "cylinder")))
    return Proximity(robot, [shifted(built[k % 4], rng.uniform([-3, -3, -1.5], [4, 3, 2.5])) for k in range(count)])


@pytest.mark.parametrize("name", ["planar4", "backhoe", "panda"])
@pytest.mark.parametrize("jumps", [False, True])
def test_the_broad_phase_finds_the_pairs_of_brute_force(name: str, jumps: bool, request: pytest.FixtureRequest) -> None:
    robot: Robot = request.getfixturevalue(name)
    rng = np.random.default_rng(12)
    proximity, oracle = cluttered(robot, 12), cluttered(robot, 12)
    q = robot.random_q(rng)
    steps, found = 120, 0
    for step in range(steps):
        within = float(rng.choice([0.05, 0.1, 0.2]))
        if jumps and step % 10 == 0:
            q = robot.random_q(rng)
        q = np.clip(q + rng.uniform(-0.01, 0.01, robot.n), robot.limits.lower, robot.limits.upper)
        near = proximity.at(q, within=within)
        truth = oracle.distances(q)
        certain = np.abs(truth - within) > 1e-8
        listed = np.isin(np.arange(len(truth)), near.pair)
        np.testing.assert_array_equal(listed[certain], (truth <= within)[certain])
        np.testing.assert_allclose(near.distance, truth[near.pair], atol=1e-8)
        found += len(near)
    assert found > 0
    if not jumps:
        assert proximity.measured < 0.35 * steps * len(proximity.pairs)


@needs_native
@pytest.mark.parametrize("self_collision", [True, False])
@pytest.mark.parametrize("name", ["planar4", "backhoe", "panda"])
def test_near_pairs_of_many_configurations_equal_those_of_each(
    name: str, self_collision: bool, request: pytest.FixtureRequest
) -> None:
    """The compiled distances compared with coal's, with half-space, ball, box and cylinder around."""
    robot, rng = request.getfixturevalue(name), np.random.default_rng(4)
    obstacles = build(
        robot,
        {"shape": "halfspace", "point": [0, 0, -0.5], "normal": [0.1, 0, 1]},
        ball(0.6, 0.5, 0.4),
        {"shape": "box", "size": [0.5, 0.2, 0.9], "position": [-0.7, 0.4, 0.3], "rpy": [0.2, 0.4, 0.1]},
        {"shape": "cylinder", "radius": 0.2, "length": 0.8, "position": [1.5, -0.9, 0.2], "rpy": [0.6, 0, 0]},
    )
    proximity, other = (Proximity(robot, obstacles, self_collision=self_collision) for _ in range(2))
    rows = touching = 0
    for step in range(4):  # separating planes of earlier steps are tried again
        q = np.array([robot.random_q(rng) for _ in range(60)])
        margin = rng.uniform(0.05, 0.4, 60)
        known = np.full((60, len(proximity.pairs)), -np.inf if step < 3 else 1e3)
        found = proximity.near_in_each_unchecked(q, margin, known)
        assert found is not None
        if step == 3:
            assert len(found.row) == 0
            continue
        for row in range(60):
            true, those = other.distances(q[row]), found.row == row
            nearby = other.at(q[row], margin=float(margin[row]))
            np.testing.assert_array_equal(found.pair[those], nearby.pair)
            np.testing.assert_allclose(found.distance[those], nearby.distance, atol=1e-7)
            clear = np.abs(nearby.distance) > 1e-4  # a normal at a corner that just touches is not precise
            np.testing.assert_allclose(found.gradient[those][clear], nearby.gradient[clear], atol=1e-5)
            assert (found.lower[row] <= true + 1e-7).all()
            rows, touching = rows + len(nearby), touching + int(np.count_nonzero(nearby.distance < 0.0))
    assert rows > 150
    assert touching > 20


def test_near_pairs_of_many_configurations_are_not_computed_for_moving_or_later_obstacles(planar4: Robot) -> None:
    q, margin = np.zeros((1, 4)), np.full(1, 0.1)
    for more in ({"velocity": [0.1, 0, 0]}, {"appears_at": 1.0}):
        proximity = around(planar4, ball(9.0, 0.0, **more))
        assert proximity.near_in_each_unchecked(q, margin, np.full((1, len(proximity.pairs)), -np.inf)) is None


def test_100_spheres_50_m_away_are_not_measured_within_1_m(backhoe: Robot) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 100)
    far = [ball(50.0 * np.cos(a), 50.0 * np.sin(a), 0.0) for a in angles]
    proximity = around(backhoe, *far)
    assert len(proximity.pairs) == 100 * sum(piece.joint > 0 for piece in backhoe.pieces)
    rng = np.random.default_rng(0)
    q = backhoe.middle
    for _ in range(100):
        q = q + rng.uniform(-0.01, 0.01, 4)
        assert len(proximity.at(q, within=1.0)) == 0
    assert proximity.measured == 0
    assert len(proximity.at(q)) == len(proximity.pairs)


def test_1000_obstacles_have_the_distances_of_ten_groups_of_100(backhoe: Robot) -> None:
    """Near and far, fixed and moving: more than coal gets at once."""
    rng = np.random.default_rng(2)
    shapes = build(backhoe, *(SHAPES[name] for name in ("sphere", "box", "capsule", "halfspace")))
    places = [rng.normal(size=3) * [3.0, 3.0, 1.0] * (1.0 if k % 20 == 0 else 20.0) for k in range(999)]
    obstacles = [shifted(shapes[k % 3], place) for k, place in enumerate(places)]
    obstacles[5:8] = [replace(one, velocity=np.array([1.0, 0.0, -0.5])) for one in obstacles[5:8]]
    obstacles.append(shifted(shapes[3], np.array([0.0, 3.0, -15.0])))
    proximity = Proximity(backhoe, obstacles, self_collision=False)
    few = [Proximity(backhoe, obstacles[k : k + 100], self_collision=False) for k in range(0, 1000, 100)]
    near = 0
    for q, time in zip([backhoe.random_q(rng) for _ in range(6)], range(6), strict=True):
        truth = np.concatenate([one.distances(q, time=float(time)) for one in few])
        assert np.all(proximity.floor <= truth + 1e-9)
        found = proximity.at(q, time=float(time), margin=1.0)
        np.testing.assert_array_equal(found.pair, np.flatnonzero(truth - proximity.clearance <= 1.0))
        np.testing.assert_allclose(found.distance, truth[found.pair], atol=1e-9)
        near += len(found)
    assert near > 50
    assert (proximity.floor > 1.0).mean() > 0.5
    assert proximity.measured < 0.3 * 6 * len(proximity.pairs)
    np.testing.assert_allclose(proximity.distances(q, time=5.0), truth, atol=1e-9)


def test_a_pair_is_measured_again_when_its_bound_is_used_up(planar4: Robot) -> None:
    """The ball is a quarter turn away from the stretched arm, which turns until they overlap."""
    proximity = around(planar4, ball(0.0, 2.5))
    assert len(proximity.at(STRETCHED, within=0.1)) == 0
    for angle in np.linspace(0.0, np.pi / 2.0, 30):
        near = proximity.at(np.array([angle, 0.0, 0.0, 0.0]), within=0.1)
    assert near.distance.min() == pytest.approx(-0.34, abs=1e-6)


def test_lower_bounds_never_exceed_the_distance_and_equal_it_where_measured(backhoe: Robot) -> None:
    rng = np.random.default_rng(5)
    proximity, oracle = cluttered(backhoe, 5, 8), cluttered(backhoe, 5, 8)
    floor = np.full(len(proximity.pairs), 0.3)
    q = backhoe.middle
    skipped = 0
    for _ in range(40):
        q = np.clip(q + rng.uniform(-0.03, 0.03, 4), backhoe.limits.lower, backhoe.limits.upper)
        lower, measured = proximity.lower_bounds(q, time=0.0, floor=floor)
        truth = oracle.distances(q)
        assert np.all(lower <= truth + 1e-9)
        np.testing.assert_allclose(lower[measured], truth[measured], atol=1e-9)
        assert np.all(lower[~measured] >= floor[~measured])
        skipped += int(np.sum(~measured))
    assert skipped > 0


def test_within_and_only_select_rows(planar4: Robot) -> None:
    proximity = around(planar4, ball(2.5, 1.0))
    near = proximity.at(STRETCHED, within=0.7)
    assert [proximity.pairs[index].link for index in near.pair] == ["link3"]
    everything = proximity.at(STRETCHED)
    assert len(everything) == 4
    chosen = everything.only(everything.distance > 0.7)
    assert len(chosen) == 3
    assert chosen.gradient.shape == (3, 4)


def test_the_margin_counts_from_the_clearance_of_each_obstacle(planar4: Robot) -> None:
    """Both balls are 0.66 m from link3; the one with a clearance of 0.5 m is 0.16 m beyond it."""
    proximity = around(planar4, ball(2.5, 1.0, clearance=0.5), ball(2.5, -1.0, clearance=0.1))
    near = proximity.at(STRETCHED, margin=0.2)
    assert [(proximity.pairs[k].obstacle, proximity.pairs[k].link) for k in near.pair] == [("obstacle 0", "link3")]
    assert near.margin == pytest.approx([0.16])
    assert len(proximity.at(STRETCHED, margin=0.2, within=0.6)) == 0
    assert set(proximity.owner[proximity.at(STRETCHED, margin=0.6).pair]) == {0, 1}


def is_proven(proximity: Proximity, q: Vector, time: float = 0.0) -> bool:
    """Whether the last measurement proves the straight motion from there to q."""
    return not len(proximity.unproven_unchecked(q, time=time))


def test_a_motion_is_proven_without_measuring_up_to_the_travel_bound(planar4: Robot) -> None:
    """Link4's far corner is nearest; joint 4 moves it at most hypot(1, 0.04) a radian."""
    proximity = around(planar4, ball(3.5, 1.0, clearance=0.1))
    assert not is_proven(proximity, STRETCHED), "nothing was measured yet"
    distance = proximity.at(STRETCHED).margin.min()
    before = proximity.measured
    assert distance == pytest.approx(0.56)
    turn = np.array([0.0, 0.0, 0.0, 0.56 / np.hypot(1.0, 0.04)])
    assert is_proven(proximity, 0.999 * turn)
    assert not is_proven(proximity, 1.001 * turn)
    assert proximity.measured == before
    assert proximity.is_at(STRETCHED)
    assert not proximity.is_at(turn)
    assert not proximity.is_at(STRETCHED, time=0.1)


def test_a_bound_of_nan_does_not_keep_a_pair_from_being_measured(planar4: Robot) -> None:
    """The ball is 0.66 m from link3, and its bound is nan."""
    proximity = around(planar4, ball(2.5, 1.0, clearance=0.1))
    known = np.full(len(proximity.pairs), np.nan)
    assert proximity.at(STRETCHED, within=0.7, known=known).distance.min() == pytest.approx(0.66)
    lower, measured = around(planar4, ball(2.5, 1.0)).lower_bounds(
        STRETCHED, time=0.0, floor=np.full(len(known), 0.7), known=known
    )
    assert lower.min() == pytest.approx(0.66)
    assert measured[lower.argmin()]


def test_a_proof_without_measuring_counts_the_obstacles_own_motion(planar4: Robot) -> None:
    """2.66 m from link3, a clearance of 0.05 m, 1 m/s."""
    proximity = around(planar4, ball(2.5, 3.0, velocity=[0, -1, 0]))
    proximity.at(STRETCHED, time=0.0)
    assert is_proven(proximity, STRETCHED, time=2.60)
    assert not is_proven(proximity, STRETCHED, time=2.62)


def test_balls_and_blocks_that_just_touch_have_distance_0(planar4: Robot) -> None:
    """Where shapes just touch, coal's iterations can end without a depth and return minus infinity."""
    rng = np.random.default_rng(2)
    for _ in range(60):
        turn = rng.uniform(-np.pi, np.pi, 3).tolist()
        far = around(planar4, {"shape": "box", "size": [0.3, 0.4, 0.5], "position": [2.5, 2.0, 0.0], "rpy": turn})
        apart = far.at(STRETCHED)
        nearest = int(np.argmin(apart.distance))
        shift = -apart.distance[nearest] * apart.normal[nearest]
        touching = Proximity(planar4, [shifted(far.obstacles[0], shift)], self_collision=False)
        found = touching.at(STRETCHED)
        assert np.min(np.abs(found.distance)) < 1e-6
        assert np.all(np.isfinite(found.distance))
        assert np.all(np.isfinite(found.gradient))
        np.testing.assert_allclose(touching.distances(STRETCHED)[found.pair], found.distance, atol=1e-9)


def test_face_on_face_has_distance_0_where_coal_returns_minus_infinity(planar4: Robot) -> None:
    """Link1 hangs down to y = -1 onto a block, link2 continues inside it; the last digits reproduce the failure."""
    q = np.array([-1.5707963267948966, 0.0, 0.0, -1.5707963267948966])
    block = {"shape": "box", "size": [4, 1, 2], "position": [6.123233995733704e-17, -1.500000000000913, 0.0]}
    proximity = around(planar4, block)
    raw_model, raw_data = proximity.geometry
    assert by_link(proximity, q)["link1"] == pytest.approx(0.0, abs=1e-6)
    assert pin.computeDistance(raw_model, raw_data, 0).min_distance < -1e6, "coal has learnt it: the detour may go"
    assert by_link(proximity, q)["link2"] == pytest.approx(-1.0, abs=1e-6)
    assert proximity.distance_of(0, q) == pytest.approx(0.0, abs=1e-6)
    near = proximity.at(q)
    assert near.distance[0] == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.isfinite(near.gradient))
    lower, _ = proximity.lower_bounds(q, time=0.0, floor=np.full(4, np.inf))
    np.testing.assert_allclose(lower, near.distance, atol=1e-6)


def box_distance(low: Vector, high: Vector, other_low: Vector, other_high: Vector) -> float:
    """Signed distance of two axis-aligned boxes, from their lowest and highest corners."""
    gap = np.maximum(low - other_high, other_low - high)
    return float(np.max(gap)) if np.all(gap <= 0.0) else float(np.linalg.norm(np.maximum(gap, 0.0)))


def test_flush_faces_have_the_distance_of_the_closed_formula_for_boxes(planar4: Robot) -> None:
    """Walls of a site and links at right angles are aligned with the axes: faces and middles coincide.

    There coal has called a block half a metre inside a link 1e-12 m away from it.
    """
    rng = np.random.default_rng(137)
    size = np.array([4.0, 1.0, 2.0])
    (block,) = build(planar4, {"shape": "box", "size": size.tolist()})
    data = planar4.model.createData()
    touching = inside = 0
    for sample in range(200):
        q = rng.choice([0.0, np.pi / 2.0, -np.pi / 2.0], 4)
        at = np.round(2.0 * rng.uniform(-3.0, 3.0, 3)) / 2.0 * [1.0, 1.0, 0.2]
        at += rng.choice([0.0, 1e-12, -1e-12, 1e-9, -1e-9, 1e-7], 3)
        if sample == 0:
            q, at = np.array([np.pi / 2.0, -np.pi / 2.0, 0.0, 0.0]), np.array([-0.5, 1.0, 1e-12])
        pin.forwardKinematics(planar4.model, data, q)
        proximity = Proximity(planar4, [shifted(block, at)], self_collision=False)
        expected = []
        for pair in proximity.pairs:
            piece = planar4.pieces[pair.piece]
            corners = np.array([data.oMi[piece.joint].act(point) for point in piece.piece.hull])
            expected.append(box_distance(corners.min(axis=0), corners.max(axis=0), at - size / 2.0, at + size / 2.0))
        for _ in range(2):  # coal starts from its last result
            np.testing.assert_allclose(proximity.at(q).distance, expected, atol=1e-6)
            np.testing.assert_allclose(proximity.distances(q), expected, atol=1e-6)
        touching += int(np.sum(np.abs(expected) < 1e-6))
        inside += int(np.sum(np.array(expected) < -0.1))
    assert touching > 50
    assert inside > 50


def test_a_machine_of_one_joint_has_gradients_of_one_column(tmp_path: Path) -> None:
    """A door 2 m wide between two balls: it approaches one as it leaves the other."""
    file = tmp_path / "door.urdf"
    file.write_text(
        '<robot name="door"><link name="wall"/><link name="door"><collision><origin xyz="1 0 0"/>'
        '<geometry><box size="2 0.1 2"/></geometry></collision></link>'
        '<joint name="hinge" type="revolute"><parent link="wall"/><child link="door"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    near = around(load_robot(file), ball(1.0, 1.0), ball(1.5, -1.0)).at(np.zeros(1))
    assert near.distance == pytest.approx([1.0 - 0.05 - 0.3] * 2)
    np.testing.assert_allclose(near.gradient, [[-1.0], [1.5]], atol=1e-6)


def test_without_near_pairs_the_record_is_empty_with_the_right_shapes(planar4: Robot) -> None:
    for proximity in (around(planar4), around(planar4, ball(100.0, 0.0))):
        near = proximity.at(STRETCHED, within=1.0)
        assert len(near) == 0
        assert near.gradient.shape == (0, 4)
        assert near.normal.shape == near.point_link.shape == (0, 3)


# --- obstacles that move and appear -------------------------------------------


def test_the_distance_to_a_moving_obstacle_over_time_by_hand(planar4: Robot) -> None:
    """It comes from y = 3 at 1 m/s: 2.66 m away, and 1 m less each second."""
    proximity = around(planar4, ball(2.5, 3.0, velocity=[0, -1, 0]))
    for time in (0.0, 1.0, 2.0, 2.66, 2.9, 0.5, 0.0):
        assert by_link(proximity, STRETCHED, time=time)["link3"] == pytest.approx(2.66 - time, abs=1e-9)


@pytest.mark.parametrize(("velocity", "drift"), [([0, -1, 0], -1.0), ([0, 2, 0], 2.0), ([3, 0, 0], 0.0)])
def test_the_drift_is_negative_where_the_obstacle_approaches(
    planar4: Robot, velocity: list[float], drift: float
) -> None:
    proximity = around(planar4, ball(2.5, 1.0, velocity=velocity))
    near = proximity.at(STRETCHED)
    row = [proximity.pairs[index].link for index in near.pair].index("link3")
    assert near.drift[row] == pytest.approx(drift, abs=1e-6)


def test_the_drift_is_the_time_derivative_of_every_row(backhoe: Robot) -> None:
    proximity = around(backhoe, ball(3.0, 1.0, 0.5, velocity=[-0.3, -0.4, 0.2]), ball(3.0, -2.0, 0.5))
    q = np.array([0.2, 0.3, -1.2, -0.5])
    near = proximity.at(q, time=1.0)
    ahead, behind = (proximity.distances(q, time=1.0 + dt)[near.pair] for dt in (STEP, -STEP))
    np.testing.assert_allclose(near.drift, (ahead - behind) / (2.0 * STEP), atol=1e-6)


def test_an_obstacle_counts_from_the_time_it_appears(planar4: Robot) -> None:
    proximity = around(planar4, ball(2.5, 3.0, appears_at=2.0, velocity=[0, -1, 0]), ball(2.5, -3.0))
    assert set(proximity.owner[proximity.at(STRETCHED, time=1.999).pair]) == {1}
    assert np.all(np.isinf(proximity.distances(STRETCHED, time=1.999)[proximity.owner == 0]))
    for time, expected in ((2.0, 2.66), (3.0, 1.66)):
        near = proximity.at(STRETCHED, time=time)
        assert set(proximity.owner[near.pair]) == {0, 1}
        row = [proximity.pairs[index].link for index in near.pair].index("link3")
        assert near.distance[row] == pytest.approx(expected, abs=1e-9)
    assert set(proximity.owner[proximity.at(STRETCHED, time=0.0).pair]) == {1}, "and back in time"


def test_an_obstacle_moves_from_the_time_it_appears(planar4: Robot) -> None:
    proximity = around(planar4, ball(2.5, 3.0, appears_at=2.0, velocity=[0, -1, 0]))
    np.testing.assert_array_equal(proximity.obstacle_offset(0, 1.0), [0.0, 0.0, 0.0])
    np.testing.assert_array_equal(proximity.obstacle_offset(0, 3.5), [0.0, -1.5, 0.0])


@pytest.mark.parametrize("first", [0.0, 0.5])
def test_an_obstacle_that_appeared_before_the_clock_began_is_where_it_is_by_then(planar4: Robot, first: float) -> None:
    """As on the clock of a later leg of a sequence: after 2 s at 1 m/s it is at y = 1 and 0.66 m away."""
    (obstacle,) = build(planar4, ball(2.5, 3.0, velocity=[0, -1, 0]))
    proximity = Proximity(planar4, [replace(obstacle, appears_at=-2.0)], self_collision=False)
    for time in (first, 0.25, 0.0):
        assert by_link(proximity, STRETCHED, time=time)["link3"] == pytest.approx(0.66 - time, abs=1e-9)


def test_a_stale_cache_does_not_hide_an_obstacle_that_moved_while_the_arm_was_at_rest(planar4: Robot) -> None:
    """Pink's cache is keyed on q alone and misses an obstacle that moves."""
    proximity = around(planar4, ball(2.5, 3.0, velocity=[0, -1, 0]))
    assert len(proximity.at(STRETCHED, time=0.0, within=0.1)) == 0
    near = proximity.at(STRETCHED, time=2.6, within=0.1)
    assert near.distance == pytest.approx([0.06])
    assert len(proximity.at(STRETCHED, time=0.1, within=0.1)) == 0
    assert proximity.at(STRETCHED, time=2.6, within=0.1).distance == pytest.approx([0.06])


def test_a_stale_cache_does_not_hide_a_moved_obstacle_in_lower_bounds(planar4: Robot) -> None:
    proximity = around(planar4, ball(2.5, 3.0, velocity=[0, -1, 0]))
    floor = np.full(4, 0.1)
    proximity.lower_bounds(STRETCHED, time=0.0, floor=floor)
    lower, measured = proximity.lower_bounds(STRETCHED, time=2.6, floor=floor)
    assert measured[2]
    assert lower[2] == pytest.approx(0.06)


@pytest.mark.parametrize("seed", range(3))
def test_the_broad_phase_finds_the_pairs_of_brute_force_among_moving_obstacles(planar4: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    obstacles = [
        ball(
            *rng.uniform(-4, 4, 2),
            velocity=[*rng.uniform(-1, 1, 2), 0.0],
            appears_at=float(rng.choice([0.0, 1.0, 2.0])),
        )
        for _ in range(10)
    ]
    proximity, oracle = around(planar4, *obstacles), around(planar4, *obstacles)
    q, found = planar4.random_q(rng), 0
    for _ in range(150):
        q = q + rng.uniform(-0.02, 0.02, 4)
        time = float(rng.uniform(0.0, 4.0))
        near = proximity.at(q, time=time, within=0.3)
        truth = oracle.distances(q, time=time)
        certain = ~(np.abs(truth - 0.3) < 1e-8)
        listed = np.isin(np.arange(len(truth)), near.pair)
        np.testing.assert_array_equal(listed[certain], (truth <= 0.3)[certain])
        found += len(near)
    assert found > 0


# --- links and clearances -----------------------------------------------------


def test_an_obstacle_for_some_links_has_no_pairs_with_the_others(planar4: Robot) -> None:
    proximity = around(planar4, ball(2.5, 1.0, links=["link4", "link2"]), ball(1.0, 1.0))
    assert [(p.obstacle, p.link) for p in proximity.pairs if p.obstacle == "obstacle 0"] == [
        ("obstacle 0", "link2"),
        ("obstacle 0", "link4"),
    ]
    assert sum(pair.obstacle == "obstacle 1" for pair in proximity.pairs) == 4


def test_an_unknown_link_is_an_error_that_suggests_the_nearest(planar4: Robot) -> None:
    with pytest.raises(SceneError, match=r"obstacles\[0\] \(obstacle 0\)\.links: .*found lnk4.*did you mean 'link4'\?"):
        build(planar4, ball(2.5, 1.0, links=["lnk4"]))


def test_an_obstacle_has_its_own_clearance_or_that_of_the_scene(planar4: Robot) -> None:
    obstacles = build(
        planar4, ball(2.5, 1.0, clearance=0.5), ball(2.5, -1.0), ball(2.5, 2.0, clearance=0), clearance=0.2
    )
    proximity = Proximity(planar4, obstacles, self_collision=False)
    assert [obstacle.clearance for obstacle in obstacles] == [0.5, 0.2, 0.0]
    near = proximity.at(STRETCHED)
    np.testing.assert_allclose(near.margin, near.distance - np.repeat([0.5, 0.2, 0.0], 4), atol=1e-15)


def test_the_travel_of_self_collision_pairs_counts_only_the_joints_between(planar4: Robot) -> None:
    proximity = Proximity(planar4, ())
    bounds = travel_bounds(planar4)
    for pair, travel in zip(proximity.pairs, proximity.travel, strict=True):
        inner = int(pair.obstacle.removeprefix("link").replace("base", "0"))
        np.testing.assert_array_equal(travel[:inner], np.zeros(inner))
        np.testing.assert_array_equal(travel[inner:], bounds[pair.piece][inner:])


def test_two_proximity_objects_share_no_state(planar4: Robot) -> None:
    obstacles: Sequence[Obstacle] = build(planar4, ball(2.5, 3.0, velocity=[0, -1, 0]))
    first, second = (Proximity(planar4, obstacles, self_collision=False) for _ in range(2))
    first.at(STRETCHED, time=2.0)
    assert by_link(second, STRETCHED, time=0.0)["link3"] == pytest.approx(2.66)
    np.testing.assert_array_equal(obstacles[0].pieces[0].placement.translation, [2.5, 3.0, 0.0])


def test_bounds_for_a_slide_beyond_its_limit_stay_below_the_distance(tmp_path: Path) -> None:
    """A ball of radius 0.1 m, 1.5 m from the hinge where 0.5 m are allowed, turns by 0.8 rad into another."""
    path = tmp_path / "slide.urdf"
    path.write_text(TURNING_SLIDE)
    robot, out, angle = load_robot(path), 1.5, 0.8
    record = {"name": "post", "shape": "sphere", "radius": 0.1, "links": ["ball"]}
    there = obstacle_from_dict({**record, "position": [out * np.cos(angle), out * np.sin(angle), 0.0]})
    proximity = Proximity(robot, [build_obstacle(there, folder=Path(), clearance=0.0)])
    chord = 2.0 * out * np.sin(0.5 * angle)
    first = proximity.at(np.array([0.0, out]))
    np.testing.assert_allclose(first.distance, [chord - 0.2], atol=1e-9)
    touching = proximity.at(np.array([angle, out]), within=0.3)
    np.testing.assert_allclose(touching.distance, [-0.2], atol=1e-9)
    proximity.at(np.array([0.0, out]))
    assert not is_proven(proximity, np.array([angle, out]))
