"""The cost of a step: by hand, against full inverse dynamics, and in an exhaustive search."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from machines import LENGTH, MASS, PENDULUM
from reasons import comparison

import backhoe_planner as bp
from backhoe_planner.arrays import Array
from backhoe_planner.machine import GRAVITY
from backhoe_planner.motion import (
    OBJECTIVES,
    PathCost,
    Problem,
    Trajectory,
    build_problem,
    trajectory_costs,
    trajectory_energy,
)
from backhoe_planner.planning import LayeredGraph, PathLayers

LIFT = f"""<robot name="lift">
  <link name="post"/>
  <link name="cage"><collision><geometry><sphere radius="0.01"/></geometry></collision><inertial><mass value="{MASS}"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hoist" type="prismatic"><parent link="post"/><child link="cage"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="3" velocity="1" effort="1e4"/></joint>
</robot>"""


def machine(folder: Path, text: str, tip: str) -> bp.Robot:
    file = folder / "machine.urdf"
    file.write_text(text, encoding="utf-8")
    return bp.load_robot(file, tip=tip)


def along(*points: tuple[float, float, float], speed: float | None = 0.4, **keys: Any) -> bp.Scene:
    task: dict[str, Any] = {"waypoints": [{"position": list(point)} for point in points]}
    if speed is not None:
        task["speed"] = speed
    return bp.scene_from_dict({"version": 1, "task": {"path": task}} | keys)


def cost_of(problem: Problem, name: str) -> PathCost:
    """The cost by another objective than the scene's."""
    return PathCost(replace(problem, objective=OBJECTIVES[name]))


@pytest.fixture(scope="module")
def digging(backhoe: bp.Robot) -> Problem:
    return build_problem(backhoe, along((4.5, 0.0, -0.5), (2.5, 0.5, 1.0)))


def layers_of(problem: Problem, count: int, *, grid: float = 60.0) -> tuple[Array, list[Array]]:
    assert problem.path is not None
    stations = 0.05 * np.arange(float(count))
    targets = [problem.path.target(s) for s in stations.tolist()]
    return stations, PathLayers(problem.robot, grid=np.radians(grid)).at(stations, targets)


# --- by hand ------------------------------------------------------------------------


def test_a_pendulum_lift_costs_m_g_h(tmp_path: Path) -> None:
    robot = machine(tmp_path, PENDULUM, "end")
    problem = build_problem(robot, along((2.0, 0.0, 2.0), (1.9, 0.0, 2.5)))
    q = np.linspace(-0.7, 0.8, 60)[:, None]
    stations = LENGTH * (q[:, 0] - q[0, 0])
    lift = MASS * GRAVITY * LENGTH * (np.sin(0.8) - np.sin(-0.7))
    objective = cost_of(problem, "work")
    assert objective.value(stations, q) == pytest.approx(lift, rel=1e-3)
    # on the way down the load drives the joint, which recovers nothing
    assert objective.value(stations, q[::-1]) == 0.0


def test_a_planned_lift_costs_m_g_h(tmp_path: Path) -> None:
    """With a payload, through the whole planner."""
    robot = machine(tmp_path, LIFT, "cage")
    scene = along((0.0, 0.0, 0.5), (0.0, 0.0, 2.0), payload=100.0)
    plan = bp.plan(robot, scene, method="optimal", effort="quick")
    assert plan.verified, plan.message
    lift = (MASS + 100.0) * GRAVITY * 1.5
    assert plan.metrics.energy["work"] == pytest.approx(lift, rel=1e-3)
    assert comparison(plan).value == pytest.approx(lift, rel=1e-3)
    # with one joint the law has no choice either
    assert comparison(plan).saving_percent == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("heights", [(0.5, 2.0), (0.5, 1.1, 2.0), (0.5, 0.9, 0.9, 1.7, 2.0)])
def test_a_hand_written_lift_of_few_samples_costs_m_g_h(tmp_path: Path, heights: tuple[float, ...]) -> None:
    """At 0.1 m/s, so slow that gravity brakes within a corner: the cage gives back its kinetic energy."""
    problem = build_problem(machine(tmp_path, LIFT, "cage"), along((0.0, 0.0, 0.5), (0.0, 0.0, 2.0)))
    lift = MASS * GRAVITY * 1.5
    time = np.concatenate(([0.0], np.cumsum(np.maximum(np.diff(heights) / 0.1, 1.0))))
    motion = Trajectory.from_steps(time, np.array(heights)[:, None])
    assert trajectory_costs(problem, motion)["work"] == pytest.approx(lift, rel=1e-9)
    # the same motion with a sample every 0.02 s or 0.01 s
    for period in (0.02, 0.01):
        often = np.union1d(np.arange(0.0, time[-1], period), time)
        dense = Trajectory.from_steps(often, motion.at(often))
        assert trajectory_costs(problem, dense)["work"] == pytest.approx(lift, rel=3e-3)
    # on the way down the load drives the hoist
    down = Trajectory.from_steps(time[-1] - time[::-1], motion.q[::-1])
    assert trajectory_costs(problem, down)["work"] == pytest.approx(0.0, abs=1e-9)


def test_the_work_of_a_hand_written_motion_includes_its_corners(tmp_path: Path) -> None:
    """Up by 1 m in 2 s, rest for 1 s, down again in 2 s: every corner is rounded within 0.02 s."""
    problem = build_problem(machine(tmp_path, LIFT, "cage"), along((0.0, 0.0, 0.5), (0.0, 0.0, 2.0)))
    motion = Trajectory.from_steps(np.array([0.0, 2.0, 3.0, 5.0]), np.array([[0.5], [1.5], [1.5], [0.5]]))
    speed, weight, period = 0.5, MASS * GRAVITY, 0.02
    energy = 0.5 * MASS * speed**2
    way = 0.5 * speed * period  # of a corner from or to rest
    # work: the start's kinetic energy and the lift; the cage coasts at the top; pushing it down works only against
    # its inertia; braking at the bottom costs nothing
    pushed = energy - weight * way
    assert pushed > 0.0
    expected = weight * (1.0 - way) + energy + pushed
    costs = trajectory_costs(problem, motion)
    assert costs["work"] == pytest.approx(expected, rel=1e-9)
    assert trajectory_energy(problem, motion).work[[0, 2, 3]] == pytest.approx(
        [0.0, weight * (1.0 - way) + energy + 0.5 * pushed, expected], rel=0.05
    )
    assert costs["time"] == pytest.approx(5.0, rel=1e-12)
    assert costs["velocity_norm"] == pytest.approx(4.0 * speed**2, rel=0.01)


def test_a_hand_written_swing_up_of_two_samples_costs_m_g_h(tmp_path: Path) -> None:
    """A pendulum from -0.7 to 0.8 rad in two samples, slowly: the bend between them counts too."""
    problem = build_problem(machine(tmp_path, PENDULUM, "end"), along((2.0, 0.0, 2.0), (1.9, 0.0, 2.5)))
    lift = MASS * GRAVITY * LENGTH * (np.sin(0.8) - np.sin(-0.7))
    motion = Trajectory.from_steps(np.array([0.0, 60.0]), np.array([[-0.7], [0.8]]))
    assert trajectory_costs(problem, motion)["work"] == pytest.approx(lift, rel=1e-3)


def test_every_objective_of_a_pendulum_step_equals_a_hand_calculation(tmp_path: Path) -> None:
    """From level up by 0.2 rad over 0.4 m at 0.4 m/s, so in 1 s."""
    robot = machine(tmp_path, PENDULUM, "end")
    problem = build_problem(robot, along((2.0, 0.0, 2.0), (1.9, 0.0, 2.5)))
    q, stations = np.array([[0.0], [0.2]]), np.array([0.0, 0.4])
    tau = MASS * GRAVITY * LENGTH * np.cos(q[:, 0])
    expected = {
        "velocity_norm": 0.04,
        "kinetic": 0.5 * MASS * LENGTH**2 * 0.04,
        "effort": float(np.mean(tau**2)),
        "work": float(np.mean(tau)) * 0.2,
        "time": 1.0,
    }
    for name, value in expected.items():
        assert cost_of(problem, name).value(stations, q) == pytest.approx(value, rel=1e-12), name
    # a step too fast for the joint takes the joint's time: 0.5 rad at 1 rad/s
    fast = np.array([[0.0], [0.5]])
    assert cost_of(problem, "time").value(np.array([0.0, 0.04]), fast) == pytest.approx(0.5)


def test_a_change_of_rate_costs_its_time(tmp_path: Path) -> None:
    """0.1 rad, then 0.2 rad, over 0.4 m each at 0.4 m/s: 0 to 0.1 to 0.2 rad/s and back to 0, at 2 rad/s^2."""
    robot = machine(tmp_path, PENDULUM, "end")
    problem = build_problem(robot, along((2.0, 0.0, 2.0), (1.9, 0.0, 2.5)))
    assert problem.limits.acceleration.tolist() == [2.0]
    q, stations = np.array([[0.0], [0.1], [0.3]]), np.array([0.0, 0.4, 0.8])
    objective = cost_of(problem, "time")
    taken = (0.1 + 0.1 + 0.2) / 2.0
    assert objective.per_radian * (objective.of_run(stations, q) - objective.of_steps(stations, q)) == pytest.approx(
        taken
    )
    # the reported value is the time of the steps alone
    assert objective.value(stations, q) == pytest.approx(2.0)
    for name in ("velocity_norm", "kinetic"):
        quiet = cost_of(problem, name)
        assert quiet.of_run(stations, q) == quiet.of_steps(stations, q)


def test_an_approach_to_a_path_costs_that_of_its_least_duration(tmp_path: Path) -> None:
    """1.6 rad at 1 rad/s and 2 rad/s^2 take 1.6 + 1 / 2 s; 0.2 rad, too short for the full rate, 2 sqrt(0.2 / 2) s."""
    robot = machine(tmp_path, PENDULUM, "end")
    problem = build_problem(robot, along((2.0, 0.0, 2.0), (1.9, 0.0, 2.5)))
    start, ends, far = np.array([-0.8]), np.array([[0.8], [-0.6], [-0.8]]), np.array([1.6, 0.2, 0.0])
    taken = np.array([2.1, 2.0 * np.sqrt(0.1), 1.0])
    expected = {"velocity_norm": far**2 / taken, "kinetic": 0.5 * MASS * LENGTH**2 * far**2 / taken}
    for name, value in expected.items():
        objective = cost_of(problem, name)
        assert objective.per_radian * objective.of_approaches(start, ends) == pytest.approx(value, rel=1e-6, abs=1e-6)
    # work is the lift, and 0 on the way down; the search adds terms that are small for a heavy arm
    objective = cost_of(problem, "work")
    lift = MASS * GRAVITY * LENGTH * (np.sin(0.8) - np.sin(-0.8))
    up, down = (float(objective.of_approaches(a, b[None])[0]) for a, b in ((start, ends[0]), (ends[0], start)))
    assert objective.per_radian * (up - down) == pytest.approx(lift, rel=5e-3)


def test_motion_to_and_fro_costs_the_margin_pressure_of_its_oil(digging: Problem) -> None:
    """The same motion with the bucket swinging by 0.1 rad or not: the margin is on all the oil."""
    s = np.linspace(0.0, 1.0, 41)[:, None]
    still = np.array([0.1, 0.3, -1.4, -0.8]) + s * np.array([0.2, 0.25, -0.5, 0.0])
    swinging = still + np.array([0.0, 0.0, 0.0, 0.1]) * np.sin(6.0 * np.pi * s)
    objective = cost_of(digging, "hydraulic")
    stations = 1.2 * s[:, 0]
    hydraulics = digging.robot.hydraulics
    assert hydraulics is not None
    (bucket,) = [c for c, joint in enumerate(hydraulics.joint_of) if joint == 3]
    cylinder = hydraulics.cylinders[bucket]
    change = np.diff(hydraulics.lengths(swinging)[:, bucket])
    oil = float(np.sum(np.where(change > 0.0, cylinder.cap_area, cylinder.annulus_area) * np.abs(change)))
    more = objective.of_steps(stations, swinging) - objective.of_steps(stations, still)
    told = objective.value(stations, swinging) - objective.value(stations, still)
    assert objective.per_radian * more - told >= 2e6 * oil * (1.0 - 1e-9)
    assert objective.of_run(stations, swinging) - objective.of_run(stations, still) > more


# --- against full inverse dynamics ------------------------------------------------


@pytest.mark.parametrize("name", OBJECTIVES)
def test_steps_add_up_to_the_reported_cost_of_a_slow_motion(digging: Problem, name: str) -> None:
    """So slow that torques of inertia do not count: 1.2 m at 0.4 m/s, evenly over 300 steps."""
    s = np.linspace(0.0, 1.0, 301)[:, None]
    q = np.array([0.1, 0.3, -1.4, -0.8]) + s * np.array([0.2, 0.25, -0.5, 0.4])
    time = 3.0 * s[:, 0]
    moving = Trajectory(time=time, q=q, v=np.gradient(q, time, axis=0))
    reported = trajectory_costs(digging, moving)[name]
    if name in ("effort", "work", "hydraulic"):  # they have inertia, and the motion is sudden at its ends
        assert cost_of(digging, name).value(0.4 * time, q) == pytest.approx(reported, rel=0.04)
    else:
        assert cost_of(digging, name).value(0.4 * time, q) == pytest.approx(reported, rel=2e-3)


def test_steps_between_many_nodes_equal_steps_one_by_one(digging: Problem) -> None:
    stations, layers = layers_of(digging, 2, grid=30.0)
    a, b = layers
    assert len(a) > 2
    for name in OBJECTIVES:
        objective = cost_of(digging, name)
        together = objective.step_costs(a, b, float(stations[1]))
        wide = np.max(np.abs(b[None] - a[:, None]), axis=2) > 0.7
        assert np.isinf(together[wide]).all()
        assert np.isfinite(together[~wide]).all()
        for i, j in np.argwhere(~wide).tolist():
            alone = objective.of_steps(stations, np.array([a[i], b[j]]))
            assert together[i, j] == pytest.approx(alone, rel=1e-9)


def test_soil_costs_work_only_below_the_ground(backhoe: bp.Robot) -> None:
    soil = {"density": 1700.0, "cohesion": 5000.0, "friction": 0.55}
    for depth, more in ((0.3, True), (-0.3, False)):
        points = ((3.7, 0.0, -depth), (3.0, 0.0, -depth))
        dry, wet = (build_problem(backhoe, along(*points, soil=own)) for own in (None, soil))
        plan = bp.plan(backhoe, dry.scene, method="reactive")
        q, stations = plan.trajectory.q, np.linspace(0.0, 0.7, len(plan.trajectory))
        without, against = (cost_of(problem, "work").value(stations, q) for problem in (dry, wet))
        costs = [trajectory_costs(problem, plan.trajectory)["work"] for problem in (dry, wet)]
        if more:
            assert against > 1.05 * without
            assert costs[1] > 1.05 * costs[0]
            # the trapezia and full inverse dynamics agree on the work in soil
            assert against - without == pytest.approx(costs[1] - costs[0], rel=0.15)
        else:
            assert against == without
            assert costs[1] == costs[0]


def test_power_adds_up_to_the_reported_work(digging: Problem) -> None:
    plan = bp.plan(digging.robot, digging.scene, effort="quick")
    energy = trajectory_energy(digging, plan.trajectory)
    assert float(np.trapezoid(energy.power, energy.time)) == pytest.approx(plan.metrics.energy["work"], rel=1e-12)
    assert set(plan.metrics.energy) == set(OBJECTIVES)


def test_costs_are_the_ends_of_the_series(digging: Problem, planar4: bp.Robot) -> None:
    time = np.linspace(0.0, 4.0, 201)
    swaying = np.array([0.1, 0.3, -1.4, -0.8]) + 0.2 * np.sin(time[:, None] * np.array([1.0, 1.3, 0.7, 1.9]))
    motion = Trajectory.from_steps(time, swaying)
    costs, energy = trajectory_costs(digging, motion), trajectory_energy(digging, motion)
    assert energy.hydraulic is not None
    assert costs["work"] == pytest.approx(energy.work[-1], rel=1e-12)
    assert costs["hydraulic"] == pytest.approx(energy.hydraulic[-1], rel=1e-12)
    assert costs["work"] == pytest.approx(np.trapezoid(energy.power, time))
    flat = build_problem(planar4, along((2.0, -1.0, 0.0), (2.0, 1.0, 0.0)))
    assert set(trajectory_costs(flat, motion)) == set(OBJECTIVES) - {"hydraulic"}


def test_a_motion_of_one_sample_costs_nothing(digging: Problem) -> None:
    costs = trajectory_costs(digging, Trajectory.from_steps(np.zeros(1), np.zeros((1, 4))))
    assert set(costs) == set(OBJECTIVES)
    assert set(costs.values()) == {0.0}


# --- the search ---------------------------------------------------------------------


@pytest.mark.parametrize("name", OBJECTIVES)
def test_the_route_equals_an_exhaustive_search_with_the_same_cost(digging: Problem, name: str) -> None:
    stations, layers = layers_of(digging, 4, grid=20.0)
    assert all(3 <= len(layer) <= 12 for layer in layers)
    objective = cost_of(digging, name)
    graph = LayeredGraph(stations, layers, cost=objective.step_costs, turning=1e-9, detours=False)
    route = graph.best_route()
    costs = []
    for choice in product(*(range(len(layer)) for layer in layers)):
        q = np.array([layer[index] for layer, index in zip(layers, choice, strict=True)])
        if max(float(np.max(np.abs(b - a))) for a, b in pairwise(q)) <= 0.7:
            costs.append((objective.of_steps(stations, q), choice))
    assert route is not None
    assert len(costs) > 10
    best = min(costs)
    assert route.cost == pytest.approx(best[0], rel=1e-9)
    q = np.array([layers[layer][index] for layer, index in route.nodes])
    assert objective.of_steps(stations, q) == pytest.approx(best[0], rel=1e-9)


# --- the list -------------------------------------------------------------------------


def test_a_scene_may_request_every_objective() -> None:
    names, _ = get_args(bp.Scene.model_fields["objective"].annotation)  # the other is None
    assert get_args(names) == tuple(OBJECTIVES)
    assert all(name == objective.name and objective.unit for name, objective in OBJECTIVES.items())


# --- misuse ---------------------------------------------------------------------------


def test_hydraulic_needs_a_hydraulic_description(planar4: bp.Robot) -> None:
    scene = along((2.0, -1.0, 0.0), (2.0, 1.0, 0.0), objective="hydraulic")
    with pytest.raises(bp.SceneError, match=r"hydraulic description.*hydraulics\.yaml"):
        bp.plan(planar4, scene)


def test_an_unknown_objective_is_named(digging: Problem) -> None:
    with pytest.raises(bp.InputError, match="velocity_norm, kinetic"):
        build_problem(digging.robot, digging.scene.model_copy(update={"objective": "beauty"}))


def test_soil_needs_a_bucket(panda: bp.Robot) -> None:
    scene = along((0.5, -0.2, 0.4), (0.5, 0.2, 0.4), soil={})
    with pytest.raises(bp.SceneError, match="soil acts on a bucket"):
        build_problem(panda, scene)


def test_an_arm_without_mass_is_planned(tmp_path: Path) -> None:
    """All motions cost nothing: the quietest is taken."""
    text = LIFT.replace(f'<mass value="{MASS}"/>', '<mass value="0"/>').replace(
        '"1" iyy="1" izz="1"', '"0" iyy="0" izz="0"'
    )
    plan = bp.plan(
        machine(tmp_path, text, "cage"), along((0.0, 0.0, 0.5), (0.0, 0.0, 2.0)), method="optimal", effort="quick"
    )
    assert plan.verified, plan.message
    assert plan.metrics.energy["work"] == 0.0
