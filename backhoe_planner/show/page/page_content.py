"""What the page shows of a problem, a posture and a plan, beside the picture."""

from __future__ import annotations

from typing import Any

import numpy as np

from backhoe_planner.live import is_recording, problem_to_show, unrecorded_changes
from backhoe_planner.motion import Problem
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.framing import View
from backhoe_planner.show.drawing.palette import FAR, NEAR, TIGHT
from backhoe_planner.show.drawing.scene_graph import SceneGraph
from backhoe_planner.show.drawing.timeline import Nearest, timeline
from backhoe_planner.show.page.display import Display


def show_plan(display: Display, plan: Plan) -> SceneGraph:
    """Draw a plan and its animation, and tell its verdict, numbers and frames."""
    problem = problem_to_show(plan)
    visualizer = display.visualizer()
    frames = timeline(problem, plan.trajectory)
    graph = SceneGraph(visualizer, problem, q=plan.trajectory.q[0])
    graph.draw_trace(frames.tip)
    view = graph.look_at_motion(frames)
    visualizer.set_animation(graph.animation(frames), play=False)
    tell_problem(display, problem, graph, view, frames.obstacles)
    rows = list(zip(*frames.nearest, strict=True))  # by obstacle
    links = {name: index for index, name in enumerate(plan.robot.link_names)}
    content = {
        "verdict": plan.verdict,
        "reason": plan.reason,
        "message": plan.message,
        "facts": _facts(plan),
        "time": frames.time - frames.time[0],
        "q": frames.q.T,
        "margins": [_margins(row) for row in rows],
        "links": [_links(row, links) for row in rows],
        "view": view,
    }
    display.tell("plan", content)
    return graph


def tell_problem(
    display: Display, problem: Problem, graph: SceneGraph, view: View, obstacles: tuple[str, ...], *, task: str = ""
) -> None:
    """Tell what stands on the site and what the machine is: names, limits, where names are written.

    Parameters
    ----------
    obstacles: names of what margins are shown for.
    task: what the machine does, in words; by default what its task says.
    """
    robot, scene = problem.robot, problem.scene
    built = {obstacle.name: obstacle for obstacle in problem.obstacles}
    listed = []
    for name in obstacles:
        obstacle = built.get(name)
        listed.append(
            {
                "name": name,
                "clearance": 0.0 if obstacle is None else obstacle.clearance,
                "anchor": graph.anchors.get(name),
                "appears_at": 0.0 if obstacle is None else obstacle.appears_at,
                "velocity": None if obstacle is None or not obstacle.moves else obstacle.velocity,
            }
        )
    joints = []
    for name, slides, low, high in zip(
        robot.joint_names, robot.prismatic, problem.limits.lower, problem.limits.upper, strict=True
    ):
        bounded = np.isfinite(low) and np.isfinite(high) and high > low
        lower, upper = (low, high) if bounded else (None, None)
        joints.append({"name": name, "angular": not slides, "lower": lower, "upper": upper})
    if not task:
        task = (
            "to a goal"
            if problem.goal is not None
            else "along a path"
            if problem.path is not None
            else "driven by hand"
        )
    content = {
        "title": scene.name or "untitled scene",
        "subtitle": f"{robot.name}, {task}",
        "obstacles": listed,
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
    display: Display, q: Any, *, time: float, nearest: tuple[Nearest | None, ...], links: tuple[str, ...]
) -> None:
    """Tell the numbers of one posture: joint positions (n,) and margins, as of `time` [s]."""
    index = {name: number for number, name in enumerate(links)}
    display.tell("step", {"time": time, "q": q, "margins": _margins(nearest), "links": _links(nearest, index)})


def _facts(plan: Plan) -> list[tuple[str, str, str]]:
    """Name, value and remark of what is told of a plan."""
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
        facts.append(("Planned in", f"{metrics.planning_time:.2f} s", f"method {plan.method}, seed {plan.seed}"))
    return facts


def _metres(value: float) -> str:
    return f"{value:.3f}".replace("-", "\N{MINUS SIGN}")


def _length(value: float) -> str:
    return f"{1000.0 * value:.1f} mm" if value < 0.1 else f"{value:.2f} m"


def _margins(spots: tuple[Nearest | None, ...]) -> list[float | None]:
    return [None if spot is None else round(spot.margin, 3) for spot in spots]


def _links(spots: tuple[Nearest | None, ...], index: dict[str, int]) -> list[int]:
    return [-1 if spot is None else index[spot.link] for spot in spots]
