"""The nearest points of every frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from backhoe_planner.machine import Robot
from backhoe_planner.motion import build_problem
from backhoe_planner.show.drawing.timeline import ITSELF, critical_points, obstacle_names
from backhoe_planner.site import Proximity, load_scene

SCENE = """
version: 1
start: {joints: {swing: 0.0, boom: 0.6, stick: -1.4, bucket: -0.9}}
task: {goal: {position: [3.0, 1.0, 0.2]}}
obstacles:
  - {name: field, shape: heightmap, file: field.csv, size: [16.0, 16.0], position: [0, 0, -0.6], clearance: 0.05}
  - {name: stone, shape: sphere, radius: 0.4, position: [3.5, 1.2, -0.2], clearance: 0.1}
  - {name: far, shape: sphere, radius: 0.4, position: [30.0, 0.0, 0.0]}
  - {name: heap, shape: pointcloud, file: heap.csv, resolution: 0.2}
"""


def test_the_nearest_point_of_each_obstacle_is_that_of_all_pairs(backhoe: Robot, tmp_path: Path) -> None:
    """Near ground one pair is measured before the others, and which one changes from frame to frame."""
    rng, within = np.random.default_rng(5), 1.2
    np.savetxt(tmp_path / "field.csv", rng.uniform(-0.15, 0.15, (40, 40)), delimiter=",")
    heap = rng.uniform([4.5, 1.5, 0.0], [6.0, 3.0, 0.6], (400, 3))
    np.savetxt(tmp_path / "heap.csv", heap, delimiter=",", fmt="%.4f")
    (tmp_path / "scene.yaml").write_text(SCENE, encoding="utf-8")
    problem = build_problem(backhoe, load_scene(tmp_path / "scene.yaml"))
    proximity, alone = (Proximity(backhoe, problem.obstacles) for _ in range(2))
    names, owners = obstacle_names(problem, proximity), [0, 1, 2, 3, -1]
    assert names == ("field", "stone", "far", "heap", ITSELF)
    links = set()
    for part in np.linspace(0.0, 1.0, 25):
        q = np.array([0.8 * part, 0.7 - 0.5 * part, -1.9 + 1.2 * part, -1.6 + 2.4 * part])
        found = critical_points(proximity, names, q, time=0.0, within=within)
        distances = np.array([alone.distance_of(pair, q) for pair in range(len(alone.pairs))])
        for owner, point in zip(owners, found, strict=True):
            own = alone.owner == owner
            least = float(np.min((distances - alone.clearance)[own]))
            if point is None:
                assert np.min(distances[own]) > within
                continue
            assert abs(point.margin - least) < 1e-6
            assert abs(np.linalg.norm(point.point_link - point.point_obstacle) - abs(point.distance)) < 1e-6
        assert found[0] is not None
        links.add(found[0].link)
    assert len(links) > 1
