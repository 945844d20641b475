"""Following a plan with a kept pitch past an obstacle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from executors import AtOnce

import backhoe_planner as bp
from backhoe_planner.law import Rows
from backhoe_planner.live import Rejoining, RejoiningQuery, find_rejoining
from backhoe_planner.live.braking.joint_bounds import BRAKING
from backhoe_planner.live.braking.kept_rows import KeptRows
from backhoe_planner.live.braking_pace import BrakingPace, PlanPart, StopRule
from backhoe_planner.live.detours.reference import Reference
from backhoe_planner.live.kept_following import KeptFollowing, held_velocity, velocity_back
from backhoe_planner.motion import Keep, keep_of
from backhoe_planner.site import ClearanceScreen

NAMES = ("swing", "boom", "stick", "bucket")
A, B = (0.0, 0.3, -1.5, -1.5), (1.0, 0.6, -1.2, -2.1)  # both at a pitch of -2.7
BAND = (-2.71, -2.69)
# the same band as a pitch, and as a tilt of the axis of the bucket that is vertical at -2.7
LEVEL = (
    {"pitch": list(BAND)},
    {"tilt": {"axis": [float(np.sin(-2.7)), 0.0, float(np.cos(-2.7))], "tolerance": 0.01}},
)


def level_scene(keep: Any = LEVEL[0]) -> bp.Scene:
    start, goal = ({"joints": dict(zip(NAMES, q, strict=True))} for q in (A, B))
    task = {"goal": goal, "keep": keep}
    return bp.scene_from_dict({"version": 1, "start": start, "task": task})


def straight() -> bp.Trajectory:
    part = np.linspace(0.0, 1.0, 120)[:, None]
    blend = 10 * part**3 - 15 * part**4 + 6 * part**5
    return bp.Trajectory.from_steps(4.0 * part[:, 0], np.array(A) + blend * (np.array(B) - A))


def ball_on(robot: bp.Robot, motion: bp.Trajectory, above: float) -> dict[str, Any]:
    """A ball at the middle of the tip's path, its centre `above` that [m]."""
    tip = bp.Kinematics(robot).at(motion.q[len(motion) // 2]).tip_position + np.array([0.0, 0.0, above])
    return {"name": "ball", "shape": "sphere", "radius": 0.15, "position": tip.tolist()}


@pytest.mark.parametrize("keep", [pytest.param(LEVEL[0], marks=pytest.mark.long), LEVEL[1]])
def test_a_follower_waits_rather_than_tipping_the_bucket(backhoe: bp.Robot, keep: Any) -> None:
    """The ball pushes the bucket's side: sliding along it would tip the bucket by up to 10 degrees."""
    motion = straight()
    servo = bp.Servo(backhoe, level_scene(keep), 0.02)
    servo.add(ball_on(backhoe, motion, 0.15))
    most, reasons = 0.0, set()
    with bp.PlanFollower(servo, motion, executor=AtOnce()) as follower:
        for _ in range(2000):
            told = follower.step()
            most = max(most, abs(float(told.state.q[1:].sum()) + 2.7))
            reasons.add(told.reason)
            if told.done:
                break
    assert told.done
    assert most < 0.01 + 1e-3
    assert any("would violate `keep`" in reason for reason in reasons)


@pytest.mark.parametrize("keep", LEVEL)
def test_a_rejoining_motion_leaves_the_band_no_further_than_its_start(backhoe: bp.Robot, keep: Any) -> None:
    """The bucket starts 0.05 rad outside the band and is tipped no further."""
    motion, scene = straight(), level_scene(keep)
    servo = bp.Servo(backhoe, scene, 0.01)
    servo.add(ball_on(backhoe, motion, 0.1))
    q = np.array([0.1, *A[1:3], A[3] + 0.06])
    query = RejoiningQuery(
        robot=backhoe,
        scene=scene,
        limits=backhoe.limits,
        obstacles=servo.snapshot(),
        q=q,
        motion=motion,
        since=1.0,
        seed=0,
    )
    found = find_rejoining(query)
    assert isinstance(found, Rejoining), found
    assert np.max(np.abs(found.motion.q[:, 1:].sum(axis=1) + 2.7)) <= 0.06 + 1e-5


def test_a_widened_band_just_includes_the_given_configuration(backhoe: bp.Robot) -> None:
    keep = keep_of(backhoe, level_scene())
    assert isinstance(keep, Keep)
    q = np.array([*A[:3], A[3] + 0.06])
    wider = keep.widened(q)
    assert not keep.holds(q)
    assert wider.holds(q)
    assert not wider.holds(q + np.array([0.0, 0.0, 0.0, 1e-4]))


def test_a_plan_of_least_time_is_followed_within_what_it_keeps(level_plan: bp.Plan) -> None:
    """Nothing is in the way but what was planned around. Braking straight ahead from the plan would tip the bucket."""
    plan, keep = level_plan, level_plan.problem.keep
    assert keep is not None
    servo = bp.Servo(plan.robot, plan.scene, 0.005, q=plan.trajectory.q[0])
    least, statuses = np.inf, set()
    with bp.PlanFollower(servo, plan, executor=AtOnce()) as follower:
        for _ in range(round(4.0 * plan.trajectory.duration / 0.005)):
            told = follower.step()
            least = min(least, float(keep.margins(told.state.q).min()))
            statuses.add(told.status.value)
            if told.done:
                break
    assert told.done
    assert least > -1e-3
    assert statuses == {"following", "arrived"}


@pytest.mark.parametrize("dt", [0.06, 0.1])
def test_a_machine_that_is_held_keeps_its_bucket_level_in_long_steps_too(level_plan: bp.Plan, dt: float) -> None:
    """In one step it slides so that the bucket tips by 20 degrees a second more; the boom needs 0.5 s to stop."""
    plan, keep = level_plan, level_plan.problem.keep
    assert keep is not None
    servo = bp.Servo(plan.robot, plan.scene, dt, q=plan.trajectory.q[0])
    with bp.PlanFollower(servo, plan, executor=AtOnce()) as follower:
        postures = [follower.step().state.q for _ in range(round(2.0 * plan.trajectory.duration / dt))]
    assert min(float(keep.margins(q).min()) for q in postures) > -1e-3
    assert servo.last_error is None


def test_holding_a_machine_stops_a_tipping_bucket_before_the_boom(backhoe: bp.Robot) -> None:
    """A condition on the pitch, the sum of three angles; the bucket alone changes its rate by 0.3 rad/s in a step."""
    keep, limits, dt = keep_of(backhoe, level_scene()), backhoe.limits, 0.1
    assert keep is not None
    q, v = np.array(A) + np.array([0.0, 0.0, 0.0, -0.008]), np.array([0.2, -0.2, 0.0, 0.05])
    held = held_velocity(keep, limits, q, v, dt)
    assert float(held[1:].sum()) == pytest.approx(0.0, abs=1e-9)
    assert (np.abs(held - v) <= limits.acceleration * dt + 1e-12).all()
    np.testing.assert_array_equal(held_velocity(keep, limits, q, np.zeros(4), dt), np.zeros(4))
    slow = np.array([0.2, 0.01, 0.0, 0.0])  # it tips by 0.01 rad/s * 0.4 s / 2 until it rests, where 0.018 rad are left
    np.testing.assert_allclose(held_velocity(keep, limits, q, slow, dt), slow * (1.0 - dt / 0.4), atol=1e-12)


def test_the_plan_goes_on_only_as_fast_as_braking_straight_ahead_keeps_the_band(backhoe: bp.Robot) -> None:
    """The bucket turns at the edge of the band while the swing still needs 0.75 s to stop."""
    scene = level_scene()
    keep = keep_of(backhoe, scene)
    assert keep is not None
    time = np.linspace(0.0, 4.0, 401)
    part = time / 4.0
    blend = 10 * part**3 - 15 * part**4 + 6 * part**5
    q = np.array(A) + blend[:, None] * (np.array(B) - A)
    q[:, 3] += 0.0095 * np.sin(2.0 * np.pi * time / 0.8) * (4.0 * part * (1.0 - part)) ** 2
    reference = Reference(bp.Trajectory.from_steps(time, q), backhoe.limits)
    screen = ClearanceScreen(bp.Proximity(backhoe, []))
    paces = BrakingPace(reference, backhoe.limits, [PlanPart(0.0, StopRule(keep, screen))])
    slowest = 1.0
    for moment in np.linspace(0.2, 3.8, 181).tolist():
        pace = paces.at(moment)
        slowest = min(slowest, pace)
        v = pace * reference_rates(reference, moment)
        end = reference.at(moment) + 0.5 * v * float(np.max(np.abs(v) / (BRAKING * backhoe.limits.acceleration)))
        assert pace <= 0.1 or float(keep.margins(end).min()) > -5e-4
    assert slowest < 0.5
    free = BrakingPace(reference, backhoe.limits, [PlanPart(0.0, None)])
    assert {free.at(moment) for moment in (0.0, 1.3, 4.0)} == {1.0}


def reference_rates(reference: Reference, moment: float) -> np.ndarray:
    """(n,) the rates of the reference at `moment` [s]."""
    return np.asarray((reference.at(moment + 1e-4) - reference.at(moment - 1e-4)) / 2e-4)


def test_a_motion_of_one_sample_has_a_pace(backhoe: bp.Robot) -> None:
    rest = bp.Trajectory.from_steps(np.zeros(1), np.array([A]))
    screen = ClearanceScreen(bp.Proximity(backhoe, []))
    keep = keep_of(backhoe, level_scene())
    assert keep is not None
    parts = [PlanPart(0.0, StopRule(keep, screen))]
    assert BrakingPace(Reference(rest, backhoe.limits), backhoe.limits, parts).at(0.0) == 1.0


@pytest.mark.parametrize(("beside", "stops"), [(0.006, True), (0.002, False)])
def test_the_machine_stops_before_a_slow_joint_carries_it_out_of_the_band(
    backhoe: bp.Robot, beside: float, stops: bool
) -> None:
    """All joints brake in proportion: while a swing of v comes to rest, the pitch, at 0.01 rad/s, moves on."""
    keep = keep_of(backhoe, level_scene())
    assert keep is not None
    reference = Reference(straight(), backhoe.limits)
    reference.clock = 2.0
    rates = reference_rates(reference, 2.0)
    q, v = reference.at(2.0), rates.copy()
    q[3] += beside  # the bucket alone: the pitch is -2.7 plus this, and at most -2.69 is allowed
    v[3] += 0.01
    assert rates[0] == pytest.approx(0.469, abs=1e-3)  # 15/8 of 1 rad in 4 s; the joint that needs longest to stop
    end = beside + 0.5 * 0.01 * rates[0] / (BRAKING * backhoe.limits.acceleration[0])
    assert bool(end > 0.01) is stops
    assert keep.holds(q)
    pace = KeptFollowing(keep, backhoe.limits).pace(q, v, reference, rates)
    assert (pace == 0.0) is stops


def test_a_machine_that_stops_for_a_crate_close_by_keeps_its_bucket_level(level_plan: bp.Plan) -> None:
    """The crate leaves no room to stop along the plan; if all joints braked in proportion, it would tip by 10 deg."""
    plan, keep = level_plan, level_plan.problem.keep
    assert keep is not None
    crate = {
        "name": "crate", "shape": "box", "size": [0.41, 0.36, 0.39], "rpy": [-0.39, -0.27, -0.52],
        "position": [1.19, 2.01, 1.58],
    }  # fmt: skip
    servo, margins = bp.Servo(plan.robot, plan.scene, 0.01, q=plan.trajectory.q[0]), []
    with bp.PlanFollower(servo, plan, executor=AtOnce()) as follower:
        while follower.step().plan_time < 1.72:
            pass
        servo.add(crate)
        for _ in range(150):
            step = follower.step()
            margins.append(float(keep.margins(servo.q).min()))
            if not servo.v.any():
                break
    assert step.reason.endswith("a way round is searched for")
    assert min(margins) > 0.0


def test_a_machine_that_is_stopped_by_hand_on_its_plan_keeps_its_bucket_level(level_plan: bp.Plan) -> None:
    """Nothing is in the way. Braking straight ahead would tip the bucket, so it stops along the plan."""
    keep, motion = level_plan.problem.keep, level_plan.trajectory
    assert keep is not None
    servo, least = bp.Servo(level_plan.robot, level_plan.scene, 0.01, q=motion.q[0]), np.inf
    with bp.PlanFollower(servo, level_plan, executor=AtOnce()) as follower:
        while follower.step().plan_time < 0.5 * motion.duration:
            pass
        while servo.v.any():
            servo.step(joint_velocity=np.zeros(4))
            least = min(least, float(keep.margins(servo.q).min()))
    assert least > -1e-5


def test_at_a_pace_of_0_a_machine_waits_on_its_plan_and_loses_no_more_time(level_plan: bp.Plan) -> None:
    motion = level_plan.trajectory
    servo = bp.Servo(level_plan.robot, level_plan.scene, 0.01, q=motion.q[0])
    with bp.PlanFollower(servo, level_plan, executor=AtOnce()) as follower:
        while follower.step().plan_time < 0.5 * motion.duration:
            pass
        while servo.v.any():
            step = follower.step(pace=0.0)
        for _ in range(200):  # longer than its patience
            step = follower.step(pace=0.0)
            assert (step.status.value, step.reason) == ("waiting", "a pace of 0 is asked for")
        assert step.deviation < 1e-6
        behind = follower.step().behind
        while not step.done:
            step = follower.step()
            assert step.deviation < 1e-6
    # no joint of this plan needs longer than 1 s to gather its speed anew
    assert behind < step.behind < behind + 1.0
    with pytest.raises(bp.InputError, match="pace"):
        follower.step(pace=1.5)


def test_a_machine_outside_the_band_returns_by_the_shortest_way(backhoe: bp.Robot) -> None:
    """The pitch is the sum of three angles, 0.05 too large: of all joints these three share the way back equally."""
    keep = keep_of(backhoe, level_scene())
    assert keep is not None
    q, v = np.array([*A[:3], A[3] + 0.06]), np.zeros(4)
    back = velocity_back(keep, backhoe.limits, q, 0.01)
    assert back is not None
    np.testing.assert_allclose(back[1:], back[1], rtol=1e-6)
    assert back[0] == 0.0
    # 0.0501 rad on three joints; the slowest to brake may use half of its acceleration for it
    way, slowest = (0.05 + 1e-4) / 3.0, float(backhoe.limits.acceleration[1:].min())
    assert back[1] == pytest.approx(-np.sqrt(slowest * way), rel=1e-6)
    kept = KeptFollowing(keep, backhoe.limits)
    np.testing.assert_array_equal(kept.held(q, v, 0.01), back)
    assert kept.returns
    assert "the machine returns" in kept.lost(evades=False)
    inside = np.array(A)
    np.testing.assert_array_equal(kept.held(inside, v, 0.01), np.zeros(4))
    assert not kept.returns


def test_a_machine_in_something_that_stands_still_comes_out_with_its_bucket_level(backhoe: bp.Robot) -> None:
    """A box is put onto the bucket while the machine rests at the start of its motion."""
    motion, scene = straight(), level_scene()
    keep = keep_of(backhoe, scene)
    assert keep is not None
    servo = bp.Servo(backhoe, scene, 0.01, q=motion.q[0])
    tip = bp.Kinematics(backhoe).at(motion.q[0]).tip_position
    place = tip + np.array([0.25, 0.0, 0.1])
    servo.add({"name": "box", "shape": "box", "size": [0.3, 0.3, 0.3], "position": place.tolist()})
    margins, least = [], np.inf
    with bp.PlanFollower(servo, motion, executor=AtOnce()) as follower:
        for _ in range(150):
            margins.append(follower.step().state.margin)
            least = min(least, float(keep.margins(servo.q).min()))
    assert margins[0] < -0.01
    assert margins[-1] > -1e-4
    assert least > -1e-3


@pytest.mark.parametrize(("kept", "holds"), [([[0.0, 1.0, 1.0, 1.0]], True), (np.eye(4).tolist(), False)])
def test_what_is_kept_holds_on_the_way_out_if_it_leaves_one(backhoe: bp.Robot, kept: Any, holds: bool) -> None:
    """A box is put onto the bucket. There is a way out with the pitch as it is, and none with every joint as it is."""
    servo = bp.Servo(backhoe, level_scene(), 0.01, q=np.array(A))
    tip = bp.Kinematics(backhoe).at(servo.q).tip_position
    place = (tip + np.array([0.25, 0.0, 0.1])).tolist()
    servo.add({"name": "box", "shape": "box", "size": [0.3, 0.3, 0.3], "position": place})
    G = np.vstack((kept, -np.array(kept)))
    rows = KeptRows(G, np.zeros(len(G)), np.zeros((0, 4)), Rows.none("keep", 4), firm=False)
    states = [servo.step_keeping_unchecked(np.zeros(4), rows) for _ in range(30)]
    changes = np.array([np.abs(G @ state.v).max() for state in states])
    assert states[-1].margin > states[0].margin + 1e-3
    assert states[-1].margin < 0.0
    assert bool(changes.max() < 1e-6) is holds
