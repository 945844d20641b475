"""Starts of descents for another cost than the time: straight lines, and the same with some joints early or late."""

from __future__ import annotations

from collections.abc import Sequence

from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start, StartPrices

# for each of `Effort.ways_at_once`: how many of the cheapest straight lines are also tried with some joints early or
# late, how many of all these get a few rounds, and how many of the other lines, because the price of a line says
# little about the result of its descent: on an open site of the Panda with lines to 509 postures, one that costs 2.2
# times as much as the cheapest ends at half of its cost; chosen
_LINES_FOR_ONE, _LINES_TRIED_FOR_ONE, _LINES_SPREAD_FOR_ONE = 3, 2, 2


def line_starts(
    lines: Sequence[Start], known: Sequence[Start], prices: StartPrices, *, ways: int, begun: Sequence[JointCurve]
) -> list[PricedStart]:
    """The cheapest of the `known` starts, then of straight lines at any pace, then lines of all prices.

    Parameters
    ----------
    lines: straight ones to the ends that may do.
    known: other starts that are worth a descent.
    ways: see `Effort.ways_at_once`.
    begun: curves with equally many pieces from which descents began; starts near them are left out.
    """
    straight = prices.fair(prices.in_order(lines))
    cheapest = prices.cheapest(straight, _LINES_FOR_ONE * ways)
    both = sorted([*cheapest, *prices.paced(cheapest)], key=lambda one: one.price)
    cheap = prices.cheapest(both, _LINES_TRIED_FOR_ONE * ways, known=begun)
    return [
        *prices.cheapest(prices.in_order(known), ways, known=begun),
        *cheap,
        *prices.spread(straight, _LINES_SPREAD_FOR_ONE * ways, known=[*begun, *(one.start.curve for one in cheap)]),
    ]
