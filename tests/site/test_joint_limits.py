"""The joints of a machine in a scene: which are held, and the limits of the others."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.errors import RobotError, SceneError
from backhoe_planner.machine import load_robot
from backhoe_planner.site import (
    input_warnings,
    limit_warnings,
    load_machine,
    machine_on_site,
    scaled_limits,
    scene_from_dict,
)

Data = dict[str, Any]
START = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
READY = {f"panda_joint{k}": q for k, q in enumerate((0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.8), start=1)}


def scene(joints: dict[str, float] = START, **keys: Any) -> bp.Scene:
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [4.0, 0.5, 0.5]}}}
    return scene_from_dict(content | keys, file=Path("site.yaml"))


def without(name: str) -> dict[str, float]:
    return {joint: q for joint, q in START.items() if joint != name}


# --- held joints ------------------------------------------------------------------


def test_the_planner_leaves_out_held_joints(backhoe: bp.Robot) -> None:
    problem = bp.build_problem(backhoe, scene(without("bucket"), hold={"bucket": -0.9}))
    assert problem.robot.joint_names == ("swing", "boom", "stick")
    assert problem.start_q is not None
    np.testing.assert_array_equal(problem.start_q, [0.0, 0.4, -1.6])
    again = bp.build_problem(problem.robot, problem.scene)
    assert again.robot.hold == {"bucket": -0.9}
    assert bp.build_problem(problem.robot, scene()).robot.joint_names == backhoe.joint_names


def test_start_may_name_a_held_joint_at_its_held_position(panda: bp.Robot) -> None:
    fingers = {"panda_finger_joint1": 0.04, "panda_finger_joint2": 0.04}
    problem = bp.build_problem(panda, scene(READY | fingers, hold={"panda_finger_joint1": 0.04}))
    assert problem.start_q is not None
    np.testing.assert_array_equal(problem.start_q, list(READY.values()))
    with pytest.raises(
        SceneError, match=r"site.yaml: start.joints.panda_finger_joint1: stands still.* at 0; found 0.04"
    ):
        bp.build_problem(panda, scene(READY | fingers))
    with pytest.raises(SceneError, match=r"start.joints.panda_finger_joint1: is held at 0.01; found 0.04"):
        bp.Servo(panda, scene(READY | fingers, hold={"panda_finger_joint1": 0.01}))


WRONG: dict[str, tuple[Data, str]] = {
    "unknown": ({"hold": {"bukket": 0.0}}, r"site.yaml: hold: .*no such joint; found bukket.*did you mean 'bucket'"),
    "outside": ({"hold": {"bucket": 3.0}}, r"site.yaml: hold.bucket: is outside of the joint's limits; found 3.0"),
    "gains": ({"hold": {"boom": 0.4}, "gains": {"s_k": {"boom": 0.1}}}, "gains.s_k: .*stands still at 0.4"),
    "tracking": ({"hold": {"boom": 0.4}, "tracking": {"joints": {"boom": 0.1}}}, "tracking.joints: .*still at 0.4"),
    "limited": ({"hold": {"boom": 0.4}, "limits": {"velocity": {"boom": 0.1}}}, "limits.velocity: .*still at 0.4"),
    "unknown rate": ({"limits": {"velocity": {"bom": 0.1}}}, r"site.yaml: limits.velocity: .*did you mean 'boom'"),
    "unknown effort": ({"limits": {"effort": {"bom": 0.1}}}, r"limits.effort: .*did you mean 'boom'"),
    "unknown range": ({"limits": {"position": {"bom": [0.0, 1.0]}}}, r"limits.position: .*did you mean 'boom'"),
    "unknown gain": ({"limits": {"acceleration": {"bom": 0.1}}}, r"limits.acceleration: .*did you mean 'boom'"),
    "faster": ({"limits": {"velocity": {"swing": 0.9}}}, "limits.velocity.swing: .*found 0.9; allowed: at most 0.8"),
    "stronger": ({"limits": {"effort": {"boom": 9.1e4}}}, "limits.effort.boom: .*found 91000.0.*at most 90000"),
    "wider": ({"limits": {"position": {"boom": [-2.0, 1.0]}}}, r"limits.position.boom: is wider .*found \[-2.0, 1.0\]"),
}


@pytest.mark.parametrize(("keys", "said"), WRONG.values(), ids=WRONG.keys())
def test_joints_and_limits_that_do_not_fit_the_machine_are_refused(backhoe: bp.Robot, keys: Data, said: str) -> None:
    joints = {name: q for name, q in START.items() if name not in keys.get("hold", {})}
    with pytest.raises(SceneError, match=said):
        bp.build_problem(backhoe, scene(joints, **keys))
    if "gains" not in keys:  # the servo has no gains
        with pytest.raises(SceneError, match=said):
            bp.Servo(backhoe, scene(joints, **keys))


def test_a_range_must_rise_from_low_to_high() -> None:
    with pytest.raises(SceneError, match=r"limits.position.boom: low is not below high: \[0.5, 0.5\] .*hold"):
        scene(limits={"position": {"boom": [0.5, 0.5]}})


def test_an_open_finger_collides_where_a_closed_one_does_not(panda: bp.Robot) -> None:
    """A rod beside the hand, 5 cm off its middle, where the open finger is."""
    at = bp.Kinematics(panda).at(np.array(list(READY.values())))
    rod = (at.tip_position + at.tip_rotation @ np.array([0.0, 0.05, -0.01])).tolist()
    obstacles = [{"name": "rod", "shape": "sphere", "radius": 0.005, "position": rod, "clearance": 0.0}]
    kept = {"task": {"path": {"waypoints": [{"position": at.tip_position.tolist()}, {"position": [0.5, 0.2, 0.6]}]}}}
    verdicts = {}
    for opening in (0.0, 0.04):
        site = scene(READY, hold={"panda_finger_joint1": opening}, obstacles=obstacles, **kept)
        found = bp.plan(panda, site, method="reactive", effort="quick")
        verdicts[opening] = found.reason
        nearest = [entry for entry in found.certificate.clearances if entry.obstacle == "rod"]
        assert (nearest[0].distance > 0.0) == (opening == 0.0)
    assert verdicts[0.04] == "start_in_collision"
    assert verdicts[0.0] != "start_in_collision"


def test_a_swing_sector_does_not_limit_the_boom_when_the_swing_is_held(backhoe: bp.Robot) -> None:
    sector = {"name": "road", "kind": "swing_sector", "from": -0.5, "to": 0.5, "stop": 0.1, "slow": 0.2}
    held = scene(without("swing"), hold={"swing": 0.3}, zones=[sector])
    problem = bp.build_problem(backhoe, held)
    assert problem.robot.joint_names[0] == "boom"
    np.testing.assert_array_equal(problem.limits.lower, backhoe.limits.lower[1:])
    motion = bp.Trajectory.from_steps(np.array([0.0, 1.0]), np.array([[0.4, -1.6, -0.9]] * 2))
    assert bp.zone_log(backhoe, held, motion) == ()
    assert bp.Servo(backhoe, held).step([0.1, 0.0, 0.0]).q.shape == (3,)
    with pytest.raises(SceneError, match=r"zones\[0\] \(road\): the first joint is held outside of it; found 0.45"):
        bp.build_problem(backhoe, scene(without("swing"), hold={"swing": 0.45}, zones=[sector]))


# --- limits -----------------------------------------------------------------------


def test_the_scenes_limits_replace_those_of_the_machine(backhoe: bp.Robot) -> None:
    own = {
        "velocity": {"swing": 0.5},
        "effort": {"boom": 6e4},
        "position": {"stick": [-2.2, -0.4]},
        "acceleration": {"boom": 0.3},
        "velocity_scale": 0.5,
    }
    problem = bp.build_problem(backhoe, scene(limits=own))
    limits = problem.limits
    np.testing.assert_allclose(limits.velocity, 0.5 * np.array([0.5, *backhoe.limits.velocity[1:]]))
    np.testing.assert_array_equal(limits.effort, [backhoe.limits.effort[0], 6e4, *backhoe.limits.effort[2:]])
    assert (limits.lower[2], limits.upper[2]) == (-2.2, -0.4)
    assert (problem.robot.limits.lower[2], problem.robot.limits.upper[2]) == (-2.2, -0.4)
    np.testing.assert_array_equal(np.delete(limits.lower, 2), np.delete(backhoe.limits.lower, 2))
    assert limits.acceleration[1] == 0.3


URDF = """<robot name="tiny"><link name="base"/>
<link name="arm"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="hand"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" velocity="0"/><safety_controller k_velocity="1" soft_lower_limit="-0.5"/></joint>
<joint name="spin" type="continuous"><origin xyz="1 0 0"/><parent link="arm"/><child link="hand"/>
  <axis xyz="0 0 1"/></joint></robot>"""


@pytest.fixture
def unlimited(tmp_path: Path) -> bp.Robot:
    (tmp_path / "tiny.urdf").write_text(URDF)
    return load_robot(tmp_path / "tiny.urdf")


def test_defaults_for_limits_missing_in_the_urdf_are_reported(unlimited: bp.Robot) -> None:
    np.testing.assert_array_equal(unlimited.limits.velocity, [1.0, 1.0])
    np.testing.assert_array_equal(unlimited.limits.effort, [np.inf, np.inf])
    velocity, effort, soft, mass = limit_warnings(unlimited)
    assert "no velocity limit, or 0, for turn, spin: 1 rad/s is assumed" in velocity
    assert "limits: {velocity: {turn: ...}}" in velocity
    assert "no effort limit, or 0, for turn, spin" in effort
    assert "limits: {position: {turn: [-0.5, 1.0]}}" in soft
    assert "no link that moves has a mass" in mass


def test_the_scene_can_give_limits_missing_in_the_urdf(unlimited: bp.Robot) -> None:
    """Full rate is reached in half a second, as with the rates of a URDF."""
    given = {"velocity": {"turn": 3.0, "spin": 0.2}, "effort": {"turn": 7.0}, "position": {"turn": [-0.5, 1.0]}}
    own = scene({"turn": 0.0, "spin": 0.0}, limits=given | {"position": {"turn": [-0.5, 1.0], "spin": [2.0, 4.0]}})
    limits = scaled_limits(machine_on_site(unlimited, own), own)
    np.testing.assert_array_equal(limits.velocity, [3.0, 0.2])
    np.testing.assert_allclose(limits.acceleration, [6.0, 0.4])
    np.testing.assert_array_equal(limits.effort, [7.0, np.inf])
    np.testing.assert_array_equal([limits.lower, limits.upper], [[-0.5, 2.0], [1.0, 4.0]])
    effort, _ = limit_warnings(unlimited, own)
    assert "no effort limit, or 0, for spin" in effort
    assert len(limit_warnings(machine_on_site(unlimited, scene(hold={"spin": 1.0})), own)) == 1


@pytest.mark.parametrize(("some", "said"), [(["hand"], "arm"), (["arm"], "hand"), (["arm", "hand"], None)])
def test_a_link_that_moves_without_a_mass_is_told_where_others_have_one(
    tmp_path: Path, some: list[str], said: str | None
) -> None:
    body = '<inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    text = URDF
    for name in some:
        text = text.replace(f'<link name="{name}">', f'<link name="{name}">{body}')
    (tmp_path / "tiny.urdf").write_text(text)
    found = [warning for warning in limit_warnings(load_robot(tmp_path / "tiny.urdf")) if "mass" in warning]
    assert [warning.split(": no mass in the URDF, unlike ")[0] for warning in found] == ([] if said is None else [said])


@pytest.mark.parametrize(
    ("moments", "said"),
    [
        ((1.0, 1.0, 2.0), None),  # a plate
        ((0.0, 1.0, 1.0), None),  # a thin rod
        ((0.0, 0.0, 0.0), None),  # all of the mass in one point
        ((1.0, 2.5, 1.0), "1, 1 and 2.5 kg m^2"),
        ((0.01, 0.0, 0.0), "0, 0 and 0.01 kg m^2"),
    ],
)
def test_moments_of_inertia_that_no_body_has_give_a_warning(
    tmp_path: Path, moments: tuple[float, float, float], said: str | None
) -> None:
    ixx, iyy, izz = moments
    inertia = f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/>'
    body = f'<link name="hand"><inertial><mass value="2"/>{inertia}</inertial>'
    (tmp_path / "tiny.urdf").write_text(URDF.replace('<link name="hand">', body))
    found = [warning for warning in limit_warnings(load_robot(tmp_path / "tiny.urdf")) if "moments" in warning]
    assert len(found) == (said is not None)
    assert all(warning.startswith("hand ") and said is not None and said in warning for warning in found)


@pytest.mark.parametrize(("scale", "said"), [(1.0, None), (20.0, None), (1000.0, "5,875 m long")])
def test_a_machine_in_millimetres_gives_a_warning(
    tmp_path: Path, backhoe: bp.Robot, scale: float, said: str | None
) -> None:
    """From the swing 0.725 m to the boom's foot, then 2.4 m, 1.8 m, and 0.95 m to the teeth."""
    urdf = ET.parse(backhoe.urdf.path)
    for origin in urdf.iterfind("joint/origin"):
        origin.set("xyz", " ".join(str(scale * float(part)) for part in origin.get("xyz", "0 0 0").split()))
    urdf.write(tmp_path / "long.urdf")
    found = [warning for warning in limit_warnings(load_robot(tmp_path / "long.urdf")) if " long " in warning]
    assert len(found) == (said is not None)
    assert all(said is not None and said in warning for warning in found)


def test_cylinders_give_the_effort_limits_missing_in_the_urdf(tmp_path: Path, backhoe: bp.Robot) -> None:
    bare = tmp_path / "bare.urdf"
    bare.write_text(backhoe.urdf.path.read_text().replace('effort="90000"', 'effort="0"'))
    assert len(limit_warnings(load_robot(bare))) == 1
    assert backhoe.hydraulics is not None
    assert limit_warnings(load_robot(bare, hydraulics=backhoe.hydraulics.file)) == ()
    assert limit_warnings(backhoe) == ()


def test_a_mimic_joint_that_would_move_the_tip_needs_its_leader_held(panda: bp.Robot) -> None:
    """The other finger mimics the one that would move the tip."""
    tip = {"tip": "panda_leftfinger"}
    with pytest.raises(RobotError, match="copies joint 'panda_finger_joint1', which moves the tip"):
        load_machine("example:panda", scene(READY, **tip))
    robot = load_machine("example:panda", scene(READY, hold={"panda_finger_joint1": 0.02}, **tip))
    assert robot.joint_names == panda.joint_names


def test_an_acceleration_that_may_be_meant_in_degrees_gives_a_warning(backhoe: bp.Robot) -> None:
    """The swing's own is 0.5 rad/s^2; 30 degrees are 0.5236 rad."""
    said = "limits.acceleration.swing: 30 rad/s^2 are 60 times the 0.5 of the machine; 30 deg/s^2 are 0.5236 rad/s^2"
    doubtful = scene(limits={"acceleration": {"swing": 30.0, "boom": 1.0}})
    assert input_warnings(backhoe, doubtful) == (said,)
    assert input_warnings(backhoe, doubtful, is_planned=True) == ()
    assert input_warnings(backhoe, scene(limits={"acceleration": {"swing": 9.0}})) == ()


def test_held_joints_that_make_the_machine_collide_with_itself_are_refused(panda: bp.Robot) -> None:
    """Panda's forearm is folded back beside the shoulder as far as it goes, and its wrist turned into the shoulder."""
    inward = {"panda_joint3": 1.91, "panda_joint4": -3.07, "panda_joint5": -0.78, "panda_joint6": 0.28}
    joints = {name: q for name, q in READY.items() if name not in inward}
    with pytest.raises(SceneError, match=r"site.yaml: hold: puts panda_\w+ into panda_link\d; found an overlap of"):
        bp.build_problem(panda, scene(joints, hold=inward))
