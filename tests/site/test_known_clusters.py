"""Scans and terrains in use are loaded once, as long as their files do not change."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backhoe_planner.machine import Robot
from backhoe_planner.site import Obstacle, Proximity, build_obstacles, known_clusters, scene_from_dict
from backhoe_planner.site.schema.obstacle_shapes import PointCloud


def write(folder: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    np.savetxt(folder / "yard.xyz", np.column_stack((rng.uniform(-4.0, 4.0, (3000, 2)), rng.normal(-2.5, 0.1, 3000))))


def built(robot: Robot, folder: Path, **keys: Any) -> Obstacle:
    scan = {"name": "yard", "shape": "pointcloud", "file": "yard.xyz", "resolution": 0.1} | keys
    joints = dict.fromkeys(robot.joint_names, 0.0)
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"joints": joints}}, "obstacles": [scan]}
    (found,) = build_obstacles(scene_from_dict(content, folder=folder), robot)
    return found


def solid(obstacle: Obstacle) -> object:
    assert obstacle.cluster is not None
    return obstacle.cluster.solid


def test_obstacles_share_a_loaded_file_if_resolution_and_origin_are_equal(planar4: Robot, tmp_path: Path) -> None:
    write(tmp_path, 0)
    first = built(planar4, tmp_path)
    other = built(planar4, tmp_path, name="ground", clearance=0.3, links=["link4"])
    assert solid(other) is solid(first)
    assert solid(built(planar4, tmp_path, position=[0.0, 0.0, 0.5])) is solid(first)
    for keys in ({"resolution": 0.2}, {"map_origin": [0.0, 0.0, 0.5]}):
        assert solid(built(planar4, tmp_path, **keys)) is not solid(first)


def test_a_shared_file_at_another_place_is_as_near_as_one_loaded_there(planar4: Robot, tmp_path: Path) -> None:
    write(tmp_path, 0)
    elsewhere = {"position": [0.3, -0.2, 0.7], "rpy": [0.1, 0.2, 1.0]}
    first = built(planar4, tmp_path)
    Proximity(planar4, [first]).at(np.zeros(planar4.n))  # builds what the other place will share
    moved = built(planar4, tmp_path, **elsewhere)
    assert solid(moved) is solid(first)
    known_clusters._KNOWN.clear()
    anew = built(planar4, tmp_path, **elsewhere)
    assert solid(anew) is not solid(first)
    rng = np.random.default_rng(4)
    for q in rng.uniform(-1.5, 1.5, (20, planar4.n)):
        shared, own = (Proximity(planar4, [one]).at(q, within=5.0) for one in (moved, anew))
        np.testing.assert_allclose(shared.distance, own.distance, atol=1e-12)


def test_a_changed_file_is_read_again(planar4: Robot, tmp_path: Path) -> None:
    write(tmp_path, 0)
    first = built(planar4, tmp_path)
    write(tmp_path, 1)
    second = built(planar4, tmp_path)
    assert solid(second) is not solid(first)
    write(tmp_path, 0)
    assert solid(built(planar4, tmp_path)) is solid(first)
    assert solid(second) is not solid(first)


def test_distances_to_a_shared_cluster_equal_those_to_a_newly_loaded_one(planar4: Robot, tmp_path: Path) -> None:
    write(tmp_path, 0)
    first = built(planar4, tmp_path)
    again = built(planar4, tmp_path)
    known_clusters._KNOWN.clear()
    anew = built(planar4, tmp_path)
    assert solid(again) is solid(first)
    assert solid(anew) is not solid(first)
    rng = np.random.default_rng(2)
    known, other = (Proximity(planar4, [one]) for one in (again, anew))
    for q in rng.uniform(-1.5, 1.5, (20, planar4.n)):
        np.testing.assert_array_equal(known.distances(q), other.distances(q))


def test_clusters_no_longer_in_use_are_dropped(planar4: Robot, tmp_path: Path) -> None:
    write(tmp_path, 0)
    found = built(planar4, tmp_path)
    key = known_clusters._key(found.spec, tmp_path)
    assert key in known_clusters._KNOWN
    del found
    gc.collect()
    assert key not in known_clusters._KNOWN


def test_a_file_that_changes_while_it_is_read_is_not_kept(
    planar4: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known_clusters._KNOWN.clear()  # another test's cluster of the same points may not have been collected yet
    write(tmp_path, 0)
    read = PointCloud.body

    def body(self: PointCloud, folder: Path) -> Any:
        write(folder, 1)
        return read(self, folder)

    monkeypatch.setattr(PointCloud, "body", body)
    first = built(planar4, tmp_path)
    monkeypatch.undo()
    write(tmp_path, 0)
    assert solid(built(planar4, tmp_path)) is not solid(first)
