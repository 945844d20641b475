"""Further searches for a motion to a goal, each with its own random choices."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from one_joint_search import DURATION, END, START, ended_search, scene, world_of

import backhoe_planner as bp
from backhoe_planner.motion import Goal, build_problem, time_evenly
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.goals import cost_search
from backhoe_planner.planning.goals import searches as goal_searches
from backhoe_planner.planning.goals.cost_search import CostSearch
from backhoe_planner.planning.goals.fast_motions import FastMotions
from backhoe_planner.planning.goals.goal_planning import ToGoal
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.multistart import cost_descents
from backhoe_planner.planning.multistart.cost_descents import CostDescents
from backhoe_planner.planning.multistart.first_rounds import FirstRounds
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start
from backhoe_planner.planning.refining.refining import Refining
from backhoe_planner.planning.search.effort import EFFORTS, Effort, Work
from backhoe_planner.planning.world.world import World

LONG = 5.0  # with the objective time, a cost above this counts as much longer than the joints need


class Searches:
    """Searches that find given costs and durations, and record the seeds of their worlds."""

    def __init__(
        self, goal: Goal, found: list[tuple[float, float]], *, leads_round: bool = False, is_for_time: bool = False,
        rounds: int = 0, repeats: bool = False, refining_paid: bool = False, postures: int = 1,
        allowed_time: float = 5.0,
    ) -> None:  # fmt: skip
        self.postures, self.allowed_time = postures, allowed_time
        self._repeats, self.refining_paid = repeats, refining_paid
        self._goal, self._left, self.leads_round, self.is_for_time = goal, iter(found), leads_round, is_for_time
        self.rounds = rounds
        self.seeds: list[int] = []
        self.efforts: list[Any] = []
        self.longest: list[float] = []
        self.before: list[Any] = []
        self.earlier: list[int] = []
        self.freely: list[bool] = []
        self.looked_at = self.routes = 0
        self.best: FoundMotion | None = None
        self.fast: FoundMotion | None = None

    def __call__(
        self, world: World, *_: Any, longest: float = math.inf, before: Any = None, earlier: Any = (),
        freely: bool = False, **__: Any,
    ) -> Searches:  # fmt: skip
        self.earlier.append(len(earlier))
        self.freely.append(freely)
        self.seeds.append(world.seed)
        self.longest.append(longest)
        self.before.append(before)
        self.efforts.append(world.work.effort)
        return self

    @property
    def repeats(self) -> bool:
        return self._repeats and len(self.seeds) > 1

    @property
    def takes_long(self) -> bool:
        return self.is_for_time and self.best is not None and self.best.cost > LONG

    def run(self) -> str:
        cost, duration = next(self._left)
        motion = time_evenly(JointCurve.straight(START, END, 12), duration)
        self.best = FoundMotion(motion, cost, self._goal, f"search {len(self.seeds)}")
        return ""


def way_of(
    robot: bp.Robot, objective: str, found: Iterator[tuple[float, float]], patch: Any, *,
    effort: Effort | None = None, leads_round: bool = False, rounds: int = 0, repeats: bool = False,
    refining_paid: bool = False, postures: int = 1, allowed_time: float = 5.0,
) -> tuple[str, Searches]:  # fmt: skip
    effort = effort or replace(EFFORTS["thorough"], begins_with="", restarts=3)
    world = World(build_problem(robot, scene(robot, objective)), seed=5, work=Work(effort))
    searches = Searches(
        world.problem.goals[0], list(found), leads_round=leads_round, is_for_time=objective == "time",
        rounds=rounds, repeats=repeats, refining_paid=refining_paid, postures=postures, allowed_time=allowed_time,
    )  # fmt: skip
    patch.setattr(goal_searches, "TimeSearch" if objective == "time" else "CostSearch", searches)
    outcome = ToGoal(world.problem.goals).from_rest(world, world.stepper(START))
    assert not outcome.reason
    return outcome.findings.way or "", searches


@pytest.mark.parametrize(
    ("others", "best"),
    [
        ([(9.0, 4.0), (7.0, 4.5), (8.0, 4.0)], "search 3"),
        ([(9.0, 4.0), (7.0, 5.5), (9.5, 4.0)], "search 2"),  # the cheapest takes longer than allowed
        ([(12.0, 4.0), (11.0, 4.0), (10.0, 4.0)], "search 1"),
    ],
)
def test_the_cheapest_motion_within_the_allowed_time_is_returned(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, others: list[tuple[float, float]], best: str
) -> None:
    way, searches = way_of(planar4, "work", iter([(10.0, DURATION), *others]), monkeypatch)
    assert way == best
    assert len(set(searches.seeds)) == 4
    assert searches.seeds[0] == 5
    assert searches.efforts[1:] == [replace(EFFORTS["normal"], frugal=False)] * 3
    assert searches.longest == [math.inf, 5.0, 5.0, 5.0]
    assert searches.before == [None] * 4  # each begins anew


@pytest.mark.parametrize(
    ("effort", "costs", "best"),
    [
        ("normal", [4.0], "search 1"),
        ("normal", [10.0, 4.0], "search 2"),
        ("normal", [10.0, 11.0], "search 1"),
        ("quick", [10.0], "search 1"),
    ],
)
def test_for_least_time_the_search_is_repeated_if_the_best_is_long(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, effort: Any, costs: list[float], best: str
) -> None:
    found = iter([(cost, DURATION) for cost in costs])
    way, searches = way_of(planar4, "time", found, monkeypatch, effort=EFFORTS[effort])
    assert (way, len(searches.seeds)) == (best, len(costs))
    assert len(set(searches.seeds)) == len(costs)
    assert searches.before == [None] * len(costs)


@pytest.mark.parametrize(
    ("costs", "best"),
    [
        ([4.0, 3.0], "search 2"),
        ([4.0, 4.5], "search 1"),  # the normal effort found the cheaper one
        ([10.0, 4.0, 4.0], "search 3"),  # two searches of the normal effort
        ([10.0, 4.0, 10.0, 9.0, 9.5], "search 2"),
    ],
)
def test_thorough_begins_with_all_of_normal_and_keeps_its_best(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, costs: list[float], best: str
) -> None:
    found = iter([(cost, DURATION) for cost in costs])
    way, searches = way_of(planar4, "time", found, monkeypatch, effort=EFFORTS["thorough"])
    assert (way, len(searches.seeds)) == (best, len(costs))
    of_normal = 1 if costs[0] <= LONG else 2
    assert searches.efforts[:of_normal] == [EFFORTS["normal"]] * of_normal
    assert searches.efforts[of_normal] == EFFORTS["thorough"]
    assert searches.seeds[0] == searches.seeds[of_normal] == 5


@pytest.mark.long
def test_thorough_costs_no_more_than_normal_even_if_its_own_searches_find_worse_minima(backhoe: bp.Robot) -> None:
    """Here they end 0.17 % above."""
    scene = bp.scene_from_dict({
        "version": 1,
        "start": {"joints": {"swing": 1.531, "boom": -0.292, "stick": -0.654, "bucket": 0.32}},
        "task": {"goal": {"position": [2.143, -0.763, -0.58]}},
        "objective": "hydraulic",
        "obstacles": [{"name": "box", "shape": "box", "size": [1.28, 0.81, 0.61], "position": [0.56, -1.17, -0.01]}],
    })  # fmt: skip
    normal, thorough = (bp.plan(backhoe, scene, effort=effort) for effort in ("normal", "thorough"))
    assert normal.verified
    assert thorough.verified
    assert thorough.metrics.energy["hydraulic"] <= normal.metrics.energy["hydraulic"] * (1.0 + 1e-9)


@pytest.mark.parametrize(("leads_round", "count"), [(False, 1), (True, 2)])
def test_thorough_continues_its_own_search_if_the_best_makes_a_detour(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, leads_round: bool, count: int
) -> None:
    found = iter([(10.0, DURATION), (9.0, 4.0)])
    effort = replace(EFFORTS["thorough"], begins_with="", restarts=0)
    way, searches = way_of(planar4, "work", found, monkeypatch, effort=effort, leads_round=leads_round)
    assert (way, len(searches.seeds)) == (f"search {count}", count)
    assert searches.before == [None, searches][:count]  # it continues the one before


@pytest.mark.parametrize(
    ("rounds", "costs", "best"),
    [
        (10, [10.0], "search 1"),  # a motion found soon would be found again
        (90, [10.0, 10.2, 10.3], "search 1"),  # one of each kind
        (90, [10.0, 12.0, 9.8], "search 3"),  # 2 % less
        (90, [10.0, 9.8, 9.6], "search 3"),
        (90, [10.0, 8.0, 8.1], "search 2"),
        (90, [10.0, 8.0, 6.0, 4.0], "search 4"),  # and no fifth
        (90, [1e-3], "search 1"),  # less than lifting all moving links by half a millimetre
    ],
)
def test_long_searches_for_least_work_are_repeated_until_one_gains_little(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, rounds: int, costs: list[float], best: str
) -> None:
    found = iter([(cost, DURATION) for cost in costs])
    way, searches = way_of(planar4, "work", found, monkeypatch, effort=EFFORTS["normal"], rounds=rounds)
    assert (way, len(searches.seeds)) == (best, len(costs))
    assert searches.before == [None] * len(costs)
    assert searches.earlier == list(range(len(costs)))
    assert searches.freely == [False, True, False, True][: len(costs)]


def test_every_other_further_search_begins_freely_and_all_keep_to_the_allowed_time(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = iter([(10.0, DURATION), (12.0, DURATION), (9.9, DURATION)])
    _, searches = way_of(planar4, "work", found, monkeypatch, effort=EFFORTS["normal"], rounds=90, allowed_time=5.0)
    assert searches.freely == [False, True, False]
    assert searches.longest == [math.inf, 5.0, 5.0]


@pytest.mark.parametrize(
    ("costs", "leads_round", "best"),
    [
        ([10.0, 10.2], False, "search 1"),  # two costs agree
        ([10.0, 12.0, 10.1], False, "search 1"),
        ([10.0, 8.0, 6.0, 4.0], False, "search 4"),  # and no fifth
        ([10.0, 9.0, 9.1], True, "search 2"),  # the second continues the first, and agrees with the third
    ],
)
def test_short_searches_for_another_cost_than_work_are_repeated_until_two_costs_agree(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, costs: list[float], leads_round: bool, best: str
) -> None:
    found = iter([(cost, DURATION) for cost in costs])
    way, searches = way_of(
        planar4, "effort", found, monkeypatch, effort=EFFORTS["normal"], leads_round=leads_round, rounds=10
    )  # fmt: skip
    assert (way, len(searches.seeds)) == (best, len(costs))
    assert [one is not None for one in searches.before] == [leads_round and number == 1 for number in range(len(costs))]


@pytest.mark.parametrize(("paid", "count"), [(False, 1), (True, 3)])
def test_a_short_search_is_repeated_if_refining_took_much_from_its_best(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, paid: bool, count: int
) -> None:
    found = iter([(10.0, DURATION), (10.1, DURATION), (10.2, DURATION)])
    _, searches = way_of(
        planar4, "work", found, monkeypatch, effort=EFFORTS["normal"], rounds=10, refining_paid=paid
    )  # fmt: skip
    assert len(searches.seeds) == count


@pytest.mark.parametrize(("postures", "freely"), [(12, [False]), (300, [False, True])])
def test_a_short_search_is_followed_by_one_of_the_other_kind_if_there_are_many_postures(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, postures: int, freely: list[bool]
) -> None:
    found = iter([(10.0, DURATION), (5.0, DURATION), (4.0, DURATION)])
    way, searches = way_of(
        planar4, "work", found, monkeypatch, effort=EFFORTS["normal"], rounds=10, postures=postures
    )  # fmt: skip
    assert searches.freely == freely
    assert way == f"search {len(freely)}"


@pytest.mark.parametrize(
    ("known", "dear", "begun"),
    [
        ("", 1.0, "ab"),  # two motions
        ("b", 1.0, "abc"),  # the second goes where the first ended
        ("bc", 1.0, "abc"),  # no more than three starts
        ("b", 3.0, "ab"),  # the third costs more than twice as much as the first
    ],
)
def test_a_descent_that_goes_where_another_one_ended_is_followed_by_one_from_the_next_start(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, known: str, dear: float, begun: str
) -> None:
    """Four starts are clear after their first rounds; of three the normal effort descends to two motions."""
    curve = JointCurve.straight(START, END, 12)
    costs = {"a": 10.0, "b": 11.0, "c": 12.0 * dear, "d": 13.0 * dear}
    _, _, search = ended_search(planar4)
    assert descents_begun(search, {name: (cost, curve) for name, cost in costs.items()}, monkeypatch, known) == begun


@pytest.mark.parametrize(
    ("far", "cost", "begun"),
    [
        (True, 15.0, "abd"),
        (True, 21.0, "ab"),  # it costs more than twice as much as the first
        (False, 15.0, "ab"),  # its end is near those of the others
    ],
)
def test_one_more_descent_leads_to_an_end_that_is_far_from_those_of_the_others(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, far: bool, cost: float, begun: str
) -> None:
    _, _, search = ended_search(planar4)
    assert search.allowed_time is not None
    elsewhere = END.copy()
    # the first joint moves the most mass, so that its velocity limit counts
    elsewhere[0] -= (0.2 if far else 0.1) * search.allowed_time * planar4.limits.velocity[0]
    near, other = (JointCurve.straight(START, end, 12) for end in (END, elsewhere))
    starts = {"a": (10.0, near), "b": (11.0, near), "c": (12.0, near), "d": (cost, other)}
    assert descents_begun(search, starts, monkeypatch) == begun


def descents_begun(
    search: CostSearch, starts: dict[str, tuple[float, JointCurve]], patch: Any, known: str = ""
) -> str:  # fmt: skip
    """From which of the `starts`, clear after their first rounds at these costs, `descend_cheapest` begins descents.

    Those from the `known` ones end where others have ended.
    """
    descents, goal = search._descents, search._problem.goals[0]
    rounds = FirstRounds([(cost, Start(curve, DURATION, goal, name)) for name, (cost, curve) in starts.items()], [])
    patch.setattr(cost_descents, "after_first_rounds", lambda *_, **__: rounds)
    run = ""

    def descend(start: Start) -> bool:
        nonlocal run
        run += start.way
        if start.way not in known:
            motion = time_evenly(start.curve, DURATION)
            descents.ended.append(FoundMotion(motion, starts[start.way][0], goal, start.way, start.curve))
        return True

    patch.setattr(descents, "descend", descend)
    descents.descend_cheapest([PricedStart(start, 1.0) for _, start in rounds.clear])
    return run


@pytest.mark.parametrize(
    ("earlier", "run"),
    [
        ((10.0, math.inf), ""),  # 10.3 J after the first rounds, against 10 J
        ((10.2, math.inf), "a"),
        ((10.0, 9.0), "a"),  # an earlier start at 9 J stays in an obstacle: a detour may be cheaper
        ((math.inf, math.inf), "a"),
    ],
)
def test_a_search_ends_after_its_first_rounds_if_an_earlier_one_had_a_cheaper_start(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, earlier: tuple[float, float], run: str
) -> None:
    world = world_of(planar4)
    descents, other = (CostDescents(world, START, Incumbent(world, time=0.0, longest=5.0), time=0.0) for _ in range(2))
    other.early, other.blocked = earlier
    descents.know_of([other])
    start = Start(JointCurve.straight(START, END, 12), DURATION, world.problem.goals[0], "a")
    rounds = FirstRounds([(10.3, start)], [])
    monkeypatch.setattr(cost_descents, "after_first_rounds", lambda *_, **__: rounds)
    descended = ""

    def descend(start: Start) -> bool:
        nonlocal descended
        descended += start.way
        return True

    monkeypatch.setattr(descents, "descend", descend)
    descents.descend_cheapest([PricedStart(start, 1.0)] * 2)
    assert descended == run
    assert descents.falls_short == (not run)


def test_what_an_earlier_search_has_refined_is_not_refined_again(planar4: bp.Robot) -> None:
    """The same search with other random choices about its starts finds the same coarse motion."""
    world, found, first = ended_search(planar4)
    assert first.allowed_time is not None
    again = CostSearch(
        world.anew(1, EFFORTS["normal"]), START, found, time=0.0, longest=first.allowed_time, earlier=[first]
    )
    again._tried, again._descents._to_beat = [], math.inf  # so that it is not ended before its descents
    assert again.run() == ""
    assert again.repeats
    assert again.best is not None
    assert again.best.cost == pytest.approx(first._refining.cost_before, rel=1e-6)
    assert again.rounds > 0


def test_a_search_that_would_only_repeat_another_one_counts_as_one_of_the_same_cost(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends with its fast motion, which costs 30."""
    found = iter([(10.0, DURATION), (30.0, DURATION), (30.0, DURATION)])
    way, searches = way_of(planar4, "work", found, monkeypatch, effort=EFFORTS["normal"], rounds=90, repeats=True)
    assert (way, len(searches.seeds)) == ("search 1", 3)
    found = iter([(10.0, DURATION), (30.0, DURATION)])
    _, searches = way_of(planar4, "effort", found, monkeypatch, effort=EFFORTS["normal"], rounds=90, repeats=True)
    assert len(searches.seeds) == 2  # two of the same cost agree


def test_a_search_from_the_starts_of_an_earlier_one_ends_before_any_descent_for_its_cost(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The goal is one posture, so that the straight line to it, and its paces, are the same again."""
    world, found, first = ended_search(planar4)
    assert not first.repeats
    assert not first.leads_round
    assert first.allowed_time is not None
    again = CostSearch(
        world.anew(1, EFFORTS["normal"]), START, found, time=0.0, longest=first.allowed_time, earlier=[first]
    )
    assert again.run() == ""
    assert again.repeats
    assert again.rounds == 0


def test_a_quick_plan_never_searches_again(planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even after a long search for a motion that makes a detour, which the normal effort continues."""
    way, searches = way_of(
        planar4, "work", iter([(10.0, DURATION)]), monkeypatch, effort=EFFORTS["quick"], leads_round=True, rounds=90
    )
    assert (way, searches.seeds) == ("search 1", [5])


def test_a_continued_search_keeps_the_best_and_refines_only_what_is_better(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A free motion of one joint: a continued search finds no better one, and refines no curve."""
    world, found, first = ended_search(planar4)
    again = CostSearch(world.anew(1, EFFORTS["normal"]), START, found, time=0.0, before=first)
    assert again.allowed_time == first.allowed_time
    coarse = again.best
    assert coarse is not None
    monkeypatch.setattr(Refining, "run", lambda *_: pytest.fail("a curve is refined"))
    assert again.run() == ""
    assert again.best is coarse
    assert first.best is not None
    assert first.best.cost <= coarse.cost


def test_of_two_fast_motions_with_which_a_search_begins_it_keeps_the_faster_one(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second, longer search for a fast motion need not find a faster one."""
    world = world_of(planar4)
    found = find_goal_postures(world, world.problem.goals, near=START, time=0.0)
    assert isinstance(found, GoalPostures)
    line = JointCurve.straight(START, END, 12)
    fast = [
        FastMotions(
            fastest=FoundMotion(time_evenly(line, T), T, world.problem.goals[0], "straight", line), ended=[],
            allowed_time=3.0 * T, postures=[], goals=[], looked_at=0, routes=0,
        )
        for T in (DURATION, 1.5 * DURATION)
    ]  # fmt: skip
    monkeypatch.setattr(cost_search, "fast_motions", lambda *_, **__: iter(fast))
    search = CostSearch(world, START, found, time=0.0)
    assert search.run() == ""
    assert search.fast is not None
    assert search.fast.motion.duration == pytest.approx(DURATION)
    assert search.allowed_time == 3.0 * DURATION
