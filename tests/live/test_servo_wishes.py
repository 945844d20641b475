"""Wishes that joint limits or surfaces allow only in part."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.law import MOST_ITERATIONS, MOST_SOFT_ROWS, Rows, solve_program
from backhoe_planner.live import (
    MOST_DISTANCES,
    MOST_NEAR,
    Command,
    Placements,
    Servo,
    ServoState,
    Status,
    StepWork,
    VelocityRange,
    VelocityWish,
    velocity_program,
)
from backhoe_planner.live.servo.tip_task import turn_along_surface
from backhoe_planner.machine import Robot

ONE_HINGE = """<robot name="gate">
<link name="post"><collision><geometry><box size="0.3 0.3 0.1"/></geometry></collision></link>
<link name="bar"><inertial><origin xyz="0 0 0.5"/><mass value="2"/>
<inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.5"/><geometry><box size="0.08 0.08 1"/></geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="post"/><child link="bar"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="1" effort="500"/></joint>
<link name="tip"/><joint name="end" type="fixed"><parent link="bar"/><child link="tip"/><origin xyz="0 0 1"/></joint>
</robot>
"""


def standing(robot: Robot, q: object, **more: object) -> Servo:
    joints = dict(zip(robot.joint_names, np.asarray(q, dtype=float).tolist(), strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}}
    return Servo(robot, bp.scene_from_dict({**content, "clearance": 0.05, **more}), dt=0.004)


def driven(servo: Servo, wish: object, seconds: float) -> list[ServoState]:
    return [servo.step(wish) for _ in range(round(seconds / servo.dt))]


def test_a_joint_at_its_limit_does_not_let_the_others_run_away(backhoe: Robot) -> None:
    """The stick is at its limit and the wish is "in": the boom alone would drop the tip at over twice the speed."""
    servo = standing(backhoe, [0.0, -0.55, -0.1745, 0.68])
    states = driven(servo, [-0.6, 0.0, 0.0], 2.5)
    assert max(float(np.linalg.norm(state.tip_velocity)) for state in states) <= 0.6 * 1.02
    assert states[-1].tip_position[0] < states[0].tip_position[0] - 0.2


@pytest.mark.long
def test_wishes_are_followed_at_least_as_well_as_by_standing_still(backhoe: Robot) -> None:
    """Zero is always an allowed velocity, so the nearest allowed one is never farther from the wish than zero.

    Nor is it faster: in a convex set that contains 0, the point nearest to a wish is no longer than the wish. The
    first half second is left for braking motions in other directions.
    """
    rng = np.random.default_rng(5)
    followed = 0
    for _ in range(16):
        while True:
            q = backhoe.random_q(rng)
            if bp.Proximity(backhoe).distances(q).min() > 0.05:
                break
        wish = rng.normal(size=3)
        wish *= 0.6 / np.linalg.norm(wish)
        for state in driven(standing(backhoe, q), wish, 1.5)[125:]:
            assert np.linalg.norm(state.tip_velocity) <= 0.6 * 1.05
            assert np.linalg.norm(state.tip_velocity - wish) <= 0.6 * 1.05
            followed += bool(np.linalg.norm(state.tip_velocity - wish) < 0.06)
    assert followed > 1000


def test_a_stretched_arm_that_is_pulled_further_comes_to_rest(backhoe: Robot) -> None:
    """The bucket does not swing to and fro when the tip cannot go any further."""
    servo = standing(backhoe, [0.0, 0.1, -0.3, 0.0])
    states = driven(servo, [0.6, 0.0, 0.0], 6.0)
    bucket = np.array([state.v[3] for state in states])
    turns = np.flatnonzero(np.diff(np.sign(bucket[np.abs(bucket) > 0.02])))
    assert len(turns) <= 2
    assert np.abs(states[-1].v).max() < 0.02


def test_a_stick_pressed_onto_the_ground_stays_there(backhoe: Robot) -> None:
    """With the stick on the ground no motion serves a wish straight down, and none is made."""
    ground = {"name": "ground", "shape": "halfspace", "point": [0, 0, 0], "normal": [0, 0, 1], "clearance": 0.0}
    servo = standing(backhoe, [0.0, 0.66, -2.0, -0.2], obstacles=[{**ground, "links": ["stick"]}])
    states = driven(servo, [0.0, 0.0, -0.4], 6.0)
    touching = [state for state in states if state.margin < 0.01]
    assert len(touching) > 500
    late = states[-500:]
    assert np.ptp([state.tip_position[0] for state in late]) < 0.05
    assert max(float(np.linalg.norm(state.tip_velocity - [0.0, 0.0, -0.4])) for state in late) <= 0.41
    assert max(float(np.linalg.norm(state.tip_velocity)) for state in late) < 0.02
    assert late[-1].status in (Status.SLIDING, Status.STOPPED)


def test_a_wall_refuses_the_whole_wish_into_it_and_never_more(backhoe: Robot) -> None:
    """All of 0.4 m/s straight into a wall once the tip is at it; nothing on the free path there."""
    wall = {"name": "wall", "shape": "box", "size": [0.1, 5.0, 2.5], "position": [4.95, 0.0, -1.5], "clearance": 0.1}
    servo, wish = standing(backhoe, [0.0, 0.2, -1.3, -0.8], obstacles=[wall]), np.array([0.4, 0.0, 0.0])
    states = driven(servo, wish, 6.0)
    free = [state for state in states if state.margin == math.inf]
    assert len(free) > 100
    assert max(float(np.abs(state.refused).max()) for state in free) < 1e-9
    for state in states:
        assert np.linalg.norm(state.refused) <= 0.4 + 1e-9
        assert state.refused @ (wish - state.refused) >= -1e-9
        assert np.linalg.norm(state.feedback_force) <= 30.0
    for state in states[-50:]:
        np.testing.assert_allclose(state.tip_velocity, 0.0, atol=0.02)
        np.testing.assert_allclose(state.refused, wish, atol=0.02)
        np.testing.assert_allclose(state.feedback_force[1:], 0.0, atol=0.3)
    back = driven(servo, -wish, 2.0)
    np.testing.assert_allclose(back[-1].tip_velocity, -wish, atol=0.01)
    np.testing.assert_allclose(back[-1].refused, 0.0, atol=0.001)


def test_a_machine_near_a_box_that_refuses_its_wish_is_sliding_or_stopped(backhoe: Robot) -> None:
    """Close to the box the wish itself is reduced, and the step follows what is left of it."""
    box: dict[str, object] = {"name": "box", "shape": "box", "size": [0.6, 3.0, 3.0], "position": [5.2, 0.0, 1.0]}
    servo = standing(backhoe, [0.0, 0.4, -1.6, -0.9], obstacles=[box], clearance=0.05)
    pressed = [state for state in driven(servo, [0.3, 0.0, 0.0], 9.6) if np.linalg.norm(state.refused) > 0.05]
    near = [state for state in pressed if state.margin < 0.09]
    assert len(near) > 300
    assert {state.status for state in near} <= {Status.SLIDING, Status.STOPPED}
    assert min(state.margin for state in near) >= 0.0


def test_a_zero_wish_is_not_reported_as_stopped(backhoe: Robot) -> None:
    """Driven to a wall and released: at rest next to it, where the null space would lead away, nothing is held back."""
    wall = {"name": "wall", "shape": "box", "size": [0.1, 5.0, 2.5], "position": [4.95, 0.0, -1.5], "clearance": 0.1}
    servo = standing(backhoe, [0.0, 0.2, -1.3, -0.8], obstacles=[wall])
    pressed = driven(servo, [0.4, 0.0, 0.0], 4.5)
    assert pressed[-1].status in (Status.SLIDING, Status.STOPPED)
    assert {state.status for state in driven(servo, [0.0, 0.0, 0.0], 2.0)} == {Status.NEAR_OBSTACLE}
    assert np.abs(servo.v).max() < 0.001
    silent = driven(servo, None, 0.3)
    assert silent[-1].status is Status.STOPPED
    assert silent[-1].command is Command.TIMED_OUT


def test_a_machine_that_starts_or_creeps_is_not_reported_as_stopped(backhoe: Robot) -> None:
    """Slower than the threshold for standing: after 4 ms at 0.2 rad/s^2, and at a wish of 0.2 mm/s for a free tip."""
    slow = {"acceleration": dict.fromkeys(backhoe.joint_names, 0.2)}
    servo = standing(backhoe, [0.0, 0.3, -0.9, -0.5], limits=slow)
    for wish in (2e-4, 0.3):
        states = driven(servo, [wish, 0.0, 0.0], 2.0)
        assert {state.status for state in states} == {Status.OK}
        np.testing.assert_allclose(states[-1].tip_velocity, [wish, 0.0, 0.0], atol=1e-6)


def test_missing_boxes_stop_only_a_machine_with_a_wish(backhoe: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    servo = standing(backhoe, [0.0, 0.3, -0.9, -0.5])
    servo.add_points("scan", np.random.default_rng(0).uniform([-2.0, -4.0, 0.0], [2.0, -3.0, 1.0], (1000, 3)))
    monkeypatch.setattr(servo._boxes, "renew", lambda *_: False)
    assert {state.status for state in driven(servo, [0.0, 0.0, 0.0], 0.1)} == {Status.OK}
    state = driven(servo, [0.3, 0.0, 0.0], 0.1)[-1]
    assert state.status is Status.STOPPED
    np.testing.assert_allclose(state.refused, [0.3, 0.0, 0.0])
    assert servo.last_error is None


def test_a_machine_with_one_joint_is_driven_up_to_a_ball_and_back(tmp_path: Path) -> None:
    """A bar of 1 m on a hinge 0.2 m up; the ball is half a metre out and up from there."""
    (tmp_path / "gate.urdf").write_text(ONE_HINGE)
    robot = bp.load_robot(tmp_path / "gate.urdf")
    ball = {"name": "ball", "shape": "sphere", "radius": 0.05, "position": [0.5, 0.0, 0.7]}
    servo = standing(robot, [0.0], obstacles=[ball])
    forth = driven(servo, [0.3, 0.0, 0.0], 6.0)
    # half the bar's width is 0.04 m, the ball's radius 0.05 m and the clearance 0.05 m
    touching = 0.25 * math.pi - math.asin((0.04 + 0.05 + 0.05) / math.hypot(0.5, 0.5))
    assert touching - 0.05 < forth[-1].q[0] <= touching
    back = driven(servo, [-0.3, 0.0, 0.0], 3.0)
    assert servo.last_error is None
    assert back[-1].q[0] < forth[-1].q[0] - 0.3


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("is_beside_a_wall", [False, True])
def test_rounding_errors_do_not_change_the_motion(backhoe: Robot, seed: int, *, is_beside_a_wall: bool) -> None:
    """Two machines that start 1e-13 rad apart move alike, also at full acceleration and while sliding."""
    wall = {"name": "wall", "shape": "halfspace", "point": [0.0, 0.8, 0.0], "normal": [0.0, -1.0, 0.0]}
    start = np.array([0.0, 0.3, -0.9, -0.5])
    one, other = (
        standing(backhoe, q, obstacles=[wall] if is_beside_a_wall else [])
        for q in (start, start + 1e-13 * np.array([1.0, -1.0, 1.0, -1.0]))
    )
    statuses = set()
    for wish in np.random.default_rng(seed).uniform(-0.8, 0.8, (8, 3)):
        if is_beside_a_wall:
            wish[1] = abs(wish[1])
        for state, same in zip(driven(one, wish, 0.24), driven(other, wish, 0.24), strict=True):
            np.testing.assert_allclose(state.v, same.v, rtol=0.0, atol=1e-7)
            statuses.add(state.status)
    assert (Status.SLIDING in statuses) == is_beside_a_wall


def within_bounds(work: StepWork) -> bool:
    return (
        work.rows <= MOST_SOFT_ROWS
        and work.iterations <= MOST_ITERATIONS * work.problems
        and work.paths <= 5
        and work.distances <= MOST_DISTANCES
    )


def test_the_work_of_a_step_is_bounded_near_many_voxels(backhoe: Robot) -> None:
    """A wall of hundreds of voxels and long steps: one step may reach all of it; only the tightest rows are kept."""
    servo = standing(backhoe, [0.0, 0.3, -0.9, -0.5])
    rng = np.random.default_rng(2)
    cloud = np.array([3.6, 0.9, -1.6]) + rng.uniform(0.0, 1.0, (600, 3)) * [1.8, 0.6, 1.6]
    slow = Servo(backhoe, servo.scene, dt=0.05)
    slow.add_points("rubble", cloud, resolution=0.05)
    most = 0
    for _ in range(60):
        slow.step([0.1, 0.5, 0.0])
        assert within_bounds(slow.work)
        most = max(most, slow.work.rows)
    assert slow.last_error is None
    assert most > 10


def stones_around(robot: Robot, q: list[float], count: int, rng: np.random.Generator) -> list[dict[str, object]]:
    """Up to `count` balls of 2 cm at random, 5.5 to 8 cm off the links of the machine at q (n,)."""
    at = Placements(robot, 1)
    at.place(0, np.array(q))
    moving = [piece for piece in robot.pieces if piece.joint > 0]
    links = [piece.piece.hull @ at.R[0, piece.joint].T + at.t[0, piece.joint] for piece in moving]
    corners = np.vstack(links)
    found: list[list[float]] = []
    while len(found) < count:
        link = links[rng.integers(len(links))]
        corner = link[rng.integers(len(link))]
        out = corner - link.mean(axis=0) + rng.normal(size=3) * 0.02
        place = corner + rng.uniform(0.085, 0.1) * out / np.linalg.norm(out)
        if np.linalg.norm(corners - place, axis=1).min() > 0.085:
            found.append(place.tolist())
    stones: list[dict[str, object]] = [
        {"name": f"stone {number}", "shape": "sphere", "radius": 0.02, "position": place}
        for number, place in enumerate(found)
    ]
    obstacles = bp.build_obstacles(standing(robot, q, obstacles=stones).scene, robot)
    around = bp.Proximity(robot, obstacles, self_collision=False)
    too_near = set(around.owner[around.distances(np.array(q)) < 0.055].tolist())
    return [stone for number, stone in enumerate(stones) if number not in too_near]


@pytest.mark.long
def test_the_work_of_a_step_is_bounded_between_hundreds_of_obstacles(panda: Robot) -> None:
    """In every direction, corners of most links come too close to many obstacles at once.

    With every corner in reach as a row, one problem had 1,937 rows.
    """
    robot = panda.with_tip("panda_hand")
    q = [0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8]
    rng = np.random.default_rng(11)
    servo = standing(robot, q, obstacles=stones_around(robot, q, 330, rng))
    works = []
    for step in range(60):
        if step % 20 == 0:
            wish = rng.normal(size=3)
        state = servo.step(wish)
        assert state.proven
        assert within_bounds(servo.work)
        works.append(servo.work)
    assert servo.last_error is None
    proximity = bp.Proximity(robot, bp.build_obstacles(servo.scene, robot))
    assert 0.0 <= state.margin <= (proximity.distances(servo.q) - proximity.clearance).min() + 1e-9
    assert max(work.rows for work in works) == 24  # as many as one path may have: there were more to choose from
    assert max(work.pairs for work in works) == MOST_NEAR
    assert max(work.iterations for work in works) < 48  # two problems of 24 rows


@pytest.mark.parametrize("clearance", [0.05, *(pytest.param(c, marks=pytest.mark.long) for c in (0.3, 0.5))])
def test_the_work_of_a_step_is_bounded_while_a_person_walks_into_the_machine(panda: Robot, clearance: float) -> None:
    """A person of 0.25 m radius walks through the arm at 0.4 m/s: no evasion is enough."""
    robot = panda.with_tip("panda_hand")
    q = [0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8]
    person = {
        "name": "person", "shape": "capsule", "radius": 0.25, "from": [0.9, 0.0, 0.25], "to": [0.9, 0.0, 1.6],
    }  # fmt: skip
    servo = standing(robot, q, clearance=clearance)
    servo.add(person)
    servo.set_velocity("person", [-0.4, 0.0, 0.0])
    most = 0
    for _ in range(500):
        servo.step([0.2, 0.0, 0.0])
        assert within_bounds(servo.work)
        most = max(most, servo.work.rows)
    assert servo.last_error is None
    assert most > 10  # the person was in the way


@pytest.mark.parametrize("clearance", [0.05, pytest.param(0.3, marks=pytest.mark.long)])
def test_every_step_between_a_person_and_a_post_is_proven(panda: Robot, clearance: float) -> None:
    """Standing still keeps clear of the post; a person who walks into the arm must not outweigh that."""
    robot = panda.with_tip("panda_hand")
    q = [0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8]
    post = {"name": "post", "shape": "capsule", "radius": 0.1, "from": [0.4, 0.75, 0.0], "to": [0.4, 0.75, 1.5]}
    person = {
        "name": "person", "shape": "capsule", "radius": 0.25, "from": [0.4, -1.2, 0.25], "to": [0.4, -1.2, 1.6],
    }  # fmt: skip
    servo = standing(robot, q, clearance=clearance, obstacles=[post])
    servo.add(person)
    servo.set_velocity("person", [0.0, 0.4, 0.0])
    evading = 0
    for _ in range(700):
        state = servo.step([0.0, 0.2, 0.0])
        assert state.proven
        evading += state.status is Status.EVADING
    assert servo.last_error is None
    assert evading > 100
    assert bp.Proximity(robot, bp.build_obstacles(servo.scene, robot)).distances(servo.q).min() > 0.0


def test_joints_that_share_a_pump_are_slowed_together(backhoe: Robot) -> None:
    """The joint rates may add up to 0.4 rad/s, also where a post stops the swing and the others go on."""

    def load(_: np.ndarray, v: np.ndarray) -> float:
        return float(np.abs(v).sum()) / 0.4

    post = {"name": "post", "shape": "capsule", "radius": 0.15, "from": [4.2, 1.5, -2.0], "to": [4.2, 1.5, 3.0]}
    alone = standing(backhoe, [0.0, 0.3, -0.9, -0.5], obstacles=[post])
    servo = Servo(backhoe, alone.scene, dt=0.004, load=load)
    free, shared = driven(alone, [0.1, 0.8, 0.0], 4.0), driven(servo, [0.1, 0.8, 0.0], 4.0)
    assert max(float(np.abs(state.v).sum()) for state in free) > 0.5
    assert max(float(np.abs(state.v).sum()) for state in shared) < 0.42
    assert min(state.margin for state in shared) >= 0.0
    # in the same direction, only slower
    along = np.array([state.tip_velocity for state in shared[200:400]])
    np.testing.assert_allclose(along[:, 2], 0.0, atol=0.02)
    assert np.all(along[:, 1] > 0.1)


def test_a_load_function_that_overwrites_its_arguments_changes_nothing(backhoe: Robot) -> None:
    def load(q: np.ndarray, v: np.ndarray) -> float:
        q[:] = 9.0
        v[:] = 9.0
        return 0.5

    start = [0.0, 0.3, -1.4, -0.6]
    servo = Servo(backhoe, standing(backhoe, start).scene, dt=0.01, load=load)
    state = servo.step(joint_velocity=np.array([0.1, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(state.q, start, atol=0.01)


def test_the_velocity_program_equals_the_hand_calculation() -> None:
    """Two joints that move the tip alike: the tip's 0.6 m/s count fully, each joint's target only a little."""
    none, wide = np.zeros(2), np.full(2, 10.0)
    within = VelocityRange(-wide, wide, -wide, wide, look=0.1, cuts_wish=False)
    target = np.array([0.4, 0.2])
    wish = VelocityWish(v=target, target=target, task=np.ones((1, 2)), null=none, for_tip=True, range=within)
    stop = Rows("braking", np.array([[1.0, 0.0]]), np.array([0.1]))
    program = velocity_program(wish, target, -wide, wide, (stop,))
    np.testing.assert_allclose(program.H, [[1.005, 1.0], [1.0, 1.005]])
    np.testing.assert_allclose(program.f, [-0.6, -0.6])
    assert [block.name for block in program.rows] == ["braking"]
    solution = solve_program(program)
    assert solution is not None
    assert solution.residual < 1e-6
    # the first joint is held at 0.1; the second makes up for it: (0.6 - 0.1) / 1.005
    np.testing.assert_allclose(solution.x, [0.1, 0.5 / 1.005], atol=1e-5)
    joints = velocity_program(wish._replace(task=None), target, -wide, wide, (stop,))
    np.testing.assert_array_equal(joints.H, np.eye(2))
    np.testing.assert_array_equal(joints.f, -target)


@pytest.mark.parametrize(
    ("wish", "sense", "rises", "expected"),
    [
        ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), True, (1.0, 0.0, 1.0)),  # straight into a wall: up, if it can
        ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), False, (1.0, 1.0, 0.0)),
        ((1.0, 0.1, 0.0), (0.0, -1.0, 0.0), True, (1.0, -0.9, 0.0)),  # nearly straight: to the previous side
        ((1.0, 0.5, 0.0), (0.0, -1.0, 0.0), True, (1.0, 1.5, 0.0)),  # to the wish's own side
    ],
)
def test_a_wish_into_a_wall_is_turned_along_it(
    wish: tuple[float, ...], sense: tuple[float, ...], rises: bool, expected: tuple[float, ...]
) -> None:
    """By hand, at a wall across x."""
    found, along = turn_along_surface(np.array(wish), np.array([1.0, 0.0, 0.0]), np.array(sense), rises)
    assert found == pytest.approx(np.array(expected))
    assert along == pytest.approx(np.array(expected) - wish)
