"""The share of a path on which the requested speed is kept: by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import Problem, Trajectory, build_problem
from backhoe_planner.planning import measure_speed

CAGE = """<robot name="lift">
  <link name="post"/>
  <link name="cage"><inertial><mass value="300"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <joint name="hoist" type="prismatic"><parent link="post"/><child link="cage"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="3" velocity="1" acceleration="2" effort="1e4"/></joint>
</robot>"""


def lift(folder: Path, *, speed: float | None) -> Problem:
    file = folder / "lift.urdf"
    file.write_text(CAGE, encoding="utf-8")
    task = {"waypoints": [{"position": [0.0, 0.0, 0.5]}, {"position": [0.0, 0.0, 2.0]}]}
    content = {"version": 1, "task": {"path": task | ({} if speed is None else {"speed": speed})}}
    return build_problem(bp.load_robot(file, tip="cage"), bp.scene_from_dict(content))


def test_a_planned_lift_is_slower_only_where_it_accelerates_and_brakes(tmp_path: Path) -> None:
    """Below 90 % of 0.4 m/s for (0.36 m/s)^2 / (2 * 2 m/s^2) = 0.0324 m at either end."""
    problem = lift(tmp_path, speed=0.4)
    plan = bp.plan(problem.robot, problem.scene, effort="quick")
    assert plan.verified, plan.message
    told = plan.metrics.asked_speed
    assert told is not None
    assert told.asked == 0.4
    assert told.kept_percent == pytest.approx(100.0 * (1.0 - 2.0 * 0.0324 / 1.5), abs=0.7)
    first, last = told.slower
    assert first.path_from == pytest.approx(0.0, abs=1e-6)
    assert first.path_to == pytest.approx(0.0324, abs=0.008)
    assert last.path_from == pytest.approx(1.5 - 0.0324, abs=0.008)
    assert last.path_to == pytest.approx(1.5, abs=1e-6)
    assert first.limit == last.limit == "acceleration hoist"


def test_a_slow_stretch_in_the_middle_is_reported_with_its_ends_and_least_speed(tmp_path: Path) -> None:
    """0.4 m/s, but 0.2 m/s from 0.5 m to 0.8 m of 1.5 m: kept on 80 %."""
    problem = lift(tmp_path, speed=0.4)
    height = np.array([0.5, 1.0, 1.15, 1.3, 2.0])
    time = np.array([0.0, 1.25, 2.0, 2.75, 4.5])
    told = measure_speed(problem, Trajectory.from_steps(time, height[:, None]), begun=0.0)
    assert told is not None
    assert told.kept_percent == pytest.approx(80.0)
    (slow,) = told.slower
    assert (slow.path_from, slow.path_to, slow.least) == pytest.approx((0.5, 0.8, 0.2))


def test_without_a_requested_speed_nothing_is_reported(tmp_path: Path) -> None:
    problem = lift(tmp_path, speed=None)
    plan = bp.plan(problem.robot, problem.scene, effort="quick")
    assert plan.verified, plan.message
    assert plan.metrics.asked_speed is None


def test_a_detour_within_the_tolerance_keeps_the_requested_speed(planar4: bp.Robot) -> None:
    """A ball of 5 cm on the path, with 2 cm of clearance, is passed 7 to 30 cm off the path: the tip is still on it."""
    path = {"waypoints": [{"position": [2.5, y, 0.0]} for y in (1.0, -1.0)], "speed": 0.2, "tolerance": 0.3}
    ball = {"name": "ball", "shape": "sphere", "radius": 0.05, "position": [2.5, 0.0, 0.0]}
    content = {"version": 1, "hold": {"joint3": 0.0, "joint4": 0.0}, "clearance": 0.02}
    scene = bp.scene_from_dict(content | {"task": {"path": path}, "obstacles": [ball]})
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.tracking.max_error > 0.07
    tips, time = plan.tip_path(), plan.trajectory.time
    assert np.max(np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(time)) <= 0.2 * 1.001
