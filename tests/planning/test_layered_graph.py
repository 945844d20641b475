"""The search through the layers against an exhaustive search."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest

from backhoe_planner.arrays import Matrix
from backhoe_planner.planning import Edge, EdgeKind, LayeredGraph


def quadratic(a: Matrix, b: Matrix, span: float) -> Matrix:
    return np.asarray(np.sum((b[None] - a[:, None]) ** 2, axis=2) / span)


def never(a: Matrix, b: Matrix, span: float) -> Matrix:
    return np.full((len(a), len(b)), np.inf)


def graph(layers: list[list[float]], *, detours: bool = False, turning: float = 1e-9) -> LayeredGraph:
    """Layers 1 m apart of nodes with one joint; turning is prohibitively expensive by default."""
    nodes = [np.array(layer, dtype=float).reshape(-1, 1) for layer in layers]
    return LayeredGraph(np.arange(float(len(layers))), nodes, cost=quadratic, turning=turning, detours=detours)


@pytest.mark.parametrize("seed", range(20))
def test_the_best_route_equals_an_exhaustive_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    layers = [rng.uniform(-1.0, 1.0, (int(rng.integers(1, 5)), 2)) for _ in range(5)]
    searched = LayeredGraph(np.arange(5.0), layers, cost=quadratic, turning=1e-9, detours=False)
    forbidden = set()
    for layer in range(4):
        for a, b in product(range(len(layers[layer])), range(len(layers[layer + 1]))):
            if rng.random() < 0.15:
                forbidden.add((layer, a, b))
                searched.forbid(Edge(EdgeKind.STEP, (layer, a), (layer + 1, b)))
    best = np.inf
    for choice in product(*(range(len(layer)) for layer in layers)):
        if any((k, choice[k], choice[k + 1]) in forbidden for k in range(4)):
            continue
        points = [layer[index] for layer, index in zip(layers, choice, strict=True)]
        best = min(best, sum(float(np.sum((q - p) ** 2)) for p, q in pairwise(points)))
    route = searched.best_route()
    if not np.isfinite(best):
        assert route is None
        return
    assert route is not None
    assert route.cost == pytest.approx(best)
    assert [node[0] for node in route.nodes] == [0, 1, 2, 3, 4]


def test_a_route_begins_at_the_only_start_of_finite_cost() -> None:
    route = graph([[0.0, 5.0], [0.0, 5.0]]).best_route(np.array([np.inf, 0.0]))
    assert route is not None
    assert route.nodes == ((0, 1), (1, 1))


def test_two_small_turns_in_a_layer_replace_a_costlier_large_one() -> None:
    """From 0 to 2 in one layer: two turns of 1 cost 1 + 1, less than one turn of 2, which costs 4."""
    layers = [[0.0], [0.0, 1.0, 2.0], [2.0]]
    nodes = [np.array(layer).reshape(-1, 1) for layer in layers]

    def cost(a: Matrix, b: Matrix, span: float) -> Matrix:
        change = np.abs(b[None] - a[:, None])[:, :, 0]
        # along the path no node may change; only turns do that
        return np.where(change > 1e-9, np.inf, 0.0) if span == 1.0 else change**2

    route = LayeredGraph(np.arange(3.0), nodes, cost=cost, turning=0.5, detours=False).best_route()
    assert route is not None
    assert [edge.kind for edge in route.edges] == [EdgeKind.STEP, EdgeKind.TURN, EdgeKind.TURN, EdgeKind.STEP]
    assert route.cost == pytest.approx(2.0)
    assert route.left_out == 0.0


def test_a_detour_leaves_out_as_little_of_the_path_as_possible() -> None:
    """Layers 2 and 3 are empty: the path is left at 1 and rejoined at 4, whatever that costs."""
    route = graph([[0.0], [0.0], [], [], [9.0], [9.0]], detours=True).best_route()
    assert route is not None
    assert [edge.kind for edge in route.edges] == [EdgeKind.STEP, EdgeKind.DETOUR, EdgeKind.STEP]
    assert (route.edges[1].start, route.edges[1].end) == ((1, 0), (4, 0))
    assert route.left_out == pytest.approx(3.0)


def test_a_route_without_need_takes_no_detour() -> None:
    route = graph([[0.0], [3.0], [0.0]], detours=True).best_route()
    assert route is not None
    assert {edge.kind for edge in route.edges} == {EdgeKind.STEP}


def test_a_change_of_configuration_that_no_step_allows_is_a_detour() -> None:
    """No layer is empty, but no step leads from one node to the other: nothing is left out."""
    nodes = [np.array([[0.0]]), np.array([[0.0], [9.0]]), np.array([[9.0]])]

    def near(a: Matrix, b: Matrix, span: float) -> Matrix:
        change = np.abs(b[None] - a[:, None])[:, :, 0]
        return np.where(change > 1.0, np.inf, change)

    route = LayeredGraph(np.arange(3.0), nodes, cost=near, turning=1.0, detours=True).best_route()
    assert route is not None
    assert [edge.kind for edge in route.edges] == [EdgeKind.STEP, EdgeKind.DETOUR, EdgeKind.STEP]
    assert route.left_out == 0.0


def test_a_detour_that_failed_is_replaced_by_the_next_longer() -> None:
    searched = graph([[0.0], [0.0], [], [0.0], [0.0]], detours=True)
    searched.forbid_detours(1, 3)
    route = searched.best_route()
    assert route is not None
    assert route.left_out == pytest.approx(3.0)
    detour = next(edge for edge in route.edges if edge.kind is EdgeKind.DETOUR)
    assert (detour.start[0], detour.end[0]) in {(0, 3), (1, 4)}


def test_an_empty_last_layer_gives_no_route() -> None:
    searched = graph([[0.0], [0.0], []], detours=True)
    assert searched.best_route() is None
    assert searched.furthest() == 1


def test_only_detours_allows_no_other_detours() -> None:
    searched = graph([[0.0], [], [0.0], [], [0.0]], detours=True)
    first = Edge(EdgeKind.DETOUR, (0, 0), (2, 0))
    searched.only_detours([first])
    assert searched.furthest() == 2
    assert searched.best_route() is None
    route = searched.best_route(end=2)
    assert route is not None
    assert route.edges == (first,)


@pytest.mark.parametrize("seed", range(5))
def test_a_graph_that_is_split_equals_one_with_all_layers(seed: int) -> None:
    """Also after an earlier search, with forbidden steps and with later layers renumbered."""
    rng = np.random.default_rng(seed)
    layers = [rng.uniform(-1.0, 1.0, (4, 2)) for _ in range(6)]
    whole = LayeredGraph(np.arange(6.0), layers, cost=quadratic, turning=1e-9, detours=False)
    split = LayeredGraph(
        np.array([0.0, 1.0, 4.0, 5.0]), layers[:2] + layers[4:], cost=quadratic, turning=1e-9, detours=False
    )
    split.best_route()
    for index in range(4):  # the last step is the fifth in the whole graph
        forbidden = EdgeKind.STEP, (2, index), (3, int(rng.integers(4)))
        split.forbid(Edge(*forbidden))
        whole.forbid(Edge(EdgeKind.STEP, (4, index), (5, forbidden[2][1])))
    split.split(1, np.array([2.0, 3.0]), layers[2:4])
    one, other = whole.best_route(), split.best_route()
    assert one is not None
    assert other is not None
    assert other.nodes == one.nodes
    assert other.cost == pytest.approx(one.cost, rel=1e-12)
    np.testing.assert_array_equal(split.stations, np.arange(6.0))


def test_cheapest_steps_to_a_layer_hold_one_step_to_each_node() -> None:
    """From 0 and 1 to 0.1, 0.8 and 3: by hand 0.01 from 0, 0.04 from 1, and 4 from 1."""
    searched = graph([[0.0, 1.0], [0.1, 0.8, 3.0]])
    searched.best_route(np.zeros(2))
    found = searched.cheapest_steps(1, 2)
    assert [(edge.start[1], edge.end[1]) for edge in found] == [(0, 0), (1, 1)]
    assert len(searched.cheapest_steps(1, 9)) == 3
