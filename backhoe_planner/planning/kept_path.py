"""A path as it is planned where something is to be kept along it.

What is to be kept is asked of every waypoint that leaves it free, so that all that follows
the path keeps it there as well. The certificate judges by the path as it was given.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from backhoe_planner.motion import HeightBound, Keep, PitchBand, Problem, RotationCone, TipPath
from backhoe_planner.planning.world.outcome import Outcome, rest_at_start
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import Waypoint

_SPARE = 1e-3  # rad kept beyond the band on either side; chosen, ten times what rounded corners were seen to take
_WHOLE_POSE = 6  # joints from which on an arm can take any orientation at a place


def narrow_path(problem: Problem) -> Problem:
    """The problem with a path on which waypoints ask for what is to be kept; itself where nothing is."""
    path, keep = problem.path, problem.keep
    if path is None or keep is None:
        return problem
    asked = [_narrow(keep, waypoint, problem.robot.n) for waypoint in path.waypoints]
    numbers = [path.number(index) for index in range(len(asked))]
    return replace(problem, path=TipPath(asked, numbers=numbers))


def waypoint_breaks_keep(world: World, path: TipPath) -> Outcome | None:
    """The first waypoint at which what is to be kept cannot be kept; None where there is none."""
    keep = world.problem.keep
    for index, waypoint in enumerate(path.waypoints if keep is not None else ()):
        assert keep is not None
        for condition in keep.conditions:
            value = None
            if isinstance(condition, HeightBound):
                value = waypoint.position[2]
            elif isinstance(condition, PitchBand) and keep.narrowed(waypoint.target) is None:
                assert waypoint.pitch_range is not None
                ends = condition.counted(np.array(waypoint.pitch_range))
                value = float(ends[int(np.argmin(np.abs(ends)))])
            if value is not None and float(condition.margins(np.array([value]))[0]) < 0.0:
                message = f"at waypoint {path.number(index)} of the path {condition.describe(value)}"
                return Outcome(rest_at_start(world, world.problem.robot.middle), "goal_breaks_keep", message)
    return None


def _narrow(keep: Keep, waypoint: Waypoint, joints: int) -> Waypoint:
    if waypoint.rotation is not None:
        return waypoint
    narrowed = keep.narrowed(waypoint.target)
    if narrowed is not None and narrowed.pitch is not None:
        low, high = narrowed.pitch
        spare = min(_SPARE, 0.5 * (high - low))
        return Waypoint(position=waypoint.position, pitch=_one_turn(low + spare, high - spare))
    cone = next((one for one in keep.conditions if isinstance(one, RotationCone)), None)
    if cone is not None and waypoint.pitch is None and joints >= _WHOLE_POSE:
        turned = pin.Quaternion(cone.rotation)
        return Waypoint(position=waypoint.position, quaternion=(turned.w, turned.x, turned.y, turned.z))
    return waypoint


def _one_turn(low: float, high: float) -> tuple[float, float]:
    """The same range of pitches, with its middle within half a turn."""
    turns = 2.0 * np.pi * round(0.5 * (low + high) / (2.0 * np.pi))
    return low - turns, high - turns
