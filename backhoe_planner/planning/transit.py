"""Sampled routes from the present configuration to others, and detours off a path."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import BatchKinematics
from backhoe_planner.motion import TipPath, Trajectory, drive_of, time_way
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.search.blending import blend
from backhoe_planner.planning.search.motion_check import MotionCheck
from backhoe_planner.planning.search.sampling import JointPath, sample_path
from backhoe_planner.planning.search.shortening import shorten
from backhoe_planner.planning.world.world import World

_SPARES = (0.01, 0.002)  # m kept beyond every clearance; chosen: the second is used if the first finds nothing
_TUBES = (0.25, 0.6, 1.5)  # m that a detour may go off the path, added to half of the length that it leaves out; chosen
_DETOURS = 4  # of which the shortest is used; chosen
_TUBE_PART, _FREE_PART = 8, 2  # parts of `Effort.motions_per_search` for a detour in a tube, and one without; chosen


def find_transit(world: World, stepper: Stepper, goals: Sequence[Vector]) -> Stepper | str:
    """A motion from rest to one of several configurations.

    Parameters
    ----------
    stepper: a motion that is at rest; it stays as it is.
    goals: (n,) each [rad or m].

    Returns
    -------
    The motion, at rest on one of the goals; if no route was found, what was tried, in words.

    Raises
    ------
    OutOfTime: the budget is used up.
    """
    if not len(goals):
        return "there is no configuration to move to"
    work = world.work
    before = work.motions
    for spare in _SPARES:
        check = MotionCheck(
            world.problem, world.proximity, [stepper.q, *goals], spare=spare, time=stepper.time, brake=work.brake
        )
        path = sample_path(check, stepper.q, goals, seed=world.seed, work=work)
        if path is not None:
            branch = stepper.branch(attempt=stepper.attempt + 1)
            branch.play(_timed(check, shorten(check, path, seed=world.seed)))
            return branch
    return f"none of the {before - work.motions:,} motions that were sampled leads there"


def find_detour(
    world: World, path: TipPath, start: Vector, end: Vector, low: float, high: float, *, time: float
) -> Matrix | None:
    """(K, n) corners of a route off a path from arc length `low` to `high` [m], near it if possible; None if none.

    Parameters
    ----------
    start, end: (n,) joints with the tip on the path at `low` and `high` [rad or m].
    time: at which the positions of the obstacles are taken [s].
    """
    work = world.work
    for tube in (*_TUBES, np.inf):
        bounded = np.isfinite(tube)
        check = MotionCheck(
            world.problem, world.proximity, [start, end], spare=_SPARES[1], time=time, brake=work.brake,
            near=_near(world, path, low, high, tube + 0.5 * (high - low)) if bounded else None,
        )  # fmt: skip
        most = work.effort.motions_per_search // (_TUBE_PART if bounded else _FREE_PART)
        found: list[JointPath] = []
        for seed in range(world.seed, world.seed + _DETOURS):
            way = sample_path(check, start, [end], seed=seed, work=work, most_motions=most)
            if way is None:
                break
            found.append(shorten(check, way, seed=seed))
            if len(found[-1].q) == 2:
                break
        if found:
            return min(found, key=lambda way: way.length(world.problem.limits)).q
    return None


def play(
    world: World, stepper: Stepper, path: JointPath, *, slowed: Callable[[Trajectory], Trajectory] | None = None
) -> None:
    """Append to a motion a joint path that begins where the motion ends, with rounded corners.

    Parameters
    ----------
    slowed: gives the motion in place of the fastest one along the joint path.
    """
    ends = [path.q[0], path.q[-1]]
    motion = _timed(MotionCheck(world.problem, world.proximity, ends, spare=_SPARES[1], time=stepper.time), path)
    stepper.play(motion if slowed is None else slowed(motion))


def _timed(check: MotionCheck, path: JointPath) -> Trajectory:
    """The fastest motion along a joint path with rounded corners."""
    return time_way(blend(check, path), check.problem.limits, drive=drive_of(check.problem))


def _near(world: World, path: TipPath, low: float, high: float, reach: float) -> Callable[[Matrix], bool]:
    """The condition that the tip is within `reach` [m] of the path between two arc lengths [m], at all q (B, n)."""
    kinematics = BatchKinematics(world.problem.robot)
    marks = path.stations[(path.stations > low) & (path.stations < high)]
    corners = np.array([path(float(s)) for s in (low, *marks, high)])
    steps = np.diff(corners, axis=0)
    squares = np.maximum(np.einsum("ki,ki->k", steps, steps), 1e-18)

    def near(q: Matrix) -> bool:
        off = kinematics.tip_positions(q)[:, None] - corners[:-1]
        part = np.clip(np.einsum("bki,ki->bk", off, steps) / squares, 0.0, 1.0)
        off -= part[:, :, None] * steps
        return bool(np.max(np.min(np.einsum("bki,bki->bk", off, off), axis=1)) <= reach * reach)

    return near
