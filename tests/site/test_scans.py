"""A machine beside thousands of cells: one obstacle, whose distance is the least over all cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.errors import InputError
from backhoe_planner.machine import Robot, voxel_boxes
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import (
    ClearanceScreen,
    Obstacle,
    Proximity,
    build_obstacle,
    obstacle_from_dict,
    read_heights,
    read_points,
)
from backhoe_planner.site.distances.cluster_distances import EXACT_WITHIN


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Obstacle:
    folder = tmp_path_factory.mktemp("scan")
    rng = np.random.default_rng(3)
    heap = rng.normal([2.5, 0.8, 0.0], [0.6, 0.4, 0.3], (150, 3))
    np.savetxt(folder / "heap.csv", heap, delimiter=",", fmt="%.4f")
    record = {"name": "heap", "shape": "pointcloud", "file": "heap.csv", "resolution": 0.1, "position": [0, 0, 0.02]}
    return build_obstacle(obstacle_from_dict(record), folder=folder, clearance=0.05)


@pytest.fixture(scope="module")
def boxes(scan: Obstacle) -> Obstacle:
    """The same scan as one convex piece per box."""
    assert scan.cluster is not None
    points = scan.cluster.solid.near(*scan.cluster.bounds).middle.T
    pieces = tuple(
        shapes.box(size, scan.cluster.placement * pin.SE3(np.eye(3), centre))
        for centre, size in voxel_boxes(points, 0.1)
    )
    return replace(scan, cluster=None, pieces=pieces)


def by_link_piece(proximity: Proximity, distances: np.ndarray) -> dict[int, float]:
    found: dict[int, float] = {}
    for pair, distance in zip(proximity.pairs, distances.tolist(), strict=True):
        found[pair.piece] = min(found.get(pair.piece, np.inf), distance)
    return found


def below(proximity: Proximity, pair: int, floor: float, q: np.ndarray) -> float:
    return float(proximity.distances_below_unchecked(np.array([pair]), np.array([floor]), q, time=0.0)[0])


def test_distances_and_bounds_of_a_scan_agree_with_those_of_its_boxes(
    planar4: Robot, scan: Obstacle, boxes: Obstacle
) -> None:
    one = Proximity(planar4, [scan], self_collision=False)
    many = Proximity(planar4, [boxes], self_collision=False)
    assert len(one.pairs) < 10 < 300 < len(many.pairs)
    rng = np.random.default_rng(4)
    q = np.array([planar4.random_q(rng) for _ in range(12)])
    kept = ClearanceScreen(one).keeps(q)
    met = set()
    for row, keeps in zip(q, kept.tolist(), strict=True):
        true = by_link_piece(many, many.distances(row))
        found = by_link_piece(one, one.distances(row))
        lower, measured = one.lower_bounds(row, time=0.0, floor=one.clearance + 0.3)
        near = one.at(row, margin=0.3)
        for index, pair in enumerate(one.pairs):
            least = true[pair.piece]
            exact = one.distance_of(index, row)
            met.add("inside" if least < 0.0 else "far" if least > EXACT_WITHIN else "near")
            if least > 0.0:
                assert exact == pytest.approx(least, abs=1e-8)
                assert found[pair.piece] == pytest.approx(least, abs=1e-8) or EXACT_WITHIN <= found[pair.piece] <= least
                assert below(one, index, least - 1e-6, row) >= least - 1e-6
            else:
                assert exact < 1e-9
            assert below(one, index, least + 1e-6, row) < least + 1e-6
            assert lower[index] == pytest.approx(exact) if measured[index] else lower[index] <= exact + 1e-9
            assert measured[index] or lower[index] >= one.clearance[index] + 0.3
            assert (index in near.pair) == (exact - one.clearance[index] <= 0.3)
        assert keeps == all(true[pair.piece] >= 0.05 for pair in one.pairs)
        tightest, of_boxes = one.tightest(row), many.tightest(row)
        assert tightest is not None
        assert of_boxes is not None
        if of_boxes.distance > 0.0:
            assert tightest.distance == pytest.approx(of_boxes.distance, abs=1e-8)
    assert met == {"inside", "near", "far"}


def test_the_gradient_agrees_with_central_differences_of_the_distance(planar4: Robot, scan: Obstacle) -> None:
    proximity = Proximity(planar4, [scan], self_collision=False)
    rng, step, checked = np.random.default_rng(5), 1e-6, 0
    for _ in range(20):
        q = planar4.random_q(rng)
        near = proximity.at(q, within=0.4)
        for row, pair in enumerate(near.pair.tolist()):
            if near.distance[row] < 0.0:
                continue
            for joint, way in enumerate(step * np.eye(planar4.n)):
                ends = [proximity.distance_of(pair, q + sign * way) for sign in (1.0, -1.0)]
                slopes = [(ends[0] - near.distance[row]) / step, (near.distance[row] - ends[1]) / step]
                if abs(slopes[0] - slopes[1]) < 1e-4:  # otherwise another cell is as near
                    assert near.gradient[row, joint] == pytest.approx(0.5 * sum(slopes), abs=1e-4)
                    checked += 1
    assert checked > 20


def test_fast_reading_of_plain_tables_gives_the_numbers_in_the_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    numbers = rng.normal(size=(50, 4))
    np.savetxt(tmp_path / "a.csv", numbers, delimiter=",", fmt="%.9f")
    np.savetxt(tmp_path / "a.xyz", numbers, fmt="%.9f")
    headed = "x,y,z,w\n" + (tmp_path / "a.csv").read_text(encoding="utf-8")
    (tmp_path / "b.csv").write_text(headed, encoding="utf-8")
    for name in ("a.csv", "a.xyz", "b.csv"):
        np.testing.assert_allclose(read_points(tmp_path / name), numbers[:, :3], atol=1e-9)
    np.testing.assert_allclose(read_heights(tmp_path / "a.csv"), numbers, atol=1e-9)


@pytest.mark.parametrize(
    ("record", "text", "parts"),
    [
        ({"shape": "heightmap", "size": [4.0, 4.0]}, "1,,2\n3,4,5\n", ["row 1, column 2", "found nothing"]),
        ({"shape": "heightmap", "size": [4.0, 4.0]}, "1,2\n3,deep\n", ["row 2, column 2", "found deep"]),
        (
            {"shape": "pointcloud", "resolution": 0.1},
            "0,0,0\n9000,0,0\n" + "0,0,0.5\n" * 3,
            ["90,001 voxels along x", "65,000"],
        ),
    ],
)
def test_errors_in_surveys_name_file_and_place(
    tmp_path: Path, record: dict[str, object], text: str, parts: list[str]
) -> None:
    if record["shape"] == "pointcloud":  # more than a few boxes
        rng = np.random.default_rng(7)
        text += "\n".join(",".join(f"{value:.3f}" for value in row) for row in rng.uniform(0.0, 5.0, (200, 3)))
    (tmp_path / "survey.csv").write_text(text, encoding="utf-8")
    spec = obstacle_from_dict({"name": "ground", "file": "survey.csv", **record})
    with pytest.raises(InputError) as caught:
        build_obstacle(spec, folder=tmp_path, clearance=0.05)
    for part in (str(tmp_path / "survey.csv"), *parts):
        assert part in str(caught.value)


@pytest.mark.parametrize("machine", ["planar4", "backhoe"])
def test_batched_bounds_never_exceed_the_distance_of_each_configuration(
    machine: str, scan: Obstacle, request: pytest.FixtureRequest
) -> None:
    robot: Robot = request.getfixturevalue(machine)
    moving = replace(scan, name="moving", velocity=np.array([0.1, -0.2, 0.05]), appears_at=1.0)
    proximity = Proximity(robot, [scan, moving], self_collision=False)
    clusters = proximity.clusters
    rng = np.random.default_rng(5)
    q, times = np.array([robot.random_q(rng) for _ in range(30)]), rng.uniform(0.0, 4.0, 30)
    coarse = clusters.lower_each(q, times, needed=-np.inf)
    some = clusters.lower_each(q, times, needed=0.3)
    fine = clusters.lower_each(q, times)
    true = np.array(
        [[proximity.distance_of(k, at, time=t) for k in range(len(clusters))] for at, t in zip(q, times, strict=True)]
    )
    assert (coarse <= some).all()
    assert (some <= fine).all()
    assert (fine <= np.maximum(true, 0.0) + 1e-9).all()
    assert (some == fine)[fine < 0.3].all()
    assert (coarse < fine).any()
    assert (fine > 0.3).any()
    assert (fine[true < 0.0] == -np.inf).all()


def test_expecting_configurations_keeps_bounds_and_distances_valid(backhoe: Robot, scan: Obstacle) -> None:
    moving = replace(scan, velocity=np.array([0.1, -0.2, 0.05]))
    rng = np.random.default_rng(6)
    q = np.array([backhoe.random_q(rng) for _ in range(12)])
    for obstacle in (scan, moving):
        plain, ahead = (Proximity(backhoe, [obstacle]) for _ in range(2))
        ahead.clusters.expect(q, 1.5, needed=np.full(len(ahead.clusters), 0.2))
        for time in (1.5, 0.5):  # the second is not the expected time
            for row in q:
                floor = plain.clearance + rng.uniform(0.0, 0.5, len(plain.pairs))
                (bounds, measured), (alike, also) = (
                    one.lower_bounds(row, time=time, floor=floor) for one in (plain, ahead)
                )
                true = np.array([plain.distance_of(k, row, time=time) for k in range(len(plain.pairs))])
                for found, exact in ((bounds, measured), (alike, also)):
                    assert found[exact] == pytest.approx(true[exact], abs=1e-9)
                    assert (found <= true + 1e-9).all()
                    assert (found >= np.minimum(floor, true) - 1e-9).all()


def test_bounds_of_links_moved_by_one_joint_are_tight_from_the_second_call(planar4: Robot, scan: Obstacle) -> None:
    """An interval's bound is 1 cm below the distance at its middle, which differs by at most 1 cm from any within."""
    moving = replace(scan, name="moving", velocity=np.array([0.1, -0.2, 0.05]))
    proximity = Proximity(planar4, [scan, moving], self_collision=False)
    rng = np.random.default_rng(8)
    swings = rng.uniform(-0.6, 1.0, 20)
    q = np.array([[swing, *rng.uniform(-1.0, 1.0, 3)] for swing in np.tile(swings, 3)])
    bounds = proximity.clusters.lower_each(q, 0.0)
    true = np.array([[proximity.distance_of(k, row) for k in range(len(proximity.clusters))] for row in q])
    assert (bounds <= np.maximum(true, 0.0) + 1e-9).all()
    first = np.array([planar4.pieces[row].joint == 1 for row in proximity.clusters.piece.tolist()])
    asked, near = first & (proximity.clusters.owner == 0), (true > 0.02) & (true < EXACT_WITHIN)
    again = np.arange(len(q)) >= len(swings)
    checked = near & asked & again[:, None]
    assert (bounds >= true - 0.02 - 1e-9)[checked].all()
    assert np.count_nonzero(checked) >= 10
    assert (bounds < true - 0.02)[near & asked & ~again[:, None]].any()


def test_cached_distances_equal_those_of_a_fresh_measurement(planar4: Robot, scan: Obstacle) -> None:
    proximity = Proximity(planar4, [scan], self_collision=False)
    rng = np.random.default_rng(9)
    kept = 0
    for _ in range(12):
        q = planar4.random_q(rng)
        for reach in (0.05, 1.0, 0.3, 2.0):
            fresh = Proximity(planar4, [scan], self_collision=False)
            found, true = (one.at(q, within=reach) for one in (proximity, fresh))
            np.testing.assert_array_equal(found.pair, true.pair)
            np.testing.assert_allclose(found.distance, true.distance, atol=1e-9)
            np.testing.assert_allclose(found.gradient, true.gradient, atol=1e-6)
            kept += len(found)
    assert kept > 20
