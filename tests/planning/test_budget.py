"""The budget ends a search, not what it has found: that is finished, delivered and judged by its certificate.

The clock here is one that only the test moves, so that the load of the machine does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.planning import blend, sample_path
from backhoe_planner.planning.paths import dynamic_programming, smoothing
from backhoe_planner.planning.search import effort
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
    """Seconds of computing that go by when the test says so, `tick` of them at every look."""

    def __init__(self) -> None:
        self.now = self.tick = 0.0

    def monotonic(self) -> float:
        self.now += self.tick
        return self.now

    def thread_time(self) -> float:
        return self.now

    def runs_out_at(self, call: Callable[..., Any], number: int = 1) -> Callable[..., Any]:
        """`call`, from whose call of that number on no time is left."""
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
def test_a_route_is_kept_where_time_runs_out_while_it_is_made_cheaper(
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
    assert cut_short.message.startswith("time ran out after 5 s of computing; --budget gives more")
    assert cut_short.message.endswith("the search for a cheaper motion was not finished")
    assert cut_short.certificate.tracking.done
    assert not np.array_equal(cut_short.trajectory.q, whole.trajectory.q)


def test_without_a_complete_route_there_is_no_motion(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time runs out on the way to the path, before it is followed."""
    monkeypatch.setattr(f"{ROOM}.transit.sample_path", clock.runs_out_at(sample_path))
    plan = bp.plan(planar4, site(LINE))
    assert (plan.verdict, plan.reason, len(plan.trajectory)) == ("failed", "budget", 1)


# --- to a goal ----------------------------------------------------------------------


def test_a_motion_that_was_found_is_kept_where_time_runs_out_for_a_better_one(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = site(BEHIND, start=BENT, obstacles=[POST])
    monkeypatch.setattr(f"{ROOM}.goals.ways.blend", clock.runs_out_at(blend, number=2))
    plan = bp.plan(planar4, scene)
    assert (plan.verdict, plan.reason) == ("verified", "")
    assert plan.message.startswith("time ran out after 60 s of computing; --budget gives more")
    assert plan.message.endswith("the search for a better motion was not finished")


def test_without_any_motion_the_start_is_shown_where_time_runs_out(
    planar4: bp.Robot, clock: HandSetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = site(BEHIND, start=BENT, obstacles=[POST])
    monkeypatch.setattr(f"{ROOM}.search.goal_ends.LeastTimes", clock.runs_out_at(LeastTimes))
    plan = bp.plan(planar4, scene)
    assert (plan.verdict, plan.reason, len(plan.trajectory)) == ("failed", "budget", 1)
    assert plan.message.startswith("time ran out after 60 s of computing; --budget gives more")
    assert plan.certificate.safe


@pytest.mark.parametrize("looks", [50, 400])
def test_the_attempts_of_the_law_end_where_time_does(planar4: bp.Robot, clock: HandSetClock, looks: int) -> None:
    """One look at the clock a step: of the attempts up to there the nearest is shown."""
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


def test_only_the_threads_own_computing_uses_up_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 100 s that go by, the thread computes for 2 s, then for 4 s."""
    now = {"monotonic": 50.0, "thread_time": 1.0}
    monkeypatch.setattr(effort, "clock", SimpleNamespace(**{name: lambda name=name: now[name] for name in now}))
    brake = effort.Brake(3.0)
    for computed, is_used_up in ((2.0, False), (4.0, True)):
        now |= {"monotonic": 150.0, "thread_time": 1.0 + computed}
        assert brake.is_used_up() is is_used_up
