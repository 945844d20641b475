"""Routes to postures on the goals, from which descents begin: sampled ones, and different ones through a roadmap.

A start that goes through obstacles becomes one that goes around them, along sampled detours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import drive_of, motion_cost, time_way
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.multistart.start_prices import Start
from backhoe_planner.planning.search.blending import blend
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.planning.search.reach import Reach
from backhoe_planner.planning.search.roadmap import Price, Roadmap
from backhoe_planner.planning.search.sampled_check import SampledCheck
from backhoe_planner.planning.search.sampling import JointPath, sample_path
from backhoe_planner.planning.search.shortening import shorten
from backhoe_planner.planning.world.world import World

_SPARES = (0.01, 0.002)  # m kept beyond every clearance by a sampled route, in turn
_MAP_SPARE = 0.002  # m kept beyond every clearance in a roadmap; chosen small, because a roadmap is for narrow passages
_LOOKS_FOR_ONE = 3  # sampled checks for one of `Effort.motions`, which count proofs; a check takes a tenth of a proof
_MOTIONS = 2_000  # checked for one sampled route if another is known; chosen, a sixth of what the first may use
_STATIONS = 101  # along a start, that are checked, and between which its detours begin and end; chosen
_PLACES = 12  # along a motion, by which a roadmap knows its route; chosen
# rad: cones are at least as wide for the straight motions of a route. Its corners are in the true ones, and a descent
# brings what is between them there; chosen
_LEAST_CONE = 0.1
_SEEDS_APART = 1_000_003  # a prime, so that plans with neighbouring seeds draw different routes


class Ways:
    """Routes from one start.

    Parameters
    ----------
    start: (n,) where the machine is [rad or m].
    time: at which the positions of the obstacles are taken [s].
    hurried: whether motions are checked less densely.

    Attributes
    ----------
    looked_at: how many motions were checked in searches that found no route.
    reached: (n,) each: the ends of sampled routes.
    """

    def __init__(self, world: World, start: Vector, ends: GoalEnds, *, time: float, hurried: bool) -> None:
        self._world, self._start, self._ends, self._time, self._hurried = world, start, ends, time, hurried
        self._problem, self._drive = world.problem, drive_of(world.problem)
        keep = self._problem.keep
        self._sampled = self._problem  # for which routes are sampled
        if keep is not None and keep.cones:
            self._sampled = replace(self._problem, keep=keep.with_wider_cones(_LEAST_CONE))
        work = world.work
        more = {name: _LOOKS_FOR_ONE * getattr(work.effort, name) for name in ("motions", "motions_per_search")}
        self._sampling = Work(replace(work.effort, **more), work.brake)
        self._needed = 0  # motions that sampling checked until it found the first route
        self._line: Vector | None = None  # (n,) the last posture to which the straight line was clear
        self.looked_at = 0
        self.reached: list[Vector] = []

    @property
    def may_sample(self) -> bool:
        """Whether any motions are left to be checked."""
        return self._sampling.motions > 0

    def sample(self, which: Sequence[int], turn: int, *, again: int) -> FoundMotion | None:
        """The motion along a sampled and shortened route to one of the postures `which`; None if none is found.

        Parameters
        ----------
        turn: how many routes were sampled before.
        again: factor on the motions that are checked if another route is known; 0 for as many as for the first.
        """
        work, goals = self._world.work, list(self._ends.at(which))
        check = self._check(goals, _SPARES[turn % len(_SPARES)])
        seed = (self._world.seed + turn * _SEEDS_APART) % 2**32
        before = self._sampling.motions
        most = None
        if again:
            most = min(max(_MOTIONS, self._needed) * again, work.effort.motions_per_search)
        path = None
        try:
            path = sample_path(
                check, self._start, goals, seed=seed, work=self._sampling, most_motions=most,
                straight=self._line is None, keep=self._problem.keep,
            )  # fmt: skip
        finally:  # also if time runs out
            if path is None:
                self.looked_at += before - self._sampling.motions
        if path is not None and most is None:
            self._needed = before - self._sampling.motions
        if path is None:
            return None
        if len(path.q) == 2:
            if self._line is not None and np.array_equal(path.q[-1], self._line):
                return None
            self._line = path.q[-1]
        found = self._motion(check, path, which, seed=seed, way="sampled")
        self.reached.append(self._ends.postures[self._ends.nearest(which, found.motion.q[-1])])
        return found

    def around(self, blocked: Start, turn: int) -> Start | None:
        """A start that is `blocked`, with a sampled and shortened detour around each obstacle on its way.

        A detour is run at the mean pace of the stretch that it replaces. None if no detour is found, or if one end of
        the start is in an obstacle.

        Parameters
        ----------
        turn: another one gives other detours.
        """
        limits, s = self._problem.limits, np.linspace(0.0, 1.0, _STATIONS)
        q = np.clip(blocked.curve(s), limits.lower, limits.upper)
        keeps = self._check([], _MAP_SPARE).keeps(q)
        if keeps.all() or not (keeps[0] and keeps[-1]):
            return None
        seed = (self._world.seed + turn * _SEEDS_APART) % 2**32
        spans, corners = [np.zeros(1)], [q[:1]]
        last = 0
        while last < len(s) - 1:
            first, last = last, int(np.flatnonzero(keeps[last + 1 :])[0]) + last + 1
            between = q[first : last + 1]
            if last > first + 1:
                found = self._detour(q[first], q[last], seed)
                if found is None:
                    return None
                pace = self._lengths(between).sum() / (s[last] - s[first])
                between = found.q
                spans.append(self._lengths(between) / pace)
            else:
                spans.append(np.diff(s[first : last + 1]))
            corners.append(between[1:])
        time = np.cumsum(np.concatenate(spans))
        curve = JointCurve.through(time / time[-1], np.vstack(corners), blocked.curve.pieces, limits)
        return Start(curve, blocked.duration, blocked.goal, "around an obstacle")

    def _detour(self, a: Vector, b: Vector, seed: int) -> JointPath | None:
        """A sampled and shortened route between two clear configurations (n,); None if none is found."""
        check = SampledCheck(
            self._problem, self._world.proximity, [a, b],
            spare=_MAP_SPARE, time=self._time, brake=self._world.work.brake, hurried=self._hurried,
        )  # fmt: skip
        path = sample_path(check, a, [b], seed=seed, work=self._sampling, most_motions=_MOTIONS)
        return None if path is None else shorten(check, path, seed=seed)

    def _lengths(self, q: Matrix) -> Vector:
        """(K - 1,) joint times between successive q (K, n) [s]."""
        return np.asarray(np.linalg.norm(np.diff(q, axis=0) / self._problem.limits.velocity, axis=1))

    def through_roadmap(
        self, which: Sequence[int], turn: int, *, nodes: int, longest: float, price: Price, known: Sequence[Matrix],
        dearest: float,
    ) -> Iterator[FoundMotion]:  # fmt: skip
        """Motions along different routes through a roadmap to any of the postures `which`, shortened.

        Parameters
        ----------
        turn: how many roadmaps were made before.
        nodes: of the roadmap.
        longest: configurations are left out if every motion through them takes longer [s].
        price: of straight motions, by which the cheapest routes come first.
        known: (K, n) each: configurations along known motions; a route may pass some of them, but not near all of one.
        dearest: the highest price of a route.
        """
        goals = self._ends.at(which)
        check = self._check(list(goals), _MAP_SPARE)
        clear = np.array(check.ends_clear)
        if not clear[0] or not clear[1:].any():
            return
        seed = (self._world.seed + turn * _SEEDS_APART) % 2**32
        reach = Reach(self._problem.limits, self._start, goals[clear[1:]], longest)
        rng = np.random.default_rng(seed)
        roadmap = Roadmap(check, reach, nodes=nodes, rng=rng, price=price, known=known)
        for path in roadmap.ways(dearest=dearest):
            found = self._motion(check, path, which, seed=seed, way="through a roadmap")
            roadmap.avoid(found.motion.at(np.linspace(0.0, found.motion.duration, _PLACES)))
            yield found

    def _check(self, goals: Sequence[Vector], spare: float) -> SampledCheck:
        return SampledCheck(
            self._sampled, self._world.proximity, [self._start, *goals],
            spare=spare, time=self._time, brake=self._world.work.brake, hurried=self._hurried,
        )  # fmt: skip

    def _motion(
        self, check: SampledCheck, path: JointPath, which: Sequence[int], *, seed: int, way: str
    ) -> FoundMotion:
        path = shorten(check, path, seed=seed)
        motion = time_way(blend(check, path), self._problem.limits, drive=self._drive)
        goal = self._ends.goals[self._ends.nearest(which, path.q[-1])]
        return FoundMotion(motion, motion_cost(self._problem, motion), goal, way)
