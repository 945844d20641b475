"""Cached pieces of meshes equal newly made ones, also after damage and with two processes at once."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from waiting import PATIENCE

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.machine import cache_folder, convex_cover, load_mesh, load_robot, mesh_cover


def write_angle(path: Path) -> Path:
    """An L of two bars 1 m long and 0.1 m thick, which needs more than one hull."""
    bars = [trimesh.creation.box((1.0, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 1.0))]
    bars[1].apply_translation((0.45, 0.0, 0.45))
    trimesh.util.concatenate(bars).export(path)
    return path


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def entries() -> list[Path]:
    return sorted(cache_folder().iterdir()) if cache_folder().is_dir() else []


def assert_equal(found: list[Matrix], expected: list[Matrix]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_second_call_returns_the_same_pieces_from_the_cache(home: Path) -> None:
    mesh = write_angle(home / "angle.stl")
    first, second = mesh_cover(mesh, 2.0, pieces=4), mesh_cover(mesh, np.full(3, 2.0), pieces=4)
    doubled = load_mesh(mesh)
    doubled.apply_scale(2.0)
    expected = [corners for corners, _ in convex_cover(doubled, pieces=4)]
    assert len(expected) > 1
    assert (first.cached, second.cached) == (False, True)
    assert_equal(first.pieces, expected)
    assert_equal(second.pieces, expected)
    assert [entry.suffix for entry in entries()] == [".pieces"]


def test_mesh_scale_and_bounds_have_separate_entries(home: Path) -> None:
    mesh = write_angle(home / "angle.stl")
    assert not mesh_cover(mesh, 1.0, pieces=4).cached
    assert not mesh_cover(mesh, 1.1, pieces=4).cached
    assert not mesh_cover(mesh, np.array([1.0, 1.0, 1.1]), pieces=4).cached
    assert not mesh_cover(mesh, 1.0, pieces=3).cached
    assert not mesh_cover(mesh, 1.0, pieces=4, excess=1.2).cached
    trimesh.creation.box((1.0, 2.0, 3.0)).export(mesh)
    changed = mesh_cover(mesh, 1.0, pieces=4)
    assert not changed.cached
    np.testing.assert_allclose(np.ptp(changed.pieces[0], axis=0), [1.0, 2.0, 3.0], atol=1e-6)
    assert len(entries()) == 6


@pytest.mark.parametrize("damage", ["cut off", "one bit", "empty", "another entry's"])
def test_a_damaged_entry_is_replaced(home: Path, damage: str) -> None:
    mesh = write_angle(home / "angle.stl")
    made = mesh_cover(mesh, 1.0).pieces
    (entry,) = entries()
    content = entry.read_bytes()
    if damage == "another entry's":
        body = content[32:]  # intact, but its checksum does not belong to this key
        entry.write_bytes(hashlib.sha256(body).digest() + body)
    else:
        flipped = bytearray(content)
        flipped[-3] ^= 1
        entry.write_bytes({"cut off": content[:-1], "one bit": bytes(flipped), "empty": b""}[damage])
    again = mesh_cover(mesh, 1.0)
    assert not again.cached
    assert_equal(again.pieces, made)
    assert entry.read_bytes() == content
    assert mesh_cover(mesh, 1.0).cached


@pytest.mark.parametrize("why", ["a file is in its place", "it may not be written"])
def test_without_a_writable_cache_folder_the_pieces_are_computed_each_time(
    home: Path, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = write_angle(home / "angle.stl")
    above = home / "cache"
    if why == "it may not be written":
        cache_folder().mkdir(parents=True)
        monkeypatch.setattr(os, "access", lambda *_: False)  # permission bits do not stop every user
        cache_folder().chmod(0o500)
    else:
        above.write_text("in the way")
    try:
        found = [mesh_cover(mesh, 1.0) for _ in range(2)]
    finally:
        if why == "it may not be written":
            cache_folder().chmod(0o700)
    assert [cover.cached for cover in found] == [False, False]
    assert_equal(found[0].pieces, [corners for corners, _ in convex_cover(load_mesh(mesh))])
    assert entries() == []


@pytest.mark.long
def test_two_processes_at_once_write_one_complete_entry(home: Path) -> None:
    mesh = write_angle(home / "angle.stl")
    code = (
        "import sys\nfrom pathlib import Path\nfrom backhoe_planner.machine import mesh_cover\n"
        "import trimesh, vhacdx\n"
        "print('ready', flush=True)\nsys.stdin.readline()\n"
        f"print(len(mesh_cover(Path({str(mesh)!r}), 1.0).pieces))"
    )
    both = [
        subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in both:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in both:  # both start before either ends
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    counts = [int(process.communicate(timeout=PATIENCE)[0]) for process in both]
    third = mesh_cover(mesh, 1.0)
    assert third.cached
    assert counts == [len(third.pieces)] * 2
    assert len(entries()) == 1  # and no part of another


@pytest.mark.parametrize(
    ("content", "said"), [(None, "no such mesh file"), (b"", "empty"), (b"solid", "mesh|triangles")]
)
def test_invalid_meshes_are_refused_and_not_cached(home: Path, content: bytes | None, said: str) -> None:
    mesh = home / "none.stl"
    if content is not None:
        mesh.write_bytes(content)
    for _ in range(2):
        with pytest.raises(InputError, match=said):
            mesh_cover(mesh, 1.0)
    assert entries() == []


def test_a_mesh_with_data_in_other_files_is_not_cached(home: Path) -> None:
    """The bytes of a glTF file do not determine the content of its buffers."""
    mesh = home / "box.gltf"
    for name, part in trimesh.creation.box((1.0, 1.0, 1.0)).scene().export(file_type="gltf").items():
        (home / ("box.gltf" if name.endswith(".gltf") else name)).write_bytes(part)
    assert [mesh_cover(mesh, 1.0).cached for _ in range(2)] == [False, False]
    assert entries() == []


@pytest.mark.parametrize("relative", ["", "some/where"])
def test_a_relative_cache_home_is_ignored(relative: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", relative)
    monkeypatch.setenv("HOME", "/home/somebody")
    monkeypatch.setattr(sys, "platform", "linux")
    assert cache_folder() == Path("/home/somebody/.cache/backhoe_planner/convex_pieces")


def test_a_robot_records_which_of_its_pieces_came_from_the_cache(home: Path) -> None:
    write_angle(home / "angle.stl")
    urdf = home / "arm.urdf"
    urdf.write_text(
        '<robot name="r"><link name="base"><collision><geometry><box size="1 1 1"/></geometry></collision></link>'
        '<link name="arm"><collision><geometry><mesh filename="angle.stl"/></geometry></collision></link>'
        '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    first, second = load_robot(urdf), load_robot(urdf)
    count = len(first.pieces) - 1
    assert count > 1
    assert [solid.cached for solid in first.solids] == [None] + [False] * count
    assert [solid.cached for solid in second.solids] == [None] + [True] * count
    for one, other in zip(first.pieces, second.pieces, strict=True):
        np.testing.assert_array_equal(one.piece.hull, other.piece.hull)
