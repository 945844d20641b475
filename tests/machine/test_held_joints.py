"""Held joints stay at their positions, wherever in the machine they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError, RobotError
from backhoe_planner.machine import (
    BatchKinematics,
    Dynamics,
    Kinematics,
    Robot,
    digging_forces,
    held_overlaps,
    load_robot,
    self_pairs,
    self_pieces,
    working_envelope,
)

# held joints beyond the tip, beside it and in the chain; of solo12, legs beside the moving one
FINGERS = ("example:panda", "panda_hand", {"panda_finger_joint1": 0.04})
ELBOW = ("example:panda", "panda_hand_tcp", {"panda_joint3": 0.5, "panda_finger_joint1": 0.021})
LEGS = ("example:solo12", "FL_FOOT", {"FR_HAA": 0.3, "HL_KFE": np.pi / 2.0, "HR_HFE": -np.pi / 2.0, "HR_KFE": 2.0})
SHIN = ("example:solo12", "FL_FOOT", {"FL_HFE": 0.7, "FR_HAA": -0.2})
BUCKET = ("example:backhoe", "bucket_tip", {"bucket": -0.6})
HELD = [FINGERS, ELBOW, LEGS, SHIN, BUCKET]
BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
MASS = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


@pytest.fixture(scope="module", params=HELD, ids=["fingers", "elbow", "legs", "shin", "bucket"])
def held(request: pytest.FixtureRequest) -> Robot:
    source, tip, hold = request.param
    return load_robot(source, tip=tip).with_hold(hold)


class Whole:
    """Pinocchio's own model of all joints, with some at fixed positions."""

    def __init__(self, robot: Robot) -> None:
        self.model = pin.buildModelFromUrdf(str(robot.urdf.path))
        self.data = self.model.createData()
        self.columns = [self.model.joints[self.model.getJointId(name)].idx_v for name in robot.joint_names]
        self._standing = pin.neutral(self.model)
        for joint in robot.held:
            self._standing[self.model.joints[self.model.getJointId(joint.name)].idx_q] = joint.position

    def q(self, q: Vector) -> Vector:
        """Positions of all joints from those of the moving ones."""
        found: Vector = self._standing.copy()
        found[self.columns] = q
        return found


def test_every_link_has_the_pose_of_the_machine_with_all_joints(held: Robot) -> None:
    whole, data, rng = Whole(held), held.model.createData(), np.random.default_rng(1)
    for _ in range(4):
        q = held.random_q(rng)
        pin.framesForwardKinematics(held.model, data, q)
        pin.framesForwardKinematics(whole.model, whole.data, whole.q(q))
        for link in held.all_link_names:
            np.testing.assert_allclose(
                data.oMf[held.model.getFrameId(link, pin.FrameType.BODY)].homogeneous,
                whole.data.oMf[whole.model.getFrameId(link, pin.FrameType.BODY)].homogeneous,
                atol=1e-12,
            )


def test_torques_and_inertia_equal_those_of_the_machine_with_all_joints(held: Robot) -> None:
    """Held parts keep their weight; held joints have no velocity and no torque of their own."""
    whole, dynamics, rng = Whole(held), Dynamics(held), np.random.default_rng(2)
    for _ in range(4):
        q, v, a = held.random_q(rng), rng.normal(size=held.n), rng.normal(size=held.n)
        gravity = pin.computeGeneralizedGravity(whole.model, whole.data, whole.q(q))[whole.columns]
        scale = 1.0 + np.abs(gravity).max()
        np.testing.assert_allclose(dynamics.gravity_torques(q[None])[0], gravity, atol=1e-10 * scale)
        inertia = pin.crba(whole.model, whole.data, whole.q(q))
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        np.testing.assert_allclose(
            dynamics.mass_matrices(q[None])[0], inertia[np.ix_(whole.columns, whole.columns)], atol=1e-10 * scale
        )
        rates = np.zeros((2, whole.model.nv))
        rates[:, whole.columns] = v, a
        torques = pin.rnea(whole.model, whole.data, whole.q(q), *rates)[whole.columns]
        np.testing.assert_allclose(dynamics.torques(q, v, a), torques, atol=1e-10 * scale)


def test_collision_shapes_and_visuals_move_with_a_held_finger(panda: Robot) -> None:
    """Panda's fingers slide along y of the hand, away from each other."""
    opened = panda.with_hold({"panda_finger_joint1": 0.04})
    moved = {"panda_leftfinger": 0.04, "panda_rightfinger": -0.04}
    hand = panda.model.frames[panda.model.getFrameId("panda_hand")].placement.rotation
    for before, after in zip(panda.pieces, opened.pieces, strict=True):
        shift = hand @ np.array([0.0, moved.get(before.link, 0.0), 0.0])
        np.testing.assert_allclose(after.piece.hull, before.piece.hull + shift, atol=1e-12)
    for drawn, then in zip(panda.visuals, opened.visuals, strict=True):
        shift = hand @ np.array([0.0, moved.get(drawn.link, 0.0), 0.0])
        np.testing.assert_allclose(then.placement.translation, drawn.placement.translation + shift, atol=1e-12)


def test_held_joints_record_their_position_and_reason(panda: Robot) -> None:
    assert [(joint.name, joint.position, joint.why) for joint in panda.held] == [
        ("panda_finger_joint1", 0.0, "beside"),
        ("panda_finger_joint2", 0.0, "copies"),
    ]
    opened = panda.with_hold({"panda_finger_joint1": 0.03, "panda_joint5": 1})
    assert [(joint.name, joint.position, joint.why, joint.copies) for joint in opened.held] == [
        ("panda_joint5", 1.0, "held", None),
        ("panda_finger_joint1", 0.03, "held", None),
        ("panda_finger_joint2", 0.03, "copies", "panda_finger_joint1"),
    ]
    assert opened.joint_names == tuple(name for name in panda.joint_names if name != "panda_joint5")


def test_the_same_hold_returns_the_same_robot_and_a_new_one_replaces_it(panda: Robot) -> None:
    opened = panda.with_hold({"panda_finger_joint1": 0.03})
    assert opened.with_hold({"panda_finger_joint1": 0.03}) is opened
    assert panda.with_hold({}) is panda
    assert opened.with_tip("panda_hand").hold == {"panda_finger_joint1": 0.03}
    assert opened.with_hold({"panda_joint1": 0.0}).hold == {"panda_joint1": 0.0}
    assert opened.with_hold({}).joint_names == panda.joint_names


WRONG = {
    "unknown": ({"panda_joint9": 0.0}, r"hold: the machine has no such joint; found panda_joint9.*did you mean"),
    "fixed": ({"panda_hand_tcp_joint": 0.0}, "hold: is fixed in the URDF; found panda_hand_tcp_joint"),
    "outside": ({"panda_finger_joint1": 0.05}, r"hold.panda_finger_joint1: .*limits; found 0.05; allowed: 0 to 0.04 m"),
    "turned too far": ({"panda_joint4": 0.1}, r"hold.panda_joint4: .*found 0.1; allowed: -3.0718 to -0.0698 rad"),
    "copy": (
        {"panda_finger_joint2": 0.02},
        r"hold.panda_finger_joint2: copies joint 'panda_finger_joint1'.*found 0.02",
    ),
    "all": (
        {f"panda_joint{k}": position for k, position in enumerate((0, 0, 0, -1, 0, 1, 0), start=1)},
        "hold: leaves no joint that moves the tip, panda_hand_tcp",
    ),
}


@pytest.mark.parametrize(("hold", "said"), WRONG.values(), ids=WRONG.keys())
def test_invalid_holds_are_refused(panda: Robot, hold: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        panda.with_hold(hold)


def test_a_mimic_joint_may_be_held_at_the_position_that_follows_from_its_leader(panda: Robot) -> None:
    both = panda.with_hold({"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02})
    assert {joint.name: joint.position for joint in both.held} == {
        "panda_finger_joint1": 0.02,
        "panda_finger_joint2": 0.02,
    }


def write(tmp_path: Path, *joints: str, links: str) -> Path:
    path = tmp_path / "tiny.urdf"
    named = "".join(f'<link name="{name}">{BALL}{MASS}</link>' for name in links.split())
    path.write_text(f'<robot name="tiny">{named}{"".join(joints)}</robot>')
    return path


def hinge(name: str, parent: str, child: str, inside: str = "") -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="1 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="5" velocity="1"/>{inside}</joint>'
    )


def test_mimic_joints_follow_with_multiplier_and_offset(tmp_path: Path) -> None:
    file = write(
        tmp_path,
        hinge("arm", "base", "hand"),
        hinge("second", "hand", "b", '<mimic joint="first" multiplier="-2" offset="0.1"/>'),
        hinge("third", "hand", "c", '<mimic joint="second" offset="0.5"/>'),
        hinge("first", "hand", "a"),
        links="base hand a b c",
    )
    robot = load_robot(file, tip="hand")
    # the first is at 0 by default: the second at 0.1, the third at 0.6
    assert {joint.name: joint.position for joint in robot.held} == {"second": 0.1, "third": 0.6, "first": 0.0}
    held = robot.with_hold({"first": 0.3})
    assert {joint.name: joint.position for joint in held.held} == pytest.approx(
        {"second": -0.5, "third": 0.0, "first": 0.3}
    )


def test_a_mimic_joint_between_root_and_tip_is_held_with_its_leader(tmp_path: Path) -> None:
    """Three hinges along x, 1 m apart: at 0, 0.4 and -0.4 rad the tip is at 1 + 1 + cos 0.4 and sin 0.4."""
    file = write(
        tmp_path,
        hinge("arm", "base", "a"),
        hinge("leader", "a", "b"),
        hinge("copy", "b", "c", '<mimic joint="leader" multiplier="-1"/>'),
        links="base a b c",
    )
    with pytest.raises(RobotError, match=r"copies joint 'leader'.*hold: \{leader: \.\.\.\}"):
        load_robot(file, tip="c")
    robot = load_robot(file, tip="c", hold={"leader": 0.4})
    assert robot.joint_names == ("arm",)
    at = Kinematics(robot).at(np.zeros(1))
    np.testing.assert_allclose(at.tip_position, [2.0 + np.cos(0.4), np.sin(0.4), 0.0], atol=1e-12)
    np.testing.assert_allclose(at.tip_rotation, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("leader", ["copy", "nowhere"])
def test_a_joint_that_mimics_itself_or_nothing_is_an_error(tmp_path: Path, leader: str) -> None:
    copy = hinge("copy", "a", "b", f'<mimic joint="{leader}"/>')
    file = write(tmp_path, hinge("arm", "base", "a"), copy, links="base a b")
    with pytest.raises(RobotError, match=f"joint 'copy': copies joint '{leader}', which copies it in turn or does not"):
        load_robot(file, tip="b")


def test_a_joint_that_mimics_a_moving_one_cannot_be_held(tmp_path: Path) -> None:
    copy = hinge("copy", "base", "b", '<mimic joint="arm"/>')
    file = write(tmp_path, hinge("arm", "base", "a"), copy, links="base a b")
    with pytest.raises(RobotError, match="joint 'copy': copies joint 'arm', which moves the tip"):
        load_robot(file, tip="a", hold={"copy": 0.1})


def test_a_held_bucket_still_counts_in_the_pitch(backhoe: Robot) -> None:
    """Pitch = boom + stick + bucket, whichever of them are held."""
    held = backhoe.with_hold({"bucket": -0.7})
    batch, rng = BatchKinematics(held), np.random.default_rng(3)
    for _ in range(5):
        q = held.random_q(rng)
        at, one = Kinematics(held).at(q), batch.at(q[None])
        expected = np.arctan2(np.sin(q[1] + q[2] - 0.7), np.cos(q[1] + q[2] - 0.7))
        assert at.pitch == pytest.approx(expected, abs=1e-9)
        assert one.pitch()[0] == pytest.approx(expected, abs=1e-9)
        np.testing.assert_allclose(at.pitch_row, [0.0, 1.0, 1.0], atol=1e-9)


def test_a_bucket_that_can_tilt_has_a_pitch_if_its_tilt_is_held(tmp_path: Path) -> None:
    """The bucket's pin is 1 m along x from the boom's, the tip 2 m along x from there beyond a tilt about x."""
    lift = (
        hinge("boom", "base", "boom").replace('xyz="0 0 1"', 'xyz="0 -1 0"').replace('"3"', '"1"').replace("-3", "-1")
    )
    curl = hinge("bucket", "boom", "bucket").replace('xyz="0 0 1"', 'xyz="0 -1 0"')
    tilt = hinge("tilt", "bucket", "rotor").replace('xyz="0 0 1"', 'xyz="1 0 0"')
    tip = hinge("tip", "rotor", "end").replace("revolute", "fixed")
    robot = load_robot(write(tmp_path, lift, curl, tilt, tip, links="base boom bucket rotor end"), tip="end")
    assert not robot.has_pitch
    held = robot.with_hold({"tilt": 0.8})
    assert held.has_pitch
    assert Kinematics(held).at(np.array([0.3, 0.4])).pitch == pytest.approx(0.7)


def folding(tmp_path: Path) -> Robot:
    """Three beams of 1 m, each with a ball of radius 0.1 m on its hinge at the end of the previous one."""
    hub = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    beam = '<collision><origin xyz="0.5 0 0"/><geometry><box size="0.9 0.05 0.05"/></geometry></collision>'
    hinges = [hinge("first", "base", "a"), hinge("second", "a", "b"), hinge("third", "b", "c")]
    links = ['<link name="base"/>', *(f'<link name="{name}">{hub}{beam}</link>' for name in "abc")]
    path = tmp_path / "folding.urdf"
    path.write_text(f'<robot name="folding">{"".join((*links, *hinges))}</robot>')
    return load_robot(path)


def test_links_that_touch_only_because_of_a_held_joint_are_not_taken_for_a_pin(tmp_path: Path) -> None:
    """With the second joint folded to 3 rad, the ball of the third hinge is 0.14 m from that of the first."""
    robot = folding(tmp_path)
    held = robot.with_hold({"second": 3.0})
    kept = {(self_pieces(held)[a].link, self_pieces(held)[b].link) for a, b in self_pairs(held).kept}
    assert ("c", "a") in kept
    assert ("c", "a") not in {(pair.link, pair.other) for pair in self_pairs(held).left_out if pair.touch}


def test_overlaps_caused_by_held_joints_are_found(tmp_path: Path) -> None:
    """The third beam is folded back through the first one, or stretched out."""
    robot = folding(tmp_path)
    folded = robot.with_hold({"second": 3.0, "third": 3.0})
    assert ("c", "a") in {(link, other) for link, other, _ in held_overlaps(folded)}
    assert held_overlaps(robot.with_hold({"second": 0.5, "third": 0.3})) == ()
    assert held_overlaps(robot) == ()


def test_data_sheet_figures_are_not_given_with_a_held_swing_or_bucket(backhoe: Robot) -> None:
    for hold in ({"swing": 0.2}, {"bucket": -0.5}):
        held = backhoe.with_hold(hold)
        assert working_envelope(held) is None
        assert digging_forces(held) is None
    boom = backhoe.with_hold({"boom": 0.5})
    envelope, whole = working_envelope(boom), working_envelope(backhoe)
    assert envelope is not None
    assert whole is not None
    assert envelope.digging_depth < whole.digging_depth
    assert envelope.bucket_rotation == whole.bucket_rotation
