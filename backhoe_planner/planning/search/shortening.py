"""Shortcuts: a route is shortened as long as every new segment is proven clear.

Corners are left out, then straight pieces replace the part between two random places,
for all joints or for one alone (partial shortcuts, Geraerts and Overmars 2007).
"""

from __future__ import annotations

import itertools

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.planning.search.motion_check import MotionCheck
from backhoe_planner.planning.search.sampling import JointPath

_TRIES = 60  # random shortcuts; chosen
_PATIENCE = 20  # shortcuts in a row without a gain after which no more are tried; a third of all
_GAIN = 1e-3  # part of the length; chosen: a shortcut that gains less is not worth its proof
_ONE_JOINT = 0.4  # part of the shortcuts that move only one joint; chosen: somewhat fewer than those of all joints
_SHORTEST = 1e-6  # s between two corners: far below any motion, so that no segment is divided by 0


def shorten(check: MotionCheck, way: JointPath, *, seed: int) -> JointPath:
    """A route with the same ends that is not longer, with the same proof.

    Parameters
    ----------
    check: the check that `way` was found with.
    seed: of the random places, not negative.
    """
    rng = np.random.default_rng(seed)
    q = _without_corners(check, way.q)
    missed = 0
    for _ in range(_TRIES):
        if len(q) < 3 or missed >= _PATIENCE:
            break
        shorter = _shortcut(check, q, rng)
        if shorter is None:
            missed += 1
        else:
            q, missed = shorter, 0
    q = _without_corners(check, q)
    return JointPath(q) if _length(q, check.rate) < _length(way.q, check.rate) else way


def _length(q: Matrix, rate: Vector) -> float:
    """The same as `JointPath.length` [s]."""
    return float(np.sum(np.linalg.norm(np.diff(q, axis=0) / rate, axis=1)))


def _without_corners(check: MotionCheck, q: Matrix) -> Matrix:
    """From each corner straight to the furthest one to which the motion is clear."""
    kept = [0]
    while kept[-1] < len(q) - 1:
        here = kept[-1]
        ahead = len(q) - 1
        while ahead > here + 1 and not check.segment_is_clear(q[here], q[ahead]):
            ahead -= 1
        kept.append(ahead)
    return q[kept]


def _shortcut(check: MotionCheck, q: Matrix, rng: np.random.Generator) -> Matrix | None:
    """(K, n) the route with one straight piece between two random places; None if that is no gain or not clear."""
    steps = np.linalg.norm(np.diff(q, axis=0) / check.rate, axis=1)
    stations = np.concatenate(([0.0], np.cumsum(steps)))
    one_joint = bool(rng.random() < _ONE_JOINT)
    joint = int(rng.integers(q.shape[1]))
    s_a, s_b = np.sort(rng.random(2)) * stations[-1]
    first = min(int(np.searchsorted(stations, s_a, side="right")) - 1, len(q) - 2)
    last = min(int(np.searchsorted(stations, s_b, side="right")) - 1, len(q) - 2)
    if first == last:
        return None
    q_a = q[first] + (s_a - stations[first]) / steps[first] * (q[first + 1] - q[first])
    q_b = q[last] + (s_b - stations[last]) / steps[last] * (q[last + 1] - q[last])
    between = np.vstack((q_a, q[first + 1 : last + 1], q_b))
    if one_joint:
        part = (np.concatenate(([s_a], stations[first + 1 : last + 1], [s_b])) - s_a) / (s_b - s_a)
        new = np.array(between)
        new[:, joint] = q_a[joint] + part * (q_b[joint] - q_a[joint])
    else:
        new = np.vstack((q_a, q_b))
    if _length(new, check.rate) > _length(between, check.rate) - _GAIN * stations[-1]:
        return None
    found = np.vstack((q[: first + 1], new, q[last + 1 :]))
    if float(np.min(np.linalg.norm(np.diff(found, axis=0) / check.rate, axis=1))) < _SHORTEST:
        return None
    # the rest has been proven with `q`
    return found if all(check.segment_is_clear(a, b) for a, b in itertools.pairwise(new)) else None
