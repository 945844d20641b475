"""A truncated file of points or triangles is refused, a complete one is not."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh

import backhoe_planner as bp
from backhoe_planner.machine.shape.convex import load_mesh
from backhoe_planner.site.surveys.survey_files import read_points

BOX = trimesh.creation.box((1.0, 2.0, 3.0))


def exported(path: Path, **keys: str) -> list[str]:
    BOX.export(path, **keys)
    return path.read_text().splitlines()


@pytest.mark.parametrize(
    ("suffix", "keys"), [(".ply", {"encoding": "ascii"}), (".off", {}), (".stl", {"file_type": "stl_ascii"})]
)
def test_a_mesh_without_its_last_lines_is_refused(tmp_path: Path, suffix: str, keys: dict[str, str]) -> None:
    path = tmp_path / f"box{suffix}"
    lines = exported(path, **keys)
    assert len(load_mesh(path).faces) == 12
    path.write_text("\n".join([*lines, "", ""]))
    assert len(load_mesh(path).faces) == 12
    for cut in (1, 3, 8):
        path.write_text("\n".join(lines[:-cut]) + "\n")
        with pytest.raises(bp.InputError, match="cut short"):
            load_mesh(path)


def test_points_without_the_last_ones_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "scan.ply"
    points = np.random.default_rng(1).uniform(-3.0, 3.0, (40, 3))
    trimesh.PointCloud(points).export(path, encoding="ascii")
    lines = path.read_text().splitlines()
    np.testing.assert_allclose(read_points(path), points, atol=1e-6)
    for cut in (1, 20):
        path.write_text("\n".join(lines[:-cut]) + "\n")
        with pytest.raises(bp.InputError, match=f"cut short.*{40 - cut} lines"):
            read_points(path)
    path.write_text("\n".join([*lines, "1 2 3"]))
    with pytest.raises(bp.InputError, match="more than its header says"):
        read_points(path)


def test_binary_meshes_are_read_and_refused_when_truncated(tmp_path: Path) -> None:
    for suffix in (".ply", ".stl"):
        path = tmp_path / f"box{suffix}"
        BOX.export(path)
        assert len(load_mesh(path).faces) == 12
        path.write_bytes(path.read_bytes()[:-30])
        with pytest.raises(bp.InputError):
            load_mesh(path)


BROKEN_OBJ = {
    "a vertex of two numbers": ("v 3 0 0\nv 3 1\nv 4 1 1 7\nf 1 2 3\n", "line 2: is not a vertex.*found v 3 1;"),
    "all vertices of two numbers": ("v 3 0\nv 3 1\nv 4 1\nf 1 2 3\n", "line 1: is not a vertex"),
    "a vertex of five numbers": ("v 3 0 0 1 1\nv 3 1 0\nf 1 2 1\n", "line 1: is not a vertex"),
    "a vertex counted from 0": ("v 3 0 0\nv 3 1 0\nv 4 1 1\nf 0 1 2\n", "line 4: is not a face.*numbered from 1"),
    "a face of two vertices": ("v 3 0 0\nv 3 1 0\nv 4 1 1\nf 1 2\n", "line 4: is not a face"),
    "a face of a vertex too many": ("v 3 0 0\nv 3 1 0\nv 4 1 1\nf 1 2 4\n", "line 4: .* not there; found 3 vertices"),
    "counted back too far": ("v 3 0 0\nv 3 1 0\nv 4 1 1\nf -1 -2 -4\n", "line 4: .* not there"),
    "counted back, and more": ("v 3 0 0\nv 3 1 0\nv 4 1 1\nf -3 -2 -1\nv 9 9 9\nf -3 -2 -1\n", "counts vertices back"),
}


@pytest.mark.parametrize(("text", "said"), BROKEN_OBJ.values(), ids=BROKEN_OBJ.keys())
def test_invalid_vertices_and_faces_of_an_obj_are_refused(text: str, said: str, tmp_path: Path) -> None:
    """The reader lets numbers run on: without the check the first of these would be another triangle."""
    file = tmp_path / "broken.obj"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(bp.InputError, match=said):
        load_mesh(file)


@pytest.mark.parametrize(
    "text",
    [
        "v 3 0 0\nv 3 1 0\nv 4 1 1\nf -3 -2 -1\n",
        "# a triangle\nvn 0 0 1\nv 3 0 0 1\nv 3 1 0 1\nv 4 1 1 1\nf 1//1 2//1 \\\n3//1\n",
        "v 3 0 0 .5 .5 .5\nv 3 1 0 .5 .5 .5\nv 4 1 1 .5 .5 .5\nf 1/1/1 2/2/1 3/3/1\n",
    ],
)
def test_obj_files_with_backward_indices_normals_and_colours_are_read(text: str, tmp_path: Path) -> None:
    file = tmp_path / "triangle.obj"
    file.write_text(text, encoding="utf-8")
    mesh = load_mesh(file)
    np.testing.assert_array_equal(mesh.triangles, [[[3, 0, 0], [3, 1, 0], [4, 1, 1]]])


OBJ_OF_TWO = "v 9 9 9\nv 3 0 0\nv 3 1 0\nv 4 1 2\nf 2 3 4\n"  # of which the second to the fourth vertex have a face


@pytest.mark.parametrize(
    "content",
    [
        OBJ_OF_TWO.encode("utf-8-sig"),  # without the first vertex the face would be another
        ("# Höhe\n" + OBJ_OF_TWO + "usemtl Größe\n").encode("latin-1"),
        OBJ_OF_TWO.replace("v 3 0", "v 3\\\n0").replace("f 2 3", "f 2\\\n3").encode(),
        OBJ_OF_TWO.replace("v 9 9", "v\t9 9").encode(),
        OBJ_OF_TWO.replace("\n", "\r\n").encode(),
        OBJ_OF_TWO.replace("\n", "\r").encode(),
        OBJ_OF_TWO.replace("v 4 1 2", "  v  4 1 2 # the last").encode(),
    ],
    ids=["mark", "latin-1", "continued", "tab", "crlf", "cr", "comment"],
)
def test_obj_files_as_other_programs_write_them_are_read(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "triangle.obj"
    file.write_bytes(content)
    np.testing.assert_array_equal(load_mesh(file).triangles, [[[3, 0, 0], [3, 1, 0], [4, 1, 2]]])
    np.testing.assert_array_equal(read_points(file), [[9, 9, 9], [3, 0, 0], [3, 1, 0], [4, 1, 2]])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (OBJ_OF_TWO.encode("utf-16"), "is not an OBJ that can be read: bytes of 0 are not text"),
        (OBJ_OF_TWO.replace("v 9", "V 9").encode(), "line 1: is no keyword of an OBJ; found V; allowed: v and f"),
        (b"# C:\\\n" + OBJ_OF_TWO.encode(), "line 1: a comment ends with a backslash"),
        (OBJ_OF_TWO.encode() + b"f 1 2 \\\n", "the file is cut short"),
    ],
)
def test_obj_files_that_may_be_meant_otherwise_are_refused(content: bytes, said: str, tmp_path: Path) -> None:
    file = tmp_path / "triangle.obj"
    file.write_bytes(content)
    for read in (load_mesh, read_points):
        with pytest.raises(bp.InputError, match=said):
            read(file)


CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0]]


def binary_ply(path: Path, faces: Sequence[Sequence[int]], *, order: str = "<", flags: bool = False) -> Path:
    """A PLY with the vertices `CORNERS`, colours at its faces if `flags`, and an edge after them."""
    kind = "little" if order == "<" else "big"
    flag = "property uchar red\n" if flags else ""
    head = (
        f"ply\nformat binary_{kind}_endian 1.0\nelement vertex {len(CORNERS)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\n{flag}property list uchar int vertex_indices\n"
        "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    )
    body = b"".join(struct.pack(f"{order}3f", *corner) for corner in CORNERS)
    for face in faces:
        body += (b"\x07" if flags else b"") + struct.pack(f"{order}B{len(face)}i", len(face), *face)
    path.write_bytes(head.encode() + body + struct.pack(f"{order}2i", 0, 1))
    return path


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("flags", [False, True])
@pytest.mark.parametrize(
    ("faces", "triangles"),
    [
        ([(0, 1, 2, 3), (0, 1, 2)], [(0, 1, 2), (0, 2, 3), (0, 1, 2)]),
        # as many corners as three faces of four have: read as such, the second face would have the next one's count
        (
            [(0, 1, 2, 3), (0, 1, 2), (0, 1, 2, 3, 4)],
            [(0, 1, 2), (0, 2, 3), (0, 1, 2), (0, 1, 2), (0, 2, 3), (0, 3, 4)],
        ),
        ([(0, 1, 2, 3, 4)], [(0, 1, 2), (0, 2, 3), (0, 3, 4)]),
    ],
)
def test_faces_of_different_numbers_of_corners_in_a_binary_ply_are_fans(
    faces: list[tuple[int, ...]], triangles: list[tuple[int, ...]], order: str, flags: bool, tmp_path: Path
) -> None:
    file = binary_ply(tmp_path / "mixed.ply", faces, order=order, flags=flags)
    expected = {frozenset(triangle) for triangle in triangles}
    places = {tuple(corner): index for index, corner in enumerate(CORNERS)}
    found = load_mesh(file).triangles
    assert {frozenset(places[tuple(corner)] for corner in triangle) for triangle in found.tolist()} == expected
    np.testing.assert_array_equal(read_points(file), CORNERS)


@pytest.mark.parametrize(
    ("faces", "said"),
    [
        ([(0, 1, 2, 3), (0, 1)], r"face 2: is not a face; found \(0, 1\); allowed: three corners or more"),
        ([(0, 1, 2, 3), (0, 1, 5)], r"face 2: is not a face; found \(0, 1, 5\); .* from 0 to 4"),
        ([(0, 1, -1)], "a face has a vertex that is not there; found -1"),
    ],
)
def test_faces_of_a_ply_without_their_vertices_are_refused(
    faces: list[tuple[int, ...]], said: str, tmp_path: Path
) -> None:
    with pytest.raises(bp.InputError, match=said):
        load_mesh(binary_ply(tmp_path / "mixed.ply", faces))


def test_a_ply_of_different_faces_is_refused_when_its_length_is_wrong(tmp_path: Path) -> None:
    file = binary_ply(tmp_path / "mixed.ply", [(0, 1, 2, 3), (0, 1, 2)])
    whole = file.read_bytes()
    for content in (whole[:-1], whole[:-20], whole + b"\0"):
        file.write_bytes(content)
        with pytest.raises(bp.InputError, match=r"cut short|more than its header"):
            load_mesh(file)


@pytest.mark.parametrize("number", ["1_0", "１0"])
def test_numbers_with_underscores_or_other_digits_are_refused_in_an_off(number: str, tmp_path: Path) -> None:
    file = tmp_path / "triangle.off"
    file.write_text(f"OFF\n3 1 0\n{number} 0 0\n0 1 0\n0 0 1\n3 0 1 2\n", encoding="utf-8")
    with pytest.raises(bp.InputError, match="line 3: is not a line of numbers"):
        load_mesh(file)
