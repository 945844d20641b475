"""The proof of a plan's track: of the plan as it is followed, among the obstacles that are there now.

A certificate is about the straight lines between the samples of a plan. The reference rounds the corners between these
lines off. Where the certificate's margins are larger than that takes, nothing more is to be proven; otherwise the
reference itself is, in pieces that are nearly straight. Whatever of the obstacles that are there is not, by its
shape and place, the plan's own in the present leg counts as new, and the rest of the reference is proven among these.
Between two steps the machine moves straight on, which takes it off a curve: that counts as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.live.detours.reference import Reference
from backhoe_planner.live.detours.searches import Searches
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.live.servo.track import Track
from backhoe_planner.machine import Cluster, Piece, Robot, travel_bounds
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.planning import Plan, PlannedLeg
from backhoe_planner.proof import TOUCH, segment_is_clear
from backhoe_planner.site import Obstacle, Obstruction, Proximity

_PARTS = 4  # of the time between two samples, in which the reference is proven; a piece is 1/16 as far off its line
_WITHIN = 2.0 * TOUCH  # m below its clearance at which a motion still counts as keeping it, as in a certificate
_DEPTH = 9  # halvings of a piece in a proof
ROOM = 0.1  # m beyond every clearance that is enough for a detour to begin with; measured: more changes little
_BREAK = 0.2  # s between two proofs while the surroundings change; chosen

_Shape: TypeAlias = tuple[bytes, ...]


@dataclass(frozen=True, eq=False)
class RestQuery:
    """The input of `prove_rest`; it can be sent to another process.

    Attributes
    ----------
    reference: its clock is where the rest begins.
    legs: the machine and the samples (K,) [s] of each leg, or of the whole motion, on the reference's clock.
    obstacles: to keep clear of; they stand still.
    dt: length of a step, in which the machine moves straight on [s].
    """

    reference: Reference
    legs: tuple[tuple[Robot, Vector], ...]
    obstacles: tuple[Obstacle, ...]
    dt: float


@dataclass(frozen=True, eq=False)
class Blockage:
    """Where the rest of a reference is not proven clear of an obstacle, and how much room there is before.

    Attributes
    ----------
    begins: the first time on the reference's clock from which it is not proven clear [s].
    name: of the obstacle that is nearest there.
    ends: whether there is a clear place behind it on the same leg.
    time: (K,) of places before, as far back as there is less than `ROOM` and the first with so much, rising [s].
    margin: (K,) the distance beyond the obstacles' clearances at these places [m].
    """

    begins: float
    name: str
    ends: bool
    time: Vector
    margin: Vector


@dataclass(frozen=True, eq=False)
class RestProof:
    """The answer to a `RestQuery`: the rest is proven clear if there is no blockage."""

    blockage: Blockage | None


def prove_rest(query: RestQuery) -> RestProof:
    """Prove the rest of a reference clear of obstacles; of the machine itself nothing is proven."""
    for robot, time in query.legs:
        if time[-1] > query.reference.clock:
            proximity = Proximity(robot, query.obstacles, self_collision=False)
            begins = _clear_until(robot, proximity, query.reference, time, query.dt)
            if begins is not None:
                return RestProof(_blockage(proximity, query.reference, time, begins))
    return RestProof(None)


def _blockage(proximity: Proximity, reference: Reference, time: Vector, begins: float) -> Blockage:
    """The blockage of a leg with samples at `time` (K,) [s] that is proven clear until `begins` [s]."""

    def tightest(moment: float) -> Obstruction:
        found = proximity.tightest(reference.at(moment))
        assert found is not None  # without obstacles there is no blockage
        return found

    places: list[tuple[float, float]] = []
    first = max(reference.clock, float(time[0]))
    before = time[(time > first) & (time < begins)]
    for moment in (begins, *before[::-1].tolist(), *([first] if first < begins else [])):
        places.append((moment, tightest(moment).margin))
        if places[-1][1] >= ROOM:
            break
    following = time[time > begins].tolist()
    inside = min((tightest(moment) for moment in (begins, *following[:1])), key=lambda found: found.margin)
    ends = any(tightest(moment).margin >= 0.0 for moment in following[1:])
    rising = np.array(places[::-1])
    return Blockage(begins, inside.name, ends, rising[:, 0], rising[:, 1])


class TrackProof:
    """Proves a plan's track, and says in the track itself for which surroundings and load it is proven.

    Parameters
    ----------
    servo: its surroundings and its load are those of the proof.
    plan: a plan, or a trajectory alone, of which nothing is proven.
    reference, track: of that plan.
    executor: runs the proofs, see `Searches`.

    Attributes
    ----------
    slowed_by: why a verified plan is not proven for the machine, so that it may be late, in words; otherwise empty.
    """

    def __init__(
        self, servo: Servo, plan: Plan | Trajectory, reference: Reference, track: Track, executor: Executor | None
    ) -> None:
        self._servo, self._track, self._reference = servo, track, reference
        self._proofs = Searches(executor)
        proven = isinstance(plan, Plan) and _is_proven(plan, reference, servo.dt)
        self._plan = plan if isinstance(plan, Plan) and proven else None
        self.slowed_by = ""
        if isinstance(plan, Plan) and plan.verified and not proven and not plan.problem.is_dynamic:
            self.slowed_by = (
                f"steps of {servo.dt:g} s keep too little to the plan to go as close past things at its speed"
            )
        self._leg: PlannedLeg | None = None
        self._asked, self._again_at = -1, 0.0
        self._known: dict[str, _Known] = {}
        self._shapes: dict[tuple[int, ...], tuple[tuple[Piece, ...], _Shape]] = {}  # by the identities of pieces
        self._look_again()

    def follow_leg(self, leg: PlannedLeg) -> None:
        """Note that a leg begins, with obstacles and a load of its own."""
        self._leg = leg
        self._look_again()

    @property
    def under_way(self) -> bool:
        """Whether a proof is under way."""
        return self._proofs.under_way

    def begin(self, *, steady: bool) -> None:
        """Begin a proof if the surroundings have changed, and none is under way.

        If all that is there now is the plan's own, nothing is to be proven: then the track counts as proven at once.

        Parameters
        ----------
        steady: whether nothing has changed for a while. While obstacles that move are steered, nothing is proven.
        """
        servo, plan = self._servo, self._plan
        revision = servo.revision
        if plan is None or revision in (self._track.revision, self._asked) or (servo.is_moving() and not steady):
            return
        if servo.time < self._again_at or not self._carries_the_same():
            return
        self._again_at = servo.time + _BREAK
        new = self._new_obstacles()
        if not new:
            self._prove(revision)
            return
        if self._proofs.under_way:
            return
        self._asked = revision
        legs = [(leg.problem.robot, leg.begins + leg.trajectory.time) for leg in plan.legs]
        legs = legs or [(plan.problem.robot, plan.trajectory.time)]
        query = RestQuery(copy(self._reference), tuple(legs), new, servo.dt)
        self._proofs.begin(revision, servo.time, prove_rest, query)

    def answer(self) -> RestProof | None:
        """The answer that has come now, if any.

        A blockage counts only if the surroundings are those of the proof, and no leg began since; only then does the
        track count as proven, too.
        """
        servo, answer = self._servo, self._proofs.answer(self._servo.time)
        if not isinstance(answer, RestProof):
            return None
        holds = self._proofs.revision == servo.revision == self._asked and self._carries_the_same()
        if holds and answer.blockage is None:
            self._prove(servo.revision)
        return answer if holds or answer.blockage is None else None

    def begin_again(self) -> None:
        """Note that the last proof is of no use, so that another one begins."""
        self._proofs.drop()
        self._asked = -1

    def close(self) -> None:
        """End the proofs; see `Searches.close`."""
        self._proofs.close()

    def _prove(self, revision: int) -> None:
        self._track.revision, self._track.carried = revision, self._servo.robot.carried

    def _look_again(self) -> None:
        """Compare what is there with the plan's obstacles of the present leg."""
        self._track.revision, self._asked = None, -1
        if self._plan is None:
            return
        self._known = {one.name: _Known.of(one, _shape_of(one.pieces, one.cluster)) for one in self._problem.obstacles}
        if self._carries_the_same() and not self._new_obstacles():
            self._prove(self._servo.revision)

    @property
    def _problem(self) -> Problem:
        assert self._plan is not None
        return self._plan.problem if self._leg is None else self._leg.problem

    def _carries_the_same(self) -> bool:
        """Whether the servo's load is that of the plan in the present leg."""
        if self._plan is None:
            return False
        planned, own = self._problem.robot.carried, self._servo.robot.carried
        if planned is None or own is None:
            return planned is own
        return planned[0] == own[0] and _shape_of(planned[1]) == _shape_of(own[1])

    def _new_obstacles(self) -> tuple[Obstacle, ...]:
        """The obstacles that stand there now and are not, in shape and place, those of the plan in the present leg.

        Those that move are left to the servo (`Servo.is_proven_along_unchecked`).
        """
        shapes, new = self._shapes, []
        self._shapes = {}  # of those that are gone, nothing is kept
        for one in self._servo.snapshot():
            if one.moves:
                continue
            key = tuple(map(id, one.pieces))
            kept = (shapes.get(key) if key else None) or (one.pieces, _shape_of(one.pieces, one.cluster))
            self._shapes[key], shape = kept, kept[1]  # with the pieces, so that no other ones get their identities
            if self._known.get(one.name) != _Known.of(one, shape):
                new.append(one)
        return tuple(new)


@dataclass(frozen=True)
class _Known:
    """All of an obstacle by which motions are clear of it or not.

    The solid of a cluster is known by its identity: another one with the same cells counts as new.
    """

    shape: _Shape
    solid: int
    clearance: float
    links: tuple[str, ...] | None
    velocity: tuple[float, ...]

    @classmethod
    def of(cls, one: Obstacle, shape: _Shape) -> _Known:
        solid = 0 if one.cluster is None else id(one.cluster.solid)
        return cls(shape, solid, one.clearance, one.links, tuple(map(float, one.velocity)))


def _shape_of(pieces: Sequence[Piece], cluster: Cluster | None = None) -> _Shape:
    """The shapes and placements of pieces, and the placement of a cluster; takes some 30 us for each.

    Each part by itself, as a pickle of several also says which of them are one object: a copy would be another shape.
    """
    numbers = [] if cluster is None else [cluster.placement.homogeneous]
    for piece in pieces:
        numbers += [*piece.pose, piece.hull, piece.radius]
    shapes = (piece.shape_as_bytes() for piece in pieces)
    return (*shapes, *(np.asarray(part, dtype=float).tobytes() for part in numbers))


def _is_proven(plan: Plan, reference: Reference, dt: float) -> bool:
    """Whether a plan is verified, stands among obstacles that stay as they are, and its reference is proven clear.

    Obstacles that are present in some legs only may come and go with these.
    """
    if plan.problem.is_dynamic or not (plan.verified and reference.keeps_limits):
        return False
    if not plan.legs:
        return _is_clear(plan.problem, plan.trajectory, plan.certificate.clearances, reference, dt, begins=0.0)
    return all(
        _is_clear(leg.problem, leg.trajectory, leg.certificate.clearances, reference, dt, begins=leg.begins)
        for leg in plan.legs
    )


def _is_clear(
    problem: Problem, motion: Trajectory, clearances: Sequence[Obstruction], reference: Reference, dt: float,
    *, begins: float,
) -> bool:  # fmt: skip
    """Whether the reference keeps the clearances along a motion that begins at `begins` on its clock [s].

    clearances: those that are proven for the motion, the tightest first.
    """
    time = np.sort(np.concatenate((motion.time, 0.5 * (motion.time[1:] + motion.time[:-1]))))
    off = np.abs([reference.at(begins + moment) for moment in time.tolist()] - motion.at(time))
    travel = travel_bounds(problem.robot)
    taken = (off + _off_in_a_step(problem.robot, dt)) @ travel.T
    if not clearances or float(taken.max(initial=0.0)) <= clearances[0].margin:
        return True
    proximity = Proximity(problem.robot, problem.obstacles)
    return _clear_until(problem.robot, proximity, reference, begins + motion.time, dt) is None


def _off_in_a_step(robot: Robot, dt: float) -> Vector:
    """(n,) how far a straight step of `dt` [s] is from a curve that keeps the accelerations [rad or m]."""
    return np.asarray(robot.limits.acceleration * dt**2 / 8.0)


def _clear_until(robot: Robot, proximity: Proximity, reference: Reference, time: Vector, dt: float) -> float | None:
    """Until when the rest of a reference between the samples at `time` (K,) is proven clear, on its clock [s].

    None if all of it is.

    dt: length of the straight steps along it [s].
    """
    fine = np.interp(np.arange(_PARTS * (len(time) - 1) + 1) / _PARTS, np.arange(len(time)), time)
    fine = np.concatenate(([max(reference.clock, time[0])], fine[fine > reference.clock]))
    places: Matrix = np.array([reference.at(moment) for moment in fine.tolist()])
    travel, moments = travel_bounds(robot), fine.tolist()
    for (moment, after), (a, b) in zip(pairwise(moments), pairwise(places), strict=True):
        # by this the chord between the places, and a step that overlaps it, are off the curve
        most = reference.largest_accelerations(moment - dt, after + dt)
        spare = float((travel @ (most * ((after - moment) ** 2 + dt**2) / 8.0)).max(initial=0.0)) - _WITHIN
        if not segment_is_clear(proximity, a, b, depth=_DEPTH, spare=spare):
            return float(moment)
    return None
