"""Machines with a single joint: what stands in the only way is a proof that there is none."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import Axis, load_chain

import backhoe_planner as bp
from backhoe_planner.arrays import Flags, Matrix
from backhoe_planner.site import ClearanceScreen

ARM, START, END = 2.0, -0.5, 0.5  # m, rad
TIP = {"position": [ARM * math.cos(END), ARM * math.sin(END), 0.0]}
JOINT = {"joints": {"joint0": END}}
# from the post to the tip's ball: the radii of 0.1 m and the clearance of 0.05 m, as a chord of the tip's circle
MEETS = 2.0 * math.asin(0.25 / (2.0 * ARM))


def post(name: str, x: float, **more: Any) -> dict[str, Any]:
    return {"name": name, "shape": "cylinder", "radius": 0.1, "length": 1.0, "position": [x, 0.0, 0.0]} | more


FRONT, REAR = post("front", ARM), post("rear", -ARM)


def plan(folder: Path, kind: str, goal: Any, *obstacles: dict[str, Any], **more: Any) -> bp.Plan:
    robot = load_chain(folder, [Axis(kind, "0 0 1", -3.0, 3.0)], tool=f"{ARM} 0 0", ball=0.1)
    content = {
        "version": 1, "start": {"joints": {"joint0": START}}, "task": {"goal": goal}, "obstacles": list(obstacles),
    }  # fmt: skip
    return bp.plan(robot, bp.scene_from_dict(content | more), effort="quick")


@pytest.mark.parametrize(
    ("kind", "goal", "obstacles"),
    [
        ("revolute", JOINT, [FRONT]),
        ("revolute", TIP, [FRONT]),
        ("revolute", [TIP, {"joints": {"joint0": 0.7}}], [FRONT]),
        ("continuous", JOINT, [FRONT]),
    ],
)
def test_what_stands_in_the_only_way_is_told_with_its_place(
    kind: str, goal: Any, obstacles: list[dict[str, Any]], tmp_path: Path
) -> None:
    found = plan(tmp_path, kind, goal, *obstacles)
    assert (found.verdict, found.reason) == ("failed", "blocked")
    words = "the only way there is blocked: with joint0 at "
    assert found.message.startswith(words)
    place, _, contact = found.message.removeprefix(words).partition(" rad ")
    assert -MEETS <= float(place) < -MEETS + 0.02
    assert contact.startswith("tip is 0.0")
    assert "from front" in contact
    assert found.findings.obstruction is not None
    assert found.findings.obstruction.obstacle == "front"


def test_a_continuous_joint_comes_to_a_pose_from_the_other_side(tmp_path: Path) -> None:
    found = plan(tmp_path, "continuous", TIP, FRONT)
    assert found.verified, found.message
    assert found.trajectory.q[-1, 0] == pytest.approx(END - 2.0 * math.pi, abs=1e-3)
    found = plan(tmp_path, "continuous", TIP, FRONT, REAR)
    assert found.reason == "blocked"
    assert found.message.startswith("all ways there are blocked: with joint0 at ")
    assert "from front" in found.message
    assert "from rear" in found.message


@pytest.mark.parametrize("turns", [1000.0, -1000.0])
def test_of_many_turns_of_a_continuous_joint_one_is_looked_at(
    turns: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After one turn it passes the same places again; those of a thousand turns took seconds."""
    looked_at: list[Matrix] = []
    plain = ClearanceScreen.keeps

    def keeps(self: ClearanceScreen, q: Matrix) -> Flags:
        looked_at.append(q)
        return plain(self, q)

    monkeypatch.setattr(ClearanceScreen, "keeps", keeps)
    found = plan(tmp_path, "continuous", {"joints": {"joint0": START + turns * 2.0 * math.pi + 1.0}}, FRONT)
    assert found.message.startswith("the only way there is blocked: with joint0 at ")
    assert max(float(np.ptp(q)) for q in looked_at) == pytest.approx(2.0 * math.pi)


def test_a_way_beside_the_obstacle_and_one_that_opens_are_still_found(tmp_path: Path) -> None:
    assert plan(tmp_path, "revolute", JOINT, post("high", ARM, position=[ARM, 0.0, 2.0])).verified
    moving = plan(tmp_path, "revolute", JOINT, post("walker", ARM, velocity=[0.5, 0.0, 0.0]))
    assert moving.verified, moving.message


@pytest.mark.long
def test_a_goal_whose_tolerance_ends_before_the_obstacle_is_left_to_the_search(tmp_path: Path) -> None:
    found = plan(tmp_path, "revolute", {**TIP, "tolerance": 1.4}, FRONT)
    assert not found.message.startswith("the only way")
