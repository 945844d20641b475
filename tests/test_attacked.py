"""What an attack from outside found and no room's own tests had: each small, each with its answer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.__main__ import main
from backhoe_planner.site import check_name

ONE_JOINT = """<robot name="one"><link name="base"/>
  <link name="arm"><collision><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["backhoe-planner", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_a_machine_with_one_joint_is_inspected(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "one.urdf"
    file.write_text(ONE_JOINT, encoding="utf-8")
    assert run(monkeypatch, "inspect", str(file)) == 0


@pytest.mark.parametrize("name", ["a\nverified", "red\x1b[31m", "\t"])
def test_a_name_is_one_line_that_can_be_printed(name: str) -> None:
    with pytest.raises(bp.InputError, match="is no name"):
        check_name(name)


def test_a_seed_that_no_generator_takes_is_refused(backhoe: bp.Robot) -> None:
    content = {"version": 1, "start": {"joints": dict.fromkeys(backhoe.joint_names, -0.5)}}
    scene = bp.scene_from_dict({**content, "task": {"goal": {"position": [4, 0, 0.5]}}})
    with pytest.raises(bp.InputError, match="seed: is too large"):
        bp.plan(backhoe, scene, seed=2**64)


def test_the_page_does_not_overwrite_the_plan(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "both.json"
    options = ["-o", str(file), "--html", str(file)]
    assert run(monkeypatch, "plan", "example:planar4", "scenes/paper_planar.yaml", *options) == 2
    assert not file.exists()


def test_decimal_commas_in_a_point_cloud_are_refused(backhoe: bp.Robot, tmp_path: Path) -> None:
    (tmp_path / "scan.txt").write_text("x y z\n1,5 2,5 3,5\n", encoding="utf-8")
    scan = {"name": "scan", "shape": "pointcloud", "file": "scan.txt", "resolution": 0.1}
    content = {"version": 1, "task": {"path": {"waypoints": [{"position": [4, 0, 0.5]}, {"position": [4, 1, 0.5]}]}}}
    scene = bp.scene_from_dict({**content, "obstacles": [scan]}, folder=tmp_path)
    with pytest.raises(bp.SceneError, match="line 2: has commas and blanks"):
        bp.build_obstacles(scene, backhoe)


def test_a_load_that_writes_on_what_it_is_given_changes_nothing(backhoe: bp.Robot) -> None:
    def load(q: np.ndarray, v: np.ndarray) -> float:
        q[:] = 9.0
        v[:] = 9.0
        return 0.5

    start = dict(zip(backhoe.joint_names, (0.0, 0.3, -1.4, -0.6), strict=True))
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": start}, "task": {"goal": {"position": [4, 0, 0.5]}}})
    servo = bp.Servo(backhoe, scene, dt=0.01, load=load)
    state = servo.step(joint_velocity=np.array([0.1, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(state.q, list(start.values()), atol=0.01)
