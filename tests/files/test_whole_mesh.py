"""A truncated file of points or triangles is refused, a complete one is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

import backhoe_planner as bp
from backhoe_planner.machine.shape.convex import load_mesh
from backhoe_planner.site.schema.survey_files import read_points

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
