"""Machine, site and task as a tree of named nodes in a meshcat viewer.

    machine/<link>              one node per link, moved by one transform
    carried/<load>              what is carried, visible only while it is
    site/<obstacle>
    site/far away               all obstacles out of reach, if they are many
    clearance/<obstacle>        the surface at its clearance, hidden at first
    task/path, task/goal, task/trace
    kept/axis, kept/cone        an axis of the tip that is kept, moved by one transform, and where it may point
    critical points/<obstacle>  a rod from the link to the obstacle, where they are nearest
    ground

Names are those of the URDF and of the scene file.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import Kinematics, TipTarget, tip_travel_bound
from backhoe_planner.motion import Problem
from backhoe_planner.show.drawing.drawing import (
    PlanAnimation,
    Track,
    draw,
    mesh,
    node_name,
    node_names,
    set_camera,
    set_property,
    set_stage,
)
from backhoe_planner.show.drawing.framing import View, blocks, frame, hills, part_behind
from backhoe_planner.show.drawing.ground import draw_ground, opening_of
from backhoe_planner.show.drawing.kept_axes import kept_axes
from backhoe_planner.show.drawing.loads import load_meshes
from backhoe_planner.show.drawing.machine_meshes import machine_meshes
from backhoe_planner.show.drawing.palette import FAR, GOAL, KEPT, LOAD, PASSED_BY, PATH, TRACE, Rgb, Rgba, margin_rgb
from backhoe_planner.show.drawing.site_meshes import SiteMesh, drawn_as_one, is_ground, mesh_of_many, site_mesh
from backhoe_planner.show.drawing.solids import facets, tube
from backhoe_planner.show.drawing.timeline import ITSELF, CriticalPoint, Timeline
from backhoe_planner.site import Obstacle, offset_at

UP = np.array([0.0, 0.0, 1.0])
HIDDEN = 1e-5  # scale of hidden nodes: too small to be seen; a scale of 0 would have no inverse
_GROUPS = ("machine", "carried", "site", "clearance", "task", "kept", "critical points", "ground")
_LINE_WIDTH = 0.0011  # radius of path and trace, as part of the distance to the camera; chosen, a few pixels
_NOWHERE = np.zeros((4, 4))
_HIDDEN_ROD = np.diag([HIDDEN, HIDDEN, HIDDEN, 1.0])
_FAR_AWAY = "far away"
# part of the tip's reach, and m at most, that is as good as level with the ground; chosen: the top of a table before an
# arm is not
_SHALLOW, _MOST_SHALLOW = 0.01, 0.05
_LOW_GROUND = 0.5  # m above the machine's lowest point up to which ground hides nothing; chosen
_ROWS_IN_VIEW = 24  # frames of a motion that the camera keeps in view; chosen


class SceneGraph:
    """Draws one problem, and moves what it drew.

    Parameters
    ----------
    visualizer: a ``meshcat.Visualizer``. Only this node's children and meshcat's own sky, lights
        and camera are changed.
    problem: machine, site and task.
    q: (n,) the posture that is drawn first [rad or m]; by default the start, or the middle of the joint ranges.
    apart: names of obstacles that the caller draws; points on them are still shown.
    opening: (k, 2) convex outline of what the caller draws, counterclockwise [m]: no level ground is drawn inside it.
    each: whether each obstacle has a node of its own, so that it can be moved; otherwise many that are out of reach are
        one node, without labels and clearance shells.

    Attributes
    ----------
    warnings: what could not be drawn as the URDF specifies, in words.
    problem: the problem that is drawn.
    anchors: (3,) position of the label of each obstacle [m], world.
    drawn_as_one: names of the obstacles that are drawn as one: they are out of reach, and many.
    has_ground: whether level ground is drawn, because no obstacle is the ground.
    has_kept_axis: whether an axis that a `tilt` of `keep` keeps is drawn.
    """

    def __init__(
        self, visualizer: Any, problem: Problem, *, q: Vector | None = None, apart: Collection[str] = (),
        opening: Matrix | None = None, each: bool = False,
    ) -> None:  # fmt: skip
        self._tree = visualizer
        self.problem = problem
        robot = problem.robot
        self._data = robot.model.createData()
        self._tip = robot.model.frames[robot.tip_frame]
        self._reach = _tip_reach(problem)
        meshes, self.warnings = machine_meshes(robot)
        self._joint_of = {drawn.link: drawn.joint for drawn in meshes}
        self._links = node_names(self._joint_of)
        self._loads = load_meshes(problem)
        self._load_nodes: list[str] = []
        for load in self._loads:  # two legs may carry different things of the same name
            again = sum(load.name == other.name for other in self._loads[: len(self._load_nodes)])
            self._load_nodes.append(node_name(f"{load.name} ({again + 1})" if again else load.name))
        self._obstacles = node_names([*(obstacle.name for obstacle in problem.obstacles), ITSELF])
        self._prefix = visualizer.path.lower().rstrip("/")
        rest = problem.start_q if q is None else q
        posture = np.array(robot.middle if rest is None else rest)
        self._meshes = meshes
        self._machine_points = self._machine_corners([posture])
        centre = np.array([*(0.5 * (self._machine_points.min(axis=0) + self._machine_points.max(axis=0)))[:2], 0.0])
        # a plane is drawn up to this radius
        self._radius = 1.35 * max(self._reach, float(np.linalg.norm(self._machine_points - centre, axis=1).max()))
        given = [obstacle for obstacle in problem.obstacles if obstacle.name not in apart]
        self._far = () if each else drawn_as_one(given, centre=centre, reach=self._radius)
        self.drawn_as_one = frozenset(obstacle.name for obstacle in self._far)
        self._drawn = tuple(obstacle for obstacle in given if obstacle.name not in self.drawn_as_one)
        self._opening = opening
        self.has_ground = not any(is_ground(obstacle) for obstacle in self._drawn)
        self._site = tuple(
            site_mesh(obstacle, problem.scene, centre=centre, reach=self._radius, among=len(self._drawn))
            for obstacle in self._drawn
        )
        self.anchors = {drawn.name: drawn.anchor for drawn in self._site}
        away = self.view()
        # sizes that look right if everything is in view
        self._width = _LINE_WIDTH * float(np.linalg.norm(away.eye() - away.target))
        self._scale = self._width / 0.02
        for group in _GROUPS:
            visualizer[group].delete()
        self._rods: set[str] = set()
        self._shown_colour: dict[str, tuple[float, ...]] = {}
        self._placed: dict[tuple[str, str], Matrix] = {}
        self._draw_stage(centre, away)
        self._draw_machine()
        self._draw_site(centre)
        self._draw_task()
        self._draw_kept()
        self.move(posture, leg=problem.legs[0].name if problem.legs else None)

    # --- what does not move ---------------------------------------------------------

    def _draw_stage(self, centre: Vector, view: View) -> None:
        set_stage(self._tree, reach=1.2 * self._radius)
        if self.has_ground:
            opening, buried = self._below_ground()
            draw_ground(
                self._tree["ground"], centre=centre[:2], radius=1.9 * self._radius,
                opacity=0.5 if buried else 0.95, opening=opening,
            )  # fmt: skip
        set_camera(self._tree, view)

    def _below_ground(self) -> tuple[Matrix | None, bool]:
        """Outline (k, 2) of the obstacles that are the ground, and whether anything else is beneath it."""
        if self._opening is not None:
            return self._opening, False
        outlines, lows, shallow = [], [], min(_SHALLOW * self._reach, _MOST_SHALLOW)
        for obstacle, drawn in zip(self._drawn, self._site, strict=True):
            if drawn.bounds is None:
                continue
            low, top = drawn.bounds[:, 2]
            scanned = obstacle.spec.shape == "pointcloud" and low < -shallow and top >= 0.0  # includes the ground
            if abs(top) <= shallow or scanned:  # its top is level with the ground, or it is the ground itself
                outlines.append(drawn.facets.vertices[:, :2])
            elif top < 0.0:
                lows.append(drawn)
        points = [goal.target.position for goal in self.problem.goals]
        points += [] if self.problem.path is None else list(self.problem.path.points)
        if not outlines:
            return None, bool(lows) or any(point[2] < -shallow for point in points)
        opening = opening_of(np.vstack(outlines))
        low, high = opening.min(axis=0), opening.max(axis=0)

        def beside(corners: Matrix) -> bool:
            return bool(np.any(corners[:, :2] < low - 0.01) or np.any(corners[:, :2] > high + 0.01))

        buried = any(beside(drawn.bounds) for drawn in lows if drawn.bounds is not None)
        return opening, buried or any(point[2] < -shallow and beside(point[None, :]) for point in points)

    def _draw_machine(self) -> None:
        number: dict[str, int] = {}
        for drawn in self._meshes:
            part = number.setdefault(drawn.link, 0)
            number[drawn.link] += 1
            node = self._tree["machine"][self._links[drawn.link]][f"{part}"]
            draw(node, mesh(drawn.facets, drawn.rgba), shadow=drawn.rgba[3] == 1.0)
        for name, load in zip(self._load_nodes, self._loads, strict=True):
            draw(self._tree["carried"][name], mesh(load.facets, (*LOAD, 1.0)))

    def _draw_site(self, centre: Vector) -> None:
        for order, (obstacle, drawn) in enumerate(zip(self._drawn, self._site, strict=True)):
            node = self._obstacles[drawn.name]
            if drawn.bounds is None and is_ground(obstacle) and drawn.facets.normals[0, 2] > 0.999:
                draw_ground(
                    self._tree["site"][node], centre=centre[:2], radius=1.9 * self._radius,
                    height=float(drawn.facets.vertices[0, 2]), opacity=drawn.rgba[3], colour=drawn.rgba[:3],
                )  # fmt: skip
                continue
            self._draw_solid(node, drawn, order=order)
        if self._far:
            node = self._free_node(_FAR_AWAY)
            draw(self._tree["site"][node], mesh(mesh_of_many(self._far), (1.0, 1.0, 1.0, 1.0)), shadow=False)
        self._tree["clearance"].set_property("visible", False)

    def _draw_solid(self, name: str, drawn: SiteMesh, *, order: int) -> None:
        """One obstacle and its clearance shell."""
        lit = drawn.bounds is not None or drawn.rgba[3] > 0.5
        solid = mesh(drawn.facets, drawn.rgba, lit=lit, one_sided=drawn.one_sided)
        draw(self._tree["site"][name], solid, shadow=drawn.rgba[3] == 1.0)
        if drawn.shell is None:
            return
        shell = mesh(drawn.shell, drawn.shell_rgba, lit=False, one_sided=drawn.bounds is not None)
        draw(self._tree["clearance"][name], shell, shadow=False, order=2 + order)
        set_property(self._tree["clearance"][name], "receiveShadow", False)

    def _draw_task(self) -> None:
        problem, task = self.problem, self._tree["task"]
        if problem.path is not None:
            width = 1.4 * self._width  # the trace is drawn on the path
            _draw_line(task["path"], problem.path.points, width, (*PATH, 1.0))
            marks = [
                trimesh.creation.icosphere(subdivisions=2, radius=1.8 * width).apply_translation(point)
                for point in problem.path.points
            ]
            task["path"]["waypoints"].set_object(mesh(facets(trimesh.util.concatenate(marks)), (*PATH, 1.0), lit=False))
        for goal in problem.goals:
            self._draw_goal(task[goal.name], goal.target)

    def _draw_kept(self) -> None:
        self._kept = kept_axes(self.problem, self._scale)
        self.has_kept_axis = bool(self._kept)
        for number, kept in enumerate(self._kept):
            node = self._tree["kept"][f"axis {number}"]
            draw(node, mesh(kept.arrow, (*KEPT, 1.0), lit=False), shadow=False)
            draw(node["behind"], mesh(kept.arrow, (*KEPT, 0.4), lit=False, through=True), shadow=False, order=100)
            if kept.cone is not None:
                cone = mesh(kept.cone, (*KEPT, 0.22), lit=False, through=True)
                draw(self._tree["kept"][f"cone {number}"], cone, shadow=False, order=99)

    def mark_goal(self, reached: int) -> None:
        """Draw all goals except number `reached`, counted from 1, in the colour of goals that do not count."""
        for number, goal in enumerate(self.problem.goals, start=1):
            if number != reached:
                self._draw_goal(self._tree["task"][goal.name], goal.target, colour=PASSED_BY)

    def _draw_goal(self, node: Any, goal: TipTarget, *, colour: Rgb = GOAL) -> None:
        """A ball at the tip's position, with a triad for its orientation or a fan for its pitch."""
        ball = trimesh.creation.icosphere(subdivisions=3, radius=0.085 * self._scale)
        ball.apply_translation(goal.position)
        node.set_object(mesh(facets(ball), (*colour, 1.0)))
        if goal.rotation is not None:
            self._draw_triad(node, goal.rotation, goal.position)
        elif goal.pitch is not None:
            fan = _pitch_fan(self.problem, goal.position, goal.pitch, 0.55 * self._scale)
            draw(node["pitch"], mesh(facets(fan), (*colour, 0.4), lit=False), shadow=False)

    def _draw_triad(self, node: Any, rotation: Matrix, position: Vector) -> None:
        length = 0.3 * self._scale
        for axis, rgba in enumerate(((0.85, 0.2, 0.2, 1.0), (0.2, 0.65, 0.25, 1.0), (0.2, 0.4, 0.9, 1.0))):
            end = position + length * rotation[:, axis]
            _draw_line(node["xyz"[axis]], np.array([position, end]), 0.05 * length, rgba)

    def _draw_rod(self, name: str) -> None:
        """A rod of length 1 for the critical point to an obstacle, drawn when there is one for the first time."""
        if name in self._rods:
            return
        self._rods.add(name)
        rod = trimesh.creation.cylinder(radius=0.022 * self._scale, height=1.0, sections=12)
        rod.apply_translation([0.0, 0.0, 0.5])
        node = self._tree["critical points"][self._obstacles[name]]
        draw(node, mesh(facets(rod), (*FAR, 1.0), lit=False), shadow=False)
        self._place("critical points", self._obstacles[name], _HIDDEN_ROD)

    # --- camera -----------------------------------------------------------------------

    def view(self, points: Matrix | None = None) -> View:
        """The view of the site and of all `points` (k, 3) [m], world; by default the points of the machine."""
        seen = [self._machine_points if points is None else points]
        middle = self._machine_points.mean(axis=0)
        side = 0.0
        ceiling = None
        for obstacle, drawn in zip(self._drawn, self._site, strict=True):
            if drawn.bounds is None:
                normal = drawn.facets.normals[0]
                if normal[2] < -0.7 and drawn.anchor[2] < 2.0 * self._reach:
                    ceiling = float(drawn.anchor[2])
                    seen.append(drawn.anchor[None, :])
                if abs(normal[1]) > 0.5:  # a wall: look from in front of it
                    side -= 1e3 * float(normal[1])
                continue
            if is_ground(obstacle):
                continue
            # of a very large obstacle, only the near part
            low = np.clip(drawn.bounds[0], middle - self._radius, middle + self._radius)
            high = np.clip(drawn.bounds[1], middle - self._radius, middle + self._radius)
            corners = _box_corners(low, high)
            seen.append(corners)
            above = np.maximum(corners[:, 2].max(), 0.0) - np.maximum(corners[:, 2].min(), 0.0)
            side += float(corners[:, 1].mean() * above * np.prod(np.sqrt(np.ptp(corners[:, :2], axis=0) + 1e-9)))
        seen += [goal.target.position[None, :] for goal in self.problem.goals]
        if self.problem.path is not None:
            seen.append(self.problem.path.points)
        # large and tall obstacles belong behind the machine
        return frame(
            np.vstack(seen), side=-1.0 if side >= 0.0 else 1.0, ceiling=ceiling,
            hidden=partial(part_behind, self._opaque_boxes(), seen[0]),
        )  # fmt: skip

    def _opaque_boxes(self) -> Array:
        """(B, 2, 3) lowest and highest corners of the boxes that hide the machine from view [m], world."""
        boxes = []
        above = float(self._machine_points[:, 2].min()) + _LOW_GROUND
        for obstacle, drawn in zip(self._drawn, self._site, strict=True):
            if drawn.bounds is None or drawn.rgba[3] < 1.0:
                continue
            if is_ground(obstacle):
                boxes.append(hills(drawn.facets.vertices, above=above))
            elif obstacle.spec.shape == "pointcloud":  # it may be all around the machine
                boxes.append(blocks(drawn.facets.vertices, above=above))
            else:
                boxes.append(drawn.bounds[None])
        return np.concatenate([np.zeros((0, 2, 3)), *boxes])

    def look(self, points: Matrix) -> View:
        """Point the camera so that the site and all `points` (k, 3) are in view [m], world."""
        view = self.view(points)
        set_camera(self._tree, view)
        return view

    def look_at_motion(self, timeline: Timeline) -> View:
        """Point the camera so that the whole motion is in view."""
        rows = np.unique(np.linspace(0, len(timeline.time) - 1, _ROWS_IN_VIEW).astype(int))
        return self.look(np.vstack((self._machine_corners(timeline.q[rows]), timeline.tip)))

    def look_at_postures(self, postures: Sequence[Vector]) -> View:
        """Point the camera so that the machine is in view in all `postures` (n,)."""
        return self.look(self._machine_corners(postures))

    def _machine_corners(self, postures: Iterable[Vector]) -> Matrix:
        """(k, 3) corners of the boxes around every drawn part, in all `postures` (n,) [m], world."""
        parts = [(drawn.joint, drawn.facets.vertices) for drawn in self._meshes]
        parts += [(load.joint, load.facets.vertices) for load in self._loads]
        boxes = [(joint, _box_corners(points.min(axis=0), points.max(axis=0))) for joint, points in parts]
        found = []
        for q in postures:
            pin.forwardKinematics(self.problem.robot.model, self._data, q)
            for joint, corners in boxes:
                placement = self._data.oMi[joint]
                found.append(corners @ placement.rotation.T + placement.translation)
        return np.vstack(found)

    # --- what moves -------------------------------------------------------------------

    def move(
        self, q: Vector, *, time: float = 0.0, nearest: Sequence[CriticalPoint | None] = (), leg: str | None = None
    ) -> None:
        """Show the machine at `q` (n,) and the site at `time` [s].

        Parameters
        ----------
        nearest: critical points to be shown, in the order of the obstacles.
        leg: the leg of a sequence whose load is shown; None for no load.
        """
        pin.forwardKinematics(self.problem.robot.model, self._data, q)
        for link, joint in self._joint_of.items():
            self._place("machine", self._links[link], self._data.oMi[joint].homogeneous)
        for name, load in zip(self._load_nodes, self._loads, strict=True):
            transform = self._data.oMi[load.joint].homogeneous
            transform[:3, :3] *= 1.0 if leg in load.legs else HIDDEN
            self._place("carried", name, transform)
        tip = self._data.oMi[self._tip.parentJoint] * self._tip.placement
        for number, kept in enumerate(self._kept):
            size = 1.0 if kept.legs is None or leg in kept.legs else HIDDEN
            axis = self._data.oMi[kept.joint].homogeneous
            axis[:3, :3] *= size
            cone = np.diag([size, size, size, 1.0])
            cone[:3, 3] = tip.translation
            self._place("kept", f"axis {number}", axis)
            self._place("kept", f"cone {number}", cone)
        for obstacle in self.problem.obstacles:
            if obstacle.is_dynamic:
                self.place(obstacle.name, None if time < obstacle.appears_at else offset_at(obstacle, time))
        for name, point in zip(self._obstacles, nearest, strict=False):
            self.point(name, point)

    def add(self, obstacle: Obstacle) -> None:
        """Draw a new obstacle."""
        drawn = site_mesh(obstacle, self.problem.scene, centre=np.zeros(3), reach=self._radius)
        node = self._free_node(node_name(obstacle.name))
        self._obstacles[obstacle.name] = node
        self._draw_solid(node, drawn, order=len(self._obstacles))
        self.anchors[obstacle.name] = drawn.anchor

    def _free_node(self, node: str) -> str:
        """A name of a node that no obstacle has: `node`, or one like it."""
        while node in self._obstacles.values():
            node += "_"
        return node

    def remove(self, name: str) -> None:
        """Remove an obstacle from the picture."""
        node = self._obstacles.pop(name)
        del self.anchors[name]
        self._rods.discard(name)
        self._shown_colour.pop(name, None)
        for group in ("site", "clearance", "critical points"):
            self._tree[group][node].delete()
            self._placed.pop((group, node), None)

    def place(self, name: str, shift: Vector | None) -> None:
        """Show an obstacle at `shift` (3,) from where it was drawn [m]; None hides it."""
        transform = np.eye(4)
        if shift is None:
            transform[:3, :3] *= HIDDEN
        else:
            transform[:3, 3] = shift
        for group in ("site", "clearance"):
            self._place(group, self._obstacles[name], transform)

    @property
    def loads(self) -> tuple[dict[str, Any], ...]:
        """Name, node path and label position of everything that is carried in some leg."""
        return tuple(
            {"name": load.name, "node": ("carried", node), "anchor": load.anchor}
            for node, load in zip(self._load_nodes, self._loads, strict=True)
        )

    @property
    def prefix(self) -> str:
        """The path above its nodes in the viewer's tree, for the tracks of an animation."""
        return str(self._prefix)

    def node_of_link(self, name: str) -> str:
        """The name of a link's node in the viewer's tree, below ``machine``."""
        return self._links[name]

    def node_of(self, name: str) -> str:
        """The name of an obstacle's node in the viewer's tree, below ``site``."""
        return self._obstacles[name]

    def _place(self, group: str, node: str, transform: Matrix) -> None:
        """Set a node's transform, unless the node already has it."""
        key = (group, node)
        if not np.array_equal(self._placed.get(key, _NOWHERE), transform):
            self._placed[key] = transform
            self._tree[group][node].set_transform(transform)

    def point(self, name: str, nearest: CriticalPoint | None) -> None:
        """Show the critical point to an obstacle, or to the machine itself; None hides it."""
        if nearest is not None and nearest.margin <= self.problem.scene.influence:
            self._draw_rod(name)
        elif name not in self._rods:
            return
        position, quaternion, scale = self._rod(nearest)
        x, y, z, w = quaternion
        transform = np.eye(4)
        transform[:3, :3] = pin.Quaternion(w, x, y, z).toRotationMatrix() * scale
        transform[:3, 3] = position
        self._place("critical points", self._obstacles[name], transform)
        if nearest is None or scale[2] == HIDDEN:
            return
        colour = tuple(round(part, 1) for part in margin_rgb(nearest.margin, self.problem.scene.influence))
        if self._shown_colour.get(name) != colour:
            self._shown_colour[name] = colour
            self._tree["critical points"][self._obstacles[name]].set_property("color", [*colour, 1.0])

    def _rod(self, nearest: CriticalPoint | None) -> tuple[Vector, Vector, Vector]:
        """Position, quaternion (x, y, z, w) and scale that put the unit rod between two points."""
        if nearest is None or nearest.margin > self.problem.scene.influence:
            return np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.full(3, HIDDEN)
        along = nearest.point_obstacle - nearest.point_link
        length = max(float(np.linalg.norm(along)), 1e-4)
        turn = pin.Quaternion.FromTwoVectors(UP, along / length if length > 1e-4 else UP)
        return nearest.point_link, np.array(turn.coeffs()), np.array([1.0, 1.0, length])

    def draw_trace(self, tips: Matrix) -> None:
        """Draw the path of the tip through (T, 3) points [m], world."""
        _draw_line(self._tree["task"]["trace"], tips, 0.75 * self._width, (*TRACE, 1.0))

    def animation(self, timeline: Timeline) -> PlanAnimation:
        """Everything that moves in `timeline`: one track per link, obstacle and critical point."""
        time = timeline.time - timeline.time[0]
        tracks: list[Track] = []
        for link, joint in self._joint_of.items():
            if joint > 0:
                path = f"{self._prefix}/machine/{self._links[link]}"
                tracks.append(Track(path, "position", time, timeline.poses[:, joint, :3]))
                tracks.append(Track(path, "quaternion", time, timeline.poses[:, joint, 3:]))
        for name, load in zip(self._load_nodes, self._loads, strict=True):
            path = f"{self._prefix}/carried/{name}"
            carried = load.carried_in(timeline.legs or ("",) * len(time))  # a motion that begins no leg carries nothing
            size = np.where(carried, 1.0, HIDDEN)
            tracks.append(Track(path, "position", time, timeline.poses[:, load.joint, :3]))
            tracks.append(Track(path, "quaternion", time, timeline.poses[:, load.joint, 3:]))
            tracks.append(Track(path, "scale", time, np.repeat(size[:, None], 3, axis=1)))
        for number, kept in enumerate(self._kept):
            size = np.where(kept.kept_in(timeline.legs or ("",) * len(time)), 1.0, HIDDEN)
            moved = timeline.poses[:, kept.joint]
            for node, place in ((f"axis {number}", moved[:, :3]), (f"cone {number}", timeline.tip)):
                path = f"{self._prefix}/kept/{node}"
                tracks.append(Track(path, "position", time, place))
                tracks.append(Track(path, "scale", time, np.repeat(size[:, None], 3, axis=1)))
            tracks.append(Track(f"{self._prefix}/kept/axis {number}", "quaternion", time, moved[:, 3:]))
        for obstacle in self.problem.obstacles:
            legs = obstacle.spec.legs
            there = np.array([legs is None or leg in legs for leg in timeline.legs] or [True] * len(timeline.time))
            if obstacle.is_dynamic or not there.all():
                offset = np.array([offset_at(obstacle, moment) for moment in timeline.time])
                size = np.where((timeline.time < obstacle.appears_at) | ~there, HIDDEN, 1.0)
                for group in ("site", "clearance"):
                    path = f"{self._prefix}/{group}/{self._obstacles[obstacle.name]}"
                    tracks.append(Track(path, "position", time, offset))
                    tracks.append(Track(path, "scale", time, np.repeat(size[:, None], 3, axis=1)))
        influence = self.problem.scene.influence
        for index, name in enumerate(timeline.obstacles):
            points = [row[index] for row in timeline.nearest]
            if all(point is None or point.margin > influence for point in points):
                continue
            self._draw_rod(name)
            path = f"{self._prefix}/critical points/{self._obstacles[name]}"
            rods = [self._rod(point) for point in points]
            colours = np.array([FAR if point is None else margin_rgb(point.margin, influence) for point in points])
            for column, kind in enumerate(("position", "quaternion", "scale")):
                tracks.append(Track(path, kind, time, np.array([rod[column] for rod in rods])))
            tracks.append(Track(f"{path}/<object>", "material.color", time, colours))
        return PlanAnimation(tracks, float(time[-1]))


def _box_corners(low: Vector, high: Vector) -> Matrix:
    """(8, 3) corners of the box from `low` to `high`."""
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def _draw_line(node: Any, points: Matrix, radius: float, rgba: Rgba) -> None:
    """A line as a tube; faint where something is in front of it."""
    drawn = facets(tube(points, radius, tolerance=0.25 * radius))
    node.set_object(mesh(drawn, rgba, lit=False))
    draw(node["behind"], mesh(drawn, (*rgba[:3], 0.4), lit=False, through=True), shadow=False, order=100)


def _tip_reach(problem: Problem) -> float:
    """The approximate reach of the tip from the first joint [m]."""
    robot = problem.robot
    bound = tip_travel_bound(robot)
    turning = bound[~robot.prismatic]
    slide = np.sum((robot.limits.upper - robot.limits.lower)[robot.prismatic])
    return float(max(turning.max(initial=0.0), slide, 0.1))


def _pitch_fan(problem: Problem, tip: Vector, pitch: tuple[float, float], radius: float) -> trimesh.Trimesh:
    """A sector behind the tip (3,), in the arm's plane, from the lowest to the highest allowed pitch [rad]."""
    centre = Kinematics(problem.robot).at(problem.robot.middle).points[0]
    heading = np.arctan2(tip[1] - centre[1], tip[0] - centre[0])
    low, high = pitch if pitch[1] - pitch[0] > 0.04 else (sum(pitch) / 2.0 - 0.02, sum(pitch) / 2.0 + 0.02)
    angles = np.linspace(low, high, 24)
    rim = np.column_stack((np.cos(angles) * np.cos(heading), np.cos(angles) * np.sin(heading), np.sin(angles)))
    index = np.arange(1, len(angles))
    faces = np.column_stack((np.zeros_like(index), index, index + 1))
    return trimesh.Trimesh(np.vstack((tip, tip - radius * rim)), faces, process=False)
