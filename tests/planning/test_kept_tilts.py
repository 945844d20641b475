"""Motions that keep a cup upright, whatever its heading: to goals, along paths, from starts given by the tip."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.machine import BatchKinematics
from backhoe_planner.motion import RotationCone, build_problem
from backhoe_planner.planning.search.effort import OutOfTime
from backhoe_planner.planning.search.kept_trees import KeptTrees
from backhoe_planner.planning.sequence.leg import Leg
from backhoe_planner.planning.sequence.next_leg import ready_for_next

Data = dict[str, Any]

DOWN = np.diag([1.0, -1.0, -1.0])  # of the hand: a cup in it stands upright
CUP: Data = {"axis": [0, 0, -1], "tolerance": 0.1}
Q = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 1.9, 0.8])


def quaternion(rotation: NDArray[np.float64]) -> list[float]:
    found = pin.Quaternion(rotation)
    return [found.w, found.x, found.y, found.z]


def upright(panda: bp.Robot, position: list[float]) -> Data:
    """A start with the hand straight down."""
    found = bp.solve_inverse_kinematics(panda, bp.TipTarget(np.array(position), rotation=DOWN), start=Q)
    assert found.reached
    return {"joints": dict(zip(panda.joint_names, found.q.tolist(), strict=True))}


def plan(robot: bp.Robot, start: Data | None, task: Data, *obstacles: Data, **keys: Any) -> bp.Plan:
    tip = robot.model.frames[robot.tip_frame].name
    content = {"version": 1, "tip": tip, "task": task, "obstacles": list(obstacles)} | keys
    return bp.plan(robot, bp.scene_from_dict(content | ({} if start is None else {"start": start})), effort="quick")


def greatest_tilt(found: bp.Plan, tilt: Data) -> float:
    """The greatest angle between axis and direction at 1000 times of a motion [rad], by its cosine alone."""
    motion = found.trajectory
    times = np.linspace(motion.time[0], motion.time[-1], 1000)
    q = np.column_stack([np.interp(times, motion.time, column) for column in motion.q.T])
    axes = BatchKinematics(found.robot).at(q).tip_rotation @ np.array(tilt["axis"], dtype=float)
    return float(np.max(np.arccos(np.clip(axes @ np.array(tilt.get("direction", [0, 0, 1]), dtype=float), -1.0, 1.0))))


def test_a_cup_turns_half_round_between_its_places_which_no_kept_rotation_allows(panda: bp.Robot) -> None:
    """The goal's heading is 3.1 rad from that of the start."""
    start = upright(panda, [0.5, 0.1, 0.4])
    goal = {"position": [0.4, -0.35, 0.35], "quaternion": quaternion(pin.exp3(np.array([0.0, 0.0, 3.1])) @ DOWN)}
    found = plan(panda, start, {"goal": goal, "keep": {"tilt": CUP}})
    assert found.verified, found.message
    assert greatest_tilt(found, CUP) <= 0.1 + 1e-6
    (use,) = found.certificate.keep
    assert (use.name, use.unit) == ("tilt", "rad")
    assert 0.0 <= use.margin + 1e-6 <= 0.1 - greatest_tilt(found, CUP) + 1e-5
    ends = BatchKinematics(panda).at(found.trajectory.q[[0, -1]]).tip_rotation
    assert np.linalg.norm(pin.log3(ends[0].T @ ends[1])) == pytest.approx(3.1, abs=0.02)
    kept = {"rotation": {"quaternion": quaternion(DOWN), "tolerance": 0.1}}
    turned = plan(panda, start, {"goal": goal, "keep": kept})
    assert turned.reason == "goal_breaks_keep"
    assert "turned by 177.6 deg" in turned.message  # 3.1 rad


@pytest.mark.parametrize("tolerance", [0.2, 0.05])
def test_goals_by_position_are_found_in_a_narrow_tilt_on_arms_with_six_and_seven_joints(
    ur5: bp.Robot, panda: bp.Robot, tolerance: float
) -> None:
    """Starts by the tip's position too. Of random postures 1 in 1,600 is within 0.05 rad: (1 - cos 0.05) / 2."""
    for robot, goal in ((panda, [0.4, -0.35, 0.35]), (ur5, [-0.3, 0.4, 0.3])):
        tilt = CUP | {"tolerance": tolerance}
        begin = {"tip": {"position": [0.45, 0.2, 0.4]}}
        found = plan(robot, begin, {"goal": {"position": goal}, "keep": {"tilt": tilt}})
        assert found.verified, found.message
        assert greatest_tilt(found, tilt) <= tolerance + 1e-6


def test_the_cup_of_the_example_stays_upright_and_arrives(panda: bp.Robot) -> None:
    scene = bp.load_scene("scenes/cup.yaml")
    found = bp.plan(panda, scene, effort="quick")
    assert found.verified, found.message
    assert greatest_tilt(found, CUP) <= 0.1 + 1e-6
    np.testing.assert_allclose(found.tip_path()[-1], [0.5, -0.35, 0.3], atol=1e-3)


def test_a_path_of_positions_is_followed_within_a_tilt(panda: bp.Robot) -> None:
    waypoints = [{"position": position} for position in ([0.5, -0.05, 0.4], [0.5, 0.05, 0.4], [0.48, 0.07, 0.38])]
    found = plan(panda, None, {"path": {"waypoints": waypoints}, "keep": {"tilt": CUP}})
    assert found.verified, found.message
    assert not found.certificate.detours
    assert greatest_tilt(found, CUP) <= 0.1 + 1e-6


def test_a_tilt_that_cannot_be_had_at_a_goal_is_told_with_its_angle(panda: bp.Robot) -> None:
    """The arm has to be stretched for a goal that is 0.83 m away, so that the hand cannot point down."""
    start = upright(panda, [0.5, 0.1, 0.4])
    far = plan(panda, start, {"goal": {"position": [0.83, 0.1, 0.4]}, "keep": {"tilt": CUP}})
    assert far.reason == "goal_breaks_keep"
    assert "no posture was found on the goal that keeps it: at best the tip is tilted by" in far.message
    told = float(far.message.split("tilted by ")[1].split(" deg")[0])
    for degrees, reached in ((told + 0.1, True), (told - 2.0, False)):
        tilt = bp.Tilt(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]), np.radians(degrees))
        target = bp.TipTarget(np.array([0.83, 0.1, 0.4]), tilt=tilt)
        assert bp.solve_inverse_kinematics(panda, target, attempts=100).reached is reached
    # an orientation given: 2 rad about x leave the z axis pi - 2 rad = 65.4 deg from pointing down
    given = plan(panda, start, {"goal": {"position": [0.4, -0.35, 0.35], "rpy": [2.0, 0, 0]}, "keep": {"tilt": CUP}})
    assert given.reason == "goal_breaks_keep"
    assert "tilted by 65.4 deg, allowed 5.73 deg" in given.message
    begins = plan(panda, start, {"goal": {"position": [0.4, -0.35, 0.35]}, "keep": {"tilt": {"tolerance": 0.1}}})
    assert begins.reason == "start_breaks_keep"
    assert "tilted by 180.0 deg, allowed 5.73 deg; the opposite axis, [0, 0, -1], is within that" in begins.message
    assert "opposite" not in given.message  # 65.4 deg off, and so 114.6 deg with the other sign


@pytest.mark.parametrize(("margin", "kept", "left"), [(2e-3, True, 2e-3), (-7e-7, True, 0.0), (-2e-6, False, -2e-6)])
def test_a_margin_that_rounding_takes_below_zero_is_reported_as_zero(margin: float, kept: bool, left: float) -> None:
    """A condition may be missed by 1e-6 rad."""
    use = bp.KeepUse(name="tilt", margin=margin, value=0.1, time=0.0, unit="rad", words="")
    assert (use.kept, use.left) == (kept, left)


def test_a_tilt_may_be_kept_beside_a_rotation_and_a_height(panda: bp.Robot) -> None:
    """A cable lets the hand turn by 1 rad, and the cup must not spill."""
    start = upright(panda, [0.5, 0.1, 0.4])
    rotation = {"quaternion": quaternion(DOWN), "tolerance": 1.0}
    keep = {"tilt": CUP, "rotation": rotation, "above": 0.3}
    found = plan(panda, start, {"goal": {"position": [0.4, -0.35, 0.35]}, "keep": keep})
    assert found.verified, found.message
    assert {use.name for use in found.certificate.keep} == {"tilt", "rotation", "above"}
    assert all(use.kept for use in found.certificate.keep)
    assert greatest_tilt(found, CUP) <= 0.1 + 1e-6


def test_the_tilt_of_a_backhoe_is_its_pitch(backhoe: bp.Robot) -> None:
    """The z axis of the bucket is vertical at pitch 0, so that a tilt of 0.2 rad is a pitch of -0.2 to 0.2."""
    start = {"tip": {"position": [2.5, -2.0, 1.5]}}
    goal = {"position": [3.0, 2.0, 1.0]}
    tilted = plan(backhoe, start, {"goal": goal, "keep": {"tilt": {"tolerance": 0.2}}})
    assert tilted.verified, tilted.message
    pitches = tilted.trajectory.q[:, 1:].sum(axis=1)
    assert np.max(np.abs(pitches)) <= 0.2 + 1e-6
    assert greatest_tilt(tilted, {"axis": [0, 0, 1]}) == pytest.approx(float(np.max(np.abs(pitches))), abs=1e-5)


def test_a_goal_may_ask_for_a_tilt_at_the_end_alone(panda: bp.Robot, backhoe: bp.Robot) -> None:
    """The backhoe's bucket starts at a pitch of -2.1 rad, and arrives with its z axis within 0.2 rad of up."""
    q = dict(zip(panda.joint_names, Q.tolist(), strict=True))
    bucket = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    cases: tuple[tuple[bp.Robot, Data, list[float], Data], ...] = (
        (panda, q, [0.4, -0.35, 0.35], {"axis": [0, 1, 0], "direction": [0, 0, 2.0], "tolerance": 0.05}),
        (backhoe, bucket, [3.0, 2.0, 1.0], {"tolerance": 0.2}),
    )
    for robot, start, position, tilt in cases:
        found = plan(robot, {"joints": start}, {"goal": {"position": position, "tilt": tilt}})
        assert found.verified, found.message
        axis = bp.Kinematics(robot).at(found.trajectory.q[-1]).tip_rotation @ np.array(tilt.get("axis", [0, 0, 1]))
        left = tilt["tolerance"] - float(np.arccos(axis[2]))
        assert left >= -1e-6
        assert found.certificate.tracking.max_angle_error == pytest.approx(float(np.arccos(axis[2])), abs=1e-6)
        # a motion that ends elsewhere is not accepted: the start of this one is not tilted so
        back = found.trajectory
        turned = bp.Trajectory.from_steps(back.time, back.q[::-1])
        scene = bp.scene_from_dict(found.scene.model_dump(mode="json", by_alias=True, exclude_unset=True))
        assert any("from the asked angle" in one for one in bp.certify(robot, scene, turned).problems)


def test_a_goal_has_a_tilt_or_an_orientation() -> None:
    goal = {"position": [1, 2, 3], "tilt": {"tolerance": 0.1}, "rpy": [0, 0, 0]}
    with pytest.raises(bp.SceneError, match="only one of pitch, rpy, quaternion, tilt may be given, here are rpy and"):
        bp.scene_from_dict({"version": 1, "start": {"joints": {}}, "task": {"goal": goal}})


def test_a_leg_ends_where_the_next_one_can_begin_upright(panda: bp.Robot) -> None:
    """The first leg keeps nothing itself; it begins with the hand level, from where postures on its goal are tilted."""
    legs = [
        {"name": "to the cup", "goal": {"position": [0.4, 0.3, 0.5]}},
        {"name": "wait", "wait": 0.2},
        {"name": "carry", "goal": {"position": [0.5, 0.0, 0.35]}, "keep": {"tilt": CUP}},
    ]
    level = Q + np.array([0.5, 0.0, 0.0, 0.0, 1.2, 1.5, 0.0])
    start = {"joints": dict(zip(panda.joint_names, level.tolist(), strict=True))}
    found = plan(panda, start, {"sequence": legs})
    assert found.verified, found.message
    carried = found.trajectory.part(found.trajectory.begins[2], len(found.trajectory) - 1).q
    axes = BatchKinematics(panda).at(carried).tip_rotation @ np.array([0.0, 0.0, -1.0])
    assert np.arccos(axes[:, 2]).max() <= 0.1 + 1e-6


def test_what_the_next_leg_keeps_narrows_only_goals_that_leave_it_open(panda: bp.Robot) -> None:
    """A goal with an orientation of its own, one given by joints, and the last leg's are left as they are."""
    joints = dict(zip(panda.joint_names, Q.tolist(), strict=True))
    open_, given = {"position": [0.4, 0.3, 0.5]}, {"position": [0.4, 0.3, 0.5], "quaternion": [0, 1, 0, 0]}
    keep = {"tilt": {"axis": [0, 0, -1], "tolerance": 0.1}, "rotation": {"rpy": [np.pi, 0, 0], "tolerance": 0.6}}
    for goal, narrowed in ((open_, True), (given, False), ({"joints": joints}, False)):
        task = {"sequence": [{"name": "one", "goal": goal}, {"name": "two", "goal": open_, "keep": keep}]}
        scene = bp.scene_from_dict({"version": 1, "tip": "panda_hand_tcp", "start": {"joints": joints}, "task": task})
        legs = [Leg(problem) for problem in build_problem(panda, scene).legs]
        first, last = ready_for_next(legs)
        assert (first is not legs[0]) == narrowed
        assert last is legs[1]
        if narrowed:
            target = first.problem.goals[0].search_target
            assert target.tilt is not None
            assert target.tilt.tolerance <= 0.09 + 1e-12
            assert target.rotation is not None
            np.testing.assert_allclose(target.rotation, DOWN, atol=1e-12)
            assert 0.0 < target.rotation_tolerance <= 0.54 + 1e-12


def test_the_law_begins_within_the_acceleration_where_a_narrow_tilt_shortens_its_first_step(panda: bp.Robot) -> None:
    """From rest a shortened step has only its own time to reach its velocity, not half of the usual step as well."""
    start = (-0.020996, 0.947373, 0.305992, -0.916855, -0.083088, 2.769581, -0.867994)
    tilt = {"axis": [0.100274, 0.803068, -0.587390], "direction": [0.000802, 0.000598, 1.0], "tolerance": 0.001}
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(panda.joint_names, start, strict=True))},
            "task": {"goal": {"position": [0.6, 0.57, 0.29]}, "keep": {"tilt": tilt}},
        }
    )
    motion = bp.plan(panda, scene, method="reactive").trajectory
    assert motion.time[1] < 0.01  # it is shortened
    assert float(np.max(np.abs(motion.corner_accelerations()[0]) / panda.limits.acceleration)) < 1.0 + 1e-9


@pytest.mark.parametrize("tolerance", [0.01, 0.25])
def test_a_start_given_by_the_tip_may_lean_as_far_as_its_tilt_allows(panda: bp.Robot, tolerance: float) -> None:
    """The axis begins within its tolerance of a slanted direction; nothing keeps it afterwards."""
    tilt = {"axis": [0, 0, -1], "direction": [0.3, 0.0, 1.0], "tolerance": tolerance}
    place = [0.5, 0.1, 0.4]
    found = plan(panda, {"tip": {"position": place, "tilt": tilt}}, {"goal": upright(panda, [0.4, -0.2, 0.4])})
    assert found.verified, found.message
    at = bp.Kinematics(found.robot).at(found.trajectory.q[0])
    np.testing.assert_allclose(at.tip_position, place, atol=1e-5)
    direction = np.array([0.3, 0.0, 1.0]) / np.hypot(0.3, 1.0)
    assert float(np.linalg.norm(np.cross(-at.tip_rotation[:, 2], direction))) <= np.sin(tolerance) + 1e-5
    # of a start that may not lean so, the same motion is none
    content = found.scene.model_dump(mode="json", by_alias=True, exclude_unset=True)
    content["start"]["tip"]["tilt"] |= {"direction": [-0.3, 0.0, 1.0], "tolerance": 0.01}
    problems = bp.certify(found.robot, bp.scene_from_dict(content), found.trajectory).problems
    assert any("does not begin at the start" in one for one in problems)


def test_a_start_has_one_kind_of_orientation_and_a_wide_tilt_is_told() -> None:
    pose: Data = {"position": [0.5, 0.1, 0.4], "tilt": {"tolerance": 2.0}}
    content: Data = {"version": 1, "task": {"goal": {"position": [0.4, 0.0, 0.4]}}}
    with pytest.raises(bp.SceneError, match="only one of pitch, rpy, quaternion, tilt may be given, here are rpy and"):
        bp.scene_from_dict({**content, "start": {"tip": {**pose, "rpy": [0, 0, 0]}}})
    (warning,) = bp.scene_from_dict({**content, "start": {"tip": pose}}).warnings()
    assert warning == "start.tip.tilt.tolerance: 2 rad are 114.6 deg; 2 degrees are 0.03491 rad"


def tilted(angle: float) -> NDArray[np.float64]:
    """The hand tilted by an angle [rad] from straight down, about a horizontal axis."""
    return np.asarray(pin.exp3(angle * np.array([0.6, 0.8, 0.0])) @ DOWN)


@pytest.mark.parametrize("kept", ["tilt", "rotation"])
def test_a_path_of_poses_exactly_on_the_rim_of_a_cone_is_followed(panda: bp.Robot, kept: str) -> None:
    """The certificate allows 1e-6 rad beyond the rim, and the angles of a path may be off by 0.01 rad."""
    turned = quaternion(tilted(0.1))
    path = {"waypoints": [{"position": at, "quaternion": turned} for at in ([0.5, 0.1, 0.4], [0.48, -0.1, 0.38])]}
    keep = {"tilt": CUP} if kept == "tilt" else {"rotation": {"quaternion": quaternion(DOWN), "tolerance": 0.1}}
    found = plan(panda, None, {"path": path, "keep": keep})
    assert found.verified, found.message
    assert greatest_tilt(found, CUP) <= 0.1 + 1e-6
    assert found.certificate.tracking.max_angle_error <= 0.01


def test_poses_near_the_rim_of_a_cone_that_a_swing_alone_turns_are_followed(backhoe: bp.Robot) -> None:
    """A machine of four joints takes no other orientation at these places, 0.3 mrad inside the cone."""
    places = [[r * np.cos(0.087), r * np.sin(0.087), 0.5] for r in (3.5, 3.7)]
    path = {"waypoints": [{"position": at, "rpy": [0.0, 1.2, 0.087]} for at in places]}
    found = plan(backhoe, None, {"path": path, "keep": {"rotation": {"rpy": [0.0, 1.2, 0.0], "tolerance": 0.0873}}})
    assert found.verified, found.message


@pytest.mark.parametrize("kept", ["tilt", "rotation"])
def test_a_goal_is_reached_where_its_tolerance_and_a_cone_only_overlap_at_their_rims(
    panda: bp.Robot, kept: str
) -> None:
    """At 0.145 rad with 0.05 rad, 0.005 rad of a cone of 0.1 rad are left; at 0.15 rad a point, at 0.151 rad none."""
    start = upright(panda, [0.5, 0.1, 0.4])
    keep = {"tilt": CUP} if kept == "tilt" else {"rotation": {"quaternion": quaternion(DOWN), "tolerance": 0.1}}

    def to(angle: float) -> bp.Plan:
        pose = {"position": [0.4, -0.35, 0.35], "quaternion": quaternion(tilted(angle)), "rotation_tolerance": 0.05}
        return plan(panda, start, {"goal": pose, "keep": keep})

    for angle in (0.145, 0.15):
        found = to(angle)
        assert found.verified, found.message
        assert greatest_tilt(found, CUP) <= 0.1 + 1e-6
        end = BatchKinematics(panda).at(found.trajectory.q[-1:]).tip_rotation[0]
        assert np.linalg.norm(pin.log3(tilted(angle).T @ end)) <= 0.05
    apart = to(0.151)
    assert apart.reason == "goal_breaks_keep"
    assert apart.message.endswith("; its rotation_tolerance of 2.865 deg leaves 5.79 deg, more than 5.73 deg")


def test_a_position_that_only_the_rim_of_a_tilt_allows_is_reached(panda: bp.Robot) -> None:
    """0.8 m away the stretched arm tilts the hand by at least 0.23 rad: inverse kinematics finds nothing below."""
    tilt = CUP | {"tolerance": 0.2427}
    found = plan(
        panda, upright(panda, [0.5, 0.1, 0.4]), {"goal": {"position": [0.8, 0.1, 0.4]}, "keep": {"tilt": tilt}}
    )
    assert found.verified, found.message
    assert 0.22 <= greatest_tilt(found, tilt) <= 0.2427 + 1e-6


def test_a_ball_within_two_balls_of_orientations_is_in_both(ur5: bp.Robot) -> None:
    rng = np.random.default_rng(5)
    for angle, own in ((0.3, 0.25), (0.05, 0.4), (0.0, 0.1), (0.2, 0.01)):
        axis = rng.normal(size=3)
        given = pin.exp3(angle * axis / np.linalg.norm(axis)) @ DOWN
        target = bp.TipTarget(np.zeros(3), rotation=given, rotation_tolerance=own)
        cone = RotationCone(ur5, DOWN, 0.2)
        within = cone.narrowed(target, 0.2)
        assert within is not None
        assert within.rotation is not None
        for _ in range(50):
            turn = rng.normal(size=3)
            inside = pin.exp3(within.rotation_tolerance * turn / np.linalg.norm(turn)) @ within.rotation
            assert np.linalg.norm(pin.log3(inside @ given.T)) <= own + 1e-9
            assert np.linalg.norm(pin.log3(inside @ DOWN.T)) <= 0.2 + 1e-9
    far = bp.TipTarget(np.zeros(3), rotation=pin.exp3(np.array([0.31, 0.0, 0.0])) @ DOWN, rotation_tolerance=0.1)
    assert cone.narrowed(far, 0.2) is None


def test_a_search_in_a_tilt_that_ends_by_its_budget_says_how_many_motions_it_sampled(
    panda: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time runs out after 40 branches of the trees; the hand does not fit through a hole of 0.16 m."""
    z, half = 0.305, 0.08

    def box(name: str, low: list[float], high: list[float]) -> Data:
        size = np.subtract(high, low).tolist()
        return {"name": name, "shape": "box", "size": size, "position": np.mean([low, high], axis=0).tolist()}

    plate = (
        ("left", [0.2, half, z - 0.005], [1.3, 1.3, z + 0.005]),
        ("right", [0.2, -1.3, z - 0.005], [1.3, -half, z + 0.005]),
        ("near", [0.2, -half, z - 0.005], [0.5 - half, half, z + 0.005]),
        ("far", [0.5 + half, -half, z - 0.005], [1.3, half, z + 0.005]),
        ("curtain", [0.2, -1.3, -1.0], [0.21, 1.3, z]),
    )
    allowed, checked = KeptTrees._grow, [0]

    def grow(self: KeptTrees, *given: Any) -> Any:
        checked[0] += 1
        if checked[0] > 40:
            raise OutOfTime("time ran out")
        return allowed(self, *given)

    monkeypatch.setattr(KeptTrees, "_grow", grow)
    task = {"goal": {"position": [0.5, 0.0, 0.15]}, "keep": {"tilt": CUP | {"tolerance": 0.05}}}
    start = upright(panda, [0.45, 0.25, 0.6])
    found = plan(panda, start, task, *(box(*one) for one in plate), clearance=0.002)
    assert found.reason == "budget"
    counted = re.search(r"none of the ([\d,]+) motions that were sampled leads there", found.message)
    assert counted, found.message
    assert int(counted[1].replace(",", "")) >= 40
    assert "within the tilt of `keep`: a greater tolerance" in found.message
