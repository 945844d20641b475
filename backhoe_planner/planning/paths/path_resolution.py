"""A tip path resolved globally: a configuration for every point of it.

The layered graph over the redundancy gives the route. This module turns its edges into proven
motions, and searches its detours. The result is a list of pieces: stretches, on which the tip
is exactly on the path, and detours between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, solve_batch
from backhoe_planner.motion import Problem, TipPath, WaypointStep, longest_step
from backhoe_planner.planning.paths.layer_stations import Layering
from backhoe_planner.planning.paths.layered_graph import (
    Edge,
    EdgeKind,
    LayeredGraph,
    Route,
    StepCost,
    squared_steps,
    step_ratios,
)
from backhoe_planner.planning.paths.path_layers import PathLayers
from backhoe_planner.planning.paths.resolution import Bypass, Departure, Resolution
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.stretches.kept_cones import kept_targets, open_cones
from backhoe_planner.planning.stretches.stretch import BENT, JUMP, NEARER, STRAIGHT_STEP, Stretch
from backhoe_planner.proof import path_segment_is_clear
from backhoe_planner.site import ClearanceScreen, Obstruction, Proximity

FindDetour = Callable[[Vector, Vector, float, float], Matrix | None]

_SAME = 1e-9  # m of path: layers nearer than this are at one place
_FINE = 0.01  # m of path between the samples of a stretch; chosen
_EXTENSION = 0.005  # m: resolution with which a detour begins late and ends early; chosen: half of `_FINE`
_NEAR = 0.2  # rad or m; chosen: a joint that moves further in such a step has changed its posture
_TRIES = 2  # failed searches for a detour between two layers, before no other is tried; chosen
_AS_FAR_PART = 4  # one in so many routes and node pairs is used to find how far a path can be followed; chosen
# one in so many is used for the cheapest routes; if these fail, the rest is for routes of short steps; chosen
_CHEAP_PART = 4
_AWAY = 0.4  # rad or m of some joint by which another way is away from those known; chosen: about twice a step
_PATIENCE = 3  # routes that fail in one gap between layers, before more of its steps are tested at once; chosen
_STRIKES = 9  # such routes after which the gap is split; chosen
_AT_ONCE = 48  # steps; chosen: they take as long as two searches
_PARTS = 4  # parts into which a gap is split; chosen
_NARROWEST = 0.0025  # m of path between layers; chosen
_MOST_SPLITS = 12  # of one path; chosen
_AT_END = 1e-9  # m: rounding of an arc length
_FEW = 8  # nodes of a layer that are followed back to find where the path is free again; chosen to be quick
_BLAMED = 64  # at most so many configurations at one place are checked for what is in their way; chosen to be quick
_AT_LIMIT = 1e-3  # rad or m; chosen: a joint nearer than this is at its limit
_IN_THE_WAY = 0.1  # m; chosen: an obstacle with less margin is blamed rather than a joint


class _Share(NamedTuple):
    """A part of the effort of a plan: routes to test, and pairs of nodes to examine for them."""

    routes: int
    node_pairs: int


class PathResolver:
    """Resolves one path among static obstacles.

    Parameters
    ----------
    find_detour: function of two configurations (n,) and their arc lengths [m]; returns
        (K, n) corners of a route between them, or None.
    cost: of a step, as for `LayeredGraph`.
    work: how many routes are tested, and how many detours are searched.
    departure: from where and when the path is resolved; by default from its beginning.
    layering: how dense the nodes are.
    apart: (P,) how much more than its clearance each pair of `proximity` keeps, wherever it can [m]; by default none.
    """

    def __init__(
        self,
        problem: Problem,
        path: TipPath,
        *,
        proximity: Proximity,
        find_detour: FindDetour,
        cost: StepCost,
        work: Work | None = None,
        departure: Departure | None = None,
        layering: Layering | None = None,
        apart: Vector | None = None,
    ) -> None:
        self._problem = problem
        self._path = path
        self._proximity = proximity
        self._find_detour = find_detour
        departure, layering = departure or Departure(), layering or Layering()
        self._time = time = departure.time
        self._work = work or Work()
        self._cost = cost
        self._kinematics = BatchKinematics(problem.robot)
        self._steps = layering.joint_steps
        self._stations = layering.stations(path, departure.since)
        task = problem.scene.task.path
        self._may_turn = (task is None or task.turn_on_the_spot) and layering.joint_steps is None
        self._targets = [path.target(float(s)) for s in self._stations]
        self._cones = open_cones(problem, path)
        longest = np.inf if problem.joint_steps is None else float(np.min(problem.joint_steps))
        self._finder = PathLayers(
            problem.robot, grid=layering.grid, longest=longest, cones=self._cones, brake=self._work.brake
        )
        self._all = self._finder.at(self._stations, self._targets, begin=departure.begin)
        self._screen = ClearanceScreen(proximity, time=time, spare=-NEARER)
        self._apart = None
        if apart is not None and np.count_nonzero(apart):
            self._apart = ClearanceScreen(proximity, time=time, spare=np.maximum(apart, -NEARER))
        self._layers = []
        for nodes in self._all:
            self._work.brake.check()
            self._layers.append(self._clear(nodes))
        self._motions: dict[Edge, Stretch | None] = {}
        self._ways: dict[Edge, tuple[Stretch, Bypass, Stretch]] = {}
        self._too_long: dict[int, WaypointStep] = {}
        self._off_path = False
        self._routes = 0
        self._gave_up = False
        self._splits = 0
        self._searched: tuple[LayeredGraph, Vector] | None = None

    @property
    def first_layer(self) -> Matrix:
        """(N, n) clear configurations at the beginning of the resolved part."""
        return self._layers[0]

    def outside_cones(self) -> tuple[float, str] | None:
        """The first arc length [m] at which the tip can be on the path but not within the cones, and what breaks.

        None if there is no such place.
        """
        if self._cones is None:
            return None
        for station, target, nodes in zip(self._stations.tolist(), self._targets, self._all, strict=True):
            found = self._finder.at_any_angle(target) if not len(nodes) else nodes[:0]
            if len(found):
                return station, self._cones.broken_at(self._kinematics, TargetBatch.of([target]), found)
        return None

    def resolve(
        self,
        begin: Vector | None,
        *,
        detours: bool,
        off_path: bool = False,
        price: Callable[[Matrix], Vector] | None = None,
    ) -> Resolution:
        """The cheapest of the resolutions that leave out least of the path.

        Parameters
        ----------
        begin: (n,) joints from which the path is followed; None for any at its beginning.
        detours: whether the path may be left.
        off_path: whether the tip is off the path at `begin`; a detour then leads to the path.
        price: costs (N,) of beginning at the nodes (N, n) of the first layer.
        """
        first = self._layers[0]
        costs = price(first) if price is not None and begin is None else np.zeros(len(first))
        if begin is not None:
            costs = np.zeros(1) if off_path else np.append(0.0, np.full(len(first), np.inf))
        self._motions, self._ways, self._too_long = {}, {}, {}
        self._off_path, self._routes = off_path, 0
        effort = self._work.effort
        graph = self._graph(begin, self._cost, detours=detours)
        part = 1 if detours else _CHEAP_PART
        share = _Share(effort.routes // part, effort.node_pairs // part)
        pieces = self._search(graph, costs, share, splits=not detours)
        self._searched = None if pieces is None or detours else (graph, costs)
        if pieces is None and self._gave_up and not detours:
            costs = np.where(np.isfinite(costs), 0.0, np.inf)
            graph = self._graph(
                begin, lambda a, b, span: squared_steps(a, b, reduce=self._problem.robot.reduce_unchecked),
                detours=False,
            )  # fmt: skip
            share = _Share(effort.routes - self._routes, effort.node_pairs - effort.node_pairs // part)
            pieces = self._search(graph, costs, share, splits=True)
        return self._as_far(graph, costs) if pieces is None else Resolution(pieces)

    def another(self, way: Stretch, *, begins_there: bool) -> Stretch | None:
        """The cheapest drivable way along the path that is found away from `way` and from those given before.

        None if there is none, or `resolve` has found none without detours and in its first search.

        Parameters
        ----------
        begins_there: whether it has to begin where `way` does; then the second half of the layers is away from it.
        """
        if self._searched is None:
            return None
        graph, costs = self._searched
        at = way.q[np.abs(way.stations - graph.stations[:, None]).argmin(axis=1)]
        graph.close_near(at, _AWAY, first=len(graph.layers) // 2 if begins_there else 0)
        if begins_there:
            off = np.max(np.abs(self._problem.robot.reduce_unchecked(graph.layers[0] - at[0])), axis=1)
            costs = np.where(off < _SAME, costs, np.inf)
        effort = self._work.effort
        share = _Share(effort.routes // _CHEAP_PART, graph.looked_at + effort.node_pairs // _CHEAP_PART)
        pieces = self._search(graph, costs, share, splits=False)
        found = None if pieces is None else pieces[0]
        return found if isinstance(found, Stretch) else None

    def _graph(self, begin: Vector | None, cost: StepCost, *, detours: bool) -> LayeredGraph:
        """The graph of the layers, without the edges that are known not to be drivable.

        Parameters
        ----------
        begin, detours: as for `resolve`.
        """
        layers, stations = list(self._layers), self._stations
        if begin is not None and self._off_path:
            layers, stations = [begin[None, :], *layers], np.append(stations[0], stations)
        elif begin is not None:
            layers[0] = np.vstack((begin[None, :], layers[0]))
        turning = float(self._stations[1] - self._stations[0])
        graph = LayeredGraph(
            stations, layers, cost=cost, turning=turning, detours=detours, turns=self._may_turn,
            longest=None if self._steps is None else self._legs_to(stations)[:, None] * self._steps,
            reduce=self._problem.robot.reduce_unchecked, brake=self._work.brake,
        )  # fmt: skip
        for mark in self._path.stations[self._path.standing_waypoints].tolist():
            for start in np.flatnonzero(stations < mark - _SAME).tolist():
                for end in np.flatnonzero(stations > mark + _SAME).tolist():
                    graph.forbid_detours(start, end)
        for edge, motion in self._motions.items():
            if motion is None:
                graph.forbid(edge)
        return graph

    def _legs_to(self, stations: Vector) -> Vector:
        """(L,) how many legs of the path end between the layer before and each layer; at least one."""
        marks = np.unique(self._path.stations)
        return np.maximum(np.diff(np.searchsorted(marks, stations + _SAME, side="right"), prepend=0), 1).astype(float)

    def _search(
        self, graph: LayeredGraph, costs: Vector, share: _Share, *, splits: bool
    ) -> tuple[Stretch | Bypass, ...] | None:
        """The pieces of the best drivable route; None if there is none, or the `share` is used up.

        With `splits`, layers are inserted where no route leads on.
        """
        failures: dict[tuple[int, int], int] = {}
        strikes: dict[tuple[float, float], int] = {}
        last = self._routes + share.routes
        self._gave_up = False
        while sum(failures.values()) < self._work.effort.detours:
            if self._routes >= last or graph.looked_at >= share.node_pairs:
                self._gave_up = True
                break
            self._routes += 1
            route = graph.best_route(costs)
            if route is None:
                if splits and self._split(graph, graph.furthest(costs)):
                    continue
                break
            bad = self._make_motions(graph, route)
            if not bad and self._find_detours(graph, route, failures):
                return self._pieces(graph, route)
            # from the last one backwards: a split shifts the layers behind it
            for layer in sorted({edge.end[0] for edge in bad if edge.kind is EdgeKind.STEP})[::-1] if splits else []:
                gap = float(graph.stations[layer - 1]), float(graph.stations[layer])
                strikes[gap] = strikes.get(gap, 0) + 1
                if strikes[gap] % _PATIENCE == 0 and (not self._any_step(graph, layer) or strikes[gap] > _STRIKES):
                    self._split(graph, layer - 1)
        return None

    # --- gaps ----------------------------------------------------------------------

    def _any_step(self, graph: LayeredGraph, layer: int) -> bool:
        """Whether any of the cheapest steps to a layer can be driven; those that cannot are forbidden."""
        edges = graph.cheapest_steps(layer, _AT_ONCE)
        bad = self._test(graph, edges)
        return len(bad) < len(edges)

    def _split(self, graph: LayeredGraph, layer: int) -> bool:
        """Insert layers between `layer` and the next, so that steps are short; False if they are short already."""
        if layer < 0 or layer + 1 >= len(graph.layers) or self._splits >= _MOST_SPLITS:
            return False
        if not len(graph.layers[layer + 1]):  # no node there is clear, so shorter steps do not help
            return False
        low, high = (float(s) for s in graph.stations[layer : layer + 2])
        if self._steps is None:
            count = min(_PARTS, int((high - low) / _NARROWEST))
            stations = np.linspace(low, high, max(count, 1) + 1)[1:-1]
        else:
            stations = np.unique(self._path.stations)
            stations = stations[(stations > low + _SAME) & (stations < high - _SAME)]
            stations = stations[:: max(len(stations) // (_PARTS - 1), 1)]
        own = layer - (len(graph.layers) - len(self._layers))  # a start off the path is a layer only in the graph
        if not len(stations) or own < 0:
            return False
        self._splits += 1
        targets = [self._path.target(float(s)) for s in stations]
        found = self._finder.between(targets, np.vstack(self._all[own : own + 2]))
        clear = [self._clear(nodes) for nodes in found]
        behind = slice(own + 1, own + 1)
        self._all[behind], self._layers[behind], self._targets[behind] = found, clear, targets
        self._stations = np.insert(self._stations, own + 1, stations)
        around = np.concatenate((graph.stations[[layer]], stations, graph.stations[[layer + 1]]))
        longest = None if self._steps is None else self._legs_to(around)[1:, None] * self._steps
        graph.split(layer, stations, clear, longest=longest)

        def moved(edge: Edge) -> Edge:
            (a, i), (b, j) = edge.start, edge.end
            return Edge(edge.kind, (a + len(found) * (a > layer), i), (b + len(found) * (b > layer), j))

        across = {edge for edge in self._motions if edge.start[0] == layer and edge.end[0] == layer + 1}
        self._motions = {moved(edge): motion for edge, motion in self._motions.items() if edge not in across}
        self._too_long = {row + len(found) * (row > layer): step for row, step in self._too_long.items()}
        return True

    # --- edges ---------------------------------------------------------------------

    def _make_motions(self, graph: LayeredGraph, route: Route) -> list[Edge]:
        """Make the motions of a route along the path; returns the edges that are not clear, which are forbidden."""
        return self._test(graph, [edge for edge in route.edges if edge.kind is not EdgeKind.DETOUR])

    def _test(self, graph: LayeredGraph, edges: list[Edge]) -> list[Edge]:
        """Make the motions of some edges; returns the edges that are not clear, which are forbidden."""
        self._work.brake.check()
        fresh = [edge for edge in edges if edge not in self._motions]
        for edge, motion in zip(fresh, self._interpolate(graph, fresh), strict=True):
            passes = motion is not None and self._is_short(motion, edge.end[0]) and self._is_clear(motion.q)
            self._motions[edge] = motion if passes else None
        bad = [edge for edge in edges if self._motions[edge] is None]
        for edge in bad:
            graph.forbid(edge)
        return bad

    def _interpolate(self, graph: LayeredGraph, edges: list[Edge]) -> list[Stretch | None]:
        """The motions between nodes with the tip on the path; None for an edge without one."""
        if not edges:
            return []
        stations, guesses = [], []
        for edge in edges:
            a, b = self._ends(graph, edge)
            between = self._between(graph.stations[edge.start[0]], graph.stations[edge.end[0]], a, b)
            part = np.linspace(0.0, 1.0, len(between))[:, None]
            stations.append(between)
            guesses.append((1.0 - part) * a + part * b)
        targets = kept_targets(self._problem, self._path, np.concatenate(stations))
        q, reached = solve_batch(self._kinematics, targets, np.vstack(guesses), iterations=12)
        found: list[Stretch | None] = []
        first = 0
        for between, guess in zip(stations, guesses, strict=True):
            rows = slice(first, first + len(between))
            first += len(between)
            own = q[rows].copy()
            own[0], own[-1] = guess[0], guess[-1]
            straight = np.max(np.abs(guess[-1] - guess[0])) / (len(between) - 1)
            smooth = np.max(np.abs(np.diff(own, axis=0))) <= BENT * straight + JUMP
            found.append(Stretch(between, own) if reached[rows].all() and smooth else None)
        return found

    def _ends(self, graph: LayeredGraph, edge: Edge) -> tuple[Vector, Vector]:
        """(n,), (n,) where an edge begins and ends; a continuous joint turns in the shorter direction."""
        a, b = (graph.layers[node[0]][node[1]] for node in (edge.start, edge.end))
        return a, self._problem.robot.reduce_unchecked(b, near=a)

    def _between(self, low: float, high: float, a: Vector, b: Vector) -> Vector:
        """(K,) arc lengths of the samples of the edge from `low` to `high` [m], every waypoint among them."""
        marks = self._path.stations[(self._path.stations > low + 1e-9) & (self._path.stations < high - 1e-9)]
        edges = np.concatenate(([low], marks, [high]))
        turn = float(np.max(np.abs(b - a)))
        found = [np.array([low])]
        for start, end in pairwise(edges.tolist()):
            part = (end - start) / (high - low) if high > low else 1.0
            count = max(int(np.ceil((end - start) / _FINE)), int(np.ceil(part * turn / STRAIGHT_STEP)), 1)
            found.append(np.linspace(start, end, count + 1)[1:])
        return np.concatenate(found)

    def _is_short(self, motion: Stretch, layer: int) -> bool:
        """Whether no joint moves too far from waypoint to waypoint; the shortest step too long is kept by `layer`."""
        if self._steps is None:
            return True
        step = longest_step(self._path, motion.stations, motion.q, self._steps)
        if step is None or step.kept:
            return True
        if layer not in self._too_long or step.ratio < self._too_long[layer].ratio:
            self._too_long[layer] = step
        return False

    def _least_step(self, graph: LayeredGraph, costs: Vector, layer: int) -> WaypointStep | None:
        """The shortest step between waypoints that leads on from `layer`, the last that can be reached.

        None if no step is too long.
        """
        if self._steps is None or layer < 0 or layer + 1 == len(graph.layers):
            return None
        before, nodes, reduce = (
            graph.reached(costs)[layer],
            graph.layers[layer + 1],
            self._problem.robot.reduce_unchecked,
        )
        longest = self._legs_to(graph.stations)[layer + 1] * self._steps
        ratios = step_ratios(before, nodes, longest, reduce=reduce)
        if not ratios.size or not np.min(ratios) > 1.0:
            return self._too_long.get(layer + 1)
        a, b = np.unravel_index(int(np.argmin(ratios)), ratios.shape)
        moved = np.abs(reduce(nodes[b] - before[a]))
        joint = int(np.argmax(moved / longest))
        ends = [
            int(np.searchsorted(self._path.stations, s - _SAME)) for s in graph.stations[[layer, layer + 1]].tolist()
        ]
        return WaypointStep(joint, ends[0], ends[1], float(moved[joint]), float(longest[joint]))

    def _clear(self, nodes: Matrix) -> Matrix:
        """The nodes (N, n) of a layer that are clear; if some of these also keep the extra distance, only those."""
        clear = nodes[self._screen.keeps(nodes)]
        if self._apart is None:
            return clear
        further = self._apart.keeps(clear)
        return clear[further] if further.any() else clear

    def _is_clear(self, q: Matrix) -> bool:
        screen = self._screen
        if self._apart is not None and self._apart.keeps_all_unchecked(q[[0, -1]]):
            screen = self._apart
        if not screen.keeps_all_unchecked(q) or (self._cones is not None and not self._cones.motion_holds(q)):
            return False
        return all(path_segment_is_clear(self._proximity, a, b, time=self._time) for a, b in pairwise(q))

    # --- detours -------------------------------------------------------------------

    def _find_detours(self, graph: LayeredGraph, route: Route, failures: dict[tuple[int, int], int]) -> bool:
        """Find the detours of a route; forbid the first that is not found. True if all are found."""
        for edge in route.edges:
            if edge.kind is not EdgeKind.DETOUR or edge in self._ways:
                continue
            found = self._leave(graph, edge)
            if found is None:
                graph.forbid(edge)
                layers = (edge.start[0], edge.end[0])
                failures[layers] = failures.get(layers, 0) + 1
                if failures[layers] >= _TRIES:
                    graph.forbid_detours(*layers)
                return False
            self._ways[edge] = found
        return True

    def _leave(self, graph: LayeredGraph, edge: Edge) -> tuple[Stretch, Bypass, Stretch] | None:
        """A detour, with the parts of the path that are followed before and after it; None if none is found."""
        a, b = self._ends(graph, edge)
        low, high = (float(graph.stations[node[0]]) for node in (edge.start, edge.end))
        if low == high or (self._off_path and edge.start[0] == 0):
            obstruction = self._obstruction(a, low)
            before, after = Stretch(np.array([low]), a[None, :]), Stretch(np.array([high]), b[None, :])
        else:
            before, beyond = self._extend(low, high, a)
            obstruction = self._obstruction(*beyond)
            # only so far that the two ends do not cross
            back, _ = self._extend(high, before.reached, b)
            after = Stretch(back.stations[::-1], back.q[::-1])
        left, back_at = before.reached, float(after.stations[0])
        way = self._find_detour(before.q[-1], after.q[0], left, back_at)
        if way is None:
            return None
        return before, Bypass(way, replace(obstruction, path_from=left, path_to=back_at)), after

    def _extend(self, low: float, high: float, q: Vector) -> tuple[Stretch, tuple[Vector, float]]:
        """Follow the path on from `low` towards `high` [m], by the nearest configurations, as far as it is clear.

        Returns
        -------
        The stretch, and the configuration (n,) and arc length [m] just beyond its end at which something is in the way.
        """
        count = max(int(np.ceil(abs(high - low) / _EXTENSION)), 1)
        stations, found = [low], [q]
        beyond = None
        for s in np.linspace(low, high, count + 1)[1:].tolist():
            targets = kept_targets(self._problem, self._path, np.array([s]))
            after, reached = solve_batch(self._kinematics, targets, found[-1][None, :], iterations=12)
            near = float(np.max(np.abs(after[0] - found[-1]))) < _NEAR
            if not reached[0] or not near:
                break
            if not self._is_clear(np.array([found[-1], after[0]])):
                beyond = (after[0], s)
                break
            stations.append(s)
            found.append(after[0])
        return Stretch(np.array(stations), np.array(found)), beyond or (found[-1], stations[-1])

    def _obstruction(self, q: Vector, station: float) -> Obstruction:
        """What is in the way at `q`, otherwise what is in the way of the other configurations at that arc length."""
        tightest = self._proximity.tightest(q, time=self._time)
        gap = np.minimum(q - self._problem.limits.lower, self._problem.limits.upper - q)
        if tightest is not None and tightest.margin < 0.0:
            return tightest
        joint = int(np.argmin(gap))
        if gap[joint] < _AT_LIMIT:
            return Obstruction.joint_limit(self._problem.robot.joint_names[joint])
        layer = min(int(np.searchsorted(self._stations, station + 1e-9)), len(self._all) - 1)
        nodes = self._all[layer][:: max(len(self._all[layer]) // _BLAMED, 1)]
        others = [self._proximity.tightest(node, time=self._time) for node in nodes]
        blocked = [other for other in others if other is not None and other.margin < 0.0]
        if blocked:
            return max(blocked, key=lambda other: other.margin)
        if tightest is not None and tightest.margin < _IN_THE_WAY:
            return tightest
        return Obstruction.joint_limit(self._problem.robot.joint_names[joint])

    def _free_again(self, left: float) -> float:
        """The first arc length after `left` at which the tip can be on the path again [m], otherwise the path's end."""
        for layer, nodes in enumerate(self._layers):
            station = float(self._stations[layer])
            if station <= left + 1e-9 or not len(nodes):
                continue
            before = max(float(self._stations[layer - 1]), left)
            few = nodes[:: max(len(nodes) // _FEW, 1)]
            return min(self._extend(station, before, q)[0].reached for q in few)
        return self._path.length

    # --- the result --------------------------------------------------------------------

    def _pieces(self, graph: LayeredGraph, route: Route) -> tuple[Stretch | Bypass, ...]:
        """The motions of a route, joined into stretches where there is no detour between them."""
        layer, index = route.nodes[0]
        pieces: list[Stretch | Bypass] = [Stretch(graph.stations[[layer]], graph.layers[layer][[index]])]
        for edge in route.edges:
            if edge.kind is EdgeKind.DETOUR:
                before, detour, after = self._ways[edge]
                turns = _append(pieces, before)
                pieces += [replace(detour, q=detour.q + turns), replace(after, q=after.q + turns)]
            else:
                motion = self._motions[edge]
                assert motion is not None
                _append(pieces, motion)
        return tuple(pieces)

    def _as_far(self, graph: LayeredGraph, costs: Vector) -> Resolution:
        """The pieces up to where the path is blocked."""
        graph.only_detours(self._ways)
        pieces: tuple[Stretch | Bypass, ...] = ()
        beyond = (self._problem.robot.middle, 0.0)
        left = 0.0
        step = None
        enough = graph.looked_at + self._work.effort.node_pairs // _AS_FAR_PART
        for _ in range(self._work.effort.routes // _AS_FAR_PART):
            if graph.looked_at > enough:
                break
            reached = graph.furthest(costs)
            if reached < 0:
                break
            route = graph.best_route(costs, end=reached)
            assert route is not None
            layer, index = route.nodes[-1]
            step = self._least_step(graph, costs, layer)
            if self._make_motions(graph, route):
                beyond = (graph.layers[layer][index], float(graph.stations[layer]))
                continue
            low = float(graph.stations[layer])
            high = float(graph.stations[min(layer + 1, len(graph.stations) - 1)])
            further, beyond = self._extend(low, high, graph.layers[layer][index])
            reached_pieces = list(self._pieces(graph, route))
            _append(reached_pieces, further)
            pieces, left = tuple(reached_pieces), further.reached
            if step is None and left > self._path.length - _AT_END:
                return Resolution(pieces, routes=self._routes)
            break
        obstruction = replace(self._obstruction(*beyond), path_from=left, path_to=self._free_again(left))
        return Resolution(pieces, obstruction, step, self._routes, self._gave_up)


def _append(pieces: list[Stretch | Bypass], motion: Stretch) -> Vector:
    """Join a motion to the last piece, at whose end it begins; (n,) the turns by which its joints are shifted."""
    last = pieces[-1]
    assert isinstance(last, Stretch)
    pieces[-1], turns = last.followed_by(motion)
    return turns
