"""Different routes through a roadmap: the cheapest first, none of them near a known one.

Nodes are the start, the ends, and clear configurations through which a motion can be short enough: drawn at random,
and in the middle between two that are not clear, which finds narrow passages (bridge test, Hsu et al. 2003). Each
node is joined to its nearest. An edge is checked in its middle when the roadmap is made, and along its whole length
once a route uses it (lazy roadmaps, Bohlin and Kavraki 2000). The costs of every node from the start and to an end
give the cheapest route through each node (alternative routes through via nodes, Abraham et al. 2013).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.planning.search.chart import Chart
from backhoe_planner.planning.search.reach import Reach, beyond_limits
from backhoe_planner.planning.search.sampled_check import SampledCheck
from backhoe_planner.planning.search.sampling import JointPath

# (E,) the costs of straight motions from the first (E, n) to the second (E, n)
Price = Callable[[Matrix, Matrix], Vector]

_NEIGHBOURS = 12  # to which a node is joined; chosen
_DRAWN = 6  # at most so many times as many configurations as nodes are drawn, if few are within reach or clear; chosen
_BRIDGES = 10  # tried from each configuration that is not clear; chosen: one in thirty is a bridge
_BRIDGE = 0.4  # s of each joint: the standard deviation of a bridge's length; chosen among 0.3 to 0.8
_MOST_BLOCKED = 60  # blocked routes, after which no further route is sought; chosen
_NEAR = 0.15  # part of a route's length: configurations nearer to it do not make another route; chosen
_PLACES = 5  # of each straight motion of a route, from which that is measured
_TOGETHER = 500  # nodes whose nearest are found at once, to bound the memory
_LEAST = 1e-6  # part of the mean price: the least cost of a step, well above the rounding of a route's price
_EVEN = 0.05  # part of the Euclidean joint time, added to the slowest joint's; it decides between equals


def joint_time(rate: Vector) -> Price:
    """The estimated time of straight motions [s], at full velocities `rate` (n,)."""

    def price(a: Matrix, b: Matrix) -> Vector:
        step = np.abs(b - a) / rate
        return np.asarray(np.max(step, axis=1) + _EVEN * np.linalg.norm(step, axis=1))

    return price


def _distinct(q: Matrix) -> Matrix:
    """(M, n) configurations (N, n), each once: with one joint, many of those that are drawn are the same limit."""
    _, first = np.unique(q, axis=0, return_index=True)
    return q[np.sort(first)]


class Roadmap:
    """A roadmap from a start to several ends.

    Parameters
    ----------
    check: decides what is clear; made for the start and the ends.
    reach: start, ends, and how long a motion may take.
    nodes: how many are drawn.
    rng: by which they are drawn.
    price: of straight motions.
    known: (K, n) each: places along known routes, which become nodes too.
    """

    def __init__(
        self, check: SampledCheck, reach: Reach, *,
        nodes: int, rng: np.random.Generator, price: Price, known: Sequence[Matrix] = (),
    ) -> None:  # fmt: skip
        self._check, self._reach, self._price = check, reach, price
        self._rate = reach.limits.velocity
        self._ends = np.arange(1, 1 + len(reach.ends))
        places = [way[reach.holds(way)] for way in known]
        self._q = np.vstack((reach.start, reach.ends, *places, _distinct(np.vstack(self._draw(nodes, rng)))))
        self._near = np.zeros(len(self._q), dtype=bool)  # to known routes
        for way in known:
            self.avoid(way)
        self._clear: set[tuple[int, int]] = set()  # edges that were checked along their whole length
        self._join(*self._nearest())

    def avoid(self, way: Matrix) -> None:
        """Exclude further routes whose via node is near the route through places (K, n)."""
        part = np.linspace(0.0, 1.0, _PLACES, endpoint=False)[:, None, None]
        x, left = way / self._rate, np.flatnonzero(~self._near)
        step = np.diff(x, axis=0)
        within = _NEAR * float(np.sum(np.max(np.abs(step), axis=1)))
        places = (x[:-1] + part * step).reshape(-1, x.shape[1])
        near = np.ones((len(places), len(left)), dtype=bool)
        for place, at in zip(places.T, (self._q[left] / self._rate).T, strict=True):
            near &= np.abs(place[:, None] - at) < within
        self._near[left] = near.any(axis=0)

    def ways(self, *, dearest: float = np.inf) -> Iterator[JointPath]:
        """Routes to an end, the cheapest first, each through a configuration that is not near those before.

        Parameters
        ----------
        dearest: the highest price of a route.

        Raises
        ------
        OutOfTime: the budget of the check's brake is used up.
        """
        start = np.zeros(1, dtype=np.intp)
        blocked, changed = 0, True
        while blocked < _MOST_BLOCKED:
            if changed:
                out, before = self._prices(self._out, start)
                back, after = self._prices(self._back, self._ends)
            price = np.where(self._near, np.inf, out + back)
            via = int(np.argmin(price))
            if not price[via] <= dearest or price[via] == np.inf:
                return
            nodes = [via]
            while nodes[-1] != 0:
                nodes.append(int(before[nodes[-1]]))
            nodes.reverse()
            while not 1 <= nodes[-1] <= len(self._ends):
                nodes.append(int(after[nodes[-1]]))
            changed = self._drop_blocked(nodes)
            if changed:
                blocked += 1
                continue
            self.avoid(self._q[nodes])
            self._near[via] = True
            yield JointPath(self._q[nodes])

    def _draw(self, count: int, rng: np.random.Generator) -> list[Matrix]:
        """Clear configurations (K, n) within reach."""
        reach, chart = self._reach, Chart(self._check)
        chart.begin_at(reach.start)
        travel, (lower, upper) = reach.travel(), reach.box()
        found: list[Matrix] = []
        have = 0
        for _ in range(_DRAWN):
            ends = reach.ends[rng.integers(len(reach.ends), size=count)]
            low, high = np.minimum(reach.start, ends), np.maximum(reach.start, ends)
            if reach.longest < np.inf:
                beside = 0.5 * (travel - (high - low))
                low, high = np.maximum(low - beside, lower), np.minimum(high + beside, upper)
            else:
                low, high = np.broadcast_to(lower, ends.shape), np.broadcast_to(upper, ends.shape)
            low, high = np.array(low), np.array(high)
            low[::2], high[::2] = beyond_limits(
                reach.limits, low[::2], high[::2]
            )  # with seven joints, one is mostly at a limit then
            q = low + rng.random(ends.shape) * (high - low)
            q = chart.into_band(np.clip(q, reach.limits.lower, reach.limits.upper), rng)
            q = self._within(q, lower, upper)[: count - have]
            clear = self._check.keeps(q)
            found += [q[clear], self._bridges(q[~clear], lower, upper, rng)]
            have += int(np.count_nonzero(clear))
            if have >= count:
                break
        return found

    def _bridges(self, q: Matrix, lower: Vector, upper: Vector, rng: np.random.Generator) -> Matrix:
        """(K, n) clear configurations in the middle between one of `q` (N, n), which are not clear, and another."""
        one = np.repeat(q, _BRIDGES, axis=0)
        other = one + rng.normal(0.0, _BRIDGE, one.shape) * self._rate
        middle = 0.5 * (one + other)
        inside = self._reach.holds(middle) & ((middle >= lower) & (middle <= upper)).all(axis=1)
        other, middle = other[inside], middle[inside]
        clear = self._check.keeps(middle)  # the rarer of the two conditions first
        other, middle = other[clear], middle[clear]
        return middle[~self._check.keeps(other)]

    def _within(self, q: Matrix, lower: Vector, upper: Vector) -> Matrix:
        return q[self._reach.holds(q) & ((q >= lower) & (q <= upper)).all(axis=1)]

    def _nearest(self) -> tuple[Indices, Indices]:
        """(E,) the nodes at the ends of the edges, each pair once."""
        at = (self._q / self._rate).astype(np.float32)
        count = len(at)
        each = min(_NEIGHBOURS, count - 1)
        pairs: list[Indices] = []
        for first in range(0, count, _TOGETHER):
            rows = at[first : first + _TOGETHER]
            apart = np.zeros((len(rows), count), dtype=np.float32)
            for own, other in zip(rows.T, at.T, strict=True):
                np.maximum(apart, np.abs(own[:, None] - other), out=apart)
            apart[np.arange(len(rows)), first + np.arange(len(rows))] = np.inf
            # finding the distance of the furthest neighbour takes half as long as finding the neighbours
            furthest = np.partition(apart, each - 1, axis=1)[:, each - 1 : each]
            one, other = np.nonzero(apart <= furthest)
            pairs.append(np.minimum(first + one, other) * count + np.maximum(first + one, other))
        found = np.unique(np.concatenate(pairs))
        return found // count, found % count

    def _join(self, one: Indices, other: Indices) -> None:
        """Join these nodes (E,) by edges, if these are clear in the middle."""
        clear = self._check.keeps(0.5 * (self._q[one] + self._q[other]))
        one, other = one[clear], other[clear]
        there, back = self._price(self._q[one], self._q[other]), self._price(self._q[other], self._q[one])
        # each step costs something, so that no route goes in a circle
        least = _LEAST * float(np.mean(there + back)) if len(one) else 0.0
        there, back = np.maximum(there, least), np.maximum(back, least)
        one, other = np.append(one, other), np.append(other, one)
        there, back = np.append(there, back), np.append(back, there)
        order, count = np.argsort(one, kind="stable"), np.bincount(one, minlength=len(self._q))
        one, other = one[order], other[order]
        slot = np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count)
        # (N, M) the nodes to which each is joined, and the costs from them and to them
        self._joined = np.zeros((len(self._q), max(int(count.max()), 1)), dtype=np.intp)
        self._out = np.full(self._joined.shape, np.inf)
        self._back = self._out.copy()
        self._joined[one, slot] = other
        self._out[one, slot], self._back[one, slot] = back[order], there[order]

    def _prices(self, step: Matrix, roots: Indices) -> tuple[Vector, Indices]:
        """(N,) the least cost between every node and any of `roots`, and the next node on that route."""
        cost = np.full(len(self._q), np.inf)
        cost[roots] = 0.0
        changed = roots
        while len(changed):  # Bellman and Ford, all nodes at once that are joined to one whose cost became less
            self._check.brake.check()
            beside = np.zeros(len(cost), dtype=bool)
            beside[self._joined[changed]] = True
            nodes = np.flatnonzero(beside)
            least = (cost[self._joined[nodes]] + step[nodes]).min(axis=1)
            less = least < cost[nodes]
            changed = nodes[less]
            cost[changed] = least[less]
        slot = np.argmin(cost[self._joined] + step, axis=1)
        return cost, self._joined[np.arange(len(slot)), slot]

    def _drop_blocked(self, nodes: Sequence[int]) -> bool:
        """Check the edges of a route along their whole length, and remove blocked ones; whether there are any."""
        blocked = False
        for pair in itertools.pairwise(nodes):
            a, b = sorted(pair)
            if (a, b) in self._clear:
                continue
            if self._check.segment_is_clear(self._q[a], self._q[b]):
                self._clear.add((a, b))
                continue
            blocked = True
            for one, other in ((a, b), (b, a)):
                gone = self._joined[one] == other
                self._out[one, gone] = self._back[one, gone] = np.inf
        return blocked
