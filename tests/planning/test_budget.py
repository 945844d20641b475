"""The budget ends a search; what it has found is finished, returned and judged by its certificate.

Only the test moves the clock, so that the load of the computer does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bar_scenes import STRETCHED as STRAIGHT
from bar_scenes import TURNED, across_bar

import backhoe_planner as bp
from backhoe_planner.planning import (
    OutOfTime,
    Reach,
    Roadmap,
    SampledCheck,
    blend,
    joint_time,
    plan_motion,
    sample_path,
)
from backhoe_planner.planning.search import effort
from backhoe_planner.planning.stretches import dynamic_programming, smoothing
from backhoe_planner.proof import LeastTimes

Data = dict[str, Any]

ROOM = "backhoe_planner.planning"
STRETCHED: Data = {"joints": {"joint1": 0.0, "joint2": 0.0, "joint3": 0.0, "joint4": 0.0}}
LINE: Data = {
    "path": {"waypoints": [{"position": [2.0, -1.0, 0.0]}, {"position": [2.0, 1.0, 0.0]}], "speed": 0.4},
}
BENT: Data = {"joints": {"joint1": 0.3, "joint2": -0.6, "joint3": 0.5, "joint4": 0.2}}
BEHIND: Data = {"goal": {"position": [2.0, 2.5, 0.0]}}
POST: Data = {"name": "post", "shape": "sphere", "radius": 0.3, "position": [2.6, 1.7, 0.0]}


class HandSetClock:
    """Seconds of computing that pass when the test says so, and `tick` of them at every reading."""

    def __init__(self) -> None:
        self.now = self.tick = 0.0

    def monotonic(self) -> float:
        self.now += self.tick
        return self.now

    def thread_time(self) -> float:
        return self.now

    def runs_out_at(self, call: Callable[..., Any], number: int = 1) -> Callable[..., Any]:
        """`call`, whose call of that number uses up all time."""
        calls = 0

        def counting(*args: Any, **keys: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == number:
                self.now = 1e9
            return call(*args, **keys)

        return counting


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> HandSetClock:
    clock = HandSetClock()
    monkeypatch.setattr(effort, "clock", SimpleNamespace(thread_time=clock.thread_time, monotonic=clock.monotonic))
    return clock


def site(task: Data, *, start: Data | None = STRETCHED, obstacles: list[Data] | None = None, **keys: Any) -> bp.Scene:
    content = {"version": 1, "task": task, "clearance": 0.02, "obstacles": obstacles or []} | keys
    return bp.scene_from_dict(content if start is None else content | {"start": start})


# --- along a path -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "objective", "module", "name", "number"),
    [
        pytest.param(None, "work", dynamic_programming._Descent, "step", 3, marks=pytest.mark.long),
        (STRETCHED, "velocity_norm", smoothing, "_step", 2),
    ],
)
def test_a_route_is_kept_if_time_runs_out_while_it_is_made_cheaper(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch,
    start: Data | None, objective: str, module: Any, name: str, number: int,
) -> None:  # fmt: skip
    scene = site(LINE, start=start, objective=objective)
    whole = bp.plan(planar4, scene, effort="quick")
    assert whole.message == ""
    monkeypatch.setattr(module, name, clock.runs_out_at(getattr(module, name), number))
    cut_short = bp.plan(planar4, scene, effort="quick", budget=5.0)
    assert clock.now >= 1e9, "the search was not interrupted"
    assert (cut_short.verdict, cut_short.reason) == ("verified", "")
    assert cut_short.message.startswith("time ran out after 5 s of computing; ")
    assert cut_short.message.count("--budget gives more") == 1
    assert "the search for a cheaper motion was not finished" in cut_short.message
    assert cut_short.certificate.tracking.done
    assert not np.array_equal(cut_short.trajectory.q, whole.trajectory.q)


def test_without_a_complete_route_there_is_no_motion_if_time_runs_out(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time runs out on the way to the path, before it is followed."""
    monkeypatch.setattr(f"{ROOM}.transit.sample_path", clock.runs_out_at(sample_path))
    plan = bp.plan(planar4, site(LINE))
    assert (plan.verdict, plan.reason, len(plan.trajectory)) == ("failed", "budget", 1)


# --- to a goal ----------------------------------------------------------------------


def test_a_motion_is_kept_if_time_runs_out_in_the_search_for_a_better_one(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = site(BEHIND, start=BENT, obstacles=[POST])
    monkeypatch.setattr(f"{ROOM}.multistart.ways.blend", clock.runs_out_at(blend, number=2))
    plan = bp.plan(planar4, scene)
    assert (plan.verdict, plan.reason) == ("verified", "")
    assert plan.message.startswith("time ran out after 60 s of computing; ")
    assert plan.message.count("--budget gives more") == 1
    assert "the search for a better motion was not finished" in plan.message


def test_if_time_runs_out_before_any_motion_the_plan_holds_the_start(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = site(BEHIND, start=BENT, obstacles=[POST])
    monkeypatch.setattr(f"{ROOM}.search.goal_ends.LeastTimes", clock.runs_out_at(LeastTimes))
    plan = bp.plan(planar4, scene)
    assert (plan.verdict, plan.reason, len(plan.trajectory)) == ("failed", "budget", 1)
    assert plan.message.startswith("time ran out after 60 s of computing; ")
    assert plan.message.count("--budget gives more") == 1
    assert plan.certificate.safe


@pytest.mark.parametrize("looks", [50, 400])
def test_attempts_of_the_law_end_when_time_runs_out_and_the_closest_is_returned(
    planar4: bp.Robot, clock: HandSetClock, looks: int
) -> None:
    """The law reads the clock once a step."""
    clock.tick = 1.0
    plan = bp.plan(planar4, site(BEHIND, start=BENT, obstacles=[POST]), method="reactive", budget=float(looks))
    assert (plan.verdict, plan.reason) == ("failed", "budget")
    assert plan.findings.attempts is not None
    assert plan.findings.attempts >= 1
    attempts = (
        "the only attempt" if plan.findings.attempts == 1 else f"the closest of {plan.findings.attempts} attempts"
    )
    assert attempts in plan.message
    assert plan.findings.closest_distance is not None
    assert len(plan.trajectory) > 10
    assert plan.certificate.safe


def test_only_the_computing_time_of_the_thread_uses_up_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within 100 s of wall time, the thread computes for 2 s, then for 4 s."""
    now = {"monotonic": 50.0, "thread_time": 1.0}
    monkeypatch.setattr(effort, "clock", SimpleNamespace(**{name: lambda name=name: now[name] for name in now}))
    brake = effort.Brake(3.0)
    for computed, is_used_up in ((2.0, False), (4.0, True)):
        now |= {"monotonic": 150.0, "thread_time": 1.0 + computed}
        assert brake.is_used_up() is is_used_up


def test_the_budget_ends_the_search_for_the_cheapest_route_through_a_roadmap(
    planar4: bp.Robot, clock: HandSetClock
) -> None:
    """No route costs as little as nothing, so no motion is checked meanwhile."""
    problem, proximity = across_bar(planar4)
    price = joint_time(problem.limits.velocity)
    reach, brake = Reach(problem.limits, STRAIGHT, TURNED[None, :]), effort.Brake(5.0)
    check = SampledCheck(problem, proximity, [STRAIGHT, TURNED], spare=0.0, brake=brake)
    roadmap = Roadmap(check, reach, nodes=50, rng=np.random.default_rng(0), price=price)
    assert list(roadmap.ways(dearest=0.0)) == []
    clock.now = 6.0
    with pytest.raises(OutOfTime):
        list(roadmap.ways(dearest=0.0))


# --- sequences ----------------------------------------------------------------------

LEGS: Data = {
    "sequence": [
        {"name": "aside", "goal": {"position": [2.0, 2.5, 0.0]}},
        {"name": "back", "goal": {"position": [2.5, -2.0, 0.0]}},
        {"name": "home", "goal": BENT},
    ]
}


def test_the_ways_between_ends_of_legs_are_priced_only_while_time_is_left(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each price takes 10 to 40 ms; there is one for each of 12 ends, and one from the start."""
    calls = 0
    out = clock.runs_out_at(LeastTimes, number=3)

    def counting(*args: Any, **keys: Any) -> Any:
        nonlocal calls
        calls += 1
        return out(*args, **keys)

    monkeypatch.setattr(f"{ROOM}.sequence.ends.LeastTimes", counting)
    plan = bp.plan(planar4, site(LEGS, start=BENT), effort="quick")
    assert calls == 3
    assert (plan.verdict, plan.reason, len(plan.legs)) == ("verified", "", 3)
    assert plan.message.startswith("time ran out after 60 s of computing; ")
    assert plan.message.count("--budget gives more") == 1


def test_legs_planned_with_less_effort_are_kept_if_time_runs_out_after_them(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All legs are planned with the quick effort first: here there is time for one of them."""
    room = f"{ROOM}.sequence.leg_planning"
    monkeypatch.setattr(f"{room}.plan_motion", clock.runs_out_at(plan_motion, number=2))
    plan = bp.plan(planar4, site(LEGS, start=BENT), effort="normal")
    assert (plan.verdict, plan.reason) == ("failed", "budget")
    assert [leg.name for leg in plan.legs] == ["aside", "back"]
    assert [leg.certificate.verified for leg in plan.legs] == [True, False]
