"""Time-optimal motions against closed-form durations, within every limit of the machine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from backhoe_planner.arrays import Matrix
from backhoe_planner.machine import BatchKinematics, Dynamics, Hydraulics, JointLimits, Robot, load_robot
from backhoe_planner.motion import (
    SAMPLE_PERIOD,
    Drive,
    FastestRun,
    Problem,
    Rows,
    Trajectory,
    build_problem,
    drive_of,
    fastest,
    limit_usage,
    retime,
    time_along,
)
from backhoe_planner.motion.timing.path_limits import PathShape, _Loads, time_path
from backhoe_planner.motion.timing.time_optimal import TimeLaw
from backhoe_planner.motion.timing.timing import _over
from backhoe_planner.planning import load_plan, plan
from backhoe_planner.proof import certify
from backhoe_planner.site import Scene, scene_from_dict

MASS, LENGTH, GRAVITY = 20.0, 1.5, 9.81
PENDULUM = f"""
<robot name="pendulum">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="{LENGTH} 0 0"/><mass value="{MASS}"/>
    <inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 -1 0"/>
    <limit lower="-3" upper="3" velocity="100" effort="{{effort}}" acceleration="1000"/></joint>
</robot>
"""


def pendulum(folder: Path, effort: float) -> Robot:
    file = folder / "pendulum.urdf"
    file.write_text(PENDULUM.format(effort=effort))
    return load_robot(file)


def line(q_a: object, q_b: object, count: int = 40) -> tuple[Matrix, Matrix]:
    """Stations and joints of a straight line from q_a to q_b."""
    part = np.linspace(0.0, 1.0, count)
    a, b = np.asarray(q_a, dtype=float), np.asarray(q_b, dtype=float)
    return part, a + part[:, None] * (b - a)


def with_limits(
    limits: JointLimits, *, velocity: float | tuple[float, ...], acceleration: float | tuple[float, ...]
) -> JointLimits:
    n = len(limits.lower)
    return replace(
        limits, velocity=np.broadcast_to(velocity, n).astype(float),
        acceleration=np.broadcast_to(acceleration, n).astype(float),
    )  # fmt: skip


# --- closed-form durations --------------------------------------------------------


def test_with_acceleration_limits_alone_the_duration_is_2_sqrt_d_over_a(planar4: Robot) -> None:
    limits = with_limits(planar4.limits, velocity=100.0, acceleration=(2.0, 0.5, 1.0, 1.0))
    # the second joint is the slowest: 0.9 rad at 0.5 rad/s^2
    motion = time_along(*line([0.0] * 4, [1.2, -0.9, 0.0, 0.3]), limits)
    assert motion.duration == pytest.approx(2.0 * np.sqrt(0.9 / 0.5), rel=1e-3)


def test_with_a_velocity_limit_the_duration_is_d_over_v_plus_v_over_a(planar4: Robot) -> None:
    limits = with_limits(planar4.limits, velocity=(0.4, 1.0, 1.0, 1.0), acceleration=(0.8, 2.0, 9.0, 9.0))
    motion = time_along(*line([0.0] * 4, [1.5, 0.6, 0.0, 0.0]), limits)
    assert motion.duration == pytest.approx(1.5 / 0.4 + 0.4 / 0.8, rel=1e-3)


def test_two_joints_on_a_straight_line_keep_the_tighter_of_each_limit(planar4: Robot) -> None:
    # joint 1 bounds the speed (0.5 per unit), joint 2 the acceleration (0.25 per unit)
    limits = with_limits(planar4.limits, velocity=(0.5, 3.0, 1.0, 1.0), acceleration=(1.0, 0.5, 1.0, 1.0))
    motion = time_along(*line([0.0] * 4, [1.0, 2.0, 0.0, 0.0]), limits)
    assert motion.duration == pytest.approx(1.0 / 0.5 + 0.5 / 0.25, rel=1e-3)


def test_the_requested_tip_speed_bounds_the_motion(planar4: Robot) -> None:
    part, q = line([0.0] * 4, [0.5, 0.0, 0.0, 0.0])
    limits = with_limits(planar4.limits, velocity=9.0, acceleration=1e3)
    slow = FastestRun(2.0 * part, q, limits, speed=0.1).motion(SAMPLE_PERIOD)
    assert slow.duration == pytest.approx(2.0 / 0.1, rel=1e-3)


@pytest.mark.parametrize("part_of_way", [0.5, 2.0])
def test_the_tip_has_the_requested_speed_even_if_arc_lengths_are_wrong(planar4: Robot, part_of_way: float) -> None:
    """Joint 1 turns the stretched arm: the tip moves by 0.5 rad times its length; the arc lengths say otherwise."""
    kinematics = BatchKinematics(planar4)
    arm = float(np.linalg.norm(kinematics.at(np.zeros((1, 4))).tip_position[0, :2]))
    part, q = line([0.0] * 4, [0.5, 0.0, 0.0, 0.0])
    limits = with_limits(planar4.limits, velocity=9.0, acceleration=1e3)
    run = FastestRun(part_of_way * 0.5 * arm * part, q, limits, speed=0.1, kinematics=kinematics)
    motion = run.motion(SAMPLE_PERIOD)
    assert motion.duration == pytest.approx(0.5 * arm / 0.1, rel=1e-3)


def test_samples_with_too_fast_a_tip_are_timed_again(planar4: Robot) -> None:
    """A kinked path with uneven samples: its spline swings about it."""
    rng = np.random.default_rng(5)
    part = np.sort(np.concatenate(([0.0, 1.0], rng.uniform(0.0, 1.0, 30))))
    kinks = np.interp(part, [0.0, 0.3, 0.5, 1.0], [0.0, 0.4, 0.3, 0.9])
    q = np.column_stack((part, -kinks, 0.5 * kinks, 0.2 * part))
    kinematics = BatchKinematics(planar4)
    motion = FastestRun(part, q, planar4.limits, speed=0.05, kinematics=kinematics).motion(SAMPLE_PERIOD)
    moved = np.linalg.norm(np.diff(kinematics.at(motion.q).tip_position, axis=0), axis=1)
    assert np.max(moved / np.diff(motion.time)) <= 0.05 * 1.001
    # at the speed itself but for the ends at rest
    assert motion.duration <= 1.02 * np.sum(moved) / 0.05


@pytest.mark.parametrize(("begin", "end", "effort"), [(-1.2, 1.0, 400.0), (1.3, -1.3, 400.0), (-0.4, 0.4, 420.0)])
def test_a_pendulum_at_its_torque_limit_takes_the_time_of_bang_bang_control(
    tmp_path: Path, begin: float, end: float, effort: float
) -> None:
    """With tau = +-T the energy is known everywhere: one switch, and the duration by quadrature."""
    robot = pendulum(tmp_path, effort)
    inertia, weight = MASS * LENGTH**2, MASS * GRAVITY * LENGTH
    sign = np.sign(end - begin)

    def speeding(q: float) -> float:
        return float(sign * effort * (q - begin) - weight * (np.sin(q) - np.sin(begin)))

    def braking(q: float) -> float:
        return float(sign * effort * (end - q) + weight * (np.sin(end) - np.sin(q)))

    switch = brentq(lambda q: speeding(q) - braking(q), begin, end)

    def slowness(root: float, origin: float, way: float, energy: object) -> float:
        """dt / d root with q = origin + way root^2, which is smooth at zero speed."""
        q = origin + way * root**2
        assert callable(energy)
        return float(2.0 * root / np.sqrt(2.0 * max(energy(q), 1e-300) / inertia))

    first, _ = quad(slowness, 1e-9, np.sqrt(abs(switch - begin)), args=(begin, sign, speeding))
    second, _ = quad(slowness, 1e-9, np.sqrt(abs(end - switch)), args=(end, -sign, braking))
    motion = time_along(*line([begin], [end]), robot.limits, drive=Drive(robot))
    assert motion.duration == pytest.approx(first + second, rel=1e-3)
    effort_use = Drive(robot).use_along(motion.moments()).effort
    assert np.max(effort_use) <= 1.001


def test_a_path_is_run_no_faster_than_asked(planar4: Robot) -> None:
    """1 unit of s at no more than 0.2 units a second, with no need to rest at the ends."""
    q, slope, bend = np.zeros((11, 4)), np.zeros((11, 4)), np.zeros((10, 4))
    q[:, 0], slope[:, 0] = np.linspace(0.0, 1.0, 11), 1.0
    limits = with_limits(planar4.limits, velocity=9.0, acceleration=9.0)
    law = time_path(PathShape(q[:, 0], q, slope, bend, bend), limits, drive=None, most=0.2, rests=False)
    assert law is not None
    assert law.duration == pytest.approx(1.0 / 0.2, rel=1e-9)


def test_the_use_of_rods_and_torques_is_that_of_the_direction(backhoe: Robot) -> None:
    """At the limit of either direction it is 1; cylinders push harder than they pull, and extend more slowly."""
    drive, q = Drive(backhoe), np.array([[0.0, 0.2, -1.4, -0.9]])
    assert drive.hydraulics is not None
    rates, torques = drive.hydraulics.velocity_limits(q), drive.torque_limits(q)
    assert not np.allclose(rates.positive[0, 1:], rates.negative[0, 1:], rtol=0.1)
    assert not np.allclose(torques.positive[0, 1:], torques.negative[0, 1:], rtol=0.1)
    for use, limits in ((drive.rod_speed_use, rates), (drive.effort_use, torques)):
        np.testing.assert_allclose(use(q, limits.positive)[0, 1:], 1.0)
        np.testing.assert_allclose(use(q, -limits.negative)[0, 1:], 1.0)


def slow_machine(robot: Robot, **changes: Any) -> tuple[Robot, Hydraulics]:
    assert robot.hydraulics is not None
    hydraulics = replace(robot.hydraulics, **changes)
    return replace(robot, hydraulics=hydraulics), hydraulics


def test_with_a_weak_pump_the_duration_is_volume_over_flow(backhoe: Robot) -> None:
    robot, hydraulics = slow_machine(backhoe, pump_flow=2e-5)
    # lowering the boom and crowding the stick extend the cylinders: the caps are filled
    stations, q = line([0.0, 0.3, -1.0, -1.0], [0.0, -0.4, -1.6, -1.0])
    swept = hydraulics.lengths(q[-1]) - hydraulics.lengths(q[0])
    caps = np.array([cylinder.cap_area for cylinder in hydraulics.cylinders])
    moved = np.abs(swept) > 1e-9
    assert np.all(swept[moved] > 0.0)
    motion = FastestRun(stations, q, robot.limits, drive=Drive(robot)).motion(0.1)
    assert motion.duration == pytest.approx(float(caps @ swept) / 2e-5, rel=1e-3)


def test_with_a_weak_engine_the_duration_is_work_over_power(backhoe: Robot) -> None:
    robot, hydraulics = slow_machine(backhoe, engine_power=500.0, efficiency=0.8)
    stations, q = line([0.2, -0.5, -1.0, -1.0], [0.2, 0.6, -1.0, -1.0])
    load = Dynamics(robot, payload=400.0)
    work = load.potential_energy(q[-1]) - load.potential_energy(q[0])
    motion = time_along(stations, q, robot.limits, drive=Drive(robot, payload=400.0))
    assert motion.duration == pytest.approx(work / hydraulics.power_limit, rel=2e-3)
    assert motion.duration > work / hydraulics.power_limit


def test_the_fastest_law_within_rows_equals_a_linear_program() -> None:
    """Random rows with room at rest: no point can be passed faster."""
    rng = np.random.default_rng(3)
    grid = np.linspace(0.0, 1.0, 61)
    places = np.linspace(0.0, 2.0 * np.pi, 61)[:-1, None]
    phases = rng.uniform(0.0, 6.0, (4, 8))
    alpha, beta = np.sin(places + phases[0]), 2.0 * np.sin(2.0 * places + phases[1])
    gamma = 1.2 + np.sin(places + phases[2])
    law = fastest(grid, np.full(61, 4.0), Rows(alpha, beta, gamma), Rows(alpha, beta, gamma))
    assert law is not None
    for x in (law.x[:-1], law.x[1:]):
        assert np.all(alpha * law.u[:, None] + beta * x[:, None] <= gamma + 1e-7)
    slower = fastest(grid, np.full(61, 4.0), Rows(alpha, beta, 0.5 * gamma), Rows(alpha, beta, 0.5 * gamma))
    assert slower is not None
    assert np.all(slower.x <= law.x + 1e-9)
    # another solver's optimum of the same discrete problem: the sum of x is greatest if every x is
    from scipy.optimize import linprog

    steps = np.diff(grid)[:, None]
    count, rows = 61, []
    bounds = []
    for i in range(60):
        for x_at in (i, i + 1):
            row = np.zeros((8, count))
            row[:, i + 1] += alpha[i] / (2.0 * steps[i])
            row[:, i] -= alpha[i] / (2.0 * steps[i])
            row[:, x_at] += beta[i]
            rows.append(row)
            bounds.append(gamma[i])
    caps = [(0.0, 4.0)] * count
    caps[0] = caps[-1] = (0.0, 0.0)
    best = linprog(-np.ones(count), A_ub=np.vstack(rows), b_ub=np.concatenate(bounds), bounds=caps)
    assert best.status == 0
    np.testing.assert_allclose(law.x, best.x, atol=1e-6)


@pytest.mark.parametrize("seed", [11, 12])
def test_without_a_drive_the_duration_equals_that_of_toppra(backhoe: Robot, seed: int) -> None:
    import logging

    import toppra
    import toppra.algorithm
    import toppra.constraint

    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    q, limits = smooth_path(backhoe, seed), backhoe.limits
    stations = np.linspace(0.0, 6.0, len(q))
    turn = np.linalg.norm(np.diff(q, axis=0), axis=1)
    along = np.concatenate(([0.0], np.cumsum(np.diff(stations) + 0.1 * turn)))
    both = [
        toppra.constraint.JointVelocityConstraint(np.column_stack((-limits.velocity, limits.velocity))),
        toppra.constraint.JointAccelerationConstraint(np.column_stack((-limits.acceleration, limits.acceleration))),
    ]
    curve = toppra.SplineInterpolator(along, q, bc_type="not-a-knot")
    solver = toppra.algorithm.TOPPRA(both, curve, gridpoints=np.linspace(0.0, along[-1], 2001))
    reference = float(solver.compute_trajectory(0.0, 0.0).duration)
    assert time_along(stations, q, limits).duration == pytest.approx(reference, rel=2e-3)


def test_between_the_points_of_its_grid_a_path_is_the_cubic_through_them(tmp_path: Path) -> None:
    """q = s^3 with one interval from 0 to 1: in its middle q = 1/8 and dq/ds = 3/4, and the bend is 3 on average.

    At x = 1e-12 the torque is that of gravity alone. At x = 4 the velocity is 3/4 of 2, and the acceleration 3 times 4.
    """
    robot = pendulum(tmp_path, 400.0)
    shape = PathShape(
        np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), np.array([[0.0], [3.0]]), np.array([[0.0]]), np.array([[6.0]])
    )

    def at_speed(x: float, limits: JointLimits, drive: Drive | None) -> float:
        law = TimeLaw(shape.grid, np.full(2, x), np.array([0.0, 1.0 / np.sqrt(x)]))
        return float(_Loads(shape, limits, drive).over_between(law)[0])

    held = at_speed(1e-12, robot.limits, Drive(robot))
    assert held == pytest.approx(MASS * GRAVITY * LENGTH * np.cos(1.0 / 8.0) / 400.0, rel=1e-6)
    fast = with_limits(robot.limits, velocity=0.5, acceleration=1e3)
    assert at_speed(4.0, fast, None) == pytest.approx(0.75 * 2.0 / 0.5)
    sharp = with_limits(robot.limits, velocity=1e3, acceleration=5.0)
    assert at_speed(4.0, sharp, None) == pytest.approx(3.0 * 4.0 / 5.0)


def test_the_soils_torques_on_a_path_do_not_depend_on_its_parameter(backhoe: Robot) -> None:
    """They are those of a motion at 1 rad/s of the fastest joint, whatever the unit of the path's parameter."""
    q, direction = np.array([[0.0, -0.9, -1.0, -0.9]]), np.array([[0.0, 0.0, -0.8, 0.2]])
    drive = drive_of(posed(backhoe, q, soil={"cohesion": 20000.0, "density": 1900.0, "surface": -3.0}))
    expected = drive.soil_torques(q, direction / 0.8)
    assert np.max(np.abs(expected)) > 1e3
    for unit in (1e-4, 1.0, 50.0):
        np.testing.assert_allclose(drive.soil_torques_towards(q, unit * direction), expected, rtol=1e-9)


def test_samples_too_far_apart_to_tell_accelerations_count_as_sharp_corners(planar4: Robot) -> None:
    """To 1 rad and back in a second each: the rate changes by 2 rad/s, within one period of 0.02 s.

    At 10 rad/s^2 it may change by 0.2 rad/s in that time, so all takes 10 times as long.
    """
    limits = with_limits(planar4.limits, velocity=5.0, acceleration=10.0)
    motion = Trajectory.from_steps(np.array([0.0, 1.0, 2.0]), np.outer([0.0, 1.0, 0.0], np.ones(4)))
    assert _over(motion, limits) == pytest.approx(10.0)


# --- all limits and the binding one -------------------------------------------------


def posed(robot: Robot, q: Matrix, **more: object) -> Problem:
    scene = {
        "version": 1,
        "start": {"joints": dict(zip(robot.joint_names, q[0].tolist(), strict=True))},
        "task": {"goal": {"position": [3.0, 0.0, 0.0]}},
        **more,
    }
    return build_problem(robot, scene_from_dict(scene))


def smooth_path(robot: Robot, seed: int) -> Matrix:
    """(120, n) through four random configurations, within the limits of the joints."""
    rng = np.random.default_rng(seed)
    while True:
        knots = np.array([robot.middle + 0.8 * (robot.random_q(rng) - robot.middle) for _ in range(4)])
        q = CubicSpline(np.linspace(0.0, 1.0, 4), knots, bc_type="natural")(np.linspace(0.0, 1.0, 120))
        if np.all((q > robot.limits.lower) & (q < robot.limits.upper)):
            return np.asarray(q)


def strong(robot: Robot, changes: dict[str, float]) -> Robot:
    return slow_machine(robot, **changes)[0] if changes else robot


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 4))])
@pytest.mark.parametrize(
    ("payload", "changes"),
    [(500.0, {}), (0.0, {"pump_flow": 1.0}), (900.0, {"engine_power": 12e3})],
    ids=["pump", "valves", "engine"],
)
def test_every_limit_holds_at_ten_times_finer_sampling_and_one_binds(
    backhoe: Robot, seed: int, payload: float, changes: dict[str, float]
) -> None:
    """The second claim excludes the ends and changes from one limit to another.

    If the binding limit changes between two points of the grid, the speed in that interval
    is the one that meets both limits; those are less than a hundredth of all moments.
    """
    robot = strong(backhoe, changes)
    q = smooth_path(robot, seed)
    problem = posed(robot, q, payload=payload)
    motion = FastestRun(np.linspace(0.0, 6.0, len(q)), q, problem.limits, drive=drive_of(problem)).motion(0.002)
    usage = limit_usage(problem, motion)
    assert np.max(usage.ratio) <= 1.001
    inside = usage.greatest[2:-2]
    assert np.mean(inside >= 0.98) >= 0.99
    assert np.min(inside) > 0.5


@pytest.mark.parametrize(
    ("changes", "payload", "expected"),
    [
        ({"pump_flow": 5e-4}, 0.0, "pump flow"),
        ({"engine_power": 3e3}, 600.0, "engine power"),
        ({"pump_flow": 1.0, "pressure": 5e6}, 0.0, "torque"),
    ],
)
def test_the_binding_limit_is_reported(
    backhoe: Robot, changes: dict[str, float], payload: float, expected: str
) -> None:
    robot = strong(backhoe, changes)
    q = line([-0.8, -0.4, -1.4, -1.2], [0.8, 0.5, -0.9, -0.8])[1]
    problem = posed(robot, q, payload=payload)
    motion = time_along(np.linspace(0.0, 3.0, len(q)), q, problem.limits, drive=drive_of(problem))
    usage = limit_usage(problem, motion)
    names = [usage.names[index] for index in usage.binding]
    assert np.mean([name.startswith(expected) for name in names]) > 0.3
    assert usage.ratio.shape == (len(motion), len(usage.names))


def test_a_cut_in_soil_takes_longer_within_the_power_of_the_engine(backhoe: Robot) -> None:
    """A cut with a weak engine, slower in soil than in air."""
    robot = strong(backhoe, {"engine_power": 1e3})
    q = line([0.0, -0.9, -0.6, -0.9], [0.0, -0.9, -1.4, -0.9])[1]
    stations = np.linspace(0.0, 2.0, len(q))
    cut = posed(robot, q, soil={"cohesion": 20000.0, "density": 1900.0, "surface": -3.4})
    free = posed(robot, q)
    against = drive_of(cut).soil_torques_towards(q, np.tile(q[-1] - q[0], (len(q), 1)))
    assert np.min(against[:, 2]) < -1e3  # the stick has to crowd harder
    through = time_along(stations, q, cut.limits, drive=drive_of(cut))
    without = time_along(stations, q, free.limits, drive=drive_of(free))
    assert through.duration > 1.05 * without.duration
    usage = limit_usage(cut, through)
    assert np.max(usage.ratio) <= 1.005
    assert "engine power" in {usage.names[index] for index in usage.binding}


# --- loads that are too heavy, motions that are too fast ------------------------------


def test_a_payload_that_cannot_be_held_is_reported_with_joint_and_torque(backhoe: Robot) -> None:
    scene = scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": 0.0, "boom": 0.2, "stick": -0.6, "bucket": -0.4}},
            "task": {"goal": {"position": [4.6, 1.0, 1.0]}},
            "payload": 4000.0,
        }
    )
    found = plan(backhoe, scene, effort="quick")
    assert (found.verdict, found.reason) == ("failed", "outside_limits")
    assert "cannot hold the load" in found.message
    assert found.certificate.effort is not None
    assert found.certificate.effort.joint in found.message
    assert found.certificate.effort.at_rest > 1.0
    q = found.trajectory.q[int(np.argmin(np.abs(found.trajectory.time - found.certificate.effort.time)))]
    gravity = Dynamics(backhoe, payload=4000.0).torques(q, np.zeros(4), np.zeros(4))
    joint = backhoe.joint_names.index(found.certificate.effort.joint)
    assert found.certificate.effort.needed == pytest.approx(gravity[joint], rel=0.1)


def brisk(robot: Robot) -> Trajectory:
    part = np.linspace(0.0, 1.0, 120)
    bend = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    return Trajectory.from_steps(
        3.2 * part, np.array([0.0, 0.0, -1.2, -1.0]) + bend[:, None] * np.array([1.0, 0.5, -0.6, 0.8])
    )


def test_a_motion_that_the_pump_cannot_drive_is_refuted(backhoe: Robot) -> None:
    robot = strong(backhoe, {"pump_flow": 1.5e-3})
    motion = brisk(robot)
    certificate = certify(robot, scene_at(motion), motion)
    assert certificate.hydraulics is not None
    assert certificate.hydraulics.kind == "pump flow"
    assert not certificate.limits_kept
    assert not certificate.safe
    assert any("pump flow" in problem for problem in certificate.problems)


def scene_at(motion: Trajectory) -> Scene:
    names = ("swing", "boom", "stick", "bucket")
    return scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(names, motion.q[0].tolist(), strict=True))},
            "task": {"goal": {"position": [3.0, 0.0, 0.0]}},
        }
    )


def test_retime_keeps_every_sample_and_slows_only_where_necessary(backhoe: Robot) -> None:
    robot = strong(backhoe, {"pump_flow": 1.5e-3})
    motion, drive = brisk(robot), Drive(robot)
    slower = retime(motion, robot.limits, drive=drive)
    assert np.array_equal(slower.q, motion.q)
    use, before = (drive.use_along(found.moments()) for found in (slower, motion))
    assert max(np.max(use.effort), np.max(use.speeds)) <= 1.01
    # this long if slowed by one factor throughout
    assert motion.duration < slower.duration < motion.duration * np.max(before.speeds)
    assert retime(slower, robot.limits, drive=drive) is slower


def test_the_plan_file_holds_the_use_of_the_drive(backhoe: Robot, tmp_path: Path) -> None:
    import json

    motion = brisk(backhoe)
    found = plan(backhoe, scene_at(motion), effort="quick")
    found.save(tmp_path / "plan.json")
    content = json.loads((tmp_path / "plan.json").read_text())
    assert content["certificate"]["limits"]["hydraulics"]["ratio"] <= 1.01
    assert set(content["certificate"]["limits"]) == {"position", "velocity", "acceleration", "effort", "hydraulics"}
    again = load_plan(tmp_path / "plan.json")
    assert again.certificate.hydraulics == found.certificate.hydraulics
    for kind in ("effort", "hydraulics"):  # as in older files
        del content["certificate"]["limits"][kind]
    (tmp_path / "plan.json").write_text(json.dumps(content))
    assert load_plan(tmp_path / "plan.json").certificate.effort == found.certificate.effort


@pytest.mark.parametrize("method", ["auto", pytest.param("reactive", marks=pytest.mark.long)])
@pytest.mark.parametrize("moving", [{}, {"velocity": [0.1, 0.1, 0.0]}, {"appears_at": 1.0}], ids=str)
def test_verified_motions_keep_the_limits_of_the_drive(backhoe: Robot, method: str, moving: dict[str, object]) -> None:
    """All joints at full rate at once would need more than twice the pump's flow."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [2.5, -1.5, 2.6]}
    scene = scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": -1.0, "boom": -0.3, "stick": -1.9, "bucket": -1.6}},
            "task": {"goal": {"position": [3.2, 2.2, 1.2]}},
            "obstacles": [ball | moving],
            "payload": 300.0,
        }
    )
    found = plan(backhoe, scene, method=method, effort="quick")
    assert found.verified, found.message
    use = drive_of(build_problem(backhoe, scene)).use_along(found.trajectory.moments())
    assert max(np.max(use.effort), np.max(use.speeds)) <= 1.01
    assert np.max(use.speeds) > 0.9
