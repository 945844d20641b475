"""Something turns up while a machine is on its track: it stops where it touches least, on the track or off it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from executors import Never

import backhoe_planner as bp
from backhoe_planner.live import PlanFollower, Servo
from backhoe_planner.live.braking.braking_path import JointState
from backhoe_planner.live.servo.joint_stop import JointStop, stops_from
from backhoe_planner.live.servo.stop_choice import Comparison, Stop, StopChoice
from backhoe_planner.machine import Robot
from backhoe_planner.site import Proximity, build_obstacle, obstacle_from_dict

DT = 0.01
KEPT = 1.1e-4  # m that a certificate accepts as keeping a clearance
ACCELERATION = np.array([0.5, 0.4, 0.6, 1.0])


def on_track(plan: bp.Plan, steps: int, scene: bp.Scene | None = None) -> tuple[Servo, PlanFollower]:
    """A machine after so many steps along the plan, on the track."""
    servo = Servo(plan.robot, plan.scene if scene is None else scene, DT, q=plan.trajectory.q[0])
    follower = PlanFollower(servo, plan, executor=Never())
    for _ in range(steps):
        follower.step()
    return servo, follower


Moments = dict[int, tuple[np.ndarray, np.ndarray]]


@pytest.fixture(scope="module")
def moments(past_wall: bp.Plan) -> Moments:
    """(q, v) by the number of steps after which the machine is on its track, and moves at more than 0.2 rad/s."""
    servo, follower = on_track(past_wall, 0)
    found = {}
    for steps in range(1, int(past_wall.trajectory.duration / DT)):
        follower.step()
        if servo.on_track and np.abs(servo.v).max() > 0.2:
            found[steps] = (servo.q, servo.v)
    assert found
    return found


def stopped(servo: Servo) -> list[np.ndarray]:
    """Where the machine is until it rests, if it gets no command that it understands."""
    places = [servo.q]
    for _ in range(400):
        places.append(servo.step(joint_velocity=[math.nan] * 4).q)
        if not servo.v.any():
            break
    return places


def braked(q: np.ndarray, v: np.ndarray, acceleration: np.ndarray) -> list[np.ndarray]:
    """Where a machine is that brakes every joint as hard as it can."""
    places = [q]
    while v.any():
        change = acceleration * DT
        v = v - np.clip(v, -change, change)
        q = q + DT * v
        places.append(q)
    return places


def straight_on(q: np.ndarray, v: np.ndarray, acceleration: np.ndarray) -> list[np.ndarray]:
    """Where a machine is that brakes all joints in proportion, in the time that the slowest one needs."""
    time = float(np.max(np.abs(v) / acceleration))
    return [q + part * 0.5 * time * v for part in np.linspace(0.0, 1.0, 40)]


def least(proximity: Proximity, places: list[np.ndarray]) -> float:
    different = {q.tobytes(): q for q in places}  # a machine at rest is measured once
    return min(float(np.min(proximity.distances(q) - proximity.clearance)) for q in different.values())


Ball = tuple[int, dict[str, Any]]


@pytest.fixture(scope="module")
def balls(past_wall: bp.Plan, moments: Moments) -> list[Ball]:
    """Moments on the track, and balls beside which only a machine that brakes each joint as hard as it can stops.

    Along the track or straight on it runs into them.
    """
    plan, found = past_wall, []
    rng, kinematics, allowed = np.random.default_rng(5), bp.Kinematics(plan.robot), list(moments)
    acceleration = Servo(plan.robot, plan.scene, DT, q=plan.trajectory.q[0]).limits.acceleration
    own = Proximity(plan.robot, plan.problem.obstacles)
    for _ in range(120):
        steps = int(rng.choice(allowed))
        free = braked(*moments[steps], acceleration)
        if least(own, free) < 0.005:
            continue
        along, straight = stopped(on_track(plan, steps)[0]), straight_on(*moments[steps], acceleration)
        middle = kinematics.at(along[-1]).tip_position
        for _ in range(20):
            ball = {"name": "ball", "shape": "sphere", "radius": float(rng.uniform(0.05, 0.25)), "clearance": 0.02}
            ball |= {"position": (middle + rng.normal(0.0, 0.3, 3)).tolist()}
            alone = balls_alone(plan, ball)
            if max(least(alone, along[::4]), least(alone, straight)) < -0.02 and least(alone, free) > 0.005:
                found.append((steps, ball))
                break
        if len(found) == 3:
            return found
    raise AssertionError(f"only {len(found)} balls")


def balls_alone(plan: bp.Plan, *balls: dict[str, Any]) -> Proximity:
    folder, clearance = plan.scene.folder, plan.scene.clearance
    built = [build_obstacle(obstacle_from_dict(ball), folder=folder, clearance=clearance) for ball in balls]
    return Proximity(plan.robot, built, self_collision=False)


def test_a_ball_on_the_track_beside_which_braking_every_joint_stops_is_not_touched(
    past_wall: bp.Plan, balls: list[Ball]
) -> None:
    plan = past_wall
    own = Proximity(plan.robot, plan.problem.obstacles)
    for steps, ball in balls:
        servo, follower = on_track(plan, steps)
        servo.add(ball)
        places, v = [], [servo.v]
        for _ in range(250):
            state = follower.step().state
            places.append(state.q)
            v.append(state.v)
        assert least(balls_alone(plan, ball), places) > -KEPT
        assert least(own, places) > -KEPT
        assert (np.abs(np.diff(v, axis=0)) <= servo.limits.acceleration * DT * (1.0 + 2e-6)).all()
        assert servo.last_error is None


@pytest.mark.parametrize("swing", [1.0, -1.0])
def test_a_machine_driven_by_hand_brakes_with_all_its_acceleration_for_what_turns_up(
    past_wall: bp.Plan, swing: float
) -> None:
    """A ball between where it stops as planned, with 0.8 of its acceleration, and where it can stop."""
    robot = past_wall.robot
    scene = past_wall.scene.model_copy(update={"obstacles": []})
    servo = Servo(robot, scene, DT, q=[-0.5 * swing, 0.3, -0.6, -0.3])
    for _ in range(80):
        servo.step(joint_velocity=[swing, 0.0, 0.0, 0.0])
    q, v = servo.q, servo.v
    ends = [straight_on(q, v, part * servo.limits.acceleration)[-1] for part in (1.0, 0.8)]
    tips = [bp.Kinematics(robot).at(end).tip_position for end in ends]
    side = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "clearance": 0.02}
    for ahead in np.arange(0.1, 1.0, 0.01):
        alone = balls_alone(past_wall, ball | {"position": (tips[0] + ahead * side).tolist()})
        if least(alone, ends[:1]) > 0.02:
            break
    assert least(alone, ends[1:]) < -0.01
    servo.add(ball | {"position": (tips[0] + ahead * side).tolist()})
    places, rates = [q], [v]
    for _ in range(200):
        state = servo.step(joint_velocity=[swing, 0.0, 0.0, 0.0])
        places.append(state.q)
        rates.append(state.v)
    assert least(alone, places) > -KEPT
    assert (np.abs(np.diff(rates, axis=0)) <= servo.limits.acceleration * DT * (1.0 + 1e-6)).all()
    assert not state.v.any() or abs(state.v[0]) < 0.01
    assert servo.last_error is None


def test_an_obstacle_that_the_track_stops_short_of_does_not_lead_off_it(past_wall: bp.Plan, moments: Moments) -> None:
    plan = past_wall
    steps = min(moments)
    alone, _ = on_track(plan, steps)
    expected = stopped(alone)
    servo, _ = on_track(plan, steps)
    servo.add({"name": "far", "shape": "sphere", "radius": 0.2, "position": [-6.0, 0.0, 4.0]})
    np.testing.assert_allclose(stopped(servo)[:20], expected[:20], atol=1e-9)


@pytest.mark.long
def test_among_many_obstacles_beside_the_way_other_stops_are_looked_at_too(
    past_wall: bp.Plan, balls: list[Ball]
) -> None:
    """More distances are near than may be measured for one comparison."""
    plan = past_wall
    rng, kinematics = np.random.default_rng(11), bp.Kinematics(plan.robot)
    steps, ball = balls[0]
    servo, follower = on_track(plan, steps)
    free = braked(servo.q, servo.v, servo.limits.acceleration)
    along = stopped(on_track(plan, steps)[0])
    tip, crowd = kinematics.at(along[-1]).tip_position, [ball]
    while len(crowd) < 200:
        one = {"name": f"{len(crowd)}", "shape": "sphere", "radius": 0.05, "clearance": 0.02}
        one["position"] = (tip + rng.normal(0.0, 0.4, 3)).tolist()
        if least(balls_alone(plan, one), [*free, *along[::4]]) > 0.03:
            crowd.append(one)
    for one in crowd:
        servo.add(one)
    places = [servo.q]
    while servo.v.any() and len(places) < 250:
        places.append(follower.step().state.q)
    assert least(balls_alone(plan, *crowd), places) > -KEPT
    assert servo.last_error is None


def test_stops_are_not_compared_anew_for_each_move_of_an_obstacle(
    past_wall: bp.Plan, balls: list[Ball], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tracked obstacle is moved in each step; a comparison takes longer than many steps."""
    times: list[float] = []
    compare = StopChoice.compare

    def noted(self: StopChoice, stop: Stop) -> Comparison:
        times.append(servo.time)
        return compare(self, stop)

    monkeypatch.setattr(StopChoice, "compare", noted)
    steps, ball = balls[0]
    servo, follower = on_track(past_wall, steps)
    begun = servo.time
    servo.add(ball)
    for _ in range(25):
        servo.move("ball", [0.0, 0.0, 1e-4])
        follower.step()
    assert times[0] == pytest.approx(begun + DT)
    assert (np.diff(times) > 0.1).all()


def test_no_step_measures_the_track_and_a_stop_off_it_one_after_the_other(
    past_wall: bp.Plan, moments: Moments, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step of 10 ms begins no stop once it has done the work of 50 distances; one stop takes at most 130."""
    work: list[int] = []
    look = StopChoice.look

    def noted(self: StopChoice, looks: Iterator[None]) -> bool:
        more = look(self, looks)
        work.append(self.work)
        return more

    monkeypatch.setattr(StopChoice, "look", noted)
    rng, kinematics = np.random.default_rng(0), bp.Kinematics(past_wall.robot)
    for steps in list(moments)[::5]:
        servo, follower = on_track(past_wall, steps)
        tip = kinematics.at(past_wall.trajectory.at(np.array([DT * steps + 0.3]))[0]).tip_position
        for number in range(30):
            place = (tip + rng.normal(0.0, 0.3, 3)).tolist()
            servo.add({"name": f"{number}", "shape": "sphere", "radius": 0.05, "position": place, "clearance": 0.02})
        for _ in range(3):
            follower.step()
    assert max(work) > 50
    assert max(work) < 50 + 130


@pytest.mark.parametrize("length", [pytest.param(0.4, marks=pytest.mark.long), 0.9])
def test_a_load_taken_up_in_motion_comes_no_nearer_than_braking_every_joint_would(
    past_wall: bp.Plan, moments: Moments, length: float
) -> None:
    """A pipe hangs from the bucket that passes just above the wall; the choice may miss a tenth of the depth."""
    plan = past_wall
    pipe = {"name": "pipe", "shape": "box", "size": [0.1, 0.1, length], "position": [0.0, 0.0, -0.5 * length]}
    content = plan.scene.model_dump(by_alias=True, mode="json", exclude_none=True)
    content["task"] = {"sequence": [{"name": "laden", "carries": pipe, **content["task"]}]}
    scene = bp.scene_from_dict(content)
    for steps in list(moments)[::8]:
        servo, follower = on_track(plan, steps, scene)
        free = braked(servo.q, servo.v, servo.limits.acceleration)
        servo.carry("laden")
        laden = Proximity(servo.robot, servo.snapshot())
        places = [servo.q]
        while servo.v.any() and len(places) < 250:
            places.append(follower.step().state.q)
        possible = min(least(laden, free), 0.0)
        assert least(laden, places) >= 1.1 * possible - 0.01
        assert servo.last_error is None


@pytest.mark.parametrize("dt", [1e-3, 0.033, 0.1])
@pytest.mark.parametrize("v", [[0.5, -0.2, 0.0, 0.9], [0.0, 0.0, -0.3, 0.0]])
def test_every_stop_keeps_the_accelerations_and_ends_where_it_says(v: list[float], dt: float) -> None:
    """No joint stops earlier than in v / a, and none later than the last one; from v it moves on by v (T - dt) / 2.

    In steps of dt it moves on by up to a dt^2 / 8 more.
    """
    start, q0 = np.array(v), np.array([0.1, 0.2, -0.3, 0.4])
    own, more = np.abs(start) / ACCELERATION, 0.25 * dt**2 / np.abs(start[start != 0.0]) * ACCELERATION[start != 0.0]
    for stop in stops_from(start, ACCELERATION, dt).values():
        places, times = stop.way_to_rest(q0, start)
        assert times[-1] == pytest.approx(own.max())
        rests = 2.0 * np.abs(places[-1] - q0)[start != 0.0] / np.abs(start)[start != 0.0] + dt
        assert (rests >= own[start != 0.0] - 1e-9).all()
        assert (rests <= own.max() + more + 1e-9).all()
        q, speed = q0, start
        while speed.any():
            slower = stop.slower(q, speed)
            assert (np.abs(slower - speed) <= ACCELERATION * dt * (1.0 + 1e-9)).all()
            q, speed = q + dt * slower, slower
        np.testing.assert_allclose(q, places[-1], atol=1e-12)


def test_a_stop_has_the_same_key_at_another_velocity() -> None:
    """First the first joint takes longest to stop, 1 s, then the second one, 0.95 s. The third alone stops as late."""
    for v, longest, without in (([0.5, 0.38, 0.12, 0.1], 1.0, 4), ([0.4, 0.38, 0.12, 0.1], 0.95, 5)):
        stops, start = stops_from(np.array(v), ACCELERATION, DT), np.array(v)
        assert list(stops) == [key for key in range(8) if key != without]
        slowing = (start - stops[6].slower(start, start)) / DT
        np.testing.assert_allclose(slowing, [0.5, 0.4, 0.12 / longest, 1.0], rtol=1e-9)


def test_a_stop_within_the_limits_is_measured_though_the_present_one_ends_beyond_them(backhoe: Robot) -> None:
    """The bucket would pass its limit by 0.1 rad. By hand: a ball around the tip is touched at least 0.2 m deep."""
    q, v = np.array([0.0, 0.4, -1.2, backhoe.limits.upper[3] - 0.3]), np.array([0.3, 0.0, 0.0, 0.8])
    scene = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"joints": {"swing": 1.0}}}}
    servo = Servo(backhoe, bp.scene_from_dict(scene), DT, q=q)
    tip = bp.Kinematics(backhoe).at(q).tip_position
    servo.add({"name": "ball", "shape": "sphere", "radius": 0.2, "position": tip.tolist()})
    comparison = StopChoice(servo.robot, servo._check).compare(JointStop(np.array([0.3, 1.0, 1.0, 0.8]), DT))
    while not comparison.is_done:
        comparison.go_on(JointState(q, v, q), 0.0)
    assert comparison._margin < -0.2


def test_a_stop_from_here_with_room_enough_is_taken_although_the_track_may_be_left_later_too(
    past_wall: bp.Plan, moments: Moments, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every stop touches something at first; once the machine is slower, the third one from here does not."""
    servo, _ = on_track(past_wall, min(moments))
    state, track = JointState(servo.q, servo.v, servo.q), servo._stop
    assert track is not None
    choice = StopChoice(servo.robot, servo._check)
    from_here = choice.stops_from(servo.v)
    margins = iter([-0.1, *[-0.05] * len(from_here), -0.1, -0.2, -0.2, 0.01, *[-0.2] * 100])
    monkeypatch.setattr(choice, "least_margin", lambda *_, worst: next(margins))
    comparison = choice.compare(track)
    while not comparison.is_done:
        comparison.go_on(state, servo.time)
    assert isinstance(comparison.best, JointStop)
    expected = list(from_here.values())[2].slower(servo.q, servo.v)
    np.testing.assert_array_equal(comparison.best.slower(servo.q, servo.v), expected)
