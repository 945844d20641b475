"""The search for a way out, where going down does not lead there.

Two kinds of way are looked for from a posture q that is closer to something than allowed.

A *falling* way: a chain of postures along which the deepest violation of every obstacle
falls from each to the next. Such chains are found by descents towards postures chosen
at random: of the steps that make every obstacle's deepest violation fall, the one
nearest to the wished direction is taken. The first descent wishes for nothing; it is
the one that the servo makes by itself.

A way *below*: a chain of straight lines to a posture that is clear, along which no
obstacle's deepest violation ever is more than it was where the machine began. What
falls along it is

    W(q) = length of the way from q to its end,

so there is nothing to be stuck in. In between a violation may grow back, up to what it
was. It is found as a straight line to one of many clear postures, or else by two trees
that grow towards each other (RRT-Connect, Kuffner and LaValle 2000).

Both only steer the servo; what is taken is measured anew at every step.

The search is a generator: between two yields it looks at one posture, so that it can be
spread over the servo's steps. It looks at no more than `MOST_LOOKS` postures, and keeps
no more than that.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.law import Rows
from backhoe_planner.live.braking.braking_path import Placements
from backhoe_planner.live.braking.separation import Separation
from backhoe_planner.live.recovery.violation_descent import by_owner, way_back
from backhoe_planner.machine import JointLimits, Robot

_DESCENTS, _DESCENT_LOOKS = 40, 120  # how many are tried, and the postures of one
_NEAR_BY = 0.5  # rad or m
_GOALS, _CLEAR_GOALS = 300, 40  # postures tried, and those kept for being clear
_TREE_LOOKS, _LINE_LOOKS = 4000, 4000
_TRUST = 0.03  # rad or m: longest step of a descent
_SHORTEST = 1e-4
_RESOLUTION = 0.02  # rad or m: between two looks along a line
_EXTEND = 0.2  # rad or m: a branch of the trees
_BRANCHES = 3  # that a tree grows at once
_BEYOND = 0.003  # m: a way ends that much clearer than asked
_SLIGHT = 1e-3  # m: what the servo's own rows make room for
_NEAR = 0.1  # m: of what a descent keeps clear
_FALLS = 1e-7  # m
_LEVEL = 1e-7  # m: what counts as no more than before
_HOLDS = 0.5
MOST_LOOKS = (
    (_DESCENTS + 1) * _DESCENT_LOOKS
    + _GOALS
    + 3 * _LINE_LOOKS
    + _TREE_LOOKS
    + 2 * _BRANCHES * round(_EXTEND / _RESOLUTION)  # the last branches
)
_PARTS = (0.02, 0.1, 0.3, 0.0)  # of a step's length, by which the violation is to fall [m/rad]

RouteSearch = Generator[None, None, "EscapeRoute | None"]


@dataclass(frozen=True)
class EscapeRoute:
    """A way out.

    Attributes
    ----------
    nodes: (N, n) postures; straight lines between them.
    falling: whether the deepest violations fall all along it.
    """

    nodes: Matrix
    falling: bool


class EscapeSearch:
    """The search from one posture in one site.

    Parameters
    ----------
    separation: what may be touched; only read. It must not change while the search is on.
    q: (n,) where the machine stands.
    watched: pairs that stand still.
    inside: those of them that are violated.
    ceiling: (P,) of every pair of `separation` how deep it may be on a way below [m].
    rng: what is random.

    Attributes
    ----------
    looked: how many postures and pairs were looked at until now.
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
    ) -> None:
        self._separation, self._rng = separation, rng
        self._at = Placements(robot, 1)
        self.looked = 0
        self._pairs = watched
        self._inside = np.isin(watched, inside)
        self._clearance = separation.clearance[watched]
        self._owner = separation.owner[watched]
        self._ceiling = np.where(self._inside, ceiling[watched], 0.0) + _LEVEL
        self._travel = separation.travel[separation.classes[watched]]
        self._lower, self._upper = limits.lower, limits.upper
        # where postures are chosen; a turn either way for joints without limits
        self._from = np.where(np.isfinite(limits.lower), limits.lower, q - np.pi)
        self._to = np.where(np.isfinite(limits.upper), limits.upper, q + np.pi)
        count = len(watched)
        self._distance, self._seen_at = np.full(count, -np.inf), np.zeros((count, robot.n))

    def descent(self, q: Vector) -> RouteSearch:
        """The falling way on which the violations fall fastest from q (n,), or None where that leads nowhere."""
        nodes = yield from self._descend(q, None, 1.0)
        return None if nodes is None else EscapeRoute(np.array(nodes), True)

    def falling(self, q: Vector) -> RouteSearch:
        """A falling way from q (n,), or None."""
        for number in range(_DESCENTS):
            aim = self._rng.uniform(self._from, self._to)
            nodes = yield from self._descend(q, aim, _PARTS[number % len(_PARTS)])
            if nodes is not None:
                return EscapeRoute(np.array(nodes), True)
        return None

    def below(self, q: Vector) -> RouteSearch:
        """A way below from q (n,), or None."""
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
        """Whether the joints can come straight back within their limits from q (n,) where nothing is violated."""
        return (yield from self._line_is_allowed(q, np.clip(q, self._lower, self._upper), _SLIGHT))

    # --- one posture -------------------------------------------------------------------

    def _depth(self, q: Vector, margin: float = 0.0) -> tuple[Vector, Indices, Matrix]:
        """(K,) how deep the pairs are, exact from `margin` on [m]; which were measured, and how they deepen (M, n)."""
        least = self._distance - (self._travel * np.abs(q - self._seen_at)).sum(axis=1)
        close = (least < self._clearance + max(margin, _BEYOND)).nonzero()[0]
        self._at.place(0, q)
        if len(close):  # the planes that are known say something everywhere
            gaps = self._separation.gaps(self._pairs[close], self._at, 1)[0].min(axis=1)
            least[close] = np.maximum(least[close], gaps)
            close = close[gaps < self._clearance[close] + max(margin, _BEYOND)]
        self.looked += 1 + len(close)
        distance, falls = self._separation.gradients(self._pairs[close], self._at, 0)
        least[close] = distance
        self._distance[close], self._seen_at[close] = distance, q
        return self._clearance - least, close, falls

    # --- a falling way -----------------------------------------------------------------

    def _descend(self, q: Vector, aim: Vector | None, part: float) -> Generator[None, None, list[Vector] | None]:
        nodes, trust = [q], _TRUST
        depth, close, falls = self._depth(q, _NEAR)
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
                # beyond a limit a joint may come back, not go further out
                low=np.minimum(np.maximum(-trust, self._lower - q), 0.0),
                high=np.maximum(np.minimum(trust, self._upper - q), 0.0),
                fastest=part * trust,
                others=(Rows("clearance", others, np.maximum(-depth[close[~hard]], 0.0)),),
            )  # fmt: skip
            if found is None:
                return None
            tried = q + found[0]
            there, seen, gradient = self._depth(tried, _NEAR)
            yield
            held = by_owner(np.where(self._inside, there, 0.0), self._owner)
            falls_there = (held <= np.maximum(deepest - _FALLS, 0.0))[violated].all()
            stays_clear = not (there[~self._inside] > np.maximum(depth[~self._inside], 0.0) + _LEVEL).any()
            if falls_there and stays_clear:
                q, depth, close, falls = tried, there, seen, gradient
                nodes.append(q)
                trust = min(1.5 * trust, _TRUST)
            else:
                trust *= 0.5
                if trust < _SHORTEST:
                    return None
        return None

    # --- a way below -------------------------------------------------------------------

    def _clear_postures(self, q: Vector) -> Generator[None, None, list[Vector]]:
        """Clear postures, the nearest first; some near by, of others only a few joints are elsewhere than at q."""
        rng, found = self._rng, []
        within = np.clip(q, self._lower, self._upper)
        for number in range(_GOALS):
            if number % 2:
                goal = within + rng.normal(size=len(q)) * rng.uniform(0.0, _NEAR_BY)
                goal = np.clip(goal, self._lower, self._upper)
            else:
                moved = rng.random(len(q)) < rng.uniform(0.2, 1.0)
                goal = np.where(moved, rng.uniform(self._from, self._to), within)
            depth, _, _ = self._depth(goal)
            yield
            if (depth <= -_BEYOND).all():
                found.append(goal)
                if len(found) == _CLEAR_GOALS:
                    break
        return sorted(found, key=lambda goal: float(np.abs(goal - q).max()))

    def _line_is_allowed(self, start: Vector, end: Vector, most: Vector | float) -> Generator[None, None, bool]:
        """Whether no pair is deeper than `most` (K,) [m] anywhere on a straight line."""
        count = _looks(start, end)
        for part in range(1, count + 1):
            depth, _, _ = self._depth(start + (part / count) * (end - start))
            yield
            if not (depth <= most).all():
                return False
        return True

    def _connect(self, q: Vector, goals: list[Vector]) -> Generator[None, None, list[Vector] | None]:
        trees = [_Tree([q]), _Tree(goals)]
        looks = 0
        while looks < _TREE_LOOKS:
            aim = self._rng.uniform(self._from, self._to)
            reached = None
            for tree in trees:
                grown = yield from self._grow(tree, aim, _EXTEND)
                looks += grown[1]
                if grown[0] is None:
                    break
                if reached is None:
                    reached, aim = grown[0], tree.nodes[grown[0]]
                elif np.abs(tree.nodes[grown[0]] - aim).max() < _SHORTEST:
                    first, second = trees[0].back_from(reached), tree.back_from(grown[0])
                    way = first[::-1] + second[1:]
                    return way if trees[0].nodes[0] is q else way[::-1]
            trees.reverse()
        return None

    def _grow(self, tree: _Tree, aim: Vector, most: float) -> Generator[None, None, tuple[int | None, int]]:
        """The node of the tree that came nearest to a posture, None where there is no new one; and the looks taken."""
        nearest = tree.nearest(aim)
        start = tree.nodes[nearest]
        length = float(np.abs(aim - start).max())
        if length < _SHORTEST:
            return nearest, 1
        count = max(int(np.ceil(length / _RESOLUTION)), 1)
        branch = max(round(most / _RESOLUTION), 1)
        looks, last, reached = 0, nearest, None
        for part in range(1, count + 1):
            there = start + (part / count) * (aim - start)
            depth, _, _ = self._depth(there)
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
        """The same way without the corners that are not needed."""
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
    """How often a line is looked at."""
    return max(int(np.ceil(float(np.abs(end - start).max()) / _RESOLUTION)), 1)


class _Tree:
    """Postures, each with the one it was reached from."""

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
        """From a node to its root."""
        way = []
        while number >= 0:
            way.append(self.nodes[number])
            number = self._parents[number]
        return way
