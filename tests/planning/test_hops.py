"""Descents from beside the best motion for little work: how many, from where, and what they gain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, repeat

import numpy as np
import pytest
from one_joint_search import END, START, ended_search, motion_of_lift

import backhoe_planner as bp
from backhoe_planner.motion import drive_of
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.own_time import OwnTime
from backhoe_planner.planning.goals.cost_search import CostSearch
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.multistart.start_prices import Start
from backhoe_planner.planning.refining import refining
from backhoe_planner.planning.search.effort import EFFORTS
from backhoe_planner.planning.world.world import World
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site


@pytest.fixture(scope="module")
def ended(planar4: bp.Robot) -> tuple[World, CostSearch]:
    """A search for the least work that has ended, and its world."""
    world, _, search = ended_search(planar4)
    return world, search


def hops(
    ended: tuple[World, CostSearch], monkeypatch: pytest.MonkeyPatch, *, millimetres: float, gains: Iterator[float],
    rounds: int = 10,
) -> list[tuple[Start, FoundMotion]]:  # fmt: skip
    """The starts of all hops, each with the best motion before, if the hops gain these parts of the cost in turn.

    Parameters
    ----------
    millimetres: by which the best motion at first could lift all moving parts.
    rounds: that the descents of the search made before.
    """
    world, search = ended
    best = motion_of_lift(world, millimetres)
    incumbent, begun = search._incumbent, list[tuple[Start, FoundMotion]]()
    incumbent.best, world.work.hop_rounds = best, EFFORTS["normal"].hop_rounds

    def descend(start: Start, *, hops: bool = False) -> bool:
        assert hops
        assert incumbent.best is not None
        begun.append((start, incumbent.best))
        cost = (1.0 - next(gains)) * incumbent.best.cost
        incumbent.best = replace(incumbent.best, cost=cost, curve=start.curve)
        return True

    made = search._descents.rounds
    monkeypatch.setattr(search._descents._descent, "rounds", search._descents._descent.rounds + rounds - made.made)
    monkeypatch.setattr(search._descents, "bent_coarsely", lambda start: start)
    monkeypatch.setattr(search._descents, "descend", descend)
    monkeypatch.setattr(search._refining, "_refine", lambda *_: False)
    search._refining.run()
    return begun


@pytest.mark.parametrize(
    ("millimetres", "gains", "count"),
    [
        (39.0, (), 6),
        (39.0, (0.005, 0.005), 6),  # half a per cent is no gain
        (39.0, (0.0, 0.0, 0.05), 9),
        (41.0, (), 0),
        (1.4, (), 0),  # finer curves suffice
        (1.6, (0.4,), 1),  # what is left counts as little
        (39.0, (0.05,) * 99, 24),
    ],
)
def test_hops_end_after_some_without_a_gain(
    ended: tuple[World, CostSearch], monkeypatch: pytest.MonkeyPatch, millimetres: float, gains: tuple[float, ...],
    count: int,
) -> None:  # fmt: skip
    begun = hops(ended, monkeypatch, millimetres=millimetres, gains=chain(gains, repeat(0.0)))
    assert len(begun) == count


@pytest.mark.parametrize(("rounds", "count"), [(0, 6), (34, 6), (35, 12), (200, 12)])
def test_after_a_hard_search_hops_go_on_for_longer(
    ended: tuple[World, CostSearch], monkeypatch: pytest.MonkeyPatch, rounds: int, count: int
) -> None:
    assert len(hops(ended, monkeypatch, millimetres=39.0, gains=repeat(0.0), rounds=rounds)) == count


def test_hops_leave_the_rounds_that_finer_curves_had(
    ended: tuple[World, CostSearch], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three hops of 30 rounds each use the 90 rounds that are added for them."""
    work = ended[0].work
    monkeypatch.setattr(work, "descent_rounds", 50)

    def spent() -> Iterator[float]:
        while True:
            work.descent_rounds -= 30
            yield 0.0

    assert len(hops(ended, monkeypatch, millimetres=39.0, gains=spent())) == 3
    assert work.descent_rounds == ended[1]._descents.rounds.left == 50


def test_each_hop_is_from_beside_the_best_motion_so_far(
    ended: tuple[World, CostSearch], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All joints of this arm may turn equally fast: each is moved by 0.7 rad at most, twice, then by 1 rad, twice."""
    begun = hops(ended, monkeypatch, millimetres=39.0, gains=chain((0.0, 0.2), repeat(0.0)))
    sides = []
    for number, (start, best) in enumerate(begun):
        assert best.curve is not None
        aside = start.curve.control - best.curve.control
        np.testing.assert_array_equal(aside[[0, -1]], 0.0)
        most = (0.7, 0.7, 1.0, 1.0)[number % 4]
        assert np.all(np.max(np.abs(aside), axis=0) <= most)
        assert np.all(np.max(np.abs(aside), axis=0) > 0.9 * 0.3 * most)  # 12 pieces are near the place that moves most
        sides.append(np.sign(aside[6]))
    assert len(np.unique(sides, axis=0)) > 2


def test_every_other_hop_begins_at_the_most_folded_of_eight_curves(
    ended: tuple[World, CostSearch], monkeypatch: pytest.MonkeyPatch
) -> None:
    found, counts = ended[1]._refining, list[int]()
    beside = found._beside

    def counted(curve: JointCurve, most: float, rng: np.random.Generator, count: int) -> JointCurve:
        counts.append(count)
        return beside(curve, most, rng, count)

    monkeypatch.setattr(found, "_beside", counted)
    hops(ended, monkeypatch, millimetres=39.0, gains=repeat(0.0))
    assert counts == 3 * [8, 1]


def test_with_few_joints_a_hop_descends_on_a_coarse_curve_first(ended: tuple[World, CostSearch]) -> None:
    """What 6 pieces can do is a curve of 6 pieces; 12 pieces go on from there."""
    world, search = ended
    limits, incumbent = world.problem.limits, search._incumbent
    assert incumbent.best is not None
    aside = JointCurve.straight(START, END, 12).moved_aside(np.array([0.5, -0.5, 0.5, -0.5]), np.ones(4), limits)
    start = Start(aside, incumbent.longest, incumbent.best.goal, "straight")
    world.work.descent_rounds = 100
    bent = search._descents.bent_coarsely(start)
    assert bent.curve.pieces == 12
    np.testing.assert_array_equal(bent.curve.control[0], START)
    once = bent.curve.divided_evenly(6, limits).divided_evenly(12, limits)
    np.testing.assert_allclose(once.control, bent.curve.control, atol=1e-9)
    own_time = OwnTime(world.problem, drive_of(world.problem))
    before, after = (own_time.cost(one, incumbent.longest, width=1e-9) for one in (aside, bent.curve))
    assert after < 0.5 * before


def test_a_stretched_arm_reaches_its_length_and_a_folded_one_less(ended: tuple[World, CostSearch]) -> None:
    """Four links of 1 m: stretched, bent by a right angle in the middle, and folded there."""
    found = ended[1]._refining
    for bent, reach in ((0.0, 4.0), (0.5 * np.pi, 2.0 * np.sqrt(2.0)), (np.pi, 0.0)):
        first, last = (np.array([turn, 0.0, bent, 0.0]) for turn in (0.3, 0.8))
        assert found._reach(JointCurve.straight(first, last, 12)) == pytest.approx(reach, abs=1e-9)


def test_a_curve_beside_another_is_the_most_folded_of_those_drawn(
    ended: tuple[World, CostSearch],
) -> None:
    found, curve = ended[1]._refining, JointCurve.straight(START, END, 12)
    reach = {}
    for count in (1, 8):
        rng = np.random.default_rng(1)
        reach[count] = [found._reach(found._beside(curve, 1.0, rng, count)) for _ in range(64 // count)]
    np.testing.assert_array_equal(reach[8], np.min(np.reshape(reach[1], (8, 8)), axis=1))  # the same random curves


@pytest.mark.parametrize("objective", ["effort", pytest.param("hydraulic", marks=pytest.mark.long)])
def test_only_for_little_work_there_are_hops(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch, objective: str
) -> None:
    monkeypatch.setattr(refining.Refining, "_beside", lambda *_: pytest.fail("there is a hop"))
    start = dict(zip(backhoe.joint_names, (-0.3, 0.3, -1.4, -0.8), strict=True))
    goal = {"joints": start | {"swing": -0.2}}
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": goal}, "objective": objective}
    assert bp.plan(backhoe, bp.scene_from_dict(content), seed=3).verified


@pytest.mark.long
def test_a_machine_that_swings_folded_needs_half_of_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without hops this site costs 215 J with all seeds."""
    robot = load_machine("telescope")
    scene = random_site(robot, SiteKey("telescope", "open", "goal", 0, 523002)).scene
    scene = scene.model_copy(update={"objective": "work"})
    cost = []
    for count in (0, refining._HOPS):
        monkeypatch.setattr(refining, "_HOPS", count)
        plan = bp.plan(robot, scene, seed=1)
        assert plan.verified
        cost.append(plan.metrics.energy["work"])
    assert cost[1] < 0.6 * cost[0]
