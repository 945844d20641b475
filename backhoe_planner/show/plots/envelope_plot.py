"""A figure of the tip's reach, with the machine."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.ndimage import binary_closing, gaussian_filter

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Envelope, Kinematics, Robot, reachable_points, working_envelope
from backhoe_planner.show.drawing.machine_meshes import machine_meshes
from backhoe_planner.show.drawing.palette import Rgba
from backhoe_planner.show.drawing.solids import solid
from backhoe_planner.show.plots.figure_file import dress, new_figure, plain_text, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_SAMPLES = 300_000  # postures; chosen, several for each cell
_CELLS = 220  # along the longer side; chosen, a cell is about a line wide
_BEYOND = 0.08  # part of a joint's range by which samples exceed its ends and are clipped: the ends form the rim
_REGION, _RIM = "#cfe0f3", "#2b6cb0"
_STEEL: Rgba = (0.55, 0.58, 0.62, 1.0)
_LIGHT = np.array([0.2, -0.8, 0.57])  # direction of the light, from behind the reader's shoulder
_MOST_TRIANGLES = 30_000  # chosen: if a machine has more, its parts are drawn as their hulls
_STILL = 1e-6  # m; chosen: a tip that moves less in the plane of the arm stands still there
_UPRIGHT = 0.99  # least absolute z of an axis that counts as vertical; chosen, 8 degrees
_INK, _EARTH = "#1d2731", "#8a6a4a"


def plot_envelope(robot: Robot, path: str | os.PathLike[str]) -> None:
    """Write a figure of the tip's reach; `path` and errors as for `plot_plan`.

    For a machine that works in an upright plane, it shows that plane, with the machine from the side and the figures of
    its data sheet. For any other machine, it shows the reach from above and from the side.
    """
    figure = new_figure(path, 9.5, 7.2, inputs=robot.files)
    envelope = working_envelope(robot)
    points = None if envelope is None else _in_plane(robot)
    if envelope is not None and points is not None:
        _draw_plane(figure.subplots(), robot, envelope, points)
    else:
        tips = reachable_points(robot)
        flat = float(np.ptp(tips[:, 2])) < _STILL  # a level arm is shown only from above
        views = (("from above", 0, 1),) if flat else (("from above", 0, 1), ("from the side", 0, 2))
        figure.set_size_inches(1.0 + 5.0 * len(views), 5.6)
        for view, (title, a, b) in zip(figure.subplots(1, len(views), squeeze=False)[0], views, strict=True):
            view.scatter(tips[:, a], tips[:, b], s=2.5, color=_RIM, alpha=0.22, linewidths=0.0, rasterized=True)
            _draw_machine(view, robot, a, b)
            view.set_xlabel("x [m]")
            view.set_ylabel(f"{'xyz'[b]} [m]")
            view.set_title(title, fontsize=10, loc="left")
            _finish(view)
    save_figure(figure, path, f"{plain_text(robot.name)}: where {plain_text(robot.tip)} can get")


def _in_plane(robot: Robot) -> Matrix | None:
    """(k, 2) radius and height of the tip in the plane of the arm [m]; None with slides, or if it only swings.

    All axes of the plane are parallel, so the tip is the sum of the links, each rotated by the sum of the angles up to
    it.
    """
    kinematics = Kinematics(robot)
    rest = _rest(robot)
    at = kinematics.at(rest)
    first = 1 if abs(at.J_world[5, 0]) > _UPRIGHT else 0
    if np.any(robot.prismatic[first:]):
        return None
    axis = at.J_world[3:, -1]
    forward = np.cross(axis, [0.0, 0.0, 1.0])
    forward *= np.sign(forward[0] or 1.0)
    turning = np.sign(np.cross(forward, [0.0, 0.0, 1.0]) @ at.J_world[3:, first:]) * -1.0
    flat = np.column_stack((at.points @ forward, at.points[:, 2]))
    links = np.diff(flat[first:], axis=0)
    limits = robot.limits
    finite = np.isfinite(limits.lower) & np.isfinite(limits.upper)
    lower = np.where(finite, limits.lower, -np.pi)[first:]
    upper = np.where(finite, limits.upper, np.pi)[first:]
    rng = np.random.default_rng(0)
    part = rng.uniform(-_BEYOND, 1.0 + _BEYOND, size=(_SAMPLES, len(lower))).clip(0.0, 1.0)
    angle = np.cumsum(turning * (lower + part * (upper - lower) - rest[first:]), axis=1)
    cosine, sine = np.cos(angle), np.sin(angle)
    radius = flat[first, 0] + cosine @ links[:, 0] - sine @ links[:, 1]
    height = flat[first, 1] + sine @ links[:, 0] + cosine @ links[:, 1]
    points = np.column_stack((radius, height))
    return points if float(np.ptp(points, axis=0).max()) > _STILL else None


def _rest(robot: Robot) -> Vector:
    """(n,) the posture in which the machine is drawn: swing straight, the rest in mid-range."""
    rest = np.array(robot.middle)
    if abs(Kinematics(robot).at(rest).J_world[5, 0]) > _UPRIGHT:
        rest[0] = np.clip(0.0, robot.limits.lower[0], robot.limits.upper[0])
    return rest


def _draw_plane(axes: Axes, robot: Robot, envelope: Envelope, points: Matrix) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    cell = float((high - low).max()) / _CELLS
    pad = 6
    shape = np.ceil((high - low) / cell).astype(int) + 2 * pad
    column, row = (((points - low) / cell).astype(int) + pad).T
    hit = np.zeros((shape[1], shape[0]))
    hit[row, column] = 1.0
    region = gaussian_filter(binary_closing(hit, iterations=3).astype(float), 1.8)
    x = low[0] + cell * (np.arange(shape[0]) - pad + 0.5)
    z = low[1] + cell * (np.arange(shape[1]) - pad + 0.5)
    axes.contourf(x, z, region, levels=[0.5, 2.0], colors=[_REGION])
    axes.contour(x, z, region, levels=[0.5], colors=[_RIM], linewidths=1.3)
    _draw_machine(axes, robot, 0, 2)
    axes.axhline(0.0, color=_EARTH, linewidth=1.4, zorder=1.5)
    foot = float(Kinematics(robot).at(_rest(robot)).points[0][0])
    _figures(axes, envelope, foot, float(high[0]))
    axes.set_xlabel("x [m], from the machine outward")
    axes.set_ylabel("z [m], ground at 0")
    _finish(axes)


def _figures(axes: Axes, envelope: Envelope, foot: float, right: float) -> None:
    """Dimension lines as on a data sheet."""
    size = max(envelope.largest_reach, envelope.largest_height + max(envelope.digging_depth, 0.0))
    if envelope.digging_depth > 0.02 * size:
        depth = envelope.digging_depth
        _dimension(axes, (foot, 0.0), (foot, -depth), f"digging depth {depth:.2f} m", _RIM)
        axes.plot([foot, foot + 0.5 * right], [-depth] * 2, color=_RIM, linewidth=0.7, linestyle=":")
    if envelope.reach_at_ground is not None:
        below = -0.045 * size
        _dimension(
            axes, (foot, below), (foot + envelope.reach_at_ground, below),
            f"reach at ground level {envelope.reach_at_ground:.2f} m", _RIM,
        )  # fmt: skip
    if envelope.loading_height is not None and envelope.loading_reach is not None:
        x, height = foot + envelope.loading_reach, envelope.loading_height
        _dimension(axes, (x, 0.0), (x, height), f"loading height {height:.2f} m", _RIM)
        axes.plot(x, height, "o", color=_RIM, markersize=4)
    x, height = foot + 1.06 * envelope.largest_reach, envelope.largest_height
    _dimension(axes, (x, 0.0), (x, height), f"greatest height of the tip {height:.2f} m", "0.45")


def _dimension(axes: Axes, a: tuple[float, float], b: tuple[float, float], text: str, colour: str) -> None:
    axes.update_datalim([a, b])
    arrow = {"arrowstyle": "<->", "color": colour, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", b, a, arrowprops=arrow)
    upright = abs(b[0] - a[0]) < abs(b[1] - a[1])
    axes.annotate(
        text, (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])), xytext=(-4, 0) if upright else (0, -4),
        textcoords="offset points", rotation=90 if upright else 0, ha="right" if upright else "center",
        va="center" if upright else "top", fontsize=9, color=colour, zorder=6,
        bbox={"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
    )  # fmt: skip


def _draw_machine(axes: Axes, robot: Robot, a: int, b: int) -> None:
    """Draw the machine's parts over the world's axes `a` and `b`, seen along the third, the farthest first."""
    from matplotlib.collections import PolyCollection

    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, _rest(robot))
    across = 3 - a - b
    nearer = -1.0 if across == 1 else 1.0
    triangles: list[Matrix] = []
    depth: list[Vector] = []
    colours: list[Matrix] = []
    for joint, faces, rgba in _parts(robot):
        placement = data.oMi[joint]
        corners = faces @ placement.rotation.T + placement.translation
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
        shade = 0.72 + 0.28 * np.abs(normal @ _LIGHT)
        pale = (0.5 * np.array(rgba[:3]) + 0.46) * shade[:, None]
        triangles.append(corners[:, :, [a, b]])
        depth.append(nearer * corners[:, :, across].mean(axis=1))
        colours.append(np.column_stack((pale, np.full(len(pale), 0.95 if rgba[3] == 1.0 else 0.35))))
    order = np.argsort(np.concatenate(depth))
    axes.add_collection(
        PolyCollection(
            list(np.concatenate(triangles)[order]), facecolors=np.concatenate(colours)[order], edgecolors="none",
            antialiaseds=False, rasterized=True, zorder=1.2,
        )
    )  # fmt: skip
    at = Kinematics(robot).at(_rest(robot))
    axes.plot(at.points[:, a], at.points[:, b], color=_INK, linewidth=1.1, marker="o", markersize=3, zorder=3)


def _parts(robot: Robot) -> list[tuple[int, Matrix, Rgba]]:
    """Joint, triangles (k, 3, 3) in its frame, and colour of each drawn part of the machine."""
    drawn = machine_meshes(robot)[0]
    if sum(len(part.facets.faces) for part in drawn) <= _MOST_TRIANGLES:
        return [(part.joint, part.facets.vertices[part.facets.faces], part.rgba) for part in drawn]
    return [(piece.joint, np.asarray(solid(piece.piece).triangles), _STEEL) for piece in robot.pieces]


def _finish(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.04)
    dress(axes)
