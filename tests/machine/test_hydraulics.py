"""Cylinders and pump: hand calculations, virtual work, both directions of every map, and bad files."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import backhoe_planner as bp
from backhoe_planner.arrays import Array
from backhoe_planner.cli import main
from backhoe_planner.files.yaml_text import read_yaml
from backhoe_planner.machine import Dynamics, FourBar, Hydraulics, HydraulicsRecord, Triangle, digging_forces
from backhoe_planner.planning import export_plan

Data = dict[str, Any]

ROOT = Path(__file__).resolve().parents[2]
DESCRIPTION = ROOT / "models" / "backhoe.hydraulics.yaml"
PUBLISHED = {"bucket": 65.4e3, "stick": 38.2e3}  # N, CAT 420D, dealer sheet


@pytest.fixture(scope="module")
def hydraulics(backhoe: bp.Robot) -> Hydraulics:
    assert backhoe.hydraulics is not None
    return backhoe.hydraulics


@pytest.fixture(scope="module")
def postures(backhoe: bp.Robot) -> Array:
    """(500, 4) configurations within the limits of the URDF, corners included."""
    rng = np.random.default_rng(11)
    drawn = rng.uniform(backhoe.limits.lower, backhoe.limits.upper, (484, 4))
    corners = np.array(np.meshgrid(*np.column_stack((backhoe.limits.lower, backhoe.limits.upper)))).reshape(4, -1).T
    return np.vstack((drawn, corners))


def content() -> Data:
    return copy.deepcopy(read_yaml(DESCRIPTION)[0])


def load(folder: Path, data: Data | str, urdf: str = "example:backhoe", *, tip: str | None = None) -> bp.Robot:
    file = folder / "own.yaml"
    file.write_text(data if isinstance(data, str) else yaml.safe_dump(data), encoding="utf-8")
    return bp.load_robot(urdf, tip=tip, hydraulics=file)


# --- one hinge, with numbers for hand calculations ------------------------------------

HINGE = """<robot name="hinge">
  <link name="post"/>
  <link name="arm"><inertial><origin xyz="1 0 0"/><mass value="{mass}"/>
    <inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="end"/>
  <joint name="hinge" type="{kind}"><origin xyz="0 0 2" rpy="0 0 0.3"/><parent link="post"/><child link="arm"/>
    <axis xyz="0 -1 0"/><limit lower="{lower}" upper="{upper}" velocity="1" effort="1e4"/></joint>
  <joint name="tool" type="fixed"><origin xyz="2 0 0"/><parent link="arm"/><child link="end"/></joint>
</robot>"""
# 0.3 m below the hinge and 0.4 m out along the arm: a right angle at q = 0, 3-4-5
RIGHT: Data = {
    "version": 1,
    "pump": {"flow": 1e-3, "pressure": 2e7},
    "engine": {"power": 2e4, "efficiency": 0.5},
    "cylinders": [
        {"name": "ram", "joint": "hinge", "bore": 0.1, "rod": 0.06, "closed": 0.3, "open": 0.62,
         "parent": [0.0, 0.0, 1.7], "child": [0.4, 0.0, 0.0]},
    ],
}  # fmt: skip


def hinge(folder: Path, data: Data = RIGHT, **joint: Any) -> bp.Robot:
    text = HINGE.format(**({"kind": "revolute", "lower": -0.7, "upper": 0.55, "mass": 1.0} | joint))
    (folder / "hinge.urdf").write_text(text, encoding="utf-8")
    (folder / "hinge.hydraulics.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    return bp.load_robot(folder / "hinge.urdf", tip="end")


def test_a_cylinder_in_a_right_triangle_by_hand(tmp_path: Path) -> None:
    found = hinge(tmp_path).hydraulics
    assert found is not None
    level = np.zeros(1)
    cap, annulus = math.pi / 4.0 * 0.1**2, math.pi / 4.0 * (0.1**2 - 0.06**2)
    assert found.lengths(level) == pytest.approx([0.5])
    # the lever is the height of the 3-4-5 triangle over its hypotenuse
    assert found.moment_arms(level) == pytest.approx(np.array([[0.24]]))
    assert found.rod_speeds(level, np.array([0.5])) == pytest.approx([0.12])
    assert found.flows(level, np.array([0.5])) == pytest.approx([0.12 * cap])
    assert found.flows(level, np.array([-0.5])) == pytest.approx([0.12 * annulus])
    assert found.joint_torques(level, np.array([1e4])) == pytest.approx([2400.0])
    assert found.cylinder_forces(level, np.array([-2400.0])) == pytest.approx([-1e4])
    assert found.pressures(level, np.array([2400.0])) == pytest.approx([1e4 / cap])
    assert found.pressures(level, np.array([-2400.0])) == pytest.approx([1e4 / annulus])
    torque, rate = found.torque_limits(level), found.velocity_limits(level)
    assert torque.positive == pytest.approx([2e7 * cap * 0.24])
    assert torque.negative == pytest.approx([2e7 * annulus * 0.24])
    assert rate.positive == pytest.approx([1e-3 / cap / 0.24])
    assert rate.negative == pytest.approx([1e-3 / annulus / 0.24])
    assert found.power_limit == pytest.approx(1e4)
    # law of cosines with 62 cm, and with 30 cm
    wide = math.acos((0.09 + 0.16 - 0.62**2) / 0.24) - math.pi / 2.0
    tight = math.acos((0.09 + 0.16 - 0.3**2) / 0.24) - math.pi / 2.0
    assert found.joint_range("hinge") == pytest.approx((tight, wide))
    assert found.joints(np.array([[0.5], [0.62], [0.3]])) == pytest.approx(np.array([[0.0], [wide], [tight]]))


def test_pins_offset_along_the_joint_axis_lengthen_the_cylinder(tmp_path: Path) -> None:
    data = copy.deepcopy(RIGHT)
    # along the axis, which the joint's origin turns by 0.3 rad about z
    data["cylinders"][0]["parent"] = [0.12 * math.sin(0.3), -0.12 * math.cos(0.3), 1.7]
    data["cylinders"][0]["open"] = 0.63
    found = hinge(tmp_path, data).hydraulics
    assert found is not None
    assert found.lengths(np.zeros(1)) == pytest.approx([math.sqrt(0.25 + 0.12**2)])


def test_power_counts_only_motion_against_the_load(tmp_path: Path) -> None:
    found = hinge(tmp_path).hydraulics
    assert found is not None
    q, v, tau = np.zeros(1), np.array([0.5]), np.array([2400.0])
    assert found.power(q, v, tau) == pytest.approx(1200.0)
    assert found.power(q, -v, tau) == 0.0
    assert found.load_sensing_power(q, v, tau) == pytest.approx(1200.0)


def test_a_joint_that_moves_by_rounding_alone_needs_no_pressure(backhoe: bp.Robot) -> None:
    """The boom under 30 kN m while the swing turns: at rest the swing's pressure suffices, and at 1 nrad/s not."""
    hydraulics = backhoe.hydraulics
    assert hydraulics is not None
    q, tau = np.array([0.2, 0.4, -1.2, -0.5]), np.array([1e3, 30e3, 0.0, 0.0])
    rest, rounding, creep = (np.array([0.3, speed, 0.0, 0.0]) for speed in (0.0, 1e-14, 2e-9))
    power = hydraulics.load_sensing_power(q, rest, tau)
    assert power == pytest.approx(np.max(hydraulics.pressures(q, tau)[:2]) * hydraulics.total_flow(q, rest))
    assert hydraulics.load_sensing_power(q, rounding, tau) == power
    assert hydraulics.load_sensing_power(q, creep, tau) > 2.0 * power


# --- four-bar -----------------------------------------------------------------------


def parallelogram() -> FourBar:
    """Rocker and joint pin of 0.3 m each, 1 m apart, link of 1 m: the rocker turns by the joint angle."""
    drive = Triangle(0.8, 0.3, math.radians(-150.0))
    return FourBar((-1.0, 0.0), rocker=0.3, link=1.0, pin=0.3, pin_angle=0.0, side=1.0, drive=drive)


def test_in_a_parallelogram_the_rocker_turns_by_the_joint_angle() -> None:
    bar = parallelogram()
    q = np.linspace(0.3, 2.8, 60)
    np.testing.assert_allclose(bar.rocker_angle(q), q, atol=1e-9)
    np.testing.assert_allclose(bar.length(q), bar.drive.length(q), atol=1e-9)
    np.testing.assert_allclose(bar.arm(q), bar.drive.arm(q), atol=1e-9)


def test_in_a_parallelogram_the_moment_arm_changes_as_that_of_its_triangle() -> None:
    bar = parallelogram()
    q = np.linspace(0.3, 2.8, 60)
    np.testing.assert_allclose(bar.arm_slope(q), bar.drive.arm_slope(q), atol=1e-9)


def test_slopes_of_moment_arms_equal_central_differences(hydraulics: Hydraulics, postures: Array) -> None:
    step = 1e-6
    differences = np.empty((len(postures), len(hydraulics.cylinders)))
    for column, (cylinder, joint) in enumerate(zip(hydraulics.cylinders, hydraulics.joint_of, strict=True)):
        angle = postures[:, joint]
        sides = cylinder.linkage.arm(angle + step), cylinder.linkage.arm(angle - step)
        differences[:, column] = (sides[0] - sides[1]) / (2.0 * step)
    np.testing.assert_allclose(hydraulics.arm_slopes(postures), differences, rtol=1e-6, atol=1e-8)


def bucket_bar(hydraulics: Hydraulics) -> FourBar:
    linkage = hydraulics.cylinders[-1].linkage
    assert isinstance(linkage, FourBar)
    return linkage


def test_the_four_bar_of_the_bucket_is_closed_everywhere(hydraulics: Hydraulics) -> None:
    bar = bucket_bar(hydraulics)
    q = np.linspace(*hydraulics.joint_range("bucket"), 1001)
    R, B = bar.rocker_pin(q), bar.joint_pin(q)
    np.testing.assert_allclose(np.linalg.norm(R - B, axis=1), bar.link, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(R - np.array(bar.pivot), axis=1), bar.rocker, atol=1e-12)
    # the rocker angle is smooth: no jump to another branch
    assert np.max(np.abs(np.diff(bar.rocker_angle(q)))) < 0.01


def test_the_four_bar_passes_through_the_pins_of_the_file(hydraulics: Hydraulics) -> None:
    """With the joint at 0 the pins are where the file draws them: x from the bucket's pin outward, z up."""
    spec = content()["cylinders"][-1]
    bar, still = bucket_bar(hydraulics), np.zeros(())
    np.testing.assert_allclose(bar.rocker_pin(still), [1.395 - 1.8, 0.383], atol=1e-12)
    np.testing.assert_allclose(bar.joint_pin(still), [0.068, 0.278], atol=1e-12)
    length = np.linalg.norm(np.array(spec["rocker"]["cylinder"]) - spec["parent"])
    np.testing.assert_allclose(hydraulics.lengths(np.zeros(4))[-1], length, atol=1e-12)


def test_a_machine_with_a_reversed_bucket_axis_moves_the_same(hydraulics: Hydraulics, tmp_path: Path) -> None:
    """With the bucket's axis reversed, the rocker is on the other side of its line of pins."""
    whole = (ROOT / "models" / "backhoe.urdf").read_text(encoding="utf-8")
    begin = whole.index('<joint name="bucket"')
    joint = whole[begin : whole.index("</joint>", begin)]
    turned = joint.replace('"0 -1 0"', '"0 1 0"').replace(
        'lower="-2.7925" upper="0.7854"', 'lower="-0.7854" upper="2.7925"'
    )
    assert turned.count("2.7925") == 1
    (tmp_path / "turned.urdf").write_text(whole.replace(joint, turned), encoding="utf-8")
    again = load(tmp_path, content(), str(tmp_path / "turned.urdf"))
    assert again.hydraulics is not None
    q = np.linspace([-1.5, -1.0, -2.4, -2.7], [1.5, 1.3, -0.2, 0.7], 50)
    np.testing.assert_allclose(again.hydraulics.lengths(q * [1.0, 1.0, 1.0, -1.0]), hydraulics.lengths(q), atol=1e-12)
    np.testing.assert_allclose(
        again.hydraulics.joint_range("bucket"), -np.array(hydraulics.joint_range("bucket"))[::-1]
    )
    found, straight = digging_forces(again), digging_forces(load(tmp_path, content()))
    assert found is not None
    assert straight is not None
    assert (found.bucket, found.stick) == pytest.approx((straight.bucket, straight.stick), rel=1e-6)


@pytest.mark.parametrize("drawn_at", [-1.0, 0.4])
def test_a_rocker_may_be_drawn_at_any_joint_angle(hydraulics: Hydraulics, tmp_path: Path, drawn_at: float) -> None:
    R = bucket_bar(hydraulics).rocker_pin(np.array(drawn_at))  # x outward and z up from the bucket's pin
    moved = [1.8 + float(R[0]), 0.0, float(R[1])]
    data = content()
    data["cylinders"][-1]["rocker"] |= {"link": moved, "cylinder": moved, "drawn_at": drawn_at}
    again = load(tmp_path, data).hydraulics
    assert again is not None
    q = np.linspace([-1.5, -1.0, -2.4, -2.7], [1.5, 1.3, -0.2, 0.7], 50)
    np.testing.assert_allclose(again.lengths(q), hydraulics.lengths(q), atol=1e-9)


# --- consistency ---------------------------------------------------------------------


def test_moment_arms_agree_with_central_differences_of_the_lengths(hydraulics: Hydraulics, postures: Array) -> None:
    step = 1e-6
    for j in range(4):
        move = step * np.eye(4)[j]
        slope = (hydraulics.lengths(postures + move) - hydraulics.lengths(postures - move)) / (2.0 * step)
        np.testing.assert_allclose(hydraulics.moment_arms(postures)[..., j], slope, atol=2e-8)


def test_cached_moment_arms_belong_to_the_same_configurations(hydraulics: Hydraulics, postures: Array) -> None:
    """With more arrays than the cache holds, each changed in place; compared with one configuration at a time."""
    tau = np.linspace(1e3, 2e3, postures.shape[1])
    for _ in range(2):
        for count in range(1, 13):
            q = postures[:count].copy()
            hydraulics.cylinder_forces(q, tau)
            q[0] = postures[-1]
            found = hydraulics.cylinder_forces(q, tau)
            one_by_one = [replace(hydraulics).cylinder_forces(row, tau) for row in q]
            np.testing.assert_array_equal(found, one_by_one)


def test_the_work_of_the_cylinders_equals_that_of_the_joints(hydraulics: Hydraulics, postures: Array) -> None:
    rng = np.random.default_rng(12)
    v, force = rng.normal(size=postures.shape), 1e5 * rng.normal(size=(len(postures), 6))
    done = np.sum(force * hydraulics.rod_speeds(postures, v), axis=1)
    given = np.sum(hydraulics.joint_torques(postures, force) * v, axis=1)
    np.testing.assert_allclose(done, given, rtol=1e-9, atol=1e-9 * np.max(np.abs(done)))
    through_matrix = np.einsum("tmn,tm->tn", hydraulics.moment_arms(postures), force)
    np.testing.assert_allclose(hydraulics.joint_torques(postures, force), through_matrix, rtol=1e-12, atol=1e-6)


def test_cylinder_forces_reproduce_the_torques_with_the_least_norm(hydraulics: Hydraulics, postures: Array) -> None:
    tau = 1e4 * np.random.default_rng(13).normal(size=postures.shape)
    force = hydraulics.cylinder_forces(postures, tau)
    np.testing.assert_allclose(hydraulics.joint_torques(postures, force), tau, rtol=1e-9, atol=1e-6)
    for arm, own, torque in zip(hydraulics.moment_arms(postures)[:50], force, tau, strict=False):
        np.testing.assert_allclose(own, np.linalg.pinv(arm.T) @ torque, rtol=1e-9, atol=1e-4)


def test_lengths_and_joints_are_inverse_maps(hydraulics: Hydraulics, postures: Array) -> None:
    lengths = hydraulics.lengths(postures)
    np.testing.assert_allclose(hydraulics.joints(lengths), postures, atol=1e-9)
    np.testing.assert_allclose(hydraulics.lengths(hydraulics.joints(lengths)), lengths, atol=1e-9)
    for i, cylinder in enumerate(hydraulics.cylinders):  # single cylinders from end to end of the stroke
        if cylinder.joint == "swing":
            continue
        whole = np.tile(lengths[0], (101, 1))
        mine = [k for k, other in enumerate(hydraulics.cylinders) if other.joint == cylinder.joint]
        whole[:, mine] = np.linspace(cylinder.closed, cylinder.open, 101)[:, None]
        np.testing.assert_allclose(hydraulics.lengths(hydraulics.joints(whole))[:, i], whole[:, i], atol=1e-9)


def test_arrays_of_any_shape_are_accepted(hydraulics: Hydraulics, postures: Array) -> None:
    flat, block = postures[:30], postures[:30].reshape(5, 2, 3, 4)
    lengths = hydraulics.lengths(block)
    assert lengths.shape == (5, 2, 3, 6)
    assert hydraulics.moment_arms(block).shape == (5, 2, 3, 6, 4)
    np.testing.assert_allclose(hydraulics.joints(lengths), block, atol=1e-9)
    np.testing.assert_array_equal(hydraulics.power(block, block, block).ravel(), hydraulics.power(flat, flat, flat))
    whole, one = hydraulics.velocity_limits(block).negative, hydraulics.velocity_limits(flat[7]).negative
    np.testing.assert_allclose(whole.reshape(30, 4)[7], one, rtol=1e-12)


def test_lengths_of_no_configuration_give_nan(hydraulics: Hydraulics) -> None:
    lengths = hydraulics.lengths(np.array([0.5, 0.2, -1.0, 0.1]))
    lengths[0] += 0.01  # only the left swing cylinder
    lengths[4] = 3.0
    found = hydraulics.joints(lengths)
    assert np.isnan(found[[0, 2]]).all()
    np.testing.assert_allclose(found[[1, 3]], [0.2, 0.1], atol=1e-9)


def test_the_swing_hydraulics_are_symmetric(hydraulics: Hydraulics) -> None:
    q = np.zeros((91, 4))
    q[:, 0], q[:, 2] = np.linspace(-1.57, 1.57, 91), -1.0
    mirrored = hydraulics.lengths(q * [-1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(hydraulics.lengths(q)[:, 0], mirrored[:, 1], atol=1e-12)
    torque = hydraulics.torque_limits(q)
    np.testing.assert_allclose(torque.positive[:, 0], torque.negative[::-1, 0], rtol=1e-9)
    # the torque falls off towards the ends
    assert torque.positive[[0, -1], 0].max() < 0.55 * torque.positive[45, 0]
    arms = hydraulics.moment_arms(q)[:, :2, 0]
    assert np.all(np.max(np.abs(arms), axis=1) > 0.04)  # one cylinder helps the other over its dead centre
    assert arms[0, 1] * arms[45, 1] < 0.0


def test_rate_and_torque_limits_follow_from_flow_and_pressure(hydraulics: Hydraulics, postures: Array) -> None:
    """At its rate limit a joint uses the full flow of pump or valve, at its torque limit the relief pressure."""
    rate, torque = hydraulics.velocity_limits(postures), hydraulics.torque_limits(postures)
    for j in range(4):
        mine = np.flatnonzero(hydraulics.joint_of == j)
        valves = np.array([hydraulics.cylinders[i].flow for i in mine])
        for sign, limit in ((1.0, rate.positive), (-1.0, rate.negative)):
            v = np.zeros_like(postures)
            v[:, j] = sign * limit[:, j]
            flows = hydraulics.flows(postures, v)[:, mine]
            use = np.maximum(np.max(flows / valves, axis=1), np.sum(flows, axis=1) / hydraulics.pump_flow)
            np.testing.assert_allclose(use, 1.0, rtol=1e-9)
    for j in (2, 3):  # one cylinder each
        tau = np.zeros_like(postures)
        for bound in (torque.positive[:, j], -torque.negative[:, j]):
            tau[:, j] = bound
            np.testing.assert_allclose(hydraulics.pressures(postures, tau)[:, j + 2], hydraulics.pressure, rtol=1e-9)


def test_power_is_the_sum_of_the_positive_joint_powers(hydraulics: Hydraulics, postures: Array) -> None:
    """One cylinder, or two that share the load by least norm, deliver max(tau v, 0) for each joint."""
    rng = np.random.default_rng(14)
    v, tau = rng.normal(size=postures.shape), 1e4 * rng.normal(size=postures.shape)
    expected = np.sum(np.maximum(tau * v, 0.0), axis=1)
    np.testing.assert_allclose(hydraulics.power(postures, v, tau), expected, rtol=1e-9, atol=1e-6)
    assert np.all(hydraulics.load_sensing_power(postures, v, tau) >= expected * (1.0 - 1e-12))


# --- the backhoe ----------------------------------------------------------------------


def test_digging_forces_equal_the_published_ones(backhoe: bp.Robot) -> None:
    found = digging_forces(backhoe)
    assert found is not None
    assert found.bucket == pytest.approx(PUBLISHED["bucket"], rel=0.03)
    assert found.stick == pytest.approx(PUBLISHED["stick"], rel=0.03)


def test_the_digging_force_of_the_bucket_by_virtual_displacement(backhoe: bp.Robot, hydraulics: Hydraulics) -> None:
    """Rod force times rod travel equals digging force times travel of the teeth."""
    found = digging_forces(backhoe)
    assert found is not None
    at = np.array([0.0, 0.0, -1.0, found.bucket_at])
    after = at - [0.0, 0.0, 0.0, 1e-6]
    kinematics = bp.Kinematics(backhoe)
    teeth = np.linalg.norm(kinematics.at(after).tip_position - kinematics.at(at).tip_position)
    rod = hydraulics.lengths(after)[5] - hydraulics.lengths(at)[5]
    push = hydraulics.pressure * math.pi / 4.0 * 0.1016**2
    assert found.bucket == pytest.approx(push * rod / teeth, rel=1e-4)


def test_the_digging_force_of_the_stick_by_virtual_displacement(backhoe: bp.Robot, hydraulics: Hydraulics) -> None:
    found = digging_forces(backhoe)
    assert found is not None
    at = np.array([0.0, 0.0, found.stick_at, found.bucket_at])
    after = at - [0.0, 0.0, 1e-6, 0.0]
    kinematics = bp.Kinematics(backhoe)
    teeth = np.linalg.norm(kinematics.at(after).tip_position - kinematics.at(at).tip_position)
    rod = hydraulics.lengths(after)[4] - hydraulics.lengths(at)[4]
    assert found.stick == pytest.approx(hydraulics.pressure * math.pi / 4.0 * 0.127**2 * rod / teeth, rel=1e-4)


def test_strokes_cover_the_joint_limits_and_at_most_2_degrees_more(backhoe: bp.Robot, hydraulics: Hydraulics) -> None:
    for j, name in enumerate(backhoe.joint_names):
        lower, upper = hydraulics.joint_range(name)
        assert 0.0 <= backhoe.limits.lower[j] - lower < math.radians(2.0)
        assert 0.0 <= upper - backhoe.limits.upper[j] < math.radians(2.0)
    for cylinder in hydraulics.cylinders:
        assert cylinder.stroke < cylinder.closed  # otherwise it could not be built


def test_torque_and_rate_limits_are_of_the_order_of_those_in_the_urdf(
    backhoe: bp.Robot, hydraulics: Hydraulics, postures: Array
) -> None:
    torque, rate = hydraulics.torque_limits(postures), hydraulics.velocity_limits(postures)
    strongest = np.maximum(torque.positive.max(axis=0), torque.negative.max(axis=0))
    typical = np.minimum(np.median(rate.positive, axis=0), np.median(rate.negative, axis=0))
    np.testing.assert_array_less(np.abs(np.log(strongest / backhoe.limits.effort)), math.log(1.5))
    np.testing.assert_array_less(np.abs(np.log(typical / backhoe.limits.velocity)), math.log(1.5))


def test_the_machine_can_hold_its_arm_with_a_full_bucket_everywhere(
    backhoe: bp.Robot, hydraulics: Hydraulics, postures: Array
) -> None:
    dynamics, still = Dynamics(backhoe, payload=380.0), np.zeros(4)
    tau = np.array([dynamics.torques(q, still, still) for q in postures])
    limits = hydraulics.torque_limits(postures)
    assert np.all(tau <= limits.positive)
    assert np.all(tau >= -limits.negative)


def test_a_machine_without_a_description_has_no_hydraulics(planar4: bp.Robot) -> None:
    assert planar4.hydraulics is None
    assert digging_forces(planar4) is None


def test_a_robot_with_another_tip_has_the_cylinders_that_move_it(backhoe: bp.Robot, hydraulics: Hydraulics) -> None:
    on_stick = backhoe.with_tip("stick")
    assert on_stick.hydraulics is not None
    assert on_stick.hydraulics.cylinder_names == hydraulics.cylinder_names[:5]
    q = np.array([0.2, 0.3, -1.0])
    np.testing.assert_array_equal(on_stick.hydraulics.lengths(q), hydraulics.lengths(np.append(q, 0.0))[:5])
    assert on_stick.with_tip("bucket_tip").hydraulics is not None
    assert digging_forces(on_stick) is None  # its tip is on the axis of its last joint


def test_a_joint_without_a_cylinder_has_no_hydraulic_limit(tmp_path: Path) -> None:
    data = content()
    data["cylinders"] = data["cylinders"][2:]  # as if a motor drove the swing
    found = load(tmp_path, data).hydraulics
    assert found is not None
    q = np.array([0.3, 0.2, -1.0, -0.5])
    assert found.torque_limits(q).positive[0] == np.inf
    assert found.velocity_limits(q).negative[0] == np.inf
    assert np.isfinite(found.torque_limits(q).positive[1:]).all()
    assert np.isnan(found.joints(found.lengths(q))[0])
    with pytest.raises(bp.InputError, match=r"no cylinder moves this joint; found swing; allowed: boom, stick, bucket"):
        found.joint_range("swing")


# --- export ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dug(backhoe: bp.Robot) -> bp.Plan:
    start = {"swing": 0.0, "boom": 0.2, "stick": -1.2, "bucket": -0.8}
    task = {"goal": {"position": [4.2, 0.4, 0.6]}}
    found = bp.plan(
        backhoe, bp.scene_from_dict({"version": 1, "start": {"joints": start}, "task": task}), effort="quick"
    )
    assert found.verified, found.message
    return found


def test_exports_contain_cylinder_lengths_speeds_and_flows(
    dug: bp.Plan, hydraulics: Hydraulics, tmp_path: Path
) -> None:
    export_plan(dug, tmp_path / "motion.npz")
    export_plan(dug, tmp_path / "motion.csv")
    motion = dug.trajectory
    with np.load(tmp_path / "motion.npz") as arrays:
        assert arrays["cylinders"].tolist() == list(hydraulics.cylinder_names)
        np.testing.assert_array_equal(arrays["lengths"], hydraulics.lengths(motion.q))
        # rod speeds integrate to the change of length
        change = np.trapezoid(arrays["rod_speeds"], motion.time, axis=0)
        np.testing.assert_allclose(change, arrays["lengths"][-1] - arrays["lengths"][0], atol=2e-4)
        assert np.all(arrays["flows"] >= 0.0)
    header, *rows = (tmp_path / "motion.csv").read_text(encoding="utf-8").splitlines()
    columns = header.split(",")
    assert len(rows) == len(motion)
    assert columns[9:11] == ["swing left.length", "swing right.length"]
    assert columns[columns.index("tip.x") - 1] == "bucket.flow"
    middle = rows[len(rows) // 2].split(",")
    q = np.array([float(middle[columns.index(f"{name}.position")]) for name in dug.robot.joint_names])
    assert float(middle[columns.index("bucket.length")]) == pytest.approx(hydraulics.lengths(q)[5], abs=1e-12)


# --- bad files ----------------------------------------------------------------------------


def cylinder(index: int, **keys: Any) -> Callable[[Data], None]:
    def change(data: Data) -> None:
        data["cylinders"][index] |= keys

    return change


def both(*changes: Callable[[Data], None]) -> Callable[[Data], None]:
    def change(data: Data) -> None:
        for one in changes:
            one(data)

    return change


def at(path: str, value: Any) -> Callable[[Data], None]:
    def change(data: Data) -> None:
        *folders, key = path.split(".")
        for folder in folders:
            data = data[int(folder)] if isinstance(data, list) else data[folder]
        data[key] = value

    return change


BAD: dict[str, tuple[Callable[[Data], None], list[str]]] = {
    "unknown key": (at("pump.flwo", 1.0), ["pump.flwo (line", "did you mean 'flow'", "Allowed: flow, pressure"]),
    "unknown key of a rocker": (at("cylinders.5.rocker.pivto", 1), ["cylinders[5].rocker.pivto", "'pivot'"]),
    "no pump": (lambda data: data.pop("pump"), ["pump: is missing"]),
    "no cylinders": (at("cylinders", []), ["cylinders", "at least 1"]),
    "zero flow": (at("pump.flow", 0), ["pump.flow", "greater than or equal to 0.000000000001", "found 0"]),
    "negative bore": (cylinder(4, bore=-0.1), ["cylinders[4].bore", "greater than or equal to 0.000001", "found -0.1"]),
    "text for a number": (cylinder(4, bore="0.1"), ["cylinders[4].bore", "number", "found '0.1'"]),
    "not finite": (cylinder(4, open=math.inf), ["cylinders[4].open", "finite|less than"]),
    "efficiency over 1": (at("engine.efficiency", 1.2), ["engine.efficiency", "less than or equal to 1", "1.2"]),
    "rod thicker than bore": (cylinder(4, rod=0.2), ["cylinders[4]", "rod", "found 0.2", "allowed: less than 0.127"]),
    "open shorter than closed": (cylinder(4, open=1.0), ["cylinders[4]", "open", "found 1", "allowed: over 1.175"]),
    "same name": (cylinder(4, name="bucket"), ["two cylinders are named 'bucket'"]),
    "unknown joint": (
        cylinder(4, joint="stik"),
        ["cylinders[4].joint (stick)", "did you mean 'stick'", "found stik", "allowed: swing, boom, stick, bucket"],
    ),
    "fixed joint": (
        cylinder(4, joint="bucket_tip_fixed"),
        ["cylinders[4].joint (stick)", "found bucket_tip_fixed, fixed", "allowed: swing"],
    ),
    "no lever": (cylinder(4, child=[0, 0.2, 0]), ["cylinders[4].child (stick)", "no lever"]),
    "link too short to close": (
        at("cylinders.5.rocker.link", [1.85, 0.0, 0.29]),
        ["cylinders[5].rocker (bucket)", "cannot close the four-bar at -160.0 deg", "allowed: closed from -160.0 deg"],
    ),
    "stroke ends too early": (
        cylinder(4, open=1.7),
        ["cylinders[4].open (stick)", "does not reach the joint's limits", "found 1.7", "1.8359 m or more"],
    ),
    "stroke starts too late": (
        cylinder(4, closed=1.3),
        ["cylinders[4].closed (stick)", "does not reach the joint's limits", "found 1.3", "1.1769 m or less"],
    ),
    "longer than the pins allow": (
        cylinder(4, open=2.5),
        [
            "cylinders[4].open (stick)",
            "longer than the greatest possible distance of the pins",
            "found 2.5",
            "1.8799 m or less",
        ],
    ),
    "shorter than the pins allow": (
        cylinder(4, closed=0.9),
        [
            "cylinders[4].closed (stick)",
            "shorter than the least possible distance of the pins",
            "found 0.9",
            "1.1527 m or more",
        ],
    ),
    "dead centre within the limits": (
        cylinder(4, child=[0.3, 0.0, 0.163]),
        ["cylinders[4] (stick)", "dead centre near", "allowed: a lever from -140.0 deg to -10.0 deg"],
    ),
    "dead centre of both of two": (
        both(cylinder(2, child=[0.4, 0.062, -1.1]), cylinder(3, child=[0.4, -0.062, -1.1])),
        ["cylinders[2] (boom left)", "dead centre near"],
    ),
    "bore whose area is 0 in floating-point numbers": (
        cylinder(4, bore=1e-200, rod=1e-201),
        ["cylinders[4].bore", "1e-200"],
    ),
    "flow that no motion is slow enough for": (at("pump.flow", 1e-300), ["pump.flow", "found 1e-300"]),
    "later version": (at("version", 2), ["version", "found 2", "allowed: 1"]),
}


@pytest.mark.parametrize(("change", "said"), BAD.values(), ids=BAD.keys())
def test_errors_in_a_description_name_file_key_found_and_allowed_values(
    change: Callable[[Data], None], said: list[str], tmp_path: Path
) -> None:
    data = content()
    change(data)
    with pytest.raises(bp.RobotError) as caught:
        load(tmp_path, data)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "own.yaml"))
    for fragment in said:
        assert any(either in message for either in fragment.split("|")), message


@pytest.mark.parametrize(
    ("end", "said"),
    [
        # shortest at 45.6 deg, where link and crank line up
        (1.11, r"cylinders\[0\] \(ram\): the linkage passes a dead centre near 45\.\d deg"),
        # no crank angle extends it that far
        (1.13, r"cylinders\[0\] \(ram\): the strokes do not limit the joint at both ends.* found ends at no angle"),
    ],
)
def test_a_stroke_that_passes_a_dead_centre_of_the_rocker_is_refused(tmp_path: Path, end: float, said: str) -> None:
    """A crank of 0.2 m whose rocker only sways: a stroke beyond the sway cannot limit the range."""

    def pin(x: float, z: float) -> list[float]:
        return [x * math.cos(0.3), x * math.sin(0.3), 2.0 + z]

    rod = pin(-0.4225, 0.4674)
    data = copy.deepcopy(RIGHT)
    data["cylinders"][0] |= {"closed": 0.95, "open": end, "parent": pin(-1.2, -0.2), "child": [0.0, 0.0, 0.2]}
    data["cylinders"][0]["rocker"] = {"pivot": pin(-0.6, 0.0), "cylinder": rod, "link": rod}
    with pytest.raises(bp.RobotError, match=said):
        hinge(tmp_path, data)


BAD_TEXT = {
    "": "the file is empty",
    "- 1\n": "does not hold keys and values; allowed: a hydraulic description: version, pump",
    "version: 1\nversion: 1\n": "version: the key stands twice; found line 1 and line 2",
    "version: [1\n": "is not YAML",
}


@pytest.mark.parametrize(("text", "said"), BAD_TEXT.items(), ids=["empty", "list", "twice", "unclosed"])
def test_files_that_are_not_hydraulic_descriptions_are_refused(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(bp.RobotError) as caught:
        load(tmp_path, text)
    assert said in str(caught.value)


def test_a_missing_description_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(bp.RobotError, match=r"none\.yaml: no such hydraulic description file"):
        bp.load_robot("example:backhoe", hydraulics=tmp_path / "none.yaml")


def test_a_joint_without_limits_cannot_have_a_cylinder(tmp_path: Path) -> None:
    with pytest.raises(bp.RobotError, match=r"turns between limits; found hinge, continuous; allowed: none"):
        hinge(tmp_path, kind="continuous")


def test_the_shipped_description_is_beside_the_urdf_and_covers_all_joints(
    backhoe: bp.Robot, hydraulics: Hydraulics
) -> None:
    assert hydraulics.file == DESCRIPTION
    assert {cylinder.joint for cylinder in hydraulics.cylinders} == set(backhoe.joint_names)
    HydraulicsRecord.model_validate(content())


def test_inspect_prints_cylinders_pump_and_digging_forces(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["backhoe-planner", "inspect", "example:backhoe"])
    with pytest.raises(SystemExit) as caught:
        main()
    said = capsys.readouterr().out
    assert caught.value.code == 0
    assert re.search(r"bucket +bucket +1\.147 to 1\.993 +-161\.0 to 46\.0 +184\.8 +126\.3", said)
    assert "pump 163 l/min at 228 bar, 53.6 kW" in said
    assert "bucket 65.4 kN, stick 38.2 kN" in said


def test_a_cylinder_across_two_planes_reaches_the_hypotenuse_of_its_dead_centres() -> None:
    """Pins 0.5 and 0.9 m from the axis and 0.3 m apart along it: from hypot(0.4, 0.3) to hypot(1.4, 0.3) m."""
    linkage = Triangle(0.9, 0.5, 0.0, 0.3)
    assert linkage.length_range == pytest.approx((0.5, math.hypot(1.4, 0.3)))
    angle = np.array([0.0, 0.5 * np.pi, np.pi])
    length = linkage.length(angle)
    np.testing.assert_allclose(length, [0.5, math.sqrt(0.81 + 0.25 + 0.09), math.hypot(1.4, 0.3)])
    np.testing.assert_allclose(linkage.angles(length)[0], angle, atol=1e-7)


def test_a_load_sensing_pump_delivers_all_oil_at_the_highest_pressure(backhoe: bp.Robot) -> None:
    """Every joint moves against its load, so that every cylinder does."""
    hydraulics = backhoe.hydraulics
    assert hydraulics is not None
    q, v = np.array([0.2, 0.2, -1.4, -0.9]), np.array([0.1, -0.2, 0.15, 0.3])
    tau = np.array([4e3, -2e4, 9e3, 5e3])
    assert hydraulics.power(q, v, tau) == pytest.approx(tau @ v)
    pressures, flows = hydraulics.pressures(q, tau), hydraulics.flows(q, v)
    assert hydraulics.load_sensing_power(q, v, tau) == pytest.approx(np.max(pressures) * np.sum(flows))


def test_limits_and_flows_of_no_configuration_are_empty(backhoe: bp.Robot) -> None:
    hydraulics, none = backhoe.hydraulics, np.zeros((0, 4))
    assert hydraulics is not None
    assert hydraulics.torque_limits(none).positive.shape == hydraulics.flow_slopes(none, none)[1].shape == (0, 4)
    assert hydraulics.velocity_limit_slopes(none).negative.shape == (0, 4)
    assert hydraulics.cylinder_forces(none, none).shape == (0, len(hydraulics.cylinders))
    assert hydraulics.power(none, none, none).shape == (0,)
