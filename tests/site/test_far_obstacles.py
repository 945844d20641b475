"""Obstacles far from the machine: more than Pinocchio takes at once, and none of them within reach."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import TURNING_SLIDE

import backhoe_planner as bp
from backhoe_planner.machine import Robot, reach_ball
from backhoe_planner.motion import build_problem
from backhoe_planner.planning import plan_problem
from backhoe_planner.proof.clearances import find_clearances
from backhoe_planner.site import Proximity, build_obstacle, obstacle_from_dict, obstacles_in_reach

Q = np.array([0.0, 0.4, -1.6, -0.9])


def proximity(robot: Robot, *near: dict[str, Any], far: int = 600) -> Proximity:
    """A site with boxes of 1 m from 50 m away on, seeded, and others."""
    rng = np.random.default_rng(8)
    boxes = [
        {"name": f"far {k}", "shape": "box", "size": [1, 1, 1], "position": [50.0 + k, float(rng.uniform(-50, 50)), 0]}
        for k in range(far)
    ]
    start = {"joints": dict(zip(robot.joint_names, Q.tolist(), strict=True))}
    task = {"goal": {"position": [3.5, 2.4, 0.3]}}
    scene = bp.scene_from_dict({"version": 1, "start": start, "task": task, "obstacles": [*boxes, *near]})
    return Proximity(robot, build_problem(robot, scene).obstacles)


@pytest.mark.parametrize("x", [None, 4.5, 7.0, 40.0])
def test_the_tightest_pair_is_that_of_all_distances(backhoe: Robot, x: float | None) -> None:
    near = [] if x is None else [{"name": "rock", "shape": "sphere", "radius": 0.3, "position": [x, 0.0, 1.0]}]
    one, other = proximity(backhoe, *near), proximity(backhoe, *near)
    found, margins = one.tightest(Q), other.distances(Q) - other.clearance
    assert found is not None
    assert found.margin == pytest.approx(margins.min(), abs=1e-12)
    assert found.name == other.pairs[int(np.argmin(margins))].at(0.0).name


def test_far_obstacles_are_never_placed(backhoe: Robot) -> None:
    """Neither the tightest pair nor the certificate needs them: Pinocchio takes 250 of them at once in 20 ms."""
    site = proximity(backhoe, far=2000)
    assert site.tightest(Q) is not None
    motion = bp.Trajectory.from_steps(np.array([0.0, 2.0]), np.array([Q, Q + np.array([0.3, 0.1, 0.0, 0.0])]))
    near = find_clearances(site, motion)
    assert [one.kind for one in near] == ["machine"]
    assert len(site._geometry._made) <= 1  # of 8 parts


def _with(robot: Robot, *obstacles: dict[str, Any], tracking: float | None = None) -> Any:
    """The problem of a motion to a place with these obstacles."""
    start = {"joints": dict(zip(robot.joint_names, Q.tolist(), strict=True))}
    content = {"version": 1, "start": start, "task": {"goal": {"position": [3.5, 2.4, 0.3]}}, "obstacles": obstacles}
    if tracking is not None:
        content |= {"tracking": {"joints": tracking}}
    return build_problem(robot, bp.scene_from_dict(content))


def _ball(name: str, x: float, **keys: Any) -> dict[str, Any]:
    return {"name": name, "shape": "sphere", "radius": 0.5, "position": [x, 0.0, 0.0], **keys}


def test_only_obstacles_that_no_posture_brings_within_ten_metres_are_left_out(backhoe: Robot) -> None:
    """The ball about the swing axis that the arm never leaves decides; what moves, and half-spaces askew, are kept."""
    centre, radius = reach_ball(backhoe)
    edge = float(centre[0]) + np.sqrt((radius + 10.0 + 0.1) ** 2 - centre[2] ** 2) + 0.5  # a box around a ball of 0.5 m
    given = [
        _ball("near", edge - 0.6, clearance=0.1), _ball("far", edge + 1.0, clearance=0.1),
        _ball("far, but wide", edge + 1.0, clearance=1.5), _ball("comes", edge + 50.0, velocity=[-1.0, 0.0, 0.0]),
        {"name": "slope", "shape": "halfspace", "point": [0, 0, -90], "normal": [0.1, 0, 1]},
    ]  # fmt: skip
    obstacles = _with(backhoe, *given).obstacles
    assert [one.name for one in obstacles_in_reach(backhoe, obstacles)] == ["near", "far, but wide", "comes", "slope"]
    assert obstacles_in_reach(backhoe, ()) == ()


def test_a_machine_off_its_plan_reaches_farther(backhoe: Robot) -> None:
    """With 0.2 rad in each joint, parts of it are up to a metre or more from where they are planned to be."""
    centre, radius = reach_ball(backhoe)
    away = _ball("away", float(centre[0]) + radius + 11.2, clearance=0.1)
    plain, loose = (_with(backhoe, away, tracking=error) for error in (None, 0.2))
    assert not obstacles_in_reach(plain.robot, plain.obstacles)
    assert len(obstacles_in_reach(loose.robot, loose.obstacles)) == 1


def test_slides_beyond_their_limits_may_reach_anything(tmp_path: Path) -> None:
    file = tmp_path / "turning_slide.urdf"
    file.write_text(TURNING_SLIDE)
    robot = bp.load_robot(file)
    away = build_obstacle(obstacle_from_dict(_ball("away", 400.0)), folder=tmp_path, clearance=0.1)
    assert obstacles_in_reach(robot, [away]) == (away,)


def test_far_obstacles_have_no_pairs_in_a_plan_or_its_proof(backhoe: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plan beside 300 boxes that are 50 m away is that without them, to the last bit."""
    rng = np.random.default_rng(8)
    far = [
        {"name": f"far {k}", "shape": "box", "size": [1, 1, 1], "position": [50.0 + k, float(rng.uniform(-50, 50)), 0]}
        for k in range(300)
    ]
    post = {"name": "post", "shape": "sphere", "radius": 0.2, "position": [3.6, 1.2, 0.4]}
    counts: list[int] = []
    plain = Proximity.__init__

    def counted(self: Proximity, *args: Any, **keys: Any) -> None:
        plain(self, *args, **keys)
        counts.append(len(self.obstacles))

    monkeypatch.setattr(Proximity, "__init__", counted)
    one, other = (plan_problem(_with(backhoe, *some), effort="quick") for some in ([post], [post, *far]))
    assert set(counts) == {1}
    assert np.array_equal(one.trajectory.q, other.trajectory.q)
    assert one.certificate.clearances == other.certificate.clearances
    assert other.verified
