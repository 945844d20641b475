"""The specified path, evaluated by arc length."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import TipPath
from backhoe_planner.site import Waypoint


def corner() -> TipPath:
    """3 m along x, then 4 m along y."""
    return TipPath(
        [Waypoint(position=(0.0, 0.0, 0.0)), Waypoint(position=(3.0, 0.0, 0.0)), Waypoint(position=(3.0, 4.0, 0.0))]
    )


def test_stations_are_arc_lengths() -> None:
    path = corner()
    np.testing.assert_allclose(path.stations, [0.0, 3.0, 7.0])
    assert path.length == 7.0
    assert not path.asks_orientation


def test_position_and_direction_are_those_at_the_arc_length() -> None:
    path = corner()
    np.testing.assert_allclose(path(1.0), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(path(5.0), [3.0, 2.0, 0.0])
    np.testing.assert_allclose(path(1.0, 1), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(path(5.0, 1), [0.0, 1.0, 0.0])
    np.testing.assert_allclose(path(-1.0), [0.0, 0.0, 0.0])
    np.testing.assert_allclose(path(8.0), [3.0, 4.0, 0.0])


@pytest.mark.parametrize(
    ("point", "station", "distance"),
    [
        ([1.0, 0.5, 0.0], 1.0, 0.5),
        ([3.0, 1.0, 2.0], 4.0, 2.0),
        ([-3.0, 0.0, 4.0], 0.0, 5.0),
        ([3.0, 7.0, 0.0], 7.0, 3.0),
    ],
)
def test_the_nearest_point_of_a_path_has_a_station_and_a_distance(
    point: list[float], station: float, distance: float
) -> None:
    assert corner().nearest(np.array(point)) == pytest.approx((station, distance))


def test_the_nearest_point_of_a_part_of_a_path_is_within_the_part() -> None:
    path = corner()
    point = np.array([1.0, 0.0, 0.0])
    assert path.nearest(point, low=2.0) == pytest.approx((2.0, 1.0))
    assert path.nearest(point, low=0.0, high=0.5) == pytest.approx((0.5, 0.5))
    assert path.nearest(point, low=5.0, high=6.0) == pytest.approx((5.0, np.hypot(2.0, 2.0)))


def test_no_point_of_a_dense_raster_is_nearer_than_the_nearest_point() -> None:
    """On random paths, some of whose waypoints coincide, and within random parts of them."""
    rng = np.random.default_rng(5)
    for _ in range(15):
        corners = np.cumsum(0.2 * rng.normal(size=(8, 3)), axis=0)[rng.choice([0, 1, 2, 2, 3, 4, 5, 6, 7], 9)]
        path = TipPath([Waypoint(position=tuple(corner)) for corner in corners.tolist()])
        low, high = np.sort(rng.uniform(-0.1, 1.1, 2)) * path.length
        raster = np.linspace(max(low, 0.0), max(min(high, path.length), 0.0), 4000)
        places = np.array([path(float(s)) for s in raster])
        point = corners[4] + 0.1 * rng.normal(size=3)
        s, distance = path.nearest(point, low=float(low), high=float(high))
        away = np.linalg.norm(places - point, axis=1)
        step = float(raster[1] - raster[0])
        assert np.min(away) - step <= distance <= np.min(away) + 1e-12
        assert np.linalg.norm(path(s) - point) == pytest.approx(distance, abs=1e-12)
        assert low - 1e-12 <= s <= high + 1e-12


def test_the_nearest_point_is_the_same_with_bounds_of_the_distances() -> None:
    """They are never above the distances, and let legs be left out."""
    rng = np.random.default_rng(6)
    corners = 50.0 + np.cumsum(0.1 * rng.normal(size=(40, 3)), axis=0)
    path = TipPath([Waypoint(position=tuple(corner)) for corner in corners[rng.integers(0, 40, 60)].tolist()])
    points = corners[rng.integers(0, 40, 50)] + 0.02 * rng.normal(size=(50, 3))
    bounds = path.leg_bounds_unchecked(points)
    left_out = 0
    for point, own in zip(points, bounds, strict=True):
        s, distance = path.nearest(point)
        assert path.nearest_unchecked(point, 0.0, path.length, own) == (s, distance)
        assert np.min(own) <= distance
        for leg in range(len(own)):
            low, high = path.stations[[leg, leg + 1]].tolist()
            assert own[leg] <= path.nearest(point, low=low, high=high)[1]
        left_out += int(np.sum(own > distance))
    assert left_out > 0.4 * bounds.size


def test_pitch_is_interpolated() -> None:
    path = TipPath(
        [Waypoint(position=(0.0, 0.0, 0.0), pitch=-1.0), Waypoint(position=(2.0, 0.0, 0.0), pitch=(-2.2, -1.8))]
    )
    assert path.asks_orientation
    assert path.target(0.0).pitch == pytest.approx((-1.0, -1.0))
    assert path.target(1.0).pitch == pytest.approx((-1.6, -1.4))
    assert path.target(2.0).pitch == pytest.approx((-2.2, -1.8))


def test_pitch_turns_in_the_shorter_sense() -> None:
    """From 3 to -3 rad it turns by 2 pi - 6 over pi, not by 6 back over 0."""
    path = TipPath([Waypoint(position=(0.0, 0.0, 0.0), pitch=3.0), Waypoint(position=(1.0, 0.0, 0.0), pitch=-3.0)])
    pitch = path.target(0.5).pitch
    assert pitch is not None
    assert pitch == pytest.approx((np.pi, np.pi))


def test_a_range_of_pitch_opens_towards_a_waypoint_without_pitch() -> None:
    path = TipPath(
        [
            Waypoint(position=(0.0, 0.0, 0.0)),
            Waypoint(position=(1.0, 0.0, 0.0), pitch=-1.0),
            Waypoint(position=(3.0, 0.0, 0.0)),
        ]
    )
    assert path.target(0.0).pitch is None
    assert path.target(0.5).pitch == pytest.approx((-1.0 - np.pi / 2.0, -1.0 + np.pi / 2.0))
    assert path.target(1.0).pitch == pytest.approx((-1.0, -1.0))
    assert path.target(1.5).pitch == pytest.approx((-1.0 - np.pi / 4.0, -1.0 + np.pi / 4.0))
    assert path.target(3.0).pitch is None


def test_rotation_turns_evenly_about_one_axis() -> None:
    """From yaw 0 to yaw 90 deg: 30 deg after a third of the leg."""
    half = np.sqrt(0.5)
    path = TipPath(
        [
            Waypoint(position=(0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0)),
            Waypoint(position=(3.0, 0.0, 0.0), quaternion=(half, 0.0, 0.0, half)),
        ]
    )
    rotation = path.target(1.0).rotation
    assert rotation is not None
    np.testing.assert_allclose(rotation, pin.utils.rotate("z", np.pi / 6.0), atol=1e-12)


def test_a_rotation_at_one_end_holds_on_the_whole_leg() -> None:
    asked = Waypoint(position=(0.0, 0.0, 0.0), rpy=(0.1, 0.2, 0.3))
    path = TipPath([asked, Waypoint(position=(1.0, 0.0, 0.0))])
    rotation = path.target(0.7).rotation
    assert rotation is not None
    np.testing.assert_allclose(rotation, pin.rpy.rpyToMatrix(0.1, 0.2, 0.3))


def test_a_turn_on_the_spot_has_a_length() -> None:
    path = TipPath(
        [
            Waypoint(position=(1.0, 0.0, 0.0), pitch=-1.0),
            Waypoint(position=(1.0, 0.0, 0.0), pitch=-2.0),
            Waypoint(position=(2.0, 0.0, 0.0), pitch=-2.0),
        ]
    )
    turn = path.stations[1]
    assert turn > 0.1
    assert path.length == pytest.approx(turn + 1.0)
    np.testing.assert_allclose(path(turn / 2.0), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(path(turn / 2.0, 1), [0.0, 0.0, 0.0])
    assert path.target(turn / 2.0).pitch == pytest.approx((-1.5, -1.5))


def pose(x: float, y: float, z: float, pitch: float | tuple[float, float] | None = None) -> Waypoint:
    return Waypoint(position=(x, y, z), pitch=pitch)


def test_the_length_of_a_leg_is_the_longer_of_its_distance_and_its_turn() -> None:
    """0.25 m for each radian: with 2 rad, a leg of 1 m remains 1 m long, and one of 0.1 m becomes 0.5 m long."""
    path = TipPath(
        [pose(0.0, 0.0, 0.0, pitch=0.0), pose(1.0, 0.0, 0.0, pitch=2.0), pose(1.1, 0.0, 0.0, pitch=0.0)],
    )
    np.testing.assert_allclose(path.stations, [0.0, 1.0, 1.5])
    np.testing.assert_array_equal(path.turning, [False, True])
    assert path.turns
    assert path.arc(1.25) == pytest.approx(1.05)
    assert path.arc(path.length) == pytest.approx(1.1)
    assert not corner().turns
    assert corner().arc(5.0) == 5.0


def test_a_range_that_only_widens_on_the_spot_is_a_leg() -> None:
    """Its lower end turns by 0.4 rad. Without the leg, its first angle would not be required."""
    path = TipPath([pose(0.0, 0.0, 0.0, pitch=-1.0), pose(0.0, 0.0, 0.0, pitch=(-1.4, -0.6))])
    assert path.length == pytest.approx(0.25 * 0.4)
    assert path.target(0.0).pitch == (-1.0, -1.0)


def test_half_a_turn_has_the_sense_in_which_it_is_written() -> None:
    for written in (np.pi, -np.pi):
        path = TipPath([pose(0.0, 0.0, 0.0, pitch=-0.5), pose(0.0, 0.0, 0.0, pitch=-0.5 + written)])
        middle = path.target(0.5 * path.length).pitch
        assert middle is not None
        assert middle[0] == pytest.approx(-0.5 + 0.5 * written)


def test_a_requested_angle_takes_precedence_over_a_free_one_at_the_same_place() -> None:
    path = TipPath([pose(0.0, 0.0, 0.0, pitch=-1.0), pose(0.0, 0.0, 0.0), pose(1.0, 0.0, 0.0)])
    assert path.target(0.0).pitch == (-1.0, -1.0)
    assert path.target(0.1).pitch is None


def test_corners_are_where_the_tip_stops_to_turn_and_where_a_turn_reverses() -> None:
    """Not where a turn goes on."""
    path = TipPath(
        [
            pose(0.0, 0.0, 0.0, pitch=-1.0),
            pose(1.0, 0.0, 0.0, pitch=-1.0),
            pose(1.0, 0.0, 0.0, pitch=-1.4),
            pose(1.0, 0.0, 0.0, pitch=-2.0),
            pose(1.0, 0.0, 0.0, pitch=-1.6),
        ]
    )
    np.testing.assert_allclose(path.corners(0.1), [1.0, 1.25])


def test_places_on_a_path_are_described_by_waypoints() -> None:
    assert corner().describe(5.0) == "5.00 m"
    path = TipPath(
        [pose(0.0, 0.0, 0.0, pitch=-1.0), pose(1.0, 0.0, 0.0, pitch=-1.0), pose(1.0, 0.0, 0.0, pitch=-2.0)],
        numbers=[1, 3, 4],
    )
    assert path.describe(0.4) == "0.40 m behind waypoint 1"
    assert path.describe(1.0) == "waypoint 3"
    assert path.describe(1.125) == "28.6 deg behind waypoint 3"  # half of 1 rad
    assert path.describe(path.length) == "waypoint 4"
    assert path.describe_end() == "4"


@pytest.mark.parametrize(
    ("pitch", "station"),
    [(-1.0, 1.0), (-1.5, 1.125), (-2.0, 1.25)],
)
def test_the_station_of_the_tip_in_a_turn_follows_from_its_pitch(
    backhoe: bp.Robot, pitch: float, station: float
) -> None:
    path = TipPath([pose(2.6, 0.0, 0.3, pitch=-1.0), pose(3.6, 0.0, 0.3, pitch=-1.0), pose(3.6, 0.0, 0.3, pitch=-2.0)])
    target = bp.TipTarget(position=np.array([3.6, 0.0, 0.3]), pitch=(pitch, pitch))
    at = bp.Kinematics(backhoe).at(bp.solve_inverse_kinematics(backhoe, target).q)
    s, off, angle = path.place(at, low=0.0, high=path.length, slack=1e-4)
    assert s == pytest.approx(station, abs=1e-6)
    assert (off, angle) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_legs_that_are_skipped_do_not_change_the_station_of_the_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths that turn to and fro on the spot and move on, and tips near them."""
    robot, rng = bp.load_robot("example:panda", tip="panda_hand_tcp"), np.random.default_rng(5)
    kinematics = bp.Kinematics(robot)
    looked_at = 0
    part, plain = TipPath._nearest_part, lambda path, at: np.zeros(len(path.points) - 1)

    def counted(*args: Any) -> float:
        nonlocal looked_at
        looked_at += 1
        return part(*args)

    monkeypatch.setattr(TipPath, "_nearest_part", counted)
    counts = [0, 0]
    for _ in range(3):
        q = robot.random_q(rng)
        begin = kinematics.at(q)
        position, rotation, waypoints = begin.tip_position.copy(), begin.tip_rotation.copy(), []
        for number in range(24):
            turned = pin.Quaternion(rotation)
            quaternion = (turned.w, turned.x, turned.y, turned.z)
            waypoints.append(Waypoint(position=tuple(position.tolist()), quaternion=quaternion))
            position = position + (0.02 * rng.standard_normal(3) if number % 6 == 0 else 0.0)
            rotation = rotation @ pin.exp3(0.2 * rng.standard_normal(3))
        path = TipPath(waypoints)
        for _ in range(10):
            at = kinematics.at(q + 0.15 * rng.standard_normal(robot.n))
            found = []
            for kind in (0, 1):
                before = looked_at
                with monkeypatch.context() as patch:
                    if kind:
                        patch.setattr(TipPath, "_least_costs", plain)
                    found.append(path.place(at, low=0.0, high=path.length, slack=1e-4))
                counts[kind] += looked_at - before
            assert found[0] == found[1]
    assert counts[0] < 0.5 * counts[1]
