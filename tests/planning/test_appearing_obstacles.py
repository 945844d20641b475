"""What is planned before an obstacle appears does not depend on it, and what follows keeps the limits of the drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import Problem, build_problem, drive_of, time_along
from backhoe_planner.planning.goals.goal_planning import ToGoal
from backhoe_planner.planning.moving_obstacles import plan_over_time
from backhoe_planner.planning.reactive.stepping import STEP, Stepper
from backhoe_planner.planning.result.findings import Findings
from backhoe_planner.planning.result.plan_file import Method
from backhoe_planner.planning.search.effort import EFFORTS, Brake, Work
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import certify_motion
from backhoe_planner.site import Obstacle, Proximity
from validation.independent_check import refutations

Data = dict[str, Any]

BRISK = {"swing": 2.0, "boom": 3.0, "stick": 4.0, "bucket": 6.0}  # rad/s^2: with a payload, torques bind


def scene(robot: bp.Robot, rng: np.random.Generator, **more: Any) -> Data:
    """Between two random postures, with a payload that makes torques bind."""
    start, goal = (dict(zip(robot.joint_names, robot.random_q(rng).tolist(), strict=True)) for _ in range(2))
    return {
        "version": 1, "start": {"joints": start}, "task": {"goal": {"joints": goal}}, "clearance": 0.03,
        "payload": 600.0, "limits": {"acceleration": BRISK},
    } | more  # fmt: skip


def plan(robot: bp.Robot, content: Data, *obstacles: Data, method: Method = "auto") -> bp.Plan:
    scene = bp.scene_from_dict(content | {"obstacles": list(obstacles)})
    return bp.plan(robot, scene, effort="quick", method=method)


def ball(robot: bp.Robot, motion: bp.Trajectory, at: float, rng: np.random.Generator, *, name: str = "ball") -> Data:
    """A ball that appears at a part of a motion, near the tip's place some way further on."""
    ahead = min(0.9, at + rng.uniform(0.15, 0.5)) * motion.duration
    place = Kinematics(robot).at(motion.at(ahead)).tip_position + rng.normal(0.0, 0.25, 3)
    radius = float(rng.uniform(0.12, 0.37))
    return {
        "name": name, "shape": "sphere", "radius": radius, "position": place.tolist(),
        "appears_at": at * motion.duration,
    }  # fmt: skip


def same_until(one: bp.Trajectory, other: bp.Trajectory, moment: float) -> bool:
    """Whether two motions have the same samples up to a moment, bit for bit."""
    counts = [np.count_nonzero(motion.time <= moment) for motion in (one, other)]
    return counts[0] == counts[1] and all(
        np.array_equal(getattr(one, name)[: counts[0]], getattr(other, name)[: counts[0]]) for name in ("time", "q")
    )


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 12))])
def test_the_motion_before_an_obstacle_appears_is_the_one_without_it(backhoe: bp.Robot, seed: int) -> None:
    rng = np.random.default_rng([21, seed])
    content = scene(backhoe, rng, objective=("time", "work", "velocity_norm")[seed % 3])
    alone = plan(backhoe, content)
    if not alone.verified:
        pytest.skip("nothing to disturb")
    first = ball(backhoe, alone.trajectory, rng.uniform(0.1, 0.5), rng)
    found = plan(backhoe, content, first)
    assert same_until(alone.trajectory, found.trajectory, first["appears_at"])
    assert not found.verified or refutations(found) == []
    if not found.verified:
        return
    second = ball(backhoe, found.trajectory, rng.uniform(0.3, 0.7), rng, name="second ball")
    again = plan(backhoe, content, first, second)
    assert same_until(found.trajectory, again.trajectory, second["appears_at"])
    assert not again.verified or refutations(again) == []


def test_a_goal_is_not_reached_sooner_because_something_will_appear_on_it(backhoe: bp.Robot) -> None:
    """A motion of little cost takes all the time that is allowed; just before its end a ball appears on the goal."""
    content = scene(backhoe, np.random.default_rng([22, 2]), objective="velocity_norm", payload=0.0)
    alone = plan(backhoe, content)
    assert alone.verified
    moment = alone.trajectory.duration - 0.1
    tip = Kinematics(backhoe).at(alone.trajectory.q[-1]).tip_position
    found = plan(
        backhoe, content,
        {"name": "ball", "shape": "sphere", "radius": 0.1, "position": tip.tolist(), "appears_at": moment},
    )  # fmt: skip
    assert same_until(alone.trajectory, found.trajectory, moment)
    assert not found.verified


def test_of_obstacles_that_appear_together_the_one_in_the_way_is_named(backhoe: bp.Robot) -> None:
    content = scene(backhoe, np.random.default_rng([22, 2]), objective="time", payload=0.0)
    alone = plan(backhoe, content)
    moment = 0.5 * alone.trajectory.duration
    tip = Kinematics(backhoe).at(alone.trajectory.q[-1]).tip_position
    there = {"name": "on the goal", "shape": "sphere", "radius": 0.1, "position": tip.tolist(), "appears_at": moment}
    far = there | {"name": "far away", "position": [0.0, 0.0, 20.0]}
    [reaction] = plan(backhoe, content, far, there).findings.reactions
    assert reaction.obstacle == "on the goal"


START = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
ENDS = [[3.6, 0.6, 0.4], [3.2, 1.6, 0.6]]
PATH: Data = {"version": 1, "task": {"path": {"waypoints": [{"position": at} for at in ENDS]}}, "clearance": 0.05}


@pytest.fixture(scope="module")
def alone(backhoe: bp.Robot) -> bp.Plan:
    """Along the path, with no obstacle."""
    found = plan(backhoe, PATH)
    assert found.verified
    return found


def test_a_path_begun_anywhere_is_the_one_without_what_appears(backhoe: bp.Robot, alone: bp.Plan) -> None:
    """Not even the posture at its beginning is chosen with an obstacle in mind that appears later."""
    moment = 0.3 * alone.trajectory.duration
    tip = Kinematics(backhoe).at(alone.trajectory.q[-1]).tip_position
    above = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [*tip[:2].tolist(), float(tip[2]) + 0.5]}
    found = plan(backhoe, PATH, above | {"appears_at": moment})
    assert same_until(alone.trajectory, found.trajectory, moment)


@pytest.mark.long
def test_a_path_begun_anywhere_does_not_depend_on_what_appears_after_it(backhoe: bp.Robot, alone: bp.Plan) -> None:
    tip = Kinematics(backhoe).at(alone.trajectory.q[-1]).tip_position
    late = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": tip.tolist(), "appears_at": 99.0}
    assert same_until(plan(backhoe, PATH, late).trajectory, alone.trajectory, 99.0)


def test_what_appears_while_the_machine_brakes_for_another_obstacle_counts_although_the_task_fails(
    backhoe: bp.Robot, alone: bp.Plan
) -> None:
    """The first ball covers the end of the path, the second what is left of the way to it."""
    moment = 0.3 * alone.trajectory.duration
    tip = Kinematics(backhoe).at(alone.trajectory.q[-1]).tip_position
    first = {"name": "first", "shape": "sphere", "radius": 0.15, "position": tip.tolist(), "appears_at": moment}
    failed = plan(backhoe, PATH, first)
    assert failed.reason == "blocked"
    [reaction] = failed.findings.reactions
    assert reaction.stopped_at is not None
    assert failed.trajectory.duration > reaction.stopped_at + 0.1  # it goes on up to where the path is blocked
    there = Kinematics(backhoe).at(failed.trajectory.q[-1]).tip_position
    second = first | {"name": "second", "position": there.tolist(), "appears_at": reaction.stopped_at - 0.01}
    found = plan(backhoe, PATH, first, second)
    assert [one.obstacle for one in found.findings.reactions][:2] == ["first", "second"]


def test_of_many_obstacles_that_appear_only_the_new_one_is_looked_at(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sixty balls appear high above, one after the other: the obstacles that are looked at again do not add up."""
    looked_at: list[int] = []
    among = World.among

    def counted(world: World, obstacles: Sequence[Obstacle]) -> World:
        looked_at.append(len(obstacles))
        return among(world, obstacles)

    monkeypatch.setattr(World, "among", counted)
    content = scene(backhoe, np.random.default_rng([22, 2]), objective="time", payload=0.0)
    above = [
        {
            "name": f"ball {k}",
            "shape": "sphere",
            "radius": 0.1,
            "position": [0.0, 0.0, 20.0],
            "appears_at": 0.02 * k + 0.01,
        }
        for k in range(60)
    ]
    assert plan(backhoe, content, *above).verified
    assert len(looked_at) > 60
    assert sum(looked_at) < 3 * 60  # of all 60 every time: 1,830


def stepper(robot: bp.Robot) -> tuple[Problem, Stepper]:
    content = scene(robot, np.random.default_rng(0), start={"joints": dict.fromkeys(robot.joint_names, -0.3)})
    problem = build_problem(robot, bp.scene_from_dict(content))
    proximity = Proximity(robot, problem.obstacles)
    assert problem.start_q is not None
    return problem, Stepper(problem, problem.start_q, proximity=proximity, kinematics=Kinematics(robot))


@pytest.mark.parametrize("period", [STEP, 1.01 * STEP, 5.0 * STEP])
def test_a_step_after_samples_that_are_far_apart_keeps_the_accelerations(backhoe: bp.Robot, period: float) -> None:
    """Velocities change within the period of samples, however long the last segment was."""
    problem, machine = stepper(backhoe)
    time = np.arange(4.0) * period
    motion = bp.Trajectory.from_steps(time, np.asarray(machine.q + 0.1 * time[:, None], dtype=np.float64))
    machine.replay(motion, float(time[-1]))
    machine.advance(np.full(4, -9.0), machine.look()[1], np.zeros((3, 4)))
    found = machine.trajectory()
    change = np.abs(found.velocity_changes()[-2]) / STEP
    assert np.all(change <= problem.limits.acceleration * (1.0 + 1e-6))
    assert np.max(change / problem.limits.acceleration) > 0.5


def test_a_step_after_a_rest_keeps_the_accelerations(backhoe: bp.Robot) -> None:
    problem, machine = stepper(backhoe)
    machine.rest(3.0)
    machine.advance(np.full(4, 9.0), machine.look()[1], np.zeros((3, 4)))
    assert np.all(np.abs(machine.v) <= problem.limits.acceleration * STEP * (1.0 + 1e-6))


def test_a_sequence_does_not_depend_on_what_appears_out_of_its_way(backhoe: bp.Robot) -> None:
    """Its legs go over into each other, and their ends are chosen together, as without it."""
    legs: list[Data] = [
        {"goal": {"position": place, "tolerance": 0.1}} for place in ([4.0, 1.0, 0.3], [3.0, 2.8, 0.6], [1.5, 4.0, 0.5])
    ]
    named = [{"name": f"leg {number}"} | leg for number, leg in enumerate(legs)]
    content = {"version": 1, "start": {"joints": START}, "task": {"sequence": named}, "clearance": 0.05}
    alone = plan(backhoe, content)
    assert alone.verified
    for at in (0.5, 900.0):
        far = {"name": "far", "shape": "sphere", "radius": 0.3, "position": [-9.0, -9.0, 1.0], "appears_at": at}
        found = plan(backhoe, content, far)
        assert found.verified
        assert found.problem.is_dynamic
        assert refutations(found) == []
        for name in ("time", "q"):
            np.testing.assert_array_equal(getattr(found.trajectory, name), getattr(alone.trajectory, name))


def test_a_sequence_among_what_appears_in_its_way_is_planned_around_it(backhoe: bp.Robot) -> None:
    goals = ([4.0, 1.0, 0.3], [1.5, 4.0, 0.5])
    legs = [{"name": f"to {place[0]}", "goal": {"position": place}} for place in goals]
    content = {"version": 1, "start": {"joints": START}, "task": {"sequence": legs}, "clearance": 0.05}
    alone = plan(backhoe, content)
    place = Kinematics(backhoe).at(alone.trajectory.at(0.75 * alone.trajectory.duration)).tip_position.tolist()
    sudden = {"name": "ball", "shape": "sphere", "radius": 0.25, "position": place, "appears_at": 1.0}
    found = plan(backhoe, content, sudden)
    assert not bp.certify(backhoe, found.scene, alone.trajectory).verified
    assert found.verified
    assert refutations(found) == []


@pytest.mark.parametrize("velocity", [[0.0, 0.5, 0.0], pytest.param([-0.5, 0.0, 0.0], marks=pytest.mark.long)])
def test_a_machine_that_waits_gives_way_as_soon_as_something_appears(backhoe: bp.Robot, velocity: list[float]) -> None:
    """It waits for 9 s without a sample in between; at 2 s a ball appears that moves to where the tip is."""
    begin = np.array(list(START.values()))
    tip = Kinematics(backhoe).at(begin).tip_position
    place = tip - 1.6 * np.array(velocity) / np.linalg.norm(velocity)
    ball = {
        "name": "ball", "shape": "sphere", "radius": 0.3, "position": place.tolist(), "velocity": velocity,
        "appears_at": 2.0,
    }  # fmt: skip
    content = {
        "version": 1, "start": {"joints": START}, "task": {"goal": {"joints": START | {"swing": 0.8}}},
        "objective": "time", "clearance": 0.1, "obstacles": [ball],
    }  # fmt: skip
    problem = build_problem(backhoe, bp.scene_from_dict(content))
    stations = np.linspace(0.0, 1.0, 5)
    over = time_along(stations, begin + stations[:, None] * [0.8, 0.0, 0.0, 0.0], problem.limits)
    waiting = bp.Trajectory.from_steps(np.append(0.0, 9.0 + over.time), np.vstack((begin, over.q)))
    world = World(problem, seed=0, work=Work(EFFORTS["quick"], Brake()))
    known = Outcome(waiting, findings=Findings(waits=9.0))
    found = plan_over_time(world, ToGoal(problem.goals), world.stepper(begin), known=known)
    [reaction] = found.findings.reactions
    assert reaction.stopped_at == 2.0  # it stands already
    assert found.findings.waits == 2.0
    assert not certify_motion(problem, waiting).verified
    assert certify_motion(problem, found.trajectory).verified


def test_what_appears_just_at_the_end_of_a_motion_is_reported_as_what_appears_before(backhoe: bp.Robot) -> None:
    """The machine stands in a ball from its last sample on, where no reaction helps."""
    begin, over = np.array(list(START.values())), np.array([0.1, 0.0, 0.0, 0.0])
    goal = dict(zip(START, (begin + over).tolist(), strict=True))
    content = {"version": 1, "start": {"joints": START}, "task": {"goal": {"joints": goal}}, "objective": "time"}
    motion = time_along(np.arange(2.0), np.array([begin, begin + over]), backhoe.limits)
    ball = {
        "name": "ball", "shape": "sphere", "radius": 0.2, "appears_at": motion.duration,
        "position": Kinematics(backhoe).at(begin + over).tip_position.tolist(),
    }  # fmt: skip
    problem = build_problem(backhoe, bp.scene_from_dict(content | {"obstacles": [ball]}))
    world = World(problem, seed=0, work=Work(EFFORTS["quick"], Brake()))
    found = plan_over_time(world, ToGoal(problem.goals), world.stepper(begin), known=Outcome(motion))
    assert found.reason == "blocked"
    [reaction] = found.findings.reactions
    assert (reaction.obstacle, reaction.appears_at, reaction.way) == ("ball", motion.duration, "")
    assert "from the first moment on" in found.message


@pytest.mark.parametrize("seed", [pytest.param(1, marks=pytest.mark.long), 4])
def test_the_law_alone_does_not_know_what_will_appear(backhoe: bp.Robot, seed: int) -> None:
    """What appears after its end changes nothing; before a ball appears on its way it moves as without it."""
    rng = np.random.default_rng([23, seed])
    content = scene(backhoe, rng, payload=0.0)
    alone = plan(backhoe, content, method="reactive")
    assert alone.verified
    late = ball(backhoe, alone.trajectory, 0.5, rng) | {"appears_at": alone.trajectory.duration + 1.0}
    found = plan(backhoe, content, late, method="reactive")
    assert found.verified
    assert same_until(found.trajectory, alone.trajectory, 99.0)
    sudden = ball(backhoe, alone.trajectory, 0.4, rng)
    found = plan(backhoe, content, sudden, method="reactive")
    assert same_until(found.trajectory, alone.trajectory, sudden["appears_at"])
    [reaction] = found.findings.reactions
    assert reaction.obstacle == "ball"


def test_a_machine_that_gives_way_with_more_than_its_drive_can_do_says_so(backhoe: bp.Robot) -> None:
    """A ball appears beside the bucket and moves towards it: giving way in time takes more flow than the pump has."""
    begin, across = np.array(list(START.values())), np.array([1.4, 0.5, 0.6, 0.5])
    goal = dict(zip(START, (begin + across).tolist(), strict=True))
    content = {"version": 1, "start": {"joints": START}, "task": {"goal": {"joints": goal}}, "objective": "time"}
    empty = build_problem(backhoe, bp.scene_from_dict(content))
    stations = np.linspace(0.0, 1.0, 9)
    over = time_along(stations, begin + stations[:, None] * across, empty.limits, drive=drive_of(empty))
    moment = 0.45 * over.duration
    place = Kinematics(backhoe).at(over.at(moment + 0.3)).tip_position + np.array([0.0, 0.9, 0.0])
    sudden = {
        "name": "ball", "shape": "sphere", "radius": 0.4, "position": place.tolist(), "velocity": [0.0, -1.0, 0.0],
        "appears_at": moment,
    }  # fmt: skip
    problem = build_problem(backhoe, bp.scene_from_dict(content | {"clearance": 0.1, "obstacles": [sudden]}))
    world = World(problem, seed=0, work=Work(EFFORTS["quick"], Brake()))
    task = ToGoal(problem.goals, law_alone=True)
    found = plan_over_time(world, task, world.stepper(begin), known=Outcome(over))
    assert same_until(found.trajectory, over, moment)
    certificate = certify_motion(problem, found.trajectory)
    assert certificate.min_clearance is not None
    assert certificate.min_clearance.margin > 0.0
    assert certificate.hydraulics is not None
    assert not certificate.hydraulics.kept
    [reaction] = found.findings.reactions
    assert reaction.way.startswith("gave way with more than its drive can do")
    assert found.message == reaction.words
