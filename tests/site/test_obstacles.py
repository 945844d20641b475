"""Obstacles and their files: each becomes convex pieces at the pose of the scene, or an error names it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.machine import Robot
from backhoe_planner.site import (
    Obstacle,
    build_obstacles,
    load_scene,
    obstacle_warnings,
    read_heights,
    read_points,
    scene_from_dict,
)


def build(robot: Robot, folder: Path, **keys: object) -> Obstacle:
    data: dict[str, Any] = {
        "version": 1,
        "start": {"joints": {}},
        "task": {"goal": {"position": [0, 0, 0]}},
        "obstacles": [{"name": "thing", **keys}],
    }
    return build_obstacles(scene_from_dict(data, folder=folder, file=folder / "scene.yaml"), robot)[0]


def extent(obstacle: Obstacle) -> Matrix:
    """(2, 3) lowest and highest corner of all pieces in the world frame."""
    points = np.vstack([piece.hull for piece in obstacle.pieces])
    return np.array([points.min(axis=0), points.max(axis=0)])


def test_an_obstacle_kilometres_away_gives_a_warning(planar4: Robot, tmp_path: Path) -> None:
    """The arm reaches 4 m: an obstacle that begins 4,000 m from its base is 1,000 times as far away."""
    points = tmp_path / "millimetres.csv"
    points.write_text("5000,0,0\n5010,10,0\n5000,10,10\n")
    ground = {"shape": "halfspace", "point": [0, 0, -1], "normal": [0, 0, 1]}
    near, far = ({"shape": "sphere", "radius": 1.0, "position": [x, 0.0, 0.0]} for x in (50.0, 4001.0))
    scan = {"shape": "pointcloud", "file": points.name, "resolution": 0.1}
    found = [obstacle_warnings(planar4, [build(planar4, tmp_path, **one)]) for one in (ground, near, far, scan)]
    assert found[:2] == [(), ()]
    assert "thing is 4,000 m away, 1,000 times as far" in found[2][0]
    assert "in metres" in found[3][0]


def test_ground_with_heights_above_the_sea_gives_a_warning(planar4: Robot, tmp_path: Path) -> None:
    """The arm reaches 4 m up. Ground is solid down to 50 m below its lowest height, so to 237 m and to -20 m here."""
    (tmp_path / "ground.csv").write_text("287,287.5\n287,287\n")
    ground: dict[str, object] = {"shape": "heightmap", "file": "ground.csv", "size": [10.0, 10.0]}
    low, beside = [1.0, 2.0, -257.0], [20.0, 0.0, 0.0]
    found = [
        obstacle_warnings(planar4, [build(planar4, tmp_path, **ground, position=place)])
        for place in ([1.0, 2.0, 0.0], low, beside)
    ]
    assert "ends 233 m above the machine" in found[0][0]
    assert "`position: [1, 2, -288]`" in found[0][0]
    (within,) = found[1]
    assert "base, which does not move, stands in thing" in within
    assert "sea" not in " ".join(found[2])


def test_surveys_out_of_reach_give_one_warning_and_none_beside_one_within_reach(planar4: Robot, tmp_path: Path) -> None:
    (tmp_path / "wall.xyz").write_text("".join(f"0 {0.1 * step} 0\n" for step in range(20)))
    scan: dict[str, object] = {"shape": "pointcloud", "file": "wall.xyz", "resolution": 0.2}
    far, near = ([build(planar4, tmp_path, **scan, position=[x, 0.0, 0.0])] for x in (20.0, 3.0))
    (warning,) = obstacle_warnings(planar4, far)
    assert "reaches nothing of thing: the nearest part is 20 m away; does the machine stand elsewhere" in warning
    assert obstacle_warnings(planar4, [*far, *near]) == ()


def test_a_stray_point_far_away_is_told_from_map_coordinates(planar4: Robot, tmp_path: Path) -> None:
    rows = [f"{x:.3f} {y:.3f} {z:.3f}" for x, y, z in np.random.default_rng(5).uniform(0.0, 30.0, (300, 3))]
    keys: dict[str, object] = {"shape": "pointcloud", "file": "scan.xyz", "resolution": 0.1}
    for stray, words in (
        ("1000000 0 0", "the other 300 are near: leave it out"),
        ("9000 0 0", "along x, from 0 to 9,000.1 m.*nearly all are from 0.* to 29.* m"),
    ):
        (tmp_path / "scan.xyz").write_text("\n".join([*rows, stray]))
        with pytest.raises(SceneError, match=words) as caught:
            build(planar4, tmp_path, **keys)
        assert "map_origin" not in str(caught.value)


BLOCK = b"solid block\nendsolid block\n"

FILES: dict[str, tuple[str, str, bytes | None, dict[str, object], str]] = {
    "mesh missing": ("mesh", "a.stl", None, {}, "no such mesh file"),
    "mesh empty": ("mesh", "a.stl", b"", {}, "empty"),
    "mesh garbage": ("mesh", "a.stl", b"no triangles in here", {}, "triangles|can be read"),
    "mesh without triangles": ("mesh", "a.stl", BLOCK, {}, "triangles|can be read"),
    "mesh of an unknown kind": ("mesh", "a.dwgx", b"x", {}, "can be read"),
    "heights missing": ("heightmap", "a.csv", None, {"size": [1, 1]}, "no such height map file"),
    "heights empty": ("heightmap", "a.csv", b"", {"size": [1, 1]}, "empty"),
    "heights blank": ("heightmap", "a.csv", b" \n", {"size": [1, 1]}, "empty"),
    "heights not text": ("heightmap", "a.csv", b"\xff\xfe\x81", {"size": [1, 1]}, "is not UTF-8 text"),
    "heights in words": (
        "heightmap",
        "a.csv",
        b"x,y\n1,2\n",
        {"size": [1, 1]},
        "row 1, column 1: is not a number; found x",
    ),
    "heights ragged": ("heightmap", "a.csv", b"1,2,3\n4,5\n", {"size": [1, 1]}, r"different lengths; found \[2, 3\]"),
    "heights with a hole": (
        "heightmap",
        "a.csv",
        b"1,,3\n4,5,\n",
        {"size": [1, 1]},
        "row 1, column 2: .*found nothing",
    ),
    "one height": ("heightmap", "a.csv", b"1\n", {"size": [1, 1]}, r"at least 2 x 2 heights; found \(1, 1\)"),
    "one row of heights": (
        "heightmap",
        "a.csv",
        b"1,2,3\n",
        {"size": [1, 1]},
        r"at least 2 x 2 heights; found \(1, 3\)",
    ),
    "height NaN": ("heightmap", "a.csv", b"1,nan\n2,3\n", {"size": [1, 1]}, "a height is missing"),
    "height infinite": ("heightmap", "a.csv", b"1,inf\n2,3\n", {"size": [1, 1]}, "not finite"),
    "height beyond any site": (
        "heightmap",
        "a.csv",
        b"1,2\n2,-1e308\n",
        {"size": [1, 1]},
        r"a\.csv: row 2, column 2: a height is too large; found -1e\+308; allowed: -100000 to 100000 m",
    ),
    "height a little beyond": ("heightmap", "a.csv", b"1,100001\n2,3\n", {"size": [1, 1]}, "row 1, column 2: a height"),
    "points missing": ("pointcloud", "a.ply", None, {"resolution": 0.1}, "no such point cloud file"),
    "points empty": ("pointcloud", "a.ply", b"", {"resolution": 0.1}, "empty|can be read|no points"),
    "points garbage": ("pointcloud", "a.ply", b"ply?\nnot really\n", {"resolution": 0.1}, "is not a PLY"),
    "points text empty": ("pointcloud", "a.xyz", b"", {"resolution": 0.1}, "empty"),
    "points header only": ("pointcloud", "a.csv", b"x,y,z\n", {"resolution": 0.1}, "no points"),
    "points of two numbers": (
        "pointcloud",
        "a.xyz",
        b"1 2 3\n4 5\n",
        {"resolution": 0.1},
        "line 2: has fewer than three",
    ),
    "points in words": (
        "pointcloud",
        "a.xyz",
        b"1 2 3\n4 five 6\n",
        {"resolution": 0.1},
        "line 2: is not a number.*five",
    ),
    "point beyond any site": (
        "pointcloud",
        "a.xyz",
        b"1 2 3\n4 5 1e308\n",
        {"resolution": 0.1},
        r"a\.xyz: point 2, coordinate 3: a coordinate is too large; found 1e\+308; allowed: -100000 to 100000 m",
    ),
    "points not text": (
        "pointcloud",
        "a.npy",
        b"\x93NUMPY\x01",
        {"resolution": 0.1},
        r"a\.npy: is not UTF-8 text: .*; allowed: text with x, y, z in a line \(CSV, XYZ\), or \.ply, \.pcd, \.las, ",
    ),
    "point NaN": (
        "pointcloud",
        "a.xyz",
        b"1 2 3\nnan nan nan\n",
        {"resolution": 0.1},
        "point 2, coordinate 1: a coordinate is missing",
    ),
    "points too fine": (
        "pointcloud",
        "a.xyz",
        b"\n".join(b"%d %d 0" % (1000 * k, 2 * k) for k in range(40)),
        {"resolution": 0.5},
        r"\(thing\)\.file: .*a\.xyz: is too fine.*found 78,001 voxels along .*up to 65,000.*coarser resolution",
    ),
}


@pytest.mark.parametrize(("shape", "name", "content", "keys", "said"), FILES.values(), ids=FILES.keys())
def test_errors_in_an_obstacles_file_name_scene_obstacle_and_file(
    shape: str,
    name: str,
    content: bytes | None,
    keys: dict[str, object],
    said: str,
    planar4: Robot,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match=said) as caught:
        build(planar4, tmp_path, shape=shape, file=name, **keys)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'scene.yaml'}: obstacles[0] (thing).file: ")
    if "too fine" not in message:
        assert str(tmp_path / name) in message
    assert capfd.readouterr() == ("", "")


def test_a_folder_instead_of_a_file_is_refused(planar4: Robot, tmp_path: Path) -> None:
    for shape, keys in (("mesh", {}), ("heightmap", {"size": [1, 1]}), ("pointcloud", {"resolution": 1.0})):
        with pytest.raises(SceneError, match=r"\(thing\)\.file"):
            build(planar4, tmp_path, shape=shape, file=".", **keys)


def test_files_are_searched_beside_the_scene(planar4: Robot, tmp_path: Path) -> None:
    folder = tmp_path / "site"
    folder.mkdir()
    trimesh.creation.box((1.0, 1.0, 1.0)).export(folder / "block.stl")
    (folder / "scene.yaml").write_text(
        "version: 1\nstart: {joints: {}}\ntask: {goal: {position: [0, 0, 0]}}\n"
        "obstacles: [{name: block, shape: mesh, file: block.stl, position: [0, 0, 5]}]\n"
    )
    (found,) = build_obstacles(load_scene(folder / "scene.yaml"), planar4)
    np.testing.assert_allclose(extent(found), [[-0.5, -0.5, 4.5], [0.5, 0.5, 5.5]], atol=1e-9)


PLACED: dict[str, tuple[dict[str, object], list[list[float]]]] = {
    "box": ({"shape": "box", "size": [1, 2, 3], "position": [1, 1, 1]}, [[0.5, 0, -0.5], [1.5, 2, 2.5]]),
    "box turned": ({"shape": "box", "size": [1, 2, 3], "rpy": [0, 0, np.pi / 2]}, [[-1, -0.5, -1.5], [1, 0.5, 1.5]]),
    "box turned by quaternion": (
        {"shape": "box", "size": [1, 2, 3], "quaternion": [np.sqrt(0.5), 0, np.sqrt(0.5), 0]},
        [[-1.5, -1, -0.5], [1.5, 1, 0.5]],
    ),
    "sphere": ({"shape": "sphere", "radius": 0.4, "position": [4, 0.5, -0.3]}, [[4, 0.5, -0.3], [4, 0.5, -0.3]]),
    "capsule": ({"shape": "capsule", "from": [1, -3, -1], "to": [1, 3, -1], "radius": 0.1}, [[1, -3, -1], [1, 3, -1]]),
    "capsule downwards": (
        {"shape": "capsule", "from": [0, 0, 2], "to": [0, 0, -1], "radius": 0.1},
        [[0, 0, -1], [0, 0, 2]],
    ),
}


@pytest.mark.parametrize(("keys", "expected"), PLACED.values(), ids=PLACED.keys())
def test_shapes_have_the_pose_of_the_scene(
    keys: dict[str, object], expected: list[list[float]], planar4: Robot, tmp_path: Path
) -> None:
    np.testing.assert_allclose(extent(build(planar4, tmp_path, **keys)), expected, atol=1e-12)


def test_a_cylinder_becomes_the_32_sided_prism_around_it(planar4: Robot, tmp_path: Path) -> None:
    (piece,) = build(planar4, tmp_path, shape="cylinder", radius=1.0, length=2.0).pieces
    assert piece.hull.shape == (64, 3)
    np.testing.assert_allclose(np.abs(piece.hull[:, 2]), 1.0)
    np.testing.assert_allclose(np.hypot(piece.hull[:, 0], piece.hull[:, 1]), 1.0 / np.cos(np.pi / 32))


def test_a_mesh_is_scaled_before_it_is_placed(planar4: Robot, tmp_path: Path) -> None:
    trimesh.creation.box((1000.0, 1000.0, 1000.0)).export(tmp_path / "mm.stl")
    metres = build(planar4, tmp_path, shape="mesh", file="mm.stl", scale=0.001, position=[1, 0, 0])
    np.testing.assert_allclose(extent(metres), [[0.5, -0.5, -0.5], [1.5, 0.5, 0.5]], atol=1e-6)
    flat = build(planar4, tmp_path, shape="mesh", file="mm.stl", scale=[0.001, 0.002, 0.003])
    np.testing.assert_allclose(extent(flat), [[-0.5, -1.0, -1.5], [0.5, 1.0, 1.5]], atol=1e-6)


def test_a_flat_mesh_is_an_obstacle(planar4: Robot, tmp_path: Path) -> None:
    """Qhull refuses a flat hull, and coal ends the process at one."""
    sheet = trimesh.Trimesh([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], [[0, 1, 2], [0, 2, 3]])
    sheet.export(tmp_path / "sheet.stl")
    found = extent(build(planar4, tmp_path, shape="mesh", file="sheet.stl"))
    np.testing.assert_allclose(found, [[0, 0, 1], [1, 1, 1]], atol=1e-3)


def test_a_flat_mesh_in_a_tilted_plane_is_an_obstacle(planar4: Robot, tmp_path: Path) -> None:
    turn = trimesh.transformations.euler_matrix(0.3, 0.2, 0.1)
    sheet = trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]], [[0, 1, 2], [1, 3, 2]])
    sheet.apply_transform(turn).export(tmp_path / "sheet.stl")
    found = extent(build(planar4, tmp_path, shape="mesh", file="sheet.stl"))
    np.testing.assert_allclose(found, sheet.bounds, atol=1e-3)


def test_height_map_is_centred_and_reaches_50_m_below_its_lowest_point(planar4: Robot, tmp_path: Path) -> None:
    (tmp_path / "hill.csv").write_text("0,0,0\n0,1,0\n0,0,0\n")
    found = build(planar4, tmp_path, shape="heightmap", file="hill.csv", size=[4, 6], position=[10, 0, 2])
    np.testing.assert_allclose(extent(found), [[8, -3, 2 - 50], [12, 3, 2 + 1]], atol=1e-12)


@pytest.mark.parametrize("text", ["0,1\n2,3\n", "0;1\r\n2;3\r\n", "\ufeff0, 1,\n2, 3,\n\n", "0,0;1,0\n2,0;3,0\n"])
def test_heights_are_read_with_commas_semicolons_and_spreadsheet_artefacts(text: str, tmp_path: Path) -> None:
    path = tmp_path / "heights.csv"
    path.write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_heights(path), [[0.0, 1.0], [2.0, 3.0]])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("scan.xyz", "1 2 3\n4 5 6\n"),
        ("scan.csv", "x,y,z,intensity\n1,2,3,9\n4,5,6,9\n"),
        ("decimals.csv", "x;y;z\n1,0;2,0;3,0\n4,0;5,0;6,0\n"),
        ("scan.txt", "# a scan\n1 2 3 255 0 0\n\n4 5 6 255 0 0\n"),
        (
            "scan.ply",
            "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
            "end_header\n1 2 3\n4 5 6\n",
        ),
    ],
)
def test_points_are_read_from_text_and_ply(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    np.testing.assert_array_equal(read_points(path), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])


def test_all_vertices_of_an_obj_are_points(tmp_path: Path) -> None:
    """Whether a face has them or not, and whichever material."""
    vertices = [[0.0, 2.0, 0.0], [0.1, 2.0, 0.0], [0.2, 2.0, 0.5], [3.0, 2.0, -1.0]]
    lines = ["mtllib a.mtl", *(f"v {x} {y} {z} 1 0 0" for x, y, z in vertices), "vn 0 0 1", "usemtl a", "f 1 2 3"]
    (tmp_path / "scan.obj").write_text("\n".join([*lines, "usemtl b", "f 1 3 2"]))
    np.testing.assert_array_equal(read_points(tmp_path / "scan.obj"), vertices)
    (tmp_path / "scan.obj").write_text("v 1 2\n")
    with pytest.raises(InputError, match=r"line 1: is no vertex; found v 1 2; allowed: v X Y Z"):
        read_points(tmp_path / "scan.obj")


def test_all_solids_of_an_stl_are_points(tmp_path: Path) -> None:
    corners = "vertex {1} 0 0\nvertex {1} 1 0\nvertex {1} 0 1\n"
    one = f"solid {{0}}\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid {{0}}\n"
    (tmp_path / "two.stl").write_text(one.format("a", 1.0) + one.format("b", 5.0))
    assert set(read_points(tmp_path / "two.stl")[:, 0]) == {1.0, 5.0}


@pytest.mark.parametrize("name", ["scan.rcp", "scan.FLS"])
def test_clouds_of_scanner_makers_are_refused_with_what_converts_them(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(bytes(300))
    with pytest.raises(InputError, match=r"which is not read; allowed: text .*makes an E57 or LAZ of it"):
        read_points(tmp_path / name)


def test_the_voxels_of_a_scan_turn_with_its_pose(planar4: Robot, tmp_path: Path) -> None:
    (tmp_path / "scan.xyz").write_text("1.05 0.05 0.05\n1.15 0.05 0.05\n")
    found = build(
        planar4,
        tmp_path,
        shape="pointcloud",
        file="scan.xyz",
        resolution=0.1,
        position=[0, 0, 1],
        rpy=[0, 0, np.pi / 2],
    )
    assert len(found.pieces) == 1
    np.testing.assert_allclose(extent(found), [[-0.1, 1.0, 1.0], [0.0, 1.2, 1.1]], atol=1e-12)


def test_an_obstacle_has_the_values_of_the_scene(planar4: Robot, tmp_path: Path) -> None:
    found = build(
        planar4, tmp_path, shape="sphere", radius=1, clearance=0.3, links=["link4"], appears_at=2.0, velocity=[0, -1, 0]
    )
    assert (found.name, found.clearance, found.links, found.appears_at, found.moves) == (
        "thing",
        0.3,
        ("link4",),
        2.0,
        True,
    )
    np.testing.assert_array_equal(found.velocity, [0.0, -1.0, 0.0])
    with pytest.raises(ValueError, match="read-only"):
        found.velocity[0] = 1.0
    assert not build(planar4, tmp_path, shape="sphere", radius=1).moves


def test_errors_of_the_file_readers_are_input_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such height map file"):
        read_heights(tmp_path / "nowhere.csv")
    with pytest.raises(InputError, match="no such point cloud file"):
        read_points(tmp_path / "nowhere.xyz")


def test_a_height_grid_given_as_points_or_points_given_as_a_grid_are_refused(tmp_path: Path) -> None:
    nodes = [(x, y, 0.1 * x - 0.2 * y) for y in range(3) for x in range(4)]
    np.savetxt(tmp_path / "nodes.csv", nodes, delimiter=",", fmt="%.3f")
    with pytest.raises(InputError, match=r"holds x, y, z of points.*12 rows of 3"):
        read_heights(tmp_path / "nodes.csv")
    np.testing.assert_allclose(read_points(tmp_path / "nodes.csv"), nodes, atol=1e-9)
    coloured = [(*node, 200.0, 100.0, 50.0) for node in nodes[1:]]  # one node is missing
    np.savetxt(tmp_path / "coloured.csv", coloured, delimiter=",", fmt="%.3f")
    with pytest.raises(InputError, match=r"holds x, y, z of points.*11 rows of 6"):
        read_heights(tmp_path / "coloured.csv")
    np.savetxt(tmp_path / "grid.xyz", np.zeros((40, 40)))
    with pytest.raises(InputError, match="too many numbers in a row for a list of points; found 40"):
        read_points(tmp_path / "grid.xyz")
    # three columns of heights are not mistaken for points
    np.savetxt(tmp_path / "strip.csv", np.random.default_rng(0).normal(size=(30, 3)), delimiter=",")
    assert read_heights(tmp_path / "strip.csv").shape == (30, 3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1.0,2.0,,255,0,0\n1,2,3,255,0,0\n", r"line 1: has an empty cell among x, y, z"),
        ("1;;3\n4;5;6\n", r"line 1: has an empty cell"),
        ("1.0 2.0 O.3\n4 5 6\n", r"line 1: is not a number"),
        ("1,5 2 3\n4 5 6\n", r"line 1: has commas and blanks"),
        ("1_0 2 3\n", r"line 1: is not a number"),
        ("x,y,z\n", "holds no points"),
    ],
)
def test_a_broken_line_of_points_is_an_error_and_not_taken_as_a_header(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "scan.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_points(tmp_path / "scan.csv")


_SCAN = ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.5, 8.0, 9.0), (1.0, 1.0, -9.0))


@pytest.mark.parametrize(
    ("text", "points"),
    [
        ("nr,x,y,z\n1,1,2,3\n2,4,5,6\n3,7.5,8,9\n4,1,1,-9\n", _SCAN),
        ("Northing;Easting;Code;Elevation\n2;1;a;3\n5;4;b;6\n8;7,5;c;9\n1;1;d;-9\n", _SCAN),
        ('"x","y","z"\n"1","2","3"\n"4","5","6"\n"7.5","8","9"\n"1","1","-9"\n', _SCAN),
        ("intensity,x [m],y [m],z [m]\n9,1,2,3\n9,4,5,6\n9,7.5,8,9\n9,1,1,-9\n", _SCAN),
        ("id,X (m),Y (m),Z (metres)\n7,1,2,3\n9,4,5,6\n3,7.5,8,9\n4,1,1,-9\n", _SCAN),
        ("Point ID\tX\tY\tZ\n1\t1\t2\t3\n2\t4\t5\t6\n9\t7.5\t8\t9\n4\t1\t1\t-9\n", _SCAN),
        ("Z_m Y [m] X(m)\n3 2 1\n6 5 4\n9 8 7.5\n-9 1 1\n", _SCAN),
        ("//Z Y X R\n3 2 1 0\n6 5 4 0\n9 8 7.5 0\n-9 1 1 0\n", _SCAN),
        ("4\n1 2 3\n4 5 6\n7.5 8 9\n1 1 -9\n", _SCAN),  # PTS
        ("# a scan\n# x y z\n1 2 3 7\n4 5 6 7\n# and\n7.5 8 9 7\n1 1 -9 7\n", _SCAN),
        ("Scan of the site\n1,2,3\n4,5,6\n7.5,8,9\n1,1,-9\n", _SCAN),
        ("1,2,3,1\n4,5,6,2\n7.5,8,9,3\n1,1,-9,4\n", _SCAN),  # numbered at the end
    ],
)
def test_points_are_read_from_the_columns_named_in_the_header(
    text: str, points: Sequence[Sequence[float]], tmp_path: Path
) -> None:
    (tmp_path / "scan.csv").write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_points(tmp_path / "scan.csv"), points)


SWAPPED = [[5.0, 4.0, 6.5], [8.0, 7.0, 9.0]]  # of points that are written y, x, z
HEADS: dict[str, str] = {
    "a title": "Survey of 3 May\nyxz\n",
    "blank lines": "\n\nyxz\n",
    "comments": "# Survey\n\n# of May\nyxz\n",
    "a line of units": "yxz\nm,m,m\n",
    "units in brackets": "yxz\n[m],[m],[m]\n",
    "CloudCompare": "//Y,X,Z\n2\n",
    "a byte order mark": "\ufeffyxz\n",
    "German": "Nord,Ost,Höhe\n",
    "German, Gauss-Krueger": "Hochwert,Rechtswert,H\n",
    "French": "nord,est,altitude\n",
    "Spanish": "Norte,Este,Cota\n",
    "letters": "N,E,Z\n",
}
BESIDE = ["x,y,z,lat,lon\n", "X [m],Y [m],Z [m],scan angle (deg),range_mm\n", "lat,lon,x,y,z\n"]


@pytest.mark.parametrize("head", BESIDE)
def test_columns_beside_x_y_z_may_have_other_units(head: str, tmp_path: Path) -> None:
    given = [48.1, 11.5, 4.0, 5.0, 6.5] if head.startswith("lat") else [4.0, 5.0, 6.5, 48.1, 11.5]
    (tmp_path / "scan.csv").write_text(head + ",".join(map(str, given)) + "\n", encoding="utf-8")
    np.testing.assert_array_equal(read_points(tmp_path / "scan.csv"), [[4.0, 5.0, 6.5]])


@pytest.mark.parametrize("head", HEADS.values(), ids=HEADS.keys())
@pytest.mark.parametrize("mark", [",", ";", "\t", " "])
def test_columns_are_named_after_titles_and_units_and_in_other_languages(head: str, mark: str, tmp_path: Path) -> None:
    text = head.replace("yxz", "y,x,z").replace(",", mark) + "4,5,6.5\n7,8,9\n".replace(",", mark)
    (tmp_path / "scan.csv").write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_points(tmp_path / "scan.csv"), SWAPPED)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Ost;Nord;Hoch\n4;5;6\n", r"header: the header does not name x, y and z once each; found Ost;Nord;Hoch"),
        ("a,b,c\n4,5,6\n", r"header: the header does not name x, y and z once each; found a,b,c"),
        ("a b c\n4 5 6\n", r"header: the header does not name x, y and z once each; found a b c"),
        ("y,x,z\nft,ft,ft\n4,5,6\n", r"header: is not in metres; found ft,ft,ft"),
        ("# x [mm] y [mm] z [mm]\n4 5 6\n", r"header: is not in metres; found x \[mm\]"),
        ("# units: feet\n4 5 6\n", r"header: is not in metres; found units: feet"),
        ("//X Y Z\n3\n4 5 6\n7 8 9\n", r"line 2: has fewer than three numbers; found 3; allowed: .* follow, 2"),
        ("x,y,z\n1,5,2,3\n4,5,6\n", r"another number of cells than the header or the first line; found line 2"),
        ("x,y,z\n1,5,2,5,3,5\n4,5,5,5,6,5\n", r"another number of cells than the header .*no decimal commas"),
        ("1,5,2,5,3,5\n4,5,5,5,6,5\n", r"may have decimal commas between commas; found 1,5,2,5,3,5"),
        ("4,5,6\n1,5,2,3\n", r"another number of cells than the header or the first line; found line 2"),
        ("O1 2 3\n4 5 6\n", r"line 1: is not a number; found O1 2 3"),
        ("nr,x,y,z\nP1,4,,6\nP2,4,5,6\n", r"line 2: has an empty cell among x, y, z"),
        ("1.0m 2.0m 3.0m\n", r"line 1: is not a number; found 1.0m"),
        ("# x y z in feet\n4 5 6 7 8\n", r"header: is not in metres; found x y z in feet"),
        ("x,y,z,ft\n4,5,6,7\n", r"header: is not in metres; found x,y,z,ft"),
        ("x,y,z [ft],lat\n4,5,6,7\n", r"header: is not in metres; found x,y,z \[ft\],lat"),
        ("x,y,depth\n1,2,3\n", r"header: the header does not name x, y and z once each"),
    ],
)
def test_heads_and_lines_that_may_be_meant_otherwise_are_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "scan.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_points(tmp_path / "scan.csv")


def test_many_comments_quotes_and_texts_are_read_without_reading_line_by_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Line by line takes ten times as long."""
    points = np.round(np.random.default_rng(4).uniform(-9.0, 9.0, (500, 3)), 3)
    rows = [",".join(f"{value}" for value in point) for point in points]
    texts = {
        "comments": "\n".join(["# x and y are a scanner's", *(line for row in rows for line in (row, "# a stop"))]),
        "quotes": "\n".join(['"x","y","z"', *('"' + row.replace(",", '","') + '"' for row in rows)]),
        "texts": "\n".join(["nr,x,y,z,code", *(f'p{number},{row},"grass, wet"' for number, row in enumerate(rows))]),
        "commas": "\n".join(["x;y;z", *(row.replace(",", ";").replace(".", ",") for row in rows)]),
    }
    monkeypatch.setattr("backhoe_planner.site.surveys.point_lists._line_by_line", None)
    for name, text in texts.items():
        (tmp_path / f"{name}.csv").write_text(text, encoding="utf-8")
        np.testing.assert_array_equal(read_points(tmp_path / f"{name}.csv"), points)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,1,2,3\n2,4,5,6\n3,7,8,9\n", r"column 1: has numbers of points.*found 1, 2, 3, \.\.\..*nr,x,y,z"),
        ("10 1 2 3 grass\n20 4 5 6 road\n30 7 8 9 grass\n", r"column 1: has numbers of points"),
        ("id,x,y,code\n1,1,2,3\n2,4,5,6\n", r"header: the header does not name x, y and z once each"),
        ("id,easting_ft,northing_ft,height_ft\n7,1,2,3\n4,4,5,6\n", r"header: is not in metres"),
        ("x [mm],y [mm],z [mm]\n7,1,2\n4,4,5\n", r"header: is not in metres; found x \[mm\],y"),
        ("lat,lon,alt\n7,1,2\n4,4,5\n", r"header: is not in metres"),
        ("# columns: x y z intensity\n3 4 -2 0.5\n3 4 -1 0.5\n", r"header: the header has another number of columns"),
        ("a,x [mm],y [mm],z [mm]\n7,1,2,3\n4,4,5,6\n", r"header: is not in metres"),
        ("x,y,z,x\n1,1,2,3\n2,4,5,6\n", r"header: the header does not name x, y and z once each"),
        ("nr,x,y,z\n1,1,2\n", r"line 2: has fewer cells than the header"),
        ("1 2 3\n4 5 -9999\n", r"point 2, z: a height is missing; found -9999"),
        ("455324.5 5412345.5 300\n", r"point 1, coordinate 1: a coordinate is too large.*map coordinates"),
    ],
)
def test_points_that_would_be_misread_are_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "scan.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_points(tmp_path / "scan.csv")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0,0,0\n0,-9999,0\n0,0,0\n", r"row 2, column 2: a height is missing"),
        ("0,0,0\n0,0,-32768\n0,0,0\n", r"row 2, column 3: a height is missing"),
        ("0,0,0\n0,-3.4028235e38,0\n0,0,0\n", r"row 2, column 2: a height is missing; found none, or a figure that"),
        ("0,0,\n0,0,0\n0,0,0\n", r"row 1, column 3: is not a number; found nothing"),
        ("ncols 3\nnrows 2\n0 0 0\n0 0 0\n", r"of an ESRI grid make a GeoTIFF"),
        (
            "".join(f"{5 * i + j + 1},{i},{j},0.1\n" for i in range(5) for j in range(5)),
            "holds x, y, z of points, not heights on a grid",
        ),
    ],
)
def test_heights_that_would_be_misread_are_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "ground.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_heights(tmp_path / "ground.csv")


def test_heights_with_quotes_decimal_commas_and_comments_are_read(tmp_path: Path) -> None:
    (tmp_path / "ground.csv").write_text('# of 3 May\n"0,5";"1,5"\n"2,5";"3,5"\n', encoding="utf-8")
    np.testing.assert_array_equal(read_heights(tmp_path / "ground.csv"), [[0.5, 1.5], [2.5, 3.5]])
    (tmp_path / "ground.csv").write_text('"0,5","1,5"\n"2,5","3,5"\n', encoding="utf-8")
    with pytest.raises(InputError, match="row 1, column 1: is not a number; found 0,5"):
        read_heights(tmp_path / "ground.csv")


def test_decimal_commas_in_a_point_cloud_are_refused(planar4: Robot, tmp_path: Path) -> None:
    (tmp_path / "scan.txt").write_text("x y z\n1,5 2,5 3,5\n", encoding="utf-8")
    with pytest.raises(SceneError, match="line 2: has commas and blanks"):
        build(planar4, tmp_path, shape="pointcloud", file="scan.txt", resolution=0.1)


MAP = np.array([500_000.0, 5_400_000.0, 300.0])  # as in UTM coordinates


def test_a_survey_in_map_coordinates_is_moved_by_its_map_origin(planar4: Robot, tmp_path: Path) -> None:
    """A box of 1 x 2 x 3 m around the point 4 m north of the origin, and two points at its ends."""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    box.apply_translation(MAP + np.array([0.0, 4.0, 0.0]))
    box.export(tmp_path / "box.obj", digits=3)
    (tmp_path / "ends.xyz").write_text("500000.05 5400003.05 300.05\n500000.05 5400004.95 300.05\n")
    moved: dict[str, object] = {"map_origin": MAP.tolist(), "position": [10, 0, 1]}
    found = build(planar4, tmp_path, shape="mesh", file="box.obj", **moved)
    np.testing.assert_allclose(extent(found), [[9.5, 3.0, -0.5], [10.5, 5.0, 2.5]], atol=1e-6)
    found = build(planar4, tmp_path, shape="pointcloud", file="ends.xyz", resolution=0.1, **moved)
    np.testing.assert_allclose(extent(found), [[10.0, 3.0, 1.0], [10.1, 5.0, 1.1]], atol=1e-6)
    half = build(planar4, tmp_path, shape="mesh", file="box.obj", scale=0.5, map_origin=MAP.tolist())
    np.testing.assert_allclose(extent(half), [[-0.25, 1.5, -0.75], [0.25, 2.5, 0.75]], atol=1e-6)


def test_a_survey_in_map_coordinates_is_refused_with_the_map_origin_to_write(planar4: Robot, tmp_path: Path) -> None:
    """The middle of its box along x and y, and its lowest z, in the units of the file."""
    (tmp_path / "scan.xyz").write_text("500000.2 5400001 300\n500002.2 5400005 304\n")
    box = trimesh.creation.box((2.0, 4.0, 6.0))
    box.apply_translation(MAP)
    box.export(tmp_path / "box.obj")
    for keys, written in (
        ({"shape": "pointcloud", "file": "scan.xyz", "resolution": 0.1}, "[500001, 5400003, 300]"),
        ({"shape": "mesh", "file": "box.obj"}, "[500000, 5400000, 297]"),
        ({"shape": "mesh", "file": "box.obj", "scale": 0.1}, "[500000, 5400000, 297]"),
        ({"shape": "mesh", "file": "box.obj", "velocity": [1, 0, 0]}, "[500000, 5400000, 297]"),
    ):
        with pytest.raises(SceneError, match=r"a coordinate is too large.*`map_origin: ") as caught:
            build(planar4, tmp_path, **keys)
        assert f"`map_origin: {written}` puts" in str(caught.value)
        found = build(planar4, tmp_path, **keys, map_origin=[float(x) for x in written.strip("[]").split(",")])
        assert np.abs(extent(found)).max() < 10.0
    said = r"coordinate 1: a coordinate less map_origin \[5400001\.0, 500003\.0, 300\.0\] is too large; found -4\.9"
    with pytest.raises(SceneError, match=said):
        build(planar4, tmp_path, shape="pointcloud", file="scan.xyz", resolution=0.1, map_origin=[5400001, 500003, 300])
    with pytest.raises(InputError, match=r"subtract \[500001, 5400003, 300\] from all points"):
        read_points(tmp_path / "scan.xyz")


@pytest.mark.parametrize(
    ("name", "keys"), [("box.ply", {}), ("box.stl", {}), ("box.dae", {}), ("box.ply", {"velocity": [1, 0, 0]})]
)
def test_floats_of_32_bits_in_map_coordinates_are_refused(
    name: str, keys: dict[str, object], planar4: Robot, tmp_path: Path
) -> None:
    """5,400,000 m is one of the multiples of 0.5 m that such a float has there."""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    box.apply_translation(MAP)
    box.export(tmp_path / name)
    with pytest.raises(SceneError, match=r"floats of 32 bits, rounded to 0\.5 m so far from 0"):
        build(planar4, tmp_path, shape="mesh", file=name, map_origin=MAP.tolist(), **keys)


def test_doubles_of_a_ply_in_map_coordinates_are_read(tmp_path: Path) -> None:
    head = (
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
    )
    (tmp_path / "scan.ply").write_text(head + "500000.25 5400000.125 300.5\n")
    found = read_points(tmp_path / "scan.ply", map_origin=MAP.tolist())
    np.testing.assert_array_equal(found, [[0.25, 0.125, 0.5]])


def test_the_warning_about_a_far_survey_has_the_map_origin_to_write(planar4: Robot, tmp_path: Path) -> None:
    (tmp_path / "scan.xyz").write_text("4500.05 53000.05 12.05\n4502.05 53002.05 14.05\n")
    keys = {"shape": "pointcloud", "file": "scan.xyz", "resolution": 0.1}
    (found,) = obstacle_warnings(planar4, [build(planar4, tmp_path, **keys, position=[1, 2, 3])])
    assert found.endswith("; `map_origin: [4501, 53001, 12]` puts the middle of its file at its position")
    near = build(planar4, tmp_path, **keys, map_origin=[4501, 53001, 12])
    np.testing.assert_allclose(extent(near), [[-1.0, -1.0, 0.0], [1.1, 1.1, 2.1]], atol=1e-6)


@pytest.mark.parametrize(("points", "told"), [(300, True), (20_000, False)])
def test_the_warning_about_a_scan_with_gaps_names_a_resolution_that_closes_them(
    planar4: Robot, tmp_path: Path, points: int, told: bool
) -> None:
    """300 points on 100 m^2 are some 0.6 m apart, 20,000 nearly fill the 10,000 squares of 0.1 m."""
    rng = np.random.default_rng(0)
    ground = np.column_stack((rng.uniform(-5.0, 5.0, (points, 2)), np.full(points, -2.05)))
    np.savetxt(tmp_path / "yard.xyz", ground)
    scan = {"name": "yard", "shape": "pointcloud", "file": "yard.xyz", "resolution": 0.1}
    found = obstacle_warnings(planar4, [build(planar4, tmp_path, **scan)])
    assert len(found) == told
    if told:
        assert "yard has gaps: many of its 29" in found[0]
        assert (
            "at a resolution of 0.8 m most touch others" in found[0]
            or "at a resolution of 0.4 m most touch others" in found[0]
        )
