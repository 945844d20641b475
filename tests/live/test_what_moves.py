"""Obstacles that move: when the machine gives way, when it does not, and what it says if it could not."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from executors import Never
from machines import Axis, load_chain

import backhoe_planner as bp
from backhoe_planner.live import Status
from backhoe_planner.machine import shipped_folder
from backhoe_planner.site import Proximity

DT = 0.02


@pytest.fixture(scope="module")
def slide(tmp_path_factory: pytest.TempPathFactory) -> bp.Robot:
    """A ball of radius 0.1 m that slides along x from -5 to 5 m, at up to 1 m/s."""
    folder: Path = tmp_path_factory.mktemp("slide")
    return load_chain(folder, [Axis("prismatic", "1 0 0", -5.0, 5.0)], ball=0.1)


def slide_scene(acceleration: float) -> bp.Scene:
    return bp.scene_from_dict(
        {
            "version": 1, "start": {"joints": {"joint0": 0.0}}, "task": {"goal": {"joints": {"joint0": 1.0}}},
            "clearance": 0.05, "limits": {"acceleration": {"joint0": acceleration}},
        }
    )  # fmt: skip


def thrown(servo: bp.Servo, at: list[float], velocity: list[float], radius: float = 0.1) -> Proximity:
    """A ball that moves in a straight line, and the distances from it."""
    servo.add({"name": "ball", "shape": "sphere", "radius": radius, "position": at})
    servo.set_velocity("ball", velocity)
    ball = [one for one in servo.snapshot() if one.name == "ball"]
    return Proximity(servo.robot, ball, self_collision=False)


def test_a_slow_machine_gives_way_in_time_to_what_comes_fast(slide: bp.Robot) -> None:
    """At 0.5 m/s^2 it needs 1.2 s to be as fast as the ball, 0.6 m/s, which comes 0.36 m nearer meanwhile.

    That is farther than the influence distance of 0.3 m. Running away at 0.6 m/s, it is at 3 m after 5.6 s.
    """
    servo, least = bp.Servo(slide, slide_scene(0.5), DT), np.inf
    distances = thrown(servo, [-1.5, 0.0, 0.0], [0.6, 0.0, 0.0])
    for step in range(250):
        state = servo.step(joint_velocity=[0.0])
        least = min(least, float(distances.distances(state.q, time=(step + 1) * DT).min()))
    assert least > 0.05 - 1e-4
    assert state.q[0] > 1.0


def test_a_machine_does_not_evade_what_has_gone_by() -> None:
    """A ball passes a Panda at 1 m/s, 0.2 m beside its hand. Once it is farther and leaves, nothing is evaded."""
    scene = bp.load_scene(shipped_folder("scenes") / "cup.yaml")
    robot = bp.load_robot("example:panda", tip=scene.tip)
    servo = bp.Servo(robot, scene, DT)
    tip = bp.Kinematics(servo.robot).at(servo.q).tip_position
    distances = thrown(servo, (tip + np.array([0.3, -1.0, 0.1])).tolist(), [0.0, 1.0, 0.0], 0.05)
    after = []
    for step in range(140):
        state = servo.step(joint_velocity=np.zeros(7))
        away = float(distances.distances(state.q, time=(step + 1) * DT).min())
        if step * DT > 1.0 and away > 0.35:
            after.append(state.status)
    assert len(after) > 40
    assert Status.EVADING not in after


def test_a_clearance_that_is_lost_is_told_with_the_obstacle_and_the_distance(slide: bp.Robot) -> None:
    """A ball comes at 3 m/s; the machine reaches 1 m/s at most, so that it does not run away from afar."""
    servo, lost = bp.Servo(slide, slide_scene(0.5), DT), []
    distances = thrown(servo, [-1.5, 0.0, 0.0], [3.0, 0.0, 0.0])
    for step in range(80):
        state = servo.step(joint_velocity=[0.0])
        short = float(distances.distances(state.q, time=(step + 1) * DT).min()) - 0.05
        lost.append(short < -1e-3)
        assert short < 0.35 or state.v[0] == 0.0
        assert (state.status is Status.TOO_CLOSE) == lost[-1]
        if lost[-1]:
            assert state.nearest is not None
            assert state.nearest.name == "ball"
            assert state.margin == pytest.approx(short, abs=1e-5)
    assert 3 < sum(lost) < 40


def test_a_follower_says_that_a_clearance_is_lost(slide: bp.Robot) -> None:
    servo = bp.Servo(slide, slide_scene(0.5), DT)
    thrown(servo, [-1.5, 0.0, 0.0], [3.0, 0.0, 0.0])
    motion = bp.Trajectory.from_steps(np.linspace(0.0, 4.0, 81), np.zeros((81, 1)))
    with bp.PlanFollower(servo, motion, executor=Never()) as follower:
        steps = [follower.step() for _ in range(40)]
    lost = [step for step in steps if step.state.status is Status.TOO_CLOSE]
    assert lost
    assert all("ball" in step.reason.split(";")[0] for step in lost)


@pytest.fixture(scope="module")
def cup() -> bp.Plan:
    """A plan of least time, whose straight braking lines tilt the cup too far."""
    return planned_cup(0)


@functools.cache
def planned_cup(seed: int) -> bp.Plan:
    scene = bp.load_scene(shipped_folder("scenes") / "cup.yaml")
    plan = bp.plan(bp.load_robot("example:panda", tip=scene.tip), scene, effort="quick", seed=seed)
    assert plan.verified, plan.message
    return plan


@pytest.mark.parametrize("moment", [1.0, 1.5, 4.0])  # s: at the last two the machine can only stop along its track
def test_a_machine_that_stops_along_its_track_says_what_it_touches(cup: bp.Plan, moment: float) -> None:
    """A ball of radius 0.03 m is put onto the tip, 0.06 m too close."""
    servo, clearance, told = bp.Servo(cup.robot, cup.scene, DT, q=cup.trajectory.q[0]), cup.scene.clearance, 0
    with bp.PlanFollower(servo, cup, executor=Never()) as follower:
        while servo.time < moment:
            follower.step()
        tip = bp.Kinematics(servo.robot).at(servo.q).tip_position
        distances = thrown(servo, tip.tolist(), [0.0, 0.0, 0.0], 0.03)
        for _ in range(15):
            state = follower.step().state
            short = float(distances.distances(state.q).min()) - clearance
            assert (state.status is Status.TOO_CLOSE) == (short < -1e-3)
            if state.status is Status.TOO_CLOSE:
                told += 1
                assert state.margin == pytest.approx(short, abs=1e-5)
    assert told > 2


@pytest.mark.parametrize(
    ("place", "velocity", "late"),
    [
        ([6.0, 0.0, 1.0], [-0.3, 0.0, 0.0], False),  # 3.7 m away at the end of the plan, which takes 5 s
        ([1.5, 1.5, 1.0], [0.1, 0.1, 0.0], False),  # it leaves
        ([0.5, -2.0, 1.5], [0.0, 1.0, -0.4], True),  # it crosses the middle of the plan after 2 s
    ],
)
def test_a_machine_keeps_to_its_track_while_what_moves_cannot_reach_it(
    place: list[float], velocity: list[float], late: bool
) -> None:
    """It gives way to what comes late on a plan with room: whether it has to tilt the cup depends on the plan."""
    cup = planned_cup(2 if late else 0)
    servo, keep = bp.Servo(cup.robot, cup.scene, DT, q=cup.trajectory.q[0]), cup.problem.keep
    assert keep is not None
    distances = thrown(servo, place, velocity)
    deviation = least = 0.0
    nearest = np.inf
    with bp.PlanFollower(servo, cup, executor=Never()) as follower:
        for number in range(round(cup.trajectory.duration / DT) + 2):
            step = follower.step()
            deviation, least = max(deviation, step.deviation), min(least, float(keep.margins(servo.q).min()))
            if late and number % 5 == 0:
                nearest = min(nearest, float(distances.distances(servo.q, time=(number + 1) * DT).min()))
    assert step.done is not late
    assert least > -1e-3
    assert nearest > 0.02
    assert late or deviation < 1e-6


@pytest.mark.parametrize(
    ("change", "untrue"),
    [
        (lambda servo: servo.remove("early"), "late"),  # the pairs of what comes now have other numbers
        (lambda servo: servo.set_velocity("comer", [0.0, 0.0, 0.0]), "comer"),  # it stands
    ],
    ids=["another is removed", "it stops"],
)
def test_what_may_come_is_not_confused_after_a_change(
    cup: bp.Plan, change: Callable[[bp.Servo], None], untrue: str
) -> None:
    """Only the comer crosses the plan; the others creep 5 m away."""
    servo = bp.Servo(cup.robot, cup.scene, DT, q=cup.trajectory.q[0])
    for name, place, velocity in (
        ("early", [6.0, 0.0, 1.0], [0.0, 0.01, 0.0]),
        ("comer", [0.5, -2.0, 1.5], [0.0, 1.0, -0.4]),
        ("late", [7.0, 0.0, 1.0], [0.0, 0.01, 0.0]),
    ):
        servo.add({"name": name, "shape": "sphere", "radius": 0.05, "position": place, "velocity": velocity})
    with bp.PlanFollower(servo, cup, executor=Never()) as follower:
        named = set()
        for _ in range(60):
            follower.step()
            named.add(servo.reached_by)
        assert "comer" in named
        change(servo)
        after = set()
        for _ in range(20):
            follower.step()
            after.add(servo.reached_by)
    assert untrue not in after


@pytest.mark.parametrize(("beyond", "reached"), [(0.005, True), (0.02, False)])
def test_a_joint_that_turns_round_between_two_places_may_go_beyond_both(
    slide: bp.Robot, beyond: float, reached: bool
) -> None:
    """From 1 m/s it rests after 1 / 0.8 s, of which 1.5 times are looked at, in seven parts.

    In one of them it can turn round up to 1 m/s^2 (1.875 s / 7)^2 / 8 = 9 mm beyond its ends.
    """

    class Still:
        def places_within(self, time: float, count: int) -> np.ndarray:
            assert time == pytest.approx(1.5 / 0.8)
            return np.zeros((count, 1))

    servo = bp.Servo(slide, slide_scene(1.0), DT)
    thrown(servo, [0.25 + beyond, 0.0, 0.0], [-1e-6, 0.0, 0.0])  # two radii and the clearance are 0.25 m
    assert servo._approach.reaches(Still(), np.ones(1), 1) is reached
