"""The pose of the machine's base: moving machine and site together does not change the problem."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import backhoe_planner as bp
from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.machine import Base, Kinematics, Robot, self_pairs
from backhoe_planner.motion import build_problem
from backhoe_planner.site import InTheWay, obstacle_warnings, stands_in

AT, HEADING = (12.5, -3.0), 0.7  # m, rad
START = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}


def _moved(point: list[float]) -> list[float]:
    """The site's `point` after base and site were moved."""
    cosine, sine = math.cos(HEADING), math.sin(HEADING)
    x, y, z = point
    return [AT[0] + cosine * x - sine * y, AT[1] + sine * x + cosine * y, z]


def _scene(*, moved: bool) -> bp.Scene:
    place = _moved if moved else list
    heading = HEADING if moved else 0.0
    content: dict[str, Any] = {
        "version": 1,
        "start": {"joints": START},
        "task": {"path": {"waypoints": [{"position": place([4.6, 0.0, -0.3])}, {"position": place([3.4, 0.3, -1.0])}]}},
        "obstacles": [
            {"name": "pipe", "shape": "capsule", "from": place([1.2, 1.0, -0.9]), "to": place([5.5, 1.0, -0.9]),
             "radius": 0.1},
            {"name": "bank", "shape": "box", "size": [4.0, 2.0, 2.0], "position": place([3.6, -1.8, -1.01]),
             "rpy": [0.0, 0.0, heading]},
        ],
    }  # fmt: skip
    if moved:
        content["base"] = {"position": list(AT), "heading": HEADING}
    return bp.scene_from_dict(content)


def test_the_base_pose_transforms_the_tip(backhoe: Robot) -> None:
    q = np.array([0.3, 0.5, -1.2, -0.8])
    here, there = (Kinematics(robot).at(q) for robot in (backhoe, backhoe.with_base(Base(AT, HEADING))))
    np.testing.assert_allclose(there.tip_position, _moved(here.tip_position.tolist()), atol=1e-12)
    np.testing.assert_allclose(there.T_world_tip.rotation, pin.rpy.rpyToMatrix(0, 0, HEADING) @ here.tip_rotation,
                               atol=1e-12)  # fmt: skip
    assert there.pitch == pytest.approx(here.pitch, abs=1e-12)


def test_the_base_pose_transforms_links_that_no_joint_moves(backhoe: Robot) -> None:
    moved = backhoe.with_base(Base(AT, HEADING))
    fixed = [row for row, piece in enumerate(backhoe.pieces) if piece.joint == 0]
    assert fixed
    for row in fixed:
        here, there = (robot.pieces[row].piece.placement.translation for robot in (backhoe, moved))
        np.testing.assert_allclose(there, _moved(here.tolist()), atol=1e-12)
    for here, there in zip(backhoe.visuals, moved.visuals, strict=True):
        if here.joint == 0:
            expected = _moved(here.placement.translation.tolist())
            np.testing.assert_allclose(there.placement.translation, expected, atol=1e-12)


def test_the_certificate_is_the_same_when_machine_and_site_are_moved_together(backhoe: Robot) -> None:
    here = bp.plan(backhoe, _scene(moved=False), effort="quick")
    there = bp.certify(backhoe, _scene(moved=True), here.trajectory)
    assert here.verdict == "verified"
    assert here.certificate is not None
    assert there.verified
    for one, other in zip(here.certificate.clearances, there.clearances, strict=True):
        assert one.obstacle == other.obstacle
        assert one.distance == pytest.approx(other.distance, abs=1e-4)  # each bound has its own slack


def test_a_plan_with_another_base_pose_is_verified_and_loads_again(backhoe: Robot, tmp_path: Any) -> None:
    plan = bp.plan(backhoe, _scene(moved=True), effort="quick")
    assert plan.verdict == "verified"
    plan.save(tmp_path / "plan.json")
    again = bp.load_plan(tmp_path / "plan.json")
    assert again.problem.robot.base == Base(AT, HEADING)
    assert again.verdict == "verified"


def test_self_collision_pairs_do_not_depend_on_the_base_pose(backhoe: Robot) -> None:
    assert self_pairs(backhoe.with_base(Base(AT, HEADING))) == self_pairs(backhoe)


def test_holding_a_joint_keeps_the_base_pose(backhoe: Robot) -> None:
    moved = backhoe.with_base(Base(AT, HEADING))
    assert moved.with_hold({"swing": 0.1}).base == moved.base
    assert moved.at_origin.base == Base()
    assert moved.with_base(Base()).model.jointPlacements[1] == backhoe.model.jointPlacements[1]


def test_a_scene_without_a_base_puts_the_machine_back_at_the_origin(backhoe: Robot) -> None:
    moved = backhoe.with_base(Base(AT, HEADING))
    assert build_problem(moved, _scene(moved=False)).robot.base == Base()


def test_the_servo_uses_the_base_pose_of_the_scene(backhoe: Robot) -> None:
    servo = bp.Servo(backhoe, _scene(moved=True), dt=0.01)
    at = Kinematics(backhoe).at(np.array(list(START.values()))).tip_position
    np.testing.assert_allclose(servo.robot.base.position, AT)
    np.testing.assert_allclose(Kinematics(servo.robot).at(servo.q).tip_position, _moved(at.tolist()), atol=1e-12)


@pytest.mark.parametrize(
    ("base", "key"),
    [
        ({"position": [1.0]}, "base.position"),
        ({"position": [1.0, 2.0, 3.0]}, "base.position"),
        ({"heading": 90.0}, "base.heading"),
        ({"heading": "north"}, "base.heading"),
        ({"at": [0.0, 0.0]}, "base.at"),
    ],
)
def test_errors_in_a_base_pose_name_the_key(base: dict[str, Any], key: str) -> None:
    content = _scene(moved=False).to_dict() | {"base": base}
    with pytest.raises(SceneError, match=key):
        bp.scene_from_dict(content)


def test_a_base_position_must_be_finite() -> None:
    with pytest.raises(InputError, match=r"base\.position"):
        Base((math.nan, 0.0))


def _standing(*obstacles: dict[str, Any], clearance: float = 0.05) -> bp.Scene:
    """A machine with its swing axis at x 10 m that looks along -x: its tractor extends from x 10 to 15.2 m."""
    return bp.scene_from_dict(
        {
            "version": 1, "start": {"joints": START}, "task": {"goal": {"joints": START}}, "clearance": clearance,
            "base": {"position": [10.0, 0.0], "heading": math.pi}, "obstacles": list(obstacles),
        }
    )  # fmt: skip


def test_a_base_pose_inside_an_obstacle_is_refused_naming_link_and_obstacle(backhoe: Robot) -> None:
    wall = {"name": "house", "shape": "box", "size": [1.0, 4.0, 3.0], "position": [15.2, 0.0, 1.5]}
    with pytest.raises(SceneError, match="puts loader of the machine into house"):
        build_problem(backhoe, _standing(wall))
    build_problem(backhoe, _standing(wall | {"position": [15.76, 0.0, 1.5]}))  # the bucket ends at x 15.24 m


def test_a_machine_without_a_base_pose_that_stands_in_an_obstacle_gives_a_warning(backhoe: Robot) -> None:
    """Its tractor extends from x 0 to -5.24 m."""

    def warnings(x: float, **keys: float) -> tuple[str, ...]:
        house = {"name": "house", "shape": "box", "size": [1.0, 4.0, 3.0], "position": [x, 0.0, 1.5]}
        task = {"start": {"joints": START}, "task": {"goal": {"joints": START}}, "obstacles": [house | keys]}
        return obstacle_warnings(backhoe, build_problem(backhoe, bp.scene_from_dict({"version": 1} | task)).obstacles)

    (warning,) = warnings(-1.5)
    assert "which does not move, stands in house" in warning
    assert "base: {position: [x, y], heading: 0}" in warning
    assert warnings(-5.76) == warnings(-1.5, appears_at=2.0) == ()


@pytest.mark.parametrize(
    "ground",
    [
        {"shape": "halfspace", "point": [0, 0, 0], "normal": [0, 0, 1]},
        {"shape": "box", "size": [60, 60, 1], "position": [10, 0, -0.5]},
        {"shape": "capsule", "from": [0, 1, -0.3], "to": [20, 1, -0.3], "radius": 0.2},
    ],
)
def test_the_ground_below_the_machine_is_not_an_obstacle_to_its_fixed_parts(
    backhoe: Robot, ground: dict[str, Any]
) -> None:
    problem = build_problem(backhoe, _standing({"name": "ground"} | ground, clearance=0.2))
    assert stands_in(problem.robot, problem.obstacles, with_clearance=True) is None


def test_the_clearance_of_fixed_parts_is_checked_on_request(backhoe: Robot) -> None:
    """The cab's roof is at 2.8 m: a line at 6 m whose clearance is 3.05 m is 3.2 m away, and one at 5.8 m is 3.0 m."""
    line = {"name": "line", "shape": "halfspace", "normal": [0, 0, -1], "clearance": 3.05}
    high, low = (build_problem(backhoe, _standing(line | {"point": [0.0, 0.0, height]})) for height in (6.0, 5.8))
    assert stands_in(high.robot, high.obstacles, with_clearance=True) is None
    assert stands_in(low.robot, low.obstacles, with_clearance=True) == InTheWay("cab", "line")
    assert stands_in(low.robot, low.obstacles) is None
