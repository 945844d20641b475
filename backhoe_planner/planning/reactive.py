"""Planning with the completed law: step by step, with nothing but what is near.

A goal is first approached with the tip straight for it. Where the tip's own way is
blocked, it circulates along the surface of what blocks it, in each sense in turn.
Where that does not arrive either, the joints are sent towards configurations that put
the tip on the goal. The first attempt that arrives ends the search.
"""

from __future__ import annotations

import time as clock
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine.kinematics import Configuration
from backhoe_planner.machine.robot import JointLimits
from backhoe_planner.machine.target import TipTarget, movable_rows
from backhoe_planner.planning.stepping import Stepper
from backhoe_planner.redundancy.completed import CompletedLaw
from backhoe_planner.site.proximity import Nearby

__all__ = ["Attempt", "approach_goal"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_ARRIVED = 2e-5  # m and rad
_LONGEST = 60.0  # s of motion per attempt
_PATIENCE = 1.5  # s without progress after which an attempt counts as stuck
_PROGRESS = 0.002  # m (or rad) that counts as progress
_BRAKING_PART = 0.6  # of the acceleration is planned with while slowing down
_SETTLE = 4.0  # 1/s, slowest mode at the end of a motion


@dataclass(frozen=True)
class Attempt:
    """One try at a goal.

    Attributes
    ----------
    arrived: the tip is on the goal, at rest.
    stepper: the motion that was made.
    distance: of the tip from the goal at the end [m].
    blocker: (link, obstacle) that held the motion back at the end, if any.
    way: how it was tried, in words.
    """

    arrived: bool
    stepper: Stepper
    distance: float
    blocker: tuple[str, str] | None
    way: str


Sense = tuple[float, float, float]


def approach_goal(
    stepper: Stepper,
    goal: TipTarget,
    configurations: Sequence[Vector],
    *,
    deadline: float,
    all_ways: bool = False,
) -> Iterator[Attempt]:
    """Attempts to bring the tip to `goal`, the simplest first; ends once one arrives.

    Parameters
    ----------
    stepper: a motion that is at rest; every attempt is a branch of it.
    configurations: (n,) known to put the tip on the goal, the preferred one first.
    deadline: on `time.monotonic`, after which no further attempt is begun.
    all_ways: go on after an attempt that arrives, for whoever wants another one.
    """
    at, _ = stepper.look()
    ways: list[tuple[str, Vector | None, Sense | None]] = [("straight", None, None)]
    ways += [(f"circulating about {sense}", None, sense) for sense in _senses(at)]
    ways += [(f"to posture {index}", q, None) for index, q in enumerate(configurations, start=1)]
    for number, (name, posture, sense) in enumerate(ways, start=1):
        branch = stepper.branch(attempt=number)
        if posture is None:
            attempt = _drive_tip(branch, goal, sense, name, deadline)
        else:
            attempt = _drive_joints(branch, posture, goal, name, deadline)
        yield attempt
        if (attempt.arrived and not all_ways) or clock.monotonic() > deadline:
            return


def _senses(at: Configuration) -> list[Sense]:
    """Axes about which the tip may circulate: the plane's normal, else three of space."""
    rows = movable_rows(at.jacobian[:3])
    if not rows[2]:
        return [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
    return [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0)]


# --- moving the tip ---------------------------------------------------------------


def _drive_tip(stepper: Stepper, goal: TipTarget, sense: Sense | None, way: str, deadline: float) -> Attempt:
    problem = stepper.problem
    law = CompletedLaw(problem.robot, influence=problem.scene.influence)
    progress = _Progress()
    turning = _Turning(sense)
    arrived = False
    begun = stepper.time
    while stepper.time < begun + _LONGEST and clock.monotonic() < deadline:
        at, nearby = stepper.look()
        error, J = _task(goal, at)
        left = float(np.linalg.norm(error))
        if left < _ARRIVED and stepper.stopped():
            stepper.stop()
            arrived = True
            break
        wished = turning.direction(error, nearby, stepper, left)
        xdot = wished * _pace(problem.limits, law, J, wished)
        wish = law.wish(at, J, xdot, nearby)
        fade = min(1.0, left / 0.05)
        if not stepper.advance(_within_rates(wish.primary + fade * wish.null, problem.limits), nearby, at.jacobian[:3]):
            break
        if progress.stuck(left, stepper.time, patience=turning.patience):
            if not turning.begin(error, nearby, stepper, left):
                break
            progress = _Progress()
    return _attempt(stepper, goal, arrived, way)


def _task(goal: TipTarget, at: Configuration) -> tuple[Vector, Matrix]:
    """Error and Jacobian of the rows that joints can move and that are not yet satisfied."""
    error, J = goal.error(at), goal.jacobian(at)
    rows = movable_rows(J)
    if goal.pitch is not None and goal.rotation is None and error[3] == 0.0 and goal.pitch[1] > goal.pitch[0]:
        rows = rows & np.array([True, True, True, False])
    return error[rows], J[rows]


def _pace(limits: JointLimits, law: CompletedLaw, J: Matrix, error: Vector) -> float:
    """1/s by which `error` is to shrink: as fast as every joint can, and can still brake."""
    dq = np.abs(J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(len(J)), error)) + 1e-9
    rate = limits.velocity / dq
    braking = np.sqrt(2.0 * _BRAKING_PART * limits.acceleration / dq)
    return float(min(np.min(rate), np.min(braking), _SETTLE))


def _within_rates(v: Vector, limits: JointLimits) -> Vector:
    """`v` slowed, not bent, until every joint is within its rate."""
    ratio = float(np.max(np.abs(v) / limits.velocity))
    return v / ratio if ratio > 1.0 else v


class _Progress:
    """Notices when the remaining distance has stopped falling."""

    def __init__(self) -> None:
        self._best = np.inf
        self._since = 0.0

    def stuck(self, left: float, time: float, *, patience: float = _PATIENCE) -> bool:
        if left < self._best - _PROGRESS:
            self._best, self._since = left, time
        return time - self._since > patience


class _Turning:
    """The circulation term: along the surface of what blocks the way.

    It begins where the straight way is stuck, and ends where the tip is nearer to the
    goal than it was there and the way to the goal points away from the surface.
    """

    _HOLD = 0.4  # s: a surface just left still counts

    def __init__(self, sense: Sense | None) -> None:
        self._sense = None if sense is None else np.array(sense)
        self._hit: float | None = None
        self._normal: Vector | None = None
        self._touched = 0.0
        self.patience = _PATIENCE

    def begin(self, error: Vector, nearby: Nearby, stepper: Stepper, left: float) -> bool:
        """Start to circulate; False where there is no sense, or it was tried in vain."""
        if self._sense is None or self._hit is not None:
            return False
        normal = _blocking_normal(nearby, stepper)
        if normal is None:
            return False
        self._hit, self._normal = left, normal
        self._touched = stepper.time
        self.patience = 8.0
        return True

    def direction(self, error: Vector, nearby: Nearby, stepper: Stepper, left: float) -> Vector:
        """(m,) where to go: the error itself, or along the surface while circulating."""
        if self._hit is None or self._sense is None:
            return error
        normal = _blocking_normal(nearby, stepper)
        if normal is not None:
            self._normal, self._touched = normal, stepper.time
        assert self._normal is not None
        toward = error[:3] if len(error) >= 3 else np.array([*error, 0.0])
        leaving = left < self._hit - 0.02 and (
            normal is None or float(toward @ normal) <= 0.0 or stepper.time - self._touched > self._HOLD
        )
        if leaving:
            self._hit, self._normal = None, None
            self.patience = _PATIENCE
            return error
        along = np.cross(self._normal, self._sense)
        length = float(np.linalg.norm(along))
        if length < 1e-6:
            return error
        # towards the surface a little, so as not to lose it
        bent = along / length + 0.3 * self._normal
        found = np.array(error)
        size = max(float(np.linalg.norm(toward)), 0.3)
        found[: min(len(error), 3)] = size * bent[: min(len(error), 3)]
        return found


def _blocking_normal(nearby: Nearby, stepper: Stepper) -> Vector | None:
    """(3,) mean direction into what the shield is held back by; None if by nothing."""
    shielded = stepper.shielded
    if shielded is None or len(shielded.binding) == 0 or len(nearby) == 0:
        return None
    close = nearby.margin < 0.1
    if not np.any(close):
        return None
    weight = 1.0 / (np.maximum(nearby.margin[close], 0.0) + 0.01)
    mean = weight @ nearby.normal[close]
    length = float(np.linalg.norm(mean))
    return mean / length if length > 1e-9 else None


# --- moving the joints --------------------------------------------------------------


def _drive_joints(stepper: Stepper, posture: Vector, goal: TipTarget, way: str, deadline: float) -> Attempt:
    problem = stepper.problem
    limits = problem.limits
    free_tip = np.zeros((3, problem.robot.n))
    progress = _Progress()
    arrived = False
    begun = stepper.time
    while stepper.time < begun + _LONGEST and clock.monotonic() < deadline:
        _, nearby = stepper.look()
        dq = posture - stepper.q
        left = float(np.max(np.abs(dq)))
        if left < _ARRIVED and stepper.stopped():
            stepper.stop()
            arrived = True
            break
        size = np.abs(dq) + 1e-9
        pace = min(
            float(np.min(limits.velocity / size)),
            float(np.min(np.sqrt(2.0 * _BRAKING_PART * limits.acceleration / size))),
            _SETTLE,
        )
        if not stepper.advance(pace * dq, nearby, free_tip) or progress.stuck(left, stepper.time):
            break
    return _attempt(stepper, goal, arrived, way)


def _attempt(stepper: Stepper, goal: TipTarget, arrived: bool, way: str) -> Attempt:
    if not arrived:
        stepper.stop()
    at, nearby = stepper.look()
    blocker = None
    if len(nearby):
        pair = stepper.pair(int(nearby.pair[int(np.argmin(nearby.margin))]))
        blocker = (pair.link, pair.obstacle)
    return Attempt(arrived, stepper, goal.distances(at)[0], blocker, way)
