"""Motions that keep a pitch, height or rotation within a band."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import backhoe_planner as bp
from backhoe_planner.machine import BatchKinematics
from backhoe_planner.motion import build_problem
from backhoe_planner.planning import EFFORTS, Work, World, plan_to_dict
from backhoe_planner.planning.search.motion_check import MotionCheck

Data = dict[str, Any]

NAMES = ("swing", "boom", "stick", "bucket")
A, B = (0.0, 0.3, -1.5, -1.5), (1.0, 0.6, -1.2, -2.1)  # both at a pitch of -2.7
BAND = [-2.75, -2.65]
ROUND = ("sampled", "through a roadmap")  # how a detour is found


def site(start: tuple[float, ...], goal: Any, keep: Data, *obstacles: Data, **keys: Any) -> bp.Scene:
    named = goal if isinstance(goal, dict) else {"joints": dict(zip(NAMES, goal, strict=True))}
    content = {"version": 1, "start": {"joints": dict(zip(NAMES, start, strict=True))}, "clearance": 0.05}
    return bp.scene_from_dict(content | {"task": {"goal": named, "keep": keep}, "obstacles": list(obstacles)} | keys)


def pitches(plan: bp.Plan) -> Any:
    return plan.trajectory.q[:, 1:].sum(axis=1)


def post(x: float, y: float, name: str = "post") -> Data:
    return {"name": name, "shape": "capsule", "from": [x, y, -1.0], "to": [x, y, 2.0], "radius": 0.2}


def in_between() -> Data:
    """A post at the tip halfway from A to B."""
    tip = bp.Kinematics(bp.load_robot("example:backhoe")).at(0.5 * (np.array(A) + B)).tip_position
    return post(float(tip[0]), float(tip[1]))


def test_a_loaded_bucket_swings_round_a_post_within_six_degrees(backhoe: bp.Robot, tmp_path: Path) -> None:
    scene = site(A, B, {"pitch": BAND}, in_between())
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    assert plan.findings.way in ROUND
    assert np.all(np.abs(pitches(plan) + 2.7) <= 0.05 + 1e-6)
    (use,) = plan.certificate.keep
    assert -1e-6 <= use.margin <= 0.05
    plan.save(tmp_path / "plan.json")
    assert bp.load_plan(tmp_path / "plan.json").certificate.keep == plan.certificate.keep
    (told,) = plan_to_dict(plan)["certificate"]["keep"]
    assert (told["name"], told["unit"]) == ("pitch", "rad")


def test_a_constant_pitch_is_kept_round_a_post(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, site(A, B, {"pitch": [-2.7, -2.7]}, in_between()), effort="quick")
    assert plan.verified, plan.message
    np.testing.assert_allclose(pitches(plan), -2.7, atol=1e-6)


def test_a_motion_keeps_a_band_that_the_law_alone_leaves(backhoe: bp.Robot) -> None:
    """With the pitch free, the law takes the tip straight there and tilts the bucket beyond the band."""
    goal = {"position": bp.Kinematics(backhoe).at(np.array(B)).tip_position.tolist()}
    free = bp.plan(backhoe, site(A, goal, {"below": 9.0}), method="reactive")
    assert free.verified, free.message
    assert np.max(np.abs(pitches(free) + 2.7)) > 0.1
    kept = bp.plan(backhoe, site(A, goal, {"pitch": BAND}), effort="quick")
    assert kept.verified, kept.message
    assert np.max(np.abs(pitches(kept) + 2.7)) <= 0.05 + 1e-6


def test_the_law_keeps_a_band_that_it_leaves_when_free(backhoe: bp.Robot) -> None:
    start, goal = (0.0, 0.4, -1.6, -0.9), {"position": [3.6, 2.0, 1.5]}
    free = bp.plan(backhoe, site(start, goal, {"below": 9.0}), method="reactive")
    assert free.verified, free.message
    assert np.max(pitches(free)) > -1.5
    kept = bp.plan(backhoe, site(start, goal, {"pitch": [-2.6, -1.6]}), method="reactive")
    assert kept.verified, kept.message
    assert np.max(np.abs(pitches(kept) + 2.1)) <= 0.5 + 1e-6


def test_a_band_in_which_no_posture_is_on_the_goal_is_reported_by_the_law(backhoe: bp.Robot) -> None:
    """On a grid of 250,000 postures with such a pitch, no tip comes within 0.2 m of the goal."""
    position, (_, *low), (_, *high) = [3.6, 2.0, 1.5], backhoe.limits.lower, backhoe.limits.upper
    ranges = (np.linspace(a, b, 300) for a, b in zip(low[:2], high[:2], strict=True))
    boom, stick, pitch = (part.ravel() for part in np.meshgrid(*ranges, [-2.11, -2.1, -2.09]))
    q = np.column_stack((np.full(len(boom), np.arctan2(2.0, 3.6)), boom, stick, pitch - boom - stick))
    q = q[(q[:, 3] >= low[2]) & (q[:, 3] <= high[2])]
    away = np.linalg.norm(BatchKinematics(backhoe).at(q).tip_position - position, axis=1)
    assert len(q) > 200_000
    assert away.min() > 0.2
    scene = site((0.0, 0.4, -1.6, -0.9), {"position": position}, {"pitch": [-2.11, -2.09]})
    plan = bp.plan(backhoe, scene, method="reactive")
    assert plan.reason == "goal_breaks_keep"
    assert "pitch of the bucket" in plan.message


@pytest.mark.parametrize("method", ["auto", "reactive"])
def test_a_start_outside_the_band_is_reported_with_the_allowed_pitch(backhoe: bp.Robot, method: str) -> None:
    plan = bp.plan(backhoe, site((0.0, 0.4, -1.6, -0.9), B, {"pitch": BAND}), method=method, effort="quick")
    assert plan.reason == "start_breaks_keep"
    assert plan.message == "at the start the pitch of the bucket is -120.3 deg, allowed -157.6 to -151.8 deg"
    assert len(plan.trajectory) == 1


def test_a_goal_outside_the_band_is_reported_with_what_is_allowed(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, site(A, (1.0, 0.6, -1.2, -1.5), {"pitch": BAND}), effort="quick")
    assert plan.reason == "goal_breaks_keep"
    assert plan.message == "at the goal the pitch of the bucket is -120.3 deg, allowed -157.6 to -151.8 deg"
    asked = bp.plan(
        backhoe, site(A, {"position": [4.0, 1.0, 0.5], "pitch": [-1.5, -1.0]}, {"pitch": BAND}), effort="quick"
    )
    assert asked.reason == "goal_breaks_keep"
    raised = (0.0, 0.8, -1.5, -1.5)
    low = float(bp.Kinematics(backhoe).at(np.array(A)).tip_position[2]) + 0.1
    high = bp.plan(backhoe, site(A, raised, {"below": low}), effort="quick")
    assert high.reason == "goal_breaks_keep"
    assert f"m high, allowed at most {low:.4g} m" in high.message


def test_of_several_goals_one_within_the_band_is_taken(backhoe: bp.Robot) -> None:
    tips_out = {"joints": dict(zip(NAMES, (0.5, 0.6, -1.2, -1.5), strict=True))}
    level = {"joints": dict(zip(NAMES, B, strict=True))}
    content = site(A, tips_out, {"pitch": BAND}).to_dict()
    content["task"]["goal"] = [tips_out, level]
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.goal == 2


def test_a_height_limit_is_kept_past_a_post(backhoe: bp.Robot) -> None:
    start, goal = (-0.8, 0.5, -1.2, -0.8), (0.8, 0.5, -1.2, -0.8)
    kinematics = bp.Kinematics(backhoe)
    z = float(kinematics.at(np.array(start)).tip_position[2])
    tip = kinematics.at(np.array([0.0, *start[1:]])).tip_position
    scene = site(start, goal, {"below": z + 0.2}, post(float(tip[0]), 0.0))
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    assert max(float(point[2]) for point in plan.tip_path()) <= z + 0.2 + 1e-6


def test_a_segment_that_leaves_the_band_only_between_its_ends_is_not_clear(backhoe: bp.Robot) -> None:
    """Both ends are in the band: -5.0 and 1.1 rad are 1.283 and 1.1 rad, but all other pitches lie between them."""
    low, high = np.array([0.0, -0.5, -2.2, -2.3]), np.array([0.0, 0.75, -0.2, 0.55])
    for keep, clear in (({"pitch": [1.0, 1.4]}, False), ({"below": 50.0}, True)):
        problem = build_problem(backhoe, site(tuple(low), tuple(high), keep))
        proximity = bp.Proximity(backhoe, (), self_collision=False)
        check = MotionCheck(problem, proximity, [low, high], spare=0.0)
        assert check.ends_clear == [True, True]
        assert check.segment_is_clear(low, high) is clear


@pytest.mark.parametrize("beyond", [pytest.param(0.0, marks=pytest.mark.long), 5e-7])
def test_a_goal_on_the_edge_of_the_band_is_reached_by_a_detour(backhoe: bp.Robot, beyond: float) -> None:
    """Inverse kinematics misses the edge by its rounding, which still counts as kept."""
    start, goal = (*A[:3], A[3] - 0.04), (*B[:3], B[3] + 0.05 + beyond)
    plan = bp.plan(backhoe, site(start, goal, {"pitch": BAND}, in_between()), effort="quick")
    assert plan.verified, plan.message
    assert plan.findings.way in ROUND


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 3))])
def test_a_band_of_ten_degrees_is_kept_among_random_posts(backhoe: bp.Robot, seed: int) -> None:
    """Both ends are clear and in the band."""
    rng = np.random.default_rng(seed)
    limits, half = backhoe.limits, np.radians(5.0)
    while True:
        ends = [backhoe.random_q(rng), backhoe.random_q(rng)]
        pitch = float(ends[0][1:].sum())
        ends[1][3] += pitch + rng.uniform(-0.5, 0.5) * half - ends[1][1:].sum()
        places = [rng.uniform(2.0, 4.5) * np.array([np.cos(a), np.sin(a)]) for a in rng.uniform(-1.0, 1.0, 2)]
        obstacles = [post(float(x), float(y), f"post {k}") for k, (x, y) in enumerate(places)]
        scene = site(tuple(ends[0]), tuple(ends[1]), {"pitch": [pitch - half, pitch + half]}, *obstacles)
        if not limits.lower[3] < ends[1][3] < limits.upper[3] or np.linalg.norm(ends[1] - ends[0]) < 1.0:
            continue
        proximity = bp.Proximity(backhoe, bp.build_obstacles(scene, backhoe))
        if all(np.min(proximity.distances(q) - proximity.clearance) > 0.02 for q in ends):
            break
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    assert np.max(np.abs(pitches(plan) - pitch)) <= half + 1e-6


# --- among moving obstacles ----------------------------------------------------------------


def walking(x: float, y: float, velocity: list[float], **keys: Any) -> Data:
    body = {"name": "worker", "shape": "capsule", "from": [x, y, 0.0], "to": [x, y, 1.8], "radius": 0.3}
    return body | {"clearance": 0.3, "velocity": velocity} | keys


def test_giving_way_keeps_the_band(backhoe: bp.Robot) -> None:
    """A ball rises against the bucket, which with the pitch free tilts by more than the 6 degrees of the band."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [2.6, 0.0, -2.2], "clearance": 0.3}
    tips = []
    for keep in ({"below": 50.0}, {"pitch": [-2.8, -2.6]}):
        scene = site(A, B, keep, ball | {"velocity": [0.0, 0.0, 0.2]})
        stepper = World(build_problem(backhoe, scene), seed=0, work=Work(EFFORTS["quick"])).stepper(np.array(A))
        stepper.give_way(4.0)
        tips.append(np.max(np.abs(stepper.trajectory().q[:, 1:].sum(axis=1) + 2.7)))
    assert tips[0] > 0.1
    assert tips[1] <= 0.1 + 1e-6


@pytest.mark.long
def test_a_worker_who_steps_in_is_passed_within_the_band(backhoe: bp.Robot) -> None:
    worker = walking(2.0, 2.6, [0.0, -0.7, 0.0], appears_at=0.5)
    plan = bp.plan(backhoe, site((-0.8, *A[1:]), B, {"pitch": [-2.8, -2.6]}, worker), effort="quick")
    assert plan.verified, plan.message
    assert np.max(np.abs(pitches(plan) + 2.7)) <= 0.1 + 1e-6
    (reaction,) = plan.findings.reactions
    assert reaction.way == "stopped and planned anew"


# --- along a path --------------------------------------------------------------------------


def along(keep: Data, *points: list[float], **keys: Any) -> bp.Scene:
    task = {"path": {"waypoints": [{"position": point} for point in points], "speed": 0.5}, "keep": keep}
    return bp.scene_from_dict({"version": 1, "task": task, "clearance": 0.05} | keys)


@pytest.mark.parametrize("method", ["auto", "reactive"])
def test_a_path_that_leaves_the_pitch_free_is_followed_within_the_band(backhoe: bp.Robot, method: str) -> None:
    scene = along({"pitch": [-3.4, -2.8]}, [2.9, 0.0, 0.5], [2.8, 0.3, 0.8])
    plan = bp.plan(backhoe, scene, method=method, effort="quick")
    assert plan.verified, plan.message
    assert -3.4 - 1e-6 <= np.min(pitches(plan)) <= np.max(pitches(plan)) <= -2.8 + 1e-6
    assert plan.problem.path is not None
    assert plan.problem.path.waypoints[0].pitch is None  # the path is kept as it was given


@pytest.mark.long
def test_continuous_joints_give_way_and_a_goal_below_the_height_limit_is_reported() -> None:
    """A ball flies past an arm of continuous joints whose goal is below the height to keep."""
    robot = bp.load_robot("example:kinova", tip="j2s6s200_end_effector")
    assert np.isinf(robot.limits.upper).any()
    content = {
        "version": 1,
        "start": {"joints": dict(zip(robot.joint_names, [-0.85, 1.65, 1.36, 2.63, 2.06, 0.94], strict=True))},
        "task": {"goal": {"position": [-0.8, -0.43, 0.19]}, "keep": {"above": 0.597}},
        "obstacles": [
            {"name": "ball", "shape": "sphere", "radius": 0.03, "position": [-0.39, 0.04, 0.13],
             "velocity": [-0.22, -0.24, 0.05]},
        ],
    }  # fmt: skip
    assert bp.plan(robot, bp.scene_from_dict(content), effort="quick").reason == "goal_breaks_keep"


def test_the_approach_to_a_path_keeps_the_band(backhoe: bp.Robot) -> None:
    start = {"joints": dict(zip(NAMES, (-0.8, 0.3, -1.5, -1.8), strict=True))}  # -3.0
    plan = bp.plan(
        backhoe, along({"pitch": [-3.1, -2.9]}, [2.9, 0.0, 0.5], [2.8, 0.3, 0.8], start=start), effort="quick"
    )
    assert plan.verified, plan.message
    assert plan.certificate.tracking.approach_time > 0.0
    assert np.max(np.abs(pitches(plan) + 3.0)) <= 0.1 + 1e-6


def test_a_waypoint_outside_the_band_is_named(backhoe: bp.Robot) -> None:
    low = bp.plan(backhoe, along({"above": 0.6}, [2.9, 0.0, 0.7], [2.9, 0.5, 0.5]), effort="quick")
    assert low.reason == "goal_breaks_keep"
    assert low.message == "at waypoint 2 of the path the tip is 0.500 m high, allowed at least 0.6 m"
    content = along({"pitch": [-3.1, -2.9]}, [2.9, 0.0, 0.5], [2.8, 0.3, 0.8]).to_dict()
    content["task"]["path"]["waypoints"][0]["pitch"] = [-2.0, -1.5]
    tipped = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert tipped.reason == "goal_breaks_keep"
    assert tipped.message.startswith("at waypoint 1 of the path the pitch of the bucket is -114.6 deg")


# --- within a cone of orientations ---------------------------------------------------------


def test_a_glass_is_carried_round_a_ball_within_two_degrees(panda: bp.Robot) -> None:
    """No straight joint motion keeps so narrow a cone for long, and no sample is in it by chance."""
    start = np.array([-0.8, -0.3, 0.0, -2.2, 0.0, 1.9, 0.8])
    at, cone = bp.Kinematics(panda).at(start), 0.03
    x, y, z, w = Rotation.from_matrix(at.tip_rotation).as_quat().tolist()
    upright = {"quaternion": [w, x, y, z]}

    def swung(angle: float) -> list[float]:
        return [float(part) for part in Rotation.from_euler("z", angle).as_matrix() @ at.tip_position]

    task = {
        "goal": upright | {"position": swung(1.6), "rotation_tolerance": cone},
        "keep": {"rotation": upright | {"tolerance": cone}},
    }
    ball = {"name": "ball", "shape": "sphere", "radius": 0.12, "position": swung(0.8), "clearance": 0.01}
    joints = dict(zip(panda.joint_names, start.tolist(), strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": task, "obstacles": [ball]}
    plan = bp.plan(panda, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    kinematics = bp.Kinematics(panda)
    turned = [kinematics.at(q).tip_rotation @ at.tip_rotation.T for q in plan.trajectory.q]
    assert np.max(Rotation.from_matrix(np.array(turned)).magnitude()) <= cone + 1e-6


def test_a_waypoint_whose_orientation_is_outside_the_cone_is_named(panda: bp.Robot) -> None:
    """The second waypoint is turned by 0.5 rad, 28.6 degrees."""
    start = np.array([-0.8, -0.3, 0.0, -2.2, 0.0, 1.9, 0.8])
    at = bp.Kinematics(panda).at(start)

    def turned(angle: float) -> list[float]:
        rotation = Rotation.from_euler("x", angle).as_matrix() @ at.tip_rotation
        return [float(part) for part in np.roll(Rotation.from_matrix(rotation).as_quat(), 1)]

    waypoints = [
        {"position": (at.tip_position + np.array([0.0, y, 0.0])).tolist(), "quaternion": turned(angle)}
        for y, angle in ((0.0, 0.0), (0.1, 0.5))
    ]
    content = {
        "version": 1,
        "start": {"joints": dict(zip(panda.joint_names, start.tolist(), strict=True))},
        "task": {
            "path": {"waypoints": waypoints},
            "keep": {"rotation": {"quaternion": turned(0.0), "tolerance": 0.1}},
        },
    }
    plan = bp.plan(panda, bp.scene_from_dict(content), effort="quick")
    assert plan.reason == "goal_breaks_keep"
    assert plan.message == (
        "at waypoint 2 of the path the tip is turned by 28.6 deg from the orientation to be kept, allowed 5.73 deg"
    )


@pytest.mark.parametrize(
    ("swung", "pitched", "angle"), [(0.6, None, 34.4), (0.0, 0.6, 34.4), (0.1, None, None), (0.0, 0.1, None)]
)
def test_a_waypoint_at_which_no_posture_is_within_the_cone_is_named(
    backhoe: bp.Robot, swung: float, pitched: float | None, angle: float | None
) -> None:
    """The bucket turns about the upright axis with the swing, and about a level one with the pitch: 0.6 rad, 34.4 deg.

    The cone is of 0.2 rad, within which both paths with 0.1 rad are.
    """
    q = np.array((0.0, 0.4, -1.6, -0.9))
    at = bp.Kinematics(backhoe).at(q)
    x, y, z, w = Rotation.from_matrix(at.tip_rotation).as_quat().tolist()
    first: dict[str, Any] = {"position": at.tip_position.tolist()}
    last: dict[str, Any] = {"position": Rotation.from_euler("z", swung).apply(at.tip_position).tolist()}
    if pitched is not None:
        first["pitch"], last["pitch"] = at.pitch, at.pitch + pitched
        last["position"] = (at.tip_position + np.array([0.3, 0.0, 0.2])).tolist()
    content = {
        "version": 1,
        "start": {"joints": dict(zip(NAMES, q.tolist(), strict=True))},
        "task": {
            "path": {"waypoints": [first, last]},
            "keep": {"rotation": {"quaternion": [w, x, y, z], "tolerance": 0.2}},
        },
    }
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    if angle is None:
        assert plan.verified, plan.message
    else:
        assert plan.reason == "goal_breaks_keep"
        assert plan.message == (
            "no posture was found at waypoint 2 of the path that keeps it: at best the tip is turned by "
            f"{angle} deg from the orientation to be kept, allowed 11.46 deg"
        )
