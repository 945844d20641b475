"""Distances from thousands of cells: by hand, by brute force over all cells, and their bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.machine import (
    Cluster,
    MeshSolid,
    Piece,
    Reading,
    TerrainSolid,
    VoxelSolid,
    covering_balls,
    terrain_columns,
    voxel_boxes,
    voxel_keys,
)

# imports inner modules: only they show which cells are left out
from backhoe_planner.machine.clusters import cluster as cluster_module
from backhoe_planner.machine.clusters import terrain as terrain_module
from backhoe_planner.machine.clusters.link_box import LinkBox, LinkReach
from backhoe_planner.machine.clusters.solid import Placed
from backhoe_planner.machine.clusters.voxels import lone_part
from backhoe_planner.machine.shape import shapes
from backhoe_planner.native import find_compiled, plain_versions

needs_native = pytest.mark.skipif(find_compiled() is None, reason="backhoe_planner_native is not installed")

BALL = (np.zeros(3), 3.0)
SLACK = 0.15  # share of the distance by which boxes may be nearer, as in the servo
HERE = pin.SE3.Identity()


def scan(points: Matrix, edge: float, placement: pin.SE3 = HERE) -> Cluster:
    return Cluster(VoxelSolid(voxel_keys(points, edge), edge, most=10**6), placement)


def terrain(heights: Matrix, edge: float, placement: pin.SE3 = HERE) -> Cluster:
    return Cluster(TerrainSolid(heights, (edge, edge), depth=5.0, most=10**6), placement)


def at(x: float, y: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def distance(cluster: Cluster, piece: Piece, place: pin.SE3) -> float:
    found = cluster.measure(piece, place)
    assert found is not None
    return found.distance


def ball(radius: float) -> Piece:
    return shapes.sphere(radius, HERE)


def speck(point: Vector) -> Piece:
    return shapes.sphere(1e-9, pin.SE3(np.eye(3), point))


def random_place(rng: np.random.Generator, size: float) -> pin.SE3:
    turn = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    return pin.SE3(turn, rng.uniform(-size, size, 3))


def gap(first: Piece, place: pin.SE3, second: Piece) -> float:
    """The distance between two convex pieces, the second in the world frame."""
    here, there = place * first.placement, second.placement
    T = [shapes.transform(T.rotation, T.translation) for T in (here, there)]
    return shapes.Gauge().measure(first.shape, T[0], second.shape, T[1])[0]


# --- by hand -----------------------------------------------------------------------------


def test_a_plane_of_points_is_a_slab_of_voxels() -> None:
    # points at z = 0.01 lie in voxels from 0 to 0.05
    x = np.arange(-1.0, 1.0, 0.02)
    cloud = scan(np.column_stack((np.repeat(x, 100), np.tile(x, 100), np.full(10_000, 0.01))), 0.05)
    assert len(cloud) == 1600
    found = cloud.measure(ball(0.1), at(0.3, 0.2, 0.4))
    assert found is not None
    assert found.distance == pytest.approx(0.25, abs=1e-9)
    np.testing.assert_allclose(found.normal, [0.0, 0.0, -1.0], atol=1e-6)
    assert found.point[2] == pytest.approx(0.3)
    assert found.other_point[2] == pytest.approx(0.05)
    assert distance(cloud, ball(0.1), at(0.3, 0.2, -0.2)) == pytest.approx(0.1, abs=1e-9)
    assert cloud.measure(ball(0.1), at(0.3, 0.2, 0.4), 0.24) is None


def test_a_corner_of_floor_and_wall_is_two_boxes() -> None:
    # a floor below z = 0.05 and a wall beyond x = 0.5, a ball 0.15 from the floor and 0.2 from the wall
    x = np.arange(-1.0, 0.5, 0.02)
    floor = np.column_stack((np.repeat(x, 75), np.tile(x, 75), np.full(75 * 75, 0.01)))
    wall = np.column_stack((np.full(75 * 75, 0.51), np.repeat(x, 75), np.tile(x, 75) + 1.0))
    parts = (
        scan(np.vstack((floor, wall)), 0.05)
        .around(ball(0.1), at(0.2, -0.3, 0.3), 0.24, ball=BALL, most=16, slack=SLACK)
        .parts
    )
    near = [part.reading for part in parts if part.reading.distance < 0.21]
    assert [round(reading.distance, 6) for reading in near] == [0.15, 0.2]
    np.testing.assert_allclose(near[0].normal, [0.0, 0.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(near[1].normal, [1.0, 0.0, 0.0], atol=1e-6)


def test_distances_over_beside_and_inside_a_staircase_by_hand() -> None:
    # steps of 0.2 m, two cells of 0.5 m wide: between them a slope from (0, 0.2) to (0.5, 0.4)
    heights = np.tile(np.repeat(0.2 * np.arange(5), 2)[:9], (9, 1))
    ground = terrain(heights, 4.0)
    # columns at x = -2, -1.5, ..., heights 0, 0, 0.2, 0.2, 0.4, 0.4, ... : flat from 0 to 0.5 at 0.4
    assert distance(ground, ball(0.1), at(0.25, 0.0, 1.0)) == pytest.approx(0.5, abs=1e-9)
    # over the middle of the slope from (-0.5, 0.2) to (0, 0.4) along its normal
    normal = np.array([-0.2, 0.0, 0.5]) / np.hypot(0.2, 0.5)
    centre = np.array([-0.25, 0.0, 0.3]) + 0.3 * normal
    assert distance(ground, ball(0.1), at(*centre)) == pytest.approx(0.2, abs=1e-9)
    # beside the map the distance to its wall counts, below the ground the way up
    assert distance(ground, ball(0.1), at(-2.5, 0.0, -1.0)) == pytest.approx(0.4, abs=1e-9)
    inside = ground.measure(ball(0.1), at(0.25, 0.0, -0.4))
    assert inside is not None
    assert inside.distance < 0.0
    assert inside.distance == pytest.approx(-(0.8 * 0.5 + 0.25 * 0.2) / np.hypot(0.2, 0.5) + 0.1, abs=0.4)
    assert inside.normal[2] < 0.0


def test_bounds_over_and_beside_ground_with_a_step_by_hand() -> None:
    """Cells of 0.05 m, corners at 0 up to x = 0 and at -1 from x = 0.05 on: over x < 0 the distance of a point is z."""
    heights = np.where(np.arange(81) <= 40, 0.0, -1.0) + np.zeros((81, 1))
    bounds = terrain(heights, 4.0).grid(np.zeros(3), 2.0)
    z = np.array([-0.2, 0.0, 0.1, 0.7, 1.3])
    above = bounds.lower(np.array((np.full(5, -0.51), np.full(5, 0.31), z)))
    assert above == pytest.approx(np.maximum(z, 0.0), abs=1e-6)
    # 0.525 m beside the upper edge of the step, 0.5 m counted in whole cells, and 0.7 m above the ground below
    beside = float(bounds.lower(np.array([[0.525], [0.3], [-0.3]]))[0])
    assert 0.3 <= beside <= 0.525 + 0.05
    beyond = bounds.lower(np.array([[3.0, 0.0, 0.0], [0.0, 0.0, 30.0]]).T)
    assert 0.5 <= beyond[0] <= 1.0
    assert beyond[1] > 1.0


def test_a_cloud_is_hollow_and_a_closed_mesh_is_solid() -> None:
    rng = np.random.default_rng(0)
    shell = rng.normal(size=(60_000, 3))
    shell /= np.linalg.norm(shell, axis=1)[:, None]
    cloud = scan(shell, 0.05)
    assert 0.7 < distance(cloud, ball(0.1), at(0.0, 0.0, 0.0)) < 0.9
    assert distance(cloud, ball(0.1), at(0.9, 0.0, 0.0)) < 0.0
    mesh = Cluster(MeshSolid(trimesh.creation.icosphere(subdivisions=4), most=10**5), HERE)
    assert -1.1 < distance(mesh, ball(0.1), at(0.0, 0.0, 0.0)) < -1.0  # the ball is out after 1.1 m, whatever the way
    assert distance(mesh, ball(0.1), at(0.0, 0.0, 2.0)) == pytest.approx(0.9, abs=1e-2)
    hole = Cluster(MeshSolid(trimesh.creation.torus(1.0, 0.3), most=10**5), HERE)
    assert distance(hole, ball(0.1), at(0.0, 0.0, 0.0)) == pytest.approx(0.6, abs=1e-2)
    assert distance(hole, ball(0.1), at(1.0, 0.0, 0.0)) < 0.0


def test_too_many_cells_are_refused_with_their_number() -> None:
    points = np.arange(30.0).reshape(10, 3)
    with pytest.raises(InputError, match="found 10 voxels; allowed: up to 9"):
        VoxelSolid(voxel_keys(points, 0.1), 0.1, most=9)
    with pytest.raises(InputError, match="found 6 cells; allowed: up to 5"):
        TerrainSolid(np.zeros((3, 4)), (1.0, 1.0), depth=1.0, most=5)
    with pytest.raises(InputError, match="found 12 triangles; allowed: up to 11"):
        MeshSolid(trimesh.creation.box((1.0, 1.0, 1.0)), most=11)


# --- by brute force ----------------------------------------------------------------------


def solids(rng: np.random.Generator, kind: str) -> tuple[Cluster, Callable[[], list[Piece]]]:
    """A cluster, and what makes convex pieces of the same union; all kinds take the same random numbers."""
    place = random_place(rng, 0.3)
    points = rng.uniform(-1.0, 1.0, (200, 3)) * [1.0, 1.0, 0.3]
    x = np.linspace(-1.0, 1.0, 13)
    heights = 0.3 * np.sin(3.0 * x)[:, None] * np.cos(2.0 * x) + rng.normal(0.0, 0.02, (13, 13))
    if kind == "scan":
        boxes = voxel_boxes(points, 0.1)
        return scan(points, 0.1, place), lambda: [shapes.box(size, place * at(*centre)) for centre, size in boxes]
    if kind == "terrain":
        return terrain(heights, 2.0, place), lambda: [
            shapes.convex(corners, place) for corners in terrain_columns(heights, (2.0, 2.0), tolerance=0.0, depth=5.0)
        ]
    mesh = trimesh.creation.torus(0.7, 0.25, major_sections=16, minor_sections=8)
    torus = Cluster(MeshSolid(mesh, most=1000), place)
    return torus, lambda: [shapes.convex(part, place) for part in torus_sections(mesh, 16, 8)]


def torus_sections(mesh: Any, major: int, minor: int) -> list[Matrix]:
    """Corners of the convex pieces between neighbouring sections of a torus."""
    angle = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    ring = np.round(angle / (2.0 * np.pi / major)).astype(int) % major
    parts = [mesh.vertices[(ring == k) | (ring == (k + 1) % major)] for k in range(major)]
    assert all(len(part) == 2 * minor for part in parts)
    return parts


LINKS = (
    shapes.box(np.array([0.8, 0.1, 0.1]), HERE),
    shapes.sphere(0.1, HERE),
    shapes.capsule(0.05, 0.5, at(0.1, 0.0, 0.0)),
)


@pytest.mark.parametrize("kind", ["scan", "terrain", "mesh"])
def test_the_distance_of_a_cluster_is_the_least_over_all_cells(kind: str) -> None:
    rng = np.random.default_rng(7)
    cluster, make_pieces = solids(rng, kind)
    pieces = make_pieces()
    signs = [0, 0]
    for number in range(40):
        link, place = LINKS[number % 3], random_place(rng, 1.2)
        least = min(gap(link, place, piece) for piece in pieces)
        found = distance(cluster, link, place)
        assert (found > 0.0) == (least > 0.0)
        signs[found > 0.0] += 1
        if found > 0.0:
            assert found == pytest.approx(least, abs=1e-8)
            assert cluster.measure(link, place, found - 1e-6) is None
            reading = cluster.measure(link, place)
            assert reading is not None
            np.testing.assert_allclose(reading.other_point, reading.point + found * reading.normal, atol=1e-8)
            assert gap(link, place, speck(reading.point)) < 1e-7
            assert min(gap(speck(reading.other_point), HERE, piece) for piece in pieces) < 1e-7
        far = cluster.grid(*BALL).lower((covering_balls(link)[0] @ place.rotation.T + place.translation).T)
        bound = float(far.min()) - covering_balls(link)[1]
        assert bound <= found + 1e-9 or bound <= 0.0
    assert min(signs) >= 3


@pytest.mark.parametrize("kind", ["scan", "terrain", "mesh"])
def test_boxes_around_a_link_contain_all_cells_near_it(kind: str) -> None:
    rng = np.random.default_rng(8)
    cluster, _ = solids(rng, kind)
    for number in range(30):
        link, place = LINKS[number % 3], random_place(rng, 1.2)
        true = distance(cluster, link, place)
        if true <= 0.0:
            continue
        found = cluster.around(link, place, 0.8, ball=BALL, most=16, slack=SLACK)
        parts = found.parts if found.rest is None else (*found.parts, found.rest)
        for part in found.parts:
            assert gap(link, place, part.piece) == pytest.approx(part.reading.distance, abs=1e-6)
        # moved and turned within the covered region, the link is no nearer to the cells than to the boxes
        for _ in range(5):
            by = pin.SE3(Rotation.from_rotvec(rng.normal(0.0, 0.1, 3)).as_matrix(), rng.normal(0.0, 0.1, 3))
            moved = place * by
            least = distance(cluster, link, moved)
            boxes = min((gap(link, moved, part.piece) for part in parts), default=np.inf)
            if 0.0 < least < 0.4:
                assert boxes <= least + 1e-9


def compared_with_coals_tree(
    solid: MeshSolid | VoxelSolid, rng: np.random.Generator, *, around: Vector, base: Vector
) -> tuple[list[Reading], list[Reading | None]]:
    """Compiled distances of 90 links near a place (3,), compared with those of coal's tree, at `base` (3,) [m].

    Returns the readings of links within reach, and coal's where the compiled function leaves the answer to coal.
    """
    near: list[Reading] = []
    left: list[Reading | None] = []
    far = 0
    for number in range(90):
        link, place = LINKS[number % 3], random_place(rng, 1.5)
        place.translation[:] += around
        placed, reach = Placed(link, place.rotation, place.translation), float(rng.choice([0.05, 0.3, 2.0]))
        is_known, found = solid._cells.measure(placed, reach)
        true = solid._tree.measure(link.shape, placed.shifted(-base), reach)
        if not is_known:
            left.append(true)
        elif found is None:
            assert true is None
            far += 1
        else:
            assert true is not None
            assert found.distance == pytest.approx(true.distance, abs=1e-9)
            np.testing.assert_allclose(found.other_point, found.point + found.distance * found.normal, atol=1e-8)
            assert gap(link, place, speck(found.point)) < 1e-7
            near.append(found)
    assert len(near) > 15
    assert far > 5
    assert len(left) < 60
    return near, left


@needs_native
@pytest.mark.parametrize("kind", ["fine", "rough", "few"])
def test_the_compiled_distance_to_triangles_equals_that_of_coals_tree(kind: str) -> None:
    rng = np.random.default_rng(12)
    mesh = {
        "fine": lambda: trimesh.creation.torus(0.7, 0.25, major_sections=64, minor_sections=24),
        "rough": lambda: trimesh.Trimesh(rng.normal(0.0, 0.5, (903, 3)), np.arange(903).reshape(301, 3)),
        "few": lambda: trimesh.creation.box((0.8, 0.5, 0.3)),
    }[kind]()
    near, _ = compared_with_coals_tree(MeshSolid(mesh, most=10**5), rng, around=np.zeros(3), base=np.zeros(3))
    for found in near:
        nearest = trimesh.triangles.closest_point(mesh.triangles, np.tile(found.other_point, (len(mesh.faces), 1)))
        assert np.linalg.norm(nearest - found.other_point, axis=1).min() < 1e-8


@needs_native
def test_the_compiled_distance_to_voxels_equals_that_of_coals_tree() -> None:
    rng, edge, around = np.random.default_rng(13), 0.08, np.array([40.0, -7.0, 3.0])
    keys = voxel_keys(rng.normal(0.0, 0.4, (600, 3)) + around, edge)
    solid, middle = VoxelSolid(keys, edge, most=10**5), edge * (keys + 0.5)
    near, left = compared_with_coals_tree(solid, rng, around=around, base=edge * solid._base)
    for found in near:
        assert np.abs(middle - found.other_point).max(axis=1).min() == pytest.approx(0.5 * edge, abs=1e-9)
    for true in left:
        assert true is not None
        assert true.distance < 1e-6


def test_how_deep_a_ball_is_inside_a_mesh_by_hand() -> None:
    """In a cube with edges of 2 m, 0.7 m under a face, a ball with a radius of 0.1 m is out after 0.8 m."""
    cube = trimesh.creation.box((2.0, 2.0, 2.0)).subdivide().subdivide()
    cluster = Cluster(MeshSolid(cube, most=10**5), HERE)
    reading = cluster.measure(ball(0.1), at(0.3, 0.05, -0.1))
    assert reading is not None
    assert -0.8 <= reading.distance < -0.7
    np.testing.assert_allclose(reading.normal, [-1.0, 0.0, 0.0], atol=1e-9)  # into the mesh: the way out is along x
    np.testing.assert_allclose(reading.point, [0.2, 0.05, -0.1], atol=1e-9)
    np.testing.assert_allclose(reading.other_point, reading.point + reading.distance * reading.normal, atol=1e-9)
    deeper = distance(cluster, ball(0.1), at(0.1, 0.05, -0.1))
    assert deeper == pytest.approx(reading.distance - 0.2, abs=0.03)


@pytest.mark.parametrize("place", [0.0, 5e5])
@pytest.mark.parametrize("corners", [[0, 1, 2], [0, 1, 1], [1, 0, 1], [0, 0, 1], [1, 1, 1]], ids=str)
def test_a_ball_is_as_deep_in_a_triangle_without_area_as_in_the_line_or_point_that_it_is(
    corners: list[int], place: float
) -> None:
    """The middle of the ball is 0.15 m from the line along x and from its point at x = 1, the radius is 0.3 m."""
    points = place + np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [9.0, 0.0, 0.0], [9.0, 1.0, 0.0]])
    mesh = trimesh.Trimesh(points, [corners, [2, 3, 4]], process=False)
    reading = Cluster(MeshSolid(mesh, most=10), HERE).measure(ball(0.3), at(place + 1.0, place + 0.12, place - 0.09))
    assert reading is not None
    assert reading.distance == pytest.approx(-0.15, abs=1e-7)
    np.testing.assert_allclose(reading.normal, [0.0, -0.8, 0.6], atol=1e-6)


@pytest.mark.parametrize("way", ["across", "inside"])
def test_a_shape_is_not_out_of_a_mesh_before_it_has_moved_by_its_depth(way: str) -> None:
    rng = np.random.default_rng(5)
    torus = trimesh.creation.torus(0.9, 0.3, major_sections=96, minor_sections=32)
    cluster = Cluster(MeshSolid(torus, most=10**5), HERE)
    far = 0
    for _ in range(25):
        angle = rng.uniform(-np.pi, np.pi)
        ring = 0.9 * np.array([np.cos(angle), np.sin(angle), 0.0]) + rng.normal(0.0, 0.08, 3)
        turn = random_place(rng, 0.0).rotation
        link = LINKS[0] if way == "across" else LINKS[1]
        found = distance(cluster, link, pin.SE3(turn, ring))
        assert found < 0.0
        far += found < -0.15
        for _ in range(8):
            step = rng.normal(size=3)
            step *= 0.999 * -found / np.linalg.norm(step)
            assert distance(cluster, link, pin.SE3(turn, ring + step)) < 1e-6
    assert far > 15


@needs_native
@pytest.mark.parametrize("kind", ["scan", "terrain", "mesh"])
@pytest.mark.parametrize("most", [pytest.param(3, marks=pytest.mark.long), 16])
def test_compiled_boxes_equal_those_found_by_coal(kind: str, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """For upright and turned solids and links that touch no cell; for links in contact coal finds the boxes."""
    rng = np.random.default_rng(14)
    upright, _ = solids(rng, kind)
    turned = upright.moved_to(random_place(rng, 0.3))
    answered: list[bool] = []

    def noted(name: str) -> None:
        ask = getattr(cluster_module, name)

        def answer(*arguments: Any) -> Any:
            found = ask(*arguments)
            answered.append(found is not None)
            return found

        monkeypatch.setattr(cluster_module, name, answer)

    for number in range(40):
        cluster = (upright, turned)[number % 2]
        link, place, reach = LINKS[number % 3], random_place(rng, 1.2), float(rng.choice([0.2, 0.8]))
        noted("boxes_of_voxels")
        noted("boxes_of_cells")
        found = cluster.around(link, place, reach, ball=BALL, most=most, slack=SLACK, exact=0.3)
        monkeypatch.undo()
        for name in ("boxes_of_voxels", "boxes_of_cells"):
            monkeypatch.setattr(cluster_module, name, plain_versions()[name])
        by_coal = cluster.around(link, place, reach, ball=BALL, most=most, slack=SLACK, exact=0.3)
        monkeypatch.undo()
        assert found.covered == pytest.approx(by_coal.covered, abs=1e-9)
        assert (found.rest is None) == (by_coal.rest is None)
        for one, other in zip(found.parts, by_coal.parts, strict=True):
            assert one.reading.distance == pytest.approx(other.reading.distance, abs=1e-6)
            np.testing.assert_allclose(one.reading.normal, other.reading.normal, atol=1e-5)
            np.testing.assert_allclose(np.sort(one.piece.hull, axis=0), np.sort(other.piece.hull, axis=0), atol=1e-4)
            assert one.at_cell == other.at_cell
            T = one.piece.placement
            corners = 0.5 * one.numbers[22:25] * shapes.box(np.full(3, 2.0), HERE).hull
            np.testing.assert_allclose(one.piece.hull, corners @ T.rotation.T + T.translation, atol=1e-12)
    assert answered.count(True) > 20


@pytest.mark.parametrize("kind", ["scan", "terrain", "mesh"])
def test_bounds_hold_if_the_grid_is_smaller_than_the_solid(kind: str) -> None:
    rng = np.random.default_rng(9)
    cluster, _ = solids(rng, kind)
    known = 0
    for radius in (0.4, 3.0):
        grid = cluster.grid(np.array([0.3, 0.2, 0.4]), radius)
        for _ in range(60):
            place = random_place(rng, 3.0)
            bound = float(grid.lower(place.translation[:, None])[0])
            true = distance(cluster, ball(0.01), place) + 0.01
            assert bound <= max(true, 0.0) + 1e-9
            known += bound > 0.5 * true > 0.0
    assert known > 20


@pytest.mark.parametrize("reach", [-0.1, 0.0, 1e-9])
def test_contact_is_found_at_any_reach(reach: float) -> None:
    flat = terrain(np.zeros((21, 21)), 4.0)
    scanned = scan(np.array([[x, y, -0.01] for x in (-0.05, 0.05) for y in (-0.05, 0.05)]), 0.1)
    for height, depth in ((0.2, 0.1), (0.0, 0.3), (-0.2, 0.5), (-1.0, 1.3)):  # a ball of radius 0.3 m moving down
        found = flat.measure(ball(0.3), at(0.03, 0.03, height), reach)
        assert found is not None
        assert found.distance == pytest.approx(-depth, abs=1e-6)
    assert flat.measure(ball(0.3), at(0.03, 0.03, 0.31), reach) is None
    touched = scanned.measure(ball(0.3), at(0.03, 0.03, 0.2), reach)
    assert touched is not None
    assert touched.distance < 0.0


@pytest.mark.parametrize("cell", [0.01, 0.04])
def test_the_distance_of_a_shape_beside_a_map_is_that_to_its_wall(cell: float) -> None:
    """Walls of 50 m consist of triangles a few centimetres wide, on which coal's iterations may break down."""
    rng, rows = np.random.default_rng(1), round(1.5 / cell)
    for _ in range(60):
        ground = TerrainSolid(rng.uniform(-0.05, 0.0, (rows + 1, 9)), (4.0, rows * cell), depth=50.0, most=10**6)
        piece = shapes.convex(rng.uniform(-0.1, 0.1, (40, 3)), HERE)
        place, apart = random_place(rng, 0.3), rng.uniform(0.02, 0.4)
        corners = piece.hull @ place.rotation.T
        place.translation[:] = 2.0 + apart - corners[:, 0].min(), rng.uniform(-0.3, 0.3), rng.uniform(-20.0, -0.4)
        found = Cluster(ground, HERE).measure(piece, place, 0.5)
        assert found is not None
        assert found.distance == pytest.approx(apart, abs=2e-6)
        np.testing.assert_allclose(found.normal, [-1.0, 0.0, 0.0], atol=1e-4)


@pytest.mark.parametrize("roughness", [0.0, pytest.param(0.3, marks=pytest.mark.long)])
def test_the_reported_depth_in_ground_never_exceeds_the_true_one(roughness: float) -> None:
    """A shape moved by less than its depth in any direction still touches; straight up it leaves even ground."""
    rng, sunk = np.random.default_rng(8), 0
    for _ in range(25):
        ground = terrain(roughness * rng.uniform(size=(41, 41)), 8.0)
        size = rng.uniform(0.1, 0.9, 3)
        piece = [shapes.sphere(size[0], HERE), shapes.capsule(size[0], size[1], HERE), shapes.box(size, HERE)][
            rng.integers(3)
        ]
        place = random_place(rng, 0.5)
        place.translation[2] = rng.uniform(-1.0, 0.2)
        found = ground.measure(piece, place)
        if found is None or found.distance >= 0.0:
            continue
        sunk += 1
        assert np.linalg.norm(found.normal) == pytest.approx(1.0, abs=1e-9)
        assert (found.other_point - found.point) @ found.normal == pytest.approx(found.distance, abs=1e-6)
        ways = rng.normal(size=(20, 3))
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        for way in (*ways, np.array([0.0, 0.0, 1.0]), -found.normal):
            moved = pin.SE3(place.rotation, place.translation - 0.999 * found.distance * way)
            still = ground.measure(piece, moved, 1.0)
            assert still is not None
            assert still.distance < 1e-9
        if roughness == 0.0:
            out = pin.SE3(place.rotation, place.translation - np.array([0.0, 0.0, found.distance - 1e-3]))
            above = ground.measure(piece, out)
            assert above is not None
            assert above.distance == pytest.approx(1e-3, abs=1e-6)
    assert sunk > 10


@needs_native
@pytest.mark.parametrize("roughness", [0.0, pytest.param(0.02, marks=pytest.mark.long), 0.5])
def test_the_compiled_distance_to_ground_equals_that_of_coals_trees(
    roughness: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiled search of the cells compared with coal's trees of triangles, for every kind of piece."""
    rng = np.random.default_rng(int(100 * roughness))
    counted = []
    compiled = terrain_module.nearest_on_ground
    for _ in range(60):
        heights = roughness * rng.uniform(size=(41, 61))
        solid = TerrainSolid(heights, (6.0, 4.0), depth=5.0, most=10**6)
        size = rng.uniform(0.05, 0.8, 3)
        piece = [
            shapes.sphere(size[0], HERE), shapes.capsule(size[0], size[1], HERE), shapes.box(size, HERE),
            shapes.cylinder(size[0], size[1], HERE), shapes.convex(rng.uniform(-1.0, 1.0, (12, 3)) * size, HERE),
        ][rng.integers(5)]  # fmt: skip
        place = random_place(rng, 1.0)
        place.translation[2] = rng.uniform(0.0, 1.5)
        link, reach = Placed(piece, place.rotation, place.translation), float(rng.choice([0.1, 0.7]))
        monkeypatch.setattr(terrain_module, "nearest_on_ground", compiled)
        found = solid.measure(link, reach)
        monkeypatch.setattr(terrain_module, "nearest_on_ground", lambda *_: ())
        by_trees = solid.measure(link, reach)
        if found is None or by_trees is None:
            assert found is by_trees
            continue
        counted.append(found.distance > 0.0)
        assert found.distance == pytest.approx(by_trees.distance, abs=1e-7)
        if found.distance > 1e-3:
            assert (found.other_point - found.point) @ found.normal == pytest.approx(found.distance, abs=1e-9)
            assert np.linalg.norm(found.normal) == pytest.approx(1.0, abs=1e-12)
            np.testing.assert_allclose(found.other_point - found.point, found.distance * found.normal, atol=1e-5)
    assert sum(counted) > 8


@pytest.mark.parametrize("cell", [0.05, 0.2, 0.4, 1.0])
def test_boxes_of_coarse_cells_stay_below_a_link_above_them(cell: float) -> None:
    flat = terrain(np.zeros((25, 25)), 24 * cell)
    for height in (0.05, 0.24, 0.26, 0.5):  # of the lowest point of a ball above the ground
        place = at(0.03, 0.05, height + 0.1)
        parts = flat.around(ball(0.1), place, 0.65, ball=BALL, most=15, slack=SLACK).parts
        least = min(gap(ball(0.1), place, part.piece) for part in parts)
        coarse = height > 0.25 and cell < 0.1
        assert (0.0 if coarse else 0.85) * height <= least <= height + 1e-9


def test_bounds_hold_after_digging_and_heaping_the_ground() -> None:
    rng = np.random.default_rng(11)
    heights = 0.1 * rng.uniform(size=(41, 41))
    ground = TerrainSolid(heights, (8.0, 8.0), depth=5.0, most=10**6)
    place = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.4), np.array([1.0, 0.5, 0.2]))
    cluster, around = Cluster(ground, place), (np.array([1.0, 0.5, 0.0]), 4.0)
    cluster.prepare(*around)
    known, closer = 0, 0
    for step in range(8):
        heights = heights.copy()
        r, c = rng.integers(0, 36, 2)
        heights[r : r + 4, c : c + 5] += -0.4 if step % 2 == 0 else 0.3
        assert isinstance(cluster.solid, TerrainSolid)
        before, cluster = cluster, Cluster(cluster.solid.with_heights(heights), place)
        points = around[0] + rng.uniform(-3.5, 3.5, (150, 3)) * [1.0, 1.0, 0.3]
        lower, old = cluster.grid(*around).lower(points.T), before.grid(*around).lower(points.T)
        true = np.array([distance(cluster, ball(1e-4), at(*point)) + 1e-4 for point in points])
        assert (lower <= np.maximum(true, 0.0) + 1e-6).all()
        known += int((lower > 0.7 * true).sum())
        closer += int((old > np.maximum(true, 0.0) + 1e-6).sum())
    assert known > 500
    assert closer > 0  # the old bounds would be wrong


@pytest.mark.parametrize("kind", ["scan", "terrain"])
def test_exact_boxes_are_no_nearer_than_the_cells(kind: str) -> None:
    # a bar 0.5 m above ground that is level to 1 cm, in cells of 5 cm; cubes of 10 cm would come within 0.4 m
    rng = np.random.default_rng(12)
    heights = rng.uniform(-0.01, -0.001, (81, 81))
    x = np.linspace(-2.0, 2.0, 400)
    points = np.column_stack((np.repeat(x, 400), np.tile(x, 400), rng.uniform(-0.01, -0.001, 160_000)))
    cluster = terrain(heights, 4.0) if kind == "terrain" else scan(points, 0.05)
    link, place = LINKS[0], at(0.03, 0.02, 0.55)
    for exact, least in ((0.0, 0.25), (0.4, 0.4)):
        found = cluster.around(link, place, 0.65, ball=BALL, most=15, slack=SLACK, exact=exact)
        boxes = min(gap(link, place, part.piece) for part in found.parts)
        assert found.covered == 0.65
        assert least <= boxes <= distance(cluster, link, place) + 1e-9


@pytest.mark.parametrize("kind", ["scan", "terrain", "mesh"])
def test_the_cells_near_a_box_include_all_with_their_middle_in_it(kind: str) -> None:
    solid = solids(np.random.default_rng(13), kind)[0].solid
    rng = np.random.default_rng(14)
    every = solid.near(solid.bounds[0] - 1.0, solid.bounds[1] + 1.0)
    middle, radius = every.around()
    assert len(every) >= len(solid)
    for _ in range(20):
        low = rng.uniform(-1.2, 1.0, 3)
        high = low + rng.uniform(0.0, 0.6, 3)
        found = {tuple(row) for row in np.round(solid.near(low, high).around()[0].T, 9).tolist()}
        # cells with their middle in the box touch it
        own = middle.T[np.abs(middle.T - 0.5 * (low + high)).max(axis=1) <= 0.5 * (high - low).min()]
        assert {tuple(row) for row in np.round(own, 9).tolist()} <= found
    assert (radius > 0.0).all()


@pytest.mark.parametrize("kind", ["scan", "terrain", "mesh"])
def test_tiles_find_all_cells_within_reach_of_a_link(kind: str) -> None:
    solid = solids(np.random.default_rng(16), kind)[0].solid
    rng = np.random.default_rng(17)
    middle, _ = solid.near(solid.bounds[0] - 1.0, solid.bounds[1] + 1.0).around()
    near, left_out = 0, 0
    for number in range(20):
        link, place = LINKS[number % 3], random_place(rng, 0.8)
        placed = Placed(link, np.array(place.rotation), np.array(place.translation))
        box, reach = LinkBox.around(placed.hull, placed.R, placed.radius), float(rng.uniform(0.0, 0.4))
        all_there = {tuple(row) for row in np.round(solid.near(*placed.box(reach)).around()[0].T, 9).tolist()}
        few = solid.near(*placed.box(reach), LinkReach(box, reach)).around()[0].T
        found = {tuple(row) for row in np.round(few, 9).tolist()}
        own = placed.R.T @ middle  # in the axes of the box
        corners = placed.R.T @ placed.hull.T
        low, high = corners.min(axis=1)[:, None], corners.max(axis=1)[:, None]
        off = np.linalg.norm(np.maximum(np.maximum(low - own, own - high), 0.0), axis=0) - placed.radius
        within = {tuple(row) for row in np.round(middle.T[off <= reach], 9).tolist()}
        assert within <= found <= all_there
        near, left_out = near + len(within), left_out + len(all_there - found)
    assert near > 100
    assert kind == "terrain" or left_out > 20


def test_boxes_around_a_sunken_link_contain_the_ground_and_face_upward() -> None:
    rng = np.random.default_rng(15)
    x = np.linspace(-2.0, 2.0, 81)
    heights = 0.2 * np.sin(2.0 * x)[:, None] * np.cos(1.5 * x) + rng.normal(0.0, 0.01, (81, 81))
    cluster = terrain(heights, 4.0, at(0.1, 0.0, 0.3))
    compared = 0
    for number in range(12):
        link, depth = LINKS[number % 3], float(rng.uniform(0.05, 0.4))
        turn = Rotation.from_euler("zy", rng.uniform(-0.3, 0.3, 2)).as_matrix()
        place = pin.SE3(turn, np.array([*rng.uniform(-0.4, 0.4, 2), 0.3 - depth]))
        ground = cluster.ground_under(link, place, 0.8)
        if ground is None:
            continue
        assert ground.reading.distance < 0.0
        assert ground.reading.normal[2] < -0.7
        assert gap(link, place, ground.piece) == pytest.approx(ground.reading.distance, abs=1e-6)
        found = cluster.around(link, place, 0.8, ball=BALL, most=15, slack=SLACK, ground=ground)
        for up in (0.2, 0.4, 0.6):
            moved = pin.SE3(turn, place.translation + np.array((*rng.normal(0.0, 0.05, 2), up)))
            least = distance(cluster, link, moved)
            if 0.0 < least < 0.2:
                assert min(gap(link, moved, part.piece) for part in (ground, *found.parts)) <= least + 1e-9
                compared += 1
    assert compared >= 5
    assert cluster.ground_under(LINKS[0], at(0.0, 0.0, 1.5), 0.8) is None


def test_the_voxel_edge_that_closes_a_scan_is_a_power_of_two_times_its_own() -> None:
    """Points 0.45 m apart in x and y; in voxels of 0.4 m, successive ones lie in neighbouring voxels."""
    nodes = np.stack(np.meshgrid(np.arange(20), np.arange(20), [0]), axis=-1).reshape(-1, 3)
    thin = VoxelSolid(voxel_keys(0.45 * nodes + 0.01, 0.1), 0.1, most=10**6)
    assert thin.closed_edge() == pytest.approx(0.4)
    whole = VoxelSolid(voxel_keys(0.1 * nodes + 0.01, 0.1), 0.1, most=10**6)
    assert whole.closed_edge() == 0.1


def test_a_scanned_cable_and_a_single_voxel_have_no_gaps() -> None:
    along = np.arange(0.0, 5.0, 0.04)
    cable = np.column_stack((along, 0.3 * along, 2.0 + 0.05 * (along - 2.5) ** 2))
    assert VoxelSolid(voxel_keys(cable, 0.1), 0.1, most=10**6).closed_edge() == 0.1
    assert VoxelSolid(voxel_keys(cable[:1], 0.1), 0.1, most=10**6).closed_edge() == 0.1


def test_the_share_of_isolated_voxels_equals_that_of_brute_force() -> None:
    keys = voxel_keys(np.random.default_rng(0).uniform(-2.0, 2.0, (300, 3)), 0.25)
    steps = np.abs(keys[:, None] - keys[None]).max(axis=2)
    assert lone_part(keys) == pytest.approx(float(((steps == 1).sum(axis=1) == 0).mean()))
