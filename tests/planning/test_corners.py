"""Corners rounded within the tolerance."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.machine import BatchKinematics
from backhoe_planner.motion import FastestRun, Problem, build_problem
from backhoe_planner.planning import Brake, Stretch, resolve_along, round_corners, time_stretch
from backhoe_planner.planning.stretches import corners
from validation.habitats import load_machine
from validation.independent_check import refutations
from validation.sites import SiteKey, random_site

TOLERANCE = 0.005


def arc(bend: float) -> bp.Scene:
    """Three legs of half a metre, with a bend of `bend` [rad] between them."""
    points = [np.array([4.0, -0.8, 0.2])]
    for leg in range(3):
        heading = 0.5 * np.pi + (leg - 1) * bend
        points.append(points[-1] + 0.5 * np.array([np.cos(heading), np.sin(heading), 0.0]))
    path = {"waypoints": [{"position": point.tolist()} for point in points], "tolerance": TOLERANCE}
    return bp.scene_from_dict({"version": 1, "task": {"path": path}})


@pytest.mark.parametrize("bend", [0.07, *(pytest.param(bend, marks=pytest.mark.long) for bend in (0.1, 0.5)), 1.5])
def test_a_corner_is_cut_by_two_fifths_of_the_tolerance(backhoe: bp.Robot, bend: float) -> None:
    problem = build_problem(backhoe, arc(bend))
    assert problem.path is not None
    proximity, kinematics = bp.Proximity(backhoe, problem.obstacles), bp.Kinematics(backhoe)
    start = bp.plan(backhoe, arc(bend), method="reactive").trajectory.q[0]
    law = resolve_along(problem, problem.path, 0.0, start, proximity=proximity, kinematics=kinematics)
    assert law.obstruction is None
    rounded, left = round_corners(problem, problem.path, law, proximity=proximity)
    assert left.size == 0
    assert np.all(np.diff(rounded.stations) > 0.0)
    tips = np.array([kinematics.at(joints).tip_position for joints in rounded.q])
    # a parabola is off its corner by half its height: 0.4 of the tolerance was requested
    for corner in problem.path.points[1:-1]:
        assert np.min(np.linalg.norm(tips - corner, axis=1)) == pytest.approx(0.4 * TOLERANCE, rel=0.05)
    off = [problem.path.nearest(tip)[1] for tip in tips]
    assert max(off) <= 0.4 * TOLERANCE + 1e-6
    # no kink is left: each step turns the tip by a part of the bend only
    steps = np.diff(tips, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    turns = np.arccos(np.clip(np.sum(steps[:-1] * steps[1:], axis=1), -1.0, 1.0))
    assert np.max(turns) < 0.35 * bend


def test_a_reversal_of_the_path_remains_a_stop(planar4: bp.Robot) -> None:
    path = {"waypoints": [{"position": [2.0, y, 0.0]} for y in (-0.3, 0.3, -0.3)]}
    scene = bp.scene_from_dict({"version": 1, "task": {"path": path}})
    problem = build_problem(planar4, scene)
    assert problem.path is not None
    stations = np.linspace(0.0, 1.2, 61)
    q = np.zeros((61, 4))
    same, left = round_corners(problem, problem.path, Stretch(stations, q), proximity=bp.Proximity(planar4))
    np.testing.assert_array_equal(same.stations, stations)
    np.testing.assert_array_equal(same.q, q)
    np.testing.assert_allclose(left, [0.6])


@pytest.mark.long
def test_waypoints_half_a_micrometre_apart_before_a_corner_are_followed(backhoe: bp.Robot) -> None:
    """The direction is taken 1 um from a waypoint, here beyond the next one, so that the first seems to bend."""
    points = [[4.0, 0.0, 0.0], [4.0, 0.5, 0.0], [4.0, 0.5 + 5e-7, 0.0], [3.6, 0.5, 0.0]]
    path = {"waypoints": [{"position": point} for point in points]}
    scene = bp.scene_from_dict({"version": 1, "task": {"path": path}})
    problem = build_problem(backhoe, scene)
    assert problem.path is not None
    assert problem.path.corners(corners.SHARP)[0] == pytest.approx(0.5, abs=1e-9)
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message


@pytest.mark.parametrize(
    "points",
    [
        [{"position": [4.0, 0.0, 0.0], "pitch": -1.6}] * 2,
        [{"position": [4.0, 0.0, 0.0]}, {"position": [4.0, 1e-12, 0.0]}],
    ],
)
def test_a_path_without_length_is_refused(backhoe: bp.Robot, points: list[dict[str, Any]]) -> None:
    scene = bp.scene_from_dict({"version": 1, "task": {"path": {"waypoints": points}}})
    with pytest.raises(bp.SceneError, match=r"task\.path: the waypoints all lie in one point"):
        bp.plan(backhoe, scene)


@pytest.mark.long
def test_a_fine_polyline_has_no_stops(backhoe: bp.Robot) -> None:
    """9 points on an arc: the tip stops only at the ends."""
    points = [[4.0 * np.cos(a), 4.0 * np.sin(a), 0.3] for a in np.linspace(-0.4, 0.4, 9)]
    path = {"waypoints": [{"position": point} for point in points]}
    found = bp.plan(backhoe, bp.scene_from_dict({"version": 1, "task": {"path": path}}), effort="quick")
    assert found.verified
    rates = np.max(np.abs(found.trajectory.segment_velocities()), axis=1)
    inside = (found.trajectory.time[1:] > 1.5) & (found.trajectory.time[1:] < found.trajectory.duration - 1.5)
    assert np.min(rates[inside]) > 0.05
    assert found.certificate.tracking.max_error < TOLERANCE


# --- timed from stop to stop ---------------------------------------------------------------


def zigzag(robot: bp.Robot, teeth: int) -> tuple[Problem, Stretch]:
    """The first joint moves to and fro by 0.02 rad: the joints along the path, with a stop at each end of a tooth."""
    near = np.array([0.3, -0.6, 0.5, 0.2])
    q = near + 0.02 * np.column_stack((np.arange(2 * teeth + 1) % 2, *np.zeros((3, 2 * teeth + 1))))
    tips = [bp.Kinematics(robot).at(row).tip_position.tolist() for row in q]
    path = {"waypoints": [{"position": tip} for tip in tips]}
    problem = build_problem(robot, bp.scene_from_dict({"version": 1, "task": {"path": path}}))
    assert problem.path is not None
    return problem, Stretch(problem.path.stations, q)


def test_a_stretch_that_ends_where_it_begins_takes_no_motion(planar4: bp.Robot) -> None:
    problem, stretch = zigzag(planar4, 2)
    assert problem.path is not None
    assert time_stretch(problem, problem.path, Stretch(stretch.stations[:1], stretch.q[:1])) == []


@pytest.mark.parametrize(("brake", "most"), [(Brake(), 1000 + 40 * 40), (Brake(-1.0), 40 * 40)])
def test_motions_between_stops_share_the_intervals_of_one_motion(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, brake: Brake, most: int
) -> None:
    """40 motions share 1,000 intervals, and have at least 40 each; only these if no time is left."""
    problem, stretch = zigzag(planar4, 20)
    counted: list[int] = []

    def counting(*args: Any, intervals: int, **keys: Any) -> FastestRun:
        counted.append(intervals)
        return FastestRun(*args, intervals=intervals, **keys)

    monkeypatch.setattr(corners, "FastestRun", counting)
    assert problem.path is not None
    found = time_stretch(problem, problem.path, stretch, brake=brake)
    assert len(found) == 40
    assert sum(counted) <= most
    # 0.02 rad from rest to rest at the joint's acceleration a take at least 2 sqrt(0.02 / a)
    least = 2.0 * float(np.sqrt(0.02 / problem.limits.acceleration[0]))
    for motion in found:
        assert least <= motion.duration < 1.1 * least


def off_leg(place: Vector, begin: Vector, end: Vector) -> float:
    """The distance of a point from a straight segment [m]."""
    leg = end - begin
    part = min(max(float((place - begin) @ leg / (leg @ leg)), 0.0), 1.0)
    return float(np.linalg.norm(place - begin - part * leg))


def test_how_far_segments_are_off_the_corners_that_they_pass_is_found_as_one_by_one(planar4: bp.Robot) -> None:
    """Steps of joints that cut the corners of a zigzag by far, by little, or not at all."""
    rng = np.random.default_rng(3)
    problem, stretch = zigzag(planar4, 5)
    path, kinematics, seen = problem.path, BatchKinematics(planar4), []
    assert path is not None
    for spread, every in ((1e-4, 1), (1e-3, 1), (1e-2, 1), (1e-3, 3)):
        q = stretch.q[::every] + spread * rng.normal(size=stretch.q[::every].shape)
        worst = 0.0
        for before, corner, after in zip(path.points, path.points[1:], path.points[2:], strict=False):
            for a, b in pairwise(kinematics.at(q).tip_position):
                if min(np.linalg.norm(a - corner), np.linalg.norm(b - corner)) < np.linalg.norm(b - a):
                    places = [a + part * (b - a) for part in np.arange(1, 8) / 8]
                    off = [min(off_leg(place, before, corner), off_leg(place, corner, after)) for place in places]
                    worst = max(worst, *off)
        found = corners._off_corners(kinematics, path, corners._passed_waypoints(path, stretch), q)
        assert found == pytest.approx(worst, rel=1e-9, abs=1e-12)
        seen.append(found)
    assert min(seen) < 1e-3
    assert max(seen) > 1e-2


# --- samples between samples ---------------------------------------------------------------


def test_a_sample_halfway_is_on_the_path_and_between_its_neighbours(planar4: bp.Robot) -> None:
    problem, stretch = zigzag(planar4, 3)
    assert problem.path is not None
    denser = corners.with_halfways(problem, problem.path, stretch)
    np.testing.assert_array_equal(denser.stations[::2], stretch.stations)
    np.testing.assert_array_equal(denser.q[::2], stretch.q)
    np.testing.assert_allclose(denser.stations[1::2], 0.5 * (stretch.stations[1:] + stretch.stations[:-1]))
    tips = np.array([bp.Kinematics(planar4).at(joints).tip_position for joints in denser.q])
    assert max(problem.path.nearest(tip)[1] for tip in tips) < 1e-6
    # on a chord of 0.02 rad the joints halfway are off the mean by some 0.02^2 / 8
    assert np.max(np.abs(denser.q[1::2] - 0.5 * (stretch.q[1:] + stretch.q[:-1]))) < 0.02**2


def test_samples_with_equal_joints_get_no_sample_between_them(planar4: bp.Robot) -> None:
    problem, stretch = zigzag(planar4, 1)
    assert problem.path is not None
    still = Stretch(stretch.stations[[0, 0, 1]], stretch.q[[0, 0, 1]])
    assert len(corners.with_halfways(problem, problem.path, still).q) == 4


@pytest.mark.long
def test_the_curve_keeps_its_clearance_at_the_end_of_a_turn_on_the_spot() -> None:
    """The samples have 0.9 mm to spare there; a cubic curve through them swung out by 2.3 mm and was not verified."""
    backhoe = load_machine("backhoe")
    found = bp.plan(backhoe, random_site(backhoe, SiteKey("backhoe", "scan", "path", 0, 6200)).scene, effort="quick")
    assert found.verified, found.message
    assert not refutations(found)
