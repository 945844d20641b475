"""An obstacle must apply to links that can touch it, and a machine must have shapes; else nothing is proven."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.errors import RobotError, SceneError

SPHERE: dict[str, Any] = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [3, 3, 3]}
TASK = {
    "version": 1,
    "start": {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}},
    "task": {"goal": {"position": [4.0, 0.5, 0.5]}},
}


@pytest.mark.parametrize("links", [["chassis"], ["chassis", "cab"], ["bucket_tip"]])
def test_an_obstacle_for_links_that_cannot_touch_it_is_an_error(links: list[str]) -> None:
    """The chassis is fixed, and the tip is a frame without a shape."""
    scene = bp.scene_from_dict({**TASK, "obstacles": [{**SPHERE, "links": links}]})
    with pytest.raises(SceneError, match=r"\(ball\).links: .* has no effect.*allowed: swing_post, boom"):
        bp.plan(bp.load_robot("example:backhoe"), scene)


@pytest.mark.parametrize("where", ["obstacles", "zones"])
def test_an_empty_list_of_links_is_an_error(where: str) -> None:
    zone = {"name": "wall", "kind": "ceiling", "height": 3.0, "stop": 0.1}
    with pytest.raises(SceneError, match="links"):
        bp.scene_from_dict({**TASK, where: [{**(SPHERE if where == "obstacles" else zone), "links": []}]})


def test_a_live_obstacle_for_links_that_cannot_touch_it_is_an_error() -> None:
    servo = bp.Servo(bp.load_robot("example:backhoe"), bp.scene_from_dict(TASK), dt=0.001)
    for links in (["chassis"], []):
        with pytest.raises(bp.InputError, match="links"):
            servo.add({**SPHERE, "links": links})
    servo.add({**SPHERE, "links": ["chassis", "bucket"]})


BOX = '<geometry><box size="1 0.1 0.1"/></geometry>'


@pytest.fixture
def arm_of(tmp_path: Path) -> Callable[[str, str], bp.Robot]:
    """An arm of two links with the given XML in each."""

    def build(first: str, second: str) -> bp.Robot:
        joints = "".join(
            f'<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{x} 0 0"/>'
            '<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint>'
            for k, (parent, child, x) in enumerate([("base", "a", 0), ("a", "b", 1)])
        )
        path = tmp_path / "arm.urdf"
        path.write_text(
            f'<robot name="arm"><link name="base"/><link name="a">{first}</link><link name="b">{second}</link>{joints}'
            '<link name="tip"/><joint name="f" type="fixed"><parent link="b"/><child link="tip"/>'
            '<origin xyz="1 0 0"/></joint></robot>'
        )
        return bp.load_robot(path)

    return build


def reach_into(robot: bp.Robot) -> bp.Certificate:
    """The first joint turns by 1.5 rad; its stretched arm sweeps through a ball at (0.9, 0.9, 0) at 45 deg."""
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"j0": 0.0, "j1": 0.0}},
            "task": {"goal": {"position": [0.0, 1.9, 0.0]}},
            "obstacles": [{"name": "ball", "shape": "sphere", "radius": 0.45, "position": [0.9, 0.9, 0.0]}],
        }
    )
    return bp.certify(robot, scene, bp.Trajectory.from_steps(np.array([0.0, 10.0]), np.array([[0.0, 0.0], [1.5, 0.0]])))


def test_visuals_are_the_shapes_of_a_machine_without_collision_shapes(
    arm_of: Callable[[str, str], bp.Robot],
) -> None:
    robot = arm_of(f"<visual>{BOX}</visual>", f"<visual>{BOX}</visual>")
    assert robot.link_names == ("a", "b")
    assert robot.warnings == ("no link has a <collision>: what is drawn of the links is taken as their shape",)
    certificate = reach_into(robot)
    assert not certificate.safe
    assert certificate.min_clearance is not None
    assert certificate.min_clearance.obstacle == "ball"


def test_a_warning_names_visible_links_without_collision_shapes(arm_of: Callable[[str, str], bp.Robot]) -> None:
    robot = arm_of(f"<visual>{BOX}</visual><collision>{BOX}</collision>", f"<visual>{BOX}</visual>")
    assert robot.link_names == ("a",)
    assert robot.warnings == ("links that are drawn but have no <collision>, so that nothing is proven of them: b",)


def test_certifying_a_machine_without_shapes_is_an_error(arm_of: Callable[[str, str], bp.Robot]) -> None:
    robot = arm_of("", "")
    with pytest.raises(RobotError, match="no link that moves has a shape"):
        reach_into(robot)
