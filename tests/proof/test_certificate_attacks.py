"""Motions that break a condition unseen, as between samples: none is certified."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import Drive, build_problem, limit_usage
from backhoe_planner.proof import describe_ratio

START = [0.0, 0.4, -1.6, -0.9]


def scene(**changes: Any) -> bp.Scene:
    content: dict[str, Any] = {
        "version": 1,
        "start": {"joints": dict(zip(("swing", "boom", "stick", "bucket"), START, strict=True))},
        "task": {"goal": {"position": [0.0, 0.0, 0.0]}},
    }
    return bp.scene_from_dict(content | changes)


def goal_at(robot: bp.Robot, q: list[float]) -> dict[str, Any]:
    return {"goal": {"position": bp.Kinematics(robot).at(np.array(q)).tip_position.tolist()}}


def test_a_motion_must_begin_at_time_zero() -> None:
    """Before time 0 no obstacle would have appeared yet."""
    with pytest.raises(bp.InputError, match="does not start at 0"):
        bp.Trajectory(time=np.array([-1000.0, -999.0]), q=np.zeros((2, 4)), v=np.zeros((2, 4)))


@pytest.mark.parametrize("speed", [5.0, 5000.0])
def test_an_obstacle_that_passes_between_two_samples_is_found(backhoe: bp.Robot, speed: float) -> None:
    """From 50 m away through the machine at rest and away again, far away at both samples."""
    ball = {"name": "ball", "shape": "sphere", "radius": 1.0, "position": [50.0, 1.0, 1.0], "velocity": [-speed, 0, 0]}
    given = scene(task=goal_at(backhoe, START), obstacles=[ball])
    standing = bp.Trajectory.from_steps(np.array([0.0, 20.0]), np.array([START, START]))
    certificate = bp.certify(backhoe, given, standing)
    assert not certificate.verified
    assert certificate.min_clearance is not None
    assert certificate.min_clearance.margin < 0.0


@pytest.mark.parametrize(
    "obstacle",
    [
        {"shape": "box", "size": [4000.0, 4000.0, 4000.0], "position": [0.0, 0.0, 0.0]},
        {"shape": "sphere", "radius": 5000.0, "position": [0.0, 0.0, 0.0]},
        {"shape": "halfspace", "point": [0.0, 0.0, 2000.0], "normal": [0.0, 0.0, 1.0]},
    ],
)
def test_a_machine_deep_inside_an_obstacle_is_in_collision(backhoe: bp.Robot, obstacle: dict[str, Any]) -> None:
    given = scene(task=goal_at(backhoe, START), obstacles=[{"name": "rock", "clearance": 0.0} | obstacle])
    certificate = bp.certify(backhoe, given, bp.Trajectory.from_steps(np.zeros(1), np.array([START])))
    assert certificate.min_clearance is not None
    assert certificate.min_clearance.distance < -1000.0
    assert not certificate.verified


def test_the_distance_in_rough_ground_is_that_of_the_deepest_piece(backhoe: bp.Robot, tmp_path: Path) -> None:
    """The pieces of a terrain of many cells are measured until no other can be deeper."""
    x, y = np.meshgrid(np.linspace(-6.0, 6.0, 120), np.linspace(-6.0, 6.0, 120))
    heights = 0.7 * np.exp(-((x - 4.0) ** 2 + y**2)) + 0.02 * np.sin(7.0 * x) * np.cos(5.0 * y)
    np.savetxt(tmp_path / "ground.csv", heights, delimiter=",")
    ground = {"name": "ground", "shape": "heightmap", "file": str(tmp_path / "ground.csv"), "size": [12.0, 12.0]}
    rng, inside = np.random.default_rng(2), 0
    for _ in range(12):
        q = np.array([rng.uniform(-0.3, 0.3), rng.uniform(0.0, 0.6), rng.uniform(-2.0, -1.0), rng.uniform(-2.0, 0.0)])
        start = {"joints": dict(zip(backhoe.joint_names, q.tolist(), strict=True))}
        given = scene(task=goal_at(backhoe, q.tolist()), start=start, obstacles=[ground], clearance=0.1)
        proximity = bp.Proximity(backhoe, build_problem(backhoe, given).obstacles)
        deepest = float(np.min(proximity.distances(q)[proximity.owner >= 0]))
        if deepest > -0.01:
            continue
        inside += 1
        certificate = bp.certify(backhoe, given, bp.Trajectory.from_steps(np.zeros(1), q[None]))
        found = next(near for near in certificate.clearances if near.obstacle == "ground")
        assert deepest - 2e-4 <= found.distance <= deepest
    assert inside >= 4


def test_a_start_given_by_the_tip_is_checked_against_the_motion(backhoe: bp.Robot) -> None:
    standing = bp.Trajectory.from_steps(np.zeros(1), np.array([START]))
    tip = bp.Kinematics(backhoe).at(np.array(START)).tip_position.tolist()
    there = scene(task=goal_at(backhoe, START), start={"tip": {"position": tip}})
    assert bp.certify(backhoe, there, standing).verified
    elsewhere = scene(task=goal_at(backhoe, START), start={"tip": {"position": [4.0, -2.0, 0.5]}})
    assert "start of the scene" in bp.certify(backhoe, elsewhere, standing).problems[0]


def test_velocities_that_do_not_fit_the_motion_are_reported(backhoe: bp.Robot) -> None:
    given = scene(task=goal_at(backhoe, START))
    lying = bp.Trajectory(time=np.array([0.0, 1.0]), q=np.array([START, START]), v=np.full((2, 4), 1e6))
    assert any("velocities" in problem for problem in bp.certify(backhoe, given, lying).problems)


@pytest.mark.long
def test_a_corner_cut_between_two_samples_is_not_followed(backhoe: bp.Robot) -> None:
    """Both samples are on the path; the chord between them misses the corner by more than the tolerance."""
    corner = [[4.6, 0.0, -0.3], [4.6, 0.4, -0.3], [4.2, 0.4, -0.3]]
    given = scene(start=None, task={"path": {"waypoints": [{"position": p} for p in corner], "speed": 0.1}})
    whole = bp.plan(backhoe, given, effort="quick")
    assert whole.verified
    assert not whole.certificate.detours
    tips = whole.tip_path()
    at_corner = int(np.argmin(np.linalg.norm(tips - np.array(corner[1]), axis=1)))
    kept = np.delete(np.arange(len(tips)), np.arange(at_corner - 25, at_corner + 26))
    cut = bp.Trajectory.from_steps(whole.trajectory.time[kept], whole.trajectory.q[kept])
    certificate = bp.certify(backhoe, given, cut)
    assert certificate.detours or not certificate.verified


def test_going_back_along_the_last_leg_does_not_follow_a_closed_path(planar4: bp.Robot) -> None:
    """Three centimetres back along the last leg and home again are not the loop."""
    corners = [[2.0, 0.0, 0.0], [2.4, 0.0, 0.0], [2.4, 0.4, 0.0], [2.0, 0.4, 0.0], [2.0, 0.0, 0.0]]
    given = bp.scene_from_dict({"version": 1, "task": {"path": {"waypoints": [{"position": p} for p in corners]}}})
    q = [np.array([1.2, -1.0, -1.0, -0.5])]
    back = [*np.linspace(0.0, 0.03, 16), *np.linspace(0.03, 0.0, 16)[1:]]
    for y in back:
        target = bp.TipTarget(position=np.array([2.0, y, 0.0]))
        q.append(bp.solve_inverse_kinematics(planar4, target, start=q[-1]).q)
    steps = np.array(q[1:])
    tracking = bp.certify(planar4, given, bp.Trajectory.from_steps(np.linspace(0.0, 6.0, len(steps)), steps)).tracking
    assert tracking.followed < 0.2


def lifted(robot: bp.Robot, samples: int, *, duration: float = 1e5) -> tuple[bp.Scene, bp.Trajectory]:
    """The arm rises with a load that it can hold at both ends, but not stretched out level between them."""
    begin, end = np.array([0.0, -0.8, -1.2, 0.7]), np.array([0.0, 1.3, -0.3, 0.4])
    part = np.linspace(0.0, 1.0, samples)[:, None]
    q = begin + part**3 * (10.0 - 15.0 * part + 6.0 * part**2) * (end - begin)
    given = scene(
        start={"joints": dict(zip(robot.joint_names, begin.tolist(), strict=True))},
        task=goal_at(robot, end.tolist()), payload=1600.0,
    )  # fmt: skip
    return given, bp.Trajectory.from_steps(duration * part[:, 0], q)


@pytest.mark.parametrize("samples", [2, 7, *(pytest.param(n, marks=pytest.mark.long) for n in (3, 60))])
def test_a_load_that_cannot_be_held_between_two_samples_is_found(backhoe: bp.Robot, samples: int) -> None:
    """However few the samples, the report is that of many."""
    given, dense = lifted(backhoe, 2401)
    expected = bp.certify(backhoe, given, dense)
    (said,) = [problem for problem in expected.problems if "torque" in problem or "hold" in problem]
    assert said.startswith("boom cannot hold the load")
    ends = bp.certify(backhoe, given, bp.Trajectory.from_steps(np.zeros(1), dense.q[:1])).effort
    assert ends is not None
    assert ends.kept, "the load is held where the motion begins"
    found = bp.certify(backhoe, given, lifted(backhoe, samples)[1])
    assert found.effort is not None
    assert expected.effort is not None
    assert found.effort.joint == "boom"
    assert found.effort.ratio == pytest.approx(expected.effort.ratio, rel=2e-3)
    assert any(problem.startswith("boom cannot hold the load") for problem in found.problems)


def test_the_use_of_limits_includes_torques_between_samples(backhoe: bp.Robot) -> None:
    given, motion = lifted(backhoe, 2)
    problem = build_problem(backhoe, given)
    usage, certificate = limit_usage(problem, motion), bp.certify(backhoe, given, motion)
    assert certificate.effort is not None
    torque = usage.ratio[:, usage.names.index("torque boom")]
    assert torque.max() == certificate.effort.ratio
    assert usage.moments.time[int(np.argmax(torque))] == certificate.effort.time
    assert max(torque[0], torque[-1]) < 1.0 < torque.max()


def test_a_flow_beyond_the_pump_between_two_samples_is_found(backhoe: bp.Robot) -> None:
    """At a constant joint rate the rod is fastest somewhere between the samples."""
    begin, end = np.array([0.0, 1.1, -0.6, -0.9]), np.array([0.0, -1.05, -0.6, -0.9])
    drive = Drive(backhoe)
    rate = (end - begin) / 3.0
    q = begin + np.linspace(0.0, 3.0, 4001)[:, None] * rate
    expected = drive.flow_use(q, np.tile(rate, (len(q), 1)))
    assert 10 < int(np.argmax(expected)) < len(q) - 10
    motion = bp.Trajectory.from_steps(np.array([0.0, 3.0]), np.array([begin, end]))
    usage = limit_usage(build_problem(backhoe, scene(task=goal_at(backhoe, end.tolist()))), motion)
    found = usage.ratio[:, usage.names.index("pump flow")]
    assert float(np.max(found)) == pytest.approx(float(np.max(expected)), rel=1e-3)
    certified = bp.certify(backhoe, scene(task=goal_at(backhoe, end.tolist())), motion).hydraulics
    assert certified is not None
    assert certified.ratio >= float(np.max(found))


def test_moments_between_samples_equal_a_hand_calculation() -> None:
    """0.1 rad in 2 s are four parts of 0.025 rad, the second segment is one; corners are rounded off within 0.01 s."""
    motion = bp.Trajectory.from_steps(np.array([0.0, 2.0, 3.0]), np.array([[0.0, 1.0], [0.1, 0.95], [0.1, 0.96]]))
    moments = motion.moments()
    np.testing.assert_array_equal(moments.segment, [0, 0, 0, 0, 0, 0, 1, 1, 1, 2])
    np.testing.assert_allclose(moments.time, [0.0, 0.01, 0.505, 1.0, 1.495, 1.99, 2.0, 2.01, 2.99, 3.0])
    along = np.array([0.01, 0.505, 1.0, 1.495, 1.99])
    np.testing.assert_allclose(moments.q[1:6], np.column_stack((0.05 * along, 1.0 - 0.025 * along)))
    np.testing.assert_allclose(moments.v[1:6], [[0.05, -0.025]] * 5)
    np.testing.assert_allclose(moments.q[7:9], [[0.1, 0.9501], [0.1, 0.9599]])
    np.testing.assert_array_equal(moments.a[[1, 2, 3, 4, 5, 7, 8]], 0.0)
    of_samples = ((moments.q, motion.q), (moments.v, motion.v), (moments.a, motion.corner_accelerations()))
    for own, expected in of_samples:
        np.testing.assert_array_equal(own[[0, 6, 9]], expected)
    # the corners are 2 s, 1.5 s and 1 s apart, of which 0.02 s count
    np.testing.assert_allclose(moments.before[[6, 9], 0], [0.025 + (1.0 - 0.02 / 1.5) * 0.025, 0.0], atol=1e-15)
    np.testing.assert_allclose(moments.after[[0, 6], 0], [(1.0 - 0.02 / 2.0) * 0.05, 0.02 / 1.5 * 0.025])
    np.testing.assert_array_equal(motion.moments(longest=np.inf).q, motion.q)


def test_moments_between_samples_of_a_smooth_motion_have_its_acceleration() -> None:
    """q = 40 t^2 moves by more than 0.025 rad from sample to sample: v changes by 80 rad/s in a second throughout."""
    for period, expected in ((0.02, 80.0), (0.03, 0.5 * 120.0), (0.04, 0.0)):
        time = period * np.arange(12, dtype=np.float64)
        moments = bp.Trajectory.from_steps(time, 40.0 * time[:, None] ** 2).moments()
        inside = np.flatnonzero((moments.segment > 1) & (moments.segment < 9) & ~np.isin(moments.time, time))
        assert len(inside) > 10
        # from 0.02 s on, corners are rounded off within 0.02 s, and parts of the segments are straight
        np.testing.assert_allclose(moments.a[inside, 0], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("ratio", "said"),
    [(1.0123, "101.23 % of"), (1.491, "149 % of"), (12.3, "12 times"), (1e6, "more than 1000 times")],
)
def test_a_ratio_to_a_limit_is_described_in_words(ratio: float, said: str) -> None:
    assert describe_ratio(ratio) == said


# --- the requested speed of the tip -----------------------------------------------------

LINE = [np.array([2.6, 0.3, 0.0]), np.array([2.0, -0.3, 0.0])]


def along_line(robot: bp.Robot, samples: int, *, speed: float, tolerance: float) -> tuple[bp.Scene, bp.Trajectory]:
    """The tip moves along equal parts of a line at 0.2 m/s; the scene requests `speed`."""
    q = [np.array([0.9, -0.8, -0.8, -0.5])]
    for part in np.linspace(0.0, 1.0, samples):
        target = bp.TipTarget(position=LINE[0] + part * (LINE[1] - LINE[0]))
        q.append(bp.solve_inverse_kinematics(robot, target, start=q[-1]).q)
    path = {"waypoints": [{"position": p.tolist()} for p in LINE], "speed": speed, "tolerance": tolerance}
    given = bp.scene_from_dict({"version": 1, "task": {"path": path}})
    length = float(np.linalg.norm(LINE[1] - LINE[0]))
    return given, bp.Trajectory.from_steps(np.linspace(0.0, length / 0.2, samples), np.array(q[1:]))


@pytest.mark.parametrize(("asked", "kept"), [(0.2, True), (0.19, False)])
def test_a_tip_speed_above_the_requested_one_is_reported(planar4: bp.Robot, asked: float, kept: bool) -> None:
    given, motion = along_line(planar4, 200, speed=asked, tolerance=0.005)
    certificate = bp.certify(planar4, given, motion)
    use = certificate.tip_speed
    assert use is not None
    assert certificate.tracking.followed == pytest.approx(0.6 * np.sqrt(2.0), rel=0.01)
    assert use.needed == pytest.approx(0.2, rel=1e-6)
    assert (use.available, use.kept) == (asked, kept)
    assert use.ratio == pytest.approx(0.2 / asked, rel=1e-6)
    assert any("the asked" in problem for problem in certificate.problems) == (not kept)


def test_the_tip_speed_between_few_samples_equals_that_of_many(planar4: bp.Robot) -> None:
    """Not the mean speed, but that of the same motion with many samples on its straight segments."""
    given, motion = along_line(planar4, 4, speed=0.2, tolerance=0.2)
    time = np.unique(np.append(np.linspace(0.0, motion.duration, 3001), motion.time))
    dense = bp.certify(planar4, given, bp.Trajectory.from_steps(time, motion.at(time)))
    found = bp.certify(planar4, given, motion)
    assert found.tip_speed is not None
    assert dense.tip_speed is not None
    assert dense.tip_speed.needed > 0.201
    assert found.tip_speed.needed == pytest.approx(dense.tip_speed.needed, rel=0.01)


def test_a_path_without_a_speed_has_no_tip_speed_to_keep(planar4: bp.Robot) -> None:
    given, motion = along_line(planar4, 50, speed=0.2, tolerance=0.005)
    content = given.to_dict()
    del content["task"]["path"]["speed"]
    assert bp.certify(planar4, bp.scene_from_dict(content), motion).tip_speed is None


def test_a_plan_whose_file_requests_less_speed_is_not_verified(backhoe: bp.Robot, tmp_path: Path) -> None:
    points = [{"position": [4.6, 0.0, -0.3]}, {"position": [3.9, 0.0, -0.6]}]
    whole = bp.plan(backhoe, scene(start=None, task={"path": {"waypoints": points, "speed": 0.5}}), effort="quick")
    assert whole.verified
    assert whole.certificate.tip_speed is not None
    assert 0.99 < whole.certificate.tip_speed.ratio < 1.03
    whole.save(tmp_path / "plan.json")
    content = json.loads((tmp_path / "plan.json").read_text())
    assert content["certificate"]["limits"]["tip_speed"]["available"] == 0.5
    content["scene"]["task"]["path"]["speed"] = 0.4
    (tmp_path / "plan.json").write_text(json.dumps(content))
    again = bp.load_plan(tmp_path / "plan.json")
    assert not again.verified
    assert "125 % of the asked 0.4 m/s" in again.message


@pytest.mark.long
def test_on_the_approach_and_on_a_detour_the_tip_may_be_faster(backhoe: bp.Robot) -> None:
    stone = {"name": "stone", "shape": "sphere", "radius": 0.15, "position": [4.1, 0.0, -0.35]}
    path = {"waypoints": [{"position": [4.6, 0.0, -0.3]}, {"position": [3.6, 0.0, -0.6]}], "speed": 0.1}
    found = bp.plan(backhoe, scene(task={"path": path}, obstacles=[stone]), effort="quick")
    assert found.verified, found.message
    assert found.certificate.detours
    assert found.certificate.tip_speed is not None
    assert found.certificate.tip_speed.ratio < 1.03
    fastest = np.max(np.linalg.norm(np.diff(found.tip_path(), axis=0), axis=1) / np.diff(found.trajectory.time))
    assert fastest > 0.2
