"""Paths close to an obstacle: the planner keeps the clearances that the certificate proves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import PathCost, Problem, Trajectory, build_problem
from backhoe_planner.planning import EFFORTS, PathResolver, Stretch, Work, cheapen_stretch, planner, smooth_stretch
from backhoe_planner.proof import Certificate, certify_motion

AT_CLEARANCE = 1e-5  # m: a measured distance short by no more counts as clear
FURTHER = 0.003  # m
SWEEPS = 20  # of the dynamic programming
CUT = ((3.0, 0.0, 0.2), (2.6, 0.2, 0.6))
BALL = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [2.4, 0.2, 2.9]}  # above the stick


def beside_the_ball(clearance: float) -> bp.Scene:
    waypoints = [{"position": point} for point in CUT]
    task = {"path": {"waypoints": waypoints, "detour": False}}
    ball = BALL | {"clearance": clearance}
    return bp.scene_from_dict({"version": 1, "task": task, "objective": "velocity_norm", "obstacles": [ball]})


def from_the_ball(proximity: bp.Proximity, q: np.ndarray[Any, Any]) -> float:
    """The least distance of configurations from the ball [m]."""
    own = [index for index, pair in enumerate(proximity.pairs) if pair.obstacle == "ball"]
    return min(float(np.min(proximity.distances(row)[own])) for row in q)


def resolved(problem: Problem, *, further: float = 0.0) -> tuple[Stretch, bp.Proximity]:
    assert problem.path is not None
    cost, proximity = PathCost(problem), bp.Proximity(problem.robot, problem.obstacles)
    apart = np.full(len(proximity.pairs), further)
    resolver = PathResolver(
        problem, problem.path, proximity=proximity, find_detour=lambda *_: None, cost=cost.step_costs, apart=apart
    )
    (piece,) = resolver.resolve(None, detours=False).pieces
    assert isinstance(piece, Stretch)
    return piece, proximity


def test_a_path_at_its_clearance_keeps_it_however_often_it_is_made_cheaper(backhoe: bp.Robot) -> None:
    """At 0.25 m from the ball the cheapest configurations are cut off, so cheaper ones would be nearer."""
    piece, proximity = resolved(build_problem(backhoe, beside_the_ball(0.25)))
    clearance = from_the_ball(proximity, piece.q)  # so the path is at exactly its clearance
    problem = build_problem(backhoe, beside_the_ball(clearance))
    assert problem.path is not None
    cost, proximity = PathCost(problem), bp.Proximity(backhoe, problem.obstacles)
    ends: dict[str, Any] = {"proximity": proximity, "free_start": True, "free_end": True}
    for _ in range(3):
        piece = smooth_stretch(problem, problem.path, piece, **ends)
        work = Work()
        work.sweeps = SWEEPS
        piece = cheapen_stretch(problem, problem.path, piece, cost=cost, work=work, **ends)
    assert from_the_ball(proximity, piece.q) >= clearance - AT_CLEARANCE


def test_a_route_keeps_an_additional_distance_where_possible(backhoe: bp.Robot) -> None:
    """At 0.3 m from the ball the cheapest configurations are cut off, so the route passes just beyond."""
    problem = build_problem(backhoe, beside_the_ball(0.3))
    for further in (0.0, FURTHER):
        piece, proximity = resolved(problem, further=further)
        assert from_the_ball(proximity, piece.q) >= 0.3 + further - AT_CLEARANCE
    near, proximity = resolved(problem)
    clearance = from_the_ball(proximity, near.q)
    moved, proximity = resolved(build_problem(backhoe, beside_the_ball(clearance)), further=FURTHER)
    assert from_the_ball(proximity, moved.q) >= clearance + FURTHER


@pytest.mark.long
def test_a_path_whose_motion_is_proven_too_near_is_planned_again(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At first a much larger ball is certified, which stands for a curve that swings out towards it."""
    problem = build_problem(backhoe, beside_the_ball(0.3))
    judges = [build_problem(backhoe, beside_the_ball(2.0)), problem]

    def judge(_: Problem, motion: Trajectory) -> Certificate:
        return certify_motion(judges.pop(0), motion)

    monkeypatch.setattr(planner, "certify_motion", judge)
    outcome, certificate = planner.plan_motion(problem, effort=EFFORTS["quick"])
    assert not judges
    assert not outcome.reason
    assert certificate.verified
