"""A detour from where the machine is, or will rest, back onto the rest of a motion, around what is in its way now.

The rest of the motion consists of stretches that are proven clear and parts that are not.
The machine is brought to the earliest place from which it can go on: the first clear one
behind the obstacle. If a short search finds no detour to that place, longer ones search a detour
to any of the stretches, with less room to spare. The detour begins with a retreat from the obstacle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.digits import length_text
from backhoe_planner.machine import JointLimits, Robot
from backhoe_planner.motion import (
    OBJECTIVES,
    Problem,
    SmoothWay,
    Trajectory,
    append_motion,
    drive_of,
    keep_of,
    time_way,
)
from backhoe_planner.planning import (
    EFFORTS,
    Brake,
    JointPath,
    MotionCheck,
    OutOfTime,
    Work,
    blend,
    sample_path,
    shorten,
)
from backhoe_planner.proof import TOUCH, segment_is_clear
from backhoe_planner.site import Obstacle, Obstruction, Proximity, Scene

_EFFORTS = (EFFORTS["quick"], EFFORTS["normal"])  # of the sampling, at the first attempt and at later ones
# The numbers are chosen; validation/placements.py drives machines with them.
_EASY = (0.02, 0.005)  # m beyond every clearance, at the first attempt; the second if the first finds no detour
_HARD = (0.003, 0.01)  # m beyond every clearance, at later attempts, in turn
_ROOMY = 0.01  # m beyond every clearance that a place to rejoin at should have
_LOOKS = 100  # samples of a stretch among which such a place is searched
_RETREAT = _EASY[0]  # m beyond every clearance to which the machine retreats first
_RETREAT_STEP, _RETREAT_STEPS = 0.002, 30  # m by which a margin grows in a step of the retreat, and the most steps
_PAUSE = 0.02  # s at rest between the retreat and the rest of the detour
_HERE = 0.1  # rad or m within which the machine counts as being at a place
_PLACES = 6  # places on the rest of the motion that are tried
_WAYS = 3  # paths of the first attempt; the shortest is taken
_DEPTH = 9  # halvings of a segment in a proof; 512 parts
LONGEST = 25.0  # s after which an attempt is ended if its counts have not ended it: only a runaway takes so long


@dataclass(frozen=True, eq=False)
class RejoiningQuery:
    """The input of a search; it can be sent to another process.

    Attributes
    ----------
    robot, scene, limits: the machine, the site and payload, and the joint limits.
    obstacles: each where it is now; moving ones count as standing still there.
    q: (n,) configuration of the machine, at rest, or in which it will be at rest [rad or m].
    motion: the motion to be rejoined.
    since: the time along the motion that was reached [s].
    seed: of the sampling, not negative.
    attempt: number of the attempt, from 0. The first three grow more thorough; each samples anew.
    beyond: whether the detour must lead behind the first obstacle on the rest of the motion; otherwise it may also lead
        back to the motion before it.
    """

    robot: Robot
    scene: Scene
    limits: JointLimits
    obstacles: tuple[Obstacle, ...]
    q: Vector
    motion: Trajectory
    since: float
    seed: int
    attempt: int = 0
    beyond: bool = False


@dataclass(frozen=True, eq=False)
class Rejoining:
    """A motion from where the machine is, from rest to rest, to a place on the query's motion.

    Attributes
    ----------
    motion: keeps every clearance and limit of the query.
    rejoins_at: the time on the query's motion of the place where the detour ends [s].
    around: name of the obstacle in between; None if there is none.
    """

    motion: Trajectory
    rejoins_at: float
    around: str | None


@dataclass(frozen=True)
class NoRejoining:
    """The answer that no detour was found.

    Attributes
    ----------
    reason: why, in words, with the obstacle's name.
    searched: whether there is a place to go to, so that more effort may find a detour.
    """

    reason: str
    searched: bool


def find_rejoining(query: RejoiningQuery) -> Rejoining | NoRejoining:
    """Find a detour to the earliest clear place on the rest of a motion.

    The same query gives the same answer. OMPL's global seed is set.
    """
    keep = keep_of(query.robot, query.scene)
    if keep is not None and not keep.holds(query.q):
        keep = keep.widened(query.q)  # if it is already violated, the detour violates it no further
    problem = Problem(
        robot=query.robot,
        scene=query.scene,
        limits=query.limits,
        objective=OBJECTIVES["time"],
        obstacles=query.obstacles,
        start_q=query.q,
        start_target=None,
        goals=(),
        path=None,
        keep=keep,
    )
    work = Work(_EFFORTS[min(query.attempt, len(_EFFORTS) - 1)], Brake(LONGEST))
    try:
        return _Search(query, problem, work).run()
    except OutOfTime as ended:
        return NoRejoining(str(ended), searched=True)


def is_still_clear(robot: Robot, obstacles: tuple[Obstacle, ...], q: Matrix) -> bool:
    """Whether the path through `q` (K, n) provably keeps clear of `obstacles`, each where it is now."""
    proximity = _proximity_now(robot, obstacles)
    return all(segment_is_clear(proximity, a, b, depth=_DEPTH, spare=-TOUCH) for a, b in pairwise(q))


class _Search:
    def __init__(self, query: RejoiningQuery, problem: Problem, work: Work) -> None:
        self._query, self._problem, self._work = query, problem, work
        self._proximity = _proximity_now(query.robot, query.obstacles)
        later = query.motion.time > query.since + 1e-9
        self._time = np.concatenate(([query.since], query.motion.time[later]))
        self._q = np.vstack((query.motion.at(query.since)[None], query.motion.q[later]))
        self._start = query.q
        self._obstruction: Obstruction | None = None  # the first one on the rest of the motion, with its time

    def run(self) -> Rejoining | NoRejoining:
        here = self._proximity.tightest(self._query.q)
        if here is not None and here.margin < 0.0:
            check = MotionCheck(self._problem, self._proximity, [self._query.q], spare=0.0)
            if not check.ends_clear[0]:
                why = f"{here.link} is {length_text(-here.margin)} closer to {here.name} than allowed where it stands"
                return NoRejoining(why, searched=False)
        self._start = self._retreat(self._query.q)
        places = list(islice(self._places(), _PLACES if self._query.attempt else 1))
        found = self._way_to(places) if places else None
        return found or NoRejoining(self._why(here), searched=bool(places))

    def _why(self, here: Obstruction | None) -> str:
        """Why no detour was found, in words."""
        kept = "" if self._problem.keep is None else "; a way around it must satisfy `keep`"
        return f"{self._what_stands(here)}{kept}"

    def _what_stands(self, here: Obstruction | None) -> str:
        at_end, found = self._proximity.tightest(self._q[-1]), self._obstruction
        if at_end is not None and at_end.margin < -TOUCH:
            return f"{at_end.name} blocks the end of the plan; a new plan may end in another posture"
        if found is not None:
            return f"{found.name} blocks the plan from {found.time:.1f} s on, and no way around it was found"
        return "no way was found" if here is None else f"{here.link} is held back by {here.name}"

    # --- where to -------------------------------------------------------------------

    def _places(self) -> Iterator[int]:
        """Samples of the rest of the motion from which it can go on, the earliest first."""
        here = float(np.abs(self._q[0] - self._query.q).max()) < _HERE
        last = len(self._q) - 1
        yielded = -1
        for first, end in self._stretches():
            if self._query.beyond and first == 0 and end < last:
                continue
            if first == 0 and here:
                ahead = np.abs(self._q[: end + 1] - self._query.q).max(axis=1) > _HERE
                if not ahead.any():
                    if end == last:  # the end is near: no place comes after it
                        yield last
                    continue
                first = int(ahead.argmax())
            yielded = self._roomiest(first, end)
            yield yielded
            if end == last and yielded != last:
                yield last

    def _stretches(self) -> Iterator[tuple[int, int]]:
        """First and last sample of every stretch of the rest of the motion that is proven clear."""
        first = None
        last = len(self._q) - 1
        for row in range(last + 1):
            if first is None:
                if self._margin(self._q[row]) < 0.0:
                    self._note(row)
                    continue
                first = row
            leads_on = row < last and segment_is_clear(
                self._proximity, self._q[row], self._q[row + 1], depth=_DEPTH, spare=-TOUCH
            )
            if not leads_on:
                yield first, row
                first = None
                if row < last:
                    self._note(row + 1)

    def _note(self, row: int) -> None:
        """Keep the obstruction at a sample, if it is the first."""
        if self._obstruction is None:
            found = self._proximity.tightest(self._q[row])
            self._obstruction = found and replace(found, time=float(self._time[row]))

    def _roomiest(self, first: int, end: int) -> int:
        """The first sample of a stretch with enough room; if the first `_LOOKS` have none, the roomiest of them."""
        best, most = first, -np.inf
        for row in range(first, min(end, first + _LOOKS) + 1):
            margin = self._margin(self._q[row])
            if margin > most:
                best, most = row, margin
            if margin >= _ROOMY:
                break
        return best

    def _margin(self, q: Vector) -> float:
        """The smallest margin at `q` (n,) [m]."""
        tightest = self._proximity.tightest(q)
        return np.inf if tightest is None else tightest.margin

    # --- how ------------------------------------------------------------------------

    def _way_to(self, places: list[int]) -> Rejoining | None:
        query = self._query
        attempt = query.attempt
        for spare in _EASY if attempt == 0 else _HARD[(attempt - 1) % len(_HARD) :][:1]:
            ends = [self._start, *(self._q[place] for place in places)]
            check = MotionCheck(self._problem, self._proximity, ends, spare=spare, brake=self._work.brake)
            ways = self._ways(check, ends[1:])
            if ways:
                way = min(ways, key=lambda way: way.length(query.limits))
                motion = self._timed(blend(check, way))
                place = min(places, key=lambda place: float(np.abs(self._q[place] - way.q[-1]).max()))
                name = None if self._obstruction is None else self._obstruction.name
                return Rejoining(motion, float(self._time[place]), name)
        return None

    def _timed(self, way: SmoothWay) -> Trajectory:
        """The timed motion of the retreat, a pause, and the path `way`."""
        limits, drive = self._query.limits, drive_of(self._problem)
        motion = time_way(way, limits, drive=drive)
        back = np.array([self._query.q, self._start])
        if not (back[1] != back[0]).any():
            return motion
        times = np.linalg.norm(np.diff(back, axis=0) / limits.velocity, axis=1)
        first = time_way(SmoothWay(back, np.array([0.0, *times]), np.zeros(2)), limits, drive=drive)
        return append_motion(first, motion, rest=[_PAUSE])

    def _retreat(self, q: Vector) -> Vector:
        """(n,) a posture near q with more room, if q has little: there the servo only lets the machine move away."""
        proximity, limits = self._proximity, self._query.limits
        found = q
        for _ in range(_RETREAT_STEPS):
            nearby = proximity.at(found, margin=2.0 * _RETREAT)
            short = np.maximum(_RETREAT - nearby.margin, 0.0)
            if not short.any():
                break
            tightest = float(nearby.margin.min())
            away = (short @ nearby.gradient) * limits.velocity**2
            gain = float(nearby.gradient[int(nearby.margin.argmin())] @ away)
            if gain <= 0.0:
                break
            there = np.clip(found + (_RETREAT_STEP / gain) * away, limits.lower, limits.upper)
            if self._margin(there) <= tightest:
                break
            found = there
        check = MotionCheck(self._problem, proximity, [q, found], spare=0.0)
        return found if check.segment_is_clear(q, found) else q

    def _ways(self, check: MotionCheck, targets: list[Vector]) -> list[JointPath]:
        """Several paths, shortened; only one if it is straight, and at later attempts."""
        query = self._query
        found: list[JointPath] = []
        for turn in range(_WAYS):
            seed = (query.seed + query.attempt) * _WAYS + turn
            way = sample_path(check, self._start, targets, seed=seed, work=self._work)
            if way is None:
                break
            found.append(shorten(check, way, seed=seed))
            if len(found[-1].q) == 2 or query.attempt > 0:
                break
        return found


def _proximity_now(robot: Robot, obstacles: tuple[Obstacle, ...]) -> Proximity:
    """The distances to obstacles, with all of them standing still where they are now."""
    return Proximity(robot, tuple(replace(one, appears_at=0.0, velocity=np.zeros(3)) for one in obstacles))
