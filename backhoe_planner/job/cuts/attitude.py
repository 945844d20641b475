"""The bucket's pitch along a cut: the cutting plate at an angle to the path, its back clear of the ground.

The clearance angle is between the plate and the fresh cut behind the teeth; the rake is in front of the plate. The
wanted pitch keeps the plate at one angle to the path. Where the joints cannot reach that pitch, or a corner of the
bucket's back would press into the original ground or into the fresh cut, the nearest pitch that is free of both is
used; changes are spread along the path.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.job.cuts.arm_plane import ArmPlane
from backhoe_planner.job.cuts.bucket import Bucket

_CUTTING = 0.7  # rad from the path to the plate; chosen: draft is least at 35 to 45 degrees, and the back stays clear
_STEEPEST = 1.8  # rad from the horizontal to the plate; chosen, 103 degrees: down a wall with the back clear of it
_FLATTEST_PITCH, _STEEPEST_PITCH = -np.pi + 1e-3, -0.2  # rad; chosen: from a level opening to teeth nearly ahead
ENTERING = 0.15  # m ahead of the edge, where soil enters the bucket and does not press on the back; chosen
_CANDIDATES = 30  # pitches at every place: 0.1 rad apart
_CLEAR = 0.03  # m from the back to the ground; chosen, 3 degrees at the heel
_CLEARANCE = 0.1  # rad from the path up to the plate at least; chosen, 6 degrees; cutting tools have 5 to 15
_UPRIGHT = 0.5 * np.pi  # rad from the path to the plate: beyond it a body of soil stays in front of the blade
_LENGTH = 15.0  # places over which the pitch returns to the wanted one, 45 cm; chosen among 3 to 40 for time and work
_ROUND = 2  # places to each side over which the pitch's corners are rounded, twice: 12 cm
_CLEAR_ROUNDED = 0.01  # m of `_CLEAR` that remain after that; chosen
_SETS = 40  # of places at bounds, tried at most; a dozen is usual


@dataclass(frozen=True, eq=False)
class Attitude:
    """The pitch along a path, and the joints and back heights that follow from it.

    Attributes
    ----------
    pitch: (K,) [rad]; q: (K, n) joints; back: (K,) height of the back above the ground [m].
    """

    pitch: Vector
    q: Matrix
    back: Vector


@dataclass(frozen=True)
class Stuck:
    """The first place where no pitch is possible.

    Attributes
    ----------
    index: index of the place.
    in_reach: whether the joints have a solution there, so that it is the back that presses into the ground.
    """

    index: int
    in_reach: bool


def wanted_pitch(r: Vector, z: Vector, lift: int, bucket: Bucket) -> tuple[Vector, Vector, Vector]:
    """(K,) pitch [rad] with the plate at one angle to the path, and (K,), (K,) the least and greatest pitch that cut.

    From place `lift` on the opening turns level, and nothing is cut.
    """
    along = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(r), np.diff(z)))))
    rising = np.arctan2(np.gradient(z, along), -np.gradient(r, along))
    most = plate_pitch(bucket, rising, _UPRIGHT)
    least = np.minimum(plate_pitch(bucket, rising, _CLEARANCE), bucket.lip - np.pi + _STEEPEST)
    least[lift:], most[lift:] = -np.inf, np.inf
    plate = np.minimum(_CUTTING - rising, _STEEPEST)
    pitch = bucket.lip - np.pi + plate
    height = z[lift:] - z[lift]
    pitch[lift:] = pitch[lift - 1] + (bucket.level_pitch - pitch[lift - 1]) * height / max(float(height[-1]), 1e-9)
    return np.clip(pitch, max(bucket.level_pitch, _FLATTEST_PITCH), _STEEPEST_PITCH), least, most


def plate_pitch(bucket: Bucket, rising: Vector, angle: float) -> Vector:
    """(K,) pitch of the plate at `angle` to a path that rises at angles `rising` (K,) [rad]."""
    return bucket.lip - np.pi + angle - rising


def attitude(
    plane: ArmPlane,
    bucket: Bucket,
    *,
    swing: float,
    path: tuple[Vector, Vector, Vector, Vector, Vector],
    below: Callable[[Array, Array], Array],
    clears: Callable[[Matrix], Flags] | None,
) -> Attitude | Stuck:
    """The pitch along a path, as close to the wanted one as joints and back allow.

    Parameters
    ----------
    path: (K,) r, z, and wanted, least and greatest pitch; joints and back take priority over these three.
    below: returns the height of the ground (...) [m] at radii (...) while the edge is at radii (...).
    clears: returns (M,) whether joints (M, n) keep the arm off the ground; None to leave that unchecked.
    """
    r, z, wanted, least, most = path
    pitches = np.linspace(_FLATTEST_PITCH, _STEEPEST_PITCH, _CANDIDATES)
    at_r, at_z, at_pitch = (a.ravel() for a in np.broadcast_arrays(r[:, None], z[:, None], pitches))
    reached = plane.reaches(swing, at_r, at_z, at_pitch).reshape(len(r), -1)
    free = reached & (back_heights(bucket, r[:, None], z[:, None], pitches[None, :], below) >= _CLEAR)
    if clears is not None:
        rows, columns = np.nonzero(free)
        free[rows, columns] = clears(plane.joints(swing, r[rows], z[rows], pitches[columns]))
    none = np.flatnonzero(~free.any(axis=1))
    if len(none):
        return Stuck(int(none[0]), bool(reached[none[0]].any()))
    lower, upper = _ranges(free, pitches, wanted)
    most = np.maximum(most, least)
    lower, upper = np.clip(least, lower, upper), np.clip(most, lower, upper)
    sharp = _smoothed(np.clip(wanted, lower, upper), lower, upper)
    for pitch in (_rounded(sharp), sharp):
        q, back = plane.joints(swing, r, z, pitch), back_heights(bucket, r, z, pitch, below)
        if not np.isnan(q).any() and float(np.min(back)) >= _CLEAR_ROUNDED:
            return Attitude(pitch, q, back)
    return Stuck(int(np.argmax(np.isnan(q).any(axis=1))), not np.isnan(q).any())


def back_heights(bucket: Bucket, r: Array, z: Array, pitch: Array, below: Callable[[Array, Array], Array]) -> Array:
    """(...) height of the lowest corner of the back above the ground [m]."""
    cosine, sine = np.cos(pitch)[..., None], np.sin(pitch)[..., None]
    x, y = bucket.back.T
    at_r = r[..., None] + x * cosine - y * sine
    at_z = z[..., None] + x * sine + y * cosine
    return np.asarray(np.min(at_z - below(at_r, np.broadcast_to(r[..., None], at_r.shape)), axis=-1))


def _ranges(free: Flags, pitches: Vector, wanted: Vector) -> tuple[Vector, Vector]:
    """(K,), (K,) the ends of the run of free pitches nearest to the wanted one [rad]."""
    off = np.where(free, np.abs(pitches - wanted[:, None]), np.inf)
    nearest = np.argmin(off, axis=1)
    index = np.arange(len(pitches))
    first = np.max(np.where(~free & (index < nearest[:, None]), index + 1, 0), axis=1)
    last = np.min(np.where(~free & (index > nearest[:, None]), index - 1, len(pitches) - 1), axis=1)
    return pitches[first], pitches[last]


def _rounded(pitch: Vector) -> Vector:
    """(K,) the pitch with rounded corners, at which a motion would otherwise stop; its ends stay."""
    for _ in range(2):
        padded = np.pad(pitch, _ROUND, mode="reflect", reflect_type="odd")
        pitch = np.convolve(padded, np.full(2 * _ROUND + 1, 1.0 / (2 * _ROUND + 1)), mode="valid")
    return pitch


@lru_cache(maxsize=256)
def _stiffness(count: int) -> Matrix:
    """(count, count) matrix of the quadratic form that `_smoothed` minimises."""
    matrix = np.diag(np.full(count, 2.0 + _LENGTH**-2)) - np.eye(count, k=1) - np.eye(count, k=-1)
    matrix[0, 0] = matrix[-1, -1] = 1.0 + _LENGTH**-2
    matrix.setflags(write=False)
    return matrix


def _smoothed(wanted: Vector, lower: Vector, upper: Vector) -> Vector:
    """(K,) the pitch that changes least and is closest to the wanted one, within its bounds [rad].

    It minimises sum (p_k+1 - p_k)^2 + sum (p_k - w_k)^2 / L^2, with the last place as close to its wanted pitch as
    possible. The places at bounds are found by the primal-dual active set method, which ends in a few steps because
    the matrix is an M-matrix (M. Hintermueller, K. Ito, K. Kunisch, SIAM J. Optim. 13, 2002).
    """
    lower, upper = lower.copy(), upper.copy()
    lower[-1] = upper[-1] = np.clip(wanted[-1], lower[-1], upper[-1])
    count = len(wanted)
    matrix = _stiffness(count)
    pull = wanted / _LENGTH**2
    pitch, before = np.clip(wanted, lower, upper), None
    for _ in range(_SETS):
        ahead = pitch - (matrix @ pitch - pull)
        low, high = ahead <= lower, ahead >= upper
        low[-1], high[-1] = True, False
        sides = low.astype(int) - high
        if before is not None and np.array_equal(sides, before):
            break
        before, free = sides, ~(low | high)
        pitch = np.where(low, lower, np.where(high, upper, pitch))
        held = matrix[np.ix_(free, ~free)] @ pitch[~free]
        pitch[free] = np.linalg.solve(matrix[np.ix_(free, free)], pull[free] - held)
    return np.clip(pitch, lower, upper)
