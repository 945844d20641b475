"""The bucket's pitch along a cut: the cutting plate at an angle to the path, its back clear of the ground.

Between the plate and the fresh cut behind the teeth there is the clearance angle, and the rake
in front of it. The wanted pitch has the plate at one angle to the path. Where the joints cannot
have it, or a corner of the bucket's back would press into the ground as it was or into the
fresh cut, the nearest pitch that is free of both is taken; changes are spread along the path.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.job.cuts.arm_plane import ArmPlane
from backhoe_planner.job.cuts.bucket import Bucket

_CUTTING = 0.7  # rad from the path to the plate; chosen: draft is least at 35 to 45 degrees, and the back stays clear
_STEEPEST = 1.8  # rad from the level to the plate; chosen, 103 degrees: down a wall with the back clear of it
_FLATTEST_PITCH, _STEEPEST_PITCH = -np.pi + 1e-3, -0.2  # rad; chosen: from a level opening to teeth nearly ahead
_CANDIDATES = 30  # pitches at every place: 0.1 rad apart
_CLEAR = 0.03  # m from the back to the ground; chosen, 3 degrees at the heel
_SPREAD = 3  # places to each side over which the pitch is smoothed, twice: 18 cm


@dataclass(frozen=True, eq=False)
class Attitude:
    """The pitch along a path, and what it leads to.

    Attributes
    ----------
    pitch: (K,) [rad]; q: (K, n) joints; back: (K,) height of the back above the ground [m].
    """

    pitch: Vector
    q: Matrix
    back: Vector


@dataclass(frozen=True)
class Stuck:
    """The first place where no pitch will do.

    Attributes
    ----------
    index: of the place.
    in_reach: whether the joints have a solution there, so that it is the back that presses.
    """

    index: int
    in_reach: bool


def wanted_pitch(r: Vector, z: Vector, lift: int, bucket: Bucket) -> Vector:
    """(K,) pitch [rad] that has the plate at one angle to the path; from place `lift` on the opening turns level."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(r), np.diff(z)))))
    rising = np.arctan2(np.gradient(z, along), -np.gradient(r, along))
    plate = np.minimum(_CUTTING - rising, _STEEPEST)
    pitch = bucket.lip - np.pi + plate
    height = z[lift:] - z[lift]
    pitch[lift:] = pitch[lift - 1] + (bucket.level_pitch - pitch[lift - 1]) * height / max(float(height[-1]), 1e-9)
    return np.asarray(np.clip(pitch, max(bucket.level_pitch, _FLATTEST_PITCH), _STEEPEST_PITCH))


def attitude(
    plane: ArmPlane,
    bucket: Bucket,
    *,
    swing: float,
    path: tuple[Vector, Vector, Vector],
    below: Callable[[Array, Array], Array],
) -> Attitude | Stuck:
    """The pitch along a path, as near to the wanted as joints and back allow.

    Parameters
    ----------
    path: (K,) r, z and wanted pitch.
    below: gives the height of the ground (...) [m] under points at radii (...) while the edge is at radii (...).
    """
    r, z, wanted = path
    pitches = np.linspace(_FLATTEST_PITCH, _STEEPEST_PITCH, _CANDIDATES)
    at_r, at_z, at_pitch = (a.ravel() for a in np.broadcast_arrays(r[:, None], z[:, None], pitches))
    reached = ~np.isnan(plane.joints(swing, at_r, at_z, at_pitch)[:, 0]).reshape(len(r), -1)
    free = reached & (_back(bucket, r[:, None], z[:, None], pitches[None, :], below) >= _CLEAR)
    none = np.flatnonzero(~free.any(axis=1))
    if len(none):
        return Stuck(int(none[0]), bool(reached[none[0]].any()))
    lower, upper = _ranges(free, pitches, wanted)
    pitch = _smoothed(wanted, lower, upper)
    q = plane.joints(swing, r, z, pitch)
    if np.isnan(q).any():
        return Stuck(int(np.argmax(np.isnan(q).any(axis=1))), False)
    return Attitude(pitch, q, _back(bucket, r, z, pitch, below))


def _back(bucket: Bucket, r: Array, z: Array, pitch: Array, below: Callable[[Array, Array], Array]) -> Array:
    """(...) the least height of a corner of the back above the ground [m]."""
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


def _smoothed(wanted: Vector, lower: Vector, upper: Vector) -> Vector:
    """(K,) the wanted pitch within its bounds, changes spread over neighbours.

    A mean over neighbours of what is within bounds that hold for all of these stays within each one's own.
    """
    low, high = _extreme(lower, np.max), _extreme(upper, np.min)
    clash = low > high
    low, high = np.where(clash, lower, low), np.where(clash, upper, high)
    within = np.clip(wanted, low, high)
    for _ in range(2):
        padded = np.pad(within, _SPREAD, mode="edge")
        within = np.convolve(padded, np.full(2 * _SPREAD + 1, 1.0 / (2 * _SPREAD + 1)), mode="valid")
    return np.clip(within, lower, upper)


def _extreme(values: Vector, choose: Callable[..., Array]) -> Vector:
    padded = np.pad(values, 2 * _SPREAD, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 4 * _SPREAD + 1)
    return np.asarray(choose(windows, axis=1))
