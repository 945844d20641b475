"""Kept conditions that cannot hold together in any posture, such as a bucket that is level and tipped out at once."""

from __future__ import annotations

import itertools

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Condition, Keep

_TRIED = 24  # random postures, from which conditions are sought; chosen: mostly the first leads to all of them


def find_contradiction(keep: Keep, limits: JointLimits) -> str:
    """Which two conditions hold together in no posture that is found, in words; empty if there are no such.

    Each of them must hold by itself somewhere. From random postures Newton's method looks for one in which both hold;
    where only the first does, the value of the second that comes nearest is told.
    """
    if len(keep.conditions) < 2:
        return ""
    rng = np.random.default_rng(0)
    tried = rng.uniform(*keep.robot.finite_range, (_TRIED, keep.robot.n))
    if _first_within(keep, tried, limits) is not None:
        return ""
    for pair in itertools.combinations(keep.conditions, 2):
        alone = [Keep(keep.robot, [one]) for one in pair]
        if any(_first_within(one, tried, limits) is None for one in alone):
            continue
        if _first_within(Keep(keep.robot, pair), tried, limits) is None:
            return _told(alone[0], *pair, tried, limits)
    return ""


def _first_within(keep: Keep, tried: Matrix, limits: JointLimits) -> Vector | None:
    """(n,) the first posture that keeps all, found from one of `tried` (N, n); None if there is none."""
    return next((q for q in (keep.project(q, limits.lower, limits.upper) for q in tried) if q is not None), None)


def _told(first: Keep, one: Condition, other: Condition, tried: Matrix, limits: JointLimits) -> str:
    there = [q for q in (first.project(q, limits.lower, limits.upper) for q in tried) if q is not None]
    values = other.values(np.array(there))
    nearest = other.describe(float(values[int(np.argmax(other.margins(values)))]))
    return (
        f"`keep.{one.name}` and `keep.{other.name}` contradict each other: no posture was found in which both hold; "
        f"within `keep.{one.name}` ({one.allowed}), at best {nearest}"
    )
