"""Draws a session, thirty times a second, and tells the page its numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray

from backhoe_planner.motion import build_problem
from backhoe_planner.show.drawing.drawing import mesh, set_property
from backhoe_planner.show.drawing.scene_graph import SceneGraph
from backhoe_planner.show.drawing.solids import facets
from backhoe_planner.show.page.page_content import problem_content, step_content
from backhoe_planner.show.page.recording import Recording
from backhoe_planner.show.teleop.session import LARGEST_FORCE, Session, Snapshot
from backhoe_planner.show.teleop.wording import Wording
from backhoe_planner.site import Obstacle

__all__ = ["Picture"]

Vector = NDArray[np.float64]

_FORCE = (0.72, 0.11, 0.48, 1.0)
_LONGEST_ARROW = 1.2  # m, for the largest force
_LEAST_SHOWN = 0.3  # N
_HIDDEN = 1e-5
_POSTURES = 16  # that are to be in view
_UP = np.array([0.0, 0.0, 1.0])


class Picture:
    """What the pages of a session show.

    Parameters
    ----------
    session: of which the first snapshot is drawn at once.
    recording: to draw and tell through.

    Attributes
    ----------
    warnings: what could not be drawn as the URDF asks, in words.

    An obstacle that cannot be drawn is left out of the picture, and the pages are told.
    """

    def __init__(self, session: Session, recording: Recording) -> None:
        self._recording = recording
        self._tree = recording.visualizer()
        problem = build_problem(session.robot, session.scene)
        self._problem = replace(problem, goal=None, path=None)
        first = session.snapshot()
        self._graph = SceneGraph(self._tree, self._problem, q=first.state.q)
        self.warnings = self._graph.warnings
        rng = np.random.default_rng(0)
        around = [first.state.q + 0.5 * (session.robot.random_q(rng) - first.state.q) for _ in range(_POSTURES)]
        self._view = self._graph.look_at_postures([first.state.q, *around])
        self._anchors = {drawn.name: np.array(drawn.anchor) for drawn in self._graph.site}
        self._taken_up = tuple(obstacle.name for obstacle in self._problem.obstacles)
        self._undrawn: frozenset[str] = frozenset()
        self._wording = Wording()
        self._draw_arrow()
        self._tell_problem(first)
        self.show(first)

    def show(self, snapshot: Snapshot) -> None:
        """Bring the picture and its numbers up to date."""
        names = tuple(obstacle.name for obstacle in snapshot.obstacles)
        if names != self._taken_up:
            self._take_up(snapshot.obstacles)
            self._tell_problem(snapshot)
        self._graph.move(snapshot.state.q)
        for name in names:
            if name not in self._undrawn:
                self._graph.place(name, snapshot.shifts[name])
        for name, spot in snapshot.nearest.items():
            if name not in self._undrawn:
                self._graph.point(name, spot)
        self._place_arrow(snapshot)
        state = snapshot.state
        self._recording.tell(
            step_content(state.time, state.q, tuple(snapshot.nearest.values()), self._problem.robot.link_names)
        )
        self._recording.tell(self._content(snapshot))

    def _take_up(self, obstacles: tuple[Obstacle, ...]) -> None:
        there = {obstacle.name: obstacle for obstacle in obstacles}
        for name in [name for name in self._anchors if name not in there]:
            del self._anchors[name]
            self._graph.remove(name)
        self._undrawn &= there.keys()
        for name in [name for name in there if name not in self._anchors and name not in self._undrawn]:
            try:
                self._anchors[name] = np.array(self._graph.add(there[name]))
            except Exception as error:  # noqa: BLE001  it is there all the same, and the rest is still to be seen
                self._undrawn |= {name}
                self._recording.tell({"type": "trouble", "text": f"{name} cannot be drawn: {type(error).__name__}"})
        self._taken_up = tuple(there)

    def _tell_problem(self, snapshot: Snapshot) -> None:
        problem = replace(self._problem, obstacles=snapshot.obstacles)
        content = problem_content(problem, self._graph, self._view, tuple(snapshot.nearest))
        content["subtitle"] = f"{problem.robot.name}, driven live"
        for listed in content["obstacles"]:
            anchor = self._anchors.get(listed["name"])
            listed["anchor"] = None if anchor is None else [round(float(x), 4) for x in anchor]
            listed["velocity"], listed["appears_at"] = None, 0.0  # where it is, is told step by step
        self._recording.tell(content)

    def _content(self, snapshot: Snapshot) -> dict[str, Any]:
        state = snapshot.state
        anchors = {}
        for name, shift in snapshot.shifts.items():
            if shift is not None and name in self._anchors:
                anchors[name] = [round(float(x), 3) for x in self._anchors[name] + shift]
        speed = float(np.linalg.norm(state.tip_velocity))
        told = self._wording.next(state, asked=snapshot.asked)
        return {
            "type": "teleop",
            "time": round(state.time, 3),
            "status": state.status.value,
            "asked": snapshot.asked,
            "told": {"kind": told.kind, "word": told.word, "more": told.more},
            "pace": round(state.pace, 3),
            "margin": round(state.margin, 4) if math.isfinite(state.margin) else None,
            "link": state.link,
            "obstacle": state.obstacle,
            "tip": [round(float(x), 4) for x in state.tip_position],
            "speed": round(speed, 3),
            "force": round(float(np.linalg.norm(state.feedback_force)), 2),
            "largest_force": LARGEST_FORCE,
            "has_pitch": self._problem.robot.has_pitch,
            "zones": dict(snapshot.zones),
            "anchors": anchors,
            "shifts": {n: [round(float(x), 4) for x in s] for n, s in snapshot.shifts.items() if s is not None},
            "nodes": {n: self._graph.node_of(n) for n in sorted(snapshot.movable - self._undrawn)},
            "movable": sorted(snapshot.movable),
            "taken": list(snapshot.taken),
            "driver": snapshot.driver,
            "pages": list(snapshot.pages),
            "asking": list(snapshot.asking),
            "recording": snapshot.recording,
            "recorded": round(snapshot.recorded, 2),
            "circulate": snapshot.circulate,
            "failure": snapshot.failure,
        }

    # --- the force on the hand --------------------------------------------------------

    def _draw_arrow(self) -> None:
        shaft = trimesh.creation.cylinder(radius=0.03, height=0.72, sections=20)
        shaft.apply_translation([0.0, 0.0, 0.36])
        head = trimesh.creation.cone(radius=0.085, height=0.28, sections=28)
        head.apply_translation([0.0, 0.0, 0.72])
        arrow = self._tree["force"]
        arrow.set_object(mesh(facets(trimesh.util.concatenate([shaft, head])), _FORCE, lit=False, through=True))
        set_property(arrow, "castShadow", False)
        set_property(arrow, "renderOrder", 200)

    def _place_arrow(self, snapshot: Snapshot) -> None:
        force = snapshot.state.feedback_force
        size = float(np.linalg.norm(force))
        transform = np.eye(4)
        if size < _LEAST_SHOWN:
            transform[:3, :3] *= _HIDDEN
        else:
            turn = pin.Quaternion.FromTwoVectors(_UP, force / size).toRotationMatrix()
            length = _LONGEST_ARROW * (0.2 + 0.8 * size / LARGEST_FORCE)
            transform[:3, :3] = turn * length
            transform[:3, 3] = snapshot.state.tip_position
        self._tree["force"].set_transform(transform)
