"""The way back out of what is closer than allowed already.

What is measured. Of every obstacle (and of the machine with itself) the deepest violation

    V = max over its violated pairs of (clearance - distance)

falls at every step, at the end of the step and at every look at the braking path that
follows from it (`violation_descent` says which velocity does that fastest). The fastest descent
can lead into a local minimum, where no joint rate makes V smaller. So as soon as the
machine is inside something a way out is searched, spread over the steps (`escape`):

1. the chain of postures down which the fastest descent leads, if it leads out;
2. another chain of postures along which V falls;
3. a way that is nowhere deeper than where the machine began.

Of 1 and 2 the servo takes the direction, and V falls at every step. Only on 3, V may come
back up to what it was at the beginning, and no further. What falls at every step then is

    W = sum over the way of r_j |dq_j|,

an upper bound of how far any point of the machine still has to move until it is clear,
and so of V. Where all three fail, and some seconds later again, the machine stays, and V does
not grow: either nothing within its limits is clear, or every way there is deeper than
the start.

Until the first descent is known to lead out or not, V falls as fast as it can; while 2
and 3 are searched it falls as slowly as can be measured, so that the way still begins
where the machine is. A joint beyond its limit comes back at every step too, however
slowly, and at its full rate once nothing is violated. Where obstacles then keep it from
coming back, a way 3 is searched for it as well; and where they would at the end of a way 1
or 2, a way 3 is preferred.

A change of what stands around ends all that, and it begins anew. Per step the search
looks at `_LOOKS_PER_STEP` postures and pairs, or at one posture where that has more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.law import Rows
from backhoe_planner.live.braking.braking_path import MOST_PARTS, BrakingPath, JointState, PathClearance, Placements
from backhoe_planner.live.braking.joint_bounds import FASTEST_RECOVERY, RECOVERY, SLOWEST_RECOVERY
from backhoe_planner.live.braking.pair_bounds import Awake
from backhoe_planner.live.braking.path_check import PathCheck
from backhoe_planner.live.braking.separation import Separation
from backhoe_planner.live.recovery.escape import EscapeRoute, EscapeSearch, RouteSearch
from backhoe_planner.live.recovery.violation_descent import by_owner, way_back
from backhoe_planner.machine import JointLimits, Robot

_ATTEMPTS = 3
_BLENDS = (0.5, 0.2)
_HOLDS = 2.0  # 1/s: how soon what is not the deepest is taken hold of
_INSIDE_SPEED = 0.5  # m/s
_LEAST_RADIUS = 0.1  # m, of a joint
_FALLS = 1e-8  # m: by so much at least the deepest violation falls in a step
_LEVEL = 1e-9  # m: what counts as no deeper
_FOLLOWED_FALL = 1e-3  # m/s: on a falling way
_WAITING_FALL = 1e-4  # m/s: while the search is on
_LOOKS_PER_STEP = 20  # postures and pairs that the search looks at
_PROGRESS, _RETURN_PROGRESS = 1e-3, 3e-3  # m; rad or m: less is none
_PATIENCE, _PAUSE = 0.3, 5.0  # s without progress before a search; after one that found nothing
_AHEAD, _AT_NODE = 0.06, 0.01  # rad or m: how far ahead a falling way is aimed at; where a node is reached
_BETWEEN, _MOST_SPANS = 0.01, 8  # m between two looks at a braking path; how many at most
_SLOWEST_RETURN = 1e-5  # rad/s or m/s: of a joint beyond its limit
_SMALLEST = 1e-12
_STEP_END = MOST_PARTS + 1  # row of the placements


@dataclass(frozen=True)
class RecoveryStep:
    """What is known of the step that is to be taken.

    Attributes
    ----------
    state: where the joints are.
    low, high: (n,) the velocities within reach, see `Recovery.slowed`.
    target, brake: (n,) the velocity that is wished, and the one that brakes.
    awake: pairs that are not violated and could come into question.
    evasion: rows of what comes nearer.
    anything_moves: whether any obstacle does.
    """

    state: JointState
    low: Vector
    high: Vector
    target: Vector
    brake: Vector
    awake: Awake
    evasion: Rows
    anything_moves: bool


@dataclass(frozen=True)
class RecoveryPath:
    """The braking path of a velocity that leads out, with what was measured and proven of it.

    Attributes
    ----------
    level: (K,) of every violated pair, how deep its obstacle's deepest will be [m].
    """

    path: BrakingPath
    clearance: PathClearance
    level: Vector


class _Depths(NamedTuple):
    """The deepest violations of the pairs' obstacles along a braking path.

    Attributes
    ----------
    level, most: (K,) at the end of the step, and anywhere [m].
    worse: (K,) the pairs that come too deep, their distances [m] and gradients there, and when [s]; None where none do.
    """

    level: Vector
    most: Vector
    worse: tuple[Flags, Vector, Matrix, float] | None


class Recovery:
    """The way back of one machine.

    Parameters
    ----------
    robot, limits: the machine, and its limits in this site.
    separation, check, at: what is measured with; working memory of the servo.
    dt: length of a step [s].
    change: (n,) by how much a velocity may change in a step.

    Attributes
    ----------
    to_go: W [m] while the machine is on a way below, None otherwise.
    """

    def __init__(
        self,
        robot: Robot,
        limits: JointLimits,
        separation: Separation,
        check: PathCheck,
        at: Placements,
        dt: float,
        change: Vector,
    ) -> None:
        self._robot, self._limits, self._check = robot, limits, check
        self._separation, self._at, self._dt, self._change = separation, at, dt, change
        # no point moves faster than this by one joint while the machine is inside something
        self._slow = np.array([_INSIDE_SPEED / max(radius, _LEAST_RADIUS) for radius in separation.furthest])
        self._radius = np.maximum(separation.furthest, _LEAST_RADIUS)
        self._rng = np.random.default_rng(0)
        self._outside = True  # perhaps; once within the limits, no step leads out of them
        self._least_outside, self._held_for = math.inf, 0
        self.to_go: float | None = None
        self.changed()

    def changed(self) -> None:
        """What stands around is not what it was: whatever was searched for is forgotten."""
        self._begun = self._rests = False
        self._running: RouteSearch | None = None
        self._escape: EscapeSearch | None = None
        self._leave()

    def _leave(self) -> None:
        """Leave the way that was found."""
        self._route: EscapeRoute | None = None
        self._node = 1
        self._left: Vector = np.zeros(0)  # (N,) W at the nodes
        self.to_go = None

    def held_outside(self, q: Vector) -> bool:
        """Whether something keeps the joints from coming back within their limits, so that a way must be searched."""
        if not self._outside:
            return False
        limits = self._limits
        left = float(np.maximum(np.maximum(q - limits.upper, limits.lower - q), 0.0).sum())
        self._outside = left > _LEVEL
        if self._running is not None or self._route is not None:
            return self._outside
        self._held_for += 1
        if left < self._least_outside - _RETURN_PROGRESS:
            self._least_outside, self._held_for = left, 0
        elif self._held_for * self._dt > (_PAUSE if self._rests else _PATIENCE):
            self.changed()
            self._least_outside, self._held_for = left, 0
            return self._outside
        return False

    def slowed(self, q: Vector, v: Vector, low: Vector, high: Vector) -> tuple[Vector, Vector]:
        """(n,), (n,) bounds so slow that little lies between what is measured of a braking path.

        A joint beyond a limit may take its time, but not stand still: to hurry it back could drive
        something deeper.
        """
        up, down = v + self._change, v - self._change
        if not self._rests:
            limits = self._limits
            high = np.where(q > limits.upper, np.maximum(high, -_SLOWEST_RETURN), high)
            low = np.where(q < limits.lower, np.minimum(low, _SLOWEST_RETURN), low)
        low = np.minimum(np.maximum(np.maximum(low, -self._slow), down), up)
        high = np.minimum(np.maximum(np.minimum(high, self._slow), down), up)
        return low, high

    def choose(self, pairs: Indices, stands: Flags, step: RecoveryStep) -> tuple[Vector, RecoveryPath | None]:
        """How deep the violated pairs are (K,) [m], and the way on; None where none was found, so that it brakes.

        The violated pairs are measured where the step ends and along its braking path.
        Where the linear rows promised more than that, what was found there is one more
        row (a cutting plane), and the velocity is asked for anew.

        stands: (P,) of every pair whether its obstacle stands still.
        """
        distance, rows = self._separation.gradients(pairs, self._at, 0)
        depth = self._separation.clearance[pairs] - distance
        deepest = by_owner(depth, self._separation.owner[pairs])
        self._continue_search(pairs, stands, step.state.q, deepest)
        below = self._route is not None and not self._route.falling
        target, fastest = self._aim(step, float(deepest.max(initial=0.0)))
        ceiling = np.maximum(self._ceiling[pairs], deepest) if below else deepest
        slack = _HOLDS * (ceiling - depth)
        all_rows, all_slack = rows, slack
        others: tuple[Rows, ...] = (step.evasion,)
        tried = step.brake
        for attempt in range(_ATTEMPTS + len(_BLENDS)):
            if attempt < _ATTEMPTS:
                fall = way_back(
                    all_rows, all_slack, target=target, low=step.low, high=step.high,
                    fastest=fastest, others=others,
                )  # fmt: skip
                if fall is None:
                    continue
                v = tried = fall[0]
            else:
                v = step.brake + _BLENDS[attempt - _ATTEMPTS] * (tried - step.brake)
            if below and not self._nearer(step.state.q, v):
                continue
            path = self._check.path(step.state.q, v)
            found = self._check.clearance(step.awake, path, anything_moves=step.anything_moves)
            if len(found.bound) == 0:
                path.place(self._at)
            depths = self._depths_along(pairs, path, ceiling if below else deepest, below=below)
            if depths.worse is not None:
                worse, there, falls, span = depths.worse
                cut = slack[worse] + (there - distance)[worse] / span + falls[worse] @ v
                all_rows, all_slack = np.vstack((all_rows, falls[worse])), np.append(all_slack, cut)
            elif found.stands_clear and (found.clear or attempt == _ATTEMPTS - 1):
                # on a way below what is out may have to go in again
                level = ceiling if below and (depths.most > 0.0).any() else depths.level
                return depth, RecoveryPath(path, found, level)
            if not found.clear:
                # nothing may be asked for that the way back could not give
                more = self._check.rows(step.awake, path, found)
                others = (*others, more._replace(h=np.maximum(more.h, 0.0)))
        return depth, None

    def _aim(self, step: RecoveryStep, deepest: float) -> tuple[Vector, float]:
        """(n,) the velocity that is wished, and how fast the deepest violation is to fall [m/s]."""
        route = self._route
        if route is not None:
            return self._along(route, step), _FOLLOWED_FALL if route.falling else 0.0
        if self._waits:
            return step.brake, _WAITING_FALL
        return step.target, min(max(RECOVERY * deepest, SLOWEST_RECOVERY), FASTEST_RECOVERY)

    def _depths_along(self, pairs: Indices, path: BrakingPath, most: Vector, *, below: bool) -> _Depths:
        """How deep the pairs get on a braking path, until one is deeper than allowed.

        most: (K,) the depth to stay within on a way below, and else to fall from [m].
        """
        separation, at, owner = self._separation, self._at, self._separation.owner[pairs]
        before = most + _LEVEL if below else most - _FALLS
        highest = level = np.zeros(len(pairs))
        for span in self._spans(path):
            at.place(_STEP_END, path.q + path.v * span)
            there, falls = separation.gradients(pairs, at, _STEP_END)
            depth = separation.clearance[pairs] - there
            now = by_owner(depth, owner)
            worse = depth > np.maximum(before, 0.0)
            if not below:
                # still falling there, so that it falls all the way, braking too
                worse |= (depth > np.maximum(now - _FALLS, 0.0)) & (falls @ path.v >= 0.0)
                before = now
            if span == self._dt:
                level = now
            highest = np.maximum(highest, now)
            if worse.any():
                return _Depths(level, highest, (worse, there, falls, span))
        return _Depths(level, highest, None)

    def _spans(self, path: BrakingPath) -> list[float]:
        """When to measure along a braking path [s]: at the end of the step, and so often that little lies between."""
        length = float(np.abs(path.delta) @ self._radius)
        parts = min(max(math.ceil(length / _BETWEEN), 1), _MOST_SPANS)
        return [self._dt, *(path.look * part / parts for part in range(1, parts + 1))]

    # --- where going down leads nowhere --------------------------------------------------

    def _continue_search(self, pairs: Indices, stands: Flags, q: Vector, deepest: Vector) -> None:
        """Go on with the search for a way out, and begin one where the machine gets no further."""
        if not self._begun:
            self._begun = True
            self._ceiling = np.zeros(len(self._separation))
            self._ceiling[pairs] = deepest
            self._tries, self._since, self._best = 0, 0, math.inf
            self._start_search(pairs, stands, q)
        if self._running is not None:
            assert self._escape is not None
            until = self._escape.looked + _LOOKS_PER_STEP
            try:
                while self._escape.looked < until:
                    next(self._running)
            except StopIteration as end:
                self._end_search(q, end.value)
            except Exception:
                self._end_search(q, None)
                raise
            return
        self._since += 1
        left = float(deepest.sum()) if self._route is None else self._still_to_go
        if left < self._best - _PROGRESS:
            self._best, self._since = left, 0
        elif self._since * self._dt > (_PAUSE if self._rests else _PATIENCE):
            self._tries += 1
            self._start_search(pairs, stands, q)

    def _start_search(self, pairs: Indices, stands: Flags, q: Vector) -> None:
        self._leave()
        self._waits = self._tries > 0 or len(pairs) == 0
        self._escape = EscapeSearch(
            self._robot, self._limits, self._separation, q,
            watched=np.flatnonzero(stands), inside=pairs, ceiling=self._ceiling, rng=self._rng,
        )  # fmt: skip
        self._running = self._routes(self._escape, q)

    def _routes(self, escape: EscapeSearch, q: Vector) -> RouteSearch:
        """What is tried, one after the other; None where nothing is found."""
        turn = self._tries % 3
        if turn == 2:  # without a way, by descent alone
            return None
        if turn == 0:
            route = yield from escape.descent(q)
            self._waits = True
            if route is None:
                route = yield from escape.falling(q)
            if route is not None and len(route.nodes) > 1:
                if (yield from escape.returns(route.nodes[-1])):
                    return route
                return (yield from escape.below(q)) or route
        return (yield from escape.below(q))

    def _end_search(self, q: Vector, route: EscapeRoute | None) -> None:
        self._rests = route is None and self._tries % 3 < 2
        self._running = self._escape = None
        self._since, self._best, self._waits = 0, math.inf, False
        self._route, self._node = route, 1
        if route is not None:
            lengths = np.abs(np.diff(route.nodes, axis=0)) @ self._radius
            self._left = np.append(np.cumsum(lengths[::-1])[::-1], 0.0)
            self._still_to_go = math.inf

    def _along(self, route: EscapeRoute, step: RecoveryStep) -> Vector:
        """(n,) the velocity along the way that was found."""
        last = len(route.nodes) - 1
        ahead = _AHEAD if route.falling else _AT_NODE
        while self._node < last and np.abs(route.nodes[self._node] - step.state.q).max() < ahead:
            self._node += 1
        way = route.nodes[self._node] - step.state.q
        self._still_to_go = float(np.abs(way) @ self._radius + self._left[self._node])
        if not route.falling:
            self.to_go = self._still_to_go
        length = float(np.abs(way).max())
        if self._node == last and length < _AT_NODE * 0.1:
            self._leave()
            return step.brake
        per = np.maximum(np.abs(way) / length, _SMALLEST)
        stop = length + (_AHEAD if route.falling and self._node < last else 0.0)
        braking = 0.5 * float((self._change / self._dt / per).min())
        speed = min(float((self._slow / per).min()), math.sqrt(2.0 * braking * stop), length / self._dt)
        change = way / length * speed - step.state.v
        part = min(float((self._change / np.maximum(np.abs(change), _SMALLEST)).min()), 1.0)
        return np.asarray(step.state.v + part * change)

    def _nearer(self, q: Vector, v: Vector) -> bool:
        """Whether a step at v leaves less to go of a way below."""
        if self._route is None or self.to_go is None:
            return False
        way = self._route.nodes[self._node] - q - v * self._dt
        return bool(np.abs(way) @ self._radius + self._left[self._node] < self.to_go)

    def cleared(self, pairs: Indices, found: RecoveryPath) -> tuple[Indices, Vector]:
        """Those of the pairs that keep their clearance again along the path, and the proven distances (K,) [m]."""
        separation = self._separation
        pairs = pairs[found.level <= 0.0]
        if len(pairs) == 0:
            return pairs, np.zeros(0)
        bound = separation.proven_on(pairs, found.path, self._at, 0.0)
        kept = bound >= separation.clearance[pairs]
        if kept.sum() == len(found.level):
            self.changed()
        return pairs[kept], bound[kept]
