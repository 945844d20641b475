"""Plans of sequences beyond planning: followed live, exported, drawn, and recordings in their scenes."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backhoe_planner import Plan, PlanFollower, Robot, Scene, Servo, Trajectory, plan, scene_from_dict
from backhoe_planner.live import plan_from_recording
from backhoe_planner.motion import limit_usage
from backhoe_planner.planning import export_plan

LEGS: list[dict[str, Any]] = [
    {"name": "reach", "goal": {"position": [4.0, 0.0, 0.8]}},
    {"name": "swing", "goal": {"position": [2.8, 2.6, 1.0]}, "payload": 200.0},
    {"name": "rest", "wait": 0.5},
]
START = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
GONE = {"name": "gone", "shape": "sphere", "radius": 0.4, "position": [3.4, 1.9, 1.0], "legs": ["reach"]}


def scene_of(legs: list[dict[str, Any]]) -> Scene:
    content = {"version": 1, "start": {"joints": START}, "task": {"sequence": legs}, "obstacles": [GONE]}
    return scene_from_dict(content)


@pytest.fixture(scope="module")
def done(backhoe: Robot) -> Plan:
    found = plan(backhoe, scene_of(LEGS), effort="quick")
    assert found.verified, found.message
    return found


def test_an_obstacle_of_one_leg_disappears_when_the_next_leg_begins(backhoe: Robot, done: Plan) -> None:
    servo = Servo(backhoe, done.scene, dt=0.02)
    seen: dict[bool, float] = {}
    with PlanFollower(servo, done) as follower:
        for _ in range(int(done.trajectory.duration / 0.02) + 200):
            state = follower.step()
            seen.setdefault("gone" in servo.obstacles, state.plan_time)
            if state.done:
                break
    assert state.done
    assert state.behind < 0.1
    assert seen[True] < 0.05
    assert seen[False] == pytest.approx(done.legs[1].begins, abs=0.05)


def test_exports_name_the_leg_of_every_sample(done: Plan, tmp_path: Path) -> None:
    export_plan(done, tmp_path / "plan.csv")
    rows = list(csv.DictReader((tmp_path / "plan.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["leg"] for row in (rows[0], rows[done.legs[1].first], rows[-1])] == ["reach", "swing", "rest"]
    assert rows[done.legs[1].first - 1]["leg"] == "reach"
    export_plan(done, tmp_path / "plan.npz")
    with np.load(tmp_path / "plan.npz") as arrays:
        assert arrays["legs"].tolist() == ["reach", "swing", "rest"]
        assert arrays["leg_begins"].tolist() == [leg.first for leg in done.legs]


def test_the_limit_usage_covers_all_legs(done: Plan) -> None:
    usage = limit_usage(done.problem, done.trajectory)
    assert np.all(np.diff(usage.moments.time) > 0.0)
    assert usage.moments.time[-1] == pytest.approx(done.trajectory.duration)
    assert usage.moments.segment.max() == len(done.trajectory) - 1
    assert float(np.max(usage.ratio)) <= 1.01


def test_a_recording_in_the_scene_of_a_sequence_has_no_legs(backhoe: Robot, done: Plan) -> None:
    q = np.array(list(START.values())) + np.linspace(0.0, 0.02, 101)[:, None]
    found = plan_from_recording(backhoe, done.scene, Trajectory.from_steps(np.linspace(0.0, 2.0, 101), q))
    assert found.legs == ()
    assert [one.legs for one in found.scene.obstacles] == [None]
