"""The cheapest route through layers of nodes: one node of every layer, in order.

For a tip path the layers are its samples, the nodes of a layer are the configurations
that put the tip there, and an edge is the motion between two of them. The search is
Bellman's recursion, so its result is the global optimum over the nodes: no route that
exists on the grid is missed. Three kinds of edges lead to a node:

    step     from a node of the layer before
    turn     from a node of the same layer: the joints move while the tip stands
    detour   from a node of any earlier layer, or of the same one: the tip leaves the path

The length that detours leave out of the path counts before any cost: the best route is
the cheapest of those that leave out least.

It is expensive to find out whether an edge can be driven. Therefore only the edges of the
best route are tested (lazy evaluation; Dellin and Srinivasa 2016, "A Unifying Formalism for
Shortest Path Problems with Expensive Edge Evaluations via Lazy Best-First Search"): the
caller forbids an edge that cannot be driven, and searches again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.planning.search.effort import Brake

StepCost = Callable[[Matrix, Matrix, float], Matrix]
Node = tuple[int, int]  # layer, index within it

_LEFT_OUT = 1e9  # price of 1 m of path that is left out: above every cost of a route in rad
_LEAVING = 0.02  # m of path added for each detour; chosen small: one detour is better than two of the same total length
_TURNS = 64  # in a row within one layer; chosen: ends iterations that rounding would continue forever


class EdgeKind(IntEnum):
    """How a node is reached."""

    BEGIN = 0
    STEP = 1
    TURN = 2
    DETOUR = 3


@dataclass(frozen=True)
class Edge:
    """A motion between two nodes."""

    kind: EdgeKind
    start: Node
    end: Node


@dataclass(frozen=True)
class Route:
    """A route through the layers.

    Attributes
    ----------
    edges: from the first node to the last; empty if there is only one layer.
    nodes: one more than edges.
    cost: sum over steps, turns and detours, with the cost of beginning at the first node.
    left_out: length of the path that detours leave out [m].
    """

    edges: tuple[Edge, ...]
    nodes: tuple[Node, ...]
    cost: float
    left_out: float


class _Edges:
    """The motions from the nodes of one layer to those of another, or of the same one.

    Parameters
    ----------
    costs: (A, B) of all motions; infinite ones are left out.
    """

    def __init__(self, costs: Matrix) -> None:
        second, first = np.nonzero(np.isfinite(costs.T))
        self._first = first
        self._costs = costs[first, second]
        self._ends, self._begins = np.unique(second, return_index=True)
        self._counts = np.diff(np.append(self._begins, len(second)))

    def __len__(self) -> int:
        return len(self._first)

    def forbid(self, a: int, b: int) -> None:
        """Remove one motion."""
        place = int(np.searchsorted(self._ends, b))
        if place < len(self._ends) and self._ends[place] == b:
            begin = int(self._begins[place])
            own = slice(begin, begin + int(self._counts[place]))
            self._costs[own][self._first[own] == a] = np.inf

    def reach(self, value: Vector) -> tuple[NDArray[np.intp], Vector, NDArray[np.intp]]:
        """From nodes with totals `value` (A,): the (M,) nodes that are reached, their least totals and sources."""
        if not len(self):
            return self._ends, np.zeros(0), self._ends
        total = value[self._first] + self._costs
        least = np.minimum.reduceat(total, self._begins)
        hits = np.flatnonzero(total == np.repeat(least, self._counts))
        best = hits[np.searchsorted(hits, self._begins)]
        return self._ends, least, self._first[best]


class LayeredGraph:
    """Layers of nodes, and the search through them.

    Parameters
    ----------
    stations: (L,) arc length of each layer [m], not decreasing; no step leads from one
        layer to the next if both have the same arc length.
    layers: (N_l, n) configurations of each; a layer may be empty.
    cost: function of (A, n), (B, n) and the arc length between them [m]; returns the (A, B)
        costs of the motions, infinite where there is none.
    turning: arc length as which a turn counts [m].
    detours: whether the path may be left.
    turns: whether the joints may move while the tip stands.
    longest: (L, n) how far a joint may move from the layer before to each layer [rad or m]; by default freely.
    reduce: maps changes of the joints (..., n) to the shorter direction of rotation; by default unchanged.
    brake: checked by every search; by default none.

    Attributes
    ----------
    looked_at: how many pairs of nodes all searches have examined, turns and detours included.
    """

    def __init__(
        self,
        stations: Vector,
        layers: Sequence[Matrix],
        *,
        cost: StepCost,
        turning: float,
        detours: bool,
        turns: bool = True,
        longest: Matrix | None = None,
        reduce: Callable[[Array], Array] = lambda change: change,
        brake: Brake | None = None,
    ) -> None:
        self.stations = np.asarray(stations, dtype=float)
        self.layers = tuple(layers)
        self._cost = cost
        self._turning = turning
        self._detours = detours
        self._may_turn = turns
        self._longest = longest
        self._reduce = reduce
        self._brake = brake or Brake()
        self._steps: dict[int, _Edges] = {}
        self._turns: dict[int, _Edges] = {}
        self._forbidden: dict[tuple[int, int], set[tuple[int, int]]] = {}
        self._closed: dict[int, Flags] = {}
        self._refused: set[tuple[int, int]] = set()
        self._only: tuple[Edge, ...] | None = None
        self.looked_at = 0
        # per layer, the results of the last search that are still valid
        self._begin: Vector | None = None
        self._found_values: list[Vector] = []
        self._found_sources: list[NDArray[np.intp]] = []
        self._leaving: list[float] = []

    def forbid(self, edge: Edge) -> None:
        """Remove an edge, because it cannot be driven."""
        (layer_a, a), (layer_b, b) = edge.start, edge.end
        self._forget_from(layer_b)
        if edge.kind is EdgeKind.STEP:
            self._step_edges(layer_b).forbid(a, b)
        elif edge.kind is EdgeKind.TURN:
            self._turn_edges(layer_a).forbid(a, b)
        else:
            self._forbidden.setdefault((layer_a, layer_b), set()).add((a, b))

    def close_near(self, q: Matrix, within: float, *, first: int = 0) -> None:
        """Remove the nodes of every layer that are near a configuration, except where no other node would be left.

        Parameters
        ----------
        q: (L, n) one configuration for each layer.
        within: a node is near it if no joint differs by more than this [rad or m].
        first: the layer from which nodes are removed.
        """
        self._forget_from(first)
        for layer in range(first, len(self.layers)):
            away = np.max(np.abs(self._reduce(self.layers[layer] - q[layer])), axis=1, initial=0.0) > within
            away &= ~self._closed.get(layer, np.zeros(len(away), dtype=bool))
            if away.any():
                self._closed[layer] = ~away

    def forbid_detours(self, start: int, end: int) -> None:
        """Forbid all detours from layer `start` to layer `end`."""
        self._forget_from(end)
        self._refused.add((start, end))

    def only_detours(self, edges: Iterable[Edge]) -> None:
        """Allow only these detours from now on."""
        self._forget_from(0)
        self._only = tuple(sorted(edges, key=lambda edge: (edge.start, edge.end)))

    def split(self, layer: int, stations: Vector, layers: Sequence[Matrix], *, longest: Matrix | None = None) -> None:
        """Insert layers between `layer` and the next, in a graph without detours; forbidden edges stay forbidden.

        Parameters
        ----------
        stations: (M,) arc lengths between those of the two [m]; layers: (N_m, n) configurations of each.
        longest: (M + 1, n) as for the graph, for the new layers and the one behind them.
        """
        self._forget_from(layer + 1)
        count = len(layers)
        self._steps = {row + count * (row > layer): edges for row, edges in self._steps.items() if row != layer + 1}
        self._turns = {row + count * (row > layer): edges for row, edges in self._turns.items()}
        self.stations = np.insert(self.stations, layer + 1, stations)
        self.layers = (*self.layers[: layer + 1], *layers, *self.layers[layer + 1 :])
        if self._longest is not None:
            assert longest is not None
            self._longest = np.vstack((self._longest[: layer + 1], longest, self._longest[layer + 2 :]))

    def cheapest_steps(self, layer: int, most: int) -> list[Edge]:
        """Up to `most` steps to `layer` from nodes reached by the last search, one to each node; the cheapest first."""
        values, _ = self._values(self._begin)
        ends, least, best = self._step_edges(layer).reach(values[layer - 1])
        order = np.argsort(least, kind="stable")[:most]
        order = order[np.isfinite(least[order])]
        return [Edge(EdgeKind.STEP, (layer - 1, int(best[row])), (layer, int(ends[row]))) for row in order.tolist()]

    def best_route(self, begin: Vector | None = None, *, end: int | None = None) -> Route | None:
        """The cheapest of the routes from the first layer to the last that leave out least.

        Parameters
        ----------
        begin: (N_0,) cost of beginning at each node of the first layer, infinite
            where that is impossible; by default 0.
        end: the layer to go to; by default the last.

        Returns
        -------
        The route; None if there is none.
        """
        values, sources = self._values(begin)
        last = len(self.layers) - 1 if end is None else end
        if not len(values[last]) or not np.isfinite(values[last]).any():
            return None
        node = (last, int(np.argmin(values[last])))
        total = float(values[last][node[1]])
        edges: list[Edge] = []
        while sources[node[0]][node[1]][0] != EdgeKind.BEGIN:
            kind, layer, index = sources[node[0]][node[1]]
            edges.append(Edge(EdgeKind(int(kind)), (int(layer), int(index)), node))
            node = (int(layer), int(index))
        edges.reverse()
        detours = [edge for edge in edges if edge.kind is EdgeKind.DETOUR]
        left_out = float(sum(self.stations[edge.end[0]] - self.stations[edge.start[0]] for edge in detours))
        nodes = (node, *(edge.end for edge in edges))
        return Route(tuple(edges), nodes, total - _LEFT_OUT * (left_out + _LEAVING * len(detours)), left_out)

    def furthest(self, begin: Vector | None = None) -> int:
        """The last layer that can be reached; -1 if not even the first can."""
        values, _ = self._values(begin)
        return max((layer for layer, value in enumerate(values) if np.isfinite(value).any()), default=-1)

    def reached(self, begin: Vector | None) -> list[Matrix]:
        """By layer, (M, n) the nodes that can be reached."""
        values, _ = self._values(begin)
        return [nodes[np.isfinite(value)] for nodes, value in zip(self.layers, values, strict=True)]

    def _forget_from(self, layer: int) -> None:
        """Drop the results of the last search from `layer` on."""
        del self._found_values[layer:], self._found_sources[layer:], self._leaving[layer:]

    def _values(self, begin: Vector | None) -> tuple[list[Vector], list[NDArray[np.intp]]]:
        """Per layer: (N,) least total from the beginning, and (N, 3) kind of edge, layer and node it comes from."""
        first = np.zeros(len(self.layers[0])) if begin is None else np.array(begin, dtype=float)
        if self._begin is None or not np.array_equal(first, self._begin):
            self._forget_from(0)
            self._begin = first
        # `leaving`: for every layer, the least total of its nodes, minus the price of the path up to it
        values, sources, leaving = self._found_values, self._found_sources, self._leaving
        for layer in range(len(values), len(self.layers)):
            nodes = self.layers[layer]
            self._brake.check()
            value = np.full(len(nodes), np.inf)
            source = np.zeros((len(nodes), 3), dtype=np.intp)
            if layer == 0:
                value = first.copy()
            elif len(nodes) and len(values[layer - 1]):
                edges = self._step_edges(layer)
                self.looked_at += len(edges)
                ends, least, best = edges.reach(values[layer - 1])
                value[ends] = least
                source[ends, 0], source[ends, 1], source[ends, 2] = EdgeKind.STEP, layer - 1, best
            self._turn(layer, value, source)
            value[self._closed.get(layer, slice(0))] = np.inf
            if self._detours and len(nodes):
                self._detour(layer, value, source, values, leaving)
                self._turn(layer, value, source)
                value[self._closed.get(layer, slice(0))] = np.inf
            values.append(value)
            sources.append(source)
            cheapest = float(np.min(value)) if len(value) else np.inf
            leaving.append(cheapest - _LEFT_OUT * float(self.stations[layer]))
        return values, sources

    def _turn(self, layer: int, value: Vector, source: NDArray[np.intp]) -> None:
        """Add turns within a layer, as long as they make a node cheaper."""
        if len(value) < 2 or not np.isfinite(value).any() or not self._may_turn:
            return
        edges = self._turn_edges(layer)
        for _ in range(_TURNS):
            self.looked_at += len(edges)
            ends, found, best = edges.reach(value)
            better = found < value[ends] * (1.0 - 1e-12) - 1e-12
            better |= np.isfinite(found) & ~np.isfinite(value[ends])
            if not better.any():
                return
            ends = ends[better]
            value[ends] = found[better]
            source[ends, 0], source[ends, 1], source[ends, 2] = EdgeKind.TURN, layer, best[better]

    def _detour(
        self, layer: int, value: Vector, source: NDArray[np.intp], values: list[Vector], leaving: list[float]
    ) -> None:
        """Add detours to the nodes of a layer that leave the path at an earlier layer, or at this one."""
        if self._only is not None:
            self._take_detours(self._only, layer, value, source, values)
            return
        nodes = self.layers[layer]
        here = float(np.min(value)) if np.isfinite(value).any() else np.inf
        order = [layer, *np.argsort(np.array(leaving), kind="stable").tolist()]
        for start in order:
            if (start, layer) in self._refused or (start == layer and not self._may_turn):
                continue
            before = value.copy() if start == layer else values[start]
            least = here if start == layer else leaving[start] + _LEFT_OUT * float(self.stations[layer])
            if not np.isfinite(least):
                continue
            price = _LEFT_OUT * (float(self.stations[layer] - self.stations[start]) + _LEAVING)
            change = np.linalg.norm(self._reduce(nodes[None, :, :] - self.layers[start][:, None, :]), axis=2)
            total = before[:, None] + price + change
            self.looked_at += total.size
            for a, b in self._forbidden.get((start, layer), ()):
                total[a, b] = np.inf
            best = np.argmin(total, axis=0)
            found = total[best, np.arange(len(nodes))]
            better = found < value
            value[better] = found[better]
            source[better, 0], source[better, 1], source[better, 2] = EdgeKind.DETOUR, start, best[better]
            if start != layer and np.isfinite(value).all():
                return  # the remaining layers in this order leave out more

    def _take_detours(
        self, edges: Iterable[Edge], layer: int, value: Vector, source: NDArray[np.intp], values: list[Vector]
    ) -> None:
        """Add those detours of `edges` that end in a layer."""
        for edge in edges:
            (start, a), (end, b) = edge.start, edge.end
            if end != layer:
                continue
            before = value if start == layer else values[start]
            skipped = float(self.stations[layer] - self.stations[start]) + _LEAVING
            change = float(np.linalg.norm(self._reduce(self.layers[layer][b] - self.layers[start][a])))
            total = before[a] + _LEFT_OUT * skipped + change
            if total < value[b]:
                value[b] = total
                source[b] = EdgeKind.DETOUR, start, a

    def _step_edges(self, layer: int) -> _Edges:
        """The steps from the layer before to `layer`."""
        if layer not in self._steps:
            span = float(self.stations[layer] - self.stations[layer - 1])
            before, nodes = self.layers[layer - 1], self.layers[layer]
            costs = self._cost(before, nodes, span) if span > 0.0 else np.full((len(before), len(nodes)), np.inf)
            if self._longest is not None:
                costs[step_ratios(before, nodes, self._longest[layer], reduce=self._reduce) > 1.0] = np.inf
            self._steps[layer] = _Edges(costs)
        return self._steps[layer]

    def _turn_edges(self, layer: int) -> _Edges:
        """The turns within `layer`."""
        if layer not in self._turns:
            costs = self._cost(self.layers[layer], self.layers[layer], self._turning)
            np.fill_diagonal(costs, np.inf)
            self._turns[layer] = _Edges(costs)
        return self._turns[layer]


def squared_steps(a: Matrix, b: Matrix, *, reduce: Callable[[Array], Array]) -> Matrix:
    """(A, B) the squared steps from each of a (A, n) to each of b (B, n): a cost for which routes have short steps.

    If the configurations are on several self-motion curves, the cheapest route may cross from one curve to another
    wherever they come near each other. No such step can be driven, and there are as many as pairs of nodes. Short
    steps stay on a curve, and away from obstacles between two nodes.
    """
    change = reduce(b[None, :, :] - a[:, None, :])
    return np.asarray(np.sum(change * change, axis=2))


def step_ratios(a: Matrix, b: Matrix, longest: Vector, *, reduce: Callable[[Array], Array]) -> Matrix:
    """(A, B) the largest joint move from each of a (A, n) to each of b (B, n), as a part of `longest` (n,)."""
    found = np.zeros((len(a), len(b)))
    for row, joints in enumerate(a):  # one by one, because the array of all differences would be n times as large
        found[row] = np.max(np.abs(reduce(b - joints)) / longest, axis=1, initial=0.0)
    return found
