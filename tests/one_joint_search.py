"""A search for the least work among no obstacles: one joint of a planar arm moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import backhoe_planner as bp
from backhoe_planner.machine import GRAVITY, Dynamics
from backhoe_planner.motion import build_problem, time_evenly
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.goals.cost_search import CostSearch
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.search.effort import EFFORTS, Work
from backhoe_planner.planning.world.world import World

START, END = np.full(4, 0.1), np.array([0.5, 0.1, 0.1, 0.1])
DURATION = 4.0  # s of a motion within the allowed time


def scene(robot: bp.Robot, objective: str) -> bp.Scene:
    joints = {name: dict(zip(robot.joint_names, q.tolist(), strict=True)) for name, q in (("s", START), ("e", END))}
    content = {"version": 1, "start": {"joints": joints["s"]}, "task": {"goal": {"joints": joints["e"]}}}
    return bp.scene_from_dict(content | {"objective": objective})


def world_of(robot: bp.Robot) -> World:
    """The world of a search for the least work to the goal, without hops."""
    return World(
        build_problem(robot, scene(robot, "work")), seed=5, work=Work(replace(EFFORTS["normal"], hop_rounds=0))
    )


def ended_search(robot: bp.Robot) -> tuple[World, GoalPostures, CostSearch]:
    """A search for the least work to the goal that has ended, with its world and the postures on the goal."""
    world = world_of(robot)
    found = find_goal_postures(world, world.problem.goals, near=START, time=0.0)
    assert isinstance(found, GoalPostures)
    search = CostSearch(world, START, found, time=0.0)
    assert search.run() == ""
    return world, found, search


def motion_of_lift(world: World, millimetres: float) -> FoundMotion:
    """A motion of the joint, with the cost of lifting all moving parts by so many millimetres."""
    masses, _ = Dynamics(world.problem.robot).bodies()
    curve = JointCurve.straight(START, END, 12)
    cost = millimetres * 1e-3 * GRAVITY * float(np.sum(masses))
    return FoundMotion(time_evenly(curve, DURATION), cost, world.problem.goals[0], "straight", curve)
