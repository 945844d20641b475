"""The best motion of a search on finer curves: which motions are refined, and what of them is kept."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from one_joint_search import DURATION, END, START, ended_search, motion_of_lift

import backhoe_planner as bp
from backhoe_planner.motion import time_evenly
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Options, Timed
from backhoe_planner.planning.descent.margins import Margins
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.refining.refining import Refining


@pytest.mark.parametrize(
    ("refined", "begun_with", "best"),
    [
        # the first gains 5 %, so the others are refined, and the next refinement continues from the cheapest of all
        ({10.0: 9.5, 11.0: 7.0, 11.5: 9.0, 7.0: 6.9}, [10.0, 11.0, 11.5, 7.0], 6.9),
        ({10.0: 9.5, 11.0: 10.9, 11.5: 11.4, 9.5: 9.4}, [10.0, 11.0, 11.5, 9.5], 9.4),
        ({10.0: 9.7}, [10.0], 9.7),  # 3 %: no more is tried
        ({10.0: 10.1}, [10.0], 10.0),
    ],
)
def test_if_refining_pays_the_cheapest_other_motions_are_refined_too(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, refined: dict[float, float], begun_with: list[float],
    best: float,
) -> None:  # fmt: skip
    """Motions of 12.5, a quarter above the best, and a fourth one, are not refined."""
    world, _, search = ended_search(planar4)
    descents, refining, curve = search._descents, search._refining, JointCurve.straight(START, END, 12)
    motion = time_evenly(curve, DURATION)
    ended = [
        FoundMotion(motion, cost, world.problem.goals[0], "straight", curve) for cost in (12.5, 11.5, 10.0, 11.9, 11.0)
    ]
    descents.ended, descents.incumbent.best = ended, ended[2]
    begun: list[float] = []

    def bend(*_: Any, **__: Any) -> Timed:
        return Timed(curve, DURATION, refined[begun[-1]], 0.0, Margins.none(4), within_limits=motion)

    def finer(found: FoundMotion, pieces: int) -> bool:
        begun.append(found.cost)
        return refine(found, pieces)

    def offer(found: FoundMotion) -> None:
        if descents.best is None or found.cost < descents.best.cost:
            descents.incumbent.best = found

    refine = refining._refine
    for owner, name, stub in (
        (descents.rounds, "run", bend),
        (refining, "_refine", finer),
        (descents.incumbent, "offer", offer),
    ):
        monkeypatch.setattr(owner, name, stub)
    refining.run()
    assert begun == begun_with
    assert descents.best is not None
    assert descents.best.cost == best
    assert refining.gained == pytest.approx(1.0 - best / 10.0)


@pytest.mark.parametrize(
    ("millimetres", "begun"),
    [
        (0.9, [20, 28]),
        (1.3, [20, 28]),  # it costs less than a lift by a millimetre as soon as it is refined
        (3.0, [20, 20, 28, 36, 52]),  # another motion, which costs a tenth more, after the first; 0.7^4 of 3 mm are 0.7
        (6.0, [20, 20, 28, 36, 52, 72]),
    ],
)
def test_a_motion_that_costs_less_than_a_lift_by_a_millimetre_is_refined_twice_and_no_other_beside_it(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, millimetres: float, begun: list[int]
) -> None:
    """Each time 30 % is gained."""
    world, _, search = ended_search(planar4)
    best = motion_of_lift(world, millimetres)
    other = replace(best, cost=1.1 * best.cost)
    search._incumbent.best, search._descents.ended[:] = best, [best, other]
    tried: list[int] = []

    def gain(found: FoundMotion, pieces: int) -> bool:
        tried.append(pieces)
        if found is search.best:
            search._incumbent.best = replace(found, cost=0.7 * found.cost)
        return True

    monkeypatch.setattr(search._refining, "_refine", gain)
    search._refining.run()
    assert tried == begun


@pytest.mark.parametrize(("missed", "kept"), [(0.0029, True), (0.0031, False)])
def test_a_refined_motion_that_uses_some_of_the_spare_of_3_mm_is_kept_if_it_is_proven(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, missed: float, kept: bool
) -> None:
    """Nothing is near, so that the motion is proven; one that misses all of the spare is not even tried."""
    world, _, search = ended_search(planar4)
    incumbent, curve = search._incumbent, JointCurve.straight(START, END, 12)
    motion = time_evenly(curve, DURATION)
    incumbent.best = FoundMotion(motion, 10.0, world.problem.goals[0], "straight", curve)
    fine = Timed(curve, DURATION, 9.0, missed, Margins.none(4), within_limits=motion)
    monkeypatch.setattr(search._descents.rounds, "run", lambda *_, **__: fine)
    assert search._refining._refine(incumbent.best, 20)
    assert incumbent.best.cost == (9.0 if kept else 10.0)


@pytest.mark.long
def test_a_motion_that_costs_nothing_is_not_refined(backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """A swing by 0.1 mrad beside a wall costs less than a nanojoule."""
    monkeypatch.setattr(Refining, "run", lambda *_: pytest.fail("a curve is refined"))
    start = dict(zip(backhoe.joint_names, (-0.9, 0.3, -1.4, -0.8), strict=True))
    wall = {"name": "wall", "shape": "box", "size": [3.0, 0.3, 2.0], "position": [3.2, 0.3, 0.0]}
    content = {"version": 1, "start": {"joints": start}, "obstacles": [wall], "objective": "work"}
    goal = {"joints": start | {"swing": -0.9 + 1e-4}}
    plan = bp.plan(backhoe, bp.scene_from_dict(content | {"task": {"goal": goal}}), seed=3)
    assert plan.verified, plan.message
    assert 0.0 <= plan.metrics.energy["work"] < 1e-9


@pytest.mark.parametrize(("millimetres", "enough"), [(0.9, 0.01), (1.1, 0.001)])
def test_a_motion_that_costs_little_is_not_refined_to_the_last(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, millimetres: float, enough: float
) -> None:
    world, _, search = ended_search(planar4)
    search._incumbent.best = motion_of_lift(world, millimetres)
    search._descents.ended.clear()
    asked: list[Options] = []
    monkeypatch.setattr(search._descents.rounds, "run", lambda *at, **_: asked.append(at[3]))
    search._refining.run()
    assert [options.enough for options in asked] == [enough]
