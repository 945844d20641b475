"""Kept conditions that cannot hold together in any posture, such as a bucket that is level and tipped out at once."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Condition, Keep

_TRIED = 24  # random postures, from which conditions are sought; chosen: mostly the first leads to all of them
_TRIED_MORE = 100  # the same before a contradiction is told; chosen: narrow conditions need up to some dozen
_BEYOND = 2.0 * np.pi  # rad by which the search may leave the postures of a continuous joint; chosen: a turn


def find_contradiction(keep: Keep, limits: JointLimits, known: Sequence[Vector] = ()) -> str:
    """Which two conditions hold together in no posture that is found, in words; empty if there are no such.

    Each of them must hold by itself somewhere. From such postures, and from random ones, Newton's method looks for one
    in which both hold; where only the first does, the value of the second that comes nearest is told.

    Parameters
    ----------
    known: (n,) each, postures that may keep all, such as the start [rad or m].
    """
    if len(keep.conditions) < 2 or any(keep.holds(q) for q in known):
        return ""
    low, high = (np.clip(one, limits.lower, limits.upper) for one in keep.robot.finite_range)
    rng = np.random.default_rng(0)
    tried, more = (rng.uniform(low, high, (count, keep.robot.n)) for count in (_TRIED, _TRIED_MORE))
    limits = replace(
        limits, lower=np.maximum(limits.lower, low - _BEYOND), upper=np.minimum(limits.upper, high + _BEYOND)
    )
    if next(_within(keep, tried, limits), None) is not None:
        return ""
    for pair in itertools.combinations(keep.conditions, 2):
        alone = [list(_within(Keep(keep.robot, [one]), tried, limits)) for one in pair]
        if not all(alone):
            continue
        if next(_within(Keep(keep.robot, pair), np.array([*alone[0], *alone[1], *more]), limits), None) is None:
            return _told(*pair, np.array(alone[0]))
    return ""


def _within(keep: Keep, tried: Matrix, limits: JointLimits) -> Iterator[Vector]:
    """(n,) each, postures that keep all, found from those of `tried` (N, n)."""
    return (q for q in (keep.project(q, limits.lower, limits.upper) for q in tried) if q is not None)


def _told(one: Condition, other: Condition, within: Matrix) -> str:
    values = other.values(within)
    nearest = other.describe(float(values[int(np.argmax(other.margins(values)))]))
    return (
        f"`keep.{one.name}` and `keep.{other.name}` contradict each other: no posture was found in which both hold; "
        f"within `keep.{one.name}` ({one.allowed}), at best {nearest}"
    )
