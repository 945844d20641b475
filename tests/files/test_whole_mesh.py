"""A file of points or triangles that was cut short is refused, and none that is whole."""

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


def test_what_is_binary_has_no_lines_to_be_counted(tmp_path: Path) -> None:
    for suffix in (".ply", ".stl"):
        path = tmp_path / f"box{suffix}"
        BOX.export(path)
        assert len(load_mesh(path).faces) == 12
        path.write_bytes(path.read_bytes()[:-30])
        with pytest.raises(bp.InputError):
            load_mesh(path)
