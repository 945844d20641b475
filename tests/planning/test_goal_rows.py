"""Rows that keep the end of a curve within the tolerance of a goal, in the program of a descent."""

from __future__ import annotations

import json

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.linear_model import LinearModel
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site

START, END, PIECES = np.array([0.0, 0.4, -1.6, -0.9]), np.array([0.6, 0.2, -1.2, -0.7]), 8
TOLERANCE = 0.1  # m, of which a search uses 0.9
WIDE = 0.25  # rad


@pytest.mark.parametrize(("box", "least"), [(WIDE, 0.985), (0.1 * WIDE, 0.998)])
def test_the_rows_of_a_tolerance_bound_nearly_a_ball(backhoe: bp.Robot, box: float, least: float) -> None:
    """No step leads further than 1.01 radii from the goal, and in a small box each of nearly one radius is allowed."""
    tip = bp.Kinematics(backhoe).at(END)
    start = {"joints": dict(zip(backhoe.joint_names, START.tolist(), strict=True))}
    goal = {"position": tip.tip_position.tolist(), "tolerance": TOLERANCE}
    content = {"version": 1, "start": start, "task": {"goal": goal}, "objective": "work"}
    problem = build_problem(backhoe, bp.scene_from_dict(content))
    curve = JointCurve.straight(START, END, PIECES)
    model = LinearModel(problem, curve, 5.0, end_moves=True, box=np.full(4, box))
    model.stay_on_goal(problem.goals[0], tip)
    (rows,) = (row for row in model.program(20.0).rows if row.name == "position")

    rng, radius = np.random.default_rng(3), 0.9 * TOLERANCE
    outward = rng.normal(size=(500, 3))
    outward *= radius / np.linalg.norm(outward, axis=1)[:, None]
    moves = outward @ np.linalg.pinv(tip.jacobian[:3]).T
    # the rest of the moves leave the box, where rows that cannot be reached in it are left out
    moves = moves[np.max(np.abs(moves), axis=1) < box / 1.02]
    assert len(moves) > 20
    ends = np.zeros((rows.G.shape[1], len(moves)))
    ends[4 * (PIECES - 1) : 4 * PIECES] = moves.T
    over = rows.G @ ends / (rows.h[:, None])
    assert float(np.min(np.max(over, axis=0))) * 1.01 > 1.0
    assert float(np.max(over)) * least < 1.0


@pytest.mark.parametrize(
    ("machine", "index"), [("telescope", 6), ("planar4", 15), pytest.param("planar4", 9, marks=pytest.mark.long)]
)
def test_a_tolerance_does_not_make_a_quick_plan_dear(machine: str, index: int) -> None:
    """A motion to the position itself is allowed too. It cost a third to a fiftieth of what was found."""
    robot = load_machine(machine)
    scene = random_site(robot, SiteKey(machine, "narrow", "goal", index)).scene
    content = scene.model_dump(by_alias=True, exclude_unset=True, mode="json") | {"objective": "work"}
    costs = []
    for more in ({}, {"tolerance": 0.1}):
        content["task"]["goal"] |= more
        plan = bp.plan(robot, bp.scene_from_dict(json.loads(json.dumps(content))), effort="quick")
        assert plan.verified, plan.message
        costs.append(plan.metrics.energy["work"])
    assert costs[1] < 2.0 * costs[0]
