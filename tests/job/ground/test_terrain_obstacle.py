"""Ground from memory has the distances of the same heights from a file, also after digging."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from small_jobs import TINY

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError
from backhoe_planner.job import (
    BladeSweep,
    Terrain,
    build_worksite,
    deposited,
    job_from_dict,
    swept,
    terrain_obstacle,
)
from backhoe_planner.job.ground.grids import HeightGrid
from backhoe_planner.job.ground.obstacle import ground_around, ground_beyond, surface_beyond
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import Obstacle, build_obstacle, obstacle_from_dict


def from_file(terrain: Terrain, folder: Path) -> Obstacle:
    np.savetxt(folder / "ground.csv", terrain.surface, delimiter=",", fmt="%.17g")
    middle = 0.5 * (terrain.low + terrain.high)
    record = {
        "name": "ground", "shape": "heightmap", "file": "ground.csv",
        "size": (terrain.high - terrain.low).tolist(), "position": [*middle.tolist(), 0.0],
    }  # fmt: skip
    return build_obstacle(obstacle_from_dict(record), folder=folder, clearance=0.1)


def distances(obstacle: Obstacle, rng: np.random.Generator) -> Vector:
    assert obstacle.cluster is not None
    body = shapes.capsule(0.1, 0.5, pin.SE3.Identity())
    found = []
    for _ in range(60):
        place = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-2.0, 2.0, 3)), rng.uniform([0, -3, -1], [6, 3, 1]))
        reading = obstacle.cluster.measure(body, place)
        assert reading is not None
        found.append(reading.distance)
    return np.array(found)


def test_distances_to_ground_from_memory_equal_those_to_a_file_after_every_step(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    terrain = Terrain.level(0.0, (0.0, -3.0), (6.0, 3.0))
    terrain = terrain.with_layers(0.05 * rng.uniform(size=terrain.shape), terrain.loose)
    obstacle = terrain_obstacle(terrain, "ground", 0.1)
    shared = 0
    for step in range(4):
        found = distances(obstacle, np.random.default_rng(step))
        expected = distances(from_file(terrain, tmp_path), np.random.default_rng(step))
        apart = expected > 0.0
        assert 10 < apart.sum() < 50
        np.testing.assert_allclose(found[apart], expected[apart], atol=1e-9)
        np.testing.assert_allclose(found, expected, atol=1e-5)  # depths are found by iteration
        if step % 2 == 0:
            edge = np.array([[2.0, 0.2, -0.2 - 0.1 * step], [4.0, 0.2, -0.2 - 0.1 * step]])
            terrain = swept(terrain, BladeSweep(edge, np.array([0.0, 1.0, 0.0]), 0.6)).terrain
        else:
            after = deposited(terrain, (3.0, -1.5), 1.0)
            assert isinstance(after, Terrain)
            terrain = after
        before, obstacle = obstacle, terrain_obstacle(terrain, "ground", 0.1, before=obstacle)
        trees = [one.cluster.solid._trees for one in (before, obstacle)]  # type: ignore[union-attr]
        shared += sum(trees[1].get(tile) is tree for tile, tree in trees[0].items())
        assert 0 < len(trees[1]) < len(trees[0])  # trees of changed ground are not shared
    assert shared > 20


def test_ground_of_another_place_or_size_is_built_anew() -> None:
    first = terrain_obstacle(Terrain.level(0.0, (0.0, 0.0), (3.0, 3.0)), "ground", 0.1)
    found = terrain_obstacle(Terrain.level(0.0, (1.0, 0.0), (4.0, 4.0)), "ground", 0.2, before=first)
    assert found.cluster is not None
    np.testing.assert_allclose(found.cluster.bounds[:, :2], [[1.0, 0.0], [4.0, 4.0]], atol=1e-12)
    moved = terrain_obstacle(Terrain.level(0.0, (1.0, 0.0), (4.0, 3.0)), "ground", 0.2, before=first)
    assert moved.cluster is not None
    np.testing.assert_allclose(moved.cluster.bounds[:, :2], [[1.0, 0.0], [4.0, 3.0]], atol=1e-12)
    with pytest.raises(InputError, match="clearance"):
        terrain_obstacle(Terrain.level(0.0, (0.0, 0.0), (3.0, 3.0)), "ground", -0.1)


def test_ground_of_the_same_size_elsewhere_is_where_it_is() -> None:
    here, there = Terrain.level(0.0, (0.0, -3.0), (6.0, 3.0)), Terrain.level(0.0, (1.0, 4.0), (7.0, 10.0))
    found = terrain_obstacle(there, "ground", 0.1, before=terrain_obstacle(here, "ground", 0.1))
    assert found.cluster is not None
    np.testing.assert_allclose(found.cluster.placement.translation, [4.0, 7.0, 0.0])


def test_level_ground_lies_on_all_sides_of_what_is_known() -> None:
    """Known from 0, -3 to 6, 4 m, covered from -5, -8 to 10, 9 m: four boxes whose tops are level, without gaps."""
    ground = Terrain.level(0.0, (0.0, -3.0), (6.0, 4.0))
    found = ground_around(ground, -0.5, np.array([-5.0, -8.0]), np.array([10.0, 9.0]), 0.1)
    sides = {one.name.split()[2]: one for one in found}
    expected = {
        "west": ((-5.0, 0.0), (-8.0, 9.0)), "east": ((6.0, 10.0), (-8.0, 9.0)),
        "south": ((0.0, 6.0), (-8.0, -3.0)), "north": ((0.0, 6.0), (4.0, 9.0)),
    }  # fmt: skip
    assert sides.keys() == expected.keys()
    for name, (x, y) in expected.items():
        (piece,) = sides[name].pieces
        low, high = piece.hull.min(axis=0) - piece.radius, piece.hull.max(axis=0) + piece.radius
        np.testing.assert_allclose([low[0], high[0], low[1], high[1], high[2]], [*x, *y, -0.5], atol=1e-12)
        assert low[2] < -10.0
    # where the known ground reaches far enough, there is none
    beyond = ground_around(ground, -0.5, np.array([1.0, -8.0]), np.array([5.0, 2.0]), 0.1)
    assert [one.name.split()[2] for one in beyond] == ["south"]


@pytest.mark.parametrize("name", ["ground.csv", "ground.xyz"])
def test_the_ground_of_a_file_beyond_the_modelled_ground_is_an_obstacle(name: str, tmp_path: Path) -> None:
    """The job has the ground up to x = 4.4 m; in the file it rises by 3 m from x = 4.6 to 4.7 m."""
    low, high, cell = TINY["ground"]["low"], TINY["ground"]["high"], 0.1
    x, y = np.meshgrid(np.arange(low[0], 9.05, cell), np.arange(low[1], high[1] + 0.05, cell))
    heights = np.where(x > 4.65, 3.0, 0.0)
    points = np.column_stack((x.ravel(), y.ravel(), heights.ravel()))
    table = name.endswith(".csv")
    np.savetxt(tmp_path / name, heights if table else points, delimiter="," if table else " ", fmt="%.3f")
    ground = {"file": name, "low": low, "high": [4.4, high[1]], "cell": cell}
    site = build_worksite(job_from_dict(TINY | {"ground": ground}, folder=tmp_path))
    assert site.ground.surface.max() == 0.0
    beyond, below = (one for one in site.problem.obstacles if "modelled" in one.name)
    assert (beyond.name, beyond.clearance) == ("the ground beyond what is modelled", TINY["site"]["clearance"])
    assert beyond.links == ("boom", "stick", "bucket")
    # the swing post turns above it, as near as it is, but must not touch it
    assert (below.name, below.clearance) == ("the ground beyond what is modelled, below swing_post", 0.0)
    assert below.links == ("swing_post",)
    assert below.cluster is beyond.cluster
    assert beyond.cluster is not None
    ball = shapes.capsule(0.1, 0.0, pin.SE3.Identity())
    slope = 0.4 / np.hypot(3.0, 0.1) - 0.1  # from x 4.5, z 1 to the line from 4.6, 0 to 4.7, 3
    within = 0.9 - 0.1 / 20.0 - 0.1  # to the border at x 4.4, z 0, below which it falls by 20 m in a column
    places = [(4.5, 0.0, 1.0), (5.0, -2.0, 4.0), (4.45, -4.4, 0.12), (3.5, 0.0, -1.0)]
    for place, distance in zip(places, (slope, 0.9, 0.02, within), strict=True):
        reading = beyond.cluster.measure(ball, pin.SE3(np.eye(3), np.array(place)))
        assert reading is not None
        assert reading.distance == pytest.approx(distance, abs=1e-4)
    # its drawing ends a place within the border, a little below the terrain
    vertices, triangles = surface_beyond(beyond, 15_000)
    assert len(np.unique(triangles)) == len(vertices)
    assert vertices[:, 2].min() == pytest.approx(-0.05)
    assert vertices[:, 2].max() == 3.0
    inside = (np.abs(vertices[:, 1] - 0.5 * (low[1] + high[1])) < 0.5 * (high[1] - low[1]) - 0.15) & (
        vertices[:, 0] < 4.25
    )
    assert not (inside & (vertices[:, 0] > low[0] + 0.15)).any()
    # ground from elsewhere that is larger than that of the file: all of the obstacle is 20 m below it
    wide = Terrain.level(0.0, (-9.0, -9.0), (12.0, 9.0), 0.1)
    (deep,) = ground_beyond(wide, HeightGrid(np.array([0.0, 0.0]), 0.1, np.ones((11, 21))), wide.low, wide.high, 0.1)
    assert deep.cluster is not None
    assert deep.cluster.bounds[1, 2] == -19.0
    assert len(surface_beyond(deep, 1_000)[1]) == 0
    # where the file goes no further, there is none
    whole = build_worksite(job_from_dict(TINY | {"ground": ground | {"high": [9.0, high[1]]}}, folder=tmp_path))
    assert not [one for one in whole.problem.obstacles if "modelled" in one.name]
