"""Cached self-collision pairs: for the same machine only, and equal to computed ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from backhoe_planner.machine import Robot, TrackingTube, cache_folder, load_robot, self_pairs
from backhoe_planner.machine.pairs_cache import key_of, read_pairs


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def entries() -> list[Path]:
    folder = cache_folder().with_name("own_pairs")
    return sorted(folder.iterdir()) if folder.is_dir() else []


def wheel_in(folder: Path, ring: trimesh.Trimesh | None, *, radius: float = 0.1) -> Robot:
    """A wheel that turns in a ring, or on a box of the ring's size without one."""
    shape = '<box size="0.6 0.6 0.1"/>'
    if ring is not None:
        ring.export(folder / "ring.stl")
        shape = '<mesh filename="ring.stl"/>'
    path = folder / "machine.urdf"
    path.write_text(
        f'<robot name="r"><link name="ring"><collision><geometry>{shape}</geometry></collision></link>'
        f'<link name="wheel"><collision><geometry><cylinder radius="{radius}" length="0.08"/></geometry></collision>'
        '</link><joint name="turn" type="revolute"><parent link="ring"/><child link="wheel"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    return load_robot(path)


def annulus(hole: float) -> trimesh.Trimesh:
    return trimesh.creation.annulus(hole, 0.3, 0.1, sections=48)


def test_a_machine_loaded_twice_computes_its_pairs_once(home: Path) -> None:
    first, second = wheel_in(home, annulus(0.15)), wheel_in(home, annulus(0.15))
    assert first.pieces is not second.pieces
    assert self_pairs(first) is self_pairs(second)


def test_pairs_of_meshes_are_cached_and_read_unchanged(home: Path) -> None:
    robot = wheel_in(home, annulus(0.15), radius=0.101)
    pairs = self_pairs(robot)
    assert pairs.left_out
    assert len(entries()) == 1
    assert read_pairs(key_of(wheel_in(home, annulus(0.15), radius=0.101))) == pairs


def test_a_damaged_entry_is_ignored(home: Path) -> None:
    robot = wheel_in(home, annulus(0.15), radius=0.102)
    self_pairs(robot)
    (entry,) = entries()
    entry.write_bytes(entry.read_bytes()[:-1])
    assert read_pairs(key_of(robot)) is None


def test_pairs_of_many_primitives_are_cached(home: Path) -> None:
    """A stack of 19 boxes of one body below a wheel; only the upper one is at the joint."""
    box = '<collision><origin xyz="0 0 {z}"/><geometry><box size="0.6 0.6 0.1"/></geometry></collision>'
    path = home / "machine.urdf"
    path.write_text(
        f'<robot name="r"><link name="stack">{"".join(box.format(z=-0.1 * row) for row in range(19))}</link>'
        '<link name="wheel"><collision><geometry><cylinder radius="0.1" length="0.08"/></geometry></collision></link>'
        '<joint name="turn" type="revolute"><parent link="stack"/><child link="wheel"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    robot = load_robot(path)
    assert len(robot.pieces) == 20
    pairs = self_pairs(robot)
    assert pairs.kept == ()
    assert {one.why for one in pairs.left_out} == {"touch at turn", "cannot meet over the range of turn"}
    assert read_pairs(key_of(robot)) == pairs


def test_pairs_of_few_primitives_or_of_a_start_out_of_range_are_not_cached(home: Path) -> None:
    self_pairs(wheel_in(home, None))
    self_pairs(wheel_in(home, annulus(0.15), radius=0.103), posture=(1.5,))
    assert entries() == []


def test_the_key_of_pairs_depends_on_meshes_shapes_and_limits(home: Path) -> None:
    """A ring with a wider hole has the same hull but other triangles; a tracking error matters for slides only."""
    robot = wheel_in(home, annulus(0.15))
    narrow = replace(robot, limits=replace(robot.limits, upper=np.array([0.5])))
    others = [narrow, wheel_in(home, annulus(0.2)), wheel_in(home, annulus(0.15), radius=0.09), wheel_in(home, None)]
    assert len({key_of(machine) for machine in (robot, *others)}) == 5
    assert key_of(replace(robot, tube=TrackingTube(np.array([0.01])))) == key_of(robot)
