"""Commands load only the modules they need, so that they start fast."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yourdfpy
from lxml import etree

from backhoe_planner.machine import load_robot, read_urdf, shipped_folder
from backhoe_planner.machine.description.urdf_tree import read_tree

ROOT = Path(__file__).resolve().parents[1]

# loading any of these takes a tenth of a second or more, or is useless for a motion to a goal
SLOW = [
    "scipy", "trimesh", "yourdfpy", "networkx", "shapely", "vhacdx", "ompl", "PIL", "matplotlib", "meshcat", "tornado",
    "umsgpack", "toppra", "backhoe_planner.live.servo", "backhoe_planner.show.viewer", "backhoe_planner.show.plots",
    "backhoe_planner.planning.path_planning", "backhoe_planner.planning.sequence.chain", "rich", "numpy.ma",
    "backhoe_planner.site.surveys.survey_files",
]  # fmt: skip
SIMPLEST = """
version: 1
start: {joints: {swing: 0.0, boom: 0.4, stick: -1.6, bucket: -0.9}}
task: {goal: {joints: {swing: 0.8, boom: 0.5, stick: -1.4, bucket: -0.7}}}
clearance: 0.05
obstacles:
  - {name: pole, shape: cylinder, radius: 0.1, length: 3.0, position: [-4, 2, 1.5]}
  - {name: truck, shape: box, size: [1, 1, 1], position: [-4, -2, 0.5]}
"""


def loaded(arguments: list[str], of: list[str], *, begins: str = "") -> tuple[int, list[str]]:
    """The exit status of the command line in a process of its own, and which modules of `of` it loaded.

    If `begins` is given, its output begins with that line, and it prints no message.
    """
    code = (
        "import json, sys\n"
        f"sys.argv = ['backhoe-planner', *{arguments!r}]\n"
        "from backhoe_planner.__main__ import main\n"
        "try:\n    main()\n"
        "except SystemExit as done:\n"
        f"    print(json.dumps([done.code, [name for name in {of!r} if name in sys.modules]]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, *_, last = done.stdout.splitlines()
    if begins:
        assert (first, done.stderr) == (begins, "")
    status, names = json.loads(last)
    return status, names


def test_help_loads_no_numerical_modules() -> None:
    computing = ["numpy", "pydantic", "yaml", "lxml", "pinocchio", "coal", "daqp", "backhoe_planner.machine.robot"]
    assert loaded(["--help"], [*SLOW, *computing]) == (0, [])


def test_a_plan_of_primitives_is_made_by_a_program_that_loads_no_mesh_library_and_no_scipy(tmp_path: Path) -> None:
    scene, plan = tmp_path / "scene.yaml", tmp_path / "plan.json"
    scene.write_text(SIMPLEST)
    machine = str(shipped_folder("models") / "backhoe.urdf")
    assert loaded(["plan", machine, str(scene), "-o", str(plan)], SLOW, begins="verified") == (0, [])
    assert plan.is_file()


LIBRARIES_OF_MESHES = ["trimesh", "yourdfpy", "networkx", "shapely", "vhacdx"]


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The URDF of an arm with one mesh, beside an empty cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    trimesh.creation.box(extents=[0.1, 0.2, 0.3]).export(tmp_path / "arm.stl")
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        '<robot name="r"><link name="base"/><link name="arm"><collision><geometry><mesh filename="arm.stl"/></geometry>'
        '</collision></link><joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    return urdf


def test_a_machine_whose_pieces_are_cached_loads_no_mesh_library(arm: Path) -> None:
    """Convex pieces come from the cache folder, and so does what yourdfpy read from the URDF."""
    assert load_robot(arm).pieces
    assert any(file.is_file() for file in (arm.parent / "cache").rglob("*"))
    assert loaded(["inspect", str(arm)], LIBRARIES_OF_MESHES) == (0, [])


@pytest.mark.long
def test_cached_urdfs_are_identified_by_their_content(arm: Path) -> None:
    loaded(["inspect", str(arm)], LIBRARIES_OF_MESHES)
    trimesh.creation.box(extents=[0.1, 0.2, 0.4]).export(arm.with_suffix(".stl"))
    assert "yourdfpy" not in loaded(["inspect", str(arm)], LIBRARIES_OF_MESHES)[1]
    arm.write_text(arm.read_text().replace("-1", "-2"))
    assert "yourdfpy" in loaded(["inspect", str(arm)], LIBRARIES_OF_MESHES)[1]


@pytest.mark.parametrize(("asked", "given"), [(None, "1"), ("3", "3")])
def test_a_command_uses_one_thread_for_linear_algebra_unless_set(asked: str | None, given: str) -> None:
    """Its objects are frozen at the end: a last garbage collection takes a sixth of a simple plan's time."""
    code = (
        "import gc, os, sys\n"
        "sys.argv = ['backhoe-planner', '--help']\n"
        "from backhoe_planner.__main__ import main\n"
        "try:\n    main()\n"
        "except SystemExit:\n"
        "    print([os.environ[f'{name}_NUM_THREADS'] for name in ('OMP', 'OPENBLAS', 'MKL')],"
        " gc.get_freeze_count() > 10 * len(gc.get_objects()))"
    )
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    if asked is not None:
        environment["OPENBLAS_NUM_THREADS"] = asked
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.splitlines()[-1] == f"{['1', given, '1']} True"


@pytest.mark.parametrize("scene", [pytest.param("yard", marks=pytest.mark.long), "wall"])
def test_a_step_of_the_servo_imports_nothing(scene: str) -> None:
    """An import would stall the loop."""
    code = (
        "import sys, backhoe_planner as bp\n"
        f"servo = bp.Servo(bp.load_robot('example:backhoe'), bp.load_scene('scenes/{scene}.yaml'), dt=0.01)\n"
        "servo.add({'name': 'mast', 'shape': 'cylinder', 'radius': 0.2, 'length': 4, 'position': [3.5, 1.5, 2]})\n"
        "before = set(sys.modules)\n"
        "found = {servo.step([0.3, 0.5, -0.3]).status.value for _ in range(300)}\n"
        "print(sorted(set(sys.modules) - before), servo.last_error, sorted(found))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.startswith("[] None "), done.stdout
    assert "near_obstacle" in done.stdout or "sliding" in done.stdout or "stopped" in done.stdout


def test_urdfs_are_read_as_yourdfpy_reads_them() -> None:
    text = """
    <robot name="r"><material name="red"><color rgba="1 0 0 1"/></material><material name="none"/>
    <link name="a"><visual><origin xyz="1 2 3" rpy="0.1 -1.2 2.5"/><geometry><box size="1 2 3"/></geometry>
      <material name="red"/></visual><collision><geometry><cylinder radius="0.2" length="1"/></geometry></collision>
      <collision><origin xyz="0 0 1"/><geometry><sphere radius="0.3"/></geometry></collision></link>
    <link name="b"><visual><geometry><mesh filename="b.dae" scale="1 2 -3"/></geometry></visual>
      <collision><geometry><mesh filename="package://p/b.stl" scale="0.001"/></geometry></collision></link>
    <link name="c"><visual><geometry><mesh filename="c.obj"/></geometry></visual></link><link name="d"/>
    <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
      <origin rpy="3 1.5707963 0.2"/><limit lower="-1" upper="2" effort="3" velocity="4"/>
      <safety_controller soft_lower_limit="-0.5" k_velocity="2"/></joint>
    <joint name="k" type="continuous"><parent link="b"/><child link="c"/></joint>
    <joint name="l" type="prismatic"><parent link="c"/><child link="d"/><axis/><mimic joint="j" multiplier="-2"/>
      <limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""
    shipped = [path.read_text() for path in shipped_folder("models").glob("*.urdf")]
    examples = [read_urdf(f"example:{name}").xml.decode() for name in ("panda", "so101", "TwoDofs", "kinova", "ur5")]
    for xml in (text, *shipped, *examples):
        root = etree.fromstring(xml.encode(), etree.XMLParser(remove_comments=True))
        ours, theirs = read_tree(root), yourdfpy.URDF._parse_robot(xml_element=root)
        assert_same(ours, theirs)
    assert len(shipped) >= 2


def assert_same(ours: Any, theirs: Any) -> None:
    """Every field of our record is in theirs, with the same value."""
    if dataclasses.is_dataclass(ours):
        for field in dataclasses.fields(ours):
            if hasattr(theirs, field.name) or field.name != "material":  # only visuals have one
                assert_same(getattr(ours, field.name), getattr(theirs, field.name))
    elif isinstance(ours, list):
        assert isinstance(theirs, list)
        assert len(ours) == len(theirs)
        for one, other in zip(ours, theirs, strict=True):
            assert_same(one, other)
    elif isinstance(ours, np.ndarray):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-15)
    else:
        assert ours == theirs
