"""The numbers that the page shows beside the picture: of a problem, a posture and a plan."""

from __future__ import annotations

from typing import Any

import numpy as np

from backhoe_planner.live import is_recording, problem_to_show, unrecorded_changes
from backhoe_planner.motion import Problem
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.framing import View
from backhoe_planner.show.drawing.palette import FAR, NEAR, TIGHT
from backhoe_planner.show.drawing.scene_graph import SceneGraph
from backhoe_planner.show.drawing.timeline import CriticalPoint, timeline
from backhoe_planner.show.page.display import Display


def show_plan(display: Display, plan: Plan) -> SceneGraph:
    """Draw a plan and its animation, and tell the page its verdict, numbers and frames."""
    problem = problem_to_show(plan)
    visualizer = display.visualizer()
    frames = timeline(problem, plan.trajectory)
    graph = SceneGraph(visualizer, problem, q=plan.trajectory.q[0])
    graph.draw_trace(frames.tip)
    view = graph.look_at_motion(frames)
    visualizer.set_animation(graph.animation(frames), play=False)
    tell_problem(display, problem, graph, view, frames.obstacles)
    numbers = [_numbers(row, plan.robot.link_names) for row in zip(*frames.nearest, strict=True)]  # by obstacle
    content = {
        "verdict": plan.verdict,
        "reason": plan.reason,
        "message": plan.message,
        "facts": _facts(plan),
        "time": frames.time - frames.time[0],
        "q": frames.q.T,
        "margins": [margins for margins, _ in numbers],
        "links": [links for _, links in numbers],
        "view": view,
    }
    display.tell("plan", content)
    return graph


def tell_problem(
    display: Display, problem: Problem, graph: SceneGraph, view: View, obstacles: tuple[str, ...], *, task: str = ""
) -> None:
    """Tell the page of the site and the machine: names and where they are written, clearances, limits.

    Parameters
    ----------
    graph, view: the picture and its camera.
    obstacles: names of what margins are shown for.
    task: what the machine does, in words; by default from its task.
    """
    robot, scene = problem.robot, problem.scene
    listed = {
        name: {"name": name, "clearance": 0.0, "anchor": graph.anchors.get(name), "appears_at": 0.0, "velocity": None}
        for name in obstacles
    }
    for obstacle in problem.obstacles:
        velocity = obstacle.velocity if obstacle.moves else None
        more = {"clearance": obstacle.clearance, "appears_at": obstacle.appears_at, "velocity": velocity}
        listed[obstacle.name].update(more)
    joints = []
    for name, slides, low, high in zip(
        robot.joint_names, robot.prismatic, problem.limits.lower, problem.limits.upper, strict=True
    ):
        bounded = np.isfinite(low) and np.isfinite(high) and high > low
        lower, upper = (low, high) if bounded else (None, None)
        joints.append({"name": name, "angular": not slides, "lower": lower, "upper": upper})
    of_problem = "along a path" if problem.path is not None else "driven by hand"
    of_problem = "to a goal" if problem.goals else of_problem
    content = {
        "title": scene.name or "untitled scene",
        "subtitle": f"{robot.name}, {task or of_problem}",
        "obstacles": list(listed.values()),
        "joints": joints,
        "links": robot.link_names,
        "influence": scene.influence,
        "far": 2.0 * scene.influence,
        "colours": [TIGHT, NEAR, FAR],
        "ground": graph.has_ground,
        "warnings": graph.warnings,
        "view": view,
    }
    display.tell("problem", content)


def tell_step(
    display: Display, q: Any, *, time: float, nearest: tuple[CriticalPoint | None, ...], links: tuple[str, ...]
) -> None:
    """Tell the page the numbers of one posture: joint positions q (n,) and margins, at `time` [s].

    Parameters
    ----------
    nearest: critical points, in the order of the obstacles that `tell_problem` named.
    links: names of the robot's links.
    """
    margins, numbers = _numbers(nearest, links)
    display.tell("step", {"time": time, "q": q, "margins": margins, "links": numbers})


def _facts(plan: Plan) -> list[tuple[str, str, str]]:
    """The facts that the page lists of a plan: name, value and remark of each."""
    certificate, metrics = plan.certificate, plan.metrics
    facts = []
    tightest = certificate.min_clearance
    if tightest is not None:
        required = tightest.distance - tightest.margin
        remark = f"{tightest.link} to {tightest.name} at {tightest.time:.1f} s; {_metres(tightest.distance)} m apart"
        remark += f", {required:.2f} m required" if required > 1e-9 else ""
        facts.append(("Tightest margin", f"{_metres(tightest.margin)} m", remark))
    tracking = certificate.tracking
    mean = "" if plan.scene.task.path is None else f"mean {_length(tracking.mean_error)}"
    if not is_recording(plan):
        facts.append(("Tip error", _length(tracking.max_error), mean))
    if certificate.detours:
        longest = max(detour.max_deviation for detour in certificate.detours)
        facts.append(("Detours", f"{len(certificate.detours)}", f"up to {_length(longest)} off the path"))
    facts.append(("Duration", f"{plan.trajectory.duration:.1f} s", ""))
    work = metrics.energy.get("work")
    if work is not None:
        facts.append(("Work", f"{work / 1000.0:.1f} kJ" if work >= 1000.0 else f"{work:.1f} J", ""))
    if is_recording(plan):
        facts.append(("Recording", "driven by hand", "; ".join(unrecorded_changes(plan))))
    else:
        facts.append(("Planned in", f"{metrics.planning_time:.2f} s", plan.settings))
    return facts


def _metres(value: float) -> str:
    return f"{value:.3f}".replace("-", "\N{MINUS SIGN}")


def _length(value: float) -> str:
    return f"{1000.0 * value:.1f} mm" if value < 0.1 else f"{value:.2f} m"


def _numbers(nearest: tuple[CriticalPoint | None, ...], links: tuple[str, ...]) -> tuple[list[float | None], list[int]]:
    """Margins [m], and indices of the links; None and -1 where there is no critical point."""
    margins = [None if point is None else round(point.margin, 3) for point in nearest]
    return margins, [-1 if point is None else links.index(point.link) for point in nearest]
