"""Motions to a goal are nearly of least duration or cost: against hand calculations and lower bounds."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import Dynamics
from backhoe_planner.motion import Goal, build_problem, drive_of, limit_usage, motion_cost, time_curve
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve, basis
from backhoe_planner.planning.descent.descent import Options
from backhoe_planner.planning.descent.descent_of_time import DescentOfTime
from backhoe_planner.planning.descent.linear_model import LinearModel
from backhoe_planner.planning.descent.looks import Looks
from backhoe_planner.planning.descent.margins import find_margins
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.site import ClearanceScreen
from validation.goal_runs import with_objective
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site

Data = dict[str, Any]

NAMES = ("joint1", "joint2", "joint3", "joint4")
READY = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
WALL: Data = {"name": "wall", "shape": "box", "size": [1.5, 0.3, 1.0], "position": [4.5, 1.2, 0.0]}


def planar(q: list[float], *obstacles: Data, start: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0), **keys: Any) -> bp.Scene:
    joints = {"start": {"joints": dict(zip(NAMES, start, strict=True))}}
    goal = {"joints": dict(zip(NAMES, q, strict=True))}
    return bp.scene_from_dict({"version": 1, **joints, "task": {"goal": goal}, "obstacles": list(obstacles), **keys})


def digger(goal: Any, *obstacles: Data, **keys: Any) -> bp.Scene:
    content = {"version": 1, "start": {"joints": READY}, "task": {"goal": goal}, "obstacles": list(obstacles)}
    return bp.scene_from_dict(content | keys)


@pytest.mark.parametrize(
    ("q", "least"),
    [
        ([0.5, 0.4, -0.3, 0.2], 2.0 * np.sqrt(0.5 / 2.0)),  # joint 1 accelerates at 2 rad/s^2 for 0.25 rad, and brakes
        ([1.0, 0.2, -0.3, 0.2], 1.0 / 1.0 + 1.0 / 2.0),  # and here it reaches 1 rad/s
    ],
)
def test_without_obstacles_the_slowest_joint_alone_decides_the_duration(
    planar4: bp.Robot, q: list[float], least: float
) -> None:
    plan = bp.plan(planar4, planar(q), effort="quick")
    assert plan.verified, plan.message
    assert least * (1.0 - 1e-9) <= plan.trajectory.duration <= 1.01 * least


@pytest.mark.parametrize("end", [{"swing": 1.0, "boom": -0.3}, {"swing": 0.8, "boom": 0.0, "stick": -1.2}])
def test_hydraulic_energy_is_not_above_that_of_moving_one_joint_after_the_other(
    backhoe: bp.Robot, end: dict[str, float]
) -> None:
    """Joints that sink under load need no pressure; while the swing turns alone, little oil is at its pressure."""
    scene = digger({"joints": READY | end}, objective="hydraulic")
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    longest = plan.findings.allowed_time
    assert longest is not None
    time = np.linspace(0.0, longest, 1 + round(longest / 0.02))
    each = []
    for order in itertools.permutations(end):
        q = np.tile(list(READY.values()), (len(time), 1))
        for turn, joint in enumerate(order):
            u = np.clip(len(order) * time / longest - turn, 0.0, 1.0)
            q[:, list(READY).index(joint)] += u**3 * (10.0 - 15.0 * u + 6.0 * u * u) * (end[joint] - READY[joint])
        each.append(motion_cost(build_problem(backhoe, scene), bp.Trajectory.from_steps(time, q)))
    assert plan.metrics.energy["hydraulic"] <= min(each)


def test_a_goal_by_position_lets_the_final_configuration_move(planar4: bp.Robot) -> None:
    """Joint 1 alone would need 1.5 s to turn the stretched arm; all joints together reach the position sooner."""
    there = bp.Kinematics(planar4).at(np.array([1.0, 0.0, 0.0, 0.0])).tip_position
    start = {"joints": dict.fromkeys(NAMES, 0.1)}
    goal = {"position": [0.95 * float(value) for value in there]}
    scene = bp.scene_from_dict({"version": 1, "start": start, "task": {"goal": goal}})
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.verified, plan.message
    first = min(np.max(np.abs(q - 0.1)) for q in postures(planar4, scene))
    assert plan.trajectory.duration < first + 0.5  # the time to the nearest configuration that the sampling finds


def postures(robot: bp.Robot, scene: bp.Scene) -> tuple[Any, ...]:
    problem = build_problem(robot, scene)
    assert problem.start_q is not None
    found = World(problem, seed=0, work=Work(EFFORTS["normal"])).postures
    return found.at(problem.goals[0].target, near=problem.start_q, count=48).clear


def test_starting_points_within_a_travel_find_more_configurations_there(planar4: bp.Robot) -> None:
    """With as many starting points, all lie within the travel instead of every other one anywhere."""
    problem = build_problem(planar4, planar([0.5, -0.6, 0.7, -0.4]))
    target = bp.TipTarget(bp.Kinematics(planar4).at(np.array([0.5, -0.6, 0.7, -0.4])).tip_position)
    within = []
    for travel in (np.full(4, 0.9), None):
        world = World(problem, seed=0, work=Work(EFFORTS["normal"]))
        found = world.postures.at(target, near=np.zeros(4), count=96, travel=travel)
        within.append(sum(np.max(np.abs(q)) <= 0.9 for q in found.clear))
    assert within[0] > within[1]


@pytest.mark.parametrize("near", [False, True])
def test_a_motion_with_no_obstacle_beside_it_is_not_searched_for_detours(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, near: bool
) -> None:
    """A motion that no obstacle bends has no other side: only beside one are detours sought through a roadmap."""
    mapped: list[int] = []

    def through_roadmap(self: Any, which: list[int], turn: int, **asked: Any) -> Iterator[Any]:
        mapped.append(turn)
        yield from ()

    monkeypatch.setattr("backhoe_planner.planning.multistart.ways.Ways.through_roadmap", through_roadmap)
    # all links of the stretched arm move along arcs; the ball is on that of the second joint, or beyond all
    place = 2.0 if near else 6.0
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [0.88 * place, 0.48 * place, 0.0]}
    plan = bp.plan(planar4, planar([1.0, 0.0, 0.0, 0.0], ball))
    assert plan.verified
    assert bool(mapped) == near


@pytest.mark.long
def test_after_a_roadmap_in_vain_a_denser_one_searches_shorter_motions(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A motion round a ball on the arc of the second joint takes twice as long as the bound."""
    asked: list[tuple[int, float]] = []

    def through_roadmap(self: Any, which: list[int], turn: int, **given: Any) -> Iterator[Any]:
        asked.append((given["nodes"], given["longest"]))
        yield from ()

    monkeypatch.setattr("backhoe_planner.planning.multistart.ways.Ways.through_roadmap", through_roadmap)
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [1.76, 0.96, 0.0]}
    plan = bp.plan(planar4, planar([1.0, 0.0, 0.0, 0.0], ball))
    assert plan.verified, plan.message
    assert plan.bound is not None
    assert plan.trajectory.duration > 2.0 * plan.bound.duration
    (nodes, longest), (more, shorter) = asked[:2]
    assert more > nodes
    assert plan.bound.duration < shorter < longest < plan.trajectory.duration


def test_in_a_motion_round_a_wall_a_limit_binds_nearly_all_the_time(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, digger({"position": [3.5, 3.5, 0.2]}, WALL), effort="quick")
    assert plan.verified, plan.message
    usage = limit_usage(plan.problem, plan.trajectory)
    assert np.mean(usage.greatest > 0.95) > 0.85


@pytest.mark.parametrize("way", ["search", "law", "fallback on the law"])
@pytest.mark.parametrize("goal", [[3.5, 3.5, 0.2], [4.0, 2.0, 1.0]])
def test_a_limit_binds_in_every_motion_to_a_goal_however_it_is_found(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch, way: str, goal: list[float]
) -> None:
    if way == "fallback on the law":
        monkeypatch.setattr("backhoe_planner.planning.goals.time_search.TimeSearch.run", lambda _: "")
    scene = digger({"position": goal}, WALL)
    plan = bp.plan(backhoe, scene, effort="quick", method="reactive" if way == "law" else "auto")
    assert plan.verified, plan.message
    used = float(np.max(limit_usage(plan.problem, plan.trajectory).greatest))
    assert used > 0.95
    proven = (
        plan.certificate.velocity,
        plan.certificate.acceleration,
        plan.certificate.effort,
        plan.certificate.hydraulics,
    )
    assert max(use.ratio for use in proven if use is not None) == used  # on which the plan's note is based
    assert "of any limit" not in plan.note


def test_a_note_says_that_a_plan_at_no_limit_could_be_faster(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slowed four times, velocities are at most a quarter of their limits, and accelerations a sixteenth."""
    found = bp.plan(backhoe, digger({"position": [3.5, 3.5, 0.2]}), effort="quick").trajectory
    slow = bp.Trajectory.from_steps(4.0 * found.time, found.q)
    monkeypatch.setattr("backhoe_planner.planning.goals.goal_planning.ToGoal.from_rest", lambda *_: Outcome(slow))
    plan = bp.plan(backhoe, digger({"position": [3.5, 3.5, 0.2]}), effort="quick")
    assert plan.verified, plan.message
    assert "of any limit: it could be faster" in plan.note


def test_least_work_is_not_above_that_of_the_fastest_motion(backhoe: bp.Robot) -> None:
    """Both are found with the same seed and effort."""
    fast, cheap = (
        bp.plan(backhoe, digger({"position": [3.5, 3.5, 1.5]}, WALL, objective=name), effort="quick", seed=3)
        for name in ("time", "work")
    )
    assert cheap.verified, cheap.message
    assert cheap.metrics.energy["work"] <= fast.metrics.energy["work"] * 1.001


def test_least_velocity_norm_is_a_lower_trapezium_in_thrice_the_least_duration(planar4: bp.Robot) -> None:
    """1 rad at 1 rad/s and 2 rad/s^2 takes 1.5 s, of which the bound proves 97 to 100 %.

    In T the plateau is the v of v (T - v / 2) = 1, reached in v / 2 s, so the integral of v^2 is
    v^2 (T - v + v / 3); a spline of cubics is not quite a trapezium.
    """
    plan = bp.plan(planar4, planar([1.0, 0.0, 0.0, 0.0], objective="velocity_norm"))
    assert plan.verified, plan.message
    T = plan.trajectory.duration
    assert plan.findings.allowed_time is not None
    assert 0.97 * 4.5 <= plan.findings.allowed_time <= 4.5
    assert 0.99 * plan.findings.allowed_time <= T <= plan.findings.allowed_time
    v = T - np.sqrt(T * T - 2.0)
    assert plan.metrics.energy["velocity_norm"] == pytest.approx(v * v * (T - v + v / 3.0), rel=0.03)


def test_the_objective_work_does_less_work_but_not_less_than_the_gain_in_potential_energy(backhoe: bp.Robot) -> None:
    """Work is never less than the gain in potential energy."""
    fast, cheap = (
        bp.plan(backhoe, digger({"position": [3.5, 3.5, 1.5]}, WALL, objective=name), effort="quick")
        for name in ("time", "work")
    )
    assert fast.verified
    assert cheap.verified
    work = [motion_cost(cheap.problem, plan.trajectory) for plan in (fast, cheap)]
    assert work[1] <= work[0]
    ends = Dynamics(backhoe)
    gained = ends.potential_energy(cheap.trajectory.q[-1]) - ends.potential_energy(cheap.trajectory.q[0])
    assert work[1] >= gained
    assert fast.trajectory.duration <= cheap.trajectory.duration + 1e-6


def test_the_method_optimal_takes_a_goal_and_gives_a_reason_if_it_fails(backhoe: bp.Robot) -> None:
    inside = {"name": "silo", "shape": "box", "size": [1.5, 1.5, 3.0], "position": [4.0, 0.0, 0.5]}
    plan = bp.plan(backhoe, digger({"position": [3.5, 1.5, 0.3]}), method="optimal", effort="quick")
    assert plan.verified, plan.message
    stuck = bp.plan(backhoe, digger({"position": [4.0, 0.0, 0.5]}, inside), method="optimal", effort="quick")
    assert stuck.reason


def test_a_curve_is_at_rest_at_its_ends_and_within_its_control_points() -> None:
    rng = np.random.default_rng(3)
    curve = JointCurve(rng.normal(size=(13, 4)))
    s = np.linspace(0.0, 1.0, 200)
    assert np.max(np.abs(curve(s[[0, -1]], 1))) < 1e-9
    np.testing.assert_allclose(curve(s[[0, -1]]), curve.control[[0, -1]], atol=1e-12)
    assert np.all(curve(s) <= curve.control.max(axis=0) + 1e-12)
    assert np.all(curve(s) >= curve.control.min(axis=0) - 1e-12)
    for derivative in range(3):
        np.testing.assert_allclose(basis(12, 200, derivative) @ curve.control, curve(s, derivative), atol=1e-8)


def test_the_fastest_run_along_a_line_is_the_trapezium(planar4: bp.Robot) -> None:
    limits = planar4.limits  # 1 rad/s, 2 rad/s^2
    line = JointCurve.straight(np.zeros(4), np.array([1.0, 0.5, 0.0, -0.2]), 12)
    motion = time_curve(line, np.linspace(0.0, 1.0, 121), limits)
    assert motion is not None
    assert motion.duration == pytest.approx(1.5, rel=5e-3)


def test_the_fastest_run_along_a_curve_is_no_slower_than_its_own_time(backhoe: bp.Robot) -> None:
    """The own time of a random curve is stretched until it just keeps velocities and accelerations."""
    rng = np.random.default_rng(5)
    limits = backhoe.limits
    for _ in range(5):
        curve = JointCurve(np.clip(rng.normal(size=(13, 4)), limits.lower, limits.upper))
        s = np.linspace(0.0, 1.0, 400)
        rate = float(np.max(np.abs(curve(s, 1)) / limits.velocity))
        bend = float(np.sqrt(np.max(np.abs(curve(s, 2)) / limits.acceleration)))
        motion = time_curve(curve, np.linspace(0.0, 1.0, 121), limits)
        assert motion is not None
        assert motion.duration <= 1.01 * max(rate, bend)


@pytest.mark.parametrize("payload", [0.0, 200.0])
def test_rows_of_the_linear_model_equal_the_change_of_the_limits_in_a_small_step(
    backhoe: bp.Robot, payload: float
) -> None:
    """Every row against the same limit of the curve after a small step, by differences."""
    problem = build_problem(backhoe, digger({"position": [3.5, 3.5, 0.2]}, WALL, payload=payload, clearance=0.05))
    drive, limits = drive_of(problem), problem.limits
    rng = np.random.default_rng(2)
    start = np.array(list(READY.values()))
    curve = JointCurve.straight(start, start + np.array([1.0, 0.3, 0.5, 0.4]), 8)
    T, box = 2.5, np.full(4, 0.05)
    proximity = bp.Proximity(backhoe, problem.obstacles)
    places = 49

    def values(control: Any, T: float) -> tuple[Any, ...]:
        q, v, a = (basis(8, 25, derivative) @ control / T**derivative for derivative in range(3))
        use = drive.use(q, v, a)
        q_near = JointCurve(control)(np.linspace(0.0, 1.0, places))
        return (
            np.abs(v) / limits.velocity, np.abs(a[::3]) / limits.acceleration, use.flow, use.power, use.effort,
            find_margins(proximity, None, q_near, spare=0.0, reach=0.3, time=0.0).least,
        )  # fmt: skip

    model = LinearModel(problem, curve, T, end_moves=True, box=box)
    model.keep_joint_limits()
    model.keep_drive_limits(drive)
    model.keep_clear(
        find_margins(proximity, None, curve(np.linspace(0, 1, places)), spare=0.0, reach=0.3, time=0.0), places
    )
    program = model.program(20.0)
    x = np.zeros(len(program.f))
    x[:-2] = 1e-4 * rng.uniform(-1.0, 1.0, len(x) - 2)
    x[-2] = 1e-4
    before, after = values(curve.control, T), values(*model.step(x))
    by_name = {
        name: np.vstack([rows.G for rows in program.rows if rows.name == name]) @ x for name in ("drive", "clearance")
    }
    room = {name: np.concatenate([rows.h for rows in program.rows if rows.name == name]) for name in by_name}
    most = {name: float(np.max(by_name[name] - room[name])) for name in by_name}  # 0 at the limit, negative within
    drive_now = max(float(np.max(part)) for part in after[2:5])
    if drive_now > 0.85:  # otherwise all rows are left out
        assert most["drive"] == pytest.approx(drive_now - 1.0, abs=2e-5)
    assert most["clearance"] == pytest.approx(-after[5], abs=2e-5)
    assert before[5] != after[5]


def test_a_thin_post_between_two_places_is_found(planar4: bp.Robot) -> None:
    """The stretched arm turns by 1 rad through a post of 4 mm, which three equal steps of 1/3 rad all miss."""
    tip = bp.Kinematics(planar4).at(np.array([0.5, 0.0, 0.0, 0.0])).tip_position
    post: Data = {"name": "post", "shape": "cylinder", "radius": 0.002, "length": 1.0, "position": (0.9 * tip).tolist()}
    problem = build_problem(planar4, planar([1.0, 0.0, 0.0, 0.0], post, clearance=0.001))
    proximity = bp.Proximity(planar4, problem.obstacles)
    curve = JointCurve.straight(np.zeros(4), np.array([1.0, 0.0, 0.0, 0.0]), 8)
    places = np.linspace(0.0, 1.0, 4)
    assert min(float(np.min(proximity.at(q).margin)) for q in curve(places)) > 0.1
    looks = Looks(proximity, ClearanceScreen(proximity), None, steps=3, spare=0.003, time=0.0)
    known = looks.known
    assert looks.find_margins(curve).least < 0.0
    assert looks.known > known
    assert len(looks.find_margins(JointCurve.straight(np.zeros(4), np.full(4, 0.01), 8)).place) == 0


def test_a_descent_does_not_raise_the_cost_and_its_end_stays_on_the_goal(backhoe: bp.Robot) -> None:
    problem = build_problem(backhoe, digger({"position": [3.5, 3.5, 0.2]}, WALL))
    world = World(problem, seed=0, work=Work(EFFORTS["normal"]))
    assert problem.start_q is not None
    goal: Goal = problem.goals[0]
    end = world.postures.at(goal.target, near=problem.start_q, count=24).clear[0]
    costs: list[float] = []

    def note(here: Any, _: int) -> bool:
        costs.append(here.cost + 20.0 * costs[0] * here.missed if costs else here.cost * (1.0 + 20.0 * here.missed))
        return False

    line = JointCurve.straight(problem.start_q, end, 12)
    found = DescentOfTime(problem, world.proximity, world.kinematics, time=0.0, brake=world.work.brake).run(
        line, 4.0, goal, Options(10, spare=0.003, density=2, box=0.25, is_hopeless=note)
    )
    assert found is not None
    assert len(costs) > 2
    position, _ = goal.distances(world.kinematics.at(found.curve.control[-1]))
    assert position < 1e-7
    assert found.cost + 20.0 * costs[0] * found.missed <= costs[0] * (1.0 + 1e-6)


def test_a_hurried_descent_ends_once_its_first_program_promises_little(backhoe: bp.Robot) -> None:
    """Where descents have ended nothing is left to gain; a hurried one sees that from its first program alone."""
    problem = build_problem(backhoe, digger({"position": [3.5, 3.5, 0.2]}))
    world = World(problem, seed=0, work=Work(EFFORTS["quick"]))
    assert problem.start_q is not None
    goal = problem.goals[0]
    end = world.postures.at(goal.target, near=problem.start_q, count=24).clear[0]
    curve, T = JointCurve.straight(problem.start_q, end, 8), 4.0
    ends_at_once = {}
    for hurried in (False, True):
        descent = DescentOfTime(
            problem, world.proximity, world.kinematics, time=0.0, brake=world.work.brake, hurried=hurried
        )  # fmt: skip
        for _ in range(3):
            before = descent.rounds
            found = descent.run(curve, T, goal, Options(40, spare=0.003, density=2, box=0.1))
            assert found is not None
            # without hurry, the descent takes the step all the same or tries shorter ones
            ends_at_once[hurried] = found.curve is curve and descent.rounds - before == 1
            curve, T = found.curve, found.duration
    assert ends_at_once == {False: False, True: True}


@pytest.mark.parametrize("objective", ["time", "work"])
@pytest.mark.parametrize("way", [0.0, 1e-9, 5e-4, 2e-3])
def test_a_goal_nearer_than_one_sample_is_reached(planar4: bp.Robot, way: float, objective: str) -> None:
    """At 1,000 rad/s^2 even 0.4 rad have a bound of 0 s, and the machine gets there."""
    fast = {"acceleration": dict.fromkeys(NAMES, 1e3)}
    scene = planar([way, 0.0, way, 0.0], limits=fast, objective=objective)
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.verified, plan.message
    assert plan.bound is not None
    assert plan.bound.duration == 0.0


def test_watched_steps_show_the_best_duration_falling_to_that_of_the_plan(backhoe: bp.Robot) -> None:
    seen: list[float] = []
    plan = bp.plan(
        backhoe, digger({"position": [3.5, 3.5, 0.2]}, WALL), effort="quick",
        watch=lambda step: seen.append(step.best) if step.best is not None else None,
    )  # fmt: skip
    assert seen == sorted(seen, reverse=True)
    assert seen[-1] == pytest.approx(plan.trajectory.duration, rel=1e-3)


def test_least_work_takes_at_most_thrice_the_least_time_and_the_work_of_an_even_turn(planar4: bp.Robot) -> None:
    """On level ground only acceleration costs: joint 1 turns the stretched arm by 1 rad, with 2 rad/s^2 at the ends.

    Its plateau is the v of v (T - v / 2) = 1, its work M v^2 / 2. The fastest such turn takes 1.5 s, of which 97
    to 100 % are proven. Drawing in the arm on the way costs less.
    """
    plan = bp.plan(planar4, planar([1.0, 0.0, 0.0, 0.0], objective="work"))
    assert plan.verified, plan.message
    T = plan.findings.allowed_time
    assert T is not None
    assert 0.97 * 4.5 <= T <= 4.5
    assert 0.5 * T < plan.trajectory.duration <= T
    v = T - np.sqrt(T * T - 2.0)
    M = float(Dynamics(planar4).mass_matrices(np.zeros((1, 4)))[0, 0, 0])
    assert 0.0 < plan.metrics.energy["work"] < 1.01 * 0.5 * M * v * v


@pytest.mark.long
def test_the_work_of_a_plan_hardly_depends_on_its_seed(backhoe: bp.Robot) -> None:
    """Past a wall, with three seeds: costs differ by less than a tenth."""
    scene = digger({"position": [3.5, 3.5, 0.2]}, WALL, objective="work")
    costs = [bp.plan(backhoe, scene, seed=seed, effort="quick").metrics.energy["work"] for seed in range(3)]
    assert max(costs) < 1.1 * min(costs)


@pytest.mark.long
def test_a_cheaper_detour_is_found_though_a_straight_line_to_another_end_is_clear() -> None:
    """A detour found by seed 0 needs 3,050 J; a clear straight line to another configuration needs 5,720 J."""
    robot = load_machine("backhoe")
    scene = random_site(robot, SiteKey("backhoe", "cluttered", "goal", 0, 501)).scene
    plan = bp.plan(robot, with_objective(scene, "work"), seed=1)
    assert plan.verified
    assert plan.metrics.energy["work"] < 1.1 * 3050.0
