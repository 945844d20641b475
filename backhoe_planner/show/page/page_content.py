"""The figures that the page shows next to the picture: for a problem, a posture and a plan."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from backhoe_planner.live import problem_to_show
from backhoe_planner.motion import Problem
from backhoe_planner.planning import Plan, PlannedLeg
from backhoe_planner.show.drawing.framing import View
from backhoe_planner.show.drawing.kept_parts import kept_parts
from backhoe_planner.show.drawing.palette import FAR, KEPT, NEAR, TIGHT
from backhoe_planner.show.drawing.scene_graph import SceneGraph
from backhoe_planner.show.drawing.timeline import ITSELF, CriticalPoint, Timeline, timeline
from backhoe_planner.show.page.display import Display
from backhoe_planner.show.page.plan_facts import plan_facts

_DEGREES = float(np.degrees(1.0))  # per radian
_KEPT = {
    "pitch": "pitch",
    "above": "height",
    "below": "height",
    "rotation": "turned by at most",
    "tilt": "tilted by at most",
}


def show_plan(display: Display, plan: Plan) -> SceneGraph:
    """Draw a plan and its animation, and send the page its verdict, figures and frames."""
    problem = problem_to_show(plan)
    visualizer = display.visualizer()
    frames = timeline(problem, plan.trajectory)
    graph = SceneGraph(visualizer, problem, q=plan.trajectory.q[0])
    frames = frames.without(graph.drawn_as_one)
    graph.draw_trace(frames.tip)
    goal = plan.certificate.goal if problem.goals and plan.has_motion else None
    if goal is not None:
        graph.mark_goal(goal)
    view = graph.look_at_motion(frames)
    visualizer.set_animation(graph.animation(frames), play=False)
    tell_problem(display, problem, graph, view, frames.obstacles)
    content = {
        "verdict": plan.verdict,
        "reason": plan.reason,
        "message": plan.message,
        "facts": plan_facts(plan),
        "goal": goal,
        "legs": [_leg(problem, leg) for leg in plan.legs],
        "kept": _kept(plan, frames),
        **frame_numbers(frames, shown_links(problem)),
        "view": view,
    }
    display.tell("plan", content)
    return graph


def _leg(problem: Problem, leg: PlannedLeg) -> dict[str, Any]:
    """The facts of a leg for the page: its beginning, what it carries, and the obstacles that are not present in it."""
    carried = leg.problem.robot.carried
    there = {obstacle.name for obstacle in leg.problem.obstacles}
    away = [obstacle.name for obstacle in problem.obstacles if obstacle.name not in there]
    return {"name": leg.name, "begins": leg.begins, "carries": carried and carried[0], "away": away}


def frame_numbers(frames: Timeline, links: tuple[str, ...]) -> dict[str, Any]:
    """The figures of every frame: time from the first one, joints, and per obstacle margins and indices of `links`."""
    numbers = [_numbers(row, links) for row in zip(*frames.nearest, strict=True)]
    return {
        "time": frames.time - frames.time[0],
        "q": frames.q.T,
        "margins": [margins for margins, _ in numbers],
        "links": [links for _, links in numbers],
    }


def tell_problem(
    display: Display,
    problem: Problem,
    graph: SceneGraph,
    view: View,
    obstacles: tuple[str, ...],
    *,
    task: str = "",
    unnamed: Collection[str] = (),
    hidden: Collection[str] = (),
) -> None:
    """Send the page the facts about site and machine: names and their positions, clearances, limits.

    Parameters
    ----------
    graph, view: the picture and its camera.
    obstacles: names for which margins are shown.
    task: what the machine does, in words; by default derived from its task.
    unnamed: obstacles without a label in the picture.
    hidden: groups of `SceneGraph` that are hidden until they are switched on.
    """
    robot, scene = problem.robot, problem.scene
    listed = {
        name: {
            "name": name,
            "clearance": 0.0,
            "anchor": graph.anchors.get(name),
            "appears_at": 0.0,
            "velocity": None,
            "itself": name == ITSELF,
        }
        for name in obstacles
    }
    for obstacle in (one for one in problem.obstacles if one.name in listed):
        velocity = obstacle.velocity if obstacle.moves else None
        more = {"clearance": obstacle.clearance, "appears_at": obstacle.appears_at, "velocity": velocity}
        listed[obstacle.name].update(more)
    for name in unnamed:
        listed[name]["anchor"] = None
    joints = []
    for name, slides, low, high in zip(
        robot.joint_names, robot.prismatic, problem.limits.lower, problem.limits.upper, strict=True
    ):
        bounded = np.isfinite(low) and np.isfinite(high) and high > low
        lower, upper = (low, high) if bounded else (None, None)
        joints.append({"name": name, "angular": not slides, "lower": lower, "upper": upper})
    of_problem = "along a path" if problem.path is not None else "driven by hand"
    of_problem = "to a goal" if problem.goals else of_problem
    of_problem = f"a sequence of {len(problem.legs)} legs" if problem.legs else of_problem
    content = {
        "title": scene.title,
        "subtitle": f"{robot.name}, {task or of_problem}",
        "obstacles": list(listed.values()),
        "loads": graph.loads,
        "hidden": tuple(hidden),
        "goals": [{"name": goal.name, "anchor": goal.target.position} for goal in problem.goals[1:] and problem.goals],
        "joints": joints,
        "links": shown_links(problem),
        "influence": scene.influence,
        "far": 2.0 * scene.influence,
        "colours": [TIGHT, NEAR, FAR],
        "kept_axis": KEPT if graph.has_kept_axis else None,
        "ground": graph.has_ground,
        "warnings": graph.warnings,
        "view": view,
    }
    display.tell("problem", content)


def shown_links(problem: Problem) -> tuple[str, ...]:
    """Names of the links of a problem's machine, and of the loads that it carries in some leg."""
    loads = [leg.robot.carried[0] for leg in problem.legs if leg.robot.carried is not None]
    return tuple(dict.fromkeys((*problem.robot.link_names, *loads)))


def tell_step(
    display: Display, q: Any, *, time: float, nearest: tuple[CriticalPoint | None, ...], links: tuple[str, ...]
) -> None:
    """Send the page the figures of one posture: joint positions q (n,) and margins, at `time` [s].

    Parameters
    ----------
    nearest: critical points, in the order of the obstacles that `tell_problem` named.
    links: names of the robot's links.
    """
    margins, numbers = _numbers(nearest, links)
    display.tell("step", {"time": time, "q": q, "margins": margins, "links": numbers})


def _kept(plan: Plan, frames: Timeline) -> list[dict[str, Any]]:
    """The facts of each condition for the page: value and margin at every frame, in degrees or metres.

    They are None at frames at which the condition is not to be kept. One that is kept in several legs is told once.
    """
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for begins, ends, conditions in kept_parts(plan):
        within = np.flatnonzero((frames.time >= begins) & (frames.time <= ends)).tolist()
        for one in conditions:
            scale = _DEGREES if one.unit == "rad" else 1.0
            facts = found.setdefault((one.name, one.allowed), {
                "name": _KEPT[one.name],
                "allowed": one.allowed.replace(" deg", "\N{DEGREE SIGN}").replace("-", "\N{MINUS SIGN}"),
                "angular": one.unit == "rad",
                "values": [None] * len(frames.time),
                "margins": [None] * len(frames.time),
            })  # fmt: skip
            values = one.values(frames.q[within])
            for frame, value, margin in zip(within, values.tolist(), one.margins(values).tolist(), strict=True):
                facts["values"][frame], facts["margins"][frame] = scale * one.absolute(value), scale * margin
    return list(found.values())


def _numbers(nearest: tuple[CriticalPoint | None, ...], links: tuple[str, ...]) -> tuple[list[float | None], list[int]]:
    """Margins [m], and indices of the links; None and -1 if there is no critical point."""
    margins = [None if point is None else round(point.margin, 3) for point in nearest]
    return margins, [-1 if point is None else links.index(point.link) for point in nearest]
