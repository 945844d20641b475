"""The servo: no wish drives the machine into an obstacle, and no wish stops it for good."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from machines import TURNING_SLIDE
from scipy.optimize import linprog

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.law import CompletedLaw, activation
from backhoe_planner.live import (
    BrakingPath,
    Command,
    Feedback,
    Placements,
    Separation,
    Servo,
    Status,
    bound_along,
    corner_rows,
    gaps_at,
    look_closely,
    measure_gradients,
    measure_pair,
    refused_part,
    renew_plane,
    way_back,
)
from backhoe_planner.machine import Robot, bend_weights
from backhoe_planner.site import Nearby, Proximity, build_obstacles

STANDING = [0.0, 0.3, -0.9, -0.5]  # the tip at (4.74, 0, -0.66)
POST = {"name": "post", "shape": "capsule", "radius": 0.15, "from": [4.2, 1.5, -2.0], "to": [4.2, 1.5, 3.0]}
BALL = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [4.5, -1.5, 0.0]}


def site(robot: Robot, obstacles: list[dict[str, Any]], q: list[float] | None = None, **more: Any) -> bp.Scene:
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(robot.joint_names, q or STANDING, strict=True))},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "clearance": 0.05,
            "obstacles": obstacles,
            **more,
        }
    )


def least_margin(robot: Robot, scene: bp.Scene, q: Vector) -> float:
    """The least margin of all pairs, by Proximity, which shares only coal with the servo."""
    proximity = Proximity(robot, build_obstacles(scene, robot))
    return float(np.min(proximity.distances(q) - proximity.clearance))


def test_a_servo_is_shown_in_one_line(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe, [POST, BALL]), dt=0.001)
    assert repr(servo) == "<Servo of backhoe, obstacles: 2, dt 0.001 s, at 0.000 s>"
    servo.step()
    assert "at 0.001 s" in repr(servo)


# --- the braking path ---------------------------------------------------------------------


def test_a_braking_path_equals_the_hand_calculation() -> None:
    """0.4 rad/s at 0.5 rad/s^2 takes 0.8 s; with 0.1 s steps: e = 0.4 * (0.1 + 0.4) = 0.2 rad; the other joint half."""
    path = BrakingPath(
        np.zeros(2), np.array([0.4, -0.2]), 0.1,
        acceleration=(0.5, 1.0), furthest=np.ones(2), turning=np.ones(2),
    )  # fmt: skip
    np.testing.assert_allclose(path.end, [0.2, -0.1], atol=1e-15)
    assert path.time == pytest.approx(0.9)


@pytest.mark.parametrize("v", [[0.4, -0.2, 0.1], [-0.1, 0.7, 0.3], [0.2, 0.1, -0.7]])
def test_the_derivative_of_the_paths_end_equals_central_differences(v: list[float]) -> None:
    def end(rates: Vector) -> Vector:
        return BrakingPath(
            np.zeros(3), rates, 0.01,
            acceleration=(0.5, 1.0, 1.5), furthest=np.ones(3), turning=np.ones(3),
        ).end  # fmt: skip

    path = BrakingPath(
        np.zeros(3), np.array(v), 0.01,
        acceleration=(0.5, 1.0, 1.5), furthest=np.ones(3), turning=np.ones(3),
    )  # fmt: skip
    slowest, sharper = path.bend_of_end
    D = path.look * np.eye(3) + sharper * np.outer(v, np.eye(3)[slowest])
    numeric = np.array([(end(np.array(v) + step) - end(np.array(v) - step)) / 2e-6 for step in 1e-6 * np.eye(3)]).T
    np.testing.assert_allclose(D, numeric, atol=1e-8)


def test_braking_stays_on_the_proven_path() -> None:
    """Braking step by step in proportion ends before e and never leaves the line."""
    rng = np.random.default_rng(3)
    for _ in range(12):
        v, acceleration, dt = rng.normal(size=4), rng.uniform(0.3, 3.0, 4), 0.001
        path = BrakingPath(
            np.zeros(4), v, 0.0, acceleration=tuple(acceleration.tolist()), furthest=np.ones(4), turning=np.ones(4)
        )
        q, rates = np.zeros(4), v.copy()
        while np.any(rates):
            time = float(np.max(np.abs(rates) / acceleration))
            slower = rates * max(1.0 - dt / time, 0.0)
            assert np.all(np.abs(slower - rates) <= acceleration * dt * (1.0 + 1e-9))
            rates = slower
            q = q + rates * dt
        part = q / path.end
        np.testing.assert_allclose(part, part[0], rtol=1e-9)
        assert 0.0 <= part[0] <= 1.0


def test_no_corner_deviates_from_the_chord_by_more_than_its_bound(backhoe: Robot) -> None:
    """At most bend / 8, for the corners of every piece over random motions."""
    rng = np.random.default_rng(4)
    separation = Separation(backhoe, self_collision=False)
    obstacle = build_obstacles(site(backhoe, [BALL]), backhoe)[0]
    pairs = separation.add({0: obstacle})
    at = Placements(backhoe, 3)
    most = 0.0
    for _ in range(200):
        q, delta = backhoe.random_q(rng), rng.normal(size=4) * 0.3
        for sample in range(3):
            at.place(sample, q + 0.5 * sample * delta)
        normal = rng.normal(size=3)
        separation.planes[pairs] = *(normal / np.linalg.norm(normal)), 0.0
        gaps = gaps_at(separation, pairs, at, 3).all
        off = np.abs(gaps[:, 1] - 0.5 * (gaps[:, 0] + gaps[:, 2])).max(axis=1)
        bound = (separation.travel @ bend_weights(delta, separation.turning))[separation.classes[pairs]] / 8.0
        assert np.all(off <= bound + 1e-12)
        most = max(most, float(np.max(off / bound)))
    assert most > 0.2  # the bound is not far too large


# --- planes ---------------------------------------------------------------------------------


def test_gaps_equal_coals_distance_where_measured_and_never_exceed_it_elsewhere(any_robot: Robot) -> None:
    rng = np.random.default_rng(5)
    reach = 4.0 if any_robot.n == 4 else 0.8
    obstacles: list[dict[str, Any]] = [
        {"name": "ball", "shape": "sphere", "radius": 0.1 * reach, "position": [0.6 * reach, 0.2 * reach, 0.0]},
        {"name": "box", "shape": "box", "size": [0.2 * reach] * 3, "position": [-0.5 * reach, 0.3, 0.1]},
        {"name": "post", "shape": "capsule", "radius": 0.1, "from": [0.0, reach, -1.0], "to": [0.2, reach, 1.0]},
        {"name": "floor", "shape": "halfspace", "point": [0.0, 0.0, -reach], "normal": [0.1, 0.0, 1.0]},
    ]
    scene = site(any_robot, obstacles, q=[0.0] * any_robot.n)
    built = build_obstacles(scene, any_robot)
    separation, proximity = Separation(any_robot), Proximity(any_robot, built)
    for number, obstacle in enumerate(built):
        separation.add({number: obstacle})
    everything = np.arange(len(separation))
    assert len(separation) == len(proximity.pairs)
    at = Placements(any_robot, 1)
    known: dict[tuple[int, int, int], float] = {}
    touched = 0
    for _ in range(12):
        q = any_robot.random_q(rng)
        at.place(0, q)
        before = gaps_at(separation, everything, at, 1).all[:, 0].min(axis=1)
        found = np.array([renew_plane(separation, pair, at, 0) for pair in everything.tolist()])
        after = gaps_at(separation, everything, at, 1).all[:, 0].min(axis=1)
        np.testing.assert_allclose(after, found, atol=2e-6)
        assert np.all(before <= found + 2e-6)
        np.testing.assert_allclose(np.sort(found), np.sort(proximity.distances(q)), atol=2e-6)
        touched += int(np.sum(found < 0.0))
        known.clear()
    assert touched > 0


def test_constraint_rows_equal_central_differences(any_robot: Robot) -> None:
    rng = np.random.default_rng(6)
    reach = 4.0 if any_robot.n == 4 else 0.8
    ball = {"name": "ball", "shape": "sphere", "radius": 0.1 * reach, "position": [0.6 * reach, 0.2 * reach, 0.0]}
    separation = Separation(any_robot)
    separation.add({0: build_obstacles(site(any_robot, [ball], q=[0.0] * any_robot.n), any_robot)[0]})
    pairs = np.arange(len(separation))
    at, aside = Placements(any_robot, 1), Placements(any_robot, 1)
    q = any_robot.random_q(rng)
    at.place(0, q)
    for pair in pairs.tolist():
        renew_plane(separation, pair, at, 0)
    corner = gaps_at(separation, pairs, at, 1).all[:, 0].argmin(axis=1)
    rows = corner_rows(separation, pairs, np.zeros(len(pairs), dtype=np.intp), corner, at)
    for joint in range(any_robot.n):
        step = np.zeros(any_robot.n)
        step[joint] = 1e-6
        aside.place(0, q + step)
        ahead = gaps_at(separation, pairs, aside, 1).all[:, 0][pairs, corner]
        aside.place(0, q - step)
        behind = gaps_at(separation, pairs, aside, 1).all[:, 0][pairs, corner]
        np.testing.assert_allclose(rows[:, joint], -(ahead - behind) / 2e-6, atol=1e-7)


def test_the_proven_bound_of_a_path_never_exceeds_its_measured_distance(backhoe: Robot) -> None:
    """Against 60 configurations along the path, measured one by one."""
    rng = np.random.default_rng(7)
    scene = site(backhoe, [POST, BALL, {"name": "box", "shape": "box", "size": [1, 1, 1], "position": [3, 0.5, 1]}])
    built = build_obstacles(scene, backhoe)
    separation, proximity = Separation(backhoe, self_collision=False), Proximity(backhoe, built, self_collision=False)
    for number, obstacle in enumerate(built):
        separation.add({number: obstacle})
    pairs = np.arange(len(separation))
    at = Placements(backhoe, 9)
    tightest = np.inf
    for _ in range(25):
        v = rng.uniform(-1.0, 1.0, 4) * backhoe.limits.velocity
        path = BrakingPath(
            backhoe.random_q(rng), v, 0.001,
            acceleration=tuple(backhoe.limits.acceleration.tolist()),
            furthest=separation.furthest, turning=separation.turning,
        )  # fmt: skip
        at.place(0, path.q)
        path.place(at)
        for pair in pairs.tolist():
            renew_plane(separation, pair, at, 0)
        bound, _ = bound_along(separation, pairs, path, at, 0.0)
        true = np.min([proximity.distances(path.q + s * path.delta) for s in np.linspace(0.0, 1.0, 60)], axis=0)
        assert np.all(bound <= true + 2e-6)
        for pair in pairs.tolist():
            closer, _ = look_closely(separation, pair, path, at, 0.0)
            assert closer <= true[pair] + 2e-6
            tightest = min(tightest, float(true[pair] - closer))
    assert tightest < 0.01


# --- one invariant ---------------------------------------------------------------------------


def pushed(servo: Servo, wish: dict[str, Any], steps: int) -> list[Any]:
    return [servo.step(**wish) for _ in range(steps)]


def keeps_limits(servo: Servo, states: list[Any], before: Vector) -> None:
    limits = servo.limits
    for state in states:
        assert np.all(np.abs(state.v - before) <= limits.acceleration * servo.dt * (1.0 + 1e-9))
        assert np.all(np.abs(state.v) <= limits.velocity * (1.0 + 1e-9))
        assert np.all(state.q <= limits.upper + 1e-9)
        assert np.all(state.q >= limits.lower - 1e-9)
        before = state.v


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.long) for s in (1, 2))])
def test_no_wish_drives_the_machine_into_an_obstacle(backhoe: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall = {"name": "wall", "shape": "box", "size": [0.2, 6.0, 4.0], "position": [5.2, 0.0, 0.0], "rpy": [0, 0, 0.2]}
    scene = site(backhoe, [POST, BALL, wall])
    servo = Servo(backhoe, scene, 0.004)
    proximity = Proximity(backhoe, build_obstacles(scene, backhoe))
    wish: dict[str, Any] = {}
    closest = np.inf
    for step in range(1000):
        if step % 60 == 0:
            if rng.integers(2):
                wish = {"tip_velocity": rng.normal(size=3) * 1.5}
            else:
                wish = {"joint_velocity": rng.uniform(-2, 2, 4)}
        before = servo.v
        state = servo.step(**wish)
        keeps_limits(servo, [state], before)
        margin = float(np.min(proximity.distances(state.q) - proximity.clearance))
        assert margin >= -1e-6
        assert state.margin <= margin + 2e-6 or margin > 0.2
        closest = min(closest, margin)
    assert closest < 0.05


def test_a_machine_driven_at_full_speed_into_a_post_stops_before_it(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe, [POST]), 0.004)
    states = pushed(servo, {"joint_velocity": [0.8, 0.0, 0.0, 0.0]}, 750)
    keeps_limits(servo, states, np.zeros(4))
    assert max(state.v[0] for state in states) > 0.3
    margin = least_margin(backhoe, site(backhoe, [POST]), states[-1].q)
    assert 0.0 <= margin < 0.01
    assert abs(states[-1].v[0]) < 0.01
    assert states[-1].status in (Status.STOPPED, Status.SLIDING)
    assert states[-1].nearest is not None
    assert states[-1].nearest.obstacle == "post"


def test_a_machine_driven_obliquely_into_a_wall_slides_along_it(backhoe: Robot) -> None:
    """A wall across y: the part of the wish along the wall is followed, the part into it is not."""
    wall = {"name": "wall", "shape": "halfspace", "point": [0.0, 0.8, 0.0], "normal": [0.0, -1.0, 0.0]}
    servo = Servo(backhoe, site(backhoe, [wall]), 0.004)
    states = pushed(servo, {"tip_velocity": [-0.3, 0.4, 0.0]}, 625)
    assert states[-1].status is Status.SLIDING
    assert states[-1].tip_velocity[0] < -0.2
    assert abs(states[-1].tip_velocity[1]) < 0.05
    assert states[-1].feedback_force[1] < -5.0
    assert least_margin(backhoe, site(backhoe, [wall]), states[-1].q) >= -1e-6


def test_circulation_leads_past_a_ball(backhoe: Robot) -> None:
    """Driven straight at a ball, the machine stops; with circulation it passes."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.4, "position": [4.5, 0.7, -0.6]}
    after = {}
    for circulate in (False, True):
        servo = Servo(backhoe, site(backhoe, [ball], q=[-0.2, 0.3, -0.9, -0.5]), 0.004, circulate=circulate)
        states = pushed(servo, {"tip_velocity": [0.0, 0.4, 0.0]}, 1500)
        after[circulate] = states[-1].tip_position[1]
        assert least_margin(backhoe, site(backhoe, [ball]), states[-1].q) >= -1e-6
    assert after[True] > 1.0
    assert after[True] > after[False]


@pytest.mark.long
def test_pressing_against_a_flat_wall_causes_no_chatter(backhoe: Robot) -> None:
    """The joint rates change smoothly: no witness point jumps from edge to edge."""
    wall = {"name": "wall", "shape": "box", "size": [0.2, 8.0, 8.0], "position": [5.2, 0.0, 0.0]}
    servo = Servo(backhoe, site(backhoe, [wall]))
    states = pushed(servo, {"tip_velocity": [0.5, 0.0, 0.0]}, 2500)
    v = np.array([state.v for state in states])[1500:]
    window = np.ones(51) / 51.0
    smooth = np.array([np.convolve(joint, window, mode="valid") for joint in v.T]).T
    assert np.max(np.abs(v[25:-25] - smooth)) < 0.03
    assert least_margin(backhoe, site(backhoe, [wall]), states[-1].q) >= -1e-6


# --- obstacles come and go -------------------------------------------------------------------


def test_an_obstacle_that_appears_ahead_is_not_touched(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe, []), 0.004)
    pushed(servo, {"joint_velocity": [0.8, 0, 0, 0]}, 125)
    servo.add(POST)
    states = pushed(servo, {"joint_velocity": [0.8, 0, 0, 0]}, 750)
    assert list(servo.obstacles) == ["post"]
    margins = [least_margin(backhoe, site(backhoe, [POST]), state.q) for state in states[::12]]
    assert min(margins) >= -1e-6
    assert min(margins) < 0.01
    servo.remove("post")
    assert len(servo.obstacles) == 0
    assert pushed(servo, {"joint_velocity": [0.8, 0, 0, 0]}, 50)[-1].v[0] > 0.05


def test_the_machine_evades_an_approaching_obstacle_without_a_wish(backhoe: Robot) -> None:
    """A ball approaches the stick from the side at 0.15 m/s for 8 s: the arm swings away from it."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [3.2, -1.2, 0.6], "velocity": [0, 0.15, 0]}
    servo = Servo(backhoe, site(backhoe, [ball]), 0.004)
    evading = 0
    robot_alone = Proximity(backhoe, build_obstacles(site(backhoe, [ball]), backhoe))
    for step in range(2000):
        state = servo.step()
        evading += state.status is Status.EVADING
        if step % 5 == 0:
            assert np.min(robot_alone.distances(state.q, time=servo.time) - robot_alone.clearance) > -1e-3
    assert evading > 25  # 0.1 s
    final = robot_alone.distances(np.array(STANDING), time=servo.time) - robot_alone.clearance
    assert np.min(final) < -0.05  # had the arm stayed at its start
    np.testing.assert_allclose(servo.shift_of("ball"), [0.0, 1.2, 0.0], atol=1e-9)


def test_a_moved_obstacle_counts_at_its_new_place(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe, [BALL]), 0.004)
    servo.move("ball", [0.0, 0.6, 0.0])
    servo.step()
    moved = dict(BALL, position=[4.5, -0.9, 0.0])
    states = pushed(servo, {"joint_velocity": [-0.8, 0, 0, 0]}, 625)
    margins = [least_margin(backhoe, site(backhoe, [moved]), state.q) for state in states[::25]]
    assert 0.0 <= min(margins) < 0.1


def test_a_scan_is_an_obstacle_until_the_next_of_its_name_replaces_it(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe, []), 0.004)
    cloud = np.random.default_rng(1).uniform(-0.3, 0.3, (300, 3))
    servo.add_points("scan", cloud + np.array([4.4, 3.0, -0.5]), resolution=0.1)
    servo.add_points("scan", cloud + np.array([4.4, 1.1, -0.5]), resolution=0.1)
    assert list(servo.obstacles) == ["scan"]
    states = pushed(servo, {"joint_velocity": [0.8, 0, 0, 0]}, 500)
    near = [state.margin for state in states if state.nearest is not None and state.nearest.obstacle == "scan"]
    assert 0.0 <= min(near) < 0.05
    nothings: tuple[object, ...] = (np.zeros((0, 3)), [])
    for nothing in nothings:
        servo.add_points("scan", cloud + np.array([4.4, 1.1, -0.5]), resolution=0.1)
        assert "scan" in servo.obstacles
        servo.add_points("scan", nothing)
        assert "scan" not in servo.obstacles
    assert len(servo.obstacles) == 0


@pytest.mark.parametrize(
    "call",
    [
        lambda servo: servo.add(dict(BALL)),
        lambda servo: servo.add({"name": "x", "shape": "bal"}),
        lambda servo: servo.remove("nothing"),
        lambda servo: servo.move("ball", [1.0, np.nan, 0.0]),
        lambda servo: servo.set_velocity("ball", [1.0]),
        lambda servo: servo.add_points("scan", [[1.0, 2.0]]),
    ],
)
def test_misuse_of_obstacles_is_refused(backhoe: Robot, call: Any) -> None:
    with pytest.raises(bp.InputError):
        call(Servo(backhoe, site(backhoe, [BALL])))


# --- recovery ------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_limit_violation_shrinks_at_every_step(backhoe: Robot, side: float) -> None:
    limits = backhoe.limits
    q = np.array(STANDING)
    q[3] = limits.upper[3] + 0.1 if side > 0 else limits.lower[3] - 0.1
    servo = Servo(backhoe, site(backhoe, []), 0.004, q=q)
    outside = 0.1
    for _ in range(2000):
        state = servo.step(joint_velocity=[0.0, 0.0, 0.0, side])
        now = float(max(state.q[3] - limits.upper[3], limits.lower[3] - state.q[3]))
        if outside <= 0.0:
            assert now <= 1e-9
        else:
            assert now < outside
        outside = now
    assert outside <= 0.0


def test_a_slide_far_outside_its_limit_is_not_swung_into_a_post(tmp_path: Path) -> None:
    """A 0.1 m ball, 1 m beyond its slide's limit, swings at a 0.15 m post that no position within the limit reaches."""
    path = tmp_path / "slide.urdf"
    path.write_text(TURNING_SLIDE)
    robot, foot = bp.load_robot(path), 1.35 * np.array([np.cos(0.8), np.sin(0.8)])
    post = {"name": "post", "shape": "capsule", "radius": 0.15, "from": [*foot, -1.0], "to": [*foot, 1.0]}
    scene = site(robot, [post], q=[0.0, 0.5])
    servo = Servo(robot, scene, q=[0.0, 1.5])
    for _ in range(1500):
        state = servo.step(joint_velocity=[1.0, 1.0])
        turned, out = state.q
        ball = out * np.array([np.cos(turned), np.sin(turned)])
        assert np.linalg.norm(ball - foot) - 0.25 >= 0.05 - 1e-6
    assert turned > 0.4  # it did come near


@pytest.mark.parametrize(
    "depth", [pytest.param(0.02, marks=pytest.mark.long), pytest.param(0.1, marks=pytest.mark.long), 0.2]
)
def test_the_violation_inside_a_ball_shrinks_at_every_step(backhoe: Robot, depth: float) -> None:
    clear = bp.Kinematics(backhoe).at(np.array(STANDING)).tip_position
    centre = (clear + np.array([0.0, 0.0, depth - 0.3])).tolist()
    scene = site(backhoe, [{"name": "ball", "shape": "sphere", "radius": 0.3, "position": centre}])
    servo = Servo(backhoe, scene, 0.004)
    proximity = Proximity(backhoe, build_obstacles(scene, backhoe))
    before = float(np.min(proximity.distances(servo.q) - proximity.clearance))
    assert before < -depth
    for _ in range(1500):
        state = servo.step([0.0, 0.0, -0.3])  # further in
        now = float(np.min(proximity.distances(state.q) - proximity.clearance))
        if before < -1e-6:
            assert now > before
        else:
            assert now >= -1e-6
            break
        before = now
    assert now >= -1e-6


@pytest.mark.parametrize("dt", [*(pytest.param(dt, marks=pytest.mark.long) for dt in (1e-3, 1e-4)), 1e-5])
def test_the_way_out_of_an_obstacle_begins_even_with_short_time_steps(backhoe: Robot, dt: float) -> None:
    """At a post near the swing axis, where the first step from rest gains about 1e-12 m in 10 us."""
    post = {"name": "post", "shape": "capsule", "from": [0.05, 0.22, 0.3], "to": [0.05, 0.22, 1.2], "radius": 0.02}
    scene = site(backhoe, [post], [0.0, 0.4, -1.6, -0.9], clearance=0.02)
    servo = Servo(backhoe, scene, dt=dt)
    proximity = Proximity(backhoe, build_obstacles(scene, backhoe))
    before = float(np.min(proximity.distances(servo.q) - proximity.clearance))
    assert before < -0.01
    for _ in range(200):
        state = servo.step(joint_velocity=[0.8, 0.0, 0.0, 0.0])
    assert np.min(proximity.distances(state.q) - proximity.clearance) > before


def started_inside(robot: Robot, seed: int) -> tuple[Vector, bp.Scene, Proximity]:
    """A random configuration that violates its clearance from a random obstacle by 3 to 30 cm."""
    rng = np.random.default_rng([seed, 7])
    alone, kinematics = Proximity(robot), bp.Kinematics(robot)
    while True:
        q = robot.random_q(rng)
        if np.any(alone.distances(q) < 0.02):
            continue
        part = rng.uniform(0.4, 1.0)
        place = (part * kinematics.at(q).tip_position + rng.normal(size=3) * 0.3).tolist()
        obstacle: dict[str, Any] = [
            {"shape": "sphere", "radius": float(rng.uniform(0.1, 0.5)), "position": place},
            {"shape": "box", "size": rng.uniform(0.1, 1.2, 3).tolist(), "position": place, "rpy": [0.3, 0.2, seed % 6]},
            {"shape": "capsule", "radius": 0.1, "from": place, "to": (np.array(place) + rng.normal(size=3)).tolist()},
        ][seed % 3]
        scene = site(robot, [{"name": "thing", **obstacle}], q=q.tolist())
        proximity = Proximity(robot, build_obstacles(scene, robot))
        if -0.3 < float(np.min(proximity.distances(q) - proximity.clearance)) < -0.03:
            return q, scene, proximity


# each shape with each kind of wish; scripts/study_servo.py --recoveries has many more
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 3, 4, 5, 8))])
def test_the_deepest_violation_shrinks_at_every_step(backhoe: Robot, seed: int) -> None:
    q, scene, proximity = started_inside(backhoe, seed)
    rng = np.random.default_rng(seed)
    wish = {"tip_velocity": rng.normal(size=3)} if seed % 2 else {"joint_velocity": rng.uniform(-1, 1, 4)}
    servo = Servo(backhoe, scene)
    before = float(np.max(proximity.clearance - proximity.distances(q)))
    v = np.zeros(4)
    for _ in range(10_000):
        state = servo.step(**wish)
        now = float(np.max(proximity.clearance - proximity.distances(state.q)))
        assert now < before
        assert np.all(np.abs(state.v - v) <= backhoe.limits.acceleration * servo.dt * (1.0 + 1e-9))
        v, before = state.v, now
        if now <= 1e-6:
            break
    assert before <= 1e-6


@pytest.mark.long
def test_a_post_through_the_machines_own_foot_never_gets_deeper(backhoe: Robot) -> None:
    """A vertical post through the middle of the swing's body: no step increases the violation."""
    post = {"name": "post", "shape": "capsule", "radius": 0.1, "from": [0.3, 0, -1.0], "to": [0.3, 0, 2.0]}
    scene = site(backhoe, [post])
    proximity = Proximity(backhoe, build_obstacles(scene, backhoe))
    servo = Servo(backhoe, scene)
    deepest = [float(np.max(proximity.clearance - proximity.distances(servo.q)))]
    for _ in range(1600):
        state = servo.step([0.5, 0.5, 0.5])
        deepest.append(float(np.max(proximity.clearance - proximity.distances(state.q))))
    assert deepest[0] > 0.1
    assert np.max(np.diff(deepest)) <= 0.0
    assert deepest[-1] < deepest[0] - 0.01


def test_the_recovery_speed_is_optimal() -> None:
    """Against a linear programme in (v, t), with neither a speed limit nor other rows."""
    rng = np.random.default_rng(8)
    for _ in range(60):
        rows, slack = rng.normal(size=(6, 4)), rng.uniform(0.0, 0.2, 6)
        low, high = -rng.uniform(0.0005, 0.5, 4), rng.uniform(0.0005, 0.5, 4)
        found = way_back(
            rows, slack, target=rng.normal(size=4), low=low, high=high, fastest=10.0,
        )  # fmt: skip
        best = linprog(
            [0.0, 0.0, 0.0, 0.0, -1.0], A_ub=np.hstack((rows, np.ones((6, 1)))), b_ub=slack,
            bounds=[*zip(low, high, strict=True), (None, None)],
        )  # fmt: skip
        assert found is not None
        v, speed = found
        assert np.all(rows @ v + speed <= slack + 1e-6)
        scale = float(np.max(np.abs(rows) @ np.maximum(-low, high)))
        assert speed == pytest.approx(best.x[4], abs=0.02 * scale)


def test_gradients_of_penetrating_pairs_equal_central_differences(backhoe: Robot) -> None:
    checked = 0
    for seed in range(0, 30, 3):  # spheres, whose distance is smooth
        q, scene, _ = started_inside(backhoe, seed)
        separation = Separation(backhoe, self_collision=False)
        pairs = separation.add({0: build_obstacles(scene, backhoe)[0]})
        at = Placements(backhoe, 1)

        def distances(where: Vector, separation: Separation = separation, at: Any = at, pairs: Any = pairs) -> Vector:
            at.place(0, where)
            return np.array([measure_pair(separation, pair, at, 0)[0] for pair in pairs.tolist()])

        at.place(0, q)
        found, falls = measure_gradients(separation, pairs, at, 0)
        numeric = np.array([(distances(q - step) - distances(q + step)) / 2e-5 for step in 1e-5 * np.eye(4)]).T
        smooth = np.abs(distances(q + 1e-5) + distances(q - 1e-5) - 2.0 * found) < 1e-7
        np.testing.assert_allclose(falls[smooth], numeric[smooth], atol=2e-3)
        checked += int(np.sum(smooth & (found < 0.0)))
    assert checked > 5


# --- commands ------------------------------------------------------------------------------------


def test_without_commands_the_machine_brakes_within_its_limits_and_resumes_afterwards(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe, []), watchdog=0.1)
    states = pushed(servo, {"joint_velocity": [0.3, 0.0, 0.0, 0.2]}, 800)
    before = states[-1].v
    states = pushed(servo, {}, 1500)
    keeps_limits(servo, states, before)
    assert states[50].command is Command.HELD
    assert states[50].v[0] == pytest.approx(0.3)
    assert states[-1].command is Command.TIMED_OUT
    assert states[-1].status is Status.STOPPED
    np.testing.assert_allclose(states[-1].v, 0.0, atol=1e-9)
    state = pushed(servo, {"joint_velocity": [0.3, 0.0, 0.0, 0.2]}, 700)[-1]
    assert state.command is Command.NEW
    assert state.v[0] == pytest.approx(0.3)


NONSENSE: list[dict[str, Any]] = [
    {"tip_velocity": [np.nan, 0.0, 0.0]},
    {"tip_velocity": [np.inf, 0.0, 0.0]},
    {"tip_velocity": [1.0, 2.0]},
    {"tip_velocity": "fast"},
    {"tip_velocity": object()},
    {"tip_velocity": [[1.0, 0.0, 0.0]]},
    {"tip_velocity": [0.1, 0.0, 0.0], "joint_velocity": [0.1, 0.0, 0.0, 0.0]},
    {"joint_velocity": [1.0]},
    {"pitch_rate": 0.1},
    {"tip_velocity": [0.1, 0.0, 0.0], "pitch_rate": "up"},
    {"tip_velocity": {"x": 1.0}},
]


@pytest.mark.parametrize("wish", NONSENSE)
def test_invalid_commands_bring_the_machine_to_rest(backhoe: Robot, wish: dict[str, Any]) -> None:
    servo = Servo(backhoe, site(backhoe, [BALL]), 0.005, watchdog=0.05)
    pushed(servo, {"joint_velocity": [0.2, 0.0, 0.0, 0.0]}, 60)
    assert np.any(servo.v)
    states = pushed(servo, wish, 200)
    assert {state.command for state in states} == {Command.INVALID}
    assert np.all(np.isfinite([state.q for state in states]))
    np.testing.assert_allclose(states[-1].v, 0.0, atol=1e-9)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=0, max_size=5))
def test_no_wish_raises_an_exception(values: list[float]) -> None:
    servo = _SHARED()
    state = servo.step(values)
    assert np.all(np.isfinite(state.q))
    assert np.all(np.isfinite(state.feedback_force))


def _SHARED(made: list[Servo] = []) -> Servo:  # noqa: B006
    if not made:
        robot = bp.load_robot("example:backhoe")
        made.append(Servo(robot, site(robot, [BALL, POST])))
    return made[0]


def test_a_failing_law_makes_the_machine_brake_on_the_proven_path(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    servo = Servo(backhoe, site(backhoe, [POST]))
    moving = pushed(servo, {"tip_velocity": [0.0, 0.6, 0.2]}, 900)[-1]

    def fails(*_: object) -> None:
        raise ZeroDivisionError

    # opens the wall: a fault in the middle of a step, which nothing outside can cause
    monkeypatch.setattr(servo._tip.law, "quick_terms_unchecked", fails)
    states = pushed(servo, {"tip_velocity": [0.0, 0.6, 0.2]}, 1500)
    keeps_limits(servo, states, moving.v)
    assert not any(state.proven for state in states)
    np.testing.assert_allclose(states[-1].v, 0.0, atol=1e-9)
    assert least_margin(backhoe, site(backhoe, [POST]), states[-1].q) >= -1e-6
    monkeypatch.undo()
    assert pushed(servo, {"tip_velocity": [0.0, -0.3, 0.0]}, 900)[-1].tip_velocity[1] < -0.1


def test_the_scalar_activation_equals_the_vector_one(backhoe: Robot) -> None:
    law = CompletedLaw(backhoe, influence=0.3)
    margins = np.linspace(-0.1, 0.5, 61)
    expected = activation(margins, law.unity, law.influence)
    # opens the wall: the scalar path equals the public vector one
    np.testing.assert_allclose([law._activation(margin) for margin in margins.tolist()], expected, atol=1e-15)


def test_the_closed_form_for_one_redundant_joint_equals_the_general_law(backhoe: Robot) -> None:
    """Also near limits, obstacles and singularities; the plain version leaves the last of these to the general law."""
    rng = np.random.default_rng(12)
    law, kinematics = CompletedLaw(backhoe, influence=0.3), bp.Kinematics(backhoe)
    faster = bent = 0
    for _ in range(500):
        at = kinematics.at(backhoe.random_q(rng))
        J, xdot, count = at.jacobian[:3], rng.normal(size=3), int(rng.integers(0, 45))
        nearby = Nearby(
            pair=np.arange(count), distance=np.zeros(count), margin=rng.uniform(-0.05, 0.4, count),
            normal=np.zeros((count, 3)), point_link=np.zeros((count, 3)), point_obstacle=np.zeros((count, 3)),
            gradient=rng.normal(size=(count, 4)), drift=rng.normal(size=count) * 0.1,
        )  # fmt: skip
        plain, found = law.wish(at, J, xdot, nearby), law.quick_terms_unchecked(at.q, J, xdot, nearby)
        primary, null = law.terms_unchecked(at, J, xdot, nearby)
        np.testing.assert_allclose([primary, null], [plain.primary, plain.null], rtol=1e-8, atol=1e-8)
        if found is None:
            continue
        np.testing.assert_allclose(found[:2], [plain.primary, plain.null], rtol=1e-8, atol=1e-8)
        assert found[2] == pytest.approx(plain.task.damping, abs=1e-8)
        faster += 1
        bent += bool(np.abs(plain.null).max() > 1e-3)
    assert faster > 300
    assert bent > 200


def test_a_free_tip_moves_at_the_wished_velocity(backhoe: Robot) -> None:
    servo = Servo(backhoe, site(backhoe, []))
    state = pushed(servo, {"tip_velocity": [0.1, 0.1, 0.05], "pitch_rate": 0.05}, 1500)[-1]
    np.testing.assert_allclose(state.tip_velocity, [0.1, 0.1, 0.05], atol=2e-3)
    assert float(np.sum(state.v[1:])) == pytest.approx(0.05, abs=2e-3)
    assert state.status is Status.OK
    np.testing.assert_allclose(state.feedback_force, 0.0, atol=0.2)


def test_a_planar_arm_is_driven_in_its_plane(planar4: Robot) -> None:
    servo = Servo(planar4, site(planar4, [], q=[0.3, 0.5, 0.4, 0.3]), self_collision=False)
    state = pushed(servo, {"tip_velocity": [0.1, -0.1, 0.3]}, 1000)[-1]
    np.testing.assert_allclose(state.tip_velocity, [0.1, -0.1, 0.0], atol=2e-3)


# --- force -------------------------------------------------------------------------------------


def test_the_force_opposes_the_refused_velocity_and_is_bounded() -> None:
    feedback = Feedback(0.001, largest=30.0)
    force = np.zeros(3)
    for _ in range(200):
        force = feedback.next(np.array([0.4, 0.0, 0.0]), np.array([0.4, 0.0, 0.0]), np.zeros(3), 0.0)
    assert -30.0 < force[0] < -15.0
    for _ in range(200):
        force = feedback.next(np.array([90.0, 0.0, 0.0]), np.array([90.0, 0.0, 0.0]), np.zeros(3), 0.0)
    assert np.linalg.norm(force) <= 30.0


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 4))])
def test_the_force_never_feeds_energy_to_the_hand(seed: int) -> None:
    """Cyclic hand motions with random refusals: the work is never above 1e-6 J."""
    rng = np.random.default_rng(seed)
    feedback = Feedback(0.001)
    work, force, felt = 0.0, np.zeros(3), 0.0
    for step in range(20_000):
        phase = 2.0 * np.pi * step / 1000.0
        hand = np.array([np.cos(phase), np.sin(2.0 * phase), np.cos(3.0 * phase)])
        work += 0.001 * float(force @ hand)
        assert work <= 1e-6
        normal = rng.normal(size=3)
        force = feedback.next(hand, rng.normal(size=3), normal / np.linalg.norm(normal), rng.uniform())
        felt = max(felt, float(np.linalg.norm(force)))
    assert felt > 5.0


@pytest.mark.parametrize(
    ("difference", "refused"),
    [
        ([0.6, 0.0, 0.8], [0.6, 0.0, 0.8]),  # at rest: all of it
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
        ([0.6, 0.0, 0.0], [0.6, 0.0, 0.0]),  # it slides along a wall across x
        ([0.3, 0.0, -1.6], [0.3, 0.0, -0.1]),  # dragged up
        ([1.2, 0.0, 1.6], [0.6, 0.0, 0.8]),  # driven back at the wished speed: still no more than all
        ([-0.6, 0.0, -0.8], [0.0, 0.0, 0.0]),  # it goes twice as fast as wished
        ([0.3, 2.0, 0.4], [0.3, 0.5, 0.4]),  # dragged to the side
    ],
)
def test_the_refused_part_of_a_wish_equals_the_hand_calculation(difference: list[float], refused: list[float]) -> None:
    """A wish of 1 m/s along (0.6, 0, 0.8): its parts form a ball of radius 0.5 about (0.3, 0, 0.4)."""
    found = refused_part(np.array([0.6, 0.0, 0.8]), np.array(difference))
    np.testing.assert_allclose(found, refused, atol=1e-12)
    assert not refused_part(np.zeros(3), np.array(difference)).any()


def test_status_and_command_names_are_words() -> None:
    assert [status.value for status in Status] == [
        "ok", "near_singularity", "near_limit", "near_obstacle", "sliding", "stopped", "evading", "too_close",
    ]  # fmt: skip
    assert len(set(itertools.chain(Status, Command))) == 12
