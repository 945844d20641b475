"""Goals given by joints, lists of goals, and orientations with a tolerance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem

Data = dict[str, Any]

STRETCHED: Data = {"joints": {"joint1": 0.0, "joint2": 0.0, "joint3": 0.0, "joint4": 0.0}}
BENT: Data = {"joint1": 0.5, "joint2": 0.4, "joint3": -0.3, "joint4": 0.2}
READY: Data = {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}}


def site(goal: Any, *, start: Data = STRETCHED, obstacles: tuple[Data, ...] = (), **keys: Any) -> bp.Scene:
    content = {"version": 1, "start": start, "task": {"goal": goal}, "clearance": 0.02, "influence": 0.4}
    return bp.scene_from_dict(content | {"obstacles": list(obstacles)} | keys)


def ball(x: float, y: float, radius: float) -> Data:
    return {"name": "ball", "shape": "sphere", "radius": radius, "position": [x, y, 0.0]}


@pytest.mark.parametrize("objective", ["time", "work"])
@pytest.mark.parametrize("method", ["auto", "optimal"])
@pytest.mark.parametrize("margin", [0.0005, 1.0])
def test_a_machine_on_its_goal_does_not_move(planar4: bp.Robot, objective: str, method: str, margin: float) -> None:
    """0 in 0 s is the least cost, also if other configurations would have to keep 3 mm more than the clearance."""
    aside = {
        "name": "wall",
        "shape": "halfspace",
        "point": [0.0, 0.0, 0.0],
        "normal": [0.0, 1.0, 0.0],
        "clearance": 0.0,
    }
    probe = site(STRETCHED, obstacles=({**aside, "point": [0.0, -3.0, 0.0]},))
    room = bp.plan(planar4, probe, effort="quick").certificate.clearances
    wall = next(one for one in room if one.name == "wall")
    near = {**aside, "point": [0.0, -3.0 + wall.distance - margin, 0.0]}
    tip = bp.Kinematics(planar4).at(np.zeros(4)).tip_position.tolist()
    for goal in (STRETCHED, {"position": tip}, [{"position": [0.5, 0.9, tip[2]]}, STRETCHED]):
        plan = bp.plan(planar4, site(goal, obstacles=(near,), objective=objective), method=method, effort="quick")
        assert plan.verified, plan.message
        assert plan.message == ""
        np.testing.assert_array_equal(plan.trajectory.q, np.zeros((1, 4)))
        assert plan.metrics.cost is not None
        assert plan.metrics.cost.value == 0.0
        assert plan.bound is not None
        assert plan.bound.duration == 0.0


def test_a_start_within_the_tolerance_of_a_goal_out_of_reach_counts_as_there(planar4: bp.Robot) -> None:
    beyond = bp.Kinematics(planar4).at(np.zeros(4)).tip_position + np.array([0.0005, 0.0, 0.0])
    plan = bp.plan(planar4, site({"position": beyond.tolist()}), effort="quick")
    assert (plan.verified, plan.reason, plan.message) == (True, "", "")
    np.testing.assert_array_equal(plan.trajectory.q, np.zeros((1, 4)))


# the arm has four links of 1 m in a level plane, at a height of 0 m
@pytest.mark.parametrize(
    ("goal", "least"),
    [
        ({"position": [2.0, 1.0, 0.0005]}, 0.0005),  # within the millimetre that counts without a tolerance
        ({"position": [2.0, 1.0, 0.01], "tolerance": 0.02}, 0.01),
        ({"position": [4.1, 0.0, 0.0], "tolerance": 0.2}, 0.1),
        # the last link points sideways: the other three reach 3 m, and would have to reach to (4, -1)
        ({"position": [4.0, 0.0, 0.0], "rpy": [0.0, 0.0, math.pi / 2], "tolerance": 1.3}, math.hypot(4.0, 1.0) - 3.0),
    ],
)
@pytest.mark.parametrize("method", ["auto", "reactive"])
def test_a_goal_out_of_reach_is_reached_within_its_tolerance(
    planar4: bp.Robot, goal: Data, least: float, method: str
) -> None:
    """The law ends at the nearest position, or up to a fiftieth of the tolerance further into the reach.

    A search also makes use of the tolerance, up to 0.9 of it.
    """
    plan = bp.plan(planar4, site(goal, start={"joints": BENT}), method=method, effort="quick")
    assert plan.verified, plan.message
    at = bp.Kinematics(planar4).at(plan.trajectory.q[-1])
    most = least + 0.02 * goal.get("tolerance", 1e-3)
    if method == "auto" and "tolerance" in goal:
        most = 0.9 * goal["tolerance"] + 1e-6
    assert least - 1e-6 <= math.dist(at.tip_position, goal["position"]) <= most
    if "rpy" in goal:
        np.testing.assert_allclose(at.tip_rotation[:, 0], [0.0, 1.0, 0.0], atol=1e-4)
    assert plan.certificate.tracking.max_error == pytest.approx(math.dist(at.tip_position, goal["position"]), abs=1e-9)
    assert plan.bound is not None
    assert plan.bound.duration <= plan.trajectory.duration


@pytest.mark.parametrize(
    "goal", [{"position": [2.0, 1.0, 0.002]}, {"position": [4.1, 0.0, 0.0], "tolerance": 0.09}], ids=["above", "far"]
)
def test_a_goal_out_of_reach_by_more_than_its_tolerance_is_unreachable(planar4: bp.Robot, goal: Data) -> None:
    plan = bp.plan(planar4, site(goal, start={"joints": BENT}), effort="quick")
    assert plan.reason == "unreachable"


WALL_AHEAD: Data = {"name": "wall", "shape": "box", "size": [0.2, 2.0, 1.0], "position": [2.6, 0.0, 0.0]}


@pytest.mark.parametrize("method", ["auto", "reactive"])
def test_a_goal_too_near_a_wall_is_reached_within_its_tolerance(planar4: bp.Robot, method: str) -> None:
    """The last link ends at the tip and points at a wall 8 cm ahead, of which the clearance is 10 cm.

    So the tip stops 2 cm short, and 3 mm more that the planner keeps at ends; a search may stop up to 4.5 cm from it.
    """
    goal: Data = {"position": [2.42, 0.0, 0.0], "rpy": [0.0, 0.0, 0.0], "tolerance": 0.05}
    scene = site(goal, start={"joints": BENT | {"joint1": 1.2}}, obstacles=(WALL_AHEAD | {"clearance": 0.1},))
    plan = bp.plan(planar4, scene, method=method, effort="quick")
    assert plan.verified, plan.message
    off = np.asarray(bp.Kinematics(planar4).at(plan.trajectory.q[-1]).tip_position) - goal["position"]
    assert off[0] <= -0.0199
    assert np.linalg.norm(off) <= 0.045 + 1e-6
    if method == "reactive":
        assert off[0] >= -0.023 - 0.02 * 0.05
        np.testing.assert_allclose(off[1:], 0.0, atol=1e-4)
    assert plan.bound is not None
    assert plan.bound.duration <= plan.trajectory.duration


# --- positions with a tolerance --------------------------------------------------------

STIFF: Data = {"joint2": 0.0, "joint3": 0.0, "joint4": 0.0}


@pytest.mark.parametrize("objective", ["time", "effort"])
@pytest.mark.parametrize("tolerance", [None, 0.1, 1.0])
def test_a_motion_ends_as_early_as_the_tolerance_of_its_goal_allows(
    planar4: bp.Robot, objective: str, tolerance: float | None
) -> None:
    """A stiff arm of 4 m turns by 1 rad, or less by the angle whose chord is 0.9 of the tolerance."""
    goal: Data = {"position": [4.0 * math.cos(1.0), 4.0 * math.sin(1.0), 0.0]}
    goal |= {} if tolerance is None else {"tolerance": tolerance}
    less = 2.0 * math.asin(0.9 * (tolerance or 0.0) / 8.0)
    start = {"joints": {"joint1": 0.0}}
    plan = bp.plan(planar4, site(goal, start=start, hold=STIFF, objective=objective), effort="quick")
    assert plan.verified, plan.message
    assert plan.trajectory.q[-1, 0] == pytest.approx(1.0 - less, abs=0.005)


@pytest.mark.parametrize("effort", ["quick", pytest.param("normal", marks=pytest.mark.long)])
def test_a_tolerance_saves_work_that_is_unavoidable_without_it(backhoe: bp.Robot, effort: str) -> None:
    """The tip is lifted by 2.3 m; with the tolerance it may stay 0.45 m lower.

    The motion costs less than is proven for all motions to the position itself.
    """
    goal: Data = {"position": [2.6, 2.6, 1.2], "pitch": [-2.4, -1.6]}
    exact = bp.plan(backhoe, site(goal, start=READY, objective="work"), effort="quick")
    assert exact.bound is not None
    bound = exact.bound.least_energy("work")
    assert bound is not None
    plan = bp.plan(backhoe, site(goal | {"tolerance": 0.5}, start=READY, objective="work"), effort=effort)
    assert plan.verified, plan.message
    assert plan.metrics.cost is not None
    assert plan.metrics.cost.value < bound
    assert plan.certificate.tracking.max_error <= 0.45 + 1e-6


@pytest.mark.parametrize("objective", ["time", "work"])
@pytest.mark.parametrize("away", [0.2, 0.29, 2.0])
def test_a_machine_within_the_tolerance_of_its_goal_stays(backhoe: bp.Robot, objective: str, away: float) -> None:
    tip = bp.Kinematics(backhoe).at(np.array([0.0, 0.4, -1.6, -0.9])).tip_position
    beside = [tip[0], tip[1] + away, tip[2]]
    goal = {"position": beside, "tolerance": max(0.3, 1.01 * away)}
    plan = bp.plan(backhoe, site(goal, start=READY, objective=objective), effort="quick")
    assert (plan.verified, plan.message) == (True, "")
    np.testing.assert_array_equal(plan.trajectory.q, [[0.0, 0.4, -1.6, -0.9]])


def test_a_machine_within_the_tolerance_turns_its_bucket_as_required(backhoe: bp.Robot) -> None:
    at = bp.Kinematics(backhoe).at(np.array([0.0, 0.4, -1.6, -0.9]))
    asked, (x, y, z) = at.pitch + 0.9, at.tip_position
    goal: Data = {"position": [x + 0.2, y, z], "pitch": asked, "tolerance": 0.3}
    plan = bp.plan(backhoe, site(goal, start=READY), effort="quick")
    assert plan.verified, plan.message
    end = bp.Kinematics(backhoe).at(plan.trajectory.q[-1])
    assert end.pitch == pytest.approx(asked, abs=1e-6)
    assert math.dist(end.tip_position, goal["position"]) <= 0.27 + 1e-6


@pytest.mark.parametrize("objective", ["time", "work"])
def test_a_motion_ends_beside_an_obstacle_that_takes_most_of_the_tolerance(backhoe: bp.Robot, objective: str) -> None:
    """The ball leaves free what is more than 0.15 m from its middle, the goal, and 0.02 m of clearance."""
    block = {"name": "ball", "shape": "sphere", "radius": 0.15, "position": [2.6, 2.6, 1.2]}
    goal = {"position": [2.6, 2.6, 1.2], "tolerance": 0.21}
    plan = bp.plan(backhoe, site(goal, start=READY, obstacles=(block,), objective=objective), effort="quick")
    assert plan.verified, plan.message
    assert 0.17 <= plan.certificate.tracking.max_error <= 0.9 * 0.21 + 1e-6


def test_only_the_last_motion_of_a_sequence_ends_elsewhere_than_at_its_goal(planar4: bp.Robot) -> None:
    """The first leg stops for a wait, at the position. The last one ends 0.27 m from its own."""
    legs = [
        {"name": "there", "goal": {"position": [2.0, 2.0, 0.0], "tolerance": 0.3}},
        {"name": "still", "wait": 0.2},
        {"name": "back", "goal": {"position": [3.0, 0.0, 0.0], "tolerance": 0.3}},
        {"name": "rest", "wait": 0.2},
    ]
    content = {"version": 1, "start": {"joints": BENT}, "task": {"sequence": legs}, "clearance": 0.02}
    plan = bp.plan(planar4, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    tips = plan.tip_path()
    np.testing.assert_allclose(tips[plan.legs[0].last], [2.0, 2.0, 0.0], atol=1e-6)
    assert math.dist(tips[-1], [3.0, 0.0, 0.0]) == pytest.approx(0.27, abs=1e-4)


def test_a_goal_too_near_a_wall_by_more_than_its_tolerance_is_in_collision(planar4: bp.Robot) -> None:
    goal = {"position": [2.42, 0.0, 0.0], "rpy": [0.0, 0.0, 0.0], "tolerance": 0.02}
    scene = site(goal, start={"joints": BENT | {"joint1": 1.2}}, obstacles=(WALL_AHEAD | {"clearance": 0.1},))
    plan = bp.plan(planar4, scene, effort="quick")
    assert (plan.reason, plan.message[:4]) == ("goal_in_collision", "at t")
    assert "link4 is 0.080 m from wall, 0.020 m closer than allowed" in plan.message


def test_one_of_several_goals_may_be_out_of_reach_within_its_tolerance(planar4: bp.Robot) -> None:
    goals = [{"position": [0.0, 4.3, 0.0], "tolerance": 0.1}, {"position": [4.1, 0.3, 0.0], "tolerance": 0.2}]
    plan = bp.plan(planar4, site(goals, start={"joints": BENT}), effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.goal == 2


def test_a_leg_ends_within_the_tolerance_of_a_goal_out_of_reach(planar4: bp.Robot) -> None:
    legs = [
        {"name": "out", "goal": {"position": [4.1, 0.0, 0.0], "tolerance": 0.2}},
        {"name": "back", "goal": {"position": [1.5, 1.5, 0.0]}},
    ]
    content = {"version": 1, "start": {"joints": BENT}, "task": {"sequence": legs}, "clearance": 0.02}
    plan = bp.plan(planar4, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message


# --- the joints --------------------------------------------------------------------


@pytest.mark.parametrize("method", ["auto", "reactive"])
def test_a_joint_goal_is_reached_with_these_joints(planar4: bp.Robot, method: str) -> None:
    plan = bp.plan(planar4, site({"joints": BENT}), method=method, effort="quick")
    assert plan.verified, plan.message
    np.testing.assert_allclose(plan.trajectory.q[-1], list(BENT.values()), atol=1e-3)


def test_reaching_the_tip_pose_with_other_joints_does_not_reach_a_joint_goal(planar4: bp.Robot) -> None:
    """An arm of four links, mirrored at the line from base to tip, ends at the same place."""
    scene = site({"joints": {"joint1": 0.5, "joint2": -1.0, "joint3": 0.0, "joint4": 0.0}})
    there = bp.Kinematics(planar4).at(np.array([0.5, -1.0, 0.0, 0.0]))
    found = bp.solve_inverse_kinematics(
        planar4, bp.TipTarget(there.tip_position), start=np.array([-1.0, 1.0, 0.3, 0.0])
    )
    assert found.reached
    ends = np.array([[0.0, 0.0, 0.0, 0.0], found.q])
    certificate = bp.certify(planar4, scene, bp.Trajectory.from_steps(np.array([0.0, 20.0]), ends))
    assert certificate.goal is None
    assert any("from the goal" in problem and problem.startswith("joint") for problem in certificate.problems)


def test_missing_and_unknown_joints_of_a_goal_are_named(planar4: bp.Robot) -> None:
    with pytest.raises(bp.SceneError, match=r"task.goal.joints.*joints are missing: joint2, joint4"):
        build_problem(planar4, site({"joints": {"joint1": 0.0, "joint3": 0.0}}))
    with pytest.raises(bp.SceneError, match=r"task.goal\[1\].joints.*joint5"):
        build_problem(planar4, site([{"position": [2, 1, 0]}, {"joints": {**BENT, "joint5": 0.0}}]))


def test_a_goal_outside_the_limits_is_reported_with_the_joint_and_its_limit(backhoe: bp.Robot) -> None:
    high = float(backhoe.limits.upper[1])
    goal = {"joints": {"swing": 0.0, "boom": high + 0.2, "stick": -1.6, "bucket": -0.9}}
    plan = bp.plan(backhoe, site(goal, start=READY), effort="quick")
    assert plan.reason == "outside_limits"
    assert f"boom at the goal is {high + 0.2:.4g}" in plan.message
    assert f"to {high:.4g}" in plan.message
    assert plan.findings.joints == ("boom",)


def test_a_goal_in_an_obstacle_names_the_obstacle(planar4: bp.Robot) -> None:
    tip = bp.Kinematics(planar4).at(np.array(list(BENT.values()))).tip_position
    plan = bp.plan(planar4, site({"joints": BENT}, obstacles=(ball(tip[0], tip[1], 0.2),)), effort="quick")
    assert plan.reason == "goal_in_collision"
    assert plan.message.startswith("at the goal ")
    assert "ball" in plan.message
    assert len(plan.trajectory) == 1


def test_a_joint_goal_behind_an_obstacle_is_reached_by_a_detour(planar4: bp.Robot) -> None:
    """The stretched arm cannot sweep through a ball beside it."""
    scene = site({"joints": {**STRETCHED["joints"], "joint1": 1.2}}, obstacles=(ball(2.2, 1.1, 0.3),))
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.verified, plan.message
    assert plan.trajectory.q[-1] == pytest.approx([1.2, 0.0, 0.0, 0.0], abs=1e-3)


# --- several -----------------------------------------------------------------------


def test_the_reachable_goal_of_a_list_is_reached_and_its_number_is_saved(planar4: bp.Robot, tmp_path: Path) -> None:
    far, near = {"position": [9.0, 0.0, 0.0]}, {"position": [2.0, 1.0, 0.0]}
    plan = bp.plan(planar4, site([far, near]), effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.goal == 2
    assert np.linalg.norm(plan.tip_path()[-1] - near["position"]) < 1e-3
    assert plan.message.startswith(
        "1 of 2 goals is left out: the goal 1 (9.00, 0.00, 0.00) is out of reach: the nearest pose is 5.000 m"
    )
    plan.save(tmp_path / "plan.json")
    again = bp.load_plan(tmp_path / "plan.json")
    assert again.verified
    assert again.certificate.goal == 2
    assert again.message == plan.message
    assert again.scene.to_dict()["task"] == plan.scene.to_dict()["task"]


def test_a_list_may_mix_poses_and_joints(planar4: bp.Robot) -> None:
    inside = ball(2.0, 1.0, 0.2)
    plan = bp.plan(
        planar4, site([{"position": [2.0, 1.0, 0.0]}, {"joints": BENT}], obstacles=(inside,)), effort="quick"
    )
    assert plan.verified, plan.message
    assert plan.certificate.goal == 2
    assert plan.message.startswith("1 of 2 goals is left out: at the goal 1 ")
    assert "inside ball" in plan.message


@pytest.mark.parametrize("method", ["auto", "reactive"])
def test_no_goal_is_named_if_all_can_be_reached(planar4: bp.Robot, method: str) -> None:
    goals = [{"position": [2.0, 1.0, 0.0]}, {"joints": BENT}]
    plan = bp.plan(planar4, site(goals), method=method, effort="quick")
    assert plan.verified
    assert "left out" not in plan.message
    assert plan.findings.left_out == ()


def test_a_leg_names_the_goals_of_its_list_that_cannot_be_reached(planar4: bp.Robot) -> None:
    far, near = {"position": [9.0, 0.0, 0.0]}, {"position": [2.0, 1.0, 0.0]}
    legs = [{"name": "there", "goal": [near, far]}, {"name": "back", "goal": {"position": [2.5, -1.0, 0.0]}}]
    content = site(near).to_dict() | {"task": {"sequence": legs}}
    plan = bp.plan(planar4, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    assert plan.message.startswith("leg 'there': 1 of 2 goals is left out: the goal 2 (9.00, 0.00, 0.00) is out")
    assert "back" not in plan.message


def test_what_several_goals_of_a_list_fail_by_is_said_once(planar4: bp.Robot) -> None:
    """A ball on the first link, which stands alike at both goals by joints."""
    turned = BENT | {"joint4": BENT["joint4"] + 0.1}
    goals: list[dict[str, Any]] = [{"joints": BENT}, {"joints": turned}]
    along = np.array([np.cos(BENT["joint1"]), np.sin(BENT["joint1"])])
    on_link = (ball(float(0.5 * along[0]), float(0.5 * along[1]), 0.1),)
    plan = bp.plan(planar4, site(goals, obstacles=on_link), effort="quick")
    assert plan.message.startswith("at each of the 2 goals link1 is ")
    assert plan.message.count("inside ball") == 1
    plan = bp.plan(planar4, site([*goals, {"position": [9.0, 0.0, 0.0]}], obstacles=on_link), effort="quick")
    assert plan.message.startswith("at the goal 1 and goal 2 link1 is ")
    assert "; the goal 3 (9.00, 0.00, 0.00) is out of reach" in plan.message


def test_if_no_goal_of_a_list_is_possible_each_is_named_with_its_reason(planar4: bp.Robot) -> None:
    scene = site([{"position": [9.0, 0.0, 0.0]}, {"position": [2.0, 1.0, 0.0]}], obstacles=(ball(2.0, 1.0, 0.2),))
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.reason == "goal_in_collision"
    assert "the goal 1 (9.00, 0.00, 0.00) is out of reach" in plan.message
    assert "at the goal 2" in plan.message


def test_the_method_paper_takes_only_a_single_pose(planar4: bp.Robot) -> None:
    for goal in ({"joints": BENT}, [{"position": [2.0, 1.0, 0.0]}] * 2):
        with pytest.raises(bp.InputError, match="method"):
            bp.plan(planar4, site(goal), method="paper")


# --- orientations with a tolerance ----------------------------------------------------


def level(turned: float, **keys: Any) -> Data:
    """A pose in front of a backhoe at swing 0, with the bucket turned about the vertical."""
    at = bp.Kinematics(bp.load_robot("example:backhoe")).at(np.array([0.0, 0.4, -1.6, -0.9]))
    yaw = np.array([[math.cos(turned), -math.sin(turned), 0], [math.sin(turned), math.cos(turned), 0], [0, 0, 1]])
    rotation = yaw @ at.tip_rotation
    w = 0.5 * math.sqrt(max(1.0 + float(np.trace(rotation)), 1e-12))
    x, y, z = ((rotation[2, 1] - rotation[1, 2]), (rotation[0, 2] - rotation[2, 0]), (rotation[1, 0] - rotation[0, 1]))
    quaternion = [w, *(float(part) / (4.0 * w) for part in (x, y, z))]
    return {"position": at.tip_position.tolist(), "quaternion": quaternion} | keys


def test_a_bucket_may_miss_a_goal_rotation_by_the_rotation_tolerance(backhoe: bp.Robot) -> None:
    """A backhoe has one swing for a position: the pose, turned by 0.2 rad, is 0.2 rad from any that it reaches."""
    start = {"joints": {"swing": 0.3, "boom": 0.4, "stick": -1.6, "bucket": -0.9}}
    exact = bp.plan(backhoe, site(level(0.2), start=start), effort="quick")
    assert exact.reason == "unreachable"
    tolerant = bp.plan(backhoe, site(level(0.2, rotation_tolerance=0.25), start=start), effort="quick")
    assert tolerant.verified, tolerant.message
    assert 0.2 - 0.025 <= tolerant.certificate.tracking.max_angle_error <= 0.25
    tight = bp.plan(backhoe, site(level(0.2, rotation_tolerance=0.1), start=start), effort="quick")
    assert not tight.verified


def test_the_certificate_applies_the_rotation_tolerance_of_the_goal(backhoe: bp.Robot) -> None:
    q = np.array([[0.0, 0.4, -1.6, -0.9]] * 2)
    stands = bp.Trajectory.from_steps(np.array([0.0, 1.0]), q)
    for tolerance, reached in ((0.19, False), (0.21, True)):
        found = bp.certify(backhoe, site(level(0.2, rotation_tolerance=tolerance), start=READY), stands)
        assert found.tracking.done == reached
        assert found.tracking.max_angle_error == pytest.approx(0.2, abs=1e-9)
    assert not bp.certify(backhoe, site(level(0.2), start=READY), stands).tracking.done
    assert bp.certify(backhoe, site(level(0.009), start=READY), stands).tracking.done
