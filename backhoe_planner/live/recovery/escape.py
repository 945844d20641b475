"""The search for a route out of a posture q that is closer to something than allowed.

Two kinds of route are searched.

A *falling* route is a chain of postures along which the deepest violation of every obstacle
falls from each to the next. Such chains are found by descents towards random postures: among
the steps that make every obstacle's deepest violation fall, the one nearest to the wished
direction is taken. The first descent has no wished direction; it is the one that the servo
makes by itself.

A route *below* is a chain of straight lines to a clear posture, along which no obstacle's
deepest violation exceeds what it was where the machine began. Along it

    W(q) = length of the route from q to its end

falls, so the machine cannot get stuck. In between a violation may grow again, up to what it
was. The route is a straight line to one of many clear postures; otherwise it is found by two
trees that grow towards each other (RRT-Connect, Kuffner and LaValle 2000).

Both only guide the servo, which measures every step itself.

The search is a generator: between two yields it examines one posture, or `_AT_ONCE` of its
pairs if many are close, so that it can be spread over the servo's steps. It examines no more
than `MOST_LOOKS` postures, and stores no more than that.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.law import Rows
from backhoe_planner.live.braking.braking_path import Placements
from backhoe_planner.live.planes.narrow_phase import measure_gradients
from backhoe_planner.live.planes.plane_gaps import least_gaps_at
from backhoe_planner.live.planes.separation import Separation
from backhoe_planner.live.recovery.violation_descent import by_owner, way_back
from backhoe_planner.machine import JointLimits, Robot

# The counts are chosen: they bound the work of a search.
_DESCENTS, _DESCENT_LOOKS = 40, 120  # descents, and the postures of one
_GOALS, _CLEAR_GOALS = 300, 40  # postures that are tried as ends of a route, and the most that are kept
_TREE_LOOKS, _LINE_LOOKS = 4000, 4000  # postures of the trees, and of the straight lines
_PAIRS_PER_LOOK = 2000  # the bounds of so many pairs take as long as one measurement, some 20 us
_AT_ONCE = 8  # pairs of one posture that are measured between two yields
_BRANCHES = 3  # branches that a tree grows at once
_NEAR_BY = 0.5  # rad or m: chosen, spread of the ends near q
_TRUST = 0.03  # rad or m: trust region, the longest step of a descent; chosen, gradients are valid about so far
_SHORTEST = 1e-4  # rad or m: chosen, a shorter step of a descent leads nowhere
_RESOLUTION = 0.02  # rad or m between two looks along a line; chosen, the servo measures its steps itself
_EXTEND = 10.0 * _RESOLUTION  # rad or m: length of a branch
_BEYOND = 0.003  # m beyond every clearance where a route ends; chosen, just more than the servo's `BUFFER`
_SLIGHT = 1e-3  # m that a joint's return may be too deep: chosen, the servo's own rows make room for it
_NEAR = 0.1  # m beyond its clearance within which a descent measures a pair; chosen, a few steps
_FALLS = 1e-7  # m by which V falls at a step of a descent, and below which V counts as unchanged: rounding
_HOLDS = 0.5  # part of its room by which a pair may get deeper in a step of a descent; chosen
MOST_LOOKS = (
    (_DESCENTS + 1) * _DESCENT_LOOKS
    + _GOALS
    + 3 * _LINE_LOOKS
    + _TREE_LOOKS
    + 2 * _BRANCHES * round(_EXTEND / _RESOLUTION)  # the last branches
)
_PARTS = (0.02, 0.1, 0.3, 0.0)  # m/rad by which V is to fall per length of a step, in turn; chosen

RouteSearch = Generator[None, None, "EscapeRoute | None"]


@dataclass(frozen=True)
class EscapeRoute:
    """A route out.

    Attributes
    ----------
    nodes: (N, n) postures, with straight lines between them [rad or m].
    falling: whether it is a falling route; otherwise it is one below.
    """

    nodes: Matrix
    falling: bool


class EscapeSearch:
    """The search from one posture in one site.

    Parameters
    ----------
    robot, limits: the machine, and its limits in this site.
    separation: the pairs. It is only read, and must not change during the search.
    q: (n,) configuration of the machine [rad or m].
    watched: indices of the pairs whose obstacles stand still.
    inside: those of them that are violated.
    ceiling: (P,) how deep every pair of `separation` may be on a route below [m].
    rng: draws the random postures.
    known: (P,) lower bounds of all distances at q [m], so that far pairs are not examined again.

    Attributes
    ----------
    looked: how many postures and pairs were examined so far; a posture counts once more for every
        `_PAIRS_PER_LOOK` pairs whose bounds it needs.
    """

    def __init__(
        self,
        robot: Robot,
        limits: JointLimits,
        separation: Separation,
        q: Vector,
        *,
        watched: Indices,
        inside: Indices,
        ceiling: Vector,
        rng: np.random.Generator,
        known: Vector | None = None,
    ) -> None:
        self._separation, self._rng = separation, rng
        self._at = Placements(robot, 1)
        self.looked = 0
        self._pairs = watched
        self._per_posture = 1 + len(watched) // _PAIRS_PER_LOOK
        self._inside = np.isin(watched, inside)
        self._clearance = separation.clearance[watched]
        self._owner = separation.owner[watched]
        self._ceiling = np.where(self._inside, ceiling[watched], 0.0) + _FALLS
        self._travel = separation.travel[separation.classes[watched]]
        self._lower, self._upper = limits.lower, limits.upper
        # random postures are between these; a half turn either way for joints without limits
        self._from = np.where(np.isfinite(limits.lower), limits.lower, q - np.pi)
        self._to = np.where(np.isfinite(limits.upper), limits.upper, q + np.pi)
        count = len(watched)
        # measured distances or bounds of them, each at a posture
        self._distance = np.full(count, -np.inf) if known is None else known[watched]
        self._seen_at = np.tile(q, (count, 1))

    def descent(self, q: Vector) -> RouteSearch:
        """The falling route on which the violations fall fastest from q (n,), or None if it does not lead out."""
        nodes = yield from self._descend(q, None, 1.0)
        return None if nodes is None else EscapeRoute(np.array(nodes), True)

    def falling(self, q: Vector) -> RouteSearch:
        """A falling route from q (n,), or None."""
        for number in range(_DESCENTS):
            aim = self._rng.uniform(self._from, self._to)
            nodes = yield from self._descend(q, aim, _PARTS[number % len(_PARTS)])
            if nodes is not None:
                return EscapeRoute(np.array(nodes), True)
        return None

    def below(self, q: Vector) -> RouteSearch:
        """A route below from q (n,), or None."""
        goals = yield from self._clear_postures(q)
        if not goals:
            return None
        looks = 0
        for goal in goals[: _CLEAR_GOALS // 2]:
            looks += _looks(q, goal)
            if looks > _LINE_LOOKS:
                break
            if (yield from self._line_is_allowed(q, goal, self._ceiling)):
                return EscapeRoute(np.array([q, goal]), False)
        nodes = yield from self._connect(q, goals)
        if nodes is None:
            return None
        nodes = yield from self._shorter(nodes)
        return EscapeRoute(np.array(nodes), False)

    def returns(self, q: Vector) -> Generator[None, None, bool]:
        """Whether the joints can return straight to within their limits from q (n,), where nothing is violated."""
        return (yield from self._line_is_allowed(q, np.clip(q, self._lower, self._upper), _SLIGHT))

    # --- one posture -------------------------------------------------------------------

    def _depth(self, q: Vector, margin: float = 0.0) -> Generator[None, None, tuple[Vector, Indices, Matrix]]:
        """How deep the pairs are at q (n,), exact for those within `margin` of their clearance [m].

        Returns
        -------
        (K,) depths [m]; indices (M,) of the pairs that were measured; (M, n) how their depths grow
        with the joints [m/rad].
        """
        least = self._distance - (self._travel * np.abs(q - self._seen_at)).sum(axis=1)
        close = (least < self._clearance + max(margin, _BEYOND)).nonzero()[0]
        self._at.place(0, q)
        if len(close):  # the planes bound the distances everywhere
            gaps = least_gaps_at(self._separation, self._pairs[close], self._at, 0)
            least[close] = self._distance[close] = np.maximum(least[close], gaps)
            self._seen_at[close] = q
            close = close[gaps < self._clearance[close] + max(margin, _BEYOND)]
        self.looked += self._per_posture
        distance, falls = np.zeros(len(close)), np.zeros((len(close), len(q)))
        for first in range(0, len(close), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            if first:
                yield
            distance[some], falls[some] = measure_gradients(self._separation, self._pairs[close[some]], self._at, 0)
            self.looked += len(close[some])
        least[close] = distance
        self._distance[close], self._seen_at[close] = distance, q
        return self._clearance - least, close, falls

    # --- a falling route ---------------------------------------------------------------

    def _descend(self, q: Vector, aim: Vector | None, part: float) -> Generator[None, None, list[Vector] | None]:
        """The postures of a descent from q (n,) towards `aim` (n,), or None if it does not lead out.

        `part` is the wished fall of V per length of a step [m/rad].
        """
        nodes, trust = [q], _TRUST
        depth, close, falls = yield from self._depth(q, _NEAR)
        yield
        nothing = np.zeros(len(q))
        for _ in range(_DESCENT_LOOKS - 1):
            violated = self._inside & (depth > 0.0)
            deepest = by_owner(np.where(self._inside, depth, 0.0), self._owner)
            if not violated.any():
                return nodes
            hard = violated[close]
            rows, others = falls[hard], falls[~hard]
            own = close[hard]
            wish = nothing if aim is None else aim - q
            if aim is not None:
                wish = wish * (trust / max(float(np.abs(wish).max()), _SHORTEST))
            found = way_back(
                rows, _HOLDS * (deepest[own] - depth[own]),
                target=wish,
                # a joint beyond a limit may come back, but not go further out
                low=np.minimum(np.maximum(-trust, self._lower - q), 0.0),
                high=np.maximum(np.minimum(trust, self._upper - q), 0.0),
                fastest=part * trust,
                others=(Rows("clearance", others, np.maximum(-depth[close[~hard]], 0.0)),),
            )  # fmt: skip
            if found is None:
                return None
            tried = q + found[0]
            there, seen, gradient = yield from self._depth(tried, _NEAR)
            yield
            held = by_owner(np.where(self._inside, there, 0.0), self._owner)
            falls_there = (held <= np.maximum(deepest - _FALLS, 0.0))[violated].all()
            stays_clear = not (there[~self._inside] > np.maximum(depth[~self._inside], 0.0) + _FALLS).any()
            if falls_there and stays_clear:
                q, depth, close, falls = tried, there, seen, gradient
                nodes.append(q)
                trust = min(1.5 * trust, _TRUST)
            else:
                trust *= 0.5
                if trust < _SHORTEST:
                    return None
        return None

    # --- a route below -----------------------------------------------------------------

    def _clear_postures(self, q: Vector) -> Generator[None, None, list[Vector]]:
        """Clear postures, the nearest to q (n,) first: some are nearby, others have only a few joints moved."""
        rng, found = self._rng, []
        within = np.clip(q, self._lower, self._upper)
        for number in range(_GOALS):
            if number % 2:
                goal = within + rng.normal(size=len(q)) * rng.uniform(0.0, _NEAR_BY)
                goal = np.clip(goal, self._lower, self._upper)
            else:
                moved = rng.random(len(q)) < rng.uniform(0.2, 1.0)
                goal = np.where(moved, rng.uniform(self._from, self._to), within)
            depth, _, _ = yield from self._depth(goal)
            yield
            if (depth <= -_BEYOND).all():
                found.append(goal)
                if len(found) == _CLEAR_GOALS:
                    break
        return sorted(found, key=lambda goal: float(np.abs(goal - q).max()))

    def _line_is_allowed(self, start: Vector, end: Vector, most: Vector | float) -> Generator[None, None, bool]:
        """Whether no pair is deeper than `most` (K,) [m] at any examined posture along a straight line."""
        count = _looks(start, end)
        for part in range(1, count + 1):
            depth, _, _ = yield from self._depth(start + (part / count) * (end - start))
            yield
            if not (depth <= most).all():
                return False
        return True

    def _connect(self, q: Vector, goals: list[Vector]) -> Generator[None, None, list[Vector] | None]:
        """A route from q (n,) to one of the goals (n,) by two trees, or None."""
        trees = [_Tree([q]), _Tree(goals)]
        looks = 0
        while looks < _TREE_LOOKS:
            aim = self._rng.uniform(self._from, self._to)
            reached = None
            for tree in trees:
                node, more = yield from self._grow(tree, aim)
                looks += more
                if node is None:
                    break
                if reached is None:
                    reached, aim = node, tree.nodes[node]
                elif np.abs(tree.nodes[node] - aim).max() < _SHORTEST:
                    first, second = trees[0].back_from(reached), tree.back_from(node)
                    way = first[::-1] + second[1:]
                    return way if trees[0].nodes[0] is q else way[::-1]
            trees.reverse()
        return None

    def _grow(self, tree: _Tree, aim: Vector) -> Generator[None, None, tuple[int | None, int]]:
        """Grow a tree towards a posture (n,); return the node that came nearest, or None, and the looks needed."""
        nearest = tree.nearest(aim)
        start = tree.nodes[nearest]
        length = float(np.abs(aim - start).max())
        if length < _SHORTEST:
            return nearest, 1
        count, branch = _looks(start, aim), round(_EXTEND / _RESOLUTION)
        looks, last, reached = 0, nearest, None
        for part in range(1, count + 1):
            there = start + (part / count) * (aim - start)
            depth, _, _ = yield from self._depth(there)
            looks += 1
            yield
            if not (depth <= self._ceiling).all():
                break
            if part % branch == 0 or part == count:
                last = reached = tree.add(there, last)
                if part >= _BRANCHES * branch and part < count:
                    break
        return reached, looks

    def _shorter(self, nodes: list[Vector]) -> Generator[None, None, list[Vector]]:
        """The same route without the nodes that straight lines can skip."""
        kept, here, looks = [nodes[0]], 0, 0
        while here < len(nodes) - 1:
            after = here + 1
            for ahead in (len(nodes) - 1, (here + len(nodes)) // 2, here + 4, here + 2):
                more = _looks(nodes[here], nodes[ahead]) if here + 1 < ahead < len(nodes) else _LINE_LOOKS
                if looks + more < _LINE_LOOKS:
                    looks += more
                    if (yield from self._line_is_allowed(nodes[here], nodes[ahead], self._ceiling)):
                        after = ahead
                        break
            here = after
            kept.append(nodes[here])
        return kept


def _looks(start: Vector, end: Vector) -> int:
    """How many looks a line from `start` to `end` (n,) needs."""
    return max(int(np.ceil(float(np.abs(end - start).max()) / _RESOLUTION)), 1)


class _Tree:
    """Postures, each with the one that it was reached from."""

    def __init__(self, roots: list[Vector]) -> None:
        self.nodes = list(roots)
        self._parents = [-1] * len(roots)

    def nearest(self, q: Vector) -> int:
        return int(((np.array(self.nodes) - q) ** 2).sum(axis=1).argmin())

    def add(self, q: Vector, parent: int) -> int:
        self.nodes.append(q)
        self._parents.append(parent)
        return len(self.nodes) - 1

    def back_from(self, number: int) -> list[Vector]:
        """The postures from a node to its root."""
        way = []
        while number >= 0:
            way.append(self.nodes[number])
            number = self._parents[number]
        return way
