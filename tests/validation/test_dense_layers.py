"""Dense samples find no way exactly where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import backhoe_planner as bp
from validation.dense_layers import DenseLayers

# two links of 1 m in the plane; a ball of 0.05 m at the elbow
ELBOW = """<robot name="elbow"><link name="base"/>
  <link name="upper"><collision><origin xyz="1 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>
  <link name="lower"/><link name="tip"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="1 0 0"/><parent link="upper"/><child link="lower"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="end" type="fixed"><origin xyz="1 0 0"/><parent link="lower"/><child link="tip"/></joint></robot>"""
# the tip goes from (1.2, -0.3) to (1.2, 0.3); the elbow is half way, 0.786 m to one side
LEFT_AT_FIRST, RIGHT_AT_LAST = [0.79, 0.612, 0.0], [0.79, -0.612, 0.0]


@pytest.mark.parametrize(
    ("balls", "together"), [([], True), ([LEFT_AT_FIRST], True), ([LEFT_AT_FIRST, RIGHT_AT_LAST], False)]
)
def test_layers_hang_together_unless_the_elbow_would_have_to_change_sides(
    balls: list[list[float]], together: bool, tmp_path: Path
) -> None:
    (tmp_path / "elbow.urdf").write_text(ELBOW, encoding="utf-8")
    robot = bp.load_robot(tmp_path / "elbow.urdf", tip="tip")
    points = [{"position": [1.2, y, 0.0]} for y in (-0.3, 0.3)]
    obstacles: list[dict[str, Any]] = [
        {"name": f"ball {number}", "shape": "sphere", "radius": 0.05, "position": ball, "clearance": 0.01}
        for number, ball in enumerate(balls)
    ]
    content = {"version": 1, "task": {"path": {"waypoints": points}}, "obstacles": obstacles}
    assert DenseLayers(robot, bp.scene_from_dict(content), drawn=30).hang_together is together
