"""Curves from which descents may begin, and estimates of which of them will cost least."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal
from backhoe_planner.planning.descent.curve import JointCurve, from_rest_to_rest
from backhoe_planner.planning.descent.descent_of_cost import DescentOfCost
from backhoe_planner.site import ClearanceScreen

_PLACES = 25  # of a curve, that are checked for collisions; chosen, about every 2 to 10 cm of the tip
_PART = 0.5  # part of the curve in which an early or a late joint makes its whole move; chosen
_APART = 0.15  # part of the longest time: joint time between two starts that count as different; chosen
_CLOSER = (0.08, 0.04)  # the same, in turn, until there are enough; chosen
_SAME = 0.05  # the same between a start and one that was tried before; chosen
_EQUAL = 0.005  # the same between two starts whose descents end alike; chosen
_DEAR = 3.0  # times the least price, above which no descent is tried; measured: above it hardly any becomes the best
_BESIDE = 6  # starts with joints early or late, in addition to the cheapest of each line; chosen
# starts that are priced at once, to bound the memory, and that are checked at once: not all, as some need no check
_TOGETHER, _CHECKED_TOGETHER = 100, 16


@dataclass(frozen=True, eq=False)
class Start:
    """A curve from which a descent may begin, its estimated duration [s], where it ends, and how it was found."""

    curve: JointCurve
    duration: float
    goal: Goal
    way: str


@dataclass(frozen=True, eq=False)
class PricedStart:
    """A start, and the estimated cost of a descent from it, which grows with the blocked part, to at most twice."""

    start: Start
    price: float


class StartPrices:
    """The prices of starts among the same obstacles.

    Parameters
    ----------
    descent: estimates the costs.
    screen: of the obstacles.
    longest: the longest time that a motion may take [s].
    alike: (n,) how far each joint may turn or slide in a second that count alike in distances between starts [rad/s or
        m/s]; by default the velocity limits.
    """

    def __init__(
        self, descent: DescentOfCost, screen: ClearanceScreen, *, longest: float, alike: Vector | None = None
    ) -> None:
        self._descent, self._screen, self._longest = descent, screen, longest
        self._alike = descent.rate if alike is None else alike

    def in_order(self, starts: Sequence[Start]) -> Iterator[PricedStart]:
        """Starts with equally many pieces, the cheapest first; the blocked part is checked only if needed."""
        # a start that is not checked yet costs at least this
        left = sorted((cost, index) for index, cost in enumerate(self._where_clear(starts)))
        left.reverse()
        checked: list[tuple[float, int]] = []
        while left or checked:
            if left and (not checked or left[-1] < checked[0]):
                some = [left.pop() for _ in range(min(_CHECKED_TOGETHER, len(left)))]
                for (cost, index), dearer in zip(some, self._dearer([starts[k] for _, k in some]), strict=True):
                    heapq.heappush(checked, (cost * dearer, index))
            else:
                price, index = heapq.heappop(checked)
                yield PricedStart(starts[index], price)

    def cheapest(
        self, priced: Iterable[PricedStart], count: int, *, known: Sequence[JointCurve] = ()
    ) -> list[PricedStart]:
        """At most `count` of starts in order of price, none of them dear; of those near each other only the cheapest.

        Parameters
        ----------
        known: curves with equally many pieces; starts near them are left out.
        """
        chosen: list[PricedStart] = []
        least: float | None = None
        for one in priced:
            least = one.price if least is None else least
            if one.price > _DEAR * least:
                break
            others = [other.start.curve for other in chosen]
            if not self._is_near(one, others, _APART) and not self._is_near(one, known):
                chosen.append(one)
            if len(chosen) >= count:
                break
        return chosen

    def fair(self, priced: Iterable[PricedStart]) -> list[PricedStart]:
        """The starts, in order of price, before the first that is dear."""
        found: list[PricedStart] = []
        for one in priced:
            if found and one.price > _DEAR * found[0].price:
                break
            found.append(one)
        return found

    def spread(
        self, priced: Sequence[PricedStart], count: int, *, known: Sequence[JointCurve] = ()
    ) -> list[PricedStart]:
        """At most `count` of starts in order of price, at equal steps of this order.

        Parameters
        ----------
        known: curves with equally many pieces; starts that are not far from one of them are left out.
        """
        left = [one for one in priced if not self._is_near(one, known, _APART)]
        return left[:: max(-(-len(left) // count), 1)]

    def spaced(
        self, priced: Sequence[PricedStart], count: int, *, known: Sequence[JointCurve] = ()
    ) -> list[PricedStart]:
        """At most `count` of starts in order of price: those far from each other first, then nearer ones.

        Parameters
        ----------
        known: curves with equally many pieces; starts near them are left out.
        """
        left, chosen = [one for one in priced if not self._is_near(one, known)], list[PricedStart]()
        for apart in _CLOSER:
            rest: list[PricedStart] = []
            for one in left:
                near = len(chosen) >= count or self._is_near(one, [other.start.curve for other in chosen], apart)
                (rest if near else chosen).append(one)
            left = rest
        return chosen

    def repeats(self, one: PricedStart, known: Sequence[JointCurve]) -> bool:
        """Whether a descent from a start ends like that from one of the `known` curves, with equally many pieces."""
        return self._is_near(one, known, _EQUAL)

    def paced(self, lines: Sequence[PricedStart]) -> list[PricedStart]:
        """The straight `lines` with some joints early or late, so that they cost less; the cheapest first.

        The cost of a motion often depends on which joint moves first: an arm that is unfolded after it was lowered
        needs little of the work of one that is held out meanwhile, and no small step leads there from an even pace. The
        joints are tried one after the other, twice. The other starts that were tried are included, except those that
        are dear or near another.
        """
        if not lines:
            return []
        best = list(lines)
        met: list[PricedStart] = []  # their prices do not include the blocked part yet
        n = lines[0].start.curve.control.shape[1]
        for joint in (*range(n), *range(n)):
            tried = [
                list(_with_other_paces(line.start, one.start, joint)) for line, one in zip(lines, best, strict=True)
            ]
            cost = iter(self._where_clear([other for others in tried for other in others]))
            for index, others in enumerate(tried):
                for other in others:
                    price = next(cost)
                    met.append(PricedStart(other, price))
                    if price < best[index].price:
                        price *= self._dearer([other])[0]
                    if price < best[index].price:
                        best[index] = PricedStart(other, price)
        changed = [one for one, line in zip(best, lines, strict=True) if one is not line]
        return sorted([*changed, *self._beside(best, met)], key=lambda one: one.price)

    def _beside(self, best: Sequence[PricedStart], met: Sequence[PricedStart]) -> list[PricedStart]:
        """Those starts of `met` that are neither dear nor near one of the `best`, or each other."""
        found: list[PricedStart] = []
        dear = _DEAR * min(one.price for one in best)
        for one in sorted(met, key=lambda one: one.price):
            if one.price > dear or len(found) >= _BESIDE:
                break
            if self._is_near(one, [other.start.curve for other in (*best, *found)], _APART):
                continue
            price = one.price * self._dearer([one.start])[0]
            if price <= dear:
                found.append(PricedStart(one.start, price))
        return found

    def _where_clear(self, starts: Sequence[Start]) -> list[float]:
        """Estimated costs of descents from starts, as if nothing were blocked."""
        found: list[float] = []
        for first in range(0, len(starts), _TOGETHER):
            some = starts[first : first + _TOGETHER]
            durations = np.array([max(start.duration, self._longest) for start in some])
            found += self._descent.estimates([start.curve for start in some], durations, longest=self._longest).tolist()
        return found

    def _dearer(self, starts: Sequence[Start]) -> list[float]:
        """The factors on the costs of starts with equally many pieces for their blocked parts: 1 to 2."""
        q = starts[0].curve.weights(_PLACES) @ np.array([start.curve.control for start in starts])
        keeps = self._screen.keeps(q.reshape(-1, q.shape[2])).reshape(len(starts), -1)
        return [2.0 - part for part in np.mean(keeps, axis=1).tolist()]

    def _is_near(self, one: PricedStart, known: Sequence[JointCurve], within: float = _SAME) -> bool:
        """Whether a start is near one of `known`, with equally many pieces, by `within`, a part of the longest time."""
        if not known:
            return False
        apart = np.abs(one.start.curve.control - np.array([other.control for other in known])) / self._alike
        return bool(np.min(np.max(apart, axis=(1, 2))) <= within * self._longest)


def _with_other_paces(line: Start, now: Start, joint: int) -> Iterator[Start]:
    """The start `now` with one joint early, at the pace of the straight `line`, or late; without `now` itself."""
    control, way = line.curve.control, line.curve.control[-1] - line.curve.control[0]
    u = np.linspace(0.0, 1.0, len(control))
    for part in (np.minimum(u / _PART, 1.0), u, np.maximum((u - 1.0) / _PART + 1.0, 0.0)):
        moved = now.curve.control.copy()
        moved[:, joint] = control[0, joint] + from_rest_to_rest(part) * way[joint]
        if not np.array_equal(moved, now.curve.control):
            yield replace(line, curve=line.curve.moved_to(moved))
