"""Where the camera stands so that everything is in view at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector

FIELD_OF_VIEW = np.radians(38.0)  # vertical
_ELEVATIONS = np.radians([20.0, 17.0, 14.0, 11.0, 9.0])
_UNDER = 0.08  # part of the distance by which the camera stays under a ceiling
_AZIMUTH = np.radians(52.0)  # from the x axis, along which the arm points
_ASPECTS = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5)
_ROOM = 1.07


@dataclass(frozen=True)
class View:
    """A camera that looks at `target` (3,) from `direction` (3,), world.

    Attributes
    ----------
    target: centre of the picture, around which the viewer turns [m].
    direction: unit vector from there to the camera.
    distances: (aspect, distance [m]) at which everything is in view, aspect rising.
    """

    target: Vector
    direction: Vector
    distances: tuple[tuple[float, float], ...]

    def eye(self, aspect: float = 1.5) -> Vector:
        """(3,) where the camera stands for a picture of width / height `aspect` [m]."""
        aspects, distances = zip(*self.distances, strict=True)
        return np.asarray(self.target + self.direction * np.interp(aspect, aspects, distances))


def frame(points: Matrix, *, side: float = -1.0, ceiling: float | None = None) -> View:
    """The three-quarter view that has all `points` (k, 3) in it.

    Parameters
    ----------
    side: sign of y of the camera: left or right of the arm.
    ceiling: height of something wide overhead, which is better looked at from below [m].
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
    target = _centred(points, direction, right, up, 1.5)
    distances = tuple((aspect, _distance(points - target, direction, right, up, aspect)) for aspect in _ASPECTS)
    return View(target=target, direction=direction, distances=distances)


def _distance(relative: Matrix, direction: Vector, right: Vector, up: Vector, aspect: float) -> float:
    tangent = np.tan(FIELD_OF_VIEW / 2.0) / _ROOM
    needed = relative @ direction + np.maximum(
        np.abs(relative @ right) / (tangent * aspect), np.abs(relative @ up) / tangent
    )
    return float(max(needed.max(), 0.5))


def _centred(points: Matrix, direction: Vector, right: Vector, up: Vector, aspect: float) -> Vector:
    """The target for which the points fill the picture evenly."""
    target = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for _ in range(12):
        relative = points - target
        depth = _distance(relative, direction, right, up, aspect) - relative @ direction
        for axis in (right, up):
            seen = (relative @ axis) / depth
            target = target + 0.5 * (seen.max() + seen.min()) * float(np.median(depth)) * axis
    return np.asarray(target)
