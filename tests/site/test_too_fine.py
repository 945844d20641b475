"""A moving survey that is too fine is refused before its pieces are built; a fixed one becomes one cluster.

Counted, not timed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import spatial

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.machine import terrain_columns, voxel_boxes
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import build_obstacle, obstacle_from_dict


class Counted:
    """Calls of a function."""

    def __init__(self, function: Any) -> None:
        self.function, self.calls = function, 0

    def __call__(self, *args: Any, **keys: Any) -> Any:
        self.calls += 1
        return self.function(*args, **keys)


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[Counted]:
    """Counters of the functions that build boxes and hulls."""
    places: list[tuple[Any, str]] = [(shapes, "box"), (shapes, "convex"), (spatial, "ConvexHull")]
    found = [Counted(getattr(*place)) for place in places]
    for place, counted in zip(places, found, strict=True):
        monkeypatch.setattr(*place, counted)
    return found


def calls(built: list[Counted]) -> int:
    return sum(counted.calls for counted in built)


def refused(folder: Path, **keys: Any) -> str:
    spec = obstacle_from_dict({"name": "survey", "velocity": [1.0, 0.0, 0.0], **keys})
    with pytest.raises(InputError, match="too fine") as caught:
        build_obstacle(spec, folder=folder, clearance=0.1)
    return str(caught.value)


def waves(points: int, length: float) -> Matrix:
    """Heights on a square of 20 m: waves of 1 m amplitude and wavelength `length` [m] in x and y."""
    x = np.linspace(-10.0, 10.0, points)
    return np.asarray(np.sin(2.0 * np.pi * x / length)[:, None] * np.sin(2.0 * np.pi * x / length))


def write_map(folder: Path, heights: Matrix) -> None:
    np.savetxt(folder / "map.csv", heights, fmt="%.5f", delimiter=",")


def test_a_moving_cloud_of_single_voxels_is_refused_before_boxes_are_built(
    tmp_path: Path, built: list[Counted]
) -> None:
    # a checkerboard in space: no two voxels share a face, so that nothing can be merged
    grid = np.argwhere(np.indices((50, 50, 50)).sum(axis=0) % 2 == 0)
    np.savetxt(tmp_path / "scan.xyz", 0.1 * grid + 0.05, fmt="%.3f")
    said = refused(tmp_path, shape="pointcloud", file="scan.xyz", resolution=0.1)
    assert "found 62500 convex pieces; allowed: up to 20000" in said
    assert calls(built) == 0


def test_fixed_surveys_become_clusters_without_building_boxes_or_hulls(tmp_path: Path, built: list[Counted]) -> None:
    grid = np.argwhere(np.indices((50, 50, 50)).sum(axis=0) % 2 == 0)
    np.savetxt(tmp_path / "scan.xyz", 0.1 * grid + 0.05, fmt="%.3f")
    write_map(tmp_path, np.random.default_rng(0).uniform(0.0, 1.0, (200, 200)))
    for keys, cells in (
        ({"shape": "pointcloud", "file": "scan.xyz", "resolution": 0.1}, 62_500),
        ({"shape": "heightmap", "file": "map.csv", "size": [20.0, 20.0]}, 199 * 199),
    ):
        found = build_obstacle(obstacle_from_dict({"name": "survey", **keys}), folder=tmp_path, clearance=0.1)
        assert found.cluster is not None
        assert len(found.cluster) == cells
        assert found.pieces == ()
    assert calls(built) == 0


def test_a_moving_map_of_rough_ground_is_refused_before_hulls_are_built(tmp_path: Path, built: list[Counted]) -> None:
    write_map(tmp_path, np.random.default_rng(0).uniform(0.0, 1.0, (200, 200)))  # 39,601 cells
    said = refused(tmp_path, shape="heightmap", file="map.csv", size=[20.0, 20.0])
    assert "found more than 20000 convex pieces; allowed: up to 20000" in said
    assert calls(built) == 0


def test_a_moving_map_of_waves_is_refused_before_hulls_are_built(tmp_path: Path, built: list[Counted]) -> None:
    # neighbouring points bend by less than the tolerance: only wider blocks show that there are too many
    heights = waves(601, 0.7)
    assert np.max(np.abs(np.diff(heights, 2, axis=0))) / 2.0 < 0.06
    write_map(tmp_path, heights)
    refused(tmp_path, shape="heightmap", file="map.csv", size=[20.0, 20.0])
    assert calls(built) == 0


def test_building_columns_ends_when_there_are_too_many(built: list[Counted]) -> None:
    # one hollow beside flat ground, not seen along the middle lines of any block
    heights = np.zeros((4, 400))
    heights[1:3, ::3] = 0.5
    with pytest.raises(InputError, match="more than 20 convex pieces"):
        terrain_columns(heights, (40.0, 0.4), tolerance=0.02, depth=1.0, most=20)
    assert calls(built) < 2 * 2 * 25


@pytest.mark.parametrize("seed", [0, pytest.param(3, marks=pytest.mark.long)])
def test_a_maximum_number_of_columns_does_not_change_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = waves(24, 5.0) + rng.uniform(0.0, 0.05 * seed, (24, 24))
    free = terrain_columns(heights, (20.0, 20.0), tolerance=0.1, depth=1.0)
    counted = terrain_columns(heights, (20.0, 20.0), tolerance=0.1, depth=1.0, most=len(free))
    assert len(counted) == len(free) > 1
    for one, other in zip(free, counted, strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(InputError, match=f"more than {len(free) - 1} convex pieces"):
        terrain_columns(heights, (20.0, 20.0), tolerance=0.1, depth=1.0, most=len(free) - 1)


def test_exactly_as_many_boxes_as_allowed_are_accepted() -> None:
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    assert len(voxel_boxes(points, 1.0, most=3)) == 3
    with pytest.raises(InputError, match="found 3 convex pieces; allowed: up to 2"):
        voxel_boxes(points, 1.0, most=2)
