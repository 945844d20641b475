"""What is to be kept gives way to obstacles, and everything else gives way to what is to be kept."""

from __future__ import annotations

import numpy as np
import pytest
from executors import Never

import backhoe_planner as bp
from backhoe_planner.law import QuadraticProgram, Rows, solve_program
from backhoe_planner.live.clearance.evasion import authority_beside
from backhoe_planner.live.servo.kept_velocity import keeping
from backhoe_planner.machine import shipped_folder
from backhoe_planner.motion import keep_of

DT = 0.02
KEPT = Rows("keep", np.array([[1.0, 0.0]]), np.array([0.2]))  # x <= 0.2


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ((), [0.2, 1.0]),  # of the wish (1, 1), what is to be kept leaves this
        ((Rows("evasion", np.array([[-1.0, -1.0]]), np.array([-1.6])),), [0.2, 1.4]),  # x + y >= 1.6: y does it alone
        ((Rows("evasion", np.array([[-1.0, 0.0]]), np.array([-0.5])),), [0.5, 1.0]),  # x >= 0.5: nothing else does it
    ],
)
def test_what_is_kept_is_missed_only_where_an_obstacle_leaves_nothing_else(
    rows: tuple[Rows, ...], expected: list[float]
) -> None:
    wish, bound = np.array([1.0, 1.0]), np.array([2.0, 2.0])
    found = solve_program(keeping(QuadraticProgram(np.eye(2), -wish, -bound, bound, rows), KEPT))
    assert found is not None
    assert found.residual < 1e-6
    assert found.x[:2] == pytest.approx(expected, abs=0.02)


def test_evading_early_comes_after_what_is_kept() -> None:
    """Of the wish (0, 1), an early x >= 0.5 is met up to 0.2, where what is kept ends."""
    wish, bound = np.array([0.0, 1.0]), np.array([2.0, 2.0])
    early = Rows("early", np.array([[-1.0, 0.0]]), np.array([-0.5]))
    program = QuadraticProgram(0.01 * np.eye(2), -0.01 * wish, -bound, bound)
    found = solve_program(keeping(program, KEPT, early))
    assert found is not None
    assert found.x[:2] == pytest.approx([0.2, 1.0], abs=0.02)


def test_joints_that_what_is_kept_holds_add_nothing_to_the_authority() -> None:
    G, acceleration = np.array([[1.0, -1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([2.0, 3.0, 5.0])
    assert authority_beside(np.zeros((0, 3)), G, acceleration) == pytest.approx([5.0, 2.0])
    assert authority_beside(np.array([[0.5, 0.0, 0.0]]), G, acceleration) == pytest.approx([3.0, 0.0])


@pytest.fixture(scope="module")
def cup() -> tuple[bp.Robot, bp.Scene, bp.Trajectory]:
    """A Panda that turns a cup about its vertical axis, with nothing around it."""
    given = bp.load_scene(shipped_folder("scenes") / "cup.yaml")
    robot = bp.load_robot("example:panda", tip=given.tip)
    part = np.linspace(0.0, 1.0, 80)[:, None]
    first = bp.Servo(robot, given, DT).q
    turned = np.array([-0.9, *np.zeros(6)])
    return robot, given, bp.Trajectory.from_steps(
        4.0 * part[:, 0], first + (10 * part**3 - 15 * part**4 + 6 * part**5) * turned
    )  # fmt: skip


@pytest.mark.parametrize("seed", [3, 4])
def test_a_cup_stays_upright_while_the_arm_evades_a_ball(
    cup: tuple[bp.Robot, bp.Scene, bp.Trajectory], seed: int
) -> None:
    robot, scene, motion = cup
    keep = keep_of(robot, scene)
    assert keep is not None
    rng = np.random.default_rng(seed)
    way = rng.normal(size=3) * [1.0, 1.0, 0.3]
    velocity = way / np.linalg.norm(way) * rng.uniform(0.1, 0.3)
    servo = bp.Servo(robot, scene, DT, q=motion.q[0])
    for name in ("shelf", "bottle", "table"):
        servo.remove(name)
    at = bp.Kinematics(robot).at(motion.q[45]).tip_position + rng.normal(size=3) * 0.05 - 2.5 * velocity
    servo.add({"name": "ball", "shape": "sphere", "radius": 0.08, "position": at.tolist()})
    servo.set_velocity("ball", velocity.tolist())
    most, least, nearest = 0.0, np.inf, np.inf
    with bp.PlanFollower(servo, motion, executor=Never()) as follower:
        for _ in range(200):
            told = follower.step()
            state, most = told.state, max(most, told.deviation)
            least = min(least, float(keep.margins(state.q).min()))
            if state.nearest is not None and state.nearest.name == "ball":
                nearest = min(nearest, state.nearest.distance)
    assert most > 0.02  # it gave way
    assert least >= 0.0
    assert nearest > 0.02


def test_a_bucket_that_is_kept_level_stops_before_a_ball_that_creeps(backhoe: bp.Robot) -> None:
    """The ball is in the way of the swing. It comes at 26 mm/s, and nothing but stopping keeps the pitch."""
    names = ("swing", "boom", "stick", "bucket")
    first, last = np.array([0.0, 0.3, -1.5, -1.5]), np.array([1.0, 0.6, -1.2, -2.1])
    start, goal = ({"joints": dict(zip(names, q.tolist(), strict=True))} for q in (first, last))
    scene = bp.scene_from_dict(
        {"version": 1, "start": start, "task": {"goal": goal, "keep": {"pitch": [-2.75, -2.65]}}, "clearance": 0.05}
    )
    part = np.linspace(0.0, 1.0, 120)[:, None]
    motion = bp.Trajectory.from_steps(
        4.0 * part[:, 0], first + (10 * part**3 - 15 * part**4 + 6 * part**5) * (last - first)
    )
    servo = bp.Servo(backhoe, scene, DT, q=first)
    servo.add({"name": "ball", "shape": "sphere", "radius": 0.3, "position": [2.70712, 1.62424, 0.19961]})
    servo.set_velocity("ball", [0.01638, 0.01963, 0.0005])
    nearest = np.inf
    with bp.PlanFollower(servo, motion, executor=Never()) as follower:
        for _ in range(120):
            state = follower.step().state
            if state.nearest is not None and state.nearest.name == "ball":
                nearest = min(nearest, state.nearest.distance)
    assert 0.04 < nearest < 0.5
