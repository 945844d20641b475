"""Paths that leave several dimensions free: slides whose least work is known, and ways away from others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import Axis, load_chain

import backhoe_planner as bp
from backhoe_planner.arrays import Array, Matrix
from backhoe_planner.motion import PathCost, Problem, build_problem
from backhoe_planner.planning import EFFORTS, LayeredGraph, PathResolver, Stretch, Work, cheapen_stretch
from backhoe_planner.planning.sequence.chain import Chain
from backhoe_planner.planning.stretches.dynamic_programming import _aligned

GRAVITY = 9.81  # m/s^2
MASSES = (30.0, 20.0, 5.0)  # kg of the slides, the last one at the tip
RANGES = (1.0, 1.0, 0.2)  # m
LIFT = 0.3  # m


def slides(folder: Path, axes: Sequence[str], masses: Sequence[float], ranges: Sequence[float]) -> bp.Robot:
    """Slides on one another, with a small ball at the tip."""
    return load_chain(
        folder,
        [
            Axis("prismatic", axis, 0.0, range_, mass=mass)
            for axis, mass, range_ in zip(axes, masses, ranges, strict=True)
        ],
        ball=0.02, effort=5000.0,
    )  # fmt: skip


def hoist(folder: Path, ranges: Sequence[float] = RANGES) -> bp.Robot:
    """Three slides upwards on one across and one ahead: two dimensions are free at every position."""
    return slides(
        folder, ("1 0 0", "0 1 0", "0 0 1", "0 0 1", "0 0 1"), (10.0, 10.0, *MASSES), (1.0, 1.0, *ranges)
    )  # fmt: skip


def upwards(robot: bp.Robot, begin: float = 0.5) -> Problem:
    points = [[0.5, 0.5, begin], [0.5, 0.5, begin + LIFT]]
    task = {"path": {"waypoints": [{"position": point} for point in points], "speed": 0.05}}
    return build_problem(robot, bp.scene_from_dict({"version": 1, "task": task}))


def cheapened(problem: Problem, q: Matrix, *, roughly: bool = False) -> tuple[Stretch, float]:
    """The stretch along the path from q (K, n) after the search, and its value in J."""
    assert problem.path is not None
    cost, stations = PathCost(problem), np.linspace(0.0, problem.path.length, len(q))
    found = cheapen_stretch(
        problem, problem.path, Stretch(stations, q), cost=cost, proximity=bp.Proximity(problem.robot),
        free_start=True, free_end=True, roughly=roughly,
    )  # fmt: skip
    return found, cost.value(stations, found.q)


def any_way_up(rng: np.random.Generator) -> Matrix:
    """(31, 5) joints along the lift, divided among the three slides at random."""
    part = np.linspace(0.0, 1.0, 31)
    last = RANGES[2] * (0.3 + 0.4 * rng.random() + 0.25 * np.sin(rng.uniform(0, 6) + 3.0 * part))
    middle = 0.2 + 0.1 * rng.random() + 0.08 * np.sin(rng.uniform(0, 6) + 4.0 * part)
    height = 0.5 + LIFT * part
    return np.column_stack((np.full(31, 0.5), np.full(31, 0.5), height - middle - last, middle, last))


@pytest.mark.parametrize("seed", range(3))
def test_the_lightest_slides_lift_as_far_as_they_reach(tmp_path: Path, seed: int) -> None:
    """The tool alone is lifted by 0.2 m, and with the slide below it for the rest; the heaviest slide rests.

    Work that is given back counts for nothing, so no way of lowering a slide on the way makes it less.
    """
    problem = upwards(hoist(tmp_path))
    least = GRAVITY * (MASSES[2] * LIFT + MASSES[1] * (LIFT - RANGES[2]))
    begun = any_way_up(np.random.default_rng(seed))
    found, value = cheapened(problem, begun)
    assert PathCost(problem).value(found.stations, begun) > 1.5 * least
    assert least - 1e-6 <= value <= 1.02 * least
    np.testing.assert_allclose(found.q[:, 2:].sum(axis=1), 0.5 + LIFT * np.linspace(0.0, 1.0, 31), atol=1e-6)
    rough, value_of_rough = cheapened(problem, begun, roughly=True)
    assert value - 1e-9 <= value_of_rough <= 1.5 * least
    assert not np.array_equal(rough.q, found.q)


def test_equal_joints_share_a_way_equally_if_squared_rates_cost(tmp_path: Path) -> None:
    """Three equal slides ahead: a third of the way each."""
    robot = slides(tmp_path, ("1 0 0", "0 1 0", "0 0 1", "1 0 0", "1 0 0"), [1.0] * 5, [2.0] * 5)
    points = [[1.0, 0.5, 0.5], [1.9, 0.5, 0.5]]
    task = {"path": {"waypoints": [{"position": point} for point in points], "speed": 0.2}}
    scene = bp.scene_from_dict({"version": 1, "objective": "velocity_norm", "task": task})
    problem = build_problem(robot, scene)
    part = np.linspace(0.0, 1.0, 31)
    ahead = np.column_stack((0.2 + 0.7 * part**2, 0.3 + 0.1 * part))
    q = np.column_stack((ahead[:, 0], *np.full((2, 31), 0.5), ahead[:, 1], 1.0 + 0.9 * part - ahead.sum(axis=1)))
    found, _ = cheapened(problem, q)
    np.testing.assert_allclose((found.q[-1] - found.q[0])[[0, 3, 4]], 0.3, atol=0.01)


def test_a_way_leaves_a_singularity_that_all_of_it_is_in(tmp_path: Path) -> None:
    """A slide ahead carries two hinges whose bars are folded onto each other across the path.

    Then neither hinge can move the tip across, which is one dimension more than anywhere else. Bars that open as the
    slide moves share its way, so the squared rates are less.
    """
    parts, parent = ['<link name="base"/>'], "base"
    joints = (("prismatic", "1 0 0", 0.0), ("prismatic", "0 0 1", 0.0), ("revolute", "0 0 1", 0.0))
    for number, (kind, axis, ahead) in enumerate((*joints, ("revolute", "0 0 1", 0.5))):
        parts.append(
            f'<link name="link{number}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" '
            f'ixz="0" iyz="0"/></inertial></link><joint name="joint{number}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="link{number}"/><origin xyz="{ahead} 0 0"/><axis xyz="{axis}"/>'
            '<limit lower="-3.5" upper="3.5" velocity="1" effort="5000"/></joint>'
        )
        parent = f"link{number}"
    parts.append(
        '<link name="tip"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>'
        f'<joint name="tool" type="fixed"><parent link="{parent}"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>'
    )
    file = tmp_path / "folded.urdf"
    file.write_text(f'<robot name="folded">{"".join(parts)}</robot>', encoding="utf-8")
    robot = bp.load_robot(file, tip="tip")
    task = {"path": {"waypoints": [{"position": [at, 0.0, 0.0]} for at in (0.5, 1.5)], "speed": 0.2}}
    scene = bp.scene_from_dict({"version": 1, "objective": "velocity_norm", "task": task})
    part = np.linspace(0.0, 1.0, 31)
    folded = np.column_stack((0.5 + part, 0.0 * part, *np.full((2, 31), [[np.pi / 2.0], [-np.pi]])))
    problem = build_problem(robot, scene)
    found, value = cheapened(problem, folded)
    assert value < 0.9 * PathCost(problem).value(found.stations, folded)
    assert np.ptp(found.q[:, 0]) < 0.9
    along = np.column_stack((0.5 + part, 0.0 * part, 0.0 * part))
    np.testing.assert_allclose([bp.Kinematics(robot).at(q).tip_position for q in found.q], along, atol=1e-6)


def test_frames_turn_no_more_than_their_null_spaces(tmp_path: Path) -> None:
    """Null spaces that stay the same get the same frame, whichever bases are given for them; each is orthonormal."""
    rng = np.random.default_rng(1)
    base, _ = np.linalg.qr(rng.normal(size=(6, 3)))
    bases: Array = np.array([base @ np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(8)])
    found = _aligned(bases)
    np.testing.assert_allclose(found, np.broadcast_to(bases[0], found.shape), atol=1e-12)
    others = np.array([np.linalg.qr(rng.normal(size=(6, 3)))[0] for _ in range(8)])
    turned = _aligned(others)
    np.testing.assert_allclose(np.swapaxes(turned, 1, 2) @ turned, np.broadcast_to(np.eye(3), (8, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(turned @ np.swapaxes(turned, 1, 2), others @ np.swapaxes(others, 1, 2), atol=1e-12)


# --- ways away from others ------------------------------------------------------------------


def steps(a: Matrix, b: Matrix, span: float) -> Matrix:
    return np.asarray(np.sum((b[None] - a[:, None]) ** 2, axis=2) / span)


def test_nodes_near_a_way_are_closed_but_never_all_of_a_layer() -> None:
    """Rows at 0, 1 and 3: without those near 0, then near 1, the row at 3 is left; the middle layer has only 0."""
    layers = [np.array([[0.0], [1.0], [3.0]]) for _ in range(3)]
    layers[1] = np.array([[0.0], [0.2]])
    graph = LayeredGraph(np.arange(3.0), layers, cost=steps, turning=1e-9, detours=False)
    rows = []
    for _ in range(4):
        route = graph.best_route()
        assert route is not None
        rows.append([float(layers[layer][index][0]) for layer, index in route.nodes])
        graph.close_near(np.array([[value] for value in rows[-1]]), 0.5)
    assert rows == [[0.0, 0.0, 0.0], [1.0, 0.2, 1.0], [3.0, 0.2, 3.0], [3.0, 0.2, 3.0]]


def test_nodes_are_closed_from_a_layer_on() -> None:
    layers = [np.array([[0.0], [1.0]]) for _ in range(4)]
    graph = LayeredGraph(np.arange(4.0), layers, cost=steps, turning=1e-9, detours=False)
    graph.close_near(np.zeros((4, 1)), 0.5, first=2)
    route = graph.best_route(np.array([0.0, np.inf]))
    assert route is not None
    assert [node[1] for node in route.nodes][::3] == [0, 1]
    assert route.nodes[2][1] == 1


def resolver_of(problem: Problem) -> tuple[PathResolver, Stretch]:
    assert problem.path is not None
    resolver = PathResolver(
        problem, problem.path, proximity=bp.Proximity(problem.robot), find_detour=lambda *_: None,
        cost=PathCost(problem).step_costs, work=Work(),
    )  # fmt: skip
    (first,) = resolver.resolve(None, detours=False).pieces
    assert isinstance(first, Stretch)
    return resolver, first


def test_another_way_is_away_from_all_before_and_on_the_path(tmp_path: Path) -> None:
    """At both ends, which are layers; there is room for three ways that are 0.4 m apart."""
    resolver, way = resolver_of(upwards(hoist(tmp_path, (2.0, 2.0, 2.0)), 1.5))
    known = [way]
    for _ in range(2):
        other = resolver.another(known[-1], begins_there=False)
        assert other is not None
        for before in known:
            assert np.all(np.max(np.abs(other.q[[0, -1]] - before.q[[0, -1]]), axis=1) > 0.4)
        np.testing.assert_allclose(other.q[:, 2:].sum(axis=1), 1.5 + other.stations, atol=1e-6)
        known.append(other)


def test_another_way_can_begin_where_the_first_does(tmp_path: Path) -> None:
    resolver, way = resolver_of(upwards(hoist(tmp_path)))
    other = resolver.another(way, begins_there=True)
    assert other is not None
    np.testing.assert_allclose(other.q[0], way.q[0], atol=1e-9)
    assert np.max(np.abs(other.q[-1] - way.q[-1])) > 0.4


def test_there_is_no_other_way_before_a_first_one(tmp_path: Path) -> None:
    problem = upwards(hoist(tmp_path))
    resolver, way = resolver_of(problem)
    resolver._searched = None
    assert resolver.another(way, begins_there=False) is None


def test_a_plan_divides_the_lift_with_the_least_work(tmp_path: Path) -> None:
    """The whole planner; the kinetic energy at 5 cm/s adds less than 0.1 J to 34 J."""
    robot = hoist(tmp_path)
    problem = upwards(robot)
    plan = bp.plan(robot, problem.scene)
    assert plan.verified, plan.message
    least = GRAVITY * (MASSES[2] * LIFT + MASSES[1] * (LIFT - RANGES[2]))
    assert 0.99 * least <= float(plan.metrics.energy["work"]) <= 1.05 * least


def test_other_ways_along_a_leg_are_searched_once_not_for_every_chain_of_legs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two legs, for which some six chains are planned; each leg by itself has four other ways at most."""
    robot, searched, planned = hoist(tmp_path), [], []
    another, plan = PathResolver.another, Chain._plan

    def counted(self: PathResolver, way: Stretch, *, begins_there: bool) -> Stretch | None:
        searched.append(way)
        return another(self, way, begins_there=begins_there)

    def plan_counted(self: Chain, *args: Any, **keys: Any) -> int | None:
        planned.append(args)
        return plan(self, *args, **keys)

    monkeypatch.setattr(PathResolver, "another", counted)
    monkeypatch.setattr(Chain, "_plan", plan_counted)
    points = [[0.5, 0.5, 0.5], [0.5, 0.5, 0.6], [0.6, 0.5, 0.6]]
    legs = [
        {"name": f"leg {k}", "path": {"waypoints": [{"position": at} for at in points[k : k + 2]]}} for k in range(2)
    ]
    start = {"joints": dict(zip(robot.joint_names, [0.5, 0.5, 0.2, 0.2, 0.1], strict=True))}
    found = bp.plan(robot, bp.scene_from_dict({"version": 1, "start": start, "task": {"sequence": legs}}))
    assert found.verified, found.message
    assert planned
    assert 2 <= len(searched) <= 2 * EFFORTS["normal"].other_ways
