"""Loads that the machine cannot hold where a motion begins and ends at rest."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Dynamics
from backhoe_planner.motion import build_problem, drive_of, limit_usage
from backhoe_planner.planning.search.effort import EFFORTS, Brake, Work
from backhoe_planner.planning.sequence.ends import WayPrices
from backhoe_planner.planning.world.held_load import HeldLoad
from backhoe_planner.planning.world.world import World

ACROSS = np.array([0.0, 0.2, -0.6, -0.4])  # far out, so that the load has a long lever
NEAR = np.array([0.0, 0.6, -2.0, -0.9])


def posture(robot: bp.Robot, q: Vector) -> dict[str, float]:
    return dict(zip(robot.joint_names, q.tolist(), strict=True))


def use_at_rest(robot: bp.Robot, q: Vector, payload: float) -> float:
    """The greatest static torque over what the joint's own limit and its cylinder allow in that direction."""
    torque = Dynamics(robot, payload=payload).torques(q, np.zeros(4), np.zeros(4))
    assert robot.hydraulics is not None
    oil = robot.hydraulics.torque_limits(q)
    allowed = np.minimum(np.where(torque > 0.0, oil.positive, oil.negative), robot.limits.effort)
    return float(np.max(np.abs(torque) / allowed))


def payload_for(robot: bp.Robot, q: Vector, use: float) -> float:
    """The payload [kg] with which the static torque is `use` times what is allowed at q, by bisection."""
    low, high = 0.0, 2e4
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if use_at_rest(robot, q, middle) < use else (low, middle)
    return low


def scene(robot: bp.Robot, begin: Vector, task: Any, payload: float, **more: Any) -> bp.Scene:
    asked = {"version": 1, "start": {"joints": posture(robot, begin)}, "task": task, "payload": payload}
    return bp.scene_from_dict(asked | more)


GOAL = {"goal": {"position": [3.0, 1.5, 0.5]}}


@pytest.mark.parametrize(
    ("task", "method"),
    [
        (GOAL, "auto"),
        (GOAL, "reactive"),
        (GOAL, "paper"),
        ({"path": {"waypoints": [{"position": [4.0, 0.0, 0.5]}, {"position": [3.0, 0.0, 0.5]}]}}, "optimal"),
        ({"sequence": [{"name": "lift", **GOAL}, {"name": "rest", "wait": 1.0}]}, "auto"),
    ],
)
def test_a_load_that_the_start_cannot_hold_is_refused_without_a_search(
    backhoe: bp.Robot, task: Any, method: str
) -> None:
    plan = bp.plan(backhoe, scene(backhoe, ACROSS, task, 4000.0), method=method)
    assert (plan.verdict, plan.reason) == ("failed", "outside_limits")
    assert np.all(plan.trajectory.q == ACROSS)
    assert "boom cannot hold the load at the start: it takes " in plan.message
    percent = re.search(r"\((\d+) % of it\)", plan.message)
    assert percent is not None
    assert float(percent[1]) == pytest.approx(100.0 * use_at_rest(backhoe, ACROSS, 4000.0), abs=0.5)
    most = re.search(r"the largest payload that it can hold there is (\S+) kg", plan.message)
    assert most is not None
    assert float(most[1]) == pytest.approx(payload_for(backhoe, ACROSS, 1.0), abs=0.5)


def test_a_load_that_the_start_can_just_hold_is_planned(backhoe: bp.Robot) -> None:
    goal = {"goal": {"joints": posture(backhoe, NEAR)}}
    plan = bp.plan(backhoe, scene(backhoe, ACROSS, goal, payload_for(backhoe, ACROSS, 0.99)), effort="quick")
    assert plan.verified, plan.message


def test_an_arm_that_cannot_hold_itself_says_so(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, scene(backhoe, ACROSS, GOAL, 0.0, limits={"effort": {"boom": 1000.0}}))
    assert plan.reason == "outside_limits"
    assert plan.message.endswith("the machine cannot hold its own weight there")


@pytest.mark.parametrize("which", ["start", "end"])
def test_an_arm_that_drops_at_once_or_stops_late_must_hold_its_load_at_rest_too(backhoe: bp.Robot, which: str) -> None:
    """At a start that it cannot hold, a boom that falls takes less torque, and so does one that rises to a stop."""
    payload = payload_for(backhoe, ACROSS, 1.03)
    low = ACROSS - np.array([0.0, 0.4, 0.0, 0.0])
    part = np.linspace(0.0, 1.0, 61)[:, None]
    way = ACROSS + (3.0 * part**2 - 2.0 * part**3) * (low - ACROSS)
    q = way if which == "start" else way[::-1]
    goal = {"goal": {"joints": posture(backhoe, q[-1])}}
    motion = bp.Trajectory.from_steps(2.0 * part[:, 0], q)
    problem = build_problem(backhoe, scene(backhoe, q[0], goal, payload))
    row = 0 if which == "start" else -1
    dropping = Dynamics(backhoe, payload=payload).torques(q[row], np.zeros(4), motion.corner_accelerations()[row])
    assert 0.0 < dropping[1] < drive_of(problem).torque_limits(q[row]).positive[1]
    usage = limit_usage(problem, motion)
    assert usage.ratio[row, usage.names.index("torque boom")] == pytest.approx(1.03, abs=1e-6)


def test_the_certificate_of_an_arm_at_rest_gives_the_torque_that_holds_it(backhoe: bp.Robot) -> None:
    payload = payload_for(backhoe, ACROSS, 1.03)
    part = np.linspace(0.0, 1.0, 61)[:, None]
    folded = np.array([0.0, 0.0, -1.0, 0.0])  # the lever becomes shorter, so that the start is worst
    motion = bp.Trajectory.from_steps(6.0 * part[:, 0], ACROSS + (3.0 * part**2 - 2.0 * part**3) * folded)
    goal = {"goal": {"joints": posture(backhoe, motion.q[-1])}}
    found = bp.certify(backhoe, scene(backhoe, ACROSS, goal, payload), motion)
    torque = Dynamics(backhoe, payload=payload).torques(ACROSS, np.zeros(4), np.zeros(4))
    assert found.effort is not None
    assert (found.effort.joint, found.effort.time) == ("boom", 0.0)
    assert found.effort.needed == pytest.approx(torque[1])
    assert found.effort.ratio == pytest.approx(1.03, abs=1e-6)
    assert found.problems[-1].startswith("boom cannot hold the load at 0.00 s: it takes ")


def plan_to_the_second(robot: bp.Robot, begin: Vector, goals: list[Any], payload: float) -> bp.Plan:
    """A verified plan to the second of two goals, from where the load is held."""
    assert use_at_rest(robot, begin, payload) < 1.0
    plan = bp.plan(robot, scene(robot, begin, {"goal": goals}, payload), effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.goal == 2
    return plan


def test_of_several_goals_those_count_on_which_the_load_is_held(backhoe: bp.Robot) -> None:
    """The posture far out is the nearer one, but the load is too heavy there."""
    payload = payload_for(backhoe, ACROSS, 1.05)
    assert use_at_rest(backhoe, NEAR, payload) < 1.0
    goals = [{"joints": posture(backhoe, ACROSS)}, {"joints": posture(backhoe, NEAR)}]
    plan = plan_to_the_second(backhoe, NEAR + np.array([0.6, 0.0, 0.0, 0.0]), goals, payload)
    assert "boom cannot hold the load at the goal 1: it takes " in plan.message


def test_a_goal_of_the_tip_in_no_posture_of_which_the_load_is_held_is_left_out(backhoe: bp.Robot) -> None:
    """A position far out leaves no choice, but another goal does."""
    payload = payload_for(backhoe, ACROSS, 1.3)
    far = bp.Kinematics(backhoe).at(ACROSS).tip_position.tolist()
    goals = [{"position": far}, {"position": [2.0, 0.5, 1.0]}]
    plan = plan_to_the_second(backhoe, NEAR + np.array([0.6, 0.2, -0.3, 0.0]), goals, payload)
    assert "no posture was found on the goal 1 in which the machine can hold its load" in plan.message


def test_a_goal_given_by_joints_that_cannot_hold_the_load_is_refused_without_a_search(backhoe: bp.Robot) -> None:
    payload = payload_for(backhoe, ACROSS, 1.05)
    goal = {"goal": {"joints": posture(backhoe, ACROSS)}}
    plan = bp.plan(backhoe, scene(backhoe, NEAR, goal, payload))
    assert plan.reason == "outside_limits"
    assert not plan.has_motion
    assert plan.message.startswith("boom cannot hold the load at the goal: it takes ")
    assert plan.findings.joints == ("boom",)


def test_a_start_of_the_tip_is_a_posture_that_holds_the_load(backhoe: bp.Robot) -> None:
    """With the tip high up, the bucket may point up or down, and the lever of the load differs by a third."""
    task = {"goal": {"joints": posture(backhoe, NEAR)}}
    given = scene(backhoe, NEAR, task, 1500.0, start={"tip": {"position": [4.2, 0.0, 2.8]}})
    plan = bp.plan(backhoe, given, effort="quick")
    assert use_at_rest(backhoe, plan.trajectory.q[0], 1500.0) <= 1.01
    assert plan.verified, plan.message


def test_a_slide_has_a_force_and_a_hinge_a_torque() -> None:
    slide = bp.LimitUse("torque", "slide", 1.5, 0.25, -1500.0, 1000.0, "N", 0.5)
    assert (
        slide.describe() == "slide has too little force for the motion at 0.25 s: it takes 1.5 kN of 1 kN (150 % of it)"
    )
    hinge = bp.LimitUse("torque", "hinge", 1.5, 0.25, -1500.0, 1000.0, "N m", 1.5)
    assert hinge.describe() == "hinge cannot hold the load at 0.25 s: it takes 1.5 kN m of 1 kN m (150 % of it)"


def test_a_load_that_is_held_within_the_tolerance_of_torques_is_not_said_not_to_be() -> None:
    """One per cent above the limit counts as kept, at rest too."""
    use = bp.LimitUse("torque", "hinge", 1.021, 0.02, 1021.0, 1000.0, "N m", 1.001)
    assert use.describe().startswith("hinge has too little torque for the motion at 0.02 s: ")


@pytest.mark.parametrize("objective", ["time", "work"])
def test_a_motion_to_a_pose_ends_in_a_posture_that_holds_the_load(backhoe: bp.Robot, objective: str) -> None:
    """The fastest and the cheapest postures on this goal, which is high and far out, are some that cannot hold it."""
    begin = np.array([0.28, 0.12, -0.23, -2.04])
    task = {"goal": {"position": [3.46, -0.99, 3.36]}}
    plan = bp.plan(backhoe, scene(backhoe, begin, task, 1770.0, objective=objective), effort="quick")
    assert use_at_rest(backhoe, plan.trajectory.q[-1], 1770.0) <= 1.01
    assert plan.verified, plan.message


def test_a_leg_that_takes_up_a_load_does_not_begin_where_that_cannot_be_held(backhoe: bp.Robot) -> None:
    """No motion is planned from such an end of the leg before."""
    goal = {"goal": {"joints": posture(backhoe, NEAR)}}
    problem = build_problem(backhoe, scene(backhoe, NEAR, goal, payload_for(backhoe, ACROSS, 1.05)))
    prices = WayPrices(World(problem, seed=0, work=Work(EFFORTS["quick"], Brake())))
    begins = (ACROSS, NEAR + np.array([0.5, 0.0, 0.0, 0.0]))
    assert [use_at_rest(backhoe, q, problem.scene.payload) < 1.01 for q in begins] == [False, True]
    np.testing.assert_array_equal(np.isfinite(prices.between(begins, (NEAR,)))[:, 0], [False, True])


def test_a_load_is_taken_up_in_a_posture_in_which_it_can_be_held(backhoe: bp.Robot) -> None:
    """The posture that the empty machine reaches first is one that holds 1,400 kg."""
    begin = np.array([0.28, 0.12, -0.23, -2.04])
    legs = [
        {"name": "out", "goal": {"position": [3.46, -0.99, 3.36]}},
        {"name": "back", "goal": {"joints": posture(backhoe, NEAR)}, "payload": 1500.0},
    ]
    plan = bp.plan(backhoe, scene(backhoe, begin, {"sequence": legs}, 0.0), effort="quick")
    assert plan.verified, plan.message
    first = plan.legs[0].trajectory.q[-1]
    assert use_at_rest(backhoe, first, 1500.0) <= 1.01


@pytest.mark.parametrize(("waits", "moves"), [(False, False), (True, False), (False, True)])
def test_a_load_that_is_taken_up_at_a_stop_is_not_there_while_the_arm_slows_down(
    backhoe: bp.Robot, waits: bool, moves: bool
) -> None:
    """The boom is lowered without a load and stops: with it, stopping so hard would take more than the boom has.

    While something moves, each leg is planned for the time at which it begins.
    """
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [9.0, -9.0, 4.0], "velocity": [0.0, 0.5, 0.0]}
    payload = payload_for(backhoe, ACROSS, 0.97)
    above, stop = ACROSS + np.array([0.0, 0.4, 0.0, 0.0]), {"name": "load", "wait": 0.5, "payload": payload}
    lower = {"name": "lower", "goal": {"joints": posture(backhoe, ACROSS)}}
    lift = {"name": "lift", "goal": {"joints": posture(backhoe, above)}, "payload": payload}
    task = {"sequence": [lower, *([stop] if waits else []), lift]}
    plan = bp.plan(backhoe, scene(backhoe, above, task, 0.0, obstacles=[ball] if moves else []), effort="quick")
    assert plan.verified, plan.message
    motion, taken = plan.trajectory, plan.legs[1].first
    deceleration = motion.corner_accelerations()[taken - 1]
    stopping = Dynamics(backhoe, payload=payload).torques(ACROSS, np.zeros(4), deceleration)
    assert stopping[1] > 1.01 * drive_of(plan.problem).torque_limits(ACROSS).positive[1]
    assert np.all(motion.q[taken] == motion.q[taken - 1])


@pytest.mark.parametrize("waits", [False, True])
def test_a_leg_ends_where_the_load_that_follows_can_be_held(backhoe: bp.Robot, waits: bool) -> None:
    """With the tip high up, the lever of the load differs by a third; the nearest postures there cannot hold it."""
    load = {"name": "load", "wait": 0.5, "payload": 1700.0} if waits else {"name": "load", "payload": 1700.0}
    load |= {} if waits else {"goal": {"joints": posture(backhoe, NEAR)}}
    task = {"sequence": [{"name": "out", "goal": {"position": [4.2, 0.0, 2.8]}}, load]}
    alone = bp.plan(backhoe, scene(backhoe, NEAR, {"goal": {"position": [4.2, 0.0, 2.8]}}, 0.0), effort="quick")
    assert use_at_rest(backhoe, alone.trajectory.q[-1], 1700.0) > 1.01
    plan = bp.plan(backhoe, scene(backhoe, NEAR, task, 0.0), effort="quick")
    assert plan.verified, plan.message
    assert use_at_rest(backhoe, plan.trajectory.q[plan.legs[0].last], 1700.0) < 1.01


@pytest.mark.parametrize("use", [1.001, 1.009])
@pytest.mark.parametrize("which", ["lift", "lower"])
def test_a_load_that_is_held_within_the_tolerance_of_torques_is_moved(
    backhoe: bp.Robot, which: str, use: float
) -> None:
    """Straight up from where it takes most torque, or down to there, as slowly as that needs."""
    low, high = ACROSS, ACROSS + np.array([0.0, 0.4, 0.0, 0.0])
    begin, end = (low, high) if which == "lift" else (high, low)
    task = {"goal": {"joints": posture(backhoe, end)}}
    plan = bp.plan(backhoe, scene(backhoe, begin, task, payload_for(backhoe, ACROSS, use)), effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.effort is not None
    assert use <= plan.certificate.effort.ratio + 1e-6


def test_the_torque_in_a_certificate_is_that_of_its_ratio(backhoe: bp.Robot) -> None:
    """Also where the velocity jumps: then the torque of the side on which it is greater counts."""
    payload = payload_for(backhoe, ACROSS, 0.8)
    rng = np.random.default_rng(7)
    for _ in range(6):
        corners = ACROSS + np.vstack((np.zeros(4), rng.uniform(-0.5, 0.5, (3, 4))))
        motion = bp.Trajectory.from_steps(np.array([0.0, 0.3, 0.8, 1.0]), corners)
        goal = {"goal": {"joints": posture(backhoe, corners[-1])}}
        problem = build_problem(backhoe, scene(backhoe, ACROSS, goal, payload))
        effort, usage = bp.certify(backhoe, problem.scene, motion).effort, limit_usage(problem, motion)
        assert effort is not None
        assert abs(effort.needed) / effort.available == pytest.approx(effort.ratio, rel=1e-9)
        allowed = drive_of(problem).torque_limits(usage.moments.q)
        most = np.where(usage.torque > 0.0, allowed.positive, allowed.negative)
        of_torques = [column for column, name in enumerate(usage.names) if name.startswith("torque ")]
        np.testing.assert_allclose(np.abs(usage.torque) / most, usage.ratio[:, of_torques], rtol=1e-9)


OUT, IN = np.array([-1.36, 1.38, -0.25, 0.34]), np.array([-0.31, 0.97, -1.07, -1.87])


@pytest.mark.parametrize("objective", ["time", "work"])
def test_a_motion_goes_round_postures_in_which_the_load_is_not_held(backhoe: bp.Robot, objective: str) -> None:
    """The load is held at both ends, but on the straight way the boom needs up to 118 % of its torque."""
    line = OUT + np.linspace(0.0, 1.0, 40)[:, None] * (IN - OUT)
    use = [use_at_rest(backhoe, q, 1835.0) for q in line]
    assert max(use[0], use[-1]) < 0.85
    assert max(use) == pytest.approx(1.18, abs=0.01)
    asked = scene(backhoe, OUT, {"goal": {"joints": posture(backhoe, IN)}}, 1835.0, objective=objective)
    plan = bp.plan(backhoe, asked, effort="quick")
    assert plan.verified, plan.message


def test_the_condition_that_a_load_is_held_has_the_slopes_of_the_static_torques(backhoe: bp.Robot) -> None:
    problem = build_problem(backhoe, scene(backhoe, OUT, GOAL, 1835.0))
    condition, rng, step = HeldLoad.of(problem), np.random.default_rng(3), 1e-6
    for _ in range(20):
        q = backhoe.random_q(rng)
        assert condition.values(q[None])[0] == pytest.approx(use_at_rest(backhoe, q, 1835.0))
        assert condition.margins(condition.values(q[None]))[0] == pytest.approx(condition.rows(q[None])[0].min())
        ends = q + step * np.vstack((np.eye(4), -np.eye(4)))
        margins = condition.rows(ends)[0]
        np.testing.assert_allclose(
            condition.rows(q[None])[1][0].T, (margins[:4] - margins[4:]) / (2.0 * step), atol=1e-5
        )


def test_a_load_is_held_beside_what_is_kept(backhoe: bp.Robot) -> None:
    """Samples are projected onto all conditions at once: the tilt of the tip, which is a cone, and the load."""
    keep = {"tilt": {"axis": [0, 0, 1], "direction": [0, 0, 1], "tolerance": 2.6}}
    task = {"goal": {"joints": posture(backhoe, IN), "keep": keep}}
    problem = build_problem(backhoe, scene(backhoe, OUT, task, 1835.0))
    kept = World(problem, seed=0, work=Work(EFFORTS["quick"], Brake())).keeping(HeldLoad.of(problem)).problem.keep
    assert kept is not None
    assert problem.keep is not None
    line = OUT + np.linspace(0.0, 1.0, 200)[:, None] * (IN - OUT)
    beyond = next(q for q in line if use_at_rest(backhoe, q, 1835.0) > 1.02)
    assert problem.keep.holds(beyond)
    found = kept.project(beyond, backhoe.limits.lower, backhoe.limits.upper)
    assert found is not None
    assert use_at_rest(backhoe, found, 1835.0) < 1.01
