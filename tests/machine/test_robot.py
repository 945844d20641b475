"""The machine: its joints, limits, held joints, and the tip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.errors import InputError, RobotError
from backhoe_planner.machine import JointLimits, Kinematics, Robot, load_robot, travel_times, travel_within

LIMIT = '<limit lower="-1" upper="1" effort="5" velocity="0.6"/>'
DOT = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'


def joint(name: str, kind: str, parent: str, child: str, inside: str = "", limit: str = LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="1 0.2 0" rpy="0.3 -0.4 0.5"/><axis xyz="0 1 2"/>{limit}{inside}</joint>'
    )


def load(tmp_path: Path, *elements: str, links: str, tip: str | None = None) -> Robot:
    path = tmp_path / "tiny.urdf"
    named = "".join(f'<link name="{name}">{DOT}</link>' for name in links.split())
    path.write_text(f'<robot name="tiny">{named}{"".join(elements)}</robot>')
    return load_robot(path, tip=tip)


def test_the_backhoe_has_four_joints_from_the_machine_outward(backhoe: Robot) -> None:
    assert backhoe.joint_names == ("swing", "boom", "stick", "bucket")
    assert (backhoe.n, backhoe.tip, backhoe.name) == (4, "bucket_tip", "backhoe")
    assert backhoe.model.nq == backhoe.model.nv == 4


def test_the_bucket_of_the_backhoe_turns_205_degrees_as_on_the_specification_sheet(backhoe: Robot) -> None:
    span = backhoe.limits.upper - backhoe.limits.lower
    assert np.degrees(span[3]) == pytest.approx(205.0, abs=0.1)
    assert np.degrees(span[0]) == pytest.approx(180.0, abs=0.1)


def test_an_acceleration_limit_in_the_urdf_is_used(planar4: Robot) -> None:
    np.testing.assert_array_equal(planar4.limits.acceleration, [2.0] * 4)


def test_the_default_acceleration_reaches_full_rate_in_half_a_second(tmp_path: Path) -> None:
    robot = load(tmp_path, joint("j", "revolute", "a", "b"), links="a b")
    np.testing.assert_array_equal(robot.limits.velocity, [0.6])
    np.testing.assert_array_equal(robot.limits.acceleration, [1.2])
    np.testing.assert_array_equal(robot.limits.effort, [5.0])


def test_the_acceleration_of_the_ur5_is_twice_its_rate(ur5: Robot) -> None:
    np.testing.assert_array_equal(ur5.limits.acceleration, 2.0 * ur5.limits.velocity)


def test_limits_are_read_only(planar4: Robot) -> None:
    with pytest.raises(ValueError, match="read-only"):
        planar4.limits.lower[0] = 0.0


@pytest.mark.parametrize("limit", ["", '<limit effort="5" velocity="0.6"/>'])
def test_a_continuous_joint_is_one_number_without_limits(tmp_path: Path, limit: str) -> None:
    robot = load(tmp_path, joint("j", "continuous", "a", "b", limit=limit), links="a b")
    assert robot.model.nq == robot.model.nv == robot.n == 1
    assert (robot.limits.lower[0], robot.limits.upper[0]) == (-np.inf, np.inf)
    assert robot.middle[0] == 0.0
    many = [robot.random_q(np.random.default_rng(seed))[0] for seed in range(50)]
    assert -np.pi <= min(many) < -2.0 < 2.0 < max(many) <= np.pi
    turned = Kinematics(robot)
    np.testing.assert_allclose(
        turned.at(np.array([0.3 + 2.0 * np.pi])).tip_rotation, turned.at(np.array([0.3])).tip_rotation, atol=1e-12
    )


def test_the_middle_configuration_is_in_the_middle_of_each_range(panda: Robot) -> None:
    assert panda.middle[3] == pytest.approx(-0.5 * (3.0718 + 0.0698))


def test_prismatic_joints_are_marked(tmp_path: Path) -> None:
    robot = load(tmp_path, joint("slide", "prismatic", "a", "b"), joint("turn", "revolute", "b", "c"), links="a b c")
    np.testing.assert_array_equal(robot.prismatic, [True, False])


HELD = [
    ("prismatic", "0.01", "0.04", 0.01),
    ("prismatic", "-0.04", "-0.02", -0.02),
    ("prismatic", "-0.04", "0.04", 0.0),
    ("revolute", "0.3", "0.9", 0.3),
    ("revolute", "-2.4435", "-0.1745", -0.1745),
]


@pytest.mark.parametrize(("kind", "lower", "upper", "held"), HELD)
def test_a_joint_off_the_chain_is_held_at_the_position_nearest_to_0_with_pinocchios_poses(
    tmp_path: Path, kind: str, lower: str, upper: str, held: float
) -> None:
    limit = f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'
    robot = load(
        tmp_path,
        joint("arm", "revolute", "base", "hand"),
        joint("grip", kind, "hand", "finger", limit=limit),
        joint("nail", "fixed", "finger", "tip_of_finger", limit=""),
        links="base hand finger tip_of_finger",
        tip="hand",
    )
    assert robot.joint_names == ("arm",)
    whole = pin.buildModelFromXML((tmp_path / "tiny.urdf").read_text())
    own, other = robot.model.createData(), whole.createData()
    for angle in (-0.8, 0.0, 0.5):
        pin.framesForwardKinematics(robot.model, own, np.array([angle]))
        pin.framesForwardKinematics(whole, other, np.array([angle, held]))
        for link in ("finger", "tip_of_finger"):
            np.testing.assert_allclose(
                own.oMf[robot.model.getFrameId(link)].homogeneous,
                other.oMf[whole.getFrameId(link)].homogeneous,
                atol=1e-14,
            )


def test_pandas_closed_fingers_have_pinocchios_poses(panda: Robot) -> None:
    whole = pin.buildModelFromUrdf(str(panda.urdf.path))
    own, other = panda.model.createData(), whole.createData()
    rng = np.random.default_rng(4)
    for _ in range(5):
        q = panda.random_q(rng)
        pin.framesForwardKinematics(panda.model, own, q)
        pin.framesForwardKinematics(whole, other, np.concatenate((q, [0.0, 0.0])))
        for link in panda.all_link_names:
            np.testing.assert_allclose(
                own.oMf[panda.model.getFrameId(link, pin.FrameType.BODY)].homogeneous,
                other.oMf[whole.getFrameId(link, pin.FrameType.BODY)].homogeneous,
                atol=1e-12,
            )


def test_a_mimic_joint_on_the_chain_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"tiny\.urdf: joint 'follower'.*'leader'.*mimic"):
        load(
            tmp_path,
            joint("leader", "revolute", "a", "b"),
            joint("follower", "revolute", "b", "c", '<mimic joint="leader"/>'),
            links="a b c",
        )


def test_a_mimic_joint_off_the_chain_is_held(tmp_path: Path) -> None:
    robot = load(
        tmp_path,
        joint("arm", "revolute", "a", "b"),
        joint("left", "revolute", "b", "c"),
        joint("right", "revolute", "b", "d", '<mimic joint="left"/>'),
        links="a b c d",
        tip="b",
    )
    assert robot.joint_names == ("arm",)


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "continuous"])
@pytest.mark.parametrize("second", ['<mimic joint="arm" multiplier="-1"/>', '<mimic joint="first"/>'])
def test_a_mimic_joint_off_the_chain_with_its_leader_on_it_is_refused(tmp_path: Path, kind: str, second: str) -> None:
    """Its link moves with the arm: held at 0, it would be proven clear where it is not."""
    followers = [
        joint("first", "revolute", "a", "c", '<mimic joint="arm"/>' if "first" in second else ""),
        joint("second", kind, "a", "d", second),
    ]
    with pytest.raises(RobotError, match=r"tiny\.urdf: joint '(first|second)': copies joint 'arm'.*<mimic>"):
        load(tmp_path, joint("arm", "revolute", "a", "b"), *followers, links="a b c d", tip="b")
    moved_by_none = [follower.replace('joint="arm"', 'joint="left"') for follower in followers]
    left = joint("left", "revolute", "a", "e")
    robot = load(tmp_path, joint("arm", "revolute", "a", "b"), left, *moved_by_none, links="a b c d e", tip="b")
    assert robot.joint_names == ("arm",)


def test_several_ends_without_a_tip_are_an_error_that_lists_them(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"tip: .*several ends.*allowed: left, right") as caught:
        load(tmp_path, joint("l", "revolute", "a", "left"), joint("r", "revolute", "a", "right"), links="a left right")
    assert str(tmp_path / "tiny.urdf") in str(caught.value)


def test_an_example_robot_is_named_in_errors_as_the_user_named_it() -> None:
    for tip, said in ((None, "the URDF has several ends"), ("nope", "the URDF has no such link; found nope")):
        with pytest.raises(RobotError) as caught:
            load_robot("example:panda", tip=tip)
        assert str(caught.value).startswith(f"example:panda: tip: {said}")
        assert "share" not in str(caught.value)


def test_an_end_that_no_joint_moves_cannot_be_the_tip(tmp_path: Path) -> None:
    fixed, left = joint("f", "fixed", "a", "plate"), joint("l", "revolute", "a", "left")
    assert load(tmp_path, fixed, left, links="a plate left").tip == "left"
    with pytest.raises(RobotError, match=r"several ends.*allowed: left, right \("):
        load(tmp_path, fixed, left, joint("r", "revolute", "a", "right"), links="a plate left right")
    with pytest.raises(RobotError, match=r"no joint moves the tip; found plate"):
        load(tmp_path, fixed, links="a plate")


def test_bucket_tip_is_the_default_tip_even_among_several_ends(tmp_path: Path) -> None:
    robot = load(
        tmp_path,
        joint("l", "revolute", "a", "other"),
        joint("r", "revolute", "a", "bucket_tip"),
        links="a other bucket_tip",
    )
    assert robot.tip == "bucket_tip"


def test_the_only_end_is_the_default_tip(planar4: Robot) -> None:
    assert planar4.tip == "tip"


def test_an_unknown_tip_is_an_error_that_suggests_the_nearest_link() -> None:
    with pytest.raises(RobotError, match=r"tip: .*no such link; found buket_tip.*did you mean 'bucket_tip'\?"):
        load_robot("example:backhoe", tip="buket_tip")


def test_a_tip_that_no_joint_moves_is_refused() -> None:
    with pytest.raises(RobotError, match="no joint moves the tip; found cab"):
        load_robot("example:backhoe", tip="cab")


def test_with_tip_returns_a_new_robot_and_does_not_change_the_old_one(backhoe: Robot) -> None:
    before = backhoe.model.copy()
    shorter = backhoe.with_tip("stick")
    assert shorter is not backhoe
    assert shorter.joint_names == ("swing", "boom", "stick")
    assert (backhoe.tip, backhoe.n) == ("bucket_tip", 4)
    assert backhoe.model == before
    assert {piece.link for piece in shorter.pieces} == {piece.link for piece in backhoe.pieces}


@pytest.mark.parametrize("tip", [None, "bucket_tip"])
def test_with_tip_returns_the_same_robot_for_the_same_tip(backhoe: Robot, tip: str | None) -> None:
    assert backhoe.with_tip(tip) is backhoe


def test_a_robot_is_read_only(planar4: Robot) -> None:
    with pytest.raises(AttributeError):
        planar4.tip = "link1"  # type: ignore[misc]


def test_kinematics_do_not_change_the_model(any_robot: Robot) -> None:
    before = any_robot.model.copy()
    kinematics = Kinematics(any_robot)
    for seed in range(3):
        kinematics.at(any_robot.random_q(np.random.default_rng(seed)))
    assert any_robot.has_pitch == (any_robot.name == "backhoe")
    assert any_robot.model == before


def test_a_link_and_a_joint_may_have_the_same_name(tmp_path: Path) -> None:
    robot = load(
        tmp_path,
        joint("arm", "revolute", "base", "arm"),
        joint("hand", "revolute", "arm", "hand"),
        links="base arm hand",
    )
    assert robot.joint_names == ("arm", "hand")
    assert [(piece.link, piece.joint) for piece in robot.pieces] == [("base", 0), ("arm", 1), ("hand", 2)]
    frame = robot.model.frames[robot.tip_frame]
    assert (frame.name, frame.type, frame.parentJoint) == ("hand", pin.FrameType.BODY, 2)


def test_pieces_are_numbered_within_their_link(planar4: Robot) -> None:
    assert [piece.name for piece in planar4.pieces] == ["base/0", "link1/0", "link2/0", "link3/0", "link4/0"]
    assert planar4.link_names == ("base", "link1", "link2", "link3", "link4")
    assert planar4.all_link_names == (*planar4.link_names, "tip")


def test_random_q_is_within_the_joint_limits(any_robot: Robot) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        q = any_robot.random_q(rng)
        assert np.all(any_robot.limits.lower <= q)
        assert np.all(q <= any_robot.limits.upper)


def test_check_q_returns_a_copy(planar4: Robot) -> None:
    given = np.zeros(4)
    checked = planar4.check_q(given)
    given[0] = 1.0
    assert checked[0] == 0.0


@pytest.mark.parametrize(
    ("q", "said"),
    [
        (
            [0.0] * 3,
            r"start: has the wrong shape; found shape \(3,\); allowed: 4 numbers: joint1, joint2",
        ),
        ([[0.0] * 4], r"has the wrong shape"),
        ([0.0, np.nan, 0.0, np.inf], r"start \(joint2, joint4\): is not finite"),
        (["a", "b", "c", "d"], "is not numbers"),
        (None, "is not numbers; found None"),
    ],
)
def test_check_q_refuses_wrong_shapes_and_values(planar4: Robot, q: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        planar4.check_q(q, what="start")


def test_visuals_contain_kind_colour_and_mesh(backhoe: Robot, panda: Robot) -> None:
    assert {visual.kind for visual in backhoe.visuals} <= {"box", "cylinder", "sphere"}
    assert all(visual.rgba is not None and len(visual.rgba) == 4 for visual in backhoe.visuals)
    meshes = [visual.mesh for visual in panda.visuals if visual.kind == "mesh"]
    assert meshes
    assert all(mesh is not None and mesh.is_file() for mesh in meshes)


def test_travel_times_and_travel_within_are_inverse() -> None:
    """1 rad at 1 rad/s^2 is a triangle of 2 s; 10 rad at 2 rad/s take 3 s at full rate and two ramps of 2 s."""
    one = np.ones(1)
    limits = JointLimits(lower=-100.0 * one, upper=100.0 * one, velocity=2.0 * one, acceleration=one, effort=one)
    np.testing.assert_allclose(travel_times(np.array([[1.0], [-10.0], [0.0]]), limits), [2.0, 7.0, 0.0])
    np.testing.assert_allclose(travel_within(2.0, limits), [1.0])
    np.testing.assert_allclose(travel_within(7.0, limits), [10.0])
