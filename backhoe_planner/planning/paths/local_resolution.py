"""A tip path resolved into joint positions by the completed law.

Sample by sample along the path, the law gives a desired step, `step_on_path` takes the
nearest step that stays on the path, Newton's iteration removes the remaining error, and the
step is kept only if it is proven clear. This goes as far as the law can from its start.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law import CompletedLaw, Kind, Rows, step_on_path
from backhoe_planner.machine import Configuration, Kinematics, TipTarget, movable_rows
from backhoe_planner.motion import Problem, TipPath, hand_set_gains
from backhoe_planner.planning.stretches.kept_cones import KeptCones, open_cones
from backhoe_planner.planning.stretches.stretch import Stretch
from backhoe_planner.proof import segment_is_clear
from backhoe_planner.site import Nearby, Obstruction, Proximity

_SPACING = 0.02  # m between samples at most; chosen: the law's step is linear, and this is small enough for it
_LEAST_SPACING = 1e-4  # m as which a step counts if a waypoint is there twice; chosen: small compared with `_SPACING`
_TIME_PER_METRE = 3.0  # s per m of path; chosen: the inverse of the tip's speed at which the law's rates become steps
_APPROACH = 0.4  # part of a margin that one step may use up; chosen below a half, so that steps become smaller
_SPARE = 0.001  # m kept on top of every clearance; chosen: for the error of the linearised rows
_EXACT = 1e-8  # m and rad; chosen: with less error the tip counts as on the path
_CORRECTIONS = 6  # of Newton's iteration; chosen: it doubles the digits with each
_LARGEST_STEP = 0.25  # rad or m of a joint between samples; chosen
_OPEN_RANGE = 0.02  # rad; chosen: a pitch range narrower than this counts as one angle
_AT_LIMIT = 0.01  # rad or m; chosen: a joint nearer than this is at its limit
_TOUCHING = 0.02  # m; chosen: a pair with less margin is blamed before a joint at its limit
_IN_THE_WAY = 0.1  # m; chosen: a pair with less margin is blamed if no joint is at its limit


def sample_stations(path: TipPath, s: float) -> Vector:
    """(K,) arc lengths from `s` to the end, every waypoint among them [m]."""
    marks = np.concatenate(([s], path.stations[path.stations > s + 1e-9]))
    parts = [
        np.linspace(a, b, max(int(np.ceil((b - a) / _SPACING)), 1 if b - a < 0.5 * _SPACING else 2), endpoint=False)
        for a, b in pairwise(marks.tolist())
    ]
    return np.concatenate([*parts, marks[-1:]])


def resolve_along(
    problem: Problem, path: TipPath, s: float, q: Vector, *, proximity: Proximity, kinematics: Kinematics,
    time: float = 0.0,
) -> Stretch:  # fmt: skip
    """Resolve `path` from arc length `s` [m], with the joints at `q` (n,) there, as far as the law goes.

    A cone of orientations to be kept is left only where the law cannot follow the path within it.

    Parameters
    ----------
    time: at which the positions of the obstacles are taken [s].

    Returns
    -------
    The stretch that the law resolves; its `obstruction` says what ended it before the end of the path.
    """
    law = CompletedLaw(problem.robot, influence=problem.scene.influence, gains=hand_set_gains(problem))
    stations, cones = sample_stations(path, s), open_cones(problem, path)
    found = [np.array(q, dtype=float)]
    for station in stations[1:]:
        at = kinematics.at(found[-1])
        nearby = proximity.at(at.q, time=time, margin=problem.scene.influence)
        # if a waypoint is there twice, only the tip turns, which takes some time too
        span = _TIME_PER_METRE * max(float(station - stations[len(found) - 1]), _LEAST_SPACING)
        target = path.target(float(station))
        after = None if cones is None else _next(problem, law, target, at, nearby, span, kinematics, cones)
        if after is None:
            after = _next(problem, law, target, at, nearby, span, kinematics, None)
        if after is None or not segment_is_clear(proximity, at.q, after, time=time):
            return Stretch(stations[: len(found)], np.array(found), _obstruction(problem, at, nearby, proximity))
        found.append(after)
    return Stretch(stations, np.array(found))


def _next(
    problem: Problem,
    law: CompletedLaw,
    target: TipTarget,
    at: Configuration,
    nearby: Nearby,
    span: float,
    kinematics: Kinematics,
    cones: KeptCones | None,
) -> Vector | None:
    """(n,) the configuration on `target`, within `cones`, to which the law moves from `at` in `span` [s].

    None if it is stuck.
    """
    error, J = _rows(target, at)
    limits = problem.limits
    wish = span * law.wish_unchecked(at, J, error / span, nearby).v
    low = np.maximum(limits.lower - at.q, -_LARGEST_STEP)
    high = np.minimum(limits.upper - at.q, _LARGEST_STEP)
    room = _APPROACH * np.maximum(nearby.margin - _SPARE, 0.0)
    rows = (Rows("clearance", -nearby.gradient, room, Kind.HARD), *_turn_rows(target, at, cones))
    step = step_on_path(wish, J, error=error, low=low, high=high, rows=rows)
    if step is None:
        return None
    q = at.q + step
    for _ in range(_CORRECTIONS):
        now = kinematics.at(q)
        error, J = _rows(target, now)
        if float(np.max(np.abs(error))) < _EXACT and (cones is None or bool(cones.holds_each(q[None])[0])):
            break
        low, high = limits.lower - q, limits.upper - q
        fix = step_on_path(np.zeros(len(q)), J, error=error, low=low, high=high, rows=_turn_rows(target, now, cones))
        if fix is None:
            return None
        q = q + fix
    else:
        return None
    return np.clip(q, limits.lower, limits.upper)


def _rows(target: TipTarget, at: Configuration) -> tuple[Vector, Matrix]:
    """Error and Jacobian of the rows that must be met exactly."""
    error, J = target.error(at), target.jacobian(at)
    rows = movable_rows(J)
    if has_open_range(target):
        rows = rows & np.array([True, True, True, False])
    return error[rows], J[rows]


def has_open_range(target: TipTarget) -> bool:
    """Whether a target allows a limited range of pitch, more than one angle."""
    return target.rotation is None and target.pitch is not None and target.pitch[1] - target.pitch[0] > _OPEN_RANGE


def _turn_rows(target: TipTarget, at: Configuration, cones: KeptCones | None) -> tuple[Rows, ...]:
    """The rows that keep the pitch within its range, and the orientation within `cones`."""
    rows = _pitch_rows(target, at)
    return rows if cones is None else (*rows, *cones.rows(at.q))


def _pitch_rows(target: TipTarget, at: Configuration) -> tuple[Rows, ...]:
    """The rows that keep the pitch within its range; none if the target allows one angle, or any pitch."""
    if not has_open_range(target):
        return ()
    assert target.pitch is not None
    low, high = target.pitch
    middle = 0.5 * (low + high)
    off = (at.pitch - middle + np.pi) % (2.0 * np.pi) - np.pi
    half = 0.5 * (high - low)
    row = at.pitch_row
    return (Rows("pitch", np.vstack((row, -row)), np.array([half - off, half + off]), Kind.HARD),)


def _obstruction(problem: Problem, at: Configuration, nearby: Nearby, proximity: Proximity) -> Obstruction:
    """What most likely ended the motion: the tightest pair, or the joint at its limit."""
    gap = np.minimum(at.q - problem.limits.lower, problem.limits.upper - at.q)
    joint = int(np.argmin(gap))
    if len(nearby):
        row = int(np.argmin(nearby.margin))
        if nearby.margin[row] < (_TOUCHING if gap[joint] < _AT_LIMIT else _IN_THE_WAY):
            return proximity.pairs[int(nearby.pair[row])].at(float(nearby.distance[row]))
    return Obstruction.joint_limit(problem.robot.joint_names[joint], float(gap[joint]))
