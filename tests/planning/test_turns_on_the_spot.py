"""Paths with turns of the bucket on the spot: planned, timed, certified and described."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import Trajectory, build_problem, progress

A, M, B, C = [3.2, 0.0, 0.3], [3.0, 0.0, 0.3], [2.8, 0.0, 0.3], [2.8, 0.0, 0.7]
ARC = 0.4  # from A to B [m]
TURNED = -2.2  # instead of -1.6 [rad]


def at(position: list[float], pitch: float | list[float] | None = None) -> dict[str, Any]:
    return {"position": position} | ({} if pitch is None else {"pitch": pitch})


def site(*waypoints: dict[str, Any], **keys: Any) -> bp.Scene:
    return bp.scene_from_dict({"version": 1, "task": {"path": {"waypoints": list(waypoints)} | keys}})


def pitches(plan: bp.Plan) -> np.ndarray[Any, np.dtype[np.float64]]:
    kinematics = bp.Kinematics(plan.robot)
    return np.array([kinematics.at(q).pitch for q in plan.trajectory.q])


START = (at(A, -1.6), at(A, TURNED), at(B, TURNED))
MIDDLE = (at(A, -1.6), at(M, -1.6), at(M, TURNED), at(B, TURNED))
END = (at(A, -1.6), at(B, -1.6), at(B, TURNED))
ROW = (at(A, -1.6), at(A, TURNED), at(A, -1.8), at(B, -1.8), at(B, -2.4), at(B, -1.6))


@pytest.fixture(scope="module")
def straight(backhoe: bp.Robot) -> bp.Plan:
    """A plan from A to B with the bucket at -1.6 all along."""
    return bp.plan(backhoe, site(at(A, -1.6), at(B, -1.6)), effort="quick")


# --- planned and certified --------------------------------------------------------


@pytest.mark.parametrize(
    "waypoints",
    [START, pytest.param(MIDDLE, marks=pytest.mark.long), pytest.param(END, marks=pytest.mark.long), ROW],
    ids=["start", "middle", "end", "row"],
)
@pytest.mark.parametrize(
    "keys", [pytest.param({}, marks=pytest.mark.long), {"speed": 0.3, "detour": False}], ids=["fast", "slow"]
)
def test_a_turn_on_the_spot_is_followed(
    backhoe: bp.Robot, waypoints: tuple[dict[str, Any], ...], keys: dict[str, Any]
) -> None:
    """Every metre of the path without a detour, and each requested angle in order."""
    plan = bp.plan(backhoe, site(*waypoints, **keys), effort="quick")
    assert plan.verified, plan.message
    tracking = plan.certificate.tracking
    assert tracking.detours == ()
    assert tracking.path_length == pytest.approx(ARC)
    assert tracking.followed == pytest.approx(ARC, abs=1e-6)
    found, row = pitches(plan), 0
    for waypoint in waypoints:
        near = np.flatnonzero(np.abs(found[row:] - waypoint["pitch"]) < 1e-6)
        assert len(near), f"never at {waypoint['pitch']} after sample {row}"
        row += int(near[0])


def test_the_law_follows_turns_on_the_spot(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, site(*ROW), method="reactive")
    assert plan.verified, plan.message
    assert plan.certificate.detours == ()


def test_the_requested_speed_does_not_slow_a_turn_on_the_spot(backhoe: bp.Robot) -> None:
    """At 0.02 m/s a turn by 0.6 rad, if it counted as 0.15 m, would take 7.5 s."""
    slow = bp.plan(backhoe, site(at(A, -1.6), at(A, TURNED), speed=0.02), effort="quick")
    fast = bp.plan(backhoe, site(at(A, -1.6), at(A, TURNED)), effort="quick")
    assert slow.verified, slow.message
    assert slow.trajectory.duration < 1.05 * fast.trajectory.duration < 3.0


def test_successive_turns_in_one_sense_need_no_stop_between_them(backhoe: bp.Robot) -> None:
    through = bp.plan(backhoe, site(at(A, -1.6), at(A, -1.9), at(A, TURNED)), effort="quick")
    once = bp.plan(backhoe, site(at(A, -1.6), at(A, TURNED)), effort="quick")
    assert through.verified, through.message
    assert through.trajectory.duration == pytest.approx(once.trajectory.duration, rel=0.02)
    moving = np.max(np.abs(through.trajectory.segment_velocities()), axis=1)
    assert np.min(moving[5:-5]) > 0.05


def test_a_repeated_waypoint_changes_nothing(backhoe: bp.Robot, straight: bp.Plan) -> None:
    twice = bp.plan(backhoe, site(at(A, -1.6), at(A, -1.6), at(B, -1.6)), effort="quick")
    np.testing.assert_array_equal(twice.trajectory.q, straight.trajectory.q)


def test_a_requested_angle_is_kept_though_the_next_waypoint_leaves_it_free(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, site(at(A, TURNED), at(A), at(B)), effort="quick")
    assert plan.verified, plan.message
    assert pitches(plan)[0] == pytest.approx(TURNED)


def test_a_range_of_pitch_may_turn_on_the_spot(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, site(at(A, [-1.8, -1.4]), at(A, [-2.4, -2.0]), at(B, [-2.4, -2.0])), effort="quick")
    assert plan.verified, plan.message
    found = pitches(plan)
    assert -1.8 - 1e-6 <= found[0] <= -1.4 + 1e-6
    assert -2.4 - 1e-6 <= found[-1] <= -2.0 + 1e-6


HOLD = [0.5, 0.0, 0.5]


def hand(yaw: float, roll: float = np.pi, position: list[float] = HOLD) -> dict[str, Any]:
    return {"position": position, "rpy": [roll, 0.0, yaw]}


@pytest.mark.parametrize(
    "waypoints",
    [
        (hand(0.0), hand(0.6), hand(0.6, np.pi - 0.4), hand(0.0)),
        pytest.param((hand(-1.2), hand(np.pi - 1.2)), marks=pytest.mark.long),
        pytest.param(
            (hand(0.0), hand(0.0, position=[0.45, 0.1, 0.5]), hand(-0.8, position=[0.45, 0.1, 0.5])),
            marks=pytest.mark.long,
        ),
    ],
    ids=["about two axes", "half a turn", "end"],
)
def test_full_orientations_turn_on_the_spot(waypoints: tuple[dict[str, Any], ...]) -> None:
    robot = bp.load_robot("example:panda", tip="panda_hand")
    plan = bp.plan(robot, site(*waypoints, detour=False), effort="quick")
    assert plan.verified, plan.message
    tracking = plan.certificate.tracking
    assert tracking.detours == ()
    assert tracking.max_angle_error < 0.005


# --- certified only if done ----------------------------------------------------------


def test_a_missing_turn_at_the_end_is_reported(backhoe: bp.Robot, straight: bp.Plan) -> None:
    tracking = bp.certify(backhoe, site(*END), straight.trajectory).tracking
    assert not tracking.done
    assert tracking.shortfall == "the path is followed to waypoint 2 of 3"


def test_a_missing_turn_to_and_fro_is_reported(backhoe: bp.Robot, straight: bp.Plan) -> None:
    """-1.6 to -2.2 is 34.4 deg. Before and after the turn the tip is in the same place as without it."""
    to_and_fro = site(at(A, -1.6), at(M, -1.6), at(M, TURNED), at(M, -1.6), at(B, -1.6))
    certificate = bp.certify(backhoe, to_and_fro, straight.trajectory)
    assert not certificate.verified
    assert "waypoint 3 is passed with the bucket 34.4 deg from its angle" in certificate.tracking.shortfall


def turning(robot: bp.Robot, *angles: float) -> Trajectory:
    """A motion at A in which the bucket turns from one angle to the next, sample by sample."""
    near: np.ndarray[Any, np.dtype[np.float64]] = np.array([0.0, 0.4, -1.6, -0.9])
    found: list[np.ndarray[Any, np.dtype[np.float64]]] = []
    for begin, end in pairwise(angles):
        for pitch in np.linspace(begin, end, 41)[1 if found else 0 :]:
            target = bp.TipTarget(position=np.array(A), pitch=(float(pitch), float(pitch)))
            near = bp.solve_inverse_kinematics(robot, target, start=near).q
            found.append(near)
    return Trajectory.from_steps(np.linspace(0.0, 20.0, len(found)), np.array(found))


TO_AND_FRO = (at(A, -1.6), at(A, TURNED), at(A, -1.6))


@pytest.mark.parametrize(
    ("angles", "done"),
    [
        ((-1.6, -2.2, -1.6), True),
        ((-1.6, -2.0, -1.6), False),  # turned too little
        ((-1.6, -2.2), False),  # does not turn back
        ((-1.6, -1.0, -1.6), False),  # the opposite sense
    ],
)
def test_a_path_is_done_only_if_its_angles_are_passed(backhoe: bp.Robot, angles: tuple[float, ...], done: bool) -> None:
    assert bp.certify(backhoe, site(*TO_AND_FRO), turning(backhoe, *angles)).tracking.done is done


def test_requested_angles_are_passed_in_order(backhoe: bp.Robot) -> None:
    asked = site(at(A, -1.8), at(A, -2.2), at(A, -1.4), at(A, -1.8))
    assert bp.certify(backhoe, asked, turning(backhoe, -1.8, -2.2, -1.4, -1.8)).tracking.done
    assert not bp.certify(backhoe, asked, turning(backhoe, -1.8, -1.4, -2.2, -1.8)).tracking.done


def test_an_angle_that_is_passed_between_two_samples_counts(backhoe: bp.Robot) -> None:
    """0.9 rad in 40 steps of 0.0225 rad: -2.2 is two thirds of a step past a sample, further than the tolerance."""
    asked = site(at(A, -1.6), at(A, -2.2), at(A, -2.5), rotation_tolerance=5e-4)
    assert bp.certify(backhoe, asked, turning(backhoe, -1.6, -2.5)).tracking.done


@pytest.mark.parametrize("may", [True, False])
def test_requested_turns_are_no_turns_that_turn_on_the_spot_forbids(backhoe: bp.Robot, may: bool) -> None:
    """The bucket turns as the path requests."""
    asked = site(*TO_AND_FRO, turn_on_the_spot=may)
    certificate = bp.certify(backhoe, asked, turning(backhoe, -1.6, -2.2, -1.6))
    assert certificate.tracking.done
    assert certificate.tracking.spot_turn is None


def test_progress_grows_in_a_turn_on_the_spot(backhoe: bp.Robot) -> None:
    """A third of a turn of 0.6 rad, which counts as 0.15 m."""
    problem = build_problem(backhoe, site(*TO_AND_FRO))
    assert problem.path is not None
    made = progress(problem.path, 0.005, turning(backhoe, -1.6, -1.8), bp.Kinematics(backhoe))
    assert made == pytest.approx(0.05, abs=1e-6)
    made = progress(problem.path, 0.005, turning(backhoe, -1.6, -2.2, -2.0), bp.Kinematics(backhoe))
    assert made == pytest.approx(0.15 + 0.05, abs=1e-3)


# --- messages ------------------------------------------------------------------------


def test_an_angle_out_of_reach_is_reported_with_the_joint_at_its_limit(backhoe: bp.Robot) -> None:
    plan = bp.plan(backhoe, site(at(A, -1.6), at(B, -1.6), at(B, 0.3)), effort="quick")
    assert plan.reason == "unreachable"
    assert "waypoint 3 of the path" in plan.message
    assert "deg away" in plan.message
    assert "with bucket at the limit; the position alone can be reached, with a pitch of " in plan.message


def test_an_obstacle_that_blocks_a_turn_is_named_with_its_place(backhoe: bp.Robot) -> None:
    """A ball behind the bucket, which at a pitch of -2.4 would be in it."""
    angle = -2.4 + np.pi
    ball = [B[0] + 0.25 * float(np.cos(angle)), 0.0, B[2] + 0.25 * float(np.sin(angle))]
    waypoints = [at(C, -1.6), at(B, -1.6), at(B, -2.4), at(B, -1.6)]
    content = {
        "version": 1, "clearance": 0.01, "task": {"path": {"waypoints": waypoints}},
        "obstacles": [{"name": "ball", "shape": "sphere", "radius": 0.03, "position": ball}],
    }  # fmt: skip
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert not plan.verified
    assert plan.reason == "blocked"
    assert "behind waypoint" in plan.message
    assert "ball (at bucket)" in plan.message
