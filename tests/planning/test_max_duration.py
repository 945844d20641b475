"""The longest duration of a motion to a goal that a scene allows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import backhoe_planner as bp

START = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
POLE = {"name": "pole", "shape": "cylinder", "radius": 0.1, "length": 3.0, "position": [4.0, 1.2, 1.5]}


def scene(task: dict[str, Any], **keys: Any) -> bp.Scene:
    content = {"version": 1, "start": {"joints": START}, "task": task, "clearance": 0.05, "obstacles": [POLE], **keys}
    return bp.scene_from_dict(content)


def reach(longest: float | None, **keys: Any) -> bp.Scene:
    task: dict[str, Any] = {"goal": {"position": [3.0, 2.5, 1.5]}}
    return scene(task if longest is None else {**task, "max_duration": longest}, **keys)


def test_the_least_work_rises_as_less_time_is_allowed(backhoe: bp.Robot) -> None:
    plans = [bp.plan(backhoe, reach(longest, objective="work"), effort="quick") for longest in (10.0, 4.0, 2.6)]
    assert all(plan.verified for plan in plans), [plan.message for plan in plans]
    for plan, longest in zip(plans, (10.0, 4.0, 2.6), strict=True):
        assert plan.trajectory.duration <= longest * (1.0 + 1e-6)
        assert plan.findings.allowed_time == pytest.approx(longest)
        assert plan.certificate.duration is not None
        assert plan.certificate.duration.ratio == pytest.approx(plan.trajectory.duration / longest)
    work = [plan.metrics.energy["work"] for plan in plans]
    assert work[0] < 1.03 * work[1]
    assert work[1] < 0.95 * work[2]


def test_a_max_duration_below_the_bound_is_refused_with_the_bound(backhoe: bp.Robot) -> None:
    free = bp.plan(backhoe, reach(None), effort="quick")
    assert free.bound is not None
    plan = bp.plan(backhoe, reach(0.9 * free.bound.duration), effort="quick")
    assert (plan.reason, plan.verdict) == ("outside_limits", "failed")
    assert plan.message.startswith("no motion can take less than ")
    assert float(plan.message.split()[6]) == pytest.approx(free.bound.duration, rel=0.02)


def test_a_motion_longer_than_max_duration_is_not_verified(backhoe: bp.Robot, tmp_path: Any) -> None:
    plan = bp.plan(backhoe, reach(None), effort="quick")
    taken = plan.trajectory.duration
    for part, kept in ((1.001, True), (0.999, False)):
        certificate = bp.certify(backhoe, reach(part * taken), plan.trajectory)
        assert certificate.verified is kept
        assert kept or certificate.problems == (
            f"the motion takes {taken:.2f} s, max_duration allows {0.999 * taken:g} s",
        )
    longest = round(0.9999 * taken, 6)  # two decimals alone would say the same of both
    (problem,) = bp.certify(backhoe, reach(longest), plan.trajectory).problems
    figures = [float(word) for word in problem.split() if word[0].isdigit()]
    assert figures[0] > figures[1]
    assert figures == pytest.approx([taken, longest], abs=5e-3)
    # the law alone ignores max_duration
    slow = bp.plan(backhoe, reach(1.01 * taken), method="reactive")
    assert slow.trajectory.duration > 1.01 * taken
    assert slow.reason == "outside_limits"
    assert slow.advice == ""
    plan = bp.plan(backhoe, reach(2.0 * taken), effort="quick")
    plan.save(tmp_path / "plan.json")
    again = bp.load_plan(tmp_path / "plan.json")
    assert again.verified
    assert again.certificate.duration == plan.certificate.duration


def test_a_plan_that_takes_a_little_too_long_says_which_max_duration_allows_it(
    backhoe: bp.Robot,
) -> None:
    """The advice is rounded up, so that the motion keeps to it when it is followed literally."""
    free = bp.plan(backhoe, reach(None), effort="quick")
    taken = free.trajectory.duration
    short = replace(free, certificate=bp.certify(backhoe, reach(0.999 * taken), free.trajectory))
    words = "allows this motion; --effort normal or another --seed may find a faster one"
    given, rest = short.advice.removeprefix("max_duration: ").split(" ", 1)
    assert rest == words
    assert taken <= float(given) < taken + 0.01 + 1e-9
    assert bp.certify(backhoe, reach(float(given)), free.trajectory).verified
    assert replace(short, effort="thorough").advice.endswith("this motion; another --seed may find a faster one")
    touching = replace(short.certificate, problems=("the motion takes too long", "the bucket touches the pole"))
    assert replace(short, certificate=touching).advice == ""
    assert replace(short, failure="blocked").advice == ""


def test_each_leg_has_its_own_max_duration(backhoe: bp.Robot) -> None:
    legs: list[dict[str, Any]] = [
        {"name": "out", "goal": {"joints": START | {"swing": 0.8}}, "max_duration": 4.0, "objective": "work"},
        {"name": "back", "goal": {"joints": START}, "objective": "work"},
    ]
    plan = bp.plan(backhoe, scene({"sequence": legs}), effort="quick")
    assert plan.verified, plan.message
    first, second = plan.legs
    assert first.metrics.duration <= 4.0 * (1.0 + 1e-6)
    assert first.certificate.duration is not None
    assert second.certificate.duration is None
    assert plan.certificate.duration is not None
    assert plan.certificate.duration.ratio == first.certificate.duration.ratio
    legs[0]["max_duration"] = 0.2
    plan = bp.plan(backhoe, scene({"sequence": legs}), effort="quick")
    assert plan.reason == "outside_limits"
    assert "leg 'out': no motion can take less than" in plan.message


PATH = {"waypoints": [{"position": [4.0, 0.0, 0.5]}, {"position": [4.5, 0.0, 0.5]}]}


@pytest.mark.parametrize(
    ("task", "said"),
    [
        ({"path": PATH, "max_duration": 5.0}, "task: max_duration needs a goal"),
        ({"sequence": [{"name": "a", "wait": 1.0, "max_duration": 5.0}]}, "max_duration needs a goal"),
        ({"sequence": [{"name": "a", "wait": 1.0}], "max_duration": 5.0}, "max_duration is given beside a sequence"),
        ({"goal": {"position": [4.0, 0.0, 0.5]}, "max_duration": 0.0}, "task.max_duration"),
    ],
)
def test_a_max_duration_without_a_meaning_is_refused(task: dict[str, Any], said: str) -> None:
    with pytest.raises(bp.SceneError) as caught:
        scene(task)
    assert said in str(caught.value)


def test_far_more_time_than_needed_costs_no_more_search(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, reach(10_000.0, objective="work"), effort="quick")
    assert plan.verified, plan.message
    assert plan.trajectory.duration < 100.0
