"""Following a plan live: on time on a free path; waiting, resuming or making a detour at an obstacle."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.live import (
    FollowerState,
    FollowerStatus,
    NoRejoining,
    PlanFollower,
    Reference,
    Rejoining,
    RejoiningQuery,
    Servo,
    find_rejoining,
    is_still_clear,
)
from backhoe_planner.live.detours import rejoining, searches
from backhoe_planner.machine import Robot
from backhoe_planner.planning import EFFORTS
from backhoe_planner.proof import certify_problem
from backhoe_planner.site import Proximity, build_obstacles

START = [-0.3, 0.3, -0.9, -0.5]
END = [0.5, 0.1, -0.7, -0.6]
DT = 0.01
# upright and radial at a swing of 0.1 rad, from 1 m to 9 m, higher and deeper than the machine reaches
WALL = {
    "name": "wall", "shape": "box", "size": [8.0, 0.2, 16.0], "rpy": [0.0, 0.0, 0.1],
    "position": [5.0 * np.cos(0.1), 5.0 * np.sin(0.1), 0.0],
}  # fmt: skip


class Immediate(Executor):
    """Runs each call at once."""

    def __init__(self) -> None:
        self.answers: list[Any] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.answers.append(fn(*args, **kwargs))
        future.set_result(self.answers[-1])
        return future


class Never(Executor):
    """Never answers."""

    def __init__(self) -> None:
        self.futures: list[Future[Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.futures.append(Future())
        return self.futures[-1]


class Failing(Executor):
    """Raises, or has its calls raise."""

    def __init__(self, *, at_once: bool) -> None:
        self._at_once = at_once

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if self._at_once:
            raise RuntimeError("cannot schedule new futures after shutdown")
        future: Future[Any] = Future()
        future.set_exception(MemoryError("no room"))
        return future


def site(robot: Robot, *obstacles: dict[str, Any]) -> bp.Scene:
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(robot.joint_names, START, strict=True))},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "obstacles": list(obstacles),
        }
    )


def smooth_motion(duration: float = 6.0) -> bp.Trajectory:
    """A straight line from START to END with rates of 0 at both ends."""
    time = np.linspace(0.0, duration, 301)
    part = 0.5 * (1.0 - np.cos(np.pi * time / duration))
    return bp.Trajectory.from_steps(time, np.array(START) + part[:, None] * (np.array(END) - START))


def tip(robot: Robot, q: Any) -> list[float]:
    return [float(x) for x in bp.Kinematics(robot).at(np.array(q)).tip_position]


def followed(
    follower: PlanFollower, most: int, *, until: Callable[[FollowerState], bool] | None = None
) -> list[FollowerState]:
    found = []
    for _ in range(most):
        found.append(follower.step())
        if found[-1].done or (until is not None and until(found[-1])):
            break
    return found


def least_margin(robot: Robot, steps: list[FollowerState], *obstacles: dict[str, Any]) -> float:
    return least_margin_of(robot, [step.state.q for step in steps[::5]], *obstacles)


def least_margin_of(robot: Robot, postures: Any, *obstacles: dict[str, Any]) -> float:
    proximity = Proximity(robot, build_obstacles(site(robot, *obstacles), robot))
    return min(float(np.min(proximity.distances(np.array(q)) - proximity.clearance)) for q in postures)


def placed(robot: Robot, what: str, moment: float = 3.2) -> dict[str, Any]:
    """A ball, box or post at the tip's position at a moment of the motion."""
    place = tip(robot, smooth_motion().at(moment))
    if what == "ball":
        return {"name": what, "shape": "sphere", "radius": 0.3, "position": place}
    if what == "box":
        return {"name": what, "shape": "box", "size": [0.5, 0.3, 0.6], "position": place, "rpy": [0.3, 0.2, 0.5]}
    place[2] -= 1.0
    return {"name": what, "shape": "cylinder", "radius": 0.08, "length": 3.0, "position": place}


# --- following -------------------------------------------------------------------------


def test_an_unobstructed_follower_arrives_on_time(backhoe: Robot) -> None:
    steps = followed(PlanFollower(Servo(backhoe, site(backhoe), DT), smooth_motion(), executor=Never()), 3600)
    assert steps[-1].done
    assert max(step.deviation for step in steps) < 1e-3
    assert steps[-1].behind < 1.5 * DT
    np.testing.assert_allclose(steps[-1].state.q, END, atol=1e-3)
    assert {step.status for step in steps[:-1]} == {FollowerStatus.FOLLOWING}
    assert steps[-1].status is FollowerStatus.ARRIVED
    assert {step.reason for step in steps} == {""}


def test_a_machine_away_from_the_start_goes_there_first(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe), DT, q=[-0.1, 0.4, -1.0, -0.3])
    steps = followed(PlanFollower(servo, smooth_motion(), executor=Never()), 2400)
    assert steps[50].plan_time < 0.1
    assert steps[-1].done


def test_a_clock_waits_for_a_machine_behind_or_beside_its_motion_and_not_for_one_that_runs_on_ahead(
    backhoe: Robot,
) -> None:
    """The motion turns the swing alone."""
    time = np.linspace(0.0, 4.0, 201)
    q = np.outer(time**2 * (6.0 - time) / 32.0, [1.0, 0.0, 0.0, 0.0])
    reference = Reference(bp.Trajectory.from_steps(time, q), backhoe.limits)
    reference.clock = 2.0
    ahead, running, still = np.array([0.1, 0.05, 0.0, 0.0]), np.array([0.3, 0.0, 0.0, 0.0]), np.zeros(4)
    assert reference.lag(reference.q + ahead, running, DT) == 0.0
    assert reference.lag(reference.q + ahead, still, DT) == pytest.approx(0.05)
    assert reference.lag(reference.q - ahead, running, DT) == pytest.approx(0.1)


def test_the_machine_waits_during_the_search_and_resumes_once_the_plan_is_free(backhoe: Robot) -> None:
    """The search never ends: the machine waits clear of the ball and gives the reason; without the ball it finishes."""
    ball, never = placed(backhoe, "ball"), Never()
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, smooth_motion(), executor=never)
    followed(follower, 120)
    servo.add(ball)
    held = followed(follower, 600)
    assert held[-1].status is FollowerStatus.WAITING
    assert held[-1].reason.endswith("; a way round is searched for")
    assert "ball" in held[-1].reason
    assert held[-1].behind > 1.0
    assert not held[-1].state.v.any()
    assert -1e-6 <= least_margin(backhoe, held, ball) < 0.05
    assert len(never.futures) == 1
    servo.remove("ball")
    resumed = followed(follower, 2400)
    assert resumed[0].state.v.any()  # at once, although the search has not answered
    assert never.futures[0].cancelled()
    assert resumed[-1].done
    np.testing.assert_allclose(resumed[-1].state.q, END, atol=1e-3)


# --- without obstacles --------------------------------------------------------------

POSTURES = {
    "planar4": ([0.3, 0.5, -0.4, 0.2], [0.9, 0.1, 0.3, -0.4]),
    "backhoe": (START, END),
    "panda": ([0.0, -0.4, 0.0, -2.0, 0.0, 1.8, 0.8], [0.6, 0.1, 0.3, -1.6, 0.2, 2.1, 0.3]),
}


@pytest.mark.parametrize("machine", POSTURES)
@pytest.mark.parametrize("dt", [pytest.param(0.001, marks=pytest.mark.long), 0.004])
def test_an_unobstructed_plan_takes_its_planned_duration(
    request: pytest.FixtureRequest, machine: str, dt: float
) -> None:
    """Within one step, which may be needed to come to rest."""
    robot: Robot = request.getfixturevalue(machine)
    start, end = POSTURES[machine]
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(robot.joint_names, start, strict=True))},
            "task": {"goal": {"position": tip(robot, end)}},
        }
    )
    plan = bp.plan(robot, scene, effort="quick")
    assert plan.verified
    follower = PlanFollower(Servo(robot, scene, dt), plan, executor=Never())
    steps = followed(follower, int(plan.trajectory.duration / dt) + 1000)
    assert steps[-1].done
    assert len(steps) <= int(np.ceil(plan.trajectory.duration / dt)) + 1
    assert max(step.deviation for step in steps) < 1e-3
    assert {step.status for step in steps[:-1]} == {FollowerStatus.FOLLOWING}


def test_the_reference_keeps_the_acceleration_limit_and_stays_close_to_the_samples(backhoe: Robot) -> None:
    """0.4 s of acceleration, then 0.4 s of braking at 1 rad/s^2, samples 0.02 s apart, 0.16 rad in all.

    At constant acceleration the parabola deviates from the chord between two samples by 1 * 0.02^2 / 8.
    """
    time = np.linspace(0.0, 0.8, 41)
    way = np.where(time <= 0.4, 0.5 * time**2, 0.16 - 0.5 * (0.8 - time) ** 2)
    motion = bp.Trajectory.from_steps(time, np.array(START) + way[:, None] * [1.0, 0.0, 0.0, 0.0])
    reference = Reference(motion, replace(backhoe.limits, acceleration=np.ones(4)))
    places = []
    for _ in range(801):
        places.append(reference.q)
        reference.advance(0.001)
    assert reference.ended
    np.testing.assert_array_equal(places[0], motion.q[0])
    np.testing.assert_array_equal(reference.q, motion.q[-1])
    np.testing.assert_allclose(places, motion.at(np.linspace(0.0, 0.8, 801)), atol=2.0 * 0.02**2 / 8.0)
    rates = np.diff(places, axis=0) / 0.001
    assert np.abs(np.diff(rates, axis=0)).max() <= 0.001 * 1.0 + 1e-9
    assert np.abs(rates[[0, -1]]).max() < 1e-3


def test_the_reference_follows_straight_lines_between_distant_samples(backhoe: Robot) -> None:
    """A right-angled corner, halfway along each leg and at the corner itself."""
    q = np.array(START) + np.array([[0.0, 0.0, 0.0, 0.0], [0.4, 0.0, 0.0, 0.0], [0.4, 0.4, 0.0, 0.0]])
    reference = Reference(bp.Trajectory.from_steps(np.array([0.0, 2.0, 4.0]), q), backhoe.limits)
    for moment, before, after, part in ((1.0, 0, 1, 0.5), (2.0, 1, 1, 0.0), (3.0, 1, 2, 0.5), (9.0, 2, 2, 0.0)):
        reference.clock = moment
        np.testing.assert_allclose(reference.q, q[before] + part * (q[after] - q[before]), atol=1e-12)


# --- near the end -------------------------------------------------------------------------


@pytest.mark.parametrize("stays", [1.2, *(pytest.param(s, marks=pytest.mark.long) for s in (2.2, 3.2))])
def test_the_plan_is_finished_after_an_obstacle_near_its_end_is_removed(backhoe: Robot, stays: float) -> None:
    """The ball is 2 cm too close to the end: the machine waits just before it until the ball is removed."""
    motion = smooth_motion(1.6)
    before, end = np.array(tip(backhoe, motion.at(1.2))), np.array(tip(backhoe, END))
    way = (end - before) / np.linalg.norm(end - before)
    ball = {"name": "ball", "shape": "sphere", "radius": 0.3}
    reach = np.linspace(1.0, 0.0, 500)
    balls = [ball | {"position": (end + far * way).tolist()} for far in reach]
    ball = next(one for one in balls if least_margin_of(backhoe, [END], one) < -0.02)
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, motion, executor=Immediate())
    followed(follower, 80)
    servo.add(ball)
    held = followed(follower, round((0.8 + stays) / DT))
    assert not held[-1].done
    assert 0.001 < float(np.abs(servo.q - END).max()) < 0.1
    servo.remove("ball")
    steps = followed(follower, round(2.0 / DT))
    assert steps[-1].done


def test_the_end_of_the_plan_can_be_rejoined_from_very_near(backhoe: Robot) -> None:
    q = np.array(END) - [0.02, 0.0, 0.0, 0.0]
    asked = replace(query(backhoe, since=6.0), q=q)
    found = find_rejoining(asked)
    assert isinstance(found, Rejoining)
    assert found.rejoins_at == 6.0
    np.testing.assert_allclose(found.motion.q[0], q, atol=1e-9)
    np.testing.assert_allclose(found.motion.q[-1], END, atol=1e-9)


def test_a_constantly_moved_obstacle_does_not_prevent_the_search(backhoe: Robot) -> None:
    """Tracked at 25 Hz, 1 mm to and fro: a move does not restart the patience."""
    never = Never()
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, smooth_motion(), executor=never)
    followed(follower, 120)
    servo.add(placed(backhoe, "ball"))
    for turn in range(150):
        followed(follower, 4)
        servo.move("ball", [0.0, 0.0, 0.001 * (-1) ** turn])
    assert never.futures != []


# --- detours -------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["ball", *(pytest.param(what, marks=pytest.mark.long) for what in ("box", "post"))])
def test_an_obstacle_that_stays_on_the_plan_is_avoided_by_a_detour(backhoe: Robot, what: str) -> None:
    """The follower leaves the plan, rejoins it beyond the obstacle and finishes it unchanged, without contact."""
    obstacle, motion, executor = placed(backhoe, what), smooth_motion(), Immediate()
    assert least_margin_of(backhoe, motion.q, obstacle) < -0.1
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, motion, executor=executor)
    followed(follower, 120)
    servo.add(obstacle)
    steps = followed(follower, 4800)
    assert steps[-1].done
    np.testing.assert_allclose(steps[-1].state.q, END, atol=1e-3)
    assert least_margin(backhoe, steps, obstacle) >= -1e-6
    went = [step for step in steps if step.status is FollowerStatus.GOING_ROUND]
    assert max(step.deviation for step in went) > 0.1
    assert {step.reason for step in went} == {f"round {what}"}
    last = max(row for row, step in enumerate(steps) if step.status is FollowerStatus.GOING_ROUND)
    assert steps[last + 1].plan_time > steps[last].plan_time + 0.1
    assert max(step.deviation for step in steps[last + 1 :]) < 0.1  # the rest of the plan is unchanged
    (left,) = steps[-1].left_out
    assert (left.begins, left.ends) == pytest.approx((steps[last].plan_time, steps[last + 1].plan_time), abs=2 * DT)
    tips = [
        bp.Kinematics(backhoe).at(motion.at(time)).tip_position for time in np.linspace(left.begins, left.ends, 400)
    ]
    way = float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())
    assert left.length == pytest.approx(way, rel=1e-2)
    for figure in (f"{way:.2f} m", f"{left.ends - left.begins:.1f} s of the plan were left out"):
        assert figure in steps[-1].reason
    changes = np.diff([step.state.v for step in steps], axis=0)
    assert (np.abs(changes) <= servo.limits.acceleration * DT * (1.0 + 1e-9)).all()


@pytest.mark.long
def test_a_detour_that_becomes_blocked_is_replaced_by_another(backhoe: Robot) -> None:
    ball, executor = placed(backhoe, "ball"), Immediate()
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, smooth_motion(), executor=executor)
    followed(follower, 120)
    servo.add(ball)
    steps = followed(follower, 4800, until=lambda step: step.status is FollowerStatus.GOING_ROUND)
    (way,) = executor.answers
    place = tip(backhoe, way.motion.at(0.6 * way.motion.duration))
    second = {"name": "second", "shape": "sphere", "radius": 0.15, "position": place}
    assert least_margin(backhoe, steps[-1:], second) > 0.0
    servo.add(second)
    steps = followed(follower, 8000)
    assert executor.answers[1] is False
    assert steps[-1].done
    assert sum(isinstance(answer, Rejoining) for answer in executor.answers) >= 2
    assert least_margin(backhoe, steps, ball, second) >= -1e-6


@pytest.mark.long
def test_a_distant_new_obstacle_does_not_change_the_detour(backhoe: Robot) -> None:
    executor = Immediate()
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, smooth_motion(), executor=executor)
    followed(follower, 120)
    servo.add(placed(backhoe, "ball"))
    followed(follower, 4800, until=lambda step: step.status is FollowerStatus.GOING_ROUND)
    servo.add({"name": "far", "shape": "sphere", "radius": 0.2, "position": [-4.0, 0.0, 3.0]})
    steps = followed(follower, 4800)
    assert executor.answers[1:] == [True]
    assert steps[-1].done


def test_the_search_thread_starts_when_needed_and_ends_with_the_follower(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe), DT)
    with PlanFollower(servo, smooth_motion()) as follower:
        followed(follower, 120)
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("rejoining")]
        servo.add(placed(backhoe, "ball"))
        steps = followed(follower, 120000)
    assert steps[-1].done
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("rejoining")]


# --- no detour ------------------------------------------------------------------------------


@pytest.mark.long
def test_an_obstacle_on_the_end_blocks_the_plan_until_it_is_removed(backhoe: Robot) -> None:
    ball, executor = placed(backhoe, "ball", 6.0), Immediate()
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, smooth_motion(), executor=executor)
    followed(follower, 120)
    servo.add(ball)
    steps = followed(follower, 1000)
    assert steps[-1].status is FollowerStatus.BLOCKED
    assert steps[-1].reason == "ball blocks the end of the plan; a new plan may end in another posture"
    assert not steps[-1].done
    assert not np.any([step.state.v for step in steps[-160:]])  # it stands still
    assert 0.0 <= least_margin(backhoe, steps, ball) < 0.02  # as close as allowed
    assert [type(answer) for answer in executor.answers] == [NoRejoining]
    servo.remove("ball")
    steps = followed(follower, 2400)
    assert steps[-1].done


def test_a_wall_without_a_detour_blocks_the_plan_until_it_is_removed(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wall extends beyond the machine's reach and height; searches with rising effort find no detour."""
    executor = Immediate()
    assert least_margin_of(backhoe, [START, END], WALL) > 0.05
    efforts = [replace(EFFORTS["quick"], motions_per_search=count) for count in (100, 200, 400)]
    monkeypatch.setattr(rejoining, "_EFFORTS", efforts)
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, smooth_motion(), executor=executor)
    followed(follower, 80)
    servo.add(WALL)
    steps = followed(follower, 1600, until=lambda step: step.status is FollowerStatus.BLOCKED)
    steps += followed(follower, 40)
    assert steps[-1].status is FollowerStatus.BLOCKED
    assert "wall blocks the plan" in steps[-1].reason
    assert all(isinstance(answer, NoRejoining) and answer.searched for answer in executor.answers)
    assert least_margin(backhoe, steps, WALL) >= -1e-6
    servo.remove("wall")
    assert followed(follower, 1600)[-1].done


@pytest.mark.parametrize("at_once", [pytest.param(True, marks=pytest.mark.long), False])
def test_a_failing_executor_blocks_the_follower_without_an_exception(backhoe: Robot, at_once: bool) -> None:
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, smooth_motion(), executor=Failing(at_once=at_once))
    followed(follower, 120)
    servo.add(placed(backhoe, "ball"))
    step = followed(follower, 600)[-1]
    assert step.status is FollowerStatus.BLOCKED
    assert step.reason.startswith("planning failed: ")
    servo.remove("ball")
    assert followed(follower, 2400)[-1].done


# --- moving obstacles --------------------------------------------------------------------------


def test_a_crossing_obstacle_is_waited_for_without_a_search(backhoe: Robot) -> None:
    """A ball crosses the plan from above and is gone before the patience ends."""
    place = tip(backhoe, smooth_motion().at(3.2))
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [place[0], place[1], place[2] + 1.5]}
    never = Never()
    servo = Servo(backhoe, site(backhoe), DT)
    follower = PlanFollower(servo, smooth_motion(), executor=never)
    servo.add(ball | {"velocity": [0.0, 0.0, -0.4]})
    proximity = Proximity(backhoe, build_obstacles(site(backhoe, ball | {"velocity": [0.0, 0.0, -0.4]}), backhoe))
    steps = followed(follower, 4800)
    assert steps[-1].done
    assert max(step.behind for step in steps) > 0.3
    assert min(float(np.min(proximity.distances(step.state.q, time=step.state.time))) for step in steps[::10]) > 0.0
    assert never.futures == []


def test_a_snapshot_has_the_obstacles_at_their_present_places(backhoe: Robot) -> None:
    """A ball is moved by 0.2 m, then at 0.5 m/s for 1 s: 0.7 m up; the obstacle as built is unchanged."""
    servo = Servo(backhoe, site(backhoe, {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [2, 3, 4]}))
    revision = servo.revision
    servo.move("ball", [0.0, 0.0, 0.2])
    assert not servo.is_moving()
    servo.set_velocity("ball", [0.0, 0.0, 0.5])
    assert servo.is_moving("ball")
    assert not servo.is_moving("another")
    assert servo.revision == revision + 2
    for _ in range(1000):
        servo.step()
    assert servo.revision == revision + 2
    (ball,) = servo.snapshot()
    np.testing.assert_allclose(ball.pieces[0].placement.translation, [2.0, 3.0, 4.7])
    np.testing.assert_allclose(ball.pieces[0].hull, [[2.0, 3.0, 4.7]])
    np.testing.assert_allclose(ball.velocity, [0.0, 0.0, 0.5])
    (again,) = servo.snapshot()
    np.testing.assert_allclose(again.pieces[0].hull, [[2.0, 3.0, 4.7]])
    servo.remove("ball")
    assert servo.snapshot() == ()
    assert servo.revision == revision + 3


# --- the search --------------------------------------------------------------------------


def query(robot: Robot, *obstacles: dict[str, Any], since: float = 1.2) -> RejoiningQuery:
    servo = Servo(robot, site(robot, *obstacles), q=smooth_motion().at(since))
    return RejoiningQuery(
        robot=servo.robot, scene=servo.scene, limits=servo.limits, obstacles=servo.snapshot(), q=servo.q,
        motion=smooth_motion(), since=since, seed=0,
    )  # fmt: skip


@pytest.mark.long
def test_a_rejoining_motion_is_clear_within_limits_and_ends_at_the_first_clear_sample(backhoe: Robot) -> None:
    box, motion = placed(backhoe, "box"), smooth_motion()
    taken = [moment for moment in motion.time if least_margin_of(backhoe, [motion.at(float(moment))], box) < 0.01]
    asked = query(backhoe, box, since=taken[0] - 0.02)
    found = find_rejoining(asked)
    assert isinstance(found, Rejoining)
    assert found.around == "box"
    np.testing.assert_allclose(found.motion.q[0], asked.q, atol=1e-12)
    np.testing.assert_allclose(found.motion.q[-1], motion.at(found.rejoins_at), atol=1e-9)
    assert least_margin_of(backhoe, found.motion.at(np.linspace(0.0, found.motion.duration, 2000)), box) > 0.0
    assert found.rejoins_at == pytest.approx(max(taken) + 0.02)  # the next of the plan's samples
    assert (np.abs(found.motion.segment_velocities()) <= asked.limits.velocity * (1.0 + 1e-6)).all()
    assert (np.abs(found.motion.accelerations()) <= asked.limits.acceleration * (1.0 + 1e-6)).all()
    assert is_still_clear(backhoe, asked.obstacles, found.motion.q)
    assert not is_still_clear(backhoe, asked.obstacles, motion.q)


def test_a_pickled_query_gives_the_same_answer(backhoe: Robot) -> None:
    asked = query(backhoe, placed(backhoe, "post"))
    sent: RejoiningQuery = pickle.loads(pickle.dumps(asked))
    here, there = find_rejoining(asked), find_rejoining(sent)
    assert isinstance(here, Rejoining)
    assert isinstance(there, Rejoining)
    np.testing.assert_array_equal(here.motion.q, there.motion.q)
    assert here.rejoins_at == there.rejoins_at


def test_a_start_too_close_to_an_obstacle_is_reported(backhoe: Robot) -> None:
    """The ball is centred at the tip."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": tip(backhoe, smooth_motion().at(1.2))}
    found = find_rejoining(query(backhoe, ball))
    assert isinstance(found, NoRejoining)
    assert "closer to ball than allowed" in found.reason
    assert not found.searched


# --- refused inputs ----------------------------------------------------------------------


def test_a_motion_with_another_number_of_joints_is_refused(planar4: Robot, panda: Robot) -> None:
    servo = Servo(planar4, bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict.fromkeys(planar4.joint_names, 0.3)},
            "task": {"goal": {"position": [1.0, 1.0, 0.0]}},
        }
    ), self_collision=False)  # fmt: skip
    motion = bp.Trajectory.from_steps(np.array([0.0, 1.0]), np.zeros((2, panda.n)))
    with pytest.raises(bp.InputError, match="another number of joints"):
        PlanFollower(servo, motion)


def test_a_negative_seed_is_refused(backhoe: Robot) -> None:
    with pytest.raises(bp.InputError, match="seed"):
        PlanFollower(Servo(backhoe, site(backhoe)), smooth_motion(), seed=-1)


def test_a_plan_that_brakes_at_the_limit_is_followed_to_its_end(backhoe: Robot) -> None:
    """Without obstacles; a clock that waited for a machine ahead of the plan would drive it further ahead."""
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": -0.8, "boom": 0.3, "stick": -1.4, "bucket": -0.5}},
            "task": {"goal": {"position": [4.0, 2.5, 0.3]}},
        }
    )
    plan = bp.plan(backhoe, scene, seed=0)
    assert plan.verified
    never = Never()
    servo = Servo(backhoe, scene, 0.01, q=plan.trajectory.q[0])
    steps = followed(PlanFollower(servo, plan, executor=never), 1000, until=lambda step: step.done)
    assert steps[-1].done
    assert steps[-1].behind < 0.02
    assert max(step.deviation for step in steps) < 1e-3
    assert never.futures == []


class Silent(Executor):
    """Answers with None."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(None)
        return future


@pytest.mark.long
def test_the_plan_can_be_finished_after_a_search_without_an_answer(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(searches, "_LONGEST_SEARCH", 2.0)
    for executor in (Never(), Silent()):
        servo = Servo(backhoe, site(backhoe), DT)
        follower = PlanFollower(servo, smooth_motion(), executor=executor)
        followed(follower, 120)
        servo.add(placed(backhoe, "ball"))
        steps = followed(follower, 4800, until=lambda step: step.status is FollowerStatus.BLOCKED)
        assert steps[-1].reason.startswith("planning failed: no answer ")
        servo.remove("ball")
        assert followed(follower, 2400)[-1].done


@pytest.fixture(scope="module")
def planar(planar4: Robot) -> bp.Plan:
    """A plan to a goal for a planar arm with four joints."""
    joints = dict(zip(planar4.joint_names, [0.3, 0.4, 0.5, 0.2], strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [1.5, 1.5, 0.0]}}}
    return bp.plan(planar4, bp.scene_from_dict(content), effort="quick")


def test_a_plan_for_other_joints_is_refused(backhoe: Robot, planar: bp.Plan) -> None:
    with pytest.raises(bp.InputError, match="for other joints"):
        PlanFollower(Servo(backhoe, site(backhoe), DT), planar)


def failed(plan: bp.Plan, samples: int) -> bp.Plan:
    """The first samples of a plan with their own certificate: the goal is not reached."""
    motion = bp.Trajectory.from_steps(plan.trajectory.time[:samples], plan.trajectory.q[:samples])
    found = replace(plan, trajectory=motion, certificate=certify_problem(plan.problem, motion))
    assert found.verdict == "failed"
    return found


def test_a_failed_plan_is_refused_unless_allow_failed_is_set(planar: bp.Plan) -> None:
    robot, scene = planar.robot, planar.scene
    part = failed(planar, len(planar.trajectory) // 2)
    servo = Servo(robot, scene, q=part.trajectory.q[0])
    with pytest.raises(bp.InputError, match=f"plan: .*failed: {part.reason}.*allow_failed=True"):
        PlanFollower(servo, part)
    steps = followed(PlanFollower(servo, part, allow_failed=True, executor=Never()), 4000)
    assert steps[-1].done
    np.testing.assert_allclose(steps[-1].state.q, part.trajectory.q[-1], atol=1e-3)


@pytest.mark.parametrize("allow_failed", [False, True])
def test_a_failed_plan_without_a_motion_is_always_refused(planar: bp.Plan, allow_failed: bool) -> None:
    alone = failed(planar, 1)
    servo = Servo(alone.robot, alone.scene, q=alone.trajectory.q[0])
    with pytest.raises(bp.InputError, match="plan: "):
        PlanFollower(servo, alone, allow_failed=allow_failed)
