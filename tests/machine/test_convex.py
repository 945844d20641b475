"""Solids as convex pieces, which cover the whole solid and keep its cavities open."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.machine import (
    Cluster,
    MeshSolid,
    convex_cover,
    hull_if_nearly_convex,
    is_closed,
    load_mesh,
    terrain_columns,
    voxel_boxes,
)
from backhoe_planner.machine.shape import shapes

ROUNDING = 1e-9


def inside_any(points: Matrix, pieces: Sequence[Matrix]) -> NDArray[np.bool_]:
    """(n,) whether each point lies in at least one of the pieces' hulls."""
    depth = np.full(len(points), np.inf)
    for piece in pieces:
        equations = ConvexHull(piece).equations
        depth = np.minimum(depth, np.max(points @ equations[:, :3].T + equations[:, 3], axis=1))
    return np.asarray(depth <= ROUNDING)


def extruded(profile: Sequence[tuple[float, float]], height: float) -> trimesh.Trimesh:
    """A prism over a polygon that is star-shaped from its first corner."""
    n = len(profile)
    floor, top = [[(x, y, z) for x, y in profile] for z in (0.0, height)]
    fan = [(0, k, k + 1) for k in range(1, n - 1)]
    faces = [(c, b, a) for a, b, c in fan] + [(n + a, n + b, n + c) for a, b, c in fan]
    for k in range(n):
        following = (k + 1) % n
        faces += [(k, following, n + following), (k, n + following, n + k)]
    return trimesh.Trimesh(floor + top, faces)


def ell() -> trimesh.Trimesh:
    return extruded([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 1.0)


def samples(mesh: trimesh.Trimesh) -> Matrix:
    """Corners, face centres, and middles of edges."""
    triangles = np.asarray(mesh.triangles)
    edges = 0.5 * (triangles + np.roll(triangles, 1, axis=1))
    return np.vstack((mesh.vertices, triangles.mean(axis=1), edges.reshape(-1, 3)))


def pieces_of(mesh: trimesh.Trimesh, *, most: int = 16) -> list[Matrix]:
    """The corners (k, 3) of each piece of the cover."""
    return [corners for corners, _ in convex_cover(mesh, pieces=most)]


SOLIDS = {
    "L": (ell(), [(1.6, 1.6, 0.5), (1.9, 1.9, 0.1)]),
    "torus": (trimesh.creation.torus(1.0, 0.25, 12, 6), [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.0, -0.4, 0.1)]),
    "pipe": (trimesh.creation.annulus(0.8, 1.0, 1.0, 16), [(0.0, 0.0, 0.0), (0.0, 0.5, 0.45)]),
    "bucket": (
        trimesh.util.concatenate(
            [
                trimesh.creation.box(size, pin.SE3(np.eye(3), np.array(at)).homogeneous)
                for size, at in (([1, 1, 0.1], [0, 0, 0]), ([0.1, 1, 1], [-0.5, 0, 0.5]), ([0.1, 1, 1], [0.5, 0, 0.5]))
            ]
        ),
        [(0.0, 0.0, 0.5), (0.3, 0.4, 0.9)],
    ),
}


@pytest.mark.parametrize(
    ("mesh", "open_at"),
    [
        pytest.param(*solid, id=name, marks=[pytest.mark.long] * (name in ("pipe", "torus")))
        for name, solid in SOLIDS.items()
    ],
)
def test_the_cover_contains_the_whole_surface_and_keeps_the_cavity_open(
    mesh: trimesh.Trimesh, open_at: list[tuple[float, float, float]]
) -> None:
    cover = pieces_of(mesh)
    assert len(cover) > 1
    assert np.all(inside_any(samples(mesh), cover))
    assert not np.any(inside_any(np.array(open_at), cover))


@pytest.mark.long
def test_the_cover_contains_every_surface_point_of_a_crumpled_ball() -> None:
    rng = np.random.default_rng(0)
    mesh = trimesh.creation.icosphere(1)
    mesh.vertices = mesh.vertices * rng.uniform(0.5, 1.0, (len(mesh.vertices), 1))
    weights = rng.dirichlet(np.ones(3), size=(len(mesh.faces), 5))
    points = np.einsum("fsk,fkd->fsd", weights, np.asarray(mesh.triangles)).reshape(-1, 3)
    assert np.all(inside_any(np.vstack((points, samples(mesh))), pieces_of(mesh, most=6)))


def test_a_convex_mesh_is_its_own_cover() -> None:
    (corners,) = pieces_of(trimesh.creation.box((1.0, 2.0, 3.0)))
    assert len(corners) == 8
    assert ConvexHull(corners).volume == pytest.approx(6.0)


def test_the_cover_is_at_the_place_of_the_mesh() -> None:
    mesh = ell()
    mesh.apply_translation((10.0, -20.0, 5.0))
    points = np.vstack(pieces_of(mesh))
    assert np.all(points.min(axis=0) <= mesh.bounds[0] + ROUNDING)
    assert np.all(points.max(axis=0) >= mesh.bounds[1] - ROUNDING)
    assert np.all(np.abs(points - [11.0, -19.0, 5.5]) <= [1.1, 1.1, 0.6])


FLAT = {
    "triangle": ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
    "sheet": ([[0, 0, 1], [1, 0, 1], [1, 1, 2], [0, 1, 2]], [[0, 1, 2], [0, 2, 3]]),
    "line": ([[0, 0, 0], [1, 1, 0], [2, 2, 0]], [[0, 1, 2]]),
    "point": ([[3, 3, 3], [3, 3, 3], [3, 3, 3]], [[0, 1, 2]]),
}


@pytest.mark.parametrize(("corners", "faces"), FLAT.values(), ids=FLAT.keys())
def test_a_flat_mesh_becomes_a_solid_that_coal_can_measure(corners: list[list[float]], faces: list[list[int]]) -> None:
    mesh = trimesh.Trimesh(corners, faces, process=False)
    cover = pieces_of(mesh)
    assert np.all(inside_any(samples(mesh), cover))
    for piece in cover:
        assert shapes.convex(piece, pin.SE3.Identity()).shape.num_points >= 8 - 2
        assert ConvexHull(piece).volume < 2e-3
        assert np.max(np.abs(piece - mesh.vertices.mean(axis=0))) <= np.ptp(mesh.vertices) + 1e-3


def test_a_flat_mesh_in_any_tilted_plane_is_padded_by_half_a_millimetre() -> None:
    """By rounding a tilted sheet has a volume, so that Qhull accepts it, but inside coal it ends the process."""
    rng = np.random.default_rng(7)
    quad = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]])
    for _ in range(20):
        at = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-3.0, 3.0, 3)), rng.uniform(-5.0, 5.0, 3))
        sheet = trimesh.Trimesh(quad @ at.rotation.T + at.translation, [[0, 1, 2], [1, 3, 2]], process=False)
        (corners,) = pieces_of(sheet)
        for height in (0.8, -0.8):
            ball = at.act(np.array([0.7, 1.2, height]))
            found = gap(shapes.convex(corners, pin.SE3.Identity()), ball, radius=0.1)
            assert found == pytest.approx(0.8 - 0.1 - 0.0005, abs=1e-9)


def gap(piece: shapes.Piece, centre: Matrix, radius: float) -> float:
    """Signed distance from a piece to a ball [m]."""
    at = shapes.transform(piece.placement.rotation, piece.placement.translation)
    ball = shapes.sphere(radius, pin.SE3.Identity())
    return shapes.Gauge().measure(piece.shape, at, ball.shape, shapes.transform(np.eye(3), centre))[0]


SPREAD = [10.0**power for power in (-320, -12, -9, -8, -7, -6, -5, 0)]


@pytest.mark.parametrize(
    "size",
    [
        1e-300,
        pytest.param(1e-6, marks=pytest.mark.long),
        0.01,
        pytest.param(1.0, marks=pytest.mark.long),
        pytest.param(100.0, marks=pytest.mark.long),
        1e5,
    ],
)
def test_nearly_coinciding_points_make_a_piece_that_contains_them(size: float) -> None:
    """Nearly flat, needle-like or point-like sets, and bundles of nearly coinciding points."""
    rng = np.random.default_rng(11)
    for thin in SPREAD:
        for thinner in SPREAD:
            for count in (3, 8, 40):
                points = size * rng.uniform(-1.0, 1.0, (count, 3)) * [1.0, min(thin, 1.0), min(thinner, 1.0)]
                points = np.repeat(points, 3, axis=0) + 1e-13 * size * rng.normal(size=(3 * count, 3))
                points = points @ pin.rpy.rpyToMatrix(*rng.uniform(-3.0, 3.0, 3)).T
                piece = shapes.convex(points, pin.SE3.Identity())
                for point in points[[0, count, -1]]:
                    assert gap(piece, point, radius=0.001) <= 1e-8 * max(size, 1.0)


def test_a_shape_far_from_its_origin_keeps_its_size() -> None:
    """Like a mesh in map coordinates: 1 mm wide, 4,000 km north."""
    corners = 0.001 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) + [5e5, 4e6, 100.0]
    piece = shapes.convex(corners, pin.SE3.Identity())
    assert gap(piece, np.array([5e5 + 2.0, 4e6 + 0.0005, 100.0005]), radius=1.0) == pytest.approx(0.999, abs=1e-8)


def test_a_flat_cylinder_is_a_disc() -> None:
    for radius, length in ((1.0, 1e-9), (10.0, 1e-7), (100.0, 1e-6), (1e5, 1e-3), (1e-300, 1e-300)):
        disc = shapes.cylinder(radius, length, pin.SE3.Identity())
        half = 0.5 * max(1e-3, 2.0e-5 * radius / np.cos(np.pi / 32))
        assert gap(disc, np.array([0.0, 0.0, 3.0 + half]), radius=1.0) == pytest.approx(
            2.0, abs=1e-6 * max(radius, 1.0)
        )


def test_a_mesh_with_coordinates_beyond_any_map_is_refused() -> None:
    mesh = trimesh.creation.box((1e9, 1.0, 1.0))
    with pytest.raises(
        InputError, match=r"too large; found a vertex 5e\+08 m from the origin; allowed: up to 1e\+07 m"
    ):
        convex_cover(mesh)


# --- voxels -------------------------------------------------------------------


def cells_of(boxes: list[tuple[Matrix, Matrix]], resolution: float) -> list[tuple[int, ...]]:
    cells = []
    for centre, size in boxes:
        first = np.round((centre - 0.5 * size) / resolution).astype(int)
        extent = np.round(size / resolution).astype(int)
        cells += [tuple(first + step) for step in np.ndindex(*extent)]
    return [tuple(int(c) for c in cell) for cell in cells]


clouds: st.SearchStrategy[Matrix] = st.lists(st.tuples(*[st.floats(-2.0, 2.0)] * 3), min_size=1, max_size=60).map(
    np.array
)


@given(clouds, st.sampled_from([0.1, 0.25, 0.37, 1.0]))
def test_boxes_fill_exactly_the_voxels_that_contain_a_point(points: Matrix, resolution: float) -> None:
    boxes = voxel_boxes(points, resolution)
    cells = cells_of(boxes, resolution)
    wanted = {tuple(int(c) for c in np.floor(point / resolution)) for point in points}
    assert len(cells) == len(set(cells)), "boxes overlap"
    assert set(cells) == wanted
    volume = sum(float(np.prod(size)) for _, size in boxes)
    assert volume == pytest.approx(len(wanted) * resolution**3)
    low = np.array([centre - 0.5 * size for centre, size in boxes])
    high = np.array([centre + 0.5 * size for centre, size in boxes])
    for point in points:
        assert np.any(np.all((low - ROUNDING <= point) & (point <= high + ROUNDING), axis=1))


def test_a_full_block_of_voxels_is_one_box() -> None:
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(3), np.arange(2)), axis=-1).reshape(-1, 3)
    ((centre, size),) = voxel_boxes(np.asarray(0.5 * grid + 0.1, dtype=np.float64), 0.5)
    np.testing.assert_allclose(size, [2.0, 1.5, 1.0])
    np.testing.assert_allclose(centre, [1.0, 0.75, 0.5])


def test_one_point_is_one_voxel_of_the_grid_through_the_origin() -> None:
    ((centre, size),) = voxel_boxes(np.array([[-0.05, 0.05, 0.25]]), 0.1)
    np.testing.assert_allclose(centre, [-0.05, 0.05, 0.25])
    np.testing.assert_allclose(size, [0.1] * 3)


# --- terrain ------------------------------------------------------------------


def bilinear(heights: Matrix, size: tuple[float, float], count: int) -> Matrix:
    """(count^2, 3) points of the bilinear surface on a regular grid."""
    rows, columns = heights.shape
    found = []
    for u in np.linspace(0.0, rows - 1, count):
        for v in np.linspace(0.0, columns - 1, count):
            r, c = min(int(u), rows - 2), min(int(v), columns - 2)
            a, b = u - r, v - c
            h = heights[r : r + 2, c : c + 2]
            z = (1 - a) * ((1 - b) * h[0, 0] + b * h[0, 1]) + a * ((1 - b) * h[1, 0] + b * h[1, 1])
            found.append((size[0] * (v / (columns - 1) - 0.5), size[1] * (u / (rows - 1) - 0.5), z))
    return np.array(found)


def height_of(column: Matrix, x: float, y: float) -> float:
    """The column's top above (x, y); -inf beside it."""
    equations = ConvexHull(column).equations
    rest = equations[:, 0] * x + equations[:, 1] * y + equations[:, 3]
    across = equations[:, 2]
    if np.any(rest[np.abs(across) < 1e-12] > ROUNDING):
        return -np.inf
    top = float(np.min(-rest[across > 1e-12] / across[across > 1e-12]))
    bottom = float(np.max(-rest[across < -1e-12] / across[across < -1e-12]))
    return top if top >= bottom - ROUNDING else -np.inf


terrains = st.tuples(st.integers(2, 6), st.integers(2, 6)).flatmap(
    lambda shape: st.lists(
        st.floats(-1.0, 1.0, width=16), min_size=shape[0] * shape[1], max_size=shape[0] * shape[1]
    ).map(lambda values: np.array(values, dtype=float).reshape(shape))
)


@pytest.mark.long
@given(terrains, st.sampled_from([0.0, 0.02, 0.3]))
def test_columns_contain_the_surface_and_the_ground_below(heights: Matrix, tolerance: float) -> None:
    size = (4.0, 6.0)
    columns = terrain_columns(heights, size, tolerance=tolerance, depth=1.0)
    surface = bilinear(heights, size, 9)
    assert np.all(inside_any(surface, columns))
    below = surface.copy()
    below[:, 2] = heights.min() - 1.0
    assert np.all(inside_any(below, columns))


@pytest.mark.long
def test_columns_rise_at_most_the_tolerance_above_a_grid_point() -> None:
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-3.0, 3.0, 13), np.linspace(-3.0, 3.0, 13))
    heights = 0.4 * np.sin(x) + 0.3 * np.cos(1.3 * y) + rng.uniform(0.0, 0.01, x.shape)
    columns = terrain_columns(heights, (6.0, 6.0), tolerance=0.05, depth=1.0)
    assert 1 < len(columns) < 144
    for px, py, pz in zip(x.ravel(), y.ravel(), heights.ravel(), strict=True):
        top = max(height_of(column, px, py) for column in columns)
        assert -ROUNDING <= top - pz <= 0.05 + ROUNDING


@pytest.mark.parametrize("slope", [0.0, 0.25])
def test_evenly_sloping_ground_is_one_column(slope: float) -> None:
    heights = np.tile(slope * np.linspace(-2.0, 2.0, 7), (5, 1))
    (column,) = terrain_columns(heights, (4.0, 3.0), tolerance=0.0, depth=2.0)
    # a box of 4 x 3 m, as deep as the mean height above the floor
    assert ConvexHull(column).volume == pytest.approx(4.0 * 3.0 * (2.0 + 2.0 * slope))


def test_rows_of_heights_run_along_y_and_columns_along_x_from_the_low_corner() -> None:
    heights = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    columns = terrain_columns(heights, (4.0, 2.0), tolerance=0.0, depth=1.0)
    assert max(height_of(column, 2.0, 1.0) for column in columns) == pytest.approx(1.0)
    assert max(height_of(column, -2.0, 1.0) for column in columns) == pytest.approx(0.0)
    assert max(height_of(column, 2.0, -1.0) for column in columns) == pytest.approx(0.0)
    assert max(height_of(column, 2.1, 1.0) for column in columns) == -np.inf


# --- mesh files ---------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "off", "glb"])
def test_meshes_are_read_in_the_coordinates_of_their_file(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"block.{suffix}"
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    mesh.apply_translation((5.0, 0.0, 0.0))
    mesh.export(path)
    np.testing.assert_allclose(load_mesh(path).bounds, [[4.5, -1.0, -1.5], [5.5, 1.0, 1.5]], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("empty.stl", b"", "empty"),
        ("garbage.stl", b"this is no mesh", "triangles|cannot be read|can be read"),
        ("garbage.obj", b"\x00\x01\x02", "triangles|can be read"),
        ("garbage.ply", b"plx\n", "can be read"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\n", "triangles"),
        ("mesh.xyzzy", b"abc", "can be read"),
        ("box.obj.gz", b"abc", r"can be read; found '\.gz'; allowed: \.stl, \.obj"),
        ("nan.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertex 1, coordinate 3"),
        ("of_normals.obj", b"v 9 9 9\nv 1 0 0\nv 0 0 0\nv 0 1 nan\nvn 0 0 1\nf 4//1 2//1 3//1\n", "vertex 4, c"),
    ],
)
def test_errors_in_mesh_files_name_the_file(
    name: str, content: bytes, said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=said) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "off", "dae", "glb", "3mf"])
def test_a_coordinate_that_is_not_finite_is_refused_in_every_format(suffix: str, value: float, tmp_path: Path) -> None:
    """Its triangles would be dropped, and a plan could pass through the hole."""
    path = tmp_path / f"block.{suffix}"
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    mesh = trimesh.Trimesh(np.where(mesh.vertices == mesh.vertices[3], value, mesh.vertices), mesh.faces, process=False)
    with np.errstate(all="ignore"):
        (mesh.scene() if suffix == "3mf" else mesh).export(path)
    said = r"block\.\w+: vertex \d+, coordinate \d: a coordinate is not finite; found (nan|-?inf); allowed: a f"
    with pytest.raises(InputError, match=said):
        load_mesh(path)


@pytest.mark.parametrize("corner", ["1e30 0 0", "1 1 0"])
def test_a_huge_or_open_mesh_is_read_without_warnings(corner: str, tmp_path: Path) -> None:
    path = tmp_path / "open.obj"
    path.write_text(f"v 0 0 0\nv 1 0 0\nv {corner}\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 2 5\n")
    with np.errstate(all="raise"):
        mesh = load_mesh(path)
        if corner == "1 1 0":
            assert hull_if_nearly_convex(mesh) is None
            assert convex_cover(mesh)
        else:
            with pytest.raises(InputError, match="the mesh is too large"):
                hull_if_nearly_convex(mesh)


def torn(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same mesh with separate corners for every triangle, each with the triangle's normal."""
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    faces = np.arange(len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(corners, faces, vertex_normals=mesh.face_normals.repeat(3, axis=0), process=False)


def inside(mesh: trimesh.Trimesh, *along: float) -> list[bool]:
    """Whether a small ball at each x is in a mesh."""
    solid, ball = Cluster(MeshSolid(mesh, most=100), pin.SE3.Identity()), shapes.sphere(0.05, pin.SE3.Identity())
    places = (pin.SE3(np.eye(3), np.array([x, 0.01, 0.02])) for x in along)
    return [solid.inside_of(ball, place) is not None for place in places]


@pytest.mark.parametrize("suffix", ["obj", "dae", "glb", "ply"])
def test_a_closed_body_with_normals_by_face_is_solid(suffix: str, tmp_path: Path) -> None:
    """A block of 6 m^3 around the origin, 1 m along x."""
    torn(trimesh.creation.box((1.0, 2.0, 3.0))).export(tmp_path / f"block.{suffix}")
    mesh = load_mesh(tmp_path / f"block.{suffix}")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(6.0)
    assert inside(mesh, -0.6, -0.4, 0.0, 0.4, 0.6) == [False, True, True, True, False]


def test_closed_bodies_side_by_side_stay_solid(tmp_path: Path) -> None:
    """Two such blocks side by side: the triangles of their common faces coincide but belong to different blocks."""
    block = trimesh.creation.box((1.0, 2.0, 3.0))
    other = block.copy().apply_transform(np.diag([-1.0, 1.0, 1.0, 1.0])).apply_translation([1.0, 0.0, 0.0])
    trimesh.Scene([torn(block), torn(other)]).export(tmp_path / "blocks.glb")
    mesh = load_mesh(tmp_path / "blocks.glb")
    assert mesh.volume == pytest.approx(12.0)
    assert inside(mesh, -0.6, 0.0, 1.0, 1.6) == [False, True, True, False]


def test_a_closed_body_with_a_material_for_each_face_is_solid(tmp_path: Path) -> None:
    """A cube in OBJ as six groups with a material each: every group is open, the cube is closed."""
    corners = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
    sides = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]
    lines = ["mtllib cube.mtl", *(f"v {x} {y} {z}" for x, y, z in corners)]
    for number, (a, b, c, d) in enumerate(sides):
        lines += [f"usemtl colour_{number}", f"f {a} {b} {c}", f"f {a} {c} {d}"]
    (tmp_path / "cube.obj").write_text("\n".join(lines) + "\n")
    colours = (f"newmtl colour_{number}\nKd 0.1 0.{number} 0.5\n" for number in range(6))
    (tmp_path / "cube.mtl").write_text("".join(colours))
    mesh = load_mesh(tmp_path / "cube.obj")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(1.0)


def test_a_box_without_a_lid_stays_open(tmp_path: Path) -> None:
    block = trimesh.creation.box((1.0, 2.0, 3.0))
    open_box = trimesh.Trimesh(block.vertices, block.faces[block.face_normals[:, 2] < 0.5], process=False)
    torn(open_box).export(tmp_path / "box.obj")
    mesh = load_mesh(tmp_path / "box.obj")
    assert not mesh.is_watertight
    assert len(mesh.faces) == 10
    assert not MeshSolid(mesh, most=100).is_full


def test_a_mesh_is_closed_if_every_edge_has_an_even_number_of_triangles() -> None:
    block = trimesh.creation.box((1.0, 2.0, 3.0))
    touching = block.copy().apply_translation([1.0, 2.0, 0.0])  # they share one edge, where four faces meet
    both = trimesh.util.concatenate([block, touching])
    both.merge_vertices()
    assert len(both.vertices) == 14
    lid = block.face_normals[:, 2] > 0.5
    line = np.array([[0, 0, 1]])
    open_faces = block.faces[~lid]
    for vertices, faces, closed in (
        (block.vertices, block.faces, True),
        (both.vertices, both.faces, True),
        (block.vertices, np.vstack((block.faces, block.faces[lid][:, ::-1], line)), True),  # a two-sided lid
        (block.vertices, open_faces, False),
        (block.vertices, np.vstack((open_faces, open_faces[:, ::-1])), False),  # two-sided all over
        (both.vertices, both.faces[1:], False),
    ):
        assert is_closed(trimesh.Trimesh(vertices, faces, process=False)) == closed


def test_a_missing_mesh_file_and_a_folder_are_named(tmp_path: Path) -> None:
    for path in (tmp_path / "nowhere.stl", tmp_path):
        with pytest.raises(InputError, match="no such mesh file") as caught:
            load_mesh(path)
        assert str(path) in str(caught.value)
