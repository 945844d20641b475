"""The way out if the machine is closer to something than allowed.

For every obstacle (and for the machine with itself) the deepest violation

    V = max over its violated pairs of (clearance - distance)

falls at every step: it is measured at the end of the step and along the braking path that
follows. `violation_descent` finds the velocity that makes it fall fastest. The fastest descent
can lead into a local minimum, where no joint rate makes V smaller. So as soon as the machine
is inside something, a route out is searched, spread over the steps (`escape`):

1. the chain of postures along which the fastest descent leads, if it leads out;
2. another chain of postures along which V falls;
3. a route *below*, along which no violation is deeper than where the machine began.

On routes 1 and 2 the servo only takes their direction, and V falls at every step. Only on a
route 3 may V rise again to what it was at the beginning, and no further. There

    W = sum over the route of r_j |dq_j|

falls at every step. It is an upper bound of how far any point of the machine still has to
move until it is clear, and so of V. If all three fail, and fail again some seconds later, the
machine stays, and V does not grow: either nothing within its limits is clear, or every route
there is deeper than the start.

Until it is known whether the first descent leads out, V falls as fast as it can. While 2 and
3 are searched, it falls as slowly as can be measured, so that the route still begins where
the machine is. A joint beyond its limit also comes back at every step, however slowly, and
at its full rate once nothing is violated. If obstacles then keep it from coming back, a
route 3 is searched for it as well. If they would do so at the end of a route 1 or 2, a route 3
is preferred.

When the surroundings change, all this is dropped and begins again. Per step the search
examines `_LOOKS_PER_STEP` postures and pairs, and the next motion is checked against no more
pairs than the step may measure (`step_work`). If these do not suffice to prove a motion, the
machine brakes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.law import Kind, Rows
from backhoe_planner.live.braking.braking_path import STEP_END, BrakingPath, JointState, PathClearance
from backhoe_planner.live.braking.joint_bounds import FASTEST_RECOVERY, RECOVERY, SLOWEST_RECOVERY, TOLERANCE
from backhoe_planner.live.braking.kept_rows import KeptRows
from backhoe_planner.live.braking.step_work import CLOSER_LOOK
from backhoe_planner.live.clearance.pair_bounds import Awake
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.live.planes.close_look import proven_along
from backhoe_planner.live.planes.narrow_phase import measure_gradients
from backhoe_planner.live.planes.plane_gaps import least_gaps_at
from backhoe_planner.live.recovery.escape import EscapeRoute, EscapeSearch, RouteSearch
from backhoe_planner.live.recovery.violation_descent import SMALLEST, by_owner, way_back
from backhoe_planner.machine import Robot
from backhoe_planner.motion import SAMPLE_PERIOD

ATTEMPTS = 3  # problems that are solved per step at most; chosen, to bound its work
BLENDS = (0.5, 0.2)  # blends from braking to the velocity that was tried last; chosen
_HOLDS = 2.0  # 1/s: k, how soon pairs that are not the deepest are bound; chosen
_INSIDE_SPEED = 0.5  # m/s of a point by one joint at most; chosen, so that it moves little between two looks
_LEAST_RADIUS = 0.1  # m, for a joint whose points hardly travel; chosen, keeps its rate finite
# m by which the deepest violation falls at least in a step of 20 ms, scaled by the square in shorter ones, as it starts
# from rest; and m by which it falls in any step: above the rounding of a distance
_FALLS, _LEAST_FALL = 1e-8, 1e-12
_LEVEL = 1e-9  # m: a violation that is deeper by less counts as no deeper; rounding
_FOLLOWED_FALL = 1e-3  # m/s at which V must fall on a falling route; chosen, so that the route decides the direction
_WAITING_FALL = 1e-4  # m/s while the search is running: a tenth of `_FOLLOWED_FALL`
_FEW = 3  # so few violated pairs are all measured; chosen, finding out which need not be costs as much
_LOOKS_PER_STEP = 12  # postures and pairs that the search examines; chosen, each costs some 20 us
_PROGRESS = 1e-3  # m by which the remaining violation or route must fall to count as progress; chosen
_RETURN_PROGRESS = 3e-3  # rad or m by which a joint beyond its limit must come back to count as progress; chosen
_PATIENCE, _PAUSE = 0.3, 5.0  # s without progress before a search, and after one that found nothing; chosen
_AT_NODE = 0.01  # rad or m within which a node of a route counts as reached; chosen, half of `escape`'s resolution
_AHEAD = 0.06  # rad or m: look-ahead on a falling route; chosen, twice the longest step of a descent
_BETWEEN, _MOST_SPANS = 0.01, 8  # m between two looks along a braking path, and the most looks; chosen
_SLOWEST_RETURN = 1e-5  # rad/s or m/s of a joint beyond its limit; chosen, so that it never stands still


@dataclass(frozen=True)
class RecoveryStep:
    """The input for the step that is about to be taken.

    Attributes
    ----------
    state: of the joints.
    low, high: (n,) bounds of the velocity, see `Recovery.slow_bounds` [rad/s or m/s].
    target, brake: (n,) the wished velocity, and the one that brakes [rad/s or m/s].
    awake: pairs that are not violated and could come too close.
    evasion: rows of approaching obstacles.
    kept: the conditions to be kept; None if there are none.
    """

    state: JointState
    low: Vector
    high: Vector
    target: Vector
    brake: Vector
    awake: Awake
    evasion: Rows
    kept: KeptRows | None = None


@dataclass(frozen=True)
class RecoveryPath:
    """The braking path of a velocity that leads out, with its measured and proven distances.

    Attributes
    ----------
    path: with the velocity.
    clearance: proven for the pairs that are not violated.
    level: (K,) for every violated pair, how deep the deepest pair of its obstacle will be [m].
    """

    path: BrakingPath
    clearance: PathClearance
    level: Vector


class _Depths(NamedTuple):
    """The deepest violations of the pairs' obstacles along a braking path.

    Attributes
    ----------
    level, most: (K,) at the end of the step, and the greatest anywhere [m].
    worse: (K,) which pairs get too deep, their distances [m] and gradients there, and when [s]; None
        if none does.
    """

    level: Vector
    most: Vector
    worse: tuple[Flags, Vector, Matrix, float] | None


class Recovery:
    """Leads one machine out of violations.

    Parameters
    ----------
    robot: the machine.
    check: the check of its braking paths.

    Attributes
    ----------
    to_go: W [m] while the machine is on a route 3, None otherwise.
    """

    def __init__(self, robot: Robot, check: PathCheck) -> None:
        joints, separation = check.joints, check.separation
        self._robot, self._limits, self._check = robot, joints.limits, check
        self._separation, self._at, self._dt, self._change = separation, check.at, joints.dt, joints.change
        self._falls = max(min(_FALLS, _FALLS * (joints.dt / SAMPLE_PERIOD) ** 2), _LEAST_FALL)
        self._slow = np.array([_INSIDE_SPEED / max(radius, _LEAST_RADIUS) for radius in separation.furthest])
        self._radius = np.maximum(separation.furthest, _LEAST_RADIUS)
        self._rng = np.random.default_rng(0)
        self._outside = True  # possibly: not known yet. Once within the limits, no step leads out of them
        self._least_outside, self._held_for = math.inf, 0
        self.to_go: float | None = None
        self.changed()

    def changed(self) -> None:
        """Drop every search and route, because the surroundings have changed."""
        self._begun = self._rests = False
        self._running: RouteSearch | None = None
        self._escape: EscapeSearch | None = None
        self._leave()

    def _leave(self) -> None:
        """Drop the route that was found."""
        self._route: EscapeRoute | None = None
        self._node = 1
        self._left: Vector = np.zeros(0)  # (N,) W at the nodes
        self.to_go = None

    def held_outside(self, q: Vector) -> bool:
        """Whether something keeps the joints at q (n,) from coming back within their limits: a route is needed."""
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

    def slow_bounds(self, q: Vector, v: Vector, low: Vector, high: Vector) -> tuple[Vector, Vector]:
        """(n,), (n,) bounds of the velocity, so slow that points move little between two looks along a braking path.

        They are within `low` and `high` (n,), as far as the accelerations from v (n,) allow. A joint
        beyond a limit may come back slowly, because at full rate it could drive something deeper, but
        it may not stand still.
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
        """How deep the violated pairs are (K,) [m], and the step on the way out; None if the machine must brake.

        The violated pairs are measured where the step ends and along its braking path. If they
        are deeper there than the linear rows promised, the measurement becomes one more row
        (a cutting plane), and the problem is solved again.

        Parameters
        ----------
        pairs: (K,) indices of the violated pairs.
        stands: (P,) whether the obstacle of a pair stands still, for all pairs.
        """
        distance, rows, measured = self._depths_here(pairs)
        depth = self._separation.clearance[pairs] - distance
        deepest = by_owner(depth, self._separation.owner[pairs])
        self._continue_search(pairs, stands, step.state.q, deepest)
        below = self._route is not None and not self._route.falling
        target, fastest = self._aim(step, float(deepest.max(initial=0.0)))
        ceiling = np.maximum(self._ceiling[pairs], deepest) if below else deepest
        slack = _HOLDS * (ceiling - depth)
        all_rows, all_slack = rows[measured], slack[measured]
        others: tuple[Rows, ...] = (step.evasion,)
        kept = step.kept
        firm: tuple[Rows, ...] = ()
        if kept is not None:
            firm = (Rows("keep", -kept.G, RECOVERY * np.maximum(kept.left, 0.0), Kind.HARD),)
            if kept.firm and stands[pairs].all():
                others, firm = (*others, firm[0]._replace(kind=Kind.SOFT)), ()
        tried = step.brake
        for attempt in range(ATTEMPTS + len(BLENDS)):
            if attempt < ATTEMPTS:
                fall = self._fall(step, all_rows, all_slack, target=target, fastest=fastest, others=others, firm=firm)
                if fall is None:
                    continue
                v = tried = fall
            else:
                v = step.brake + BLENDS[attempt - ATTEMPTS] * (tried - step.brake)
            if below and not self._nearer(step.state.q, v):
                continue
            path = self._check.path(step.state.q, v)
            found = self._check.clearance(step.awake, path)
            if len(found.bound) == 0:
                path.place(self._at)
            depths = self._depths_along(pairs, path, ceiling if below else deepest, below=below)
            if depths is None:
                break
            if depths.worse is not None:
                worse, there, falls, span = depths.worse
                cut = slack[worse] + (there - distance)[worse] / span + falls[worse] @ v
                all_rows, all_slack = np.vstack((all_rows, falls[worse])), np.append(all_slack, cut)
            elif found.stands_clear and (found.clear or attempt == ATTEMPTS - 1):
                # on a route 3 a pair that is out may have to go in again
                level = ceiling if below and (depths.most > 0.0).any() else depths.level
                return depth, RecoveryPath(path, found, level)
            if not found.clear:
                # standing still must satisfy these rows: a motion that they demand could contradict the way out
                (more,) = self._check.rows(step.awake, path, found)
                others = (*others, more._replace(h=np.maximum(more.h, 0.0)))
        return depth, None

    def _fall(
        self, step: RecoveryStep, rows: Matrix, slack: Vector, *, target: Vector, fastest: float,
        others: tuple[Rows, ...], firm: tuple[Rows, ...],
    ) -> Vector | None:  # fmt: skip
        """(n,) the velocity by which the deepest violation falls fastest; None if the solver fails. See `way_back`.

        firm: rows that are kept if there is such a velocity, by which the violation falls at all and the machine
            gives way to what comes. Otherwise they are left out, and what is to be kept changes as little as it can.
        """
        little = None if step.kept is None else step.kept.near
        for block in (firm, ()) if firm else ((),):
            found = way_back(
                rows, slack, target=target, low=step.low, high=step.high, fastest=fastest,
                others=(*others, *block), note=self._check.note, little=little,
            )  # fmt: skip
            if found is not None:
                v, speed = found
                if not block or (speed * self._dt > self._falls and step.evasion.are_kept_by(v, TOLERANCE)):
                    return v
        return None

    def _aim(self, step: RecoveryStep, deepest: float) -> tuple[Vector, float]:
        """(n,) the wished velocity, and how fast V is to fall [m/s]; `deepest` is V [m]."""
        route = self._route
        if route is not None:
            return self._along(route, step), _FOLLOWED_FALL if route.falling else 0.0
        if self._waits:
            return step.brake, _WAITING_FALL
        return step.target, min(max(RECOVERY * deepest, SLOWEST_RECOVERY), FASTEST_RECOVERY)

    def _depths_here(self, pairs: Indices) -> tuple[Vector, Matrix, Flags]:
        """Distances of the violated pairs where the machine is (K,) [m], and how fast they fall (K, n) [m/rad].

        If there are many, only those that may be deepest are measured, and the others have a lower
        bound without a gradient; the last result (K,) says which were measured.
        """
        separation, most = self._separation, self._check.distances_left // 2
        if len(pairs) <= most:
            return *measure_gradients(separation, pairs, self._at, 0), np.ones(len(pairs), dtype=bool)
        # never less than what was proven when the previous step was taken
        distance = np.maximum(least_gaps_at(separation, pairs, self._at, 0), self._check.bounds.required[pairs])
        chosen = np.argpartition(distance - separation.clearance[pairs], most)[:most]
        falls, measured = np.zeros((len(pairs), self._robot.n)), np.zeros(len(pairs), dtype=bool)
        distance[chosen], falls[chosen] = measure_gradients(separation, pairs[chosen], self._at, 0, keep=True)
        measured[chosen] = True
        return distance, falls, measured

    def _depths_along(self, pairs: Indices, path: BrakingPath, most: Vector, *, below: bool) -> _Depths | None:
        """How deep the pairs get on a braking path, up to where one is deeper than allowed.

        `most` (K,) is the depth that must not be exceeded on a route 3 (`below`), and from which it must
        fall otherwise [m]. None if that would need more distances than the step has left.
        """
        separation, at, owner = self._separation, self._at, self._separation.owner[pairs]
        before = most + _LEVEL if below else most - self._falls
        highest = level = np.zeros(len(pairs))
        for span in self._spans(path):
            at.place(STEP_END, path.q + path.v * span)
            found = self._deepest_at(pairs, STEP_END, np.maximum(before, 0.0))
            if found is None:
                return None
            there, falls = found
            depth = separation.clearance[pairs] - there
            now = by_owner(depth, owner)
            worse = depth > np.maximum(before, 0.0)
            if not below:
                # V must still be falling there, so that it falls all along the path, also while braking
                worse |= (depth > np.maximum(now - self._falls, 0.0)) & (falls @ path.v >= 0.0)
                before = now
            if span == self._dt:
                level = now
            highest = np.maximum(highest, now)
            if worse.any():
                return _Depths(level, highest, (worse, there, falls, span))
        return _Depths(level, highest, None)

    def _deepest_at(self, pairs: Indices, sample: int, allowed: Vector) -> tuple[Vector, Matrix] | None:
        """Distances of the violated pairs at one sample (K,) [m], and how fast they fall (K, n) [m/rad].

        The deepest pairs of every obstacle are measured, and those that may be deeper than `allowed` (K,) [m].
        The planes prove that the others are neither; these have their lower bound and no gradient. None
        if more distances are needed than the step has left.
        """
        separation, owner = self._separation, self._separation.owner[pairs]
        clearance = separation.clearance[pairs]
        if len(pairs) <= _FEW:
            can_measure = len(pairs) <= self._check.distances_left
            return measure_gradients(separation, pairs, self._at, sample) if can_measure else None
        distance, falls = least_gaps_at(separation, pairs, self._at, sample), np.zeros((len(pairs), self._robot.n))
        measured = np.zeros(len(pairs), dtype=bool)
        while True:
            depth = clearance - distance
            deepest = by_owner(np.where(measured, depth, -np.inf), owner)
            open_ = ~measured & (depth > np.minimum(allowed, np.maximum(deepest - self._falls, 0.0)))
            if not open_.any():
                return distance, falls
            if self._check.distances_left == 0:
                return None
            row = int(np.where(open_, depth, -np.inf).argmax())
            distance[[row]], falls[[row]] = measure_gradients(separation, pairs[[row]], self._at, sample, keep=True)
            measured[row] = True

    def _spans(self, path: BrakingPath) -> list[float]:
        """When to measure along a braking path [s]: at the end of the step, and then every `_BETWEEN`."""
        length = float(np.abs(path.delta) @ self._radius)
        parts = min(max(math.ceil(length / _BETWEEN), 1), _MOST_SPANS)
        return [self._dt, *(path.look * part / parts for part in range(1, parts + 1))]

    # --- when the descent leads nowhere --------------------------------------------------

    def _continue_search(self, pairs: Indices, stands: Flags, q: Vector, deepest: Vector) -> None:
        """Continue the search for a route out, or begin one if the machine makes no progress."""
        if not self._begun:
            self._begun = True
            self._ceiling = np.zeros(len(self._separation))
            self._ceiling[pairs] = deepest
            self._tries, self._since, self._best = 0, 0, math.inf
            self._start_search(pairs, stands, q)
        if self._running is not None:
            assert self._escape is not None
            until = self._escape.looked + min(_LOOKS_PER_STEP, self._check.distances_left // 2)
            try:
                while self._escape.looked < until:
                    next(self._running)
            except StopIteration as end:
                self._end_search(end.value)
            except Exception:
                self._end_search(None)
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
            known=self._check.bounds.lower(),
        )  # fmt: skip
        self._running = self._routes(self._escape, q)

    def _routes(self, escape: EscapeSearch, q: Vector) -> RouteSearch:
        """Search routes 1, 2 and 3 in turn; None if none is found."""
        turn = self._tries % 3
        if turn == 2:  # every third time by descent alone
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

    def _end_search(self, route: EscapeRoute | None) -> None:
        self._rests = route is None and self._tries % 3 < 2
        self._running = self._escape = None
        self._since, self._best, self._waits = 0, math.inf, False
        self._route, self._node = route, 1
        if route is not None:
            lengths = np.abs(np.diff(route.nodes, axis=0)) @ self._radius
            self._left = np.append(np.cumsum(lengths[::-1])[::-1], 0.0)
            self._still_to_go = math.inf

    def _along(self, route: EscapeRoute, step: RecoveryStep) -> Vector:
        """(n,) the velocity along the route that was found."""
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
        per = np.maximum(np.abs(way) / length, SMALLEST)
        stop = length + (_AHEAD if route.falling and self._node < last else 0.0)
        braking = 0.5 * float((self._change / self._dt / per).min())
        speed = min(float((self._slow / per).min()), math.sqrt(2.0 * braking * stop), length / self._dt)
        change = way / length * speed - step.state.v
        part = min(float((self._change / np.maximum(np.abs(change), SMALLEST)).min()), 1.0)
        return np.asarray(step.state.v + part * change)

    def _nearer(self, q: Vector, v: Vector) -> bool:
        """Whether a step at v (n,) from q (n,) leaves less to go on a route 3."""
        if self._route is None or self.to_go is None:
            return False
        way = self._route.nodes[self._node] - q - v * self._dt
        return bool(np.abs(way) @ self._radius + self._left[self._node] < self.to_go)

    def clear_again(self, pairs: Indices, found: RecoveryPath) -> tuple[Indices, Vector]:
        """The violated pairs that are clear again along the path, and their proven distances (K,) [m]."""
        separation = self._separation
        pairs = pairs[found.level <= 0.0][: max(self._check.distances_left // CLOSER_LOOK, 1)]
        if len(pairs) == 0:
            return pairs, np.zeros(0)
        bound = proven_along(separation, pairs, found.path, self._at, 0.0)
        kept = bound >= separation.clearance[pairs]
        if kept.sum() == len(found.level):
            self.changed()
        return pairs[kept], bound[kept]
