"""One straight motion past one obstacle: a ball on a rail, whose distance is known at every moment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.proof import clearances, motion_is_clear, segment_is_clear
from backhoe_planner.proof.clearances import find_clearances

RAIL = """<robot name="rail"><link name="base"/>
<link name="ball"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="ball"/><axis xyz="1 0 0"/>
  <limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>"""
TOUCH = 0.04  # m between the centres: the ball has 0.01 m, every obstacle 0.03 m
DURATION = 10.0  # s
SPEED = 0.1  # m/s of an obstacle


def past(folder: Path, *, clearance: float, position: list[float], **keys: object) -> bp.Proximity:
    """The ball on the rail, along x, and a sphere."""
    path = folder / "rail.urdf"
    path.write_text(RAIL)
    robot = bp.load_robot(path, tip="ball")
    sphere = {"name": "post", "shape": "sphere", "radius": 0.03, "position": position, "clearance": clearance}
    idle = {"joints": {"slide": 0.0}}
    content = {"version": 1, "start": idle, "task": {"goal": idle}, "obstacles": [sphere | keys]}
    return bp.Proximity(robot, bp.build_obstacles(bp.scene_from_dict(content), robot))


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("begins", [0.0, 3.0])
@pytest.mark.parametrize("passes", [1.9, 5.0, 8.1])
def test_a_sphere_that_passes_a_ball_at_rest_is_found_at_any_moment(
    tmp_path: Path, passes: float, begins: float, measured: bool
) -> None:
    """It passes 0.06 m beside the ball's centre, 0.02 m away; at both ends of the motion it is 0.15 m away or more.

    `measured` is whether all distances are known where the motion begins.
    """
    still = np.array([0.3])
    for clearance, clear in ((0.01, True), (0.021, False)):
        y = -SPEED * (begins + passes)
        proximity = past(tmp_path, clearance=clearance, position=[0.36, y, 0.0], velocity=[0.0, SPEED, 0.0])
        proximity.at(still if measured else np.array([1.0]), time=begins)
        assert segment_is_clear(proximity, still, still, time=begins, dt=DURATION) is clear
        moments = np.array([begins, begins + DURATION])
        assert motion_is_clear(proximity, moments, np.array([still, still])) is clear


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("place", [-0.61, 0.0, 0.39])
def test_a_sphere_that_a_ball_passes_between_two_samples_is_found(tmp_path: Path, place: float, measured: bool) -> None:
    q = np.array([[-1.0], [1.0]])
    for clearance, clear in ((0.002, True), (0.021, False)):
        proximity = past(tmp_path, clearance=clearance, position=[place, 0.06, 0.0])
        proximity.at(q[0] if measured else np.array([1.5]), time=0.0)
        assert segment_is_clear(proximity, q[0], q[1]) is clear
        assert motion_is_clear(proximity, np.array([0.0, DURATION]), q) is clear


@pytest.mark.parametrize("length", [2, 9, 17, 18, 40, 700])
def test_a_ball_that_goes_out_and_back_at_any_one_sample_is_seen(tmp_path: Path, length: int) -> None:
    """The gap is 0.26 m at rest, and 0.01 m or 0.021 m at the one sample."""
    proximity = past(tmp_path, clearance=0.02, position=[0.3, 0.0, 0.0])
    moments = np.linspace(0.0, DURATION, length)
    for out in {0, 1, length // 2, *range(max(length - 10, 0), length)}:
        for reach, clear in ((0.25, False), (0.239, True)):
            q = np.zeros((length, 1))
            q[out] = reach
            assert motion_is_clear(proximity, moments, q) is clear


def test_an_obstacle_that_appears_counts_from_the_sample_before_on_any_long_motion(tmp_path: Path) -> None:
    """The ball is at the sphere's place until 4 s, and 0.5 m away from then on, in 100 samples of 0.1 s."""
    moments = np.linspace(0.0, 9.9, 100)
    q = np.where(moments < 4.0, 0.3, -0.2)[:, None]
    for appears, clear in ((3.95, False), (4.05, True), (9.0, True), (0.0, False)):
        proximity = past(tmp_path, clearance=0.01, position=[0.3, 0.0, 0.0], appears_at=appears)
        assert motion_is_clear(proximity, moments, q) is clear


@pytest.mark.parametrize("meets", [2.3, 7.7])
def test_a_ball_and_a_sphere_that_cross_are_checked_on_one_clock(tmp_path: Path, meets: float) -> None:
    """The ball is at 0.2 t - 1 m; the sphere is there at the moment of the meeting, or 2 s later."""
    q = np.array([[-1.0], [1.0]])
    for late, clear in ((0.0, False), (2.0, True)):
        place = [0.2 * meets - 1.0, -SPEED * (meets + late), 0.0]
        proximity = past(tmp_path, clearance=0.0, position=place, velocity=[0.0, SPEED, 0.0])
        assert segment_is_clear(proximity, q[0], q[1], dt=DURATION) is clear
        (found,) = find_clearances(proximity, bp.Trajectory.from_steps(np.array([0.0, DURATION]), q))
        # both approach at right angles: at the time t they are 0.2 (t - meets) and 0.1 (t - meets - late) apart
        nearest = 0.0 if not late else 0.2 * SPEED * late / float(np.hypot(0.2, SPEED))
        assert found.distance <= nearest - TOUCH + 1e-9
        assert found.distance >= nearest - TOUCH - max(1e-4, 0.02 * (nearest - TOUCH)) - 1e-9


@pytest.mark.parametrize("effort", [0, 1, 3, 10])
def test_a_search_that_ends_early_reports_no_more_than_is_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, effort: int
) -> None:
    """From 1.4 m before the sphere to 0.6 m behind it, and 0.02 m away in between."""
    monkeypatch.setattr(clearances, "_EFFORT", effort)
    proximity = past(tmp_path, clearance=0.0, position=[0.4, 0.06, 0.0])
    motion = bp.Trajectory.from_steps(np.array([0.0, DURATION]), np.array([[-1.0], [1.0]]))
    (found,) = find_clearances(proximity, motion)
    assert found.distance <= 0.02
