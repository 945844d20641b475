"""Draws a session thirty times a second, and sends the page its figures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh

from backhoe_planner.motion import build_problem
from backhoe_planner.show.drawing.drawing import draw, mesh
from backhoe_planner.show.drawing.scene_graph import HIDDEN, UP, SceneGraph
from backhoe_planner.show.drawing.solids import facets
from backhoe_planner.show.page.display import Display
from backhoe_planner.show.page.page_content import tell_problem, tell_step
from backhoe_planner.show.teleop.session import LARGEST_FORCE, Session, Snapshot
from backhoe_planner.show.teleop.wording import Wording
from backhoe_planner.site import Obstacle

_FORCE = (0.72, 0.11, 0.48, 1.0)  # colour of the arrow: different from everything else in the picture
_LONGEST_ARROW = 1.2  # m, for the largest force; chosen, about the length of a bucket
_LEAST_SHOWN = 0.3  # N: a hundredth of the largest force
_POSTURES = 16  # random postures; the camera keeps the machine in view up to half-way to each of them; chosen
_PLAIN = (  # fields of a snapshot that the page gets unchanged
    "zones", "movable", "taken", "names", "driver", "asking", "recording", "recorded", "circulate", "failure", "waits",
)  # fmt: skip


class Picture:
    """The picture that the pages of a session show.

    An obstacle that cannot be drawn is left out of the picture, and the pages are told.

    Parameters
    ----------
    session: the session; its first snapshot is drawn at once.
    display: the display on which it is drawn.

    Attributes
    ----------
    warnings: what could not be drawn as the URDF specifies, in words.
    """

    def __init__(self, session: Session, display: Display) -> None:
        self._display = display
        self._tree = display.visualizer()
        self._problem = replace(build_problem(session.robot, session.scene), goals=(), path=None, keep=None)
        first = session.snapshot()
        self._graph = SceneGraph(self._tree, self._problem, q=first.state.q, each=True)
        self.warnings = self._graph.warnings
        rng = np.random.default_rng(0)
        around = [first.state.q + 0.5 * (session.robot.random_q(rng) - first.state.q) for _ in range(_POSTURES)]
        self._view = self._graph.look_at_postures([first.state.q, *around])
        self._known = tuple(obstacle.name for obstacle in self._problem.obstacles)
        self._undrawn: frozenset[str] = frozenset()
        self._wording = Wording()
        self._draw_arrow()
        self._tell_problem(first)
        self.show(first)

    def show(self, snapshot: Snapshot) -> None:
        """Bring the picture and its figures up to date."""
        names = tuple(obstacle.name for obstacle in snapshot.obstacles)
        if names != self._known:
            self._take_up(snapshot.obstacles)
            self._tell_problem(snapshot)
        state = snapshot.state
        self._graph.move(state.q)
        for name in set(names) - self._undrawn:
            self._graph.place(name, snapshot.shifts[name])
        for name in snapshot.nearest.keys() - self._undrawn:
            self._graph.point(name, snapshot.nearest[name])
        self._place_arrow(snapshot)
        tell_step(
            self._display, state.q, time=state.time, nearest=tuple(snapshot.nearest.values()),
            links=self._problem.robot.link_names,
        )  # fmt: skip
        self._display.tell("teleop", self._content(snapshot))

    def _take_up(self, obstacles: tuple[Obstacle, ...]) -> None:
        """Draw new obstacles, and remove those that are gone."""
        there = {obstacle.name: obstacle for obstacle in obstacles}
        drawn = set(self._known) - self._undrawn
        for name in drawn - there.keys():
            self._graph.remove(name)
        self._undrawn &= there.keys()
        for name in [name for name in there if name not in drawn and name not in self._undrawn]:
            try:
                self._graph.add(there[name])
            except Exception as error:  # noqa: BLE001  the obstacle is there all the same, and the rest can be drawn
                self._undrawn |= {name}
                self._display.tell("trouble", {"text": f"{name} cannot be drawn: {type(error).__name__}"})
        self._known = tuple(there)

    def _tell_problem(self, snapshot: Snapshot) -> None:
        # the position of an obstacle is sent with every step
        still = tuple(replace(o, velocity=np.zeros(3), appears_at=0.0) for o in snapshot.obstacles)
        problem = replace(self._problem, obstacles=still)
        tell_problem(self._display, problem, self._graph, self._view, tuple(snapshot.nearest), task="driven live")

    def _content(self, snapshot: Snapshot) -> dict[str, Any]:
        state, anchors = snapshot.state, self._graph.anchors
        shifts = {name: shift for name, shift in snapshot.shifts.items() if shift is not None}
        return {name: getattr(snapshot, name) for name in _PLAIN} | {
            "time": state.time,
            "caption": self._wording.next(state, has_wish=snapshot.has_wish, waits=snapshot.waits)._asdict(),
            "pace": state.pace,
            "tip": state.tip_position,
            "speed": np.linalg.norm(state.tip_velocity),
            "force": np.linalg.norm(state.feedback_force),
            "largest_force": LARGEST_FORCE,
            "has_pitch": self._problem.robot.has_pitch,
            "anchors": {name: anchors[name] + shift for name, shift in shifts.items() if name in anchors},
            "shifts": shifts,
            "absent": [name for name, shift in snapshot.shifts.items() if shift is None],
            "nodes": {name: self._graph.node_of(name) for name in sorted(snapshot.movable - self._undrawn)},
        }

    # --- the force on the hand --------------------------------------------------------

    def _draw_arrow(self) -> None:
        shaft = trimesh.creation.cylinder(radius=0.03, height=0.72, sections=20)
        shaft.apply_translation([0.0, 0.0, 0.36])
        head = trimesh.creation.cone(radius=0.085, height=0.28, sections=28)
        head.apply_translation([0.0, 0.0, 0.72])
        arrow = mesh(facets(trimesh.util.concatenate([shaft, head])), _FORCE, lit=False, through=True)
        draw(self._tree["force"], arrow, shadow=False, order=200)

    def _place_arrow(self, snapshot: Snapshot) -> None:
        force = snapshot.state.feedback_force
        size = float(np.linalg.norm(force))
        transform = np.eye(4)
        if size < _LEAST_SHOWN:
            transform[:3, :3] *= HIDDEN
        else:
            turn = pin.Quaternion.FromTwoVectors(UP, force / size).toRotationMatrix()
            length = _LONGEST_ARROW * (0.2 + 0.8 * size / LARGEST_FORCE)
            transform[:3, :3] = turn * length
            transform[:3, 3] = snapshot.state.tip_position
        self._tree["force"].set_transform(transform)
