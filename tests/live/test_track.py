"""Plans of least time past obstacles are followed on a track: on time, and the machine can always stop along them."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from executors import AtOnce, Never
from shipped_plans import planned

import backhoe_planner as bp
from backhoe_planner.live import FollowerState, PlanFollower, Servo
from backhoe_planner.live.detours.reference import Reference
from backhoe_planner.live.servo.track import Track
from backhoe_planner.machine import Robot, shipped_folder
from backhoe_planner.site import Proximity

SCENES = shipped_folder("scenes")
DT = 0.02
KEPT = 1.1e-4  # m that a certificate accepts as keeping a clearance


def servo_of(plan: bp.Plan, dt: float = DT) -> Servo:
    return Servo(plan.robot, plan.scene, dt, q=plan.trajectory.q[0])


def least_margin(plan: bp.Plan, postures: list[np.ndarray]) -> float:
    """The least margin to the plan's own obstacles, and of the machine with itself [m]."""
    proximity = Proximity(plan.robot, plan.problem.obstacles)
    return min(float(np.min(proximity.distances(q) - proximity.clearance)) for q in postures)


def off_path(plan: bp.Plan, q: np.ndarray) -> float:
    """How far q (n,) is from the nearest place of the plan [rad or m]."""
    fine = plan.trajectory.at(np.linspace(0.0, plan.trajectory.duration, 4000))
    return float(np.abs(fine - q).max(axis=1).min())


def changes_within_limits(servo: Servo, v: list[np.ndarray]) -> bool:
    changes = np.abs(np.diff(np.array(v), axis=0))
    return bool((changes <= servo.limits.acceleration * servo.dt * (1.0 + 2e-6)).all())


def followed(
    follower: PlanFollower, seconds: float, *, until: Callable[[FollowerState], bool] | None = None
) -> list[FollowerState]:
    found = []
    for _ in range(round(seconds / DT)):
        found.append(follower.step())
        if found[-1].done or (until is not None and until(found[-1])):
            break
    return found


# --- nothing new in the way ------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["wall", "level_bucket", *(pytest.param(one, marks=pytest.mark.long) for one in ("pole", "trench", "truck"))],
)
def test_a_plan_of_least_time_is_followed_on_time(
    backhoe: Robot, past_wall: bp.Plan, level_plan: bp.Plan, name: str
) -> None:
    """The straight braking lines from these plans end in obstacles, or outside of the band that is kept."""
    made = {"wall": past_wall, "level_bucket": level_plan}
    plan = made[name] if name in made else planned(backhoe, name)
    servo, keep = servo_of(plan), plan.problem.keep
    with PlanFollower(servo, plan, executor=Never()) as follower:
        steps = followed(follower, 2.0 * plan.trajectory.duration)
    assert steps[-1].done
    assert len(steps) <= math.ceil(plan.trajectory.duration / DT) + 1
    assert {step.status.value for step in steps} == {"following", "arrived"}
    assert not {step.state.status.value for step in steps} & {"sliding", "stopped", "evading"}
    assert least_margin(plan, [step.state.q for step in steps]) > -KEPT
    assert max(off_path(plan, step.state.q) for step in steps[::10]) < 1e-3
    assert changes_within_limits(servo, [step.state.v for step in steps])
    if keep is not None:
        assert min(float(keep.margins(step.state.q).min()) for step in steps) > -5e-4
    assert servo.last_error is None


@pytest.mark.long
def test_a_digging_cycle_ends_with_its_plan(backhoe: Robot) -> None:
    """Its legs have their own obstacles, one is a wait of half a second, and one keeps the bucket's pitch."""
    plan = planned(backhoe, "dig_swing_dump")
    with PlanFollower(servo_of(plan), plan, executor=Never()) as follower:
        steps = followed(follower, 2.0 * plan.trajectory.duration)
    assert steps[-1].done
    assert len(steps) <= math.ceil(plan.trajectory.duration / DT) + 1
    assert {step.status.value for step in steps} == {"following", "arrived"}
    for step in steps[::5]:
        leg = [one for one in plan.legs if one.begins <= max(step.plan_time - DT, 0.0)][-1]
        proximity = Proximity(leg.problem.robot, leg.problem.obstacles)
        assert float(np.min(proximity.distances(step.state.q) - proximity.clearance)) > -KEPT


def test_a_machine_that_has_arrived_gets_no_later(past_wall: bp.Plan) -> None:
    with PlanFollower(servo_of(past_wall), past_wall, executor=Never()) as follower:
        arrived = followed(follower, 2.0 * past_wall.trajectory.duration)[-1]
        assert arrived.done
        later = [follower.step() for _ in range(100)][-1]
    assert later.done
    assert later.behind == arrived.behind


# --- something new ---------------------------------------------------------------------


BALL = {"name": "ball", "shape": "sphere", "radius": 0.3}


def test_an_obstacle_away_from_the_plan_costs_no_time_once_the_rest_is_proven_clear_of_it(past_wall: bp.Plan) -> None:
    servo = servo_of(past_wall)
    with PlanFollower(servo, past_wall, executor=AtOnce()) as follower:
        followed(follower, 0.5 * past_wall.trajectory.duration)
        servo.add(BALL | {"position": [-6.0, 0.0, 4.0]})
        steps = followed(follower, past_wall.trajectory.duration)
    assert steps[-1].done
    assert steps[-1].behind <= 2.0 * DT + 1e-9


class FirstProofNever(AtOnce):
    """Never answers the first proof."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def submit(self, function: Any, /, *args: Any, **keys: Any) -> Future[Any]:
        self.asked.append(function.__name__)
        unanswered = self.asked == ["prove_rest"]
        return Future() if unanswered else super().submit(function, *args, **keys)


def test_a_proof_that_was_given_up_for_a_search_is_asked_for_again(past_wall: bp.Plan) -> None:
    """Without it the machine is held by the wall that it cannot brake straight in front of, and a way is searched."""
    executor = FirstProofNever()
    servo = servo_of(past_wall)
    with PlanFollower(servo, past_wall, executor=executor) as follower:
        followed(follower, 0.2 * past_wall.trajectory.duration)
        servo.add(BALL | {"position": [-6.0, 0.0, 4.0]})
        assert followed(follower, 5.0 * past_wall.trajectory.duration)[-1].done
    assert executor.asked[:3] == ["prove_rest", "find_rejoining", "prove_rest"]


def test_after_a_detour_the_machine_comes_exactly_onto_the_plan_and_stays_there(past_wall: bp.Plan) -> None:
    """The rest is proven anew after the detour; 0.03 rad beside the plan a machine gathers speed within a second."""
    servo = servo_of(past_wall)
    with PlanFollower(servo, past_wall, executor=FirstProofNever()) as follower:
        followed(follower, 0.2 * past_wall.trajectory.duration)
        servo.add(BALL | {"position": [-6.0, 0.0, 4.0]})
        steps = followed(follower, 5.0 * past_wall.trajectory.duration)
    assert steps[-1].done
    (last,) = [row for row, step in enumerate(steps[:-1]) if step.status.value == "going_round"][-1:]
    assert len(steps) > last + round(1.0 / DT)
    assert max(step.deviation for step in steps[last + round(1.0 / DT) :]) < 1e-6


def test_without_that_proof_the_machine_leaves_the_track_clear_of_everything(past_wall: bp.Plan) -> None:
    servo = servo_of(past_wall)
    with PlanFollower(servo, past_wall, executor=Never()) as follower:
        steps = followed(follower, past_wall.trajectory.duration, until=lambda _: servo.on_track)
        assert servo.on_track
        servo.add(BALL | {"position": [-6.0, 0.0, 4.0]})
        steps += followed(follower, 4.0 * past_wall.trajectory.duration)
    assert not servo.on_track
    assert least_margin(past_wall, [step.state.q for step in steps]) > -KEPT
    assert changes_within_limits(servo, [step.state.v for step in steps])


@pytest.mark.parametrize("part", [0.42, *(pytest.param(part, marks=pytest.mark.long) for part in (0.1, 0.3))])
def test_a_ball_on_the_rest_of_the_plan_is_not_touched_nor_is_the_wall(past_wall: bp.Plan, part: float) -> None:
    """The ball is put onto the plan 1.5 s ahead; the swing alone stops from its rate of 0.6 rad/s in 1.2 s."""
    servo, plan = servo_of(past_wall), past_wall
    with PlanFollower(servo, plan, executor=AtOnce()) as follower:
        moment = part * plan.trajectory.duration
        steps = followed(follower, moment)
        ahead = bp.Kinematics(plan.robot).at(plan.trajectory.at(moment + 1.5))
        place = (ahead.tip_position + np.array([0.0, 0.0, 0.35])).tolist()
        ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "clearance": 0.02, "position": place}
        servo.add(ball)
        steps += followed(follower, 6.0)
    there = [one for one in servo.snapshot() if one.name == "ball"]
    alone = Proximity(plan.robot, there, self_collision=False)
    least = min(float(np.min(alone.distances(step.state.q) - alone.clearance)) for step in steps)
    assert least > -KEPT
    assert least_margin(plan, [step.state.q for step in steps]) > -KEPT
    assert changes_within_limits(servo, [step.state.v for step in steps])


def test_a_machine_that_is_no_longer_commanded_stops_along_the_plan(past_wall: bp.Plan) -> None:
    """From every moment of the plan at which it needs the track. A command that is not understood counts as none."""
    plan, tried = past_wall, 0
    servo = servo_of(plan)
    follower = PlanFollower(servo, plan, executor=Never())
    for row in range(int(plan.trajectory.duration / DT)):
        follower.step()
        if not servo.on_track or row % 4:
            continue
        tried += 1
        alone = servo_of(plan)
        again = PlanFollower(alone, plan, executor=Never())
        v = [again.step().state.v for _ in range(row + 1)]
        postures = []
        np.testing.assert_array_equal(alone.q, servo.q)
        for _ in range(400):
            state = alone.step(joint_velocity=[math.nan] * 4)
            v.append(state.v)
            postures.append(state.q)
            if not state.v.any():
                break
        assert not state.v.any()
        assert not alone.on_track
        assert least_margin(plan, postures) > -KEPT
        assert changes_within_limits(alone, v)
    assert tried > 1


def test_an_error_in_a_step_on_the_track_slows_the_machine_down_along_it(
    past_wall: bp.Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    servo = servo_of(past_wall)
    follower = PlanFollower(servo, past_wall, executor=Never())
    followed(follower, past_wall.trajectory.duration, until=lambda _: servo.on_track)

    def fails(*_: Any, **__: Any) -> None:
        raise RuntimeError("no room")

    monkeypatch.setattr(servo._bounds, "near", fails)
    states = [follower.step().state for _ in range(200)]  # braking straight ahead, it would need 1.5 s
    assert isinstance(servo.last_error, RuntimeError)
    assert max(off_path(past_wall, state.q) for state in states) < 1e-3
    assert not states[-1].v.any()


# --- the track itself -------------------------------------------------------------------


@pytest.mark.parametrize("seed", [11, pytest.param(12, marks=pytest.mark.long)])
def test_a_servo_follows_a_track_at_any_pace(past_wall: bp.Plan, seed: int) -> None:
    """A random pace for some steps, then another one; the last one leads to the end."""
    plan, rng = past_wall, np.random.default_rng(seed)
    servo = servo_of(plan)
    reference = Reference(plan.trajectory, servo.limits)
    track = Track(reference, servo.limits, servo.dt)
    track.revision = servo.revision
    v, pace, postures = [servo.v], 1.0, []
    for step in range(2000):
        if step % 15 == 0:
            pace = float(rng.choice([0.0, rng.uniform(), 1.0])) if step < 300 else 1.0
        assert track.is_joined_by(servo.q, servo.v)
        state = servo.step_along_unchecked(track, pace=pace)
        v.append(state.v)
        postures.append(state.q)
        np.testing.assert_allclose(state.q, reference.q, atol=1e-9)
        if reference.ended:
            break
    assert reference.ended
    assert least_margin(plan, postures) > -KEPT
    assert changes_within_limits(servo, v)


@pytest.mark.parametrize("dt", [0.001, 0.01])
def test_a_track_is_slowed_down_as_fast_as_its_joints_can(backhoe: Robot, dt: float) -> None:
    """A straight swing at a constant rate, by hand: it stops in v / a, and is as fast again after the same time."""
    limits = backhoe.limits
    rate, most = 0.5 * float(limits.velocity[0]), float(limits.acceleration[0])
    ramp = rate / (0.5 * most)  # s, at half of the acceleration
    time = np.linspace(0.0, 4.0 + 2.0 * ramp, round((4.0 + 2.0 * ramp) / 0.02) + 1)
    v = np.minimum(np.minimum(0.5 * most * time, rate), 0.5 * most * (time[-1] - time))
    q = np.array([0.0, 0.3, -1.5, -0.5]) + np.concatenate(([0.0], np.cumsum(0.02 * 0.5 * (v[1:] + v[:-1]))))[
        :, None
    ] * [1.0, 0.0, 0.0, 0.0]
    track = Track(Reference(bp.Trajectory.from_steps(time, q), limits), limits, dt)
    at, speed = q[0], np.zeros(4)

    def move(velocity: np.ndarray) -> None:
        nonlocal at, speed
        assert (np.abs(velocity - speed) <= limits.acceleration * dt * (1.0 + 2e-6)).all()
        at, speed = at + dt * velocity, velocity
        track.advance()

    while track.reference.clock < ramp + 0.5:
        move(track.faster(at, speed, 1.0))
    assert speed[0] == pytest.approx(rate, rel=1e-3)
    stopping = 0
    while speed.any():
        move(track.slower(at, speed))
        stopping += 1
    assert stopping * dt == pytest.approx(rate / most, rel=0.05, abs=2.0 * dt)
    starting = 0
    while speed[0] < 0.99 * rate:
        move(track.faster(at, speed, 1.0))
        starting += 1
    assert starting * dt == pytest.approx(rate / most, rel=0.05, abs=2.0 * dt)
    np.testing.assert_allclose(at, track.reference.q, atol=1e-9)


def test_a_machine_beside_its_track_or_at_another_velocity_has_not_joined_it(past_wall: bp.Plan) -> None:
    limits = past_wall.problem.limits
    track = Track(Reference(past_wall.trajectory, limits), limits, DT)
    q, still = past_wall.trajectory.q[0], np.zeros(4)
    assert track.is_joined_by(q, still)
    assert not track.is_joined_by(q + np.array([0.0, 1e-3, 0.0, 0.0]), still)
    assert not track.is_joined_by(q, np.array([0.0, 0.3, 0.0, 0.0]))
    # far behind it, the machine comes no faster than its joints can
    np.testing.assert_array_equal(track.faster(q - 0.5, limits.velocity, 1.0), limits.velocity)
    np.testing.assert_array_equal(track.faster(q + 0.5, -limits.velocity, 1.0), -limits.velocity)


def test_the_reference_rests_where_the_motion_rests(backhoe: Robot) -> None:
    """A swing, half a second at rest in one sample, and the swing back; accelerations stay within the limits."""
    time = np.linspace(0.0, 2.0, 101)
    swing = 0.2 * (10 * (time / 2) ** 3 - 15 * (time / 2) ** 4 + 6 * (time / 2) ** 5)
    q = np.array([0.0, 0.3, -1.5, -0.5]) + np.concatenate((swing, swing[::-1]))[:, None] * [1.0, 0.0, 0.0, 0.0]
    motion = bp.Trajectory.from_steps(np.concatenate((time, time + 2.5)), q)
    reference = Reference(motion, backhoe.limits)
    assert reference.keeps_limits
    for moment in (2.0, 2.1, 2.4, 2.5):
        np.testing.assert_allclose(reference.at(moment), motion.at(moment), atol=1e-12)
    fine = np.linspace(0.0, 4.5, 4501)
    places = np.array([reference.at(moment) for moment in fine.tolist()])
    np.testing.assert_allclose(places, motion.at(fine), atol=1e-4)
    assert np.abs(np.diff(places, 2, axis=0) / 1e-6).max() <= backhoe.limits.acceleration[0]
    corner = bp.Trajectory.from_steps(np.array([0.0, 2.0, 4.0]), q[[0, 50, 0]])
    assert not Reference(corner, backhoe.limits).keeps_limits


# --- not what was proven ------------------------------------------------------------------


def run_beside(plan: bp.Plan, servo: Servo, *, seconds: float = 4.0, dt: float = DT) -> tuple[float, bool]:
    """The least margin to what is there, between the steps too, and whether the machine was ever on its track.

    Nothing that is there moves.
    """
    found, on_track, q = math.inf, False, servo.q
    proximity = Proximity(servo.robot, servo.snapshot())
    with PlanFollower(servo, plan, executor=AtOnce()) as follower:
        for _ in range(round(seconds / dt)):
            step = follower.step()
            on_track |= servo.on_track
            for part in (0.5, 1.0):
                between = q + part * (step.state.q - q)
                found = min(found, float(np.min(proximity.distances(between) - proximity.clearance)))
            q = step.state.q
            if step.done:
                break
    assert servo.last_error is None
    return found, on_track


def test_an_obstacle_that_was_moved_is_new_even_if_its_record_is_the_plan_s(past_wall: bp.Plan) -> None:
    """A snapshot of the raised wall has the record of the wall as it stood."""
    servo = servo_of(past_wall)
    servo.move("wall", [0.0, 0.0, 0.3])
    [raised] = [one for one in servo.snapshot() if one.name == "wall"]
    servo.remove("wall")
    servo.add(raised)
    margin, on_track = run_beside(past_wall, servo)
    assert margin > -KEPT
    assert not on_track


def test_a_plan_is_not_proven_for_a_load_that_it_does_not_carry(backhoe: Robot, past_wall: bp.Plan) -> None:
    pipe = {"name": "pipe", "shape": "box", "size": [0.3, 0.3, 0.8], "position": [0.0, 0.0, -0.3]}
    content = past_wall.scene.model_dump(by_alias=True, mode="json", exclude_none=True)
    content["task"] = {"sequence": [{"name": "laden", "carries": pipe, **content["task"]}]}
    servo = Servo(backhoe, bp.scene_from_dict(content), DT, q=past_wall.trajectory.q[0])
    servo.carry("laden")
    margin, on_track = run_beside(past_wall, servo)
    assert margin > -KEPT
    assert not on_track


@pytest.mark.parametrize("dt", [pytest.param(0.02, marks=pytest.mark.long), 0.1, 0.3])
def test_clearances_are_kept_between_long_steps(past_wall: bp.Plan, dt: float) -> None:
    """A straight step of 0.3 s is up to 27 mm off the curve; the plan is 1.7 mm beyond the wall's clearance."""
    margin, _ = run_beside(past_wall, servo_of(past_wall, dt), seconds=8.0, dt=dt)
    assert margin > -KEPT


def test_an_obstacle_of_another_leg_is_new(backhoe: Robot) -> None:
    """The wall is there while the machine waits; by hand, it is put up before the leg that goes through its place."""
    content = bp.load_scene(SCENES / "wall.yaml").model_dump(by_alias=True, mode="json", exclude_none=True)
    content["obstacles"] = [one | {"legs": ["wait"]} for one in content["obstacles"] if one["name"] == "wall"]
    content["task"] = {"sequence": [{"name": "over", **content["task"]}, {"name": "wait", "wait": 0.5}]}
    scene = bp.scene_from_dict(content)
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    servo = servo_of(plan)
    with PlanFollower(servo, plan, executor=AtOnce()) as follower:
        follower.step()
        assert "wall" not in servo.obstacles
        servo.add(content["obstacles"][0])
        proximity = Proximity(servo.robot, servo.snapshot())
        for _ in range(300):
            q = follower.step().state.q
            assert np.min(proximity.distances(q) - proximity.clearance) > -KEPT
            assert not servo.on_track


@pytest.mark.parametrize("bounded", [False, True])
def test_a_plan_from_another_process_is_proven_among_its_own_obstacles(past_wall: bp.Plan, bounded: bool) -> None:
    """A process pool sends plans as pickles, in which everything is a copy.

    Coal gives a shape its bounding box at the first query that needs one. That of the ground is infinite.
    """
    copied = pickle.loads(pickle.dumps(past_wall))
    if bounded:
        for obstacle in copied.problem.obstacles:
            for piece in obstacle.pieces:
                piece.shape.computeLocalAABB()
    for plan in (copied, pickle.loads(pickle.dumps(copied))):
        servo = servo_of(plan)
        with PlanFollower(servo, plan, executor=Never()) as follower:
            follower.step()
            assert servo.is_proven_along_unchecked(follower._track)


def test_a_scan_counts_as_the_plan_s_where_it_is_and_with_its_points(backhoe: Robot, tmp_path: Path) -> None:
    """The scan is the wall's; it is moved up by 0.3 m, or the file is written anew with a wall of 1.6 m."""

    def write(height: float) -> None:
        ticks = [np.arange(low, high, 0.1) for low, high in ((2.0, 5.8), (0.5, 0.75), (0.05, height))]
        np.savetxt(tmp_path / "scan.xyz", np.stack(np.meshgrid(*ticks), axis=-1).reshape(-1, 3), fmt="%.4f")

    content = bp.load_scene(SCENES / "wall.yaml").model_dump(by_alias=True, mode="json", exclude_none=True)
    scan = {"name": "wall", "shape": "pointcloud", "file": "scan.xyz", "resolution": 0.1}
    content["obstacles"] = [scan if one["name"] == "wall" else one for one in content["obstacles"]]
    write(1.2)
    plan = bp.plan(backhoe, bp.scene_from_dict(content, folder=tmp_path), effort="quick")
    assert plan.verified, plan.message
    same, moved = servo_of(plan), servo_of(plan)
    moved.move("wall", [0.0, 0.0, 0.3])
    write(1.6)
    for servo, own in ((same, True), (moved, False), (servo_of(plan), False)):
        with PlanFollower(servo, plan, executor=Never()) as follower:
            postures = [follower.step().state.q for _ in range(300)]
            assert servo.is_proven_along_unchecked(follower._track) is own
        proximity = Proximity(servo.robot, servo.snapshot())
        assert min(float(np.min(proximity.distances(q) - proximity.clearance)) for q in postures[::3]) > -KEPT
