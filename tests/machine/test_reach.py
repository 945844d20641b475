"""Travel bounds: no point of the machine moves further, and some move exactly so far."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Kinematics, Robot, load_robot, tip_travel_bound, travel_bounds


def placed_hulls(robot: Robot, q: Vector) -> list[Vector]:
    """The hull points of every piece in the world frame."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return [
        piece.piece.hull @ data.oMi[piece.joint].rotation.T + data.oMi[piece.joint].translation
        for piece in robot.pieces
    ]


SLIDER = """<robot name="slider"><link name="base"/>
<link name="post"/>
<link name="rod"><collision><origin xyz="0.5 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="hand"><collision><geometry><sphere radius="0.2"/></geometry></collision></link>
<link name="tip"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="post"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="post"/><child link="rod"/><origin xyz="1 0 5"/><axis xyz="1 0 0"/>
  <limit lower="-0.5" upper="2" effort="1" velocity="1"/></joint>
<joint name="wrist" type="revolute"><parent link="rod"/><child link="hand"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz="0.25 0 0"/></joint></robot>"""


@pytest.fixture(scope="module")
def slider(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path: Path = tmp_path_factory.mktemp("slider") / "slider.urdf"
    path.write_text(SLIDER)
    return load_robot(path)


def test_radii_of_planar_links_are_the_lengths_of_the_links_between(planar4: Robot) -> None:
    """A link's corner is 1 m out and 4 cm to the side (and 4 cm up, which counts beyond its own joint)."""
    own, further = np.hypot(1.0, 0.04), np.sqrt(1.0 + 2.0 * 0.04**2)
    expected = [
        [0.0, 0.0, 0.0, 0.0],
        [own, 0.0, 0.0, 0.0],
        [1.0 + further, own, 0.0, 0.0],
        [2.0 + further, 1.0 + further, own, 0.0],
        [3.0 + further, 2.0 + further, 1.0 + further, own],
    ]
    np.testing.assert_allclose(travel_bounds(planar4), expected, atol=1e-12)


def test_the_planar_tip_is_4_3_2_1_metres_from_the_axes(planar4: Robot) -> None:
    np.testing.assert_allclose(tip_travel_bound(planar4), [4.0, 3.0, 2.0, 1.0], atol=1e-12)


def test_radii_of_the_backhoe_tip_are_the_lengths_of_the_stretched_arm(backhoe: Robot) -> None:
    """The swing axis is vertical, the boom's foot is 0.535 m off it: its height does not count."""
    expected = [0.535 + 2.4 + 1.8 + 0.95, 2.4 + 1.8 + 0.95, 1.8 + 0.95, 0.95]
    np.testing.assert_allclose(tip_travel_bound(backhoe), expected, atol=1e-12)


def test_the_bound_of_the_tip_is_attained_by_the_stretched_arm(planar4: Robot) -> None:
    kinematics = Kinematics(planar4)
    speeds = np.linalg.norm(kinematics.at(np.zeros(4)).jacobian[:3], axis=0)
    np.testing.assert_allclose(speeds, tip_travel_bound(planar4), atol=1e-12)


def test_the_bound_of_a_link_about_its_own_joint_is_attained_by_its_corners(planar4: Robot) -> None:
    bounds, step = travel_bounds(planar4), 1e-6
    at_zero = placed_hulls(planar4, np.zeros(4))
    for link in range(1, 5):
        moved = placed_hulls(planar4, step * np.eye(4)[link - 1])[link]
        travelled = np.max(np.linalg.norm(moved - at_zero[link], axis=1))
        assert travelled / step == pytest.approx(bounds[link, link - 1], rel=1e-6)


def test_a_slide_moves_everything_beyond_it_by_its_own_travel(slider: Robot) -> None:
    """rod: sphere 0.1 at 0.5; hand: sphere 0.2 at 1; the slide starts at 1 and extends by 2."""
    expected = [
        [1.0 + 2.0 + 0.5 + 0.1, 1.0, 0.0],
        [1.0 + 2.0 + 1.0 + 0.2, 1.0, 0.2],
    ]
    np.testing.assert_allclose(travel_bounds(slider), expected, atol=1e-12)
    np.testing.assert_allclose(tip_travel_bound(slider), [1.0 + 2.0 + 1.0 + 0.25, 1.0, 0.25], atol=1e-12)


def test_the_bound_of_a_slide_is_attained_when_extended(slider: Robot) -> None:
    at = Kinematics(slider).at(np.array([0.0, 2.0, 0.0]))
    np.testing.assert_allclose(np.linalg.norm(at.jacobian[:3], axis=0), tip_travel_bound(slider), atol=1e-12)


@pytest.mark.parametrize("name", ["planar4", "backhoe", "ur5", "panda", "slider"])
@pytest.mark.parametrize("size", [0.01, 0.3, 2.0])
def test_no_point_of_any_piece_travels_further_than_the_bound(
    name: str, size: float, request: pytest.FixtureRequest
) -> None:
    robot: Robot = request.getfixturevalue(name)
    bounds, tip_bound = travel_bounds(robot), tip_travel_bound(robot)
    kinematics = Kinematics(robot)
    rng = np.random.default_rng(11)
    for _ in range(40):
        start = robot.random_q(rng)
        dq = np.clip(start + rng.uniform(-size, size, robot.n), robot.limits.lower, robot.limits.upper) - start
        before, after = placed_hulls(robot, start), placed_hulls(robot, start + dq)
        for row, (a, b) in enumerate(zip(before, after, strict=True)):
            assert np.max(np.linalg.norm(b - a, axis=1)) <= np.abs(dq) @ bounds[row] + 1e-12
        tip = kinematics.at(start + dq).tip_position - kinematics.at(start).tip_position
        assert np.linalg.norm(tip) <= np.abs(dq) @ tip_bound + 1e-12


def test_fixed_pieces_have_travel_bound_0(backhoe: Robot) -> None:
    bounds = travel_bounds(backhoe)
    still = [row for row, piece in enumerate(backhoe.pieces) if piece.joint == 0]
    assert still
    assert not np.any(bounds[still])


def test_travel_bounds_grow_with_a_slide_extended_beyond_its_limit(slider: Robot) -> None:
    """Extended to 3 m instead of 2, or to -4 m: the hinge's radii grow by the excess, the others stay."""
    inside = travel_bounds(slider)
    for slides, more in (([3.0], 1.0), ([-4.0], 2.0), ([-0.7, 1.9], 0.0)):
        q = np.array([[0.3, slide, 0.1] for slide in slides])
        np.testing.assert_allclose(travel_bounds(slider, q) - inside, [[more, 0, 0], [more, 0, 0]], atol=1e-12)
        np.testing.assert_allclose(tip_travel_bound(slider, q) - tip_travel_bound(slider), [more, 0, 0], atol=1e-12)
