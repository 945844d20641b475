"""A pitch, height or rotation to keep: margins, gradients, and bounds between two configurations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Tilt, tip_travel_bound
from backhoe_planner.motion import Condition, Keep, TiltCone, build_problem

Data = dict[str, Any]

LEVEL: Data = {"rpy": [0.3, -0.2, 1.0], "tolerance": 1.2}
CUP: Data = {"axis": [1.0, 0.5, 0.2], "direction": [0.1, -0.2, 1.0], "tolerance": 1.2}


def keep_of(robot: bp.Robot, **keep: Any) -> Keep:
    start = dict.fromkeys(robot.joint_names, 0.0)
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"joints": start}, "keep": keep}}
    found = build_problem(robot, bp.scene_from_dict(content)).keep
    assert found is not None
    return found


def test_a_projection_keeps_all_conditions_and_is_idempotent(backhoe: bp.Robot) -> None:
    keep = keep_of(backhoe, pitch=[-2.75, -2.65], above=0.2)
    rng, limits, found = np.random.default_rng(0), backhoe.limits, 0
    for _ in range(50):
        q = backhoe.random_q(rng)
        projected = keep.project(q, limits.lower, limits.upper)
        if projected is not None:
            found += 1
            assert keep.holds(projected)
            assert np.all(projected >= limits.lower)
            assert np.all(projected <= limits.upper)
            again = keep.project(projected, limits.lower, limits.upper)
            assert again is not None
            np.testing.assert_array_equal(again, projected)
    assert found >= 25  # half of them; one random configuration in a hundred is in the band of pitch


@pytest.mark.parametrize(
    "keep",
    [{"pitch": [-2.7, -2.7]}, {"pitch": [-2.7, -2.69999]}, {"tilt": {"tolerance": 1e-5}},
     {"rotation": {"rpy": [0.3, -0.2, 1.0], "tolerance": 1e-5}}],
    ids=str,
)  # fmt: skip
def test_a_projection_reaches_a_band_or_a_cone_however_narrow(backhoe: bp.Robot, ur5: bp.Robot, keep: Data) -> None:
    """It aims at most at the middle: a step beyond it would miss the other side by as much, again and again."""
    robot = backhoe if "pitch" in keep else ur5
    kept, rng, found = keep_of(robot, **keep), np.random.default_rng(0), 0
    for _ in range(50):
        projected = kept.project(robot.random_q(rng), robot.limits.lower, robot.limits.upper)
        found += projected is not None and kept.holds(projected)
    assert found >= 20


def condition_of(robot: bp.Robot, **keep: Any) -> Condition:
    (found,) = keep_of(robot, **keep).conditions
    return found


def least_between(condition: Condition, q_a: Vector, q_b: Vector) -> float:
    """The least margin of 501 places on a straight motion."""
    part = np.linspace(0.0, 1.0, 501)[:, None]
    return float(np.min(condition.margins(condition.values((1.0 - part) * q_a + part * q_b))))


def bound_between(condition: Condition, q_a: Vector, q_b: Vector, travel: Vector) -> float:
    values = condition.values(np.array([q_a, q_b]))
    return float(condition.lower_bounds(values[:1], values[1:], (q_b - q_a)[None, :], travel)[0])


# --- margins ------------------------------------------------------------------------


def test_the_margins_of_a_pitch_are_its_distances_from_the_ends_of_the_band(backhoe: bp.Robot) -> None:
    """The backhoe's pitch is boom + stick + bucket: here -2.1, 0.1 above the lower end of the band."""
    q = np.array([0.4, 0.4, -1.6, -0.9])
    band = keep_of(backhoe, pitch=[-2.2, -1.8])
    assert sorted(band.margins(q)) == pytest.approx([0.1, 0.3], abs=1e-12)
    assert band.holds(q)
    assert not band.holds(q - np.array([0.0, 0.2, 0.0, 0.0]))
    np.testing.assert_allclose(band.gradients(q), [[0, 1, 1, 1], [0, -1, -1, -1]], atol=1e-12)


def test_a_band_of_pitch_may_pass_pi(backhoe: bp.Robot) -> None:
    """-3.3 rad and 2.98 rad are the same pitch."""
    q = np.array([0.0, -0.5, -1.0, -1.8])
    for pitch in ([-3.4, -2.6], [-3.4 + 2 * np.pi, -2.6 + 2 * np.pi]):
        assert np.min(keep_of(backhoe, pitch=pitch).margins(q)) == pytest.approx(0.1, abs=1e-12)


def test_heights_are_those_of_the_tip(backhoe: bp.Robot) -> None:
    q = np.array([0.4, 0.4, -1.6, -0.9])
    z = float(bp.Kinematics(backhoe).at(q).tip_position[2])
    assert keep_of(backhoe, above=z - 0.3).margins(q) == pytest.approx([0.3], abs=1e-12)
    assert keep_of(backhoe, below=z - 0.3).margins(q) == pytest.approx([-0.3], abs=1e-12)


def test_a_rotation_is_measured_as_one_angle(ur5: bp.Robot) -> None:
    q = ur5.random_q(np.random.default_rng(3))
    tip = bp.Kinematics(ur5).at(q).tip_rotation
    asked = pin.Quaternion(pin.exp3(np.array([0.0, 0.15, -0.2])) @ tip)
    quaternion = [asked.w, asked.x, asked.y, asked.z]
    margins = keep_of(ur5, rotation={"quaternion": quaternion, "tolerance": 0.4}).margins(q)
    assert margins == pytest.approx([0.15], abs=1e-9)  # 0.4 - hypot(0.15, 0.2)


@pytest.mark.parametrize(
    "keep", [{"pitch": [-3.0, 2.0]}, {"above": 0.4}, {"below": 0.4}, {"rotation": LEVEL}, {"tilt": CUP}]
)
def test_gradients_equal_central_differences(backhoe: bp.Robot, ur5: bp.Robot, keep: Data) -> None:
    robot = backhoe if "pitch" in keep else ur5
    kept, rng, h = keep_of(robot, **keep), np.random.default_rng(0), 1e-6
    for _ in range(20):
        q = robot.random_q(rng)
        for joint, step in enumerate(h * np.eye(robot.n)):
            slope = (kept.margins(q + step) - kept.margins(q - step)) / (2.0 * h)
            np.testing.assert_allclose(kept.gradients(q)[:, joint], slope, atol=1e-6)


def test_a_tilt_is_measured_as_one_angle_whatever_the_heading(ur5: bp.Robot) -> None:
    """A turn by 0.25 rad about a horizontal axis, after any heading and before any spin about the axis."""
    q = ur5.random_q(np.random.default_rng(3))
    tip = bp.Kinematics(ur5).at(q).tip_rotation
    lean = pin.exp3(0.25 * np.array([0.6, 0.8, 0.0]))
    for heading, spin in ((0.0, 0.0), (1.0, 2.0), (np.pi, -1.0)):
        upright = pin.exp3(np.array([0.0, 0.0, heading])) @ lean @ pin.exp3(np.array([0.0, 0.0, spin]))
        up, direction = np.array([0.0, 0.0, 1.0]), tip @ upright.T @ np.array([0.0, 0.0, 2.0])
        keep = keep_of(ur5, tilt={"axis": up.tolist(), "direction": direction.tolist(), "tolerance": 0.4})
        assert keep.margins(q) == pytest.approx([0.4 - 0.25], abs=1e-9)


def test_joints_that_only_turn_about_the_direction_or_the_axis_change_no_tilt(panda: bp.Robot) -> None:
    """The first hinge of the arm is vertical, and the last one turns the hand about its z axis."""
    hand = condition_of(panda, tilt={"tolerance": 0.3})
    assert hand.lever(np.ones(7)).tolist() == [0, 1, 1, 1, 1, 1, 0]
    assert condition_of(panda, tilt={"axis": [1, 0, 0], "tolerance": 0.3}).lever(np.ones(7)).tolist()[-1] == 1
    q = panda.random_q(np.random.default_rng(0))
    turned = q + np.array([1.0, 0, 0, 0, 0, 0, 2.0])
    assert hand.values(turned[None])[0] == pytest.approx(hand.values(q[None])[0], abs=1e-12)
    kept = keep_of(panda, tilt={"tolerance": float(hand.values(q[None])[0]) + 1e-5})
    assert kept.segment_holds(q, turned)
    assert kept.corner_holds(q, q, turned, sagitta=np.eye(7)[0])


def test_a_tilt_at_half_a_turn_has_a_gradient_that_leads_away(ur5: bp.Robot) -> None:
    """Upside down exactly, a projection does not stay where it is."""
    q = np.array([0.1, -1.2, 1.0, -0.7, 0.4, 0.3])
    down = -bp.Kinematics(ur5).at(q).tip_rotation[:, 0]
    kept = keep_of(ur5, tilt={"axis": [1, 0, 0], "direction": down.tolist(), "tolerance": 0.2})
    assert kept.margins(q) == pytest.approx([0.2 - np.pi], abs=1e-7)
    found = kept.project(q, ur5.limits.lower, ur5.limits.upper)
    assert found is not None
    assert kept.holds(found)


def test_a_tilt_is_widened_and_narrowed_by_angles(ur5: bp.Robot) -> None:
    q = ur5.random_q(np.random.default_rng(3))
    tilted = float(condition_of(ur5, tilt={"tolerance": 0.5}).values(q[None])[0])
    assert 0.1 < tilted < 3.0
    wide, tight = keep_of(ur5, tilt={"tolerance": tilted + 0.1}), keep_of(ur5, tilt={"tolerance": tilted - 0.1})
    narrower = wide.with_narrower_cone(0.04)
    assert narrower is not None
    assert narrower.margins(q) == pytest.approx([0.06], abs=1e-9)
    assert wide.with_narrower_cone(0.6 * (tilted + 0.1)) is None  # most of it
    assert tight.margins(q) == pytest.approx([-0.1], abs=1e-9)
    assert tight.widened(q).margins(q) == pytest.approx([0.0], abs=2e-6)


def test_a_tilt_is_widened_beyond_half_a_turn_by_what_the_tracking_error_needs(panda: bp.Robot) -> None:
    """Five joints change the tilt of the hand, by 0.01 rad each at most: it is pi beyond what is left of 0.1 rad."""
    q = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 1.9, 0.8])
    axis = -bp.Kinematics(panda).at(q).tip_rotation[2]  # it points straight down
    tilt = {"axis": axis.tolist(), "tolerance": 0.1}
    task = {"goal": {"joints": dict(zip(panda.joint_names, q.tolist(), strict=True))}, "keep": {"tilt": tilt}}
    content = {"version": 1, "tip": "panda_hand_tcp", "start": task["goal"], "task": task}
    for tracking, joints in (({}, 0.0), ({"tracking": {"joints": 0.01}}, 0.05)):
        keep = build_problem(panda, bp.scene_from_dict(content | tracking)).keep
        assert keep is not None
        (margin,) = keep.margins(q)
        assert margin == pytest.approx(0.1 - np.pi - joints, abs=1e-6)
        assert keep.widened(q).margins(q) == pytest.approx([0.0], abs=2e-6)
        assert keep.widened(q).narrowed(bp.TipTarget(np.zeros(3))) is not None


def test_the_tracking_error_of_all_joints_of_the_pitch_is_deducted(backhoe: bp.Robot) -> None:
    """Three joints change the pitch, by 0.01 rad each at most."""
    q = dict(zip(backhoe.joint_names, [0.0, 0.4, -1.6, -0.9], strict=True))
    task = {"goal": {"joints": q}, "keep": {"pitch": [-2.2, -1.8]}}
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": q}, "task": task, "tracking": {"joints": 0.01}})
    keep = build_problem(backhoe, scene).keep
    assert keep is not None
    assert min(keep.margins(np.array(list(q.values())))) == pytest.approx(0.1 - 0.03, abs=1e-12)


# --- between two configurations ---------------------------------------------------------


def test_the_bound_of_the_pitch_on_straight_motions_is_exact(backhoe: bp.Robot) -> None:
    band, rng = condition_of(backhoe, pitch=[-2.5, -0.5]), np.random.default_rng(1)
    for _ in range(100):
        q_a, q_b = backhoe.random_q(rng), backhoe.random_q(rng)
        bound, least = bound_between(band, q_a, q_b, np.ones(4)), least_between(band, q_a, q_b)
        if least > -1.0:  # it does not pass pi
            assert bound == pytest.approx(least, abs=1e-9)
        assert bound <= least + 1e-9


@pytest.mark.parametrize(
    "keep", [{"above": 0.4}, {"below": 0.4}, {"rotation": LEVEL}, {"tilt": CUP}, {"tilt": {"tolerance": 1.2}}]
)
@pytest.mark.parametrize("size", [1.0, 0.1])
def test_no_margin_between_two_configurations_is_below_the_bound(any_robot: bp.Robot, keep: Data, size: float) -> None:
    condition, rng = condition_of(any_robot, **keep), np.random.default_rng(2)
    travel = tip_travel_bound(any_robot)
    for _ in range(50):
        q_a = any_robot.random_q(rng)
        q_b = q_a + size * (any_robot.random_q(rng) - q_a)
        bound, least = bound_between(condition, q_a, q_b, travel), least_between(condition, q_a, q_b)
        assert bound <= least + 1e-9
        if size < 1.0:  # and the bound is tight to second order in the length of the motion
            assert least - bound < 6.0 * float(np.sum(np.abs(q_b - q_a))) ** 2 + 1e-9


@pytest.mark.parametrize(("part", "holds"), [(0.0, True), (0.98, True), (1.02, False)])
def test_a_rounded_corner_leaves_room_for_joints_that_are_off_it(backhoe: bp.Robot, part: float, holds: bool) -> None:
    """A swing 5 cm above a height: the boom may be off by as much as lowers the tip by 5 cm at its greatest reach."""
    q, swing = np.array([0.0, 0.4, -1.6, -0.9]), np.array([0.3, 0.0, 0.0, 0.0])
    height = float(bp.Kinematics(backhoe).at(q).tip_position[2])
    keep = keep_of(backhoe, above=height - 0.05)
    sagitta = np.array([0.5, part * 0.05 / tip_travel_bound(backhoe)[1], 0.0, 0.0])
    assert keep.corner_holds(q, q + swing, q + 2.0 * swing, sagitta=sagitta) is holds


def test_the_bound_of_a_rotation_equals_a_hand_calculation(ur5: bp.Robot) -> None:
    """max(e_a, e_b) + K / 4 with K = sum_{i<j} |dq_i| |dq_j|, or (e_a + e_b + L) / 2 if that is less, or L is long."""
    cone = condition_of(ur5, rotation={"rpy": [0.0, 0.0, 0.0], "tolerance": 2.0})
    delta = np.zeros((3, 6))
    delta[0, :3] = 0.3, -0.2, 0.1  # K = 0.06 + 0.03 + 0.02, L = 0.6
    delta[1, :2] = 1.0, -2.2  # L = 3.2, more than half a turn
    delta[2, 3:5] = 0.8, 0.9  # K = 0.72, L = 1.7: 1.5 + 0.18 is more than a quarter turn
    before, after = np.array([0.1, 0.1, 0.2]), np.array([0.4, 0.5, 1.5])
    worst = np.array([0.4 + 0.25 * 0.11, 0.5 * (0.1 + 0.5 + 3.2), 0.5 * (0.2 + 1.5 + 1.7)])
    np.testing.assert_allclose(cone.lower_bounds(before, after, delta, np.ones(6)), 2.0 - worst, atol=1e-12)


def test_the_bound_of_a_tilt_equals_a_hand_calculation(ur5: bp.Robot) -> None:
    """asin(max sin e + L^2 / 8), acos(min cos e - L^2 / 8) or (e_a + e_b + L) / 2, the least; the swing does not count.

    The first bound needs that the last one is below a quarter turn.
    """
    cone = condition_of(ur5, tilt={"axis": [1, 0, 0], "tolerance": 2.0})
    delta = np.zeros((4, 6))
    delta[:, 0] = 2.0
    delta[0, 1:3] = 0.1, -0.1
    delta[1:3, 3] = 0.4
    delta[3, 4] = 0.01
    before, after = np.array([0.1, 1.4, 1.5, 0.0]), np.array([0.2, 1.3, 1.6, 0.0])
    worst = np.array(
        [np.arcsin(np.sin(0.2) + 0.005), np.arccos(np.cos(1.4) - 0.02), np.arccos(np.cos(1.6) - 0.02), 0.0]
    )
    worst[3] = 0.01**2 / 8.0
    np.testing.assert_allclose(cone.lower_bounds(before, after, delta, np.ones(6)), 2.0 - worst, atol=1e-9)


GIMBAL = """<robot name="gimbal"><link name="base"/><link name="ring"/><link name="yoke"/>
<link name="tool"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="pan" type="revolute"><parent link="base"/><child link="ring"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="roll" type="revolute"><parent link="ring"/><child link="yoke"/><axis xyz="1 0 0"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="spin" type="revolute"><parent link="yoke"/><child link="tool"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize(("turn", "asked"), [(0.6, 1.3), (0.3, 1.45), (0.1, 0.8)])
def test_the_bound_of_a_rotation_includes_that_its_axis_turns(tmp_path: Path, turn: float, asked: float) -> None:
    """Pan, roll and spin by t, t and -t: the tool rolls by t about an axis that is panned by t.

    At both ends, t = -turn / 2 and turn / 2, it is turned by some turn^2 / 4 about y as well, in the middle not at all.
    So the middle is further than both ends from an orientation that is turned by `asked` about y.
    """
    file = tmp_path / "gimbal.urdf"
    file.write_text(GIMBAL)
    robot = bp.load_robot(file, tip="tool")
    cone = condition_of(robot, rotation={"rpy": [0.0, asked, 0.0], "tolerance": 2.0})
    end = 0.5 * turn * np.array([1.0, 1.0, -1.0])
    ends, middle = cone.values(np.array([-end, end])), cone.values(np.zeros((1, 3)))
    assert middle[0] == pytest.approx(asked, abs=1e-12)
    assert middle[0] - np.max(ends) > 0.08 * turn**2
    assert bound_between(cone, -end, end, tip_travel_bound(robot)) <= 2.0 - asked + 1e-12


def test_a_swing_changes_no_height(backhoe: bp.Robot) -> None:
    height = condition_of(backhoe, above=-5.0)
    q = np.array([-1.5, 0.4, -1.6, -0.9])
    bound = bound_between(height, q, q + np.array([3.0, 0.0, 0.0, 0.0]), tip_travel_bound(backhoe))
    assert bound == pytest.approx(least_between(height, q, q), abs=1e-12)


TILTED = """<robot name="tilted"><link name="base"/><link name="mast"/>
<link name="arm"><collision><geometry><sphere radius="0.01"/></geometry></collision></link><link name="tip"/>
<joint name="tilt" type="revolute"><parent link="base"/><child link="mast"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="pan" type="revolute"><parent link="mast"/><child link="arm"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="1 0 0"/></joint></robot>"""


def test_a_hinge_that_is_vertical_only_until_another_tilts_it_changes_heights(tmp_path: Path) -> None:
    """Tilted by a quarter turn, the tip is at -cos(pan): -0.878 m at both ends, -1 m between them."""
    file = tmp_path / "tilted.urdf"
    file.write_text(TILTED)
    robot = bp.load_robot(file, tip="tip")
    height = condition_of(robot, above=-0.9)
    q_a, q_b = np.array([0.5 * np.pi, -0.5]), np.array([0.5 * np.pi, 0.5])
    assert least_between(height, q_a, q_b) == pytest.approx(-0.1, abs=1e-9)
    assert bound_between(height, q_a, q_b, tip_travel_bound(robot)) <= -0.1


def test_a_whole_turn_of_the_wrist_between_equal_orientations_breaks_a_rotation(ur5: bp.Robot) -> None:
    q = np.array([0.1, -1.2, 1.0, -0.7, 0.4, -np.pi])
    at = pin.Quaternion(bp.Kinematics(ur5).at(q).tip_rotation)
    kept = keep_of(ur5, rotation={"quaternion": [at.w, at.x, at.y, at.z], "tolerance": 0.3})
    turned = q + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * np.pi])
    assert kept.holds(q)
    assert kept.holds(turned)
    assert not kept.segment_holds(q, turned)
    assert kept.segment_holds(q, q + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.29]))
    assert not kept.segment_holds(q, q + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.31]))


def test_an_arc_over_a_height_breaks_it_though_both_ends_keep_it(ur5: bp.Robot) -> None:
    """The shoulder swings the straight arm over the top; the ends are lower by r (1 - cos 0.5)."""
    over = np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    before, after = over - np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0]), over + np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    z = [float(bp.Kinematics(ur5).at(q).tip_position[2]) for q in (before, over, after)]
    assert z[1] > max(z[0], z[2]) + 0.05
    limit = 0.5 * (z[1] + max(z[0], z[2]))
    kept = keep_of(ur5, below=limit)
    assert kept.holds(before)
    assert kept.holds(after)
    assert not kept.segment_holds(before, after)
    assert keep_of(ur5, below=z[1] + 0.01).segment_holds(before, after)


def test_a_pitch_that_leaves_the_band_between_two_ends_is_not_kept(backhoe: bp.Robot) -> None:
    """From -5.0 to 1.1 the pitch passes all values between them, though -5.0 equals 1.283."""
    low, high = np.array([0.0, -0.5, -2.2, -2.3]), np.array([0.0, 0.75, -0.2, 0.55])
    kept = keep_of(backhoe, pitch=[1.0, 1.4])
    assert kept.holds(low)
    assert kept.holds(high)
    assert not kept.segment_holds(low, high)


def test_a_rounded_corner_is_kept_only_if_its_tangents_keep_the_band(backhoe: bp.Robot) -> None:
    q_a, q_b = np.array([0.0, 0.4, -1.6, -0.9]), np.array([0.6, 0.4, -1.6, -0.9])
    inside, outside = np.array([0.3, 0.45, -1.6, -0.9]), np.array([0.3, 0.55, -1.6, -0.9])
    kept = keep_of(backhoe, pitch=[-2.2, -2.0])
    still = np.zeros(4)
    assert kept.corner_holds(q_a, inside, q_b, sagitta=still)
    assert not kept.corner_holds(q_a, outside, q_b, sagitta=still)
    z = float(bp.Kinematics(backhoe).at(q_a).tip_position[2])
    assert keep_of(backhoe, above=z - 1e-3).corner_holds(q_a, inside, q_b, sagitta=still)
    assert not keep_of(backhoe, below=z + 1e-3).corner_holds(q_a, inside, q_b, sagitta=still)


@pytest.mark.parametrize(("tolerance", "holds"), [(0.26, True), (0.24, False)])
def test_a_corner_to_and_fro_is_rounded_halfway_to_it(ur5: bp.Robot, tolerance: float, holds: bool) -> None:
    """From q to a corner 0.5 rad away and back: the wrist turns by t - t^2, at most by 0.25 rad."""
    q, spin = np.array([0.1, -1.2, 1.0, -0.7, 0.4, 0.0]), np.eye(6)[5]
    at = pin.Quaternion(bp.Kinematics(ur5).at(q).tip_rotation)
    kept = keep_of(ur5, rotation={"quaternion": [at.w, at.x, at.y, at.z], "tolerance": tolerance})
    assert kept.corner_holds(q, q + 0.5 * spin, q, sagitta=np.zeros(6)) is holds


@pytest.mark.parametrize(("first", "second"), [(0.34, 0.34), (0.5, 0.18), (0.18, 0.5)])
@pytest.mark.parametrize("tolerance", [3.0, 3.14])
def test_a_rounded_corner_past_the_opposite_orientation_breaks_a_wide_cone(
    ur5: bp.Robot, first: float, second: float, tolerance: float
) -> None:
    """The wrist turns by 0.68 rad from 2.8 rad off, through half a turn, which no cone allows, to 2.8 rad off."""
    q, spin = np.array([0.1, -1.2, 1.0, -0.7, 0.4, 0.0]), np.eye(6)[5]
    at = pin.Quaternion(bp.Kinematics(ur5).at(q).tip_rotation)
    kept = keep_of(ur5, rotation={"quaternion": [at.w, at.x, at.y, at.z], "tolerance": tolerance})
    begin, corner = q + (np.pi - 0.34) * spin, q + (np.pi - 0.34 + first) * spin
    end = corner + second * spin
    assert kept.holds(begin)
    assert kept.holds(end)
    assert not kept.corner_holds(begin, corner, end, sagitta=np.zeros(6))


# --- targets ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "common"),
    [
        (None, (-3.4, -2.6)),
        ((-3.0, 0.0), (-3.0, -2.6)),
        ((2.0, 3.5), (-3.4, 3.5 - 2.0 * np.pi)),
        ((-1.0, 1.0), None),
    ],
)
def test_the_pitch_range_of_a_goal_is_cut_to_the_band(
    backhoe: bp.Robot, asked: tuple[float, float] | None, common: tuple[float, float] | None
) -> None:
    """2.0 to 3.5 rad equal -4.28 to -2.78 rad."""
    found = keep_of(backhoe, pitch=[-3.4, -2.6]).narrowed(bp.TipTarget(np.ones(3), pitch=asked))
    if common is None:
        assert found is None
    else:
        assert found is not None
        assert found.pitch == pytest.approx(common)


# --- the scene --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keep", "said"),
    [
        ({}, "at least one of pitch, above, below, rotation, tilt"),
        ({"pitch": [0.3, 0.0]}, "reversed"),
        ({"pitch": [0.0, 20.0]}, "looks like degrees"),
        ({"pitch": [-3.2, 3.2]}, "a whole turn keeps nothing"),
        ({"pitch": 0.3}, "task.keep.pitch"),
        ({"above": 2.0, "below": 1.0}, "no height is above 2 and below 1"),
        ({"rotation": {"rpy": [0, 0, 0]}}, "task.keep.rotation.tolerance: is missing"),
        ({"rotation": {"tolerance": 0.1}}, "exactly one of rpy, quaternion"),
        ({"tilt": {}}, "task.keep.tilt.tolerance: is missing"),
        ({"tilt": {"tolerance": 0.0}}, r"task.keep.tilt.tolerance: .*greater than 0"),
        ({"tilt": {"tolerance": 5}}, "5 degrees are 0.08727 rad"),
        ({"tilt": {"tolerance": float("nan")}}, "task.keep.tilt.tolerance"),
        (
            {"tilt": {"tolerance": 0.1, "axis": [0, 0, 0]}},
            r"task.keep.tilt.axis: a vector of length 0 has no direction",
        ),
        ({"tilt": {"tolerance": 0.1, "direction": [0, 0]}}, "task.keep.tilt.direction"),
        ({"tilt": {"tolerance": 0.1, "axes": [0, 0, 1]}}, r"task.keep.tilt.axes: there is no such key.*axis"),
        ({"hight": 2.0}, "there is no such key"),
    ],
)
def test_errors_in_keep_name_the_key(keep: Data, said: str) -> None:
    content = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [1, 2, 3]}, "keep": keep}}
    with pytest.raises(bp.SceneError, match=said):
        bp.scene_from_dict(content)


def test_a_machine_without_a_pitch_cannot_keep_one(ur5: bp.Robot) -> None:
    with pytest.raises(bp.SceneError, match=r"task.keep.pitch.*pitch is not defined"):
        keep_of(ur5, pitch=[0.0, 0.3])


def test_an_angle_in_a_narrow_cone_is_told_with_a_tenth_of_the_cone(panda: bp.Robot) -> None:
    """0.0005 rad are 0.02865 degrees, of which 0.0004 rad are 0.0229; in a wide cone one digit is enough."""
    axis, up = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
    narrow, wide = (TiltCone(panda, Tilt(axis, up, one)) for one in (0.0005, 0.1))
    assert narrow.describe(0.0004, " at 1.00 s") == "the tip is tilted by 0.023 deg at 1.00 s, allowed 0.02865 deg"
    assert wide.describe(0.05) == "the tip is tilted by 2.9 deg, allowed 5.73 deg"
