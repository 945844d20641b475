"""One HTML page that plays a job without a network: the ground as it is dug, its cycles, and a section."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh

from backhoe_planner.arrays import Vector
from backhoe_planner.job import GROUND_BEYOND, JobPlan, build_worksite, is_below_swung, surface_beyond
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.show.drawing.drawing import PlanAnimation, Track, draw, mesh, node_names
from backhoe_planner.show.drawing.framing import View
from backhoe_planner.show.drawing.palette import LOOSE_SOIL, SOIL, UNTOUCHED
from backhoe_planner.show.drawing.scene_graph import HIDDEN, SceneGraph
from backhoe_planner.show.drawing.solids import facets
from backhoe_planner.show.drawing.timeline import Timeline, frames_at
from backhoe_planner.show.job.ground_changes import changes_of, start_of
from backhoe_planner.show.job.job_facts import cycle_rows, job_facts
from backhoe_planner.show.job.job_frames import JobFrames, Part, job_frames
from backhoe_planner.show.job.section import section_content
from backhoe_planner.show.job.truck_load import draw_truck_load
from backhoe_planner.show.page.display import Display
from backhoe_planner.show.page.page import page_of, read_parts, write_page_file
from backhoe_planner.show.page.page_content import frame_numbers, tell_problem
from backhoe_planner.site.schema import obstacle_shapes

_LOAD_INSIDE = 0.9  # of the bucket's hull: size at which the soil in it is drawn; chosen by eye
_HIDDEN = ("critical points",)  # while a bucket digs, the nearest obstacle is mostly the ground, which is no danger
_MOST_BEYOND = 15_000  # triangles of the ground beyond the modelled one; chosen: some 1 MB of the page
_NODE = ("ground", "terrain")  # where the page puts the ground in the viewer's tree


def write_job_page(plan: JobPlan, path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write a page that plays a job in any browser, offline, whole or not at all.

    Returns
    -------
    What could not be drawn as the URDF specifies, in words.

    Raises
    ------
    OutputError: the name ends in neither .html nor .htm, the folder does not exist or cannot be written, or the
        file belongs to the machine or the job.
    """
    return write_page_file(path, lambda: job_page(plan), inputs=(*plan.robot.files, *plan.job.files))


def job_page(plan: JobPlan) -> tuple[str, tuple[str, ...]]:
    """The page as text, and what could not be drawn as the URDF specifies, in words."""
    display = Display()
    warnings = show_job(display, plan)
    css, body, script = read_parts("backhoe_planner.show.job", "job.css", "job.html", "job.js")
    page = page_of(plan.job.name or "job", display, css=css, body=body, script=script)
    return page, warnings


def show_job(display: Display, plan: JobPlan) -> tuple[str, ...]:
    """Draw a job and its animation, send the page its figures, and return what could not be drawn, in words."""
    problem = _problem(plan)
    below = [obstacle.name for obstacle in problem.obstacles if is_below_swung(obstacle)]
    apart = [obstacle.name for obstacle in problem.obstacles if isinstance(obstacle.spec, obstacle_shapes.HeightMap)]
    frames = job_frames(plan) if plan.cycles else _standing(problem)
    visualizer, line = display.visualizer(), frames.timeline
    ground = plan.start
    beyond = _beyond(problem)
    low, high = ground.low, ground.high
    if beyond is not None:
        low, high = np.minimum(low, beyond.bounds[0, :2]), np.maximum(high, beyond.bounds[1, :2])
    opening = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    graph = SceneGraph(visualizer, problem, q=line.q[0], apart=[*apart, *below], opening=opening)
    if beyond is not None:
        draw(visualizer["ground"]["beyond"], mesh(facets(beyond), (*UNTOUCHED, 1.0), one_sided=True))
    tracks = list(graph.animation(line).tracks)
    tracks += _draw_load(visualizer, graph, plan, frames.parts, line.time)
    tracks += draw_truck_load(visualizer, graph.prefix, plan, frames.parts, line.time)
    visualizer.set_animation(PlanAnimation(tracks, float(line.time[-1])), play=False)
    view = graph.look_at_motion(line)
    tell_problem(
        display, problem, graph, view, line.obstacles, task=_words(plan), unnamed=(*_walls(plan), *below),
        hidden=_HIDDEN,
    )  # fmt: skip
    display.tell("plan", _plan_content(plan, line, view))
    display.tell(
        "job",
        {
            "buried": _buried(problem, graph, float(ground.surface.min())),
            "ground": start_of(ground) | {"node": _NODE, "colours": [UNTOUCHED, SOIL, LOOSE_SOIL]},
            "changes": changes_of(plan, frames.parts),
            "parts": frames.parts,
            "cycles": cycle_rows(plan),
            "undug": [one.words for one in plan.undug],
            "compared": plan.compared,
            "section": section_content(plan, problem, line.q),
        },
    )
    return graph.warnings


def _beyond(problem: Problem) -> trimesh.Trimesh | None:
    """The surface of the ground that the file of a job has beyond the modelled one [m]; None if there is none."""
    found = next((one for one in problem.obstacles if one.name == GROUND_BEYOND), None)
    if found is None:
        return None
    surface = trimesh.Trimesh(*surface_beyond(found, _MOST_BEYOND), process=False)
    return None if surface.is_empty else surface


def _words(plan: JobPlan) -> str:
    trench, what = plan.job.dig.trench, "a surface"
    if trench is not None:
        length, width, depth = (f"{round(size, 2):g} m" for size in (trench.length, trench.width, trench.depth))
        what = f"a trench of {length}, {width} wide, {depth} deep"
    return f"digs {what}"


def _walls(plan: JobPlan) -> tuple[str, ...]:
    """The walls of the truck's bed: four labels in one place would hide the bed."""
    truck = plan.job.dump.truck
    return () if truck is None else tuple(wall["name"] for wall in truck.bed.walls())


def _buried(problem: Problem, graph: SceneGraph, lowest: float) -> list[str]:
    """Nodes of the obstacles that are below the ground, judged by the positions of their labels."""
    nodes = node_names(obstacle.name for obstacle in problem.obstacles)
    return [nodes[name] for name, place in graph.anchors.items() if place is not None and place[2] < lowest]


def _problem(plan: JobPlan) -> Problem:
    """The problem of the first motion; without any motion, the site with the machine at its start. It has no goals."""
    first = plan.cycles[0].legs[0].problem if plan.cycles else build_worksite(plan.job, terrain=plan.start).problem
    return replace(first, goals=(), path=None)


def _standing(problem: Problem) -> JobFrames:
    """One frame of a machine that does not move."""
    q = problem.robot.middle if problem.start_q is None else problem.start_q
    motion = Trajectory(np.zeros(1), q[None], np.zeros((1, len(q))))
    return JobFrames(frames_at(problem, motion, np.zeros(1)), ())


def _plan_content(plan: JobPlan, line: Timeline, view: View) -> dict[str, Any]:
    """The facts that the page shows of any motion, for the whole job."""
    return {
        "verdict": plan.verdict,
        "reason": plan.reason,
        "message": plan.note,
        "facts": job_facts(plan),
        "goal": None,
        "kept": [],
        "view": view,
        **frame_numbers(line, plan.robot.link_names),
    }


def _draw_load(visualizer: Any, graph: SceneGraph, plan: JobPlan, parts: tuple[Part, ...], time: Vector) -> list[Track]:
    """Draw the soil in the bucket; the track makes it grow in the cut and vanish in the dump."""
    robot = plan.robot
    hulls = [piece.piece.hull for piece in robot.pieces if piece.joint == robot.n]
    if not hulls or not plan.cycles:
        return []
    body = trimesh.convex.convex_hull(np.vstack(hulls))
    middle = np.asarray(body.centroid)
    body.apply_translation(-middle)
    path = graph.node_of_link(robot.pieces[-1].link)
    node = visualizer["machine"][path]["load"]
    draw(node["soil"], mesh(facets(body), (*LOOSE_SOIL, 1.0)))
    place = np.eye(4)
    place[:3, 3] = middle
    node.set_transform(place)
    size = _LOAD_INSIDE * np.cbrt(_filled(plan, parts, time))
    scale = np.repeat(np.maximum(size, HIDDEN)[:, None], 3, axis=1)
    return [Track(f"{graph.prefix}/machine/{path}/load/soil", "scale", time, scale)]


def _filled(plan: JobPlan, parts: tuple[Part, ...], time: Vector) -> Vector:
    """(F,) the part of the bucket's capacity that is full."""
    moments, filled = [0.0], [0.0]
    for cycle in plan.cycles:
        own = {part.name: part for part in parts if part.cycle == cycle.number}
        if "cut" not in own or "dump" not in own:
            continue
        digging = cycle.digging
        held = plan.start.swell * digging.bank + digging.loose
        moments += [*(own["cut"].begin + digging.time), own["dump"].begin, own["dump"].end]
        filled += [*np.minimum(held, cycle.held) / plan.capacity, cycle.held / plan.capacity, 0.0]
    return np.interp(time, moments, np.minimum(filled, 1.0))
