"""Smoothing never tears: steps between samples stay as short as before, or as a resolved path's may be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import BatchKinematics, TargetBatch, solve_batch
from backhoe_planner.motion import PathCost, Problem, build_problem
from backhoe_planner.planning import EFFORTS, Stretch, Work, cheapen_stretch, smooth_stretch

Data = dict[str, Any]

BOUND = 0.11  # rad: three times the 0.03 rad of a straight path plus 0.02, the most of a resolved path's steps
LENGTH = 0.4  # m of path, in 40 steps
SWEEPS = 30  # of the dynamic programming, which made the worst of the tears
WANDER = 0.03  # rad by which a joint's drift within the null space changes from sample to sample


def waypoint(position: np.ndarray[Any, Any], rotation: np.ndarray[Any, Any] | None) -> Data:
    if rotation is None:
        return {"position": position.tolist()}
    turned = pin.Quaternion(rotation)
    return {"position": position.tolist(), "quaternion": [turned.w, turned.x, turned.y, turned.z]}


def random_stretch(robot: bp.Robot, seed: int, *, full: bool) -> tuple[Problem, Stretch] | None:
    """A clear stretch along a random line that wanders in the null space; None if the walk ends early."""
    rng = np.random.default_rng(seed)
    q = robot.random_q(rng)
    at = bp.Kinematics(robot).at(q)
    begin, rotation = at.tip_position.copy(), at.tip_rotation.copy()
    way = rng.standard_normal(3)
    end = begin + LENGTH * way / np.linalg.norm(way)
    turned = rotation @ pin.exp3(0.5 * rng.standard_normal(3)) if full else None
    points = [waypoint(begin, rotation if full else None), waypoint(end, turned)]
    content = {"version": 1, "task": {"path": {"waypoints": points}}, "objective": "velocity_norm"}
    problem = build_problem(robot, bp.scene_from_dict(content))
    assert problem.path is not None
    stations = np.linspace(0.0, problem.path.length, 41)
    found, drift = [q], 2.0 * WANDER * rng.standard_normal(robot.n)
    for s in stations[1:].tolist():
        drift = 0.9 * drift + WANDER * rng.standard_normal(robot.n)
        target = TargetBatch.of([problem.path.target(s)])
        after, reached = solve_batch(BatchKinematics(robot), target, (found[-1] + drift)[None], iterations=15)
        if not reached[0] or np.max(np.abs(after[0] - found[-1])) > 0.24:
            return None
        found.append(after[0])
    proximity = bp.Proximity(robot, problem.obstacles)
    if any(np.any(proximity.distances(row) < proximity.clearance) for row in found):
        return None
    return problem, Stretch(stations, np.array(found))


def longest_step(stretch: Stretch) -> float:
    return float(np.max(np.abs(np.diff(stretch.q, axis=0))))


# seeds whose walk reaches the end of its line, and that tore before: to 0.37 rad, or by a little
PANDA = [("panda", "panda_hand_tcp", 69, True)]
FREE = [pytest.param("panda", "panda_hand_tcp", 52, False, marks=pytest.mark.long)]
XARM = [("xarm7", "link_eef", 65, True)]
MORE = [
    *(pytest.param("panda", "panda_hand_tcp", seed, True, marks=pytest.mark.long) for seed in (90, 103)),
    pytest.param("xarm7", "link_eef", 38, True, marks=pytest.mark.long),
]


@pytest.mark.parametrize(("name", "tip", "seed", "full"), [*PANDA, *FREE, *XARM, *MORE])
@pytest.mark.parametrize("free_start", [True, pytest.param(False, marks=pytest.mark.long)])
def test_smoothing_keeps_the_steps_of_seven_joints_within_their_bound(
    name: str, tip: str, seed: int, full: bool, free_start: bool
) -> None:
    robot = bp.load_robot(f"example:{name}", tip=tip)
    drawn = random_stretch(robot, seed, full=full)
    assert drawn is not None
    problem, stretch = drawn
    assert problem.path is not None
    bound = max(longest_step(stretch), BOUND) + 1e-12
    setting: dict[str, Any] = {
        "proximity": bp.Proximity(robot, problem.obstacles), "free_start": free_start, "free_end": True,
    }  # fmt: skip
    smooth = smooth_stretch(problem, problem.path, stretch, **setting)
    assert longest_step(smooth) <= bound
    work = Work(EFFORTS["quick"])
    work.sweeps = SWEEPS
    cheap = cheapen_stretch(problem, problem.path, smooth, cost=PathCost(problem), work=work, **setting)
    assert longest_step(cheap) <= max(longest_step(smooth), BOUND) + 1e-12
    cost = PathCost(problem)
    assert cost.of_run(cheap.stations, cheap.q) <= cost.of_run(smooth.stations, smooth.q)
