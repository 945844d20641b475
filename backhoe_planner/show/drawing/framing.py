"""The camera position that has everything in view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector

FIELD_OF_VIEW = np.radians(38.0)  # rad, vertical; chosen, wide enough for depth and too narrow to distort
_ELEVATIONS = np.radians([20.0, 17.0, 14.0, 11.0, 9.0])  # rad, tried in turn until one stays under a ceiling; chosen
_UNDER = 0.08  # part of the distance by which the camera stays under a ceiling; chosen
_AZIMUTH = np.radians(52.0)  # rad from the x axis, along which the arm points; chosen, between side and front
# rad, tried in turn from the same side and from the other one if something hides the machine; chosen
_OTHER_AZIMUTHS = np.radians([52.0, 20.0, 95.0, 140.0])
_STEEP = np.radians(48.0)  # rad of elevation, if the machine is hidden from all sides; chosen
_LITTLE_HIDDEN = 0.1  # greatest part of the points in view that may be hidden; chosen
_HILLS_ACROSS = 40  # boxes along uneven ground that stand for its hills; chosen
_MOST_RAYS = 200_000  # from the camera past boxes, which take some 3 ms and 10 MB; chosen
_ASPECTS = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5)  # width / height, for which distances are computed
_ASPECT = 1.5  # width / height of a common picture
_ROOM = 1.07  # size of the picture relative to its content; chosen, a narrow rim
_CLOSEST = 0.5  # m from the camera to the target; chosen


@dataclass(frozen=True)
class View:
    """A camera that looks at a target.

    Attributes
    ----------
    target: (3,) centre of the picture, around which the viewer turns [m], world.
    direction: (3,) unit vector from the target to the camera, world.
    distances: pairs (aspect, distance [m]) at which everything is in view, aspect increasing.
    """

    target: Vector
    direction: Vector
    distances: tuple[tuple[float, float], ...]

    def eye(self, aspect: float = _ASPECT) -> Vector:
        """(3,) position of the camera for a picture of width / height `aspect` [m], world."""
        aspects, distances = zip(*self.distances, strict=True)
        return np.asarray(self.target + self.direction * np.interp(aspect, aspects, distances))


def frame(
    points: Matrix, *, side: float = -1.0, ceiling: float | None = None,
    hidden: Callable[[Vector], float] = lambda eye: 0.0,
) -> View:  # fmt: skip
    """The three-quarter view that contains all `points` (k, 3) [m], world; another view if too much is hidden in it.

    Parameters
    ----------
    side: its sign is the sign of the camera's y: left or right of the arm.
    ceiling: height of something wide overhead, under which the camera stays [m].
    hidden: returns the part of the view, 0 to 1, that is hidden from a camera at (3,) [m].
    """
    side = np.sign(side or -1.0)
    best, least = _below(ceiling, points, side * _AZIMUTH), np.inf
    for azimuth in (sign * side * turned for turned in _OTHER_AZIMUTHS for sign in (1.0, -1.0)):
        view = _below(ceiling, points, azimuth)
        part = hidden(view.eye())
        if part < least:
            best, least = view, part
        if least <= _LITTLE_HIDDEN:
            return best
    steep = _view(points, side * _AZIMUTH, _STEEP)
    return steep if ceiling is None and hidden(steep.eye()) < least else best


def _below(ceiling: float | None, points: Matrix, azimuth: float) -> View:
    """The view at this azimuth that stays under a ceiling, if possible."""
    views = [_view(points, azimuth, elevation) for elevation in (_ELEVATIONS[:1] if ceiling is None else _ELEVATIONS)]
    if ceiling is not None:
        for view in views:
            eye = view.eye()
            if eye[2] < ceiling - _UNDER * np.linalg.norm(eye - view.target):
                return view
    return views[0]


def _view(points: Matrix, azimuth: float, elevation: float) -> View:
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    direction = np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    target = _centred(points, direction, right, up)
    distances = tuple((aspect, _distance(points - target, direction, right, up, aspect)) for aspect in _ASPECTS)
    return View(target=target, direction=direction, distances=distances)


def hills(vertices: Matrix, *, above: float) -> Array:
    """(B, 2, 3) boxes in place of the parts of uneven ground that are higher than `above` [m], world.

    Parameters
    ----------
    vertices: (k, 3) points of the ground [m], with few gaps between them.
    """
    low = vertices.min(axis=0)
    step = max(float(np.ptp(vertices[:, :2], axis=0).max()) / _HILLS_ACROSS, _CLOSEST)
    high = vertices[vertices[:, 2] > above]
    places, number = np.unique(np.floor((high[:, :2] - low[:2]) / step), axis=0, return_inverse=True)
    tops = np.full(len(places), -np.inf)
    np.maximum.at(tops, number.reshape(-1), high[:, 2])
    corners = low[:2] + step * places
    boxes = np.empty((len(places), 2, 3))
    boxes[:, 0] = np.column_stack((corners, np.full(len(places), low[2])))
    boxes[:, 1] = np.column_stack((corners + step, tops))
    return boxes


def blocks(vertices: Matrix, *, above: float) -> Array:
    """(B, 2, 3) boxes in place of the parts of a scan that are higher than `above` [m], world, with what is below free.

    Parameters
    ----------
    vertices: (k, 3) points of its surface [m], with few gaps between them.
    """
    step = max(float(np.ptp(vertices[:, :2], axis=0).max()) / _HILLS_ACROSS, _CLOSEST)
    corners = step * np.unique(np.floor(vertices[vertices[:, 2] > above] / step), axis=0)
    return np.stack((corners, corners + step), axis=1)


def part_behind(boxes: Array, points: Matrix, eye: Vector) -> float:
    """The part of `points` (k, 3) [m], 0 to 1, that at least one of `boxes` (B, 2, 3) hides from a camera at (3,).

    The boxes are aligned with the axes, each given by its lowest and its highest corner. A box that contains the camera
    hides nothing, and a box does not hide the points inside it. Among many boxes only some of the points are looked at.
    """
    points = points[:: 1 + len(boxes) * len(points) // _MOST_RAYS]
    if not len(boxes) or not len(points):
        return 0.0
    enters, leaves = np.full((len(boxes), len(points)), -np.inf), np.full((len(boxes), len(points)), np.inf)
    for axis in range(3):  # a ray is in a box between its last entry and its first exit of the three pairs of faces
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = ((boxes[:, end, axis, None] - eye[axis]) / (points[:, axis] - eye[axis]) for end in (0, 1))
        # a ray within the upper of two faces, whose distance is undefined, is in the box; within the lower it is not
        np.fmax(enters, np.fmin(low, high), out=enters)
        np.fmin(leaves, np.maximum(low, high), out=leaves)
    behind = (enters > 0.0) & (enters < leaves) & (leaves < 1.0)
    return float(np.mean(behind.any(axis=0)))


def _distance(relative: Matrix, direction: Vector, right: Vector, up: Vector, aspect: float) -> float:
    tangent = np.tan(FIELD_OF_VIEW / 2.0) / _ROOM
    needed = relative @ direction + np.maximum(
        np.abs(relative @ right) / (tangent * aspect), np.abs(relative @ up) / tangent
    )
    return float(max(needed.max(), _CLOSEST))


def _centred(points: Matrix, direction: Vector, right: Vector, up: Vector) -> Vector:
    """The target for which the points fill the picture evenly."""
    target = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for _ in range(12):
        relative = points - target
        depth = _distance(relative, direction, right, up, _ASPECT) - relative @ direction
        for axis in (right, up):
            seen = (relative @ axis) / depth
            target = target + 0.5 * (seen.max() + seen.min()) * float(np.median(depth)) * axis
    return np.asarray(target)
