"""Links over ground: results for many at once compared with measuring each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner import Robot
from backhoe_planner.machine import BatchKinematics, Cluster, LinkPiece, Reading, TerrainSolid
from backhoe_planner.native import find_compiled, plain_versions
from backhoe_planner.site import build_obstacles, scene_from_dict
from backhoe_planner.site.distances.cluster_distances import ClusterDistances
from backhoe_planner.site.pairs import over_ground
from backhoe_planner.site.pairs.link_balls import LinkBalls
from backhoe_planner.site.pairs.link_corners import KEPT, NEARER
from backhoe_planner.site.pairs.over_ground import OverGround

needs_native = pytest.mark.skipif(find_compiled() is None, reason="the compiled functions are not installed")


def ground_beside(robot: Robot, roughness: float, rng: np.random.Generator) -> Cluster:
    """Uneven, tilted and turned ground about half a metre below the boom's foot."""
    heights = rng.uniform(-0.5, 1.0) + roughness * rng.uniform(size=(51, 61))
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.05, -0.03, 0.4), np.array([0.3, -0.2, 0.0]))
    return Cluster(TerrainSolid(heights, (18.0, 15.0), depth=3.0, most=10**6), placement)


@needs_native
@pytest.mark.parametrize("roughness", [0.0, pytest.param(0.3, marks=pytest.mark.long)])
def test_verdicts_and_readings_of_many_links_equal_those_of_each_link(backhoe: Robot, roughness: float) -> None:
    rng = np.random.default_rng(int(10 * roughness))
    pieces = [own for own in backhoe.pieces if own.joint]
    balls = LinkBalls(pieces, most=(4,))
    over = OverGround(pieces, balls)
    kinematics, data = BatchKinematics(backhoe), backhoe.model.createData()
    verdicts, distances = [], []
    for _ in range(4):
        cluster = ground_beside(backhoe, roughness, rng)
        q = np.array([backhoe.random_q(rng) for _ in range(12)])
        rows, which = (part.ravel() for part in np.indices((len(q), len(pieces))))
        least = rng.uniform(0.02, 0.4, len(rows))
        poses = balls.poses_of(kinematics.at(q))
        verdict = over.keep(cluster, poses, rows, which, least, cluster.grid(np.zeros(3), 9.0))
        reading = over.measure(cluster, poses, rows, which, least)
        given_up: set[int] = set()
        for k, (row, number) in enumerate(zip(rows.tolist(), which.tolist(), strict=True)):
            pin.forwardKinematics(backhoe.model, data, q[row])
            own = pieces[number]
            found = cluster.measure(own.piece, data.oMi[own.joint], float(least[k]))
            verdicts.append(int(verdict[k]))
            if row in given_up:
                assert verdict[k] not in (KEPT, NEARER)
            elif verdict[k] == NEARER:
                assert found is not None
                given_up.add(row)
            elif verdict[k] == KEPT:
                assert found is None
            one = reading[k]
            if one == "far":
                assert found is None
            elif isinstance(one, Reading):
                assert found is not None
                distances.append(one.distance)
                assert one.distance == pytest.approx(found.distance, abs=1e-9)
                np.testing.assert_allclose(one.other_point - one.point, one.distance * one.normal, atol=1e-5)
                assert np.linalg.norm(one.normal) == pytest.approx(1.0, abs=1e-12)
    assert min(verdicts.count(KEPT), verdicts.count(NEARER), len(distances)) > 10


@needs_native
def test_there_is_no_verdict_beside_the_map(backhoe: Robot) -> None:
    """There its walls are as near as its cells."""
    pieces = [own for own in backhoe.pieces if own.joint]
    balls = LinkBalls(pieces, most=(4,))
    over = OverGround(pieces, balls)
    q = np.zeros((1, backhoe.n))
    poses = balls.poses_of(BatchKinematics(backhoe).at(q))
    data = backhoe.model.createData()
    pin.forwardKinematics(backhoe.model, data, q[0])
    piece = len(pieces) - 1
    corners = pieces[piece].piece.hull @ data.oMi[pieces[piece].joint].rotation.T
    corners += data.oMi[pieces[piece].joint].translation
    # the edge of the map is 10 cm beside the last link, at its own height
    edge = np.array([float(corners[:, 0].max()) + 0.1 + 2.0, 0.0, float(corners[:, 2].mean()) + 0.5])
    cluster = Cluster(TerrainSolid(np.zeros((41, 41)), (4.0, 4.0), depth=3.0, most=10**6), pin.SE3(np.eye(3), edge))
    asked = (np.array([0]), np.array([piece]), np.array([0.3]))
    assert over.keep(cluster, poses, *asked, cluster.grid(np.zeros(3), 9.0)).tolist() == [-1]
    assert over.measure(cluster, poses, *asked) == [None]
    found = cluster.measure(pieces[piece].piece, data.oMi[pieces[piece].joint], 0.3)
    assert found is not None
    assert found.distance == pytest.approx(0.1, abs=1e-6)


def corners_at(robot: Robot, own: LinkPiece, q: np.ndarray) -> np.ndarray:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    place = data.oMi[own.joint]
    return np.asarray(own.piece.hull @ place.rotation.T + place.translation)


@pytest.mark.parametrize("version", ["plain", pytest.param("compiled", marks=needs_native)])
@pytest.mark.parametrize("slope", [0.05, 0.3, -0.6])
def test_a_sunk_links_depth_is_that_of_its_lowest_corner_below_the_ground_plane(
    backhoe: Robot, slope: float, version: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On ground of even slope along x: the normal points into the ground, and the depth changes along it."""
    if version == "plain":
        monkeypatch.setattr(over_ground, "read_over_ground", plain_versions()["read_over_ground"])
    pieces = [own for own in backhoe.pieces if own.joint]
    balls = LinkBalls(pieces, most=(4,))
    over = OverGround(pieces, balls)
    x = np.linspace(-12.0, 12.0, 49)
    ground = TerrainSolid(np.tile(slope * x, (41, 1)), (24.0, 20.0), depth=50.0, most=10**6)
    cluster = Cluster(ground, pin.SE3.Identity())
    rng, step, depths = np.random.default_rng(3), 1e-6, 0
    normal = np.array([slope, 0.0, -1.0]) / np.hypot(slope, 1.0)
    for _ in range(20):
        q = backhoe.random_q(rng)
        around = np.vstack((q, q + step * np.eye(backhoe.n)))
        poses = balls.poses_of(BatchKinematics(backhoe).at(around))
        for which, own in enumerate(pieces):
            depth = corners_at(backhoe, own, q) @ normal
            lowest = int(depth.argmax())
            # either of two equally low corners may be used
            if depth[lowest] <= 0.01 or np.sort(depth)[-2] > depth[lowest] - 1e-4:
                continue
            rows, those = np.arange(len(around)), np.full(len(around), which)
            readings = over.measure(cluster, poses, rows, those, np.full(len(rows), 0.2), sunk=True)
            found, *moved = (one for one in readings if isinstance(one, Reading))
            depths += 1
            assert found.distance == pytest.approx(-depth[lowest] - own.piece.radius, abs=1e-9)
            np.testing.assert_allclose(found.normal, normal, atol=1e-9)
            np.testing.assert_allclose(found.other_point - found.point, found.distance * normal, atol=1e-9)
            for at, one in zip(around[1:], moved, strict=True):
                travel = corners_at(backhoe, own, at)[lowest] - corners_at(backhoe, own, q)[lowest]
                assert one.distance - found.distance == pytest.approx(-float(travel @ normal), abs=1e-9)
    assert depths > 15


@needs_native
def test_configurations_that_are_not_finite_get_no_verdict_and_no_reading(backhoe: Robot) -> None:
    pieces = [own for own in backhoe.pieces if own.joint]
    balls = LinkBalls(pieces, most=(4,))
    over, rng = OverGround(pieces, balls), np.random.default_rng(0)
    cluster, which = ground_beside(backhoe, 0.1, rng), np.arange(len(pieces))
    for wrong in (np.nan, np.inf):
        poses = balls.poses_of(BatchKinematics(backhoe).at(np.zeros((1, backhoe.n))))
        poses.t[:] = wrong
        asked = np.zeros(len(pieces), dtype=np.intp), which, np.full(len(pieces), 0.1)
        assert not (over.keep(cluster, poses, *asked, cluster.grid(np.zeros(3), 9.0)) == KEPT).any()
        assert over.measure(cluster, poses, *asked, sunk=True) == [None] * len(pieces)


@pytest.mark.parametrize("reach", [0.0, -0.05, 0.3])
def test_expecting_configurations_does_not_change_the_distances(backhoe: Robot, reach: float, tmp_path: Path) -> None:
    """All pairs at configurations beside and in the ground; rough depths are forgotten first, as they would differ."""
    rng, data = np.random.default_rng(1), backhoe.model.createData()
    np.savetxt(tmp_path / "ground.csv", rng.uniform(-0.3, 0.0, (81, 81)), delimiter=",")
    ground = {"name": "ground", "shape": "heightmap", "file": "ground.csv", "size": [16.0, 16.0]}
    scene = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [4, 0, 1]}}, "obstacles": [ground]}
    obstacles = build_obstacles(scene_from_dict(scene, folder=tmp_path), backhoe)
    fresh, asked = ClusterDistances(backhoe, obstacles), ClusterDistances(backhoe, obstacles)
    assert len(fresh) > 3
    q = np.array([backhoe.random_q(rng) for _ in range(8)])
    needed = np.full(len(asked), 0.4)
    for sunk in (False, True):
        asked.expect(q, 0.0, needed=needed, sunk=sunk)
        if sunk:
            asked.forget_expected()
        for at in q:
            pin.forwardKinematics(backhoe.model, data, at)
            for pair in range(len(asked)):
                one, other = (
                    each.nearest(pair, data, 0.0, lower=-np.inf, reach=reach, q=at) for each in (fresh, asked)
                )
                assert (one is None) == (other is None)
                if one is not None and other is not None:
                    assert one.distance == pytest.approx(other.distance, abs=1e-9)
