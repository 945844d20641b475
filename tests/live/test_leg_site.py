"""Obstacles of some legs only, beside others of the same name, and in one cycle after the other."""

from __future__ import annotations

import pytest
from executors import Never

import backhoe_planner as bp
from backhoe_planner.live import PlanFollower, Servo
from backhoe_planner.machine import Robot

DT = 0.05  # s
POSTURE = {"boom": 0.4, "stick": -1.6, "bucket": -0.9}
BESIDE = {"shape": "sphere", "radius": 0.2, "position": [0.0, 4.0, 0.5]}
FAR = {"shape": "sphere", "radius": 0.1, "position": [-9.0, 0.0, 0.0]}


@pytest.fixture(scope="module")
def there_and_back(backhoe: Robot) -> bp.Plan:
    """Three legs; `first` is present in the first one only, `last` in the last one only."""
    legs = [
        {"name": name, "goal": {"joints": POSTURE | {"swing": swing}}}
        for name, swing in (("there", 0.3), ("on", 0.4), ("back", 0.0))
    ]
    obstacles = [{"name": "first", "legs": ["there"], **BESIDE}, {"name": "last", "legs": ["back"], **BESIDE}]
    content = {"version": 1, "start": {"joints": POSTURE | {"swing": 0.0}}, "task": {"sequence": legs}}
    found = bp.plan(backhoe, bp.scene_from_dict(content | {"obstacles": obstacles}), effort="quick")
    assert found.verified, found.message
    return found


def in_legs(servo: Servo, plan: bp.Plan) -> list[set[str]]:
    """The names that are there in each leg of a plan that is followed to its end."""
    names: list[set[str]] = [set() for _ in plan.legs]
    with PlanFollower(servo, plan, executor=Never()) as follower:
        for _ in range(int((plan.trajectory.duration + 3.0) / DT)):
            state = follower.step()
            if state.done:
                return names
            leg = sum(leg.begins <= state.plan_time - DT for leg in plan.legs) - 1
            names[max(leg, 0)] |= set(servo.obstacles)
    raise AssertionError(state)


def test_a_plan_followed_twice_has_its_obstacles_both_times(backhoe: Robot, there_and_back: bp.Plan) -> None:
    servo = Servo(backhoe, there_and_back.scene, DT)
    once = in_legs(servo, there_and_back)
    assert ["first" in names for names in once] == [True, False, False]
    assert ["last" in names for names in once] == [False, False, True]
    assert in_legs(servo, there_and_back) == once


def test_one_that_was_removed_by_hand_stays_away(backhoe: Robot, there_and_back: bp.Plan) -> None:
    servo = Servo(backhoe, there_and_back.scene, DT)
    servo.remove("last")
    assert not any("last" in names for names in in_legs(servo, there_and_back))


@pytest.mark.parametrize("later", [{}, {"appears_at": 1000.0}])
def test_another_obstacle_of_the_same_name_stays_and_the_plans_own_comes_back(
    backhoe: Robot, there_and_back: bp.Plan, later: dict[str, float]
) -> None:
    """The plan's own comes back beside one that is there, and beside one that is still to appear."""
    servo = Servo(backhoe, there_and_back.scene, DT)
    with PlanFollower(servo, there_and_back, executor=Never()) as follower:
        assert "last" not in servo.obstacles
        servo.add({"name": "last", **FAR, **later})
        while not follower.step().done:
            assert servo.time < there_and_back.trajectory.duration + 3.0
    radii = sorted(one.spec.radius for one in servo.snapshot() if one.name.startswith("last"))  # type: ignore[union-attr]
    assert radii == ([0.2] if later else [0.1, 0.2])
    servo.remove("last")  # the other one: it is still there, or still to appear
    assert "last (2)" in servo.obstacles


def test_another_obstacle_in_place_of_one_removed_by_hand_is_not_taken_away(
    backhoe: Robot, there_and_back: bp.Plan
) -> None:
    servo = Servo(backhoe, there_and_back.scene, DT)
    servo.remove("first")
    servo.add({"name": "first", **FAR})
    assert all("first" in names for names in in_legs(servo, there_and_back))


def test_an_obstacle_that_appears_later_appears_in_its_own_leg_at_its_own_time(
    backhoe: Robot, there_and_back: bp.Plan
) -> None:
    """One would appear after its leg has ended, one before its leg begins, one 0.5 s after its leg has begun."""
    begins = [leg.begins for leg in there_and_back.legs]
    times = {
        "too late": (begins[1] + 0.3, "there"),
        "before": (0.5 * begins[2], "back"),
        "in": (begins[2] + 0.5, "back"),
    }
    content = there_and_back.scene.model_dump(by_alias=True, exclude_none=True)
    content["obstacles"] = [
        {"name": name, "legs": [leg], "appears_at": time, **FAR} for name, (time, leg) in times.items()
    ]
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    servo = Servo(backhoe, plan.scene, DT)
    seen: dict[str, float] = {}
    with PlanFollower(servo, plan, executor=Never()) as follower:
        for _ in range(int((plan.trajectory.duration + 3.0) / DT)):
            state = follower.step()
            for name in servo.obstacles:
                seen.setdefault(name, state.plan_time)
            if state.done:
                break
    assert state.done
    assert sorted(seen) == ["before", "in"]
    assert seen["before"] == pytest.approx(plan.legs[2].begins, abs=3.0 * DT)
    assert seen["in"] == pytest.approx(times["in"][0], abs=3.0 * DT)
    assert servo.waiting == ()


@pytest.mark.parametrize("pace", [1.0, 0.5])
def test_an_obstacle_that_moves_is_where_it_has_moved_to_when_its_leg_begins(
    backhoe: Robot, there_and_back: bp.Plan, pace: float
) -> None:
    """It comes from x = -9 m at 0.5 m/s, counts in the last leg only, and does not wait for a machine that is late."""
    content = there_and_back.scene.model_dump(by_alias=True, exclude_none=True)
    content["obstacles"] = [{"name": "mover", "legs": ["back"], "velocity": [-0.5, 0.0, 0.0], **FAR}]
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    servo = Servo(backhoe, plan.scene, DT)
    with PlanFollower(servo, plan, executor=Never()) as follower:
        while not (found := [one for one in servo.snapshot() if one.name == "mover"]):
            state = follower.step(pace=pace)
            assert not state.done
    moved = float(found[0].pieces[0].placement.translation[0]) + 9.0
    assert moved == pytest.approx(-0.5 * servo.time, abs=0.5 * 3.0 * DT)
    assert servo.time > 0.9 * plan.legs[2].begins / pace
