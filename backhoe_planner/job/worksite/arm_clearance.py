"""Whether boom and stick stay above the ground in the arm's plane: a quick check before a cut is planned in full.

The outline of every convex piece is covered with points. The ground is raised by the clearance all around, like the
path of a ball that rolls over it, and its height is the greatest under the width of the arm. A motion that passes
is proven later; one that does not pass is hardly worth the proof.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.job.cuts.arm_plane import ArmPlane
from backhoe_planner.job.cuts.profile import Profile
from backhoe_planner.machine import Robot

_SPACING = 0.06  # m between points of an outline; chosen, about a cell of the ground
_STEP = 0.025  # m of radius between heights of the raised ground


class ArmOutline:
    """The pieces of the links between the swing and the bucket.

    Parameters
    ----------
    plane: the plane in which the arm moves.
    clearance: clearance from the ground [m].
    """

    def __init__(self, plane: ArmPlane, clearance: float) -> None:
        self._plane, self._clearance = plane, clearance
        self._robot: Robot = plane.robot
        self._points: list[tuple[int, Matrix, float]] = []
        self.width = 0.0
        first = 2 if plane.swings else 1
        for one in self._robot.pieces:
            if first <= one.joint < self._robot.n and len(one.piece.hull):
                hull = np.asarray(one.piece.hull)
                self._points.append((one.joint, _covered(hull), float(one.piece.radius)))
                across = hull @ self._robot.joint_axes[one.joint - 1]
                self.width = max(self.width, 2.0 * (float(np.max(np.abs(across))) + float(one.piece.radius)))

    def raised(self, profile: Profile) -> tuple[Vector, Vector]:
        """(K,) radii and (K,) heights below which no point of the arm may be [m].

        Parameters
        ----------
        profile: profile of the ground under the arm, as wide as `span`.
        """
        r = np.arange(profile.r[0], profile.r[-1], _STEP)
        ground = np.interp(r, profile.r, np.max(profile.surface, axis=1))
        return r, self.raise_by_clearance(ground)

    def raise_by_clearance(self, ground: Vector) -> Vector:
        """(K,) heights at evenly spaced radii, `_STEP` apart, raised all around by the clearance [m]."""
        half = int(self._clearance / _STEP)
        offset = _STEP * np.arange(-half, half + 1)
        ball = np.sqrt(np.maximum(self._clearance**2 - offset**2, 0.0))
        padded = np.pad(ground, half, mode="edge")
        return np.asarray(np.max(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1) + ball, axis=1))

    @property
    def span(self) -> float:
        """The width of the ground that counts [m]."""
        return self.width + 2.0 * self._clearance

    def clears(self, q: Matrix, raised: tuple[Vector, Vector]) -> Flags:
        """(M,) whether the arm is above the ground at q (M, n).

        Parameters
        ----------
        raised: (K,) evenly spaced radii and (K,) heights, see `raised`.
        """
        radii, heights = raised
        spacing, rises = (radii[-1] - radii[0]) / (len(radii) - 1), np.diff(heights, append=heights[-1])
        turns, at = self._plane.heading(q[:, 0]), self._plane.kinematics.at(q)
        out = np.column_stack((np.cos(turns), np.sin(turns)))
        # rows of rotation and translation along the arm and upward, for each joint
        frames = np.empty((self._robot.n, len(q), 2, 4))
        frames[:, :, 0, :3] = np.einsum("ki,kjic->jkc", out, at.rotations[:, :, :2])
        frames[:, :, 0, 3] = np.einsum("ki,kji->jk", out, at.origins[:, :, :2] - self._plane.axis)
        frames[:, :, 1, :3], frames[:, :, 1, 3] = at.rotations[:, :, 2].swapaxes(0, 1), at.origins[:, :, 2].T
        found, highest = np.ones(len(q), dtype=bool), np.max(heights)
        for joint, points, radius in self._points:
            frame = frames[joint - 1]
            rows = np.flatnonzero(found)
            lowest = frame[rows, 1, :3] @ points.T + (frame[rows, 1, 3:] - radius)
            low = lowest < highest  # what is above all of the ground is clear
            at_r = frame[rows, 0, :3] @ points.T + frame[rows, 0, 3:]
            # as np.interp, which takes several times as long for many points
            place = np.clip((at_r[low] - radii[0]) / spacing, 0.0, len(radii) - 1.0)
            before = place.astype(np.intp)
            low[low] = lowest[low] < heights[before] + (place - before) * rises[before]
            found[rows] = ~low.any(axis=1)
        return found


def _covered(hull: Matrix) -> Matrix:
    """(k, 3) points on the edges between the corners (m, 3) of a box-like piece."""
    edges = [(a, b) for i, a in enumerate(hull) for b in hull[i + 1 :]]
    found = [hull]
    for a, b in edges:
        count = int(np.linalg.norm(b - a) / _SPACING)
        if count > 1:
            part = np.linspace(0.0, 1.0, count + 1)[1:-1, None]
            found.append(a + part * (b - a))
    return np.unique(np.round(np.vstack(found), 4), axis=0)
