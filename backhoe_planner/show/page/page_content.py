"""What the page tells beside the picture, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from backhoe_planner.live import is_driven, left_out
from backhoe_planner.motion import Problem
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.framing import View
from backhoe_planner.show.drawing.palette import FAR, NEAR, TIGHT
from backhoe_planner.show.drawing.scene_graph import SceneGraph
from backhoe_planner.show.drawing.timeline import Nearest, Timeline

__all__ = ["plan_content", "problem_content", "step_content"]


def problem_content(problem: Problem, graph: SceneGraph, view: View, obstacles: tuple[str, ...]) -> dict[str, Any]:
    """The site and the machine: names, limits, where names are written."""
    robot, scene = problem.robot, problem.scene
    anchors = {drawn.name: drawn.anchor for drawn in graph.site}
    built = {obstacle.name: obstacle for obstacle in problem.obstacles}
    listed = []
    for name in obstacles:
        obstacle = built.get(name)
        listed.append(
            {
                "name": name,
                "clearance": 0.0 if obstacle is None else obstacle.clearance,
                "anchor": None if name not in anchors else _rounded(anchors[name]),
                "appears_at": 0.0 if obstacle is None else obstacle.appears_at,
                "velocity": None if obstacle is None or not obstacle.moves else _rounded(obstacle.velocity),
            }
        )
    joints = []
    for index, name in enumerate(robot.joint_names):
        low, high = float(problem.limits.lower[index]), float(problem.limits.upper[index])
        bounded = np.isfinite(low) and np.isfinite(high) and high > low
        joints.append(
            {
                "name": name,
                "angular": not bool(robot.prismatic[index]),
                "lower": low if bounded else None,
                "upper": high if bounded else None,
            }
        )
    task = "to a goal" if problem.goal is not None else "along a path" if problem.path is not None else "driven by hand"
    return {
        "type": "problem",
        "title": scene.name or "untitled scene",
        "subtitle": f"{robot.name}, {task}",
        "obstacles": listed,
        "joints": joints,
        "links": list(robot.link_names),
        "influence": scene.influence,
        "far": 2.0 * scene.influence,
        "colours": [list(TIGHT), list(NEAR), list(FAR)],
        "ground": graph.has_ground,
        "warnings": list(graph.warnings),
        "view": _view(view),
    }


def plan_content(plan: Plan, timeline: Timeline, view: View) -> dict[str, Any]:
    """The verdict, its numbers, and the frames."""
    links = {name: index for index, name in enumerate(plan.robot.link_names)}
    columns = range(len(timeline.obstacles))
    return {
        "type": "plan",
        "verdict": plan.verdict,
        "reason": plan.reason,
        "message": plan.message,
        "facts": _facts(plan),
        "time": _rounded(timeline.time - timeline.time[0]),
        "q": [_rounded(column) for column in timeline.q.T],
        "margins": [[_margin(row[column]) for row in timeline.nearest] for column in columns],
        "links": [[_link(row[column], links) for row in timeline.nearest] for column in columns],
        "view": _view(view),
    }


def step_content(time: float, q: Any, nearest: tuple[Nearest | None, ...], links: tuple[str, ...]) -> dict[str, Any]:
    """One posture while planning goes on."""
    index = {name: number for number, name in enumerate(links)}
    return {
        "type": "step",
        "time": time,
        "q": _rounded(q),
        "margins": [_margin(spot) for spot in nearest],
        "links": [_link(spot, index) for spot in nearest],
    }


def _facts(plan: Plan) -> list[list[str]]:
    certificate, metrics = plan.certificate, plan.metrics
    facts: list[list[str]] = []
    tightest = certificate.min_clearance
    if tightest is not None:
        asked = tightest.distance - tightest.margin
        facts.append(
            [
                "Tightest margin",
                f"{_metres(tightest.margin)} m",
                f"{tightest.link} to {tightest.name} at {tightest.time:.1f} s; "
                f"{_metres(tightest.distance)} m apart" + (f", {asked:.2f} m asked" if asked > 1e-9 else ""),
            ]
        )
    tracking = certificate.tracking
    mean = "" if plan.scene.task.path is None else f"mean {_length(tracking.mean_error)}"
    if not is_driven(plan):
        facts.append(["Tip error", _length(tracking.max_error), mean])
    if certificate.detours:
        longest = max(detour.max_deviation for detour in certificate.detours)
        facts.append(["Detours", f"{len(certificate.detours)}", f"up to {_length(longest)} off the path"])
    facts.append(["Duration", f"{plan.trajectory.duration:.1f} s", ""])
    energy = metrics.get("energy")
    work = energy.get("work") if isinstance(energy, dict) else None
    if isinstance(work, (int, float)):
        facts.append(["Work", f"{work / 1000.0:.1f} kJ" if work >= 1000.0 else f"{work:.1f} J", ""])
    taken = metrics.get("planning_time")
    if is_driven(plan):
        facts.append(["Recording", "driven by hand", "; ".join(left_out(plan))])
    elif isinstance(taken, (int, float)):
        facts.append(["Planned in", f"{taken:.2f} s", f"method {plan.method}, seed {plan.seed}"])
    return facts


def _metres(value: float) -> str:
    return f"{value:.3f}".replace("-", "\N{MINUS SIGN}")


def _length(value: float) -> str:
    return f"{1000.0 * value:.1f} mm" if value < 0.1 else f"{value:.2f} m"


def _margin(spot: Nearest | None) -> float | None:
    return None if spot is None else round(spot.margin, 3)


def _link(spot: Nearest | None, links: dict[str, int]) -> int:
    return -1 if spot is None else links[spot.link]


def _view(view: View) -> dict[str, Any]:
    return {
        "target": _rounded(view.target),
        "direction": _rounded(view.direction),
        "distances": [_rounded(pair) for pair in view.distances],
    }


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 4) for value in values]
