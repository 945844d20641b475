"""Obstacles far from the machine: more than Pinocchio takes at once, and none of them within reach."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import Robot
from backhoe_planner.motion import build_problem
from backhoe_planner.proof.clearances import find_clearances
from backhoe_planner.site import Proximity

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
