"""Limits of joint steps between waypoints and of turns on the spot."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from backhoe_planner.motion import TipPath, build_problem, largest_spot_turn, longest_step
from backhoe_planner.planning import EdgeKind, LayeredGraph
from backhoe_planner.site import Waypoint

Data = dict[str, Any]

# two links of 1 m: with the tip at a distance r the elbow is bent by 2 acos(r / 2)
ELBOW = """<robot name="elbow">
  <link name="base"/>
  <link name="upper"><collision><origin xyz="0.5 0 0" rpy="0 1.5707963 0"/>
    <geometry><cylinder radius="0.02" length="0.9"/></geometry></collision></link>
  <link name="lower"/><link name="tip"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="1" effort="100"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/>
    <origin xyz="1 0 0"/><limit lower="-2.9" upper="2.9" velocity="1" effort="100"/></joint>
  <joint name="end" type="fixed"><parent link="lower"/><child link="tip"/><origin xyz="1 0 0"/></joint>
</robot>"""
RADII = (1.9, 1.4, 0.6)
BENDS = [2.0 * np.arccos(0.5 * r) for r in RADII]
FIRST, SECOND = BENDS[1] - BENDS[0], BENDS[2] - BENDS[1]  # 0.956 rad, 0.941 rad: half of each for the shoulder


@pytest.fixture(scope="module")
def elbow(tmp_path_factory: pytest.TempPathFactory) -> bp.Robot:
    file: Path = tmp_path_factory.mktemp("elbow") / "elbow.urdf"
    file.write_text(ELBOW)
    return bp.load_robot(file, tip="tip")


def site(points: list[list[float]], *, obstacles: list[Data] | None = None, start: Any = None, **keys: Any) -> bp.Scene:
    path = {"waypoints": [{"position": point} for point in points]} | keys
    content = {"version": 1, "task": {"path": path}, "clearance": 0.02, "obstacles": obstacles or []}
    return bp.scene_from_dict(content if start is None else content | {"start": start})


def inward(**keys: Any) -> bp.Scene:
    return site([[r, 0.0, 0.0] for r in RADII], **keys)


def steps_at_waypoints(plan: bp.Plan) -> Matrix:
    """(W - 1, n) steps of the joints from waypoint to waypoint, at the nearest samples."""
    tips = plan.tip_path()
    path = plan.problem.path
    assert path is not None
    begin = int(np.searchsorted(plan.trajectory.time, plan.certificate.tracking.approach_time))
    rows = [begin + int(np.argmin(np.linalg.norm(tips[begin:] - point, axis=1))) for point in path.points]
    return np.abs(np.diff(plan.trajectory.q[rows], axis=0))


# --- no further than allowed ----------------------------------------------------------


@pytest.mark.parametrize("allowed", [1.001 * FIRST, {"elbow": 1.001 * FIRST}, {"shoulder": 0.5005 * FIRST}])
def test_a_joint_step_just_above_the_least_possible_is_kept(elbow: bp.Robot, allowed: float | dict[str, float]) -> None:
    plan = bp.plan(elbow, inward(max_joint_step=allowed), effort="quick")
    assert plan.verified, plan.message
    np.testing.assert_allclose(steps_at_waypoints(plan)[:, 1], [FIRST, SECOND], atol=0.02)
    step = plan.certificate.tracking.joint_step
    assert step is not None
    assert (step.before, step.after) == (0, 1)
    assert step.size == pytest.approx(FIRST if step.joint else 0.5 * FIRST, abs=1e-3)


def test_an_impossible_joint_step_is_reported_with_the_waypoints_and_the_least_step(elbow: bp.Robot) -> None:
    """The first step takes 0.956 rad of the elbow, whichever way it bends."""
    plan = bp.plan(elbow, inward(max_joint_step=0.95), effort="quick")
    assert (plan.verdict, plan.reason) == ("failed", "outside_limits")
    assert f"elbow moves by {FIRST:.4g} rad from waypoint 1 to 2; max_joint_step allows 0.95 rad" in plan.message
    assert plan.message.endswith("this is the first such pair, and a waypoint between the two makes the steps shorter")
    assert plan.findings.joints == ("elbow",)


def test_the_certificate_checks_joint_steps(elbow: bp.Robot) -> None:
    free = bp.plan(elbow, inward(), effort="quick")
    certificate = bp.certify(elbow, inward(max_joint_step=0.95), free.trajectory)
    assert free.verified
    assert not certificate.verified
    [problem] = certificate.problems
    assert problem.startswith("elbow moves by 0.95")
    assert problem.endswith("rad from waypoint 1 to 2; max_joint_step allows 0.95 rad")
    assert bp.certify(elbow, inward(max_joint_step=0.957), free.trajectory).verified


@pytest.mark.long
def test_a_redundant_arm_keeps_a_joint_step_that_its_cheapest_motion_exceeds(backhoe: bp.Robot) -> None:
    """The cheapest motion moves some joint by 0.137 rad between two of 23 waypoints."""
    points = np.linspace([4.4, 0.0, -0.4], [2.6, 0.4, 0.8], 23).tolist()
    free = bp.plan(backhoe, site(points), effort="quick")
    assert np.max(steps_at_waypoints(free)) > 0.12
    plan = bp.plan(backhoe, site(points, max_joint_step=0.09), effort="quick")
    assert plan.verified, plan.message
    assert np.max(steps_at_waypoints(plan)) < 0.09 + 0.01  # the nearest samples are not exactly at the waypoints
    assert plan.certificate.tracking.joint_step is not None
    assert plan.certificate.tracking.joint_step.size <= 0.09


@pytest.mark.long
def test_seven_joints_keep_a_joint_step_with_full_poses(panda: bp.Robot) -> None:
    poses = [{"position": [0.5, y, 0.4], "rpy": [np.pi, 0.0, 0.0]} for y in np.linspace(-0.3, 0.3, 13)]
    path = {"waypoints": poses, "max_joint_step": 0.125}
    plan = bp.plan(panda, bp.scene_from_dict({"version": 1, "task": {"path": path}}), effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.tracking.joint_step is not None
    assert plan.certificate.tracking.joint_step.size <= 0.125


@pytest.mark.long
def test_a_joint_step_too_small_for_seven_joints_is_reported_as_a_limit(panda: bp.Robot) -> None:
    """No obstacles; a circle is followed with larger steps, and somewhere a joint must move by 0.06 rad."""
    angle = np.linspace(0.0, 2.0 * np.pi, 41)
    points = np.column_stack((0.5 + 0.12 * np.cos(angle), 0.12 * np.sin(angle), 0.3 + 0.02 * np.sin(3.0 * angle)))
    waypoints = [{"position": point, "quaternion": [0.0, 1.0, 0.0, 0.0]} for point in points.tolist()]
    for allowed, reason in ((0.09, ""), (0.05, "outside_limits")):
        task = {"path": {"waypoints": waypoints, "max_joint_step": allowed}}
        plan = bp.plan(panda, bp.scene_from_dict({"version": 1, "task": task}), effort="quick")
        assert plan.reason == reason, plan.message
    assert "from waypoint" in plan.message


def test_joint_steps_are_ranges_and_a_detour_counts_with_its_legs() -> None:
    """By hand: out and back by 0.3 within the first leg; a detour bridges the second and third."""
    path = TipPath([Waypoint(position=(float(x), 0.0, 0.0)) for x in range(4)])
    stations = np.array([0.0, 0.5, 1.0, 1.2, 9.0, 2.8, 3.0])
    q = np.array([[0.0], [0.3], [0.0], [0.1], [0.7], [0.2], [0.2]])
    step = longest_step(path, stations, q, np.array([1.0]), gaps=[(3, 5)])
    assert step is not None
    assert (step.before, step.after, step.allowed) == (1, 3, 2.0)
    assert step.size == pytest.approx(0.7)
    step = longest_step(path, stations[:3], q[:3], np.array([0.2]))
    assert step is not None
    assert (step.joint, step.before, step.after) == (0, 0, 1)
    assert step.size == pytest.approx(0.3)
    assert not step.kept
    # the waypoint is passed at 0.2, halfway between two samples
    step = longest_step(path, np.array([0.0, 0.5, 1.5]), np.array([[0.0], [0.1], [0.3]]), np.array([1.0]))
    assert step is not None
    assert step.size == pytest.approx(0.2)


def test_an_unknown_joint_is_named(backhoe: bp.Robot) -> None:
    with pytest.raises(bp.SceneError, match=r"task\.path\.max_joint_step: .*no such joint; found elbow"):
        build_problem(backhoe, site([[4.0, 0.0, 0.0], [3.0, 0.0, 0.0]], max_joint_step={"elbow": 0.1}))


# --- turns on the spot ------------------------------------------------------------------

FOLDED = [1.5929, -2.6521, 1.1739, -1.1162]  # rad, roughly: inverse kinematics then puts the tip on the path
BALL: Data = {"name": "ball", "shape": "sphere", "radius": 0.28, "position": [1.58, 0.865, 0.0]}


def largest_turn(plan: bp.Plan) -> float:
    """The largest turn of a joint while the tip stays within 2 mm [rad]."""
    tips, q, found = plan.tip_path(), plan.trajectory.q, 0.0
    for row in range(0, len(q), 5):
        near = np.linalg.norm(tips[row:] - tips[row], axis=1) < 0.002
        stays = len(near) if near.all() else int(np.argmin(near))
        found = max(found, float(np.max(np.ptp(q[row : row + stays], axis=0))))
    return found


@pytest.mark.long
def test_joints_turn_only_while_the_tip_moves_if_turn_on_the_spot_is_false(planar4: bp.Robot) -> None:
    """From a folded configuration at the path's beginning the cheapest motion reconfigures first."""
    points = [[2.0, -0.6, 0.0], [2.0, 0.6, 0.0]]
    at = bp.solve_inverse_kinematics(planar4, bp.TipTarget(np.array(points[0])), start=np.array(FOLDED))
    start = {"joints": dict(zip(planar4.joint_names, at.q.tolist(), strict=True))}
    turning = bp.plan(planar4, site(points, obstacles=[BALL], start=start), effort="quick")
    assert turning.verified
    assert largest_turn(turning) > 0.6
    plan = bp.plan(planar4, site(points, obstacles=[BALL], start=start, turn_on_the_spot=False), effort="quick")
    assert plan.verified, plan.message
    assert largest_turn(plan) < 0.15
    # the certificate checks it too
    certificate = bp.certify(planar4, plan.scene, turning.trajectory)
    assert not certificate.verified
    [problem] = certificate.problems
    assert problem.endswith("while the tip stands at 0.00 m of 1.20 m; turn_on_the_spot is false")
    assert certificate.tracking.spot_turn is not None
    assert certificate.tracking.spot_turn.size == pytest.approx(largest_turn(turning), rel=0.2)


def by_hand(*parts: tuple[float, float, float], on: bool = True) -> dict[str, Any]:
    """Samples of (arc length [m], joint [rad], time to get there [s]), 20 steps from each to the next."""
    table = np.array(parts)
    table[:, 2] = np.cumsum(table[:, 2])
    rows = np.vstack([a + k / 20 * (b - a) for a, b in pairwise(table) for k in range(20)] + [table[-1:]])
    return {"station": rows[:, 0], "q": rows[:, 1:2], "time": rows[:, 2], "on": np.full(len(rows), on)}


GO = (0.0, 0.0, 0.0), (0.5, 0.4, 1.0)  # half a metre, while the joint moves by 0.4 rad


def test_the_size_of_a_turn_on_the_spot_equals_a_hand_calculation() -> None:
    """The tip stands at 0.5 m for 0.7 rad; the step of 25 mm and 0.02 rad before is not part of that."""
    turn = largest_spot_turn(**by_hand(*GO, (0.5, 1.1, 1.0), (1.0, 1.1, 1.0)), tolerance=0.005)
    assert turn is not None
    assert (turn.joint, turn.station, turn.time) == (0, 0.5, 1.0)
    assert turn.size == pytest.approx(0.7)
    # creeping by 0.4 mm counts as rest, since a tenth of the tolerance is 0.5 mm
    turn = largest_spot_turn(**by_hand(*GO, (0.5004, 1.1, 1.0), (1.0, 1.1, 1.0)), tolerance=0.005)
    assert turn is not None
    assert turn.size == pytest.approx(0.7)


@pytest.mark.parametrize(
    "parts",
    [
        (*GO, (1.0, 1.1, 1.0)),  # the tip moves all the while
        (*GO, (0.5, 0.4, 2.0), (1.0, 1.1, 1.0)),  # tip and joint are at rest
        (*GO, (0.5, 0.49, 1.0), (1.0, 1.1, 1.0)),  # the joint turns by less than 0.1 rad
        (*GO, (0.65, 1.0, 1.0), (1.0, 1.1, 1.0)),  # a requested turn of 0.6 rad is 0.15 m of progress
    ],
)
def test_motions_without_a_turn_on_the_spot_report_none(parts: tuple[tuple[float, float, float], ...]) -> None:
    assert largest_spot_turn(**by_hand(*parts), tolerance=0.005) is None


def test_turns_off_the_path_and_on_the_approach_do_not_count() -> None:
    motion = by_hand(*GO, (0.5, 1.1, 1.0), (1.0, 1.1, 1.0))
    off = motion["on"].copy()
    off[21:40] = False  # a detour
    assert largest_spot_turn(**(motion | {"on": off}), tolerance=0.005) is None
    assert largest_spot_turn(**(motion | {"on": ~off & False}), tolerance=0.005) is None
    arriving = by_hand((0.0, 0.0, 0.0), (0.0, 0.9, 1.0), (1.0, 1.1, 1.0))
    at_once = largest_spot_turn(**arriving, tolerance=0.005)
    assert at_once is not None
    assert at_once.size == pytest.approx(0.9)
    arriving["on"][0] = False  # it comes from elsewhere and turns at the path's beginning
    assert largest_spot_turn(**arriving, tolerance=0.005) is None


def test_a_turn_that_the_path_requests_is_allowed(backhoe: bp.Robot) -> None:
    at = [3.6, 0.0, 0.3]
    poses = [
        {"position": at, "pitch": -1.6},
        {"position": at, "pitch": -2.2},
        {"position": [2.8, 0, 0.3], "pitch": -2.2},
    ]
    path = {"waypoints": poses, "turn_on_the_spot": False}
    plan = bp.plan(backhoe, bp.scene_from_dict({"version": 1, "task": {"path": path}}), effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.tracking.followed == pytest.approx(0.8, abs=1e-6)


def test_a_graph_without_turns_uses_steps_only() -> None:
    """Two layers with nodes 0 and 1. The step from 0 to 0 costs 5, that from 1 to 1 costs 1, a turn costs 1."""
    nodes = np.array([[0.0], [1.0]])
    costs = {1.0: np.array([[5.0, np.inf], [np.inf, 1.0]]), 0.1: np.ones((2, 2))}

    def graph(**keys: Any) -> LayeredGraph:
        def cost(a: Matrix, b: Matrix, span: float) -> Matrix:
            return costs[span].copy()

        return LayeredGraph(np.array([0.0, 1.0]), [nodes, nodes], cost=cost, turning=0.1, detours=False, **keys)

    begin = np.array([0.0, np.inf])
    free, straight = graph().best_route(begin), graph(turns=False).best_route(begin)
    assert free is not None
    assert straight is not None
    assert [edge.kind for edge in free.edges][:2] == [EdgeKind.TURN, EdgeKind.STEP]
    assert ([edge.kind for edge in straight.edges], straight.cost) == ([EdgeKind.STEP], 5.0)
    short = graph(turns=False, longest=np.array([[1.0], [0.5]]))
    assert short.best_route(begin) is not None
    assert [len(found) for found in short.reached(begin)] == [1, 1]


def test_an_approach_past_a_later_part_of_the_path_is_no_turn() -> None:
    """On the approach the tip is nearest to station 0.3 m, then the path begins at 0; later it turns by 0.7 rad."""
    motion = by_hand((0.3, 0.0, 0.0), (0.3, 0.9, 1.0), (0.0, 0.9, 0.1), *((s, q + 0.9, 1.0) for s, q, _ in GO[1:]))
    motion["on"][:40] = False
    assert largest_spot_turn(**motion, tolerance=0.005) is None
    turning = by_hand(
        (0.3, 0.0, 0.0), (0.3, 0.9, 1.0), (0.0, 0.9, 0.1), (0.5, 0.9, 1.0), (0.5, 1.6, 1.0), (1.0, 1.6, 1.0)
    )
    turning["on"][:40] = False
    turn = largest_spot_turn(**turning, tolerance=0.005)
    assert turn is not None
    assert turn.station == pytest.approx(0.5)
    assert turn.size == pytest.approx(0.7)
