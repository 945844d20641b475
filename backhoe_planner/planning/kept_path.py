"""A path with the conditions that `keep` adds along it.

A condition is written into every waypoint that leaves it open, so that everything that
follows the path keeps the condition. A cone of orientations is written there, as its middle, only for
a machine that can take any orientation at a position, and only in one of two plans: the other uses the whole cone,
as all plans of other machines do (`paths.kept_cones`). The certificate judges by the path as it was given.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Robot
from backhoe_planner.motion import (
    KEPT_TO,
    Condition,
    Cone,
    HeightBound,
    Keep,
    PitchBand,
    Problem,
    RotationCone,
    TipPath,
)
from backhoe_planner.planning.world.contradictions import find_contradiction
from backhoe_planner.planning.world.outcome import Outcome, rest_at_start
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import Waypoint

_SPARE = 1e-3  # rad kept inside the band at either end; chosen, ten times what rounded corners were seen to use
_OFF = 0.5  # part of a path's tolerance of its angles, by which they are turned into a cone at most; chosen
_WHOLE_POSE = 6  # dimensions of position and orientation
_PITCHED = 4  # joints: an arm with so many or fewer has only single configurations at a position with a pitch
_TURNED = 5  # joints: an arm with so many or fewer may be unable to take an orientation at a position
_STARTS = 60  # starting points of the inverse kinematics of a waypoint; chosen
_LOOKS = 8  # configurations at which the rank of the Jacobian is looked at; chosen, as it is lower only at a few
_RANK = 1e-6  # singular values of a Jacobian [1, m] below this count as 0; chosen far above rounding
_MOST_WAYPOINTS = 32  # at which configurations are looked for; chosen: each takes some 10 ms


def narrow_path(problem: Problem, *, in_middle: bool = False) -> Problem:
    """The problem with the kept conditions written into the path's waypoints; the problem itself if there are none.

    Parameters
    ----------
    in_middle: whether the middle of a cone of orientations is written there too.
    """
    path, keep = problem.path, problem.keep
    if path is None or keep is None:
        return problem
    spare = _turn_off_rims(problem, path, keep)
    asked = [_narrow(keep, waypoint, in_middle=in_middle, spare=spare) for waypoint in path.waypoints]
    numbers = [path.number(index) for index in range(len(asked))]
    return replace(problem, path=TipPath(asked, numbers=numbers))


def in_middle_of_cone(problem: Problem) -> Problem | None:
    """The problem with the tip in the middle of the cone of orientations to be kept, all along the path.

    None if there is no cone, all waypoints give an orientation or a pitch, or the machine cannot take any orientation.
    """
    path, keep = problem.path, problem.keep
    if path is None or keep is None or not any(isinstance(one, RotationCone) for one in keep.cones):
        return None
    if all(waypoint.rotation is not None or waypoint.pitch is not None for waypoint in path.waypoints):
        return None
    return narrow_path(problem, in_middle=True) if _takes_any_orientation(problem.robot) else None


def waypoint_breaks_keep(world: World, path: TipPath) -> Outcome | None:
    """The outcome for conditions that contradict each other, or for the first waypoint at which one cannot hold.

    None if there is neither.
    """
    keep = world.problem.keep
    if keep is None:
        return None
    start = world.problem.start_q
    contradiction = find_contradiction(keep, world.problem.limits, [] if start is None else [start])
    if contradiction:
        return _breaks_keep(world, contradiction)
    tried = np.linspace(0, len(path.waypoints) - 1, min(len(path.waypoints), _MOST_WAYPOINTS)).astype(int).tolist()
    for index, waypoint in enumerate(path.waypoints):
        what = f"waypoint {path.number(index)} of the path"
        for condition in keep.conditions:
            value = _given_value(keep, condition, waypoint)
            if value is not None and float(condition.margins(np.array([value]))[0]) < -KEPT_TO:
                return _breaks_keep(world, f"at {what} {condition.describe(value)}")
        nearest = _nearest_posture(world, keep, waypoint) if keep.cones and index in tried else None
        if nearest is not None and not keep.holds(nearest):
            return _breaks_keep(world, f"no posture was found at {what} that keeps it: at best {keep.broken(nearest)}")
    return None


def _breaks_keep(world: World, message: str) -> Outcome:
    return Outcome(rest_at_start(world, world.problem.robot.middle), "goal_breaks_keep", message)


def _given_value(keep: Keep, condition: Condition, waypoint: Waypoint) -> float | None:
    """The value of a condition that a waypoint gives; of its pitches, the one with the most margin; None if it is open.

    A waypoint gives its height. It gives the angle of a cone by a full orientation. It gives the
    pitch only if none of its pitches is within the band.
    """
    if isinstance(condition, HeightBound):
        return waypoint.position[2]
    if isinstance(condition, Cone) and waypoint.rotation is not None:
        return float(condition.angles(waypoint.rotation[None])[0])
    if isinstance(condition, PitchBand) and keep.narrowed(waypoint.target) is None:
        assert waypoint.pitch_range is not None
        ends = condition.counted(np.array(waypoint.pitch_range))
        return float(ends[int(np.argmin(np.abs(ends)))])
    return None


def _nearest_posture(world: World, keep: Keep, waypoint: Waypoint) -> Vector | None:
    """(n,) the configuration found on a waypoint that comes nearest to what is kept; None if that says nothing.

    It says nothing if no configuration was found, and for an arm whose joints leave so much open at the waypoint that
    a few random configurations on it are not all that there are.
    """
    if waypoint.rotation is not None or world.problem.robot.n > (_PITCHED if waypoint.pitch is not None else _TURNED):
        return None
    start = world.problem.start_q
    if start is not None and _stands_on(world, start, waypoint):
        return start
    nearest: Vector | None = None
    narrowed = (keep.narrowed(waypoint.target, to_the_rim=to_the_rim) for to_the_rim in (False, True))
    for target in filter(None, (*narrowed, waypoint.target)):
        found = world.postures.anywhere(target, count=_STARTS)
        nearest = max(found, key=lambda q: float(np.min(keep.margins(q))), default=None)
        if nearest is not None and keep.holds(nearest):
            break
    return nearest


def _stands_on(world: World, start: Vector, waypoint: Waypoint) -> bool:
    """Whether the machine keeps the conditions at the start (n,), and stands on a waypoint there."""
    path, keep = world.problem.scene.task.path, world.problem.keep
    if path is None or keep is None or not keep.holds(start):
        return False
    position, angle = waypoint.target.distances(world.kinematics.at(start))
    return position <= path.tolerance and angle <= path.rotation_tolerance


def _narrow(keep: Keep, waypoint: Waypoint, *, in_middle: bool, spare: float) -> Waypoint:
    if waypoint.rotation is not None:
        return _off_the_rim(keep, waypoint, spare)
    narrowed = keep.narrowed(waypoint.target)
    if narrowed is not None and narrowed.pitch is not None:
        low, high = narrowed.pitch
        spare = min(_SPARE, 0.5 * (high - low))
        return Waypoint(position=waypoint.position, pitch=_one_turn(low + spare, high - spare))
    cone = next((one for one in keep.conditions if isinstance(one, RotationCone)), None)
    if cone is not None and waypoint.pitch is None and in_middle:
        return _turned(waypoint, cone.rotation)
    return waypoint


def _turn_off_rims(problem: Problem, path: TipPath, keep: Keep) -> float:
    """By how much poses of a path that are on the rim of a cone may be turned into it [rad].

    0 for a machine that cannot take any orientation: it could not take the turned pose at the same position.
    """
    posed = bool(keep.cones) and any(waypoint.rotation is not None for waypoint in path.waypoints)
    if not posed or not _takes_any_orientation(problem.robot):
        return 0.0
    given = problem.scene.task.path
    return _SPARE if given is None else min(_SPARE, _OFF * given.rotation_tolerance)


def _off_the_rim(keep: Keep, waypoint: Waypoint, spare: float) -> Waypoint:
    """The waypoint, turned into the cones to be kept by at most `spare` [rad], if it is on the rim of one."""
    assert waypoint.rotation is not None
    rotation = waypoint.rotation
    for cone in keep.cones if spare > 0.0 else ():
        turn = cone.turns(rotation[None])[0]
        angle = float(np.linalg.norm(turn))
        by = min(angle - cone.usable + spare, spare + KEPT_TO, angle)
        if by > 0.0 and angle <= cone.usable + KEPT_TO:
            rotation = pin.exp3(turn * (by / angle)) @ rotation
    return waypoint if rotation is waypoint.rotation else _turned(waypoint, rotation)


def _turned(waypoint: Waypoint, rotation: Matrix) -> Waypoint:
    """A waypoint at the same position with an orientation (3, 3)."""
    turned = pin.Quaternion(rotation)
    return Waypoint(position=waypoint.position, quaternion=(turned.w, turned.x, turned.y, turned.z))


def _takes_any_orientation(robot: Robot) -> bool:
    """Whether a machine can take any orientation at a position: six joints may all turn the tip about two axes."""
    rng = np.random.default_rng(0)
    q = np.array([robot.random_q(rng) for _ in range(_LOOKS)])
    at = BatchKinematics(robot).at(q)
    J = np.concatenate((at.position_jacobian(), at.rotation_jacobian()), axis=1)
    return int(np.max(np.linalg.matrix_rank(J, tol=_RANK))) == _WHOLE_POSE


def _one_turn(low: float, high: float) -> tuple[float, float]:
    """The same pitch range, with its middle within half a turn of 0."""
    turns = 2.0 * np.pi * round(0.5 * (low + high) / (2.0 * np.pi))
    return low - turns, high - turns
