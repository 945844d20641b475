"""Kept conditions that contradict each other are told by their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import Keep, build_problem
from backhoe_planner.planning.world.contradictions import find_contradiction
from validation.pose_arms import write_arm

Data = dict[str, Any]

PATH: Data = {"waypoints": [{"position": [3.5, 0.0, 0.5]}, {"position": [3.5, 1.0, 0.5]}]}


def keep_of(robot: bp.Robot, **keep: Any) -> Keep:
    found = build_problem(robot, bp.scene_from_dict({"version": 1, "task": {"path": PATH, "keep": keep}})).keep
    assert found is not None
    return found


def upright_at(robot: bp.Robot, pitch: float) -> Data:
    """A tilt whose axis points up at this pitch."""
    q = np.array([0.0, 0.2, -1.0, pitch + 0.8])
    at = bp.Kinematics(robot).at(q)
    assert at.pitch == pytest.approx(pitch)
    return {"axis": at.tip_rotation[2].tolist(), "tolerance": 0.1}


def test_a_tilt_and_a_pitch_contradict_each_other_if_they_are_apart_by_more_than_both_allow(backhoe: bp.Robot) -> None:
    """The pitch is linear in the joints, and every change of it tips the axis by as much, whatever the swing."""
    tilt = upright_at(backhoe, -1.6)
    assert not find_contradiction(keep_of(backhoe, tilt=tilt, pitch=[-1.55, -1.0]), backhoe.limits)
    apart = keep_of(backhoe, tilt=tilt, pitch=[-1.3, -1.0])  # 0.3 rad from upright at best, of which 0.1 is allowed
    told = find_contradiction(apart, backhoe.limits)
    assert "`keep.pitch` and `keep.tilt` contradict each other" in told
    assert "tilted by 17.2 deg" in told
    assert not find_contradiction(keep_of(backhoe, tilt=tilt), backhoe.limits)


def test_a_path_whose_conditions_contradict_each_other_is_not_told_to_be_out_of_reach(backhoe: bp.Robot) -> None:
    keep = {"tilt": upright_at(backhoe, -1.6), "pitch": [-1.3, -1.0]}
    found = bp.plan(backhoe, bp.scene_from_dict({"version": 1, "task": {"path": PATH, "keep": keep}}), effort="quick")
    assert found.reason == "goal_breaks_keep"
    assert "contradict each other" in found.message


def test_conditions_of_a_machine_with_continuous_joints_are_compared_too(tmp_path: Path) -> None:
    """The z axis of a tip that is turned by nothing points up, half a turn from down."""
    arm = bp.load_robot(write_arm("gen3", tmp_path))
    upright = {"rpy": [0.0, 0.0, 0.0], "tolerance": 0.1}
    up, down = ({"axis": [0.0, 0.0, z], "tolerance": 0.1} for z in (1.0, -1.0))
    assert not find_contradiction(keep_of(arm, rotation=upright, tilt=up), arm.limits)
    told = find_contradiction(keep_of(arm, rotation=upright, tilt=down), arm.limits)
    assert "`keep.rotation` and `keep.tilt` contradict each other" in told
