"""Where the camera stands so that everything is in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector

FIELD_OF_VIEW = np.radians(38.0)  # rad, vertical; chosen, wide enough for depth and too narrow to distort
_ELEVATIONS = np.radians([20.0, 17.0, 14.0, 11.0, 9.0])  # rad, the first that stays under a ceiling; chosen
_UNDER = 0.08  # part of the distance by which the camera stays under a ceiling; chosen
_AZIMUTH = np.radians(52.0)  # rad from the x axis, along which the arm points; chosen, between side and front
_ASPECTS = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5)  # width / height, for which distances are computed
_ASPECT = 1.5  # width / height of a common picture
_ROOM = 1.07  # size of the picture beside what is in it; chosen, a narrow rim
_CLOSEST = 0.5  # m from the camera to the target; chosen


@dataclass(frozen=True)
class View:
    """A camera that looks at a target.

    Attributes
    ----------
    target: (3,) centre of the picture, around which the viewer turns [m], world.
    direction: (3,) unit vector from there to the camera, world.
    distances: pairs (aspect, distance [m]) at which everything is in view, aspect rising.
    """

    target: Vector
    direction: Vector
    distances: tuple[tuple[float, float], ...]

    def eye(self, aspect: float = _ASPECT) -> Vector:
        """(3,) where the camera stands for a picture of width / height `aspect` [m], world."""
        aspects, distances = zip(*self.distances, strict=True)
        return np.asarray(self.target + self.direction * np.interp(aspect, aspects, distances))


def frame(points: Matrix, *, side: float = -1.0, ceiling: float | None = None) -> View:
    """The three-quarter view that has all `points` (k, 3) in it [m], world.

    Parameters
    ----------
    side: its sign is the sign of the camera's y: left or right of the arm.
    ceiling: height of something wide overhead, under which the camera stays [m].
    """
    views = [_view(points, side, elevation) for elevation in _ELEVATIONS]
    if ceiling is not None:
        for view in views:
            eye = view.eye()
            if eye[2] < ceiling - _UNDER * np.linalg.norm(eye - view.target):
                return view
    return views[0]


def _view(points: Matrix, side: float, elevation: float) -> View:
    level = np.array([np.cos(_AZIMUTH), np.sign(side or -1.0) * np.sin(_AZIMUTH), 0.0])
    direction = np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    target = _centred(points, direction, right, up)
    distances = tuple((aspect, _distance(points - target, direction, right, up, aspect)) for aspect in _ASPECTS)
    return View(target=target, direction=direction, distances=distances)


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
