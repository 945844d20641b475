"""Zones: in the scene file, for planner and certificate, for the servo, and in the log."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.errors import SceneError
from backhoe_planner.machine import Robot
from backhoe_planner.motion import Trajectory, build_problem
from backhoe_planner.site import (
    Box,
    HalfSpace,
    Proximity,
    Wall,
    ZoneLog,
    build_obstacles,
    pace,
    scaled_limits,
    worst_first,
    zone_log,
)

Data = dict[str, Any]

STANDING = [0.0, 0.3, -0.9, -0.5]  # the tip at (4.74, 0, -0.66)
LINE: Data = {"kind": "ceiling", "name": "power line", "height": 3.0, "stop": 0.2, "slow": 1.0, "warn": 1.5}
SECTOR: Data = {"kind": "swing_sector", "name": "road", "from": -0.6, "to": 1.0, "stop": 0.1, "slow": 0.3, "warn": 0.4}


def site(*zones: Data, q: list[float] = STANDING, **more: Any) -> bp.Scene:
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(("swing", "boom", "stick", "bucket"), q, strict=True))},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "zones": list(zones),
            **more,
        }
    )


# --- the scene file ----------------------------------------------------------------------


def test_every_kind_of_zone_becomes_the_solid_it_forbids(backhoe: Robot) -> None:
    scene = site(
        LINE,
        {"kind": "floor", "name": "main", "height": -2.0, "stop": 0.3, "links": ["bucket"]},
        {"kind": "wall", "name": "house", "from": [-3, 3], "to": [8, 3], "stop": 0.1},
        {"kind": "wall", "name": "fence", "point": [0, -4, 0], "normal": [0, 2, 0]},
        {"kind": "cab", "name": "cab", "size": [1, 2, 3], "position": [-1.5, 0, 2], "stop": 0.25},
        SECTOR,
    )
    built = {obstacle.name: obstacle for obstacle in build_obstacles(scene, backhoe)}
    assert list(built) == ["power line", "main", "house", "fence", "cab"]
    specs = {name: obstacle.spec for name, obstacle in built.items()}
    expected = {
        "power line": ((0, 0, 3.0), (0, 0, -1)),
        "main": ((0, 0, -2.0), (0, 0, 1)),
        "house": ((-3, 3, 0), (0, -1, 0)),  # facing the machine at the origin
        "fence": ((0, -4, 0), (0, 1, 0)),
    }
    for name, (point, normal) in expected.items():
        spec = specs[name]
        assert isinstance(spec, HalfSpace)
        assert [*spec.point, *spec.normal] == pytest.approx([*point, *normal])
    cab = specs["cab"]
    assert isinstance(cab, Box)
    assert (cab.size, cab.position) == ((1, 2, 3), (-1.5, 0, 2))
    assert [obstacle.clearance for obstacle in built.values()] == [0.2, 0.3, 0.1, 0.0, 0.25]
    assert built["main"].links == ("bucket",)
    assert built["power line"].slow == pytest.approx(0.8)
    assert built["house"].slow == 0.0


@pytest.mark.parametrize(
    ("start", "end"), [((-3, 3), (8, 3)), ((8, 3), (-3, 3)), ((2, -5), (6, 1)), ((-4, 0), (0, -4))]
)
def test_a_wall_of_two_points_faces_the_origin(start: tuple[float, float], end: tuple[float, float]) -> None:
    wall = Wall.model_validate({"kind": "wall", "name": "w", "from": start, "to": end})
    point, normal = (np.array(part) for part in wall.plane((0.0, 0.0)))
    assert -point @ normal > 0.0
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert (np.array([*end, 7.0]) - point) @ normal == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("y", "towards"), [(3.0, -1.0), (10.0, 1.0)])
def test_a_wall_of_two_points_faces_the_machines_base(backhoe: Robot, y: float, towards: float) -> None:
    road = {"kind": "wall", "name": "road", "from": [-3, 5], "to": [8, 5], "stop": 0.2}
    scene = bp.scene_from_dict(site(road).to_dict() | {"base": {"position": [0.0, y]}})
    (wall,) = build_problem(backhoe, scene).obstacles
    assert isinstance(wall.spec, HalfSpace)
    assert wall.spec.normal == pytest.approx((0.0, towards, 0.0))
    with pytest.raises(SceneError, match=r"zones\[0\].*through x 0, y 5.*point and normal"):
        bp.scene_from_dict(site(road).to_dict() | {"base": {"position": [0.0, 5.0]}})


WRONG: dict[str, tuple[list[Data], list[str]]] = {
    "unknown kind": ([{**LINE, "kind": "celing"}], ["zones[0]", "no kind 'celing'", "'ceiling'", "swing_sector"]),
    "no kind": ([{"name": "x"}], ["zones[0]", "kind is missing", "cab, ceiling, floor"]),
    "no height": ([{"kind": "floor", "name": "x"}], ["zones[0].height: is missing"]),
    "unknown key": ([{**LINE, "hight": 1}], ["zones[0].hight", "did you mean 'height'?", "warn"]),
    "links of a sector": ([{**SECTOR, "links": ["boom"]}], ["zones[0].links", "no such key"]),
    "slow within stop": ([{**LINE, "slow": 0.1}], ["zones[0]", "must not fall", "0.2, 0.1, 1.5"]),
    "negative": ([{**LINE, "stop": -0.1}], ["zones[0].stop", "greater than or equal to 0", "-0.1"]),
    "degrees": ([{**SECTOR, "from": -60, "to": 60}], ["zones[0]", "look like degrees"]),
    "no room": ([{**SECTOR, "to": -0.45}], ["zones[0]", "no room left"]),
    "half a wall": (
        [{"kind": "wall", "name": "x", "point": [1, 1, 1]}],
        ["zones[0]", "point and normal, or from and to"],
    ),
    "wall through the machine": (
        [{"kind": "wall", "name": "x", "from": [-1, -1], "to": [2, 2]}],
        ["zones[0]", "x 0, y 0"],
    ),
    "two of one name": ([LINE, {**SECTOR, "name": "power line"}], ["zones[1].name", "zones[0]", "power line"]),
    "flat cab": (
        [{"kind": "cab", "name": "x", "size": [1, 0, 1], "position": [0, 0, 0]}],
        ["zones[0].size[1]", "found 0"],
    ),
}


@pytest.mark.parametrize(("zones", "said"), WRONG.values(), ids=WRONG.keys())
def test_errors_in_a_zone_name_the_key(zones: list[Data], said: list[str]) -> None:
    with pytest.raises(SceneError) as caught:
        site(*zones)
    for fragment in said:
        assert fragment in str(caught.value)


def test_zones_that_do_not_fit_the_machine_are_refused(backhoe: Robot) -> None:
    with pytest.raises(SceneError, match=r"zones\[0\] \(power line\).links.*bom.*boom"):
        build_problem(backhoe, site({**LINE, "links": ["bom"]}))
    with pytest.raises(SceneError, match=r"zones\[0\] \(road\).*no room.*swing moves from"):
        scaled_limits(backhoe, site({**SECTOR, "from": 1.5, "to": 3.0}))


# --- planner and certificate ---------------------------------------------------------------


def test_a_swing_sector_limits_the_first_joint(backhoe: Robot) -> None:
    problem = build_problem(backhoe, site(SECTOR))
    for limits in (problem.limits, problem.robot.limits):
        assert (limits.lower[0], limits.upper[0]) == pytest.approx((-0.5, 0.9))
        assert limits.upper[1] == backhoe.limits.upper[1]
    away = Trajectory.from_steps(np.linspace(0.0, 8.0, 100), np.linspace(STANDING, [-0.55, 0.3, -0.9, -0.5], 100))
    assert any(
        "swing exceeds its position limit" in problem for problem in bp.certify(backhoe, site(SECTOR), away).problems
    )


def test_a_plan_keeps_the_stop_distance_and_the_log_reports_the_warn_distance(backhoe: Robot) -> None:
    low = {"kind": "ceiling", "name": "pipe bridge", "height": 3.2, "stop": 0.3, "warn": 3.0}
    scene = site(low, SECTOR, task={"goal": {"position": [4.2, 1.8, 0.6]}})
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    kept = {clearance.obstacle: clearance.distance for clearance in plan.certificate.clearances}
    assert kept["pipe bridge"] >= 0.3 - 2e-4
    visits = worst_first(zone_log(backhoe, scene, plan.trajectory))
    assert [visit for visit in visits if visit.level == "stop"] == []
    assert "beyond the warn distance of pipe bridge" in str(visits[0])


# --- the servo -----------------------------------------------------------------------------


def test_the_pace_falls_smoothly_to_a_minimum_that_allows_leaving() -> None:
    assert [pace(1.0, 1.0), pace(2.0, 1.0), pace(0.0, 1.0), pace(-1.0, 1.0)] == [1.0, 1.0, 0.15, 0.15]
    assert pace(0.25, 0.5) == pytest.approx(0.575)  # halfway: the middle of 0.15 and 1
    falling = [pace(margin, 0.5) for margin in np.linspace(0.6, -0.1, 300)]
    assert np.all(np.diff(falling) <= 0.0)
    assert np.abs(np.diff(falling)).max() < 0.01


def test_the_servo_slows_down_and_stops_before_a_ceiling(backhoe: Robot) -> None:
    scene, free = site(LINE), site()
    servo, unhindered = bp.Servo(backhoe, scene, 0.005), bp.Servo(backhoe, free, 0.005)
    proximity = Proximity(backhoe, build_obstacles(scene, backhoe), self_collision=False)
    paces = []
    slower = False
    for _ in range(1400):
        state, other = servo.step([0.0, 0.0, 0.6]), unhindered.step([0.0, 0.0, 0.6])
        margin = float(np.min(proximity.distances(state.q) - proximity.clearance))
        assert margin >= 0.0
        if state.pace < 1.0:
            assert state.pace <= pace(margin, 0.8) + 0.05  # never much faster than the distance allows
            slower |= bool(np.linalg.norm(state.v) < 0.8 * np.linalg.norm(other.v))
        else:
            assert margin > 0.75
        paces.append(state.pace)
    assert slower
    assert paces[0] == 1.0
    assert paces[-1] < 0.3
    for _ in range(1200):  # it can leave
        state = servo.step([0.0, 0.0, -0.6])
    assert state.pace == 1.0
    assert state.tip_position[2] < 0.0


@pytest.mark.parametrize(("side", "end"), [(1.0, 0.9), (-1.0, -0.5)])
def test_the_servo_slows_down_and_stops_at_the_end_of_a_sector(backhoe: Robot, side: float, end: float) -> None:
    servo = bp.Servo(backhoe, site(SECTOR), 0.005)
    for _ in range(2000):
        state = servo.step(joint_velocity=[0.4 * side, 0.0, 0.0, 0.0])
        assert state.pace == pytest.approx(pace(side * (end - state.q[0]), 0.2), abs=0.02)
        assert side * (end - state.q[0]) >= -1e-9
    assert state.q[0] == pytest.approx(end, abs=0.02)


# --- the log -------------------------------------------------------------------------------


def test_the_log_of_a_swing_by_hand(backhoe: Robot) -> None:
    """Out at 0.1 rad/s from 0 to 0.95 and back: warn from 0.6, slow from 0.7, stop from 0.9."""
    time = np.linspace(0.0, 19.0, 1901)
    swing = 0.1 * np.minimum(time, 19.0 - time)
    log = ZoneLog(backhoe, site(SECTOR))
    levels = [log.note(float(t), [s, 0.3, -0.9, -0.5]).get("road") for t, s in zip(time, swing, strict=True)]
    assert [levels[k] for k in (0, 590, 610, 690, 710, 890, 910)] == [
        None,
        None,
        "warn",
        "warn",
        "slow",
        "slow",
        "stop",
    ]
    found = {visit.level: visit for visit in log.transgressions}
    assert len(log.transgressions) == 3
    for level, entered in (("warn", 6.0), ("slow", 7.0), ("stop", 9.0)):
        visit = found[level]  # type: ignore[index]
        assert [visit.begin, visit.end] == pytest.approx([entered, 19.0 - entered], abs=0.02)
        assert visit.depth == pytest.approx(0.1 * (9.5 - entered), abs=0.002)
        assert (visit.link, visit.kind, visit.zone) == ("swing", "swing_sector", "road")
        assert visit.time == pytest.approx(9.5, abs=0.02)


def test_the_log_measures_depth_from_the_deepest_link(backhoe: Robot) -> None:
    scene = site({**LINE, "height": 2.5})
    q = np.array([0.0, 0.8, -0.9, -0.5])
    distance = Proximity(backhoe, build_obstacles(scene, backhoe), self_collision=False).distances(q)
    log = ZoneLog(backhoe, scene)
    assert log.note(0.0, q) == {"power line": "stop" if distance.min() < 0.2 else "slow"}
    depth = {visit.level: visit.depth for visit in log.transgressions}
    assert depth["warn"] == pytest.approx(1.5 - distance.min())
    assert depth["slow"] == pytest.approx(1.0 - distance.min())


def test_trembling_at_the_edge_counts_as_one_visit(backhoe: Robot) -> None:
    log = ZoneLog(backhoe, site({**SECTOR, "slow": 0.1, "warn": 0.4}))
    for k in range(20):
        log.note(0.1 * k, [0.6 + 0.001 * (-1) ** k, 0.3, -0.9, -0.5])
    assert len(log.transgressions) == 1
    log.note(3.0, STANDING)
    log.note(4.0, [0.7, 0.3, -0.9, -0.5])
    assert [visit.begin for visit in log.transgressions] == pytest.approx([0.0, 4.0])


def test_without_zones_nothing_is_logged(backhoe: Robot) -> None:
    assert zone_log(backhoe, site(), Trajectory.from_steps(np.zeros(1), np.array([STANDING]))) == ()
