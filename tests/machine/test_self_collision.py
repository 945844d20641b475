"""Which self-collision pairs count, decided by geometry for each pair of pieces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import backhoe_planner as bp
from backhoe_planner.machine import Robot, TrackingTube, load_robot, self_pairs, self_pieces


def link(name: str, *boxes: str) -> str:
    """A link of boxes, each given as ``size | position``."""
    shapes = "".join(
        f'<collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision>'
        for size, at in (box.split("|") for box in boxes)
    )
    return f'<link name="{name}">{shapes}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    *,
    at: str = "0 0 0",
    axis: str = "0 0 1",
    kind: str = "revolute",
    either_way: float = 3.1,
) -> str:
    """A joint; a hinge turns by `either_way` [rad] to both sides."""
    ends = (
        f'<limit lower="{-either_way}" upper="{either_way}" effort="100" velocity="1"/>' if kind == "revolute" else ""
    )
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}"/><axis xyz="{axis}"/>{ends}</joint>'
    )


def machine(folder: Path, *parts: str, tip: str) -> Robot:
    path = folder / "machine.urdf"
    path.write_text(f'<robot name="machine">{"".join(parts)}</robot>')
    return load_robot(path, tip=tip)


def kept_links(robot: Robot) -> set[frozenset[str]]:
    return {frozenset((self_pieces(robot)[a].link, self_pieces(robot)[b].link)) for a, b in self_pairs(robot).kept}


ARM = link("arm", "2 0.1 0.1 | 1 0 0")
TIP = '<link name="tip"/>' + joint("tip_fixed", "arm", "tip", at="2 0 0", kind="fixed")


@pytest.mark.parametrize(
    "stand",
    [
        # a cab as a separate link, fixed to the base
        pytest.param(
            link("base", "0.3 0.3 0.3 | 0 0 -0.1")
            + link("cab", "0.6 0.6 0.6 | 0 0 0")
            + joint("cab_fixed", "base", "cab", at="0 1.5 0", kind="fixed"),
            id="fixed link",
        ),
        # the same cab as another shape of the base, on which the arm turns
        pytest.param(
            link("base", "0.3 0.3 0.3 | 0 0 -0.1", "0.6 0.6 0.6 | 0 1.5 0"),
            id="shape of the base",
            marks=pytest.mark.long,
        ),
    ],
)
def test_an_arm_that_sweeps_through_the_cab_on_its_base_is_not_verified(stand: str, tmp_path: Path) -> None:
    """The arm starts along x and turns by 3 rad: at pi/2 it is in the middle of the cab."""
    robot = machine(tmp_path, stand, ARM, TIP, joint("turn", "base", "arm", at="0 0 0.05"), tip="tip")
    goal = [2.0 * float(np.cos(3.0)), 2.0 * float(np.sin(3.0)), 0.05]
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": {"turn": 0.0}}, "task": {"goal": {"position": goal}}})
    through = bp.Trajectory.from_steps(np.array([0.0, 20.0]), np.array([[0.0], [3.0]]))
    certificate = bp.certify(robot, scene, through)
    assert not certificate.safe
    assert certificate.min_clearance is not None
    # half the width of the arm and all of the cab's 0.6 m: to separate, the box moves 0.3 + 0.05 up or down
    assert certificate.min_clearance.distance == pytest.approx(-0.35 + 0.05, abs=0.06)
    assert {certificate.min_clearance.link, certificate.min_clearance.obstacle} <= {"arm", "cab", "base"}
    # the joint's limits of 3.1 rad leave no way round the other side
    plan = bp.plan(robot, scene, effort="quick")
    assert (plan.verdict, plan.reason) == ("failed", "blocked")


def test_a_tool_fixed_to_the_wrist_that_folds_into_the_forearm_counts(tmp_path: Path) -> None:
    """The tool, 0.4 m long and 0.1 m off the wrist's axis, is in the forearm when the wrist turns by pi."""
    robot = machine(
        tmp_path,
        link("base", "0.2 0.2 0.2 | 0 0 0"),
        link("forearm", "1 0.1 0.1 | 0.5 0 0"),
        joint("elbow", "base", "forearm"),
        link("wrist", "0.1 0.1 0.1 | 0 0 0"),
        joint("wrist_turn", "forearm", "wrist", at="1 0 0"),
        link("tool", "0.4 0.04 0.04 | 0.2 0 0"),
        joint("tool_fixed", "wrist", "tool", at="0.1 0 0", kind="fixed"),
        '<link name="tip"/>',
        joint("tip_fixed", "tool", "tip", at="0.4 0 0", kind="fixed"),
        tip="tip",
    )
    assert kept_links(robot) == {
        frozenset(("tool", "forearm")),
        frozenset(("tool", "base")),
        frozenset(("wrist", "base")),
    }
    left_out = {(pair.link, pair.other): pair for pair in self_pairs(robot).left_out}
    assert left_out["wrist", "forearm"].touch
    assert left_out["wrist", "forearm"].why == "touch at wrist_turn"
    assert left_out["forearm", "base"].touch


def test_a_pair_that_cannot_meet_is_left_out_and_listed(tmp_path: Path) -> None:
    """A mast of 0.2 m at 2.5 m, out of reach of the arm of 2 m."""
    robot = machine(
        tmp_path,
        link("base", "0.3 0.3 0.3 | 0 0 -0.1"),
        link("mast", "0.2 0.2 2 | 0 0 0"),
        joint("mast_fixed", "base", "mast", at="0 2.5 0", kind="fixed"),
        ARM, TIP, joint("turn", "base", "arm", at="0 0 0.05"), tip="tip",
    )  # fmt: skip
    assert self_pairs(robot).kept == ()
    told = {(pair.link, pair.other, pair.touch, pair.why) for pair in self_pairs(robot).left_out}
    assert told == {
        ("arm", "base", True, "touch at turn"),
        ("arm", "mast", False, "cannot meet over the range of turn"),
    }


def test_a_contact_between_two_samples_of_the_sweep_is_found(tmp_path: Path) -> None:
    """A fin at 1.9 m is 10 mm wide, 0.3 deg seen from the pin; the samples are 9 deg apart."""
    robot = machine(
        tmp_path,
        link("base", "0.3 0.3 0.3 | 0 0 -0.1"),
        link("fin", "0.2 0.01 0.2 | 0 0 0"),
        joint("fin_fixed", "base", "fin", at="1.9 0.55 0.05", kind="fixed"),
        link("arm", "2 0.002 0.002 | 1 0 0"), TIP, joint("turn", "base", "arm", at="0 0 0.05"), tip="tip",
    )  # fmt: skip
    assert kept_links(robot) == {frozenset(("arm", "fin"))}


@pytest.mark.parametrize(
    ("name", "tip"),
    [
        ("backhoe", None),
        ("planar4", None),
        ("panda", "panda_hand"),
        ("ur5", "tool0"),
        pytest.param("kinova", None, marks=pytest.mark.long),
    ],
)
def test_neighbouring_links_of_real_machines_are_left_out(name: str, tip: str | None) -> None:
    """Real machines move over their whole range without collisions between neighbouring links."""
    robot = load_robot(f"example:{name}", tip=tip or {"kinova": "j2s6s200_end_effector"}.get(name))
    for a, b in self_pairs(robot).kept:
        assert self_pieces(robot)[a].joint - self_pieces(robot)[b].joint > 1


@pytest.mark.parametrize(("either_way", "left_out"), [(2.5, ["touch at elbow"]), (3.1, [])])
def test_links_that_touch_only_near_their_own_pin_are_left_out(
    either_way: float, left_out: list[str], tmp_path: Path
) -> None:
    """Two rods 4 cm thick end 2 cm before the pin between them: apart when stretched, in contact at a right angle.

    Bent by 2.5 rad, their inner edges cross 0.02 tan(1.25) m from the pin, 6 cm. At 3.1 rad they overlap lengthwise.
    """
    rod = "0.96 0.04 0.04 | 0.5 0 0"
    robot = machine(
        tmp_path,
        '<link name="base"/>',
        link("upper", rod),
        joint("shoulder", "base", "upper"),
        link("lower", rod),
        joint("elbow", "upper", "lower", at="1 0 0", either_way=either_way),
        tip="lower",
    )
    assert bool(self_pairs(robot).kept) == (not left_out)
    assert [pair.why for pair in self_pairs(robot).left_out] == left_out


def swept_post(folder: Path, *, post_at: str, limits: tuple[float, float], hub: bool = False) -> Robot:
    """A jib that turns by `limits` about z, and a post of its own base, 20 mm wide, 1 m from the axis."""
    shapes = [f"0.02 0.02 0.4 | {post_at}", *(["0.3 0.3 0.3 | 0 0 -0.1"] if hub else [])]
    turn = joint("turn", "base", "arm", at="0 0 0.05")
    text = turn.replace('lower="-3.1" upper="3.1"', f'lower="{limits[0]}" upper="{limits[1]}"')
    return machine(folder, link("base", *shapes), ARM, TIP, text, tip="tip")


@pytest.mark.parametrize("hub", [False, True])
@pytest.mark.parametrize("limits", [(-3.14159, 3.14159), (-6.28318, 6.28318), (-62.8, 62.8)])
@pytest.mark.parametrize("angle", [4.5, 45.0])
def test_a_post_between_two_samples_of_the_sweep_counts(
    hub: bool, limits: tuple[float, float], angle: float, tmp_path: Path
) -> None:
    x, y = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    robot = swept_post(tmp_path, post_at=f"{x:.6f} {y:.6f} 0.05", limits=limits, hub=hub)
    assert kept_links(robot) == {frozenset(("arm", "base"))}


def test_a_servo_that_starts_outside_its_range_stops_before_a_post_there(tmp_path: Path) -> None:
    """Range 1 rad to both sides, start at 1.5 rad, a post of its own base in between at 1.25 rad: it cannot return."""
    robot = swept_post(tmp_path, post_at=f"{np.cos(1.25):.6f} {np.sin(1.25):.6f} 0.05", limits=(-1.0, 1.0))
    assert self_pairs(robot).kept == ()
    assert len(self_pairs(robot, (1.5,)).kept) == 1
    scene = bp.scene_from_dict(
        {"version": 1, "start": {"joints": {"turn": 1.5}}, "task": {"goal": {"position": [2, 0, 0.05]}}}
    )
    servo = bp.Servo(robot, scene, dt=0.01, q=np.array([1.5]))
    for _ in range(100):  # 0.5 rad, if nothing stops it
        state = servo.step(joint_velocity=np.array([-0.5]))
    # the arm is 0.1 m wide: its edge meets the post some 0.06 m earlier
    assert state.q[0] > 1.25 + 0.05


def test_a_post_on_a_hub_that_always_overlaps_counts(tmp_path: Path) -> None:
    """The base's hub overlaps the arm's hub at all positions of the two joints between them; its post does not."""
    robot = machine(
        tmp_path,
        link("base", "0.3 0.3 0.3 | 0 0 0", "0.04 0.04 0.4 | 1 0 0"),
        '<link name="plate"/>',
        joint("lower_turn", "base", "plate"),
        link("arm", "0.3 0.3 0.3 | 0 0 0", "1.8 0.05 0.05 | 0.9 0 0"),
        joint("upper_turn", "plate", "arm"),
        tip="arm",
    )
    names = {(self_pieces(robot)[a].name, self_pieces(robot)[b].name) for a, b in self_pairs(robot).kept}
    assert ("arm/1", "base/1") in names
    assert ("arm/0", "base/0") not in names


def tilted_plates(folder: Path, slope: float) -> Robot:
    """A bar that turns on a bar of its base, both 1 m long and 0.1 m wide from 0.05 m off the axis on.

    On the axis the lower side of the upper bar is 50 mm below the top of the lower one, and rises by `slope`.
    """
    tilt = np.arctan(slope)
    middle = np.array([0.55, 0.0, -0.05 + 0.55 * slope]) + 0.05 * np.array([-np.sin(tilt), 0.0, np.cos(tilt)])
    upper = (
        f'<link name="upper"><collision><origin xyz="{middle[0]} 0 {middle[2]}" rpy="0 {-tilt} 0"/>'
        '<geometry><box size="1 0.1 0.1"/></geometry></collision></link>'
    )
    lower = link("lower", "1 0.1 0.1 | 0.55 0 -0.05")
    return machine(folder, lower, upper, joint("turn", "lower", "upper"), tip="upper")


def test_an_overlap_that_reaches_far_from_the_pin_counts_wherever_it_is_deepest(tmp_path: Path) -> None:
    """The overlap is 48 mm deep at the pin and still 5 mm deep at 1 m: the bars overlap along their whole length."""
    robot = tilted_plates(tmp_path, 0.045)
    assert kept_links(robot) == {frozenset(("upper", "lower"))}


def test_an_overlap_that_ends_near_the_pin_is_left_out(tmp_path: Path) -> None:
    """The same, but the upper bar leaves the lower one 0.2 m from the axis."""
    robot = tilted_plates(tmp_path, 0.25)
    assert self_pairs(robot).kept == ()
    assert [pair.why for pair in self_pairs(robot).left_out] == ["touch at turn"]


def test_a_turntable_that_overlaps_its_bed_all_around_is_left_out(tmp_path: Path) -> None:
    """The bed has two halves, each in contact over half the turn, 0.1 to 0.4 m from the axis.

    The overlap is 10 mm deep at 0.1 m and 1 mm at 0.4 m.
    """
    table = (
        '<link name="table"><collision><origin xyz="0.25 0 0.0445" rpy="0 -0.03 0"/>'
        '<geometry><box size="0.3 0.2 0.1"/></geometry></collision></link>'
    )
    bed = link("bed", "0.5 1 0.1 | 0.25 0 -0.05", "0.5 1 0.1 | -0.25 0 -0.05")
    robot = machine(tmp_path, bed, table, joint("turn", "bed", "table"), tip="table")
    assert self_pairs(robot).kept == ()
    assert [pair.why for pair in self_pairs(robot).left_out] == ["touch at turn"]


def disc_with_gap(folder: Path, gap: float) -> str:
    """A link that is a disc of 1 m radius, 40 mm thick, without a sector of `gap` [rad] about -x."""
    angle = np.linspace(-np.pi + gap / 2.0, np.pi - gap / 2.0, 97)
    outline = np.vstack(([0.0, 0.0], np.column_stack((np.cos(angle), np.sin(angle)))))
    count = len(outline)
    corners = np.vstack([np.column_stack((outline, np.full(count, z))) for z in (-0.02, 0.02)])
    fan = np.array([[0, i, i + 1] for i in range(1, count - 1)])
    sides = [[i, (i + 1) % count, j] for i in range(count) for j in ((i + 1) % count + count,)]
    sides += [[i, (i + 1) % count + count, i + count] for i in range(count)]
    trimesh.Trimesh(corners, np.vstack((fan[:, ::-1], fan + count, sides))).export(folder / "disc.stl")
    return '<link name="disc"><collision><geometry><mesh filename="disc.stl"/></geometry></collision></link>'


def peg_in_disc(folder: Path, gap: float, *, joints: int) -> Robot:
    """A cube of 0.1 m edge that turns 0.5 m from the axis of a disc, by one joint or by two on one axis.

    The hull of the disc reaches to cos(gap / 2) m at the gap, so that the cube is in it all around.
    """
    below = joint("below", "base", "plate", kind="fixed" if joints == 1 else "revolute", either_way=0.05)
    parts = [
        '<link name="base"/>',
        disc_with_gap(folder, gap),
        joint("disc_fixed", "base", "disc", kind="fixed"),
        '<link name="plate"/>',
        below,
        link("peg", "0.1 0.1 0.1 | 0.5 0 0"),
        joint("turn", "plate", "peg", either_way=np.pi - 0.05),
    ]
    return machine(folder, *parts, tip="peg")


@pytest.mark.parametrize("joints", [1, 2])
def test_overlap_of_the_hull_alone_is_no_reason_to_leave_a_pair_out(joints: int, tmp_path: Path) -> None:
    """A gap of 100 deg: the cube, 13 deg wide, touches the disc over 260 + 13 of 360 deg: 0.76 of the turn."""
    robot = peg_in_disc(tmp_path, np.radians(100.0), joints=joints)
    assert kept_links(robot) == {frozenset(("peg", "disc"))}


@pytest.mark.parametrize("joints", [1, 2])
def test_a_pair_whose_meshes_touch_over_nearly_the_whole_turn_is_left_out(joints: int, tmp_path: Path) -> None:
    """A gap of 20 deg, of which the cube fills 13: contact over 0.98 of the turn."""
    assert self_pairs(peg_in_disc(tmp_path, np.radians(20.0), joints=joints)).kept == ()


@pytest.mark.parametrize(
    ("hole", "why"),
    [
        (0.104, "touch at turn"),
        (0.15, "cannot meet over the range of turn, though their convex pieces overlap"),
    ],
)
def test_a_wheel_in_a_hole_that_its_hull_closes_is_left_out(hole: float, why: str, tmp_path: Path) -> None:
    """A wheel of 0.1 m radius with a play of 4 mm or 50 mm; otherwise the machine could never move."""
    trimesh.creation.annulus(hole, 0.3, 0.1, sections=96).export(tmp_path / "ring.stl")
    ring = '<link name="ring"><collision><geometry><mesh filename="ring.stl"/></geometry></collision></link>'
    wheel = (
        '<link name="wheel"><collision><geometry><cylinder radius="0.1" length="0.08"/></geometry></collision></link>'
    )
    robot = machine(tmp_path, ring, wheel, joint("turn", "ring", "wheel", kind="continuous"), tip="wheel")
    assert self_pairs(robot).kept == ()
    assert [pair.why for pair in self_pairs(robot).left_out] == [why]


def test_copies_that_differ_in_nothing_relevant_share_their_pairs(tmp_path: Path) -> None:
    """A tracking error of hinges changes no pair; a range that ends before the post at 1.25 rad does."""
    robot = swept_post(tmp_path, post_at=f"{np.cos(1.25):.6f} {np.sin(1.25):.6f} 0.05", limits=(-2.0, 2.0))
    assert self_pairs(replace(robot, tube=TrackingTube(np.array([0.01])))) is self_pairs(robot)
    narrow = replace(robot, limits=replace(robot.limits, upper=np.array([1.0])))
    assert (len(self_pairs(robot).kept), len(self_pairs(narrow).kept)) == (1, 0)
