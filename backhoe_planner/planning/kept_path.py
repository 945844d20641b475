"""A path with the conditions that `keep` adds along it.

Each condition is written into every waypoint that leaves it open, so that everything that
follows the path keeps the condition. The certificate judges by the path as it was given.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from backhoe_planner.motion import HeightBound, Keep, PitchBand, Problem, RotationCone, TipPath
from backhoe_planner.planning.world.outcome import Outcome, rest_at_start
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import Waypoint

_SPARE = 1e-3  # rad kept inside the band at either end; chosen, ten times what rounded corners were seen to use
_WHOLE_POSE = 6  # joints: an arm with so many or more can take any orientation at a position


def narrow_path(problem: Problem) -> Problem:
    """The problem with the kept conditions written into the path's waypoints; the problem itself if there are none."""
    path, keep = problem.path, problem.keep
    if path is None or keep is None:
        return problem
    asked = [_narrow(keep, waypoint, problem.robot.n) for waypoint in path.waypoints]
    numbers = [path.number(index) for index in range(len(asked))]
    return replace(problem, path=TipPath(asked, numbers=numbers))


def waypoint_breaks_keep(world: World, path: TipPath) -> Outcome | None:
    """The outcome for the first waypoint at which a kept condition cannot hold; None if there is none."""
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
    """The same pitch range, with its middle within half a turn of 0."""
    turns = 2.0 * np.pi * round(0.5 * (low + high) / (2.0 * np.pi))
    return low - turns, high - turns
