"""An obstacle on the rest of a plan: a detour from a place ahead is searched while the machine drives there."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.live import (
    FollowerState,
    FollowerStatus,
    NoRejoining,
    PlanFollower,
    Rejoining,
    RejoiningQuery,
    Servo,
    find_rejoining,
)
from backhoe_planner.live.detours import stop_ahead
from backhoe_planner.live.detours.track_proof import RestProof
from backhoe_planner.machine import Robot
from backhoe_planner.site import Proximity, build_obstacles

DT = 0.02
START = {"swing": -0.6, "boom": 0.3, "stick": -0.9, "bucket": -0.5}
FAR = {"name": "far", "shape": "sphere", "radius": 0.2, "position": [-4.0, 0.0, 3.0]}


class Desk(Executor):
    """Answers each search for a detour when the test says so, and proofs at once, or never."""

    def __init__(self, *, proves: bool = True) -> None:
        self.queries: list[RejoiningQuery] = []
        self.awaited: Future[Any] = Future()
        self.proof: Future[Any] = Future()
        self.proves = proves

    def submit(self, function: Callable[..., Any], /, *args: Any, **keys: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if function is find_rejoining:
            self.queries.append(args[0])
            self.awaited = future
        elif self.proves:
            future.set_result(function(*args, **keys))
        else:
            self.proof = future
        return future


def scene_of(*obstacles: dict[str, Any], task: dict[str, Any] | None = None) -> bp.Scene:
    goal = {"goal": {"joints": {"swing": 0.9, "boom": 0.1, "stick": -0.7, "bucket": -0.6}}}
    return bp.scene_from_dict(
        {"version": 1, "start": {"joints": START}, "task": task or goal, "obstacles": list(obstacles)}
    )


@pytest.fixture(scope="module")
def swing(backhoe: Robot) -> bp.Plan:
    found = bp.plan(backhoe, scene_of(), effort="quick")
    assert found.verified, found.message
    return found


def on_plan(plan: bp.Plan, part: float) -> dict[str, Any]:
    """A crate at the tip's place at a part of the plan's time."""
    q = plan.trajectory.at(part * plan.trajectory.duration)
    place = bp.Kinematics(plan.robot).at(q).tip_position
    return {"name": "crate", "shape": "box", "size": [0.4, 0.4, 0.4], "position": place.tolist()}


def margin(plan: bp.Plan, postures: Any, *obstacles: dict[str, Any]) -> float:
    """The least distance beyond the clearance from obstacles in postures (K, n) [m]."""
    proximity = Proximity(plan.robot, build_obstacles(scene_of(*obstacles), plan.robot), self_collision=False)
    return min(float(np.min(proximity.distances(np.array(q)) - proximity.clearance)) for q in postures)


class Run:
    """A machine that follows a plan, onto which a crate is put once the plan's clock has come to a moment."""

    def __init__(
        self, plan: bp.Plan, crate: dict[str, Any], *, at: float, proves: bool = True, dt: float = DT
    ) -> None:  # fmt: skip
        self.desk, self.plan, self.dt = Desk(proves=proves), plan, dt
        self.servo = Servo(plan.robot, plan.scene, dt, q=plan.trajectory.q[0])
        self.follower = PlanFollower(self.servo, plan, executor=self.desk)
        self.steps: list[FollowerState] = []
        self.go(until=lambda step: step.plan_time >= at * plan.trajectory.duration)
        self.servo.add(crate)
        self.put_at = len(self.steps)

    def go(self, seconds: float = 30.0, *, until: Callable[[FollowerState], bool] | None = None) -> FollowerState:
        for _ in range(round(seconds / self.dt)):
            self.steps.append(self.follower.step())
            if self.steps[-1].done or (until is not None and until(self.steps[-1])):
                break
        return self.steps[-1]

    def rests(self) -> bool:
        return bool((np.abs(self.servo.v) < 1e-4).all())


@pytest.fixture(scope="module")
def first_query(swing: bp.Plan) -> RejoiningQuery:
    """What is asked when the crate of most of these tests turns up; the same in each of them."""
    run = Run(swing, on_plan(swing, 0.7), at=0.2)
    run.go(3.0 * DT)
    (query,) = run.desk.queries
    return query


@pytest.fixture(scope="module")
def detour(first_query: RejoiningQuery) -> Rejoining:
    found = find_rejoining(first_query)
    assert isinstance(found, Rejoining)
    return found


def test_the_detour_begins_on_the_plan_ahead_and_leads_behind_the_crate(
    swing: bp.Plan, first_query: RejoiningQuery, detour: Rejoining
) -> None:
    crate, motion = on_plan(swing, 0.7), swing.trajectory
    taken = [moment for moment in motion.time.tolist() if margin(swing, [motion.at(moment)], crate) < 0.0]
    assert 0.2 * motion.duration < first_query.since < taken[0]
    np.testing.assert_allclose(first_query.q, motion.at(first_query.since), atol=1e-3)
    assert 0.1 <= margin(swing, [first_query.q], crate) < 0.2  # with room, but not much before the crate
    np.testing.assert_allclose(detour.motion.q[0], first_query.q, atol=1e-9)
    assert detour.rejoins_at > taken[-1]
    assert detour.around == "crate"


def test_a_detour_that_is_found_in_time_is_begun_at_once(swing: bp.Plan, detour: Rejoining) -> None:
    """The answer comes after 0.3 s; the machine is at rest in one step only, where the detour begins."""
    crate = on_plan(swing, 0.7)
    run = Run(swing, crate, at=0.2)
    run.go(0.3)
    assert run.steps[-1].status is FollowerStatus.FOLLOWING
    assert run.steps[-1].reason == "crate is on the rest of the plan; a way round is searched for"
    run.desk.awaited.set_result(detour)
    assert "a way round begins at" in run.go(DT).reason
    step = run.go(until=lambda step: step.status is FollowerStatus.GOING_ROUND)
    assert step.plan_time == pytest.approx(run.desk.queries[0].since, abs=1e-9)
    assert max(step.deviation for step in run.steps[:-1]) < 1e-3
    assert run.go().done
    assert len(run.desk.queries) == 1
    assert {step.status.value for step in run.steps} == {"following", "going_round", "arrived"}
    assert sum(not step.state.v.any() for step in run.steps[1:-1]) <= 3
    assert margin(swing, [step.state.q for step in run.steps[::3]], crate) > 0.0
    changes = np.abs(np.diff([step.state.v for step in run.steps], axis=0))
    assert (changes <= run.servo.limits.acceleration * DT * (1.0 + 2e-6)).all()


def test_a_machine_rests_on_the_plan_until_the_detour_is_found(swing: bp.Plan, detour: Rejoining) -> None:
    """For 3 s, longer than its patience; it stands still there, searches nothing else, and goes on with the answer."""
    run = Run(swing, on_plan(swing, 0.7), at=0.2)
    held = run.go(3.0)
    assert held.status is FollowerStatus.WAITING
    assert held.reason == "crate is on the rest of the plan; a way round is searched for"
    assert run.rests()
    np.testing.assert_allclose(run.servo.q, run.desk.queries[0].q, atol=1e-5)
    assert len(run.desk.queries) == 1
    run.desk.awaited.set_result(detour)
    assert run.go(3.0 * DT).status is FollowerStatus.GOING_ROUND
    assert not run.rests()
    assert run.go().done


def test_a_crate_that_is_taken_away_at_once_costs_little(swing: bp.Plan) -> None:
    """Before the machine has to slow down for it: the plan ends as planned."""
    run = Run(swing, on_plan(swing, 0.75), at=0.1)
    run.go(0.3)
    run.servo.remove("crate")
    last = run.go()
    assert last.done
    assert last.behind < 0.05
    assert run.desk.awaited.cancelled()


@pytest.mark.parametrize("after", [0.8, 3.0])
def test_a_crate_that_is_taken_away_later_lets_the_machine_go_on_along_the_plan(swing: bp.Plan, after: float) -> None:
    """It goes on at once, and from rest it needs no more than the plan from its start on; nothing else is searched."""
    run = Run(swing, on_plan(swing, 0.7), at=0.2)
    left = swing.trajectory.duration - run.go(after).plan_time
    run.servo.remove("crate")
    before = len(run.steps)
    run.go(5.0 * DT)
    assert run.steps[-1].plan_time > run.steps[before - 1].plan_time
    assert run.go().done
    assert (len(run.steps) - before) * DT < left + 0.6
    assert len(run.desk.queries) == 1
    assert {step.status.value for step in run.steps[before + 50 :]} <= {"following", "arrived"}


def test_without_a_detour_the_machine_goes_as_near_as_the_plan_leads(swing: bp.Plan) -> None:
    """As it did before detours were searched ahead: then it searches more thoroughly, and from there."""
    crate = on_plan(swing, 0.7)
    run = Run(swing, crate, at=0.2)
    run.go(0.5)
    run.desk.awaited.set_result(NoRejoining("there is none", searched=True))
    run.go(until=lambda _: len(run.desk.queries) == 2)
    again = run.desk.queries[1]
    assert again.attempt == 1
    assert not again.beyond
    assert run.rests()
    assert 0.0 <= margin(swing, [run.servo.q], crate) < 0.02
    for _ in range(3):
        run.desk.awaited.set_result(NoRejoining("there is none", searched=True))
        step = run.go(0.1)
    assert step.status is FollowerStatus.BLOCKED
    assert step.reason == "there is none"
    run.servo.remove("crate")
    assert run.go().done


def test_a_crate_at_the_end_of_the_plan_is_told_from_as_near_as_the_plan_leads(swing: bp.Plan) -> None:
    """No place is behind it: the machine drives on, and searches only where it stands; then the crate is taken away."""
    crate = on_plan(swing, 1.0)
    run = Run(swing, crate, at=0.3)
    run.go(until=lambda _: bool(run.desk.queries))
    found = find_rejoining(run.desk.queries[0])
    assert isinstance(found, NoRejoining)
    run.desk.awaited.set_result(found)
    step = run.go(0.05)
    assert step.status is FollowerStatus.BLOCKED
    assert step.reason == "crate blocks the end of the plan; a new plan may end in another posture"
    assert len(run.desk.queries) == 1
    assert 0.0 <= margin(swing, [run.servo.q], crate) < 0.02
    run.servo.remove("crate")
    gone = len(run.steps)
    assert run.go().done
    assert {step.status.value for step in run.steps[gone + 40 :]} <= {"following", "arrived"}


def test_without_room_ahead_the_machine_stops_and_searches_from_where_it_rests(
    swing: bp.Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No place is given the room for a detour to begin: the sooner the machine rests, the more there is."""
    monkeypatch.setattr(stop_ahead, "_ROOMS", (100.0,))
    crate = on_plan(swing, 0.7)
    run = Run(swing, crate, at=0.2)
    step = run.go(until=lambda _: bool(run.desk.queries))
    speeds = [float(np.linalg.norm(step.state.v)) for step in run.steps[run.put_at + 1 :]]
    assert all(after < before for before, after in pairwise(speeds))
    assert run.rests()
    assert "a way round is searched for" in step.reason
    (query,) = run.desk.queries
    assert query.beyond
    np.testing.assert_array_equal(query.q, run.servo.q)
    assert margin(swing, [run.servo.q], crate) > 0.1


def test_another_obstacle_before_the_place_changes_it(swing: bp.Plan) -> None:
    """The new one is nearer: the first search is given up, and a detour from a place before it is searched."""
    run = Run(swing, on_plan(swing, 0.75), at=0.05)
    run.go(0.2)
    (first,) = run.desk.queries
    nearer = on_plan(swing, 0.55) | {"name": "nearer"}
    run.servo.add(nearer)
    run.go(0.8)
    second = run.desk.queries[-1]
    assert second is not first
    assert second.since < first.since
    assert {one.name for one in second.obstacles} == {"crate", "nearer"}
    run.go(2.0)
    assert margin(swing, [step.state.q for step in run.steps[::3]], nearer) >= 0.0


def test_an_obstacle_elsewhere_changes_nothing(swing: bp.Plan, detour: Rejoining) -> None:
    run = Run(swing, on_plan(swing, 0.7), at=0.2)
    run.go(0.3)
    run.servo.add(FAR)
    run.go(1.0)
    assert not run.desk.awaited.cancelled()
    run.desk.awaited.set_result(detour)
    assert run.go().done
    assert len(run.desk.queries) == 1


def test_a_crate_that_begins_to_move_is_waited_for_as_before(swing: bp.Plan) -> None:
    """It sinks into the ground, off the plan: the machine goes on, without the detour."""
    crate = on_plan(swing, 0.7)
    run = Run(swing, crate, at=0.2)
    run.go(0.3)
    run.servo.set_velocity("crate", [0.0, 0.0, -1.0])
    run.go(DT)
    assert run.desk.awaited.cancelled()
    assert run.go().done
    assert len(run.desk.queries) == 1


def test_a_crate_that_is_moved_all_the_time_does_not_begin_searches_without_end(swing: bp.Plan) -> None:
    """Tracked at 10 Hz along the plan, for 3 s: at most one search in half a second."""
    run = Run(swing, on_plan(swing, 0.7), at=0.2)
    for turn in range(30):
        run.go(0.1)
        run.servo.move("crate", [0.0, 0.15 * (-1) ** turn, 0.0])
    assert 1 <= len(run.desk.queries) <= 7


def test_a_crate_on_a_later_leg_is_gone_round_on_that_leg(backhoe: Robot) -> None:
    """A detour may rejoin the plan on its own leg only: it is searched once that leg has begun, and begins there."""
    legs = [
        {"name": "up", "goal": {"joints": START | {"boom": 0.5}}},
        {"name": "swing", "goal": {"joints": {"swing": 0.9, "boom": 0.1, "stick": -0.7, "bucket": -0.6}}},
    ]
    plan = bp.plan(backhoe, scene_of(task={"sequence": legs}), effort="quick")
    assert plan.verified, plan.message
    begins = plan.legs[1].begins
    run = Run(plan, on_plan(plan, 0.75), at=0.5 * begins / plan.trajectory.duration)
    run.go(until=lambda _: bool(run.desk.queries))
    assert run.steps[-1].plan_time == pytest.approx(begins, abs=0.3)
    assert run.steps[-1].behind < 0.3
    assert run.desk.queries[0].since > begins


def test_a_crate_that_is_taken_away_while_the_machine_stops_for_it_is_not_waited_for(
    swing: bp.Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes to rest beyond its place on the plan, and goes back there while the search is never answered."""
    monkeypatch.setattr(stop_ahead, "_ROOMS", (100.0,))
    run = Run(swing, on_plan(swing, 0.7), at=0.2)
    assert run.go(0.3).deviation > 0.03
    run.servo.remove("crate")
    assert run.go(2.0 + swing.trajectory.duration).done


def test_a_crate_that_is_taken_away_as_the_machine_begins_to_hold_is_not_waited_for(swing: bp.Plan) -> None:
    """Held back by a crate, it is as far off the plan as the clock allows, 0.03 rad, to 1e-5 rad less or more."""
    run = Run(swing, on_plan(swing, 0.85), at=0.3)
    held = run.go(until=lambda step: step.reason.endswith("searched for"))
    assert held.deviation == pytest.approx(0.03, abs=1e-3)
    run.servo.remove("crate")
    assert not run.desk.queries
    assert run.go(3.0).done


def test_a_follower_that_is_closed_goes_as_near_as_the_plan_leads(swing: bp.Plan) -> None:
    """It finds no detours any more, and does not wait for one: it drives on to the crate and says so."""
    crate = on_plan(swing, 0.7)
    run = Run(swing, crate, at=0.2)
    run.go(0.3)
    (query,) = run.desk.queries
    run.follower.close()
    step = run.go(8.0)
    assert step.plan_time > query.since + 0.05
    assert step.status is FollowerStatus.BLOCKED
    assert "closed" in step.reason
    assert 0.0 <= margin(swing, [run.servo.q], crate) < 0.02


def test_a_search_begins_as_soon_as_the_machine_stands_before_an_obstacle(swing: bp.Plan) -> None:
    """Beside an obstacle it creeps away from it ever slower, for 2 s above 1e-6 rad/s; that is not waited for."""
    run = Run(swing, on_plan(swing, 0.7), at=0.2, proves=False, dt=0.01)
    run.go(until=lambda step: step.reason.endswith("searched for"))
    held = len(run.steps)
    run.go(until=lambda _: bool(run.desk.queries))
    assert (len(run.steps) - held) * run.dt < 0.2
    (query,) = run.desk.queries
    run.go(4.0)
    assert float(np.abs(run.servo.q - query.q).max()) < 1e-4


def test_a_crate_that_is_taken_away_before_the_search_begins_is_not_waited_for(swing: bp.Plan) -> None:
    """Neither proofs nor the search, which is for what is there without the crate, are ever answered."""
    run = Run(swing, on_plan(swing, 0.7), at=0.2, proves=False)
    run.go(until=lambda step: step.reason.endswith("searched for"))
    assert not run.desk.queries
    run.servo.add(FAR)
    run.servo.remove("crate")
    assert run.go(swing.trajectory.duration - run.steps[-1].plan_time + 2.0).done


def test_a_plan_is_free_at_once_when_all_that_was_new_is_gone(swing: bp.Plan) -> None:
    """The machine rests where a detour would begin, and goes on although a proof under way is never answered."""
    run = Run(swing, on_plan(swing, 0.7), at=0.2)
    run.go(3.0)
    assert run.rests()
    run.desk.proves = False
    run.servo.add(FAR)
    run.go(0.3)
    run.servo.remove("crate")
    run.servo.remove("far")
    assert run.go(swing.trajectory.duration - run.steps[-1].plan_time + 1.0).done


def test_a_blocked_machine_tries_its_plan_when_a_late_proof_says_that_it_is_free(swing: bp.Plan) -> None:
    """Not after the break between two searches, which all failed; how the proof came about does not matter here."""
    run = Run(swing, on_plan(swing, 0.7), at=0.2, proves=False)
    run.go(until=lambda _: bool(run.desk.queries))
    run.desk.awaited.set_result(NoRejoining("there is none", searched=False))
    assert run.go(0.5).status is FollowerStatus.BLOCKED
    here = run.servo.q
    run.desk.proof.set_result(RestProof(None))
    assert run.go(2.0 * DT).status is not FollowerStatus.BLOCKED
    assert float(np.abs(run.servo.q - here).max()) > 1e-6


class Returning(Run):
    """A machine that begins a detour around a high crate, which is taken away after 0.2 s on it."""

    def __init__(self, plan: bp.Plan, around: Rejoining, *, searches: bool = True) -> None:
        super().__init__(plan, high(plan), at=0.2)
        self.go(0.1)
        self.desk.awaited.set_result(around)
        self.go(until=lambda step: step.status is FollowerStatus.GOING_ROUND)
        self.began = len(self.steps)
        self.go(0.2)
        if not searches:
            self.follower.close()
        self.servo.remove("crate")
        self.go(5.0 * DT)

    def arrives_after(self) -> float:
        """After what time on the detour the machine is at the end of the plan [s]."""
        assert self.go().done
        return (len(self.steps) - self.began) * DT


def high(plan: bp.Plan) -> dict[str, Any]:
    return on_plan(plan, 0.7) | {"size": [0.4, 0.4, 1.6]}


@pytest.fixture(scope="module")
def around(swing: bp.Plan) -> Rejoining:
    """The detour around the high crate."""
    run = Run(swing, high(swing), at=0.2)
    run.go(0.1)
    found = find_rejoining(run.desk.queries[0])
    assert isinstance(found, Rejoining)
    return found


@pytest.fixture(scope="module")
def without_return(swing: bp.Plan, around: Rejoining) -> float:
    """The time from where the detour begins to the end of the plan, if no way back is searched [s]."""
    run = Returning(swing, around, searches=False)
    took = run.arrives_after()
    assert len(run.desk.queries) == 1
    return took


@pytest.fixture(scope="module")
def back(swing: bp.Plan, around: Rejoining) -> Rejoining:
    """The way back to the plan once the crate is gone."""
    found = find_rejoining(Returning(swing, around).desk.queries[1])
    assert isinstance(found, Rejoining)
    return found


def test_the_way_back_from_a_detour_is_searched_from_a_place_ahead_on_it(swing: bp.Plan, around: Rejoining) -> None:
    run = Returning(swing, around)
    assert run.steps[-1].status is FollowerStatus.GOING_ROUND
    _, query = run.desk.queries
    assert not query.obstacles
    ahead = np.arange(0.2, around.motion.duration, 1e-3)
    assert min(float(np.abs(around.motion.at(time) - query.q).max()) for time in ahead.tolist()) < 2e-3
    assert run.steps[-1].plan_time <= query.since <= around.rejoins_at


def test_a_machine_leaves_its_detour_for_a_sooner_way_back(
    swing: bp.Plan, around: Rejoining, back: Rejoining, without_return: float
) -> None:
    """It is on the plan again later than its joints could go straight there, and sooner than by the detour."""
    run = Returning(swing, around)
    gone, here = len(run.steps), run.servo.q
    run.desk.awaited.set_result(back)
    assert back.around is None
    assert back.rejoins_at <= around.rejoins_at
    run.go(until=lambda step: step.reason == "back to the plan")
    np.testing.assert_allclose(run.servo.q, back.motion.q[0], atol=2e-3)
    run.go(until=lambda step: step.status is FollowerStatus.FOLLOWING)
    straight = np.abs(swing.trajectory.at(back.rejoins_at) - here) / run.servo.limits.velocity
    assert (len(run.steps) - gone) * DT > float(straight.max())
    assert run.arrives_after() < without_return - 0.2
    changes = np.abs(np.diff([step.state.v for step in run.steps], axis=0))
    assert (changes <= run.servo.limits.acceleration * DT * (1.0 + 2e-6)).all()
    assert len(run.desk.queries) == 2


@pytest.mark.parametrize("answer", ["none", "slow", "error", "late"])
def test_without_a_sooner_way_back_nothing_is_lost(
    swing: bp.Plan, around: Rejoining, back: Rejoining, without_return: float, answer: str
) -> None:
    """The detour is followed to its end as if no way back had been searched, and the machine never waits."""
    run = Returning(swing, around)
    if answer == "late":
        run.go(1.0)
        assert run.desk.awaited.cancelled()
    elif answer == "error":
        run.desk.awaited.set_exception(MemoryError("no room"))
    elif answer == "none":
        run.desk.awaited.set_result(NoRejoining("there is none", searched=True))
    else:
        slow = bp.Trajectory.from_steps(5.0 * back.motion.time, back.motion.q)
        run.desk.awaited.set_result(Rejoining(slow, back.rejoins_at, None))
    assert run.arrives_after() == pytest.approx(without_return, abs=1.5 * DT)
    assert {step.status.value for step in run.steps} == {"following", "going_round", "arrived"}
    assert len(run.desk.queries) == 2


def test_a_crate_that_comes_back_ends_the_search_for_a_way_back(
    swing: bp.Plan, around: Rejoining, without_return: float
) -> None:
    """The detour still leads around it, beside which the machine is a little slower."""
    run = Returning(swing, around)
    run.servo.add(high(swing))
    run.go(2.0 * DT)
    assert run.desk.awaited.cancelled()
    assert run.arrives_after() < without_return + 0.5
    assert margin(swing, [step.state.q for step in run.steps[run.began :: 3]], high(swing)) > 0.0


def test_a_crate_that_comes_back_ends_the_way_back(
    swing: bp.Plan, around: Rejoining, back: Rejoining, without_return: float
) -> None:
    """The machine already slows down for the way back: it goes on along its detour."""
    run = Returning(swing, around)
    run.desk.awaited.set_result(back)
    speed = float(np.abs(run.servo.v).max())
    run.go(until=lambda step: float(np.abs(step.state.v).max()) < 0.7 * speed)
    assert run.steps[-1].reason == "round crate"
    run.servo.add(high(swing))
    assert run.arrives_after() < without_return + 1.0
    assert margin(swing, [step.state.q for step in run.steps[run.began :: 3]], high(swing)) > 0.0
    assert {step.status.value for step in run.steps} == {"following", "going_round", "arrived"}
