"""The proof of a plan's track: of the plan as it is followed, among the obstacles that are there now.

A certificate is about the straight lines between the samples of a plan. The reference rounds the corners between these
lines off. Where the certificate's margins are larger than that takes, nothing more is to be proven; otherwise the
reference itself is, in pieces that are nearly straight. If obstacles are added or moved later, the rest of the
reference is proven among these.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.live.reference import Reference
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.live.servo.track import Track
from backhoe_planner.machine import Robot, travel_bounds
from backhoe_planner.motion import Problem, Trajectory, chord_sagitta
from backhoe_planner.planning import Plan
from backhoe_planner.proof import TOUCH, segment_is_clear
from backhoe_planner.site import Obstacle, Obstruction, Proximity

_PARTS = 4  # of the time between two samples, in which the reference is proven; a piece is 1/16 as far off its line
_WITHIN = 2.0 * TOUCH  # m below its clearance at which a motion still counts as keeping it, as in a certificate
_DEPTH = 9  # halvings of a piece in a proof
_BREAK = 0.2  # s between two proofs while the surroundings change; chosen


@dataclass(frozen=True, eq=False)
class RestQuery:
    """The input of `rest_is_clear`; it can be sent to another process.

    Attributes
    ----------
    reference: its clock is where the rest begins.
    legs: the machine and the samples (K,) [s] of each leg, or of the whole motion, on the reference's clock.
    obstacles: to keep clear of; they stand still.
    """

    reference: Reference
    legs: tuple[tuple[Robot, Vector], ...]
    obstacles: tuple[Obstacle, ...]


def rest_is_clear(query: RestQuery) -> bool:
    """Whether the rest of a reference is proven clear of obstacles; of the machine itself nothing is proven."""
    return all(
        _pieces_are_clear(robot, Proximity(robot, query.obstacles, self_collision=False), query.reference, time)
        for robot, time in query.legs
        if time[-1] > query.reference.clock
    )


class TrackProof:
    """Says for which surroundings a plan's track is proven, by its `revision`.

    Parameters
    ----------
    servo: its surroundings are those of the proof.
    plan: a plan, or a trajectory alone, of which nothing is proven.
    reference, track: of that plan.
    """

    def __init__(self, servo: Servo, plan: Plan | Trajectory, reference: Reference, track: Track) -> None:
        self._servo, self._track, self._reference = servo, track, reference
        self._plan = plan if isinstance(plan, Plan) and _is_proven(plan, reference) else None
        self._asked, self._again_at = -1, 0.0
        if self._plan is not None and servo.revision == servo.revision_of_scene:
            track.revision = servo.revision

    def follow_leg(self, before: int) -> None:
        """Note that a leg's own obstacles came or went; `before` is the servo's revision before that."""
        if self._track.revision == before:  # each leg is proven with its own obstacles
            self._track.revision = self._servo.revision

    def query(self) -> RestQuery | None:
        """What is to be proven now, because the surroundings have changed; None if nothing is."""
        servo, plan = self._servo, self._plan
        revision = servo.revision
        if plan is None or revision in (self._track.revision, self._asked):
            return None
        if servo.is_moving() or servo.time < self._again_at:
            return None
        self._again_at = servo.time + _BREAK
        new = tuple(self._new_obstacles(plan))
        if not new:
            self._track.revision = revision
            return None
        self._asked = revision
        legs = [(leg.problem.robot, leg.begins + leg.trajectory.time) for leg in plan.legs]
        return RestQuery(copy(self._reference), tuple(legs) or ((plan.robot, plan.trajectory.time),), new)

    def take(self, *, clear: bool, revision: int) -> None:
        """Take the answer to a query that was asked at a `revision` of the surroundings."""
        if clear and revision == self._servo.revision:
            self._track.revision = revision

    def _new_obstacles(self, plan: Plan) -> Iterator[Obstacle]:
        """The obstacles that are there now and are not the plan's, or no longer where they were."""
        planned = {one.name: one.spec for one in plan.problem.obstacles}
        for one in self._servo.snapshot():
            if one.spec != planned.get(one.name) or self._servo.shift_of(one.name).any():
                yield one


def _is_proven(plan: Plan, reference: Reference) -> bool:
    """Whether a plan is verified, stands among obstacles that stay as they are, and its reference is proven clear.

    Obstacles that are present in some legs only may come and go with these.
    """
    changes = any(one.moves or one.appears_at > 0.0 for one in plan.problem.obstacles)
    if changes or not (plan.verified and reference.keeps_limits):
        return False
    if not plan.legs:
        return _is_clear(plan.problem, plan.trajectory, plan.certificate.clearances, reference, begins=0.0)
    return all(
        _is_clear(leg.problem, leg.trajectory, leg.certificate.clearances, reference, begins=leg.begins)
        for leg in plan.legs
    )


def _is_clear(
    problem: Problem, motion: Trajectory, clearances: Sequence[Obstruction], reference: Reference, *, begins: float
) -> bool:
    """Whether the reference keeps the clearances along a motion that begins at `begins` on its clock [s].

    clearances: those that are proven for the motion, the tightest first.
    """
    time = np.sort(np.concatenate((motion.time, 0.5 * (motion.time[1:] + motion.time[:-1]))))
    off = np.abs([reference.at(begins + moment) for moment in time.tolist()] - motion.at(time))
    travel = travel_bounds(problem.robot)
    if not clearances or float((off @ travel.T).max(initial=0.0)) <= clearances[0].margin:
        return True
    proximity = Proximity(problem.robot, problem.obstacles)
    return _pieces_are_clear(problem.robot, proximity, reference, begins + motion.time)


def _pieces_are_clear(robot: Robot, proximity: Proximity, reference: Reference, time: Vector) -> bool:
    """Whether the rest of a reference between the samples at `time` (K,) [s] on its clock is proven clear."""
    fine = np.interp(np.arange(_PARTS * (len(time) - 1) + 1) / _PARTS, np.arange(len(time)), time)
    fine = np.concatenate(([max(reference.clock, time[0])], fine[fine > reference.clock]))
    places: Matrix = np.array([reference.at(moment) for moment in fine.tolist()])
    off = travel_bounds(robot) @ chord_sagitta(robot.limits)
    spare = float(off.max(initial=0.0)) / _PARTS**2 - _WITHIN
    return all(segment_is_clear(proximity, a, b, depth=_DEPTH, spare=spare) for a, b in pairwise(places))
