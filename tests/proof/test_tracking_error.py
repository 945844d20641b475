"""Tracking errors: a verified plan holds for every motion within the tube around it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import tip_tracking_error

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="arm"><collision><origin xyz="1 0 0"/><geometry><box size="2 0.1 0.1"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="1" effort="100"/></joint>
  <link name="tip"/>
  <joint name="fixed" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="2 0 0"/></joint>
</robot>"""
REACH = float(np.hypot(np.hypot(2.0, 0.05), 0.0))  # m: the far corners of the box, from the axis


@pytest.fixture
def arm(tmp_path: Path) -> bp.Robot:
    file = tmp_path / "arm.urdf"
    file.write_text(ARM, encoding="utf-8")
    return bp.load_robot(file)


def beside_a_wall(**more: Any) -> bp.Scene:
    """A wall at y = 0.2: the arm along x is 0.15 m from it and must keep 0.12 m."""
    wall = {"name": "wall", "shape": "halfspace", "point": [0, 0.2, 0], "normal": [0, -1, 0], "clearance": 0.12}
    content = {
        "version": 1,
        "start": {"joints": {"turn": 0.0}},
        "task": {"goal": {"position": [2.0, 0.0, 0.0]}},
        "obstacles": [wall],
    }
    return bp.scene_from_dict(content | more)


def standing(robot: bp.Robot, scene: bp.Scene) -> bp.Certificate:
    return bp.certify(robot, scene, bp.Trajectory.from_steps(np.array([0.0, 1.0]), np.zeros((2, 1))))


def test_the_margin_is_reduced_by_the_joint_error_times_the_reach(arm: bp.Robot) -> None:
    exact = standing(arm, beside_a_wall()).min_clearance
    off = standing(arm, beside_a_wall(tracking={"joints": 0.01})).min_clearance
    assert exact is not None
    assert off is not None
    assert exact.tracking == 0.0
    assert off.tracking == pytest.approx(0.01 * REACH, rel=1e-9)
    for found in (exact, off):  # proven to 2 % of the margin
        assert found.distance == pytest.approx(0.15, abs=7e-4)
        assert found.margin == pytest.approx(found.distance - 0.12 - found.tracking, abs=1e-12)


@pytest.mark.parametrize(("error", "safe"), [(0.0149, True), (0.0151, False)])
def test_a_plan_is_safe_only_if_its_margin_covers_the_tube(error: float, safe: bool, arm: bp.Robot) -> None:
    """There are 30 mm to spare, which 0.015 rad use up at 2.0006 m."""
    certificate = standing(arm, beside_a_wall(tracking={"joints": {"turn": error}}))
    assert certificate.safe is safe
    assert certificate.verified is safe


def test_a_tip_error_counts_only_if_it_bounds_a_link_more_tightly_than_the_joints(arm: bp.Robot) -> None:
    """The near corners are 2.0006 m from the tip: 5 mm plus 0.01 rad about it are more than 0.01 rad at the hinge."""
    off = standing(arm, beside_a_wall(tracking={"joints": 0.01, "tip": 0.005})).min_clearance
    assert off is not None
    assert off.tracking == pytest.approx(0.01 * REACH, rel=1e-9)  # not the 0.025 m about the tip
    problem = bp.build_problem(arm, beside_a_wall(tracking={"joints": 0.01, "tip": 0.005}))
    assert tip_tracking_error(problem.robot) == 0.005


def test_every_motion_within_the_tube_of_a_verified_plan_keeps_its_clearance(backhoe: bp.Robot) -> None:
    """Past a pole in the way; 100 configurations at the corners of the tube for each of 20 samples."""
    content = {
        "version": 1,
        "start": {"joints": {"swing": 0.6, "boom": 0.3, "stick": -1.4, "bucket": -0.6}},
        "task": {"goal": {"position": [3.8, -1.5, 0.6]}},
        "obstacles": [
            {"name": "pole", "shape": "cylinder", "radius": 0.15, "length": 1.6, "position": [4.2, 0.2, 0.8],
             "clearance": 0.1}
        ],
        "tracking": {"joints": {"swing": 0.02, "boom": 0.01, "stick": 0.01, "bucket": 0.03}},
    }  # fmt: skip
    scene = bp.scene_from_dict(content)
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verdict == "verified"
    proximity = bp.Proximity(backhoe, bp.build_obstacles(scene, backhoe))
    rng = np.random.default_rng(3)
    error = np.array([0.02, 0.01, 0.01, 0.03])
    least = np.inf
    for row in np.linspace(0, len(plan.trajectory) - 1, 20).astype(int):
        for _ in range(100):
            q = plan.trajectory.q[row] + error * rng.choice([-1.0, 1.0], 4)
            near = proximity.tightest(q)
            assert near is not None
            least = min(least, near.margin)
    assert least > -1e-4


def test_the_servo_keeps_the_margin_of_the_tracking_error(arm: bp.Robot) -> None:
    """Driven at the wall, the arm's far corner stops 0.12 m from it plus the reach times 0.01 rad."""
    servo = bp.Servo(arm, beside_a_wall(tracking={"joints": 0.01}), dt=0.01)
    for _ in range(400):
        state = servo.step(joint_velocity=np.array([0.2]))
    proximity = bp.Proximity(arm, bp.build_obstacles(beside_a_wall(), arm))
    near = proximity.tightest(state.q)
    assert near is not None
    assert 0.01 * REACH - 1e-6 <= near.margin <= 0.01 * REACH + 0.01


@pytest.mark.parametrize(
    ("tracking", "message"),
    [
        ({"joints": {"boom": 0.01}}, r"tracking.joints: the machine has no such joint; found boom; allowed: turn"),
        ({"joints": -0.01}, r"tracking.joints"),
        ({"tip": 0.03}, r"tracking.joints"),
        ({"joints": 0.01, "tips": 0.03}, r"tracking.tips.*tip"),
    ],
)
def test_errors_in_a_tracking_error_name_the_key(tracking: dict[str, Any], message: str, arm: bp.Robot) -> None:
    with pytest.raises(bp.SceneError, match=message):
        standing(arm, beside_a_wall(tracking=tracking))


def test_a_swing_sector_is_reduced_by_the_tracking_error(arm: bp.Robot) -> None:
    sector = {"name": "street", "kind": "swing_sector", "from": -1.0, "to": 1.0, "stop": 0.1}
    limits = bp.build_problem(arm, beside_a_wall(zones=[sector], tracking={"joints": 0.02})).limits
    assert (limits.lower[0], limits.upper[0]) == pytest.approx((-0.88, 0.88))
