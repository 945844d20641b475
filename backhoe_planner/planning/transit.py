"""From where the machine stands to one of several configurations, by a sampled way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.motion import TipPath, drive_of, time_way
from backhoe_planner.planning.context import Context
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.search.blending import blend
from backhoe_planner.planning.search.motion_check import MotionCheck
from backhoe_planner.planning.search.sampling import Way, sample_way
from backhoe_planner.planning.search.shortening import shorten

__all__ = ["Transit", "find_transit", "find_way_near", "play_way"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_SPARES = (0.01, 0.002)  # m beyond every clearance; less is asked where more leads nowhere
_TUBES = (0.25, 0.6, 1.5)  # m, and half of what is left out, that a detour may go off the path
_DETOURS = 4  # of which the shortest is taken
_TUBE_PART, _FREE_PART = 8, 2  # of the motions of one search that a way in a tube, and one without, gets one in so many


@dataclass(frozen=True)
class Transit:
    """What came of a search.

    Attributes
    ----------
    stepper: the motion, at rest on one of the goals; None where no way was found.
    told: what was tried, in words, where no way was found.
    """

    stepper: Stepper | None
    told: str


def find_transit(context: Context, stepper: Stepper, goals: Sequence[Vector], *, straight: bool = False) -> Transit:
    """Bring a motion that is at rest to one of `goals`, (n,) each.

    Parameters
    ----------
    straight: whether only straight motions of the joints are tried.
    """
    if not len(goals):
        return Transit(None, "there is nowhere to go")
    work = context.work
    most = 0 if straight else None
    motions = work.motions
    for spare in _SPARES:
        check = MotionCheck(
            context.problem, context.world, [stepper.q, *goals], spare=spare, time=stepper.time, brake=work.brake
        )
        way = sample_way(check, stepper.q, goals, seed=context.seed, work=work, most_motions=most)
        if way is not None:
            branch = stepper.branch(attempt=stepper.attempt + 1)
            smooth = blend(check, shorten(check, way, seed=context.seed))
            branch.play(time_way(smooth, context.problem.limits, drive=drive_of(context.problem)))
            return Transit(branch, "")
    return Transit(None, f"of {motions - work.motions:,} motions that sampling looked at none led there")


def find_way_near(
    context: Context, path: TipPath, start: Vector, end: Vector, low: float, high: float, *, time: float
) -> Matrix | None:
    """(K, n) a way that stays near the part of a path from arc length `low` to `high` [m].

    Parameters
    ----------
    start, end: (n,) joints with the tip on the path at `low` and `high`.
    time: at which the obstacles are taken to be where they are [s].
    """
    work = context.work
    for tube in (*_TUBES, np.inf):
        check = MotionCheck(
            context.problem,
            context.world,
            [start, end],
            spare=_SPARES[1],
            time=time,
            brake=work.brake,
            keep=_near(context, path, low, high, tube + 0.5 * (high - low)) if np.isfinite(tube) else None,
        )
        most = work.effort.motions_per_search // (_TUBE_PART if np.isfinite(tube) else _FREE_PART)
        found: list[Way] = []
        for turn in range(_DETOURS):
            seed = context.seed + turn
            way = sample_way(check, start, [end], seed=seed, work=work, most_motions=most)
            if way is None:
                break
            found.append(shorten(check, way, seed=seed))
            if len(found[-1].q) == 2:
                break
        if found:
            return min(found, key=lambda way: way.length(context.problem.limits)).q
    return None


def play_way(context: Context, stepper: Stepper, way: Matrix) -> None:
    """Append a way (K, n) that begins where the motion stands, with its corners rounded."""
    check = MotionCheck(
        context.problem, context.world, [way[0], way[-1]], spare=_SPARES[1], time=stepper.time,
    )  # fmt: skip
    stepper.play(time_way(blend(check, Way(way)), context.problem.limits, drive=drive_of(context.problem)))


def _near(context: Context, path: TipPath, low: float, high: float, reach: float) -> Callable[[Vector], bool]:
    """Whether the tip is within `reach` [m] of the path between two arc lengths."""
    marks = path.stations[(path.stations > low) & (path.stations < high)]
    corners = np.array([path(float(s)) for s in (low, *marks, high)])
    steps = np.diff(corners, axis=0)
    squares = np.maximum(np.einsum("ki,ki->k", steps, steps), 1e-18)

    def keep(q: Vector) -> bool:
        off = context.kinematics.at(q).tip_position - corners[:-1]
        part = np.clip(np.einsum("ki,ki->k", off, steps) / squares, 0.0, 1.0)
        off -= part[:, None] * steps
        return bool(np.min(np.einsum("ki,ki->k", off, off)) <= reach * reach)

    return keep
