"""The certificate of a pitch, height or rotation to keep: at samples, between them, with a tracking error."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector

Data = dict[str, Any]

Q = np.array([0.0, 0.4, -1.6, -0.9])  # pitch -2.1


def scene(robot: bp.Robot, q: Vector, keep: Data, **keys: Any) -> bp.Scene:
    """A scene in which the machine stays at q."""
    joints = dict(zip(robot.joint_names, q.tolist(), strict=True))
    task = {"goal": {"joints": joints}, "keep": keep}
    return bp.scene_from_dict({"version": 1, "start": {"joints": joints}, "task": task} | keys)


def through(*q: Vector, period: float = 1000.0) -> bp.Trajectory:
    return bp.Trajectory.from_steps(period * np.arange(len(q), dtype=float), np.array(q))


def shifted(q: Vector, **joints: float) -> Vector:
    names = ("swing", "boom", "stick", "bucket")
    return np.asarray(q + np.array([joints.get(name, 0.0) for name in names]))


def test_a_motion_within_the_band_is_verified_with_its_margin(backhoe: bp.Robot) -> None:
    motion = through(Q, shifted(Q, swing=0.5, boom=0.05), Q)
    found = bp.certify(backhoe, scene(backhoe, Q, {"pitch": [-2.2, -1.9]}), motion)
    assert found.verified, found.problems
    (use,) = found.keep
    assert (use.name, use.unit, use.time) == ("pitch", "rad", 0.0)
    assert use.margin == pytest.approx(0.1, abs=1e-12)
    assert use.value == pytest.approx(-2.1, abs=1e-12)


def test_a_sample_outside_the_band_is_reported_with_pitch_and_time_and_limits(backhoe: bp.Robot) -> None:
    motion = through(Q, shifted(Q, boom=0.3), Q)
    found = bp.certify(backhoe, scene(backhoe, Q, {"pitch": [-2.2, -2.0]}), motion)
    assert not found.verified
    assert found.problems == ("the pitch of the bucket is -103.1 deg at 1000.00 s, allowed -126.1 to -114.6 deg",)
    assert found.keep[0].margin == pytest.approx(-0.2, abs=1e-12)
    assert found.safe  # no collision, and no limit of the machine is exceeded


def test_a_pitch_that_misses_its_band_by_little_is_printed_as_outside_of_it(backhoe: bp.Robot) -> None:
    """0.0004 rad are 0.02 degrees, which a tenth of a degree does not show."""
    found = bp.certify(backhoe, scene(backhoe, Q, {"pitch": [-2.2, -2.1004]}), through(Q, Q))
    (problem,) = found.problems
    pitch, high = (float(problem.split(word)[1].split()[0]) for word in ("is", " to "))
    assert pitch > high
    assert pitch == pytest.approx(np.degrees(-2.1), abs=5e-3)


def test_a_motion_on_the_edge_of_the_band_is_verified(backhoe: bp.Robot) -> None:
    motion = through(Q, shifted(Q, swing=0.5, boom=0.1, stick=-0.1), Q)
    assert bp.certify(backhoe, scene(backhoe, Q, {"pitch": [-2.1, -2.1]}), motion).verified


# --- only between the samples -----------------------------------------------------------


def test_a_turn_of_the_wrist_between_two_samples_is_found(ur5: bp.Robot) -> None:
    q = np.array([0.1, -1.2, 1.0, -0.7, 0.4, -np.pi])
    at = pin.Quaternion(bp.Kinematics(ur5).at(q).tip_rotation)
    keep = {"rotation": {"quaternion": [at.w, at.x, at.y, at.z], "tolerance": 0.3}}
    motion = through(q, q + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * np.pi]), q)
    found = bp.certify(ur5, scene(ur5, q, keep), motion)
    (use,) = found.keep
    assert not use.kept
    assert 0.0 < use.time < 2000.0
    assert any(problem.startswith("the tip is turned by ") for problem in found.problems)


def test_a_pitch_outside_the_band_between_two_samples_is_found(backhoe: bp.Robot) -> None:
    low, high = np.array([0.0, -0.5, -2.2, -2.3]), np.array([0.0, 0.75, -0.2, 0.55])  # -5.0 and 1.1: 1.283 and 1.1
    found = bp.certify(backhoe, scene(backhoe, low, {"pitch": [1.0, 1.4]}), through(low, high, low))
    (use,) = found.keep
    assert not use.kept
    assert 0.0 < use.time < 2000.0


@pytest.mark.parametrize(("side", "sense"), [("below", 1.0), ("above", -1.0)])
def test_an_arc_over_or_under_a_height_between_two_samples_is_found(ur5: bp.Robot, side: str, sense: float) -> None:
    """The shoulder swings the straight arm over the top, or through the bottom."""
    middle = np.array([0.0, -sense * np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    turn = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    heights = [float(bp.Kinematics(ur5).at(middle + t * turn).tip_position[2]) for t in np.linspace(-1.0, 1.0, 2001)]
    ends, extreme = sense * max(sense * heights[0], sense * heights[-1]), sense * max(sense * z for z in heights)
    assert sense * (extreme - ends) > 0.05
    motion = through(middle - turn, middle + turn, middle - turn)
    for limit in (ends - sense * 0.01, 0.5 * (extreme + ends), extreme + sense * 0.003):
        (use,) = bp.certify(ur5, scene(ur5, middle - turn, {side: limit}), motion).keep
        margin = sense * (limit - extreme)
        assert use.kept is (margin > 0.0)
        assert margin - 1.1e-3 <= use.margin <= margin + 1e-6


def test_the_margin_between_samples_is_proven_and_at_most_2_mm_or_2_mrad_below_the_true_one(ur5: bp.Robot) -> None:
    rng = np.random.default_rng(4)
    for _ in range(10):
        q_a = ur5.random_q(rng)
        q_b = q_a + 0.2 * (ur5.random_q(rng) - q_a)
        at = pin.Quaternion(bp.Kinematics(ur5).at(0.5 * (q_a + q_b)).tip_rotation)
        rotation = {"quaternion": [at.w, at.x, at.y, at.z], "tolerance": 3.0}
        asked_direction = at.toRotationMatrix() @ np.array([0.1, 0.9, 0.0])  # beside the axis in the middle
        tilt = {"axis": [0.0, 1.0, 0.0], "direction": asked_direction.tolist(), "tolerance": 3.0}
        keep = {"rotation": rotation, "above": -3.0, "tilt": tilt}
        found = bp.certify(ur5, scene(ur5, q_a, keep), through(q_a, q_b))
        places = [bp.Kinematics(ur5).at(q_a + t * (q_b - q_a)) for t in np.linspace(0.0, 1.0, 300)]
        asked = at.toRotationMatrix()
        turned = max(float(np.linalg.norm(pin.log3(asked.T @ place.tip_rotation))) for place in places)
        height = min(float(place.tip_position[2]) for place in places)
        along = asked_direction / np.linalg.norm(asked_direction)
        tilted = max(float(np.arccos(place.tip_rotation[:, 1] @ along)) for place in places)
        true = {"rotation": 3.0 - turned, "above": height + 3.0, "tilt": 3.0 - tilted}
        for use in found.keep:
            assert true[use.name] - 2e-3 <= use.margin <= true[use.name] + 1e-9


# --- with a tracking error --------------------------------------------------------------


def test_the_tracking_error_is_deducted_from_the_margin(backhoe: bp.Robot) -> None:
    """Three joints of 0.01 rad take 0.03 rad of a margin of 0.05, which is enough, or of 0.02, which is not."""
    for low, verified in ((-2.15, True), (-2.12, False)):
        asked = scene(backhoe, Q, {"pitch": [low, -1.9]}, tracking={"joints": 0.01})
        found = bp.certify(backhoe, asked, through(Q, Q))
        assert found.verified is verified
        assert found.keep[0].margin == pytest.approx(-2.1 - low - 0.03, abs=1e-9)
    assert "(1.7 deg less for the tracking error)" in found.problems[0]


def test_the_tracking_error_is_deducted_from_a_height_and_a_rotation(ur5: bp.Robot) -> None:
    """A tip error of 4 mm for the height; six hinges of 0.01 rad for the rotation, of which 0.2 rad are allowed.

    The last hinge turns the tip about its z axis, so that five of them count for the tilt of that axis.
    """
    q = np.array([0.1, -1.2, 1.0, -0.7, 0.4, 0.3])
    at = bp.Kinematics(ur5).at(q)
    turn = pin.Quaternion(at.tip_rotation)
    z = float(at.tip_position[2])
    rotation = {"quaternion": [turn.w, turn.x, turn.y, turn.z], "tolerance": 0.2}
    tilt = {"direction": at.tip_rotation[:, 2].tolist(), "tolerance": 0.2}
    keep = {"above": z - 0.05, "below": z + 0.07, "rotation": rotation, "tilt": tilt}
    expected = {"above": 0.05, "below": 0.07, "rotation": 0.2, "tilt": 0.2}
    for tracking, tip, turned in (({}, 0.0, 0.0), ({"tracking": {"joints": 0.01, "tip": 0.004}}, 0.004, 0.06)):
        found = bp.certify(ur5, scene(ur5, q, keep, **tracking), through(q, q))
        margins = {use.name: use.margin for use in found.keep}
        lost = {"above": tip, "below": tip, "rotation": turned, "tilt": turned * 5.0 / 6.0}
        assert margins == pytest.approx({name: most - lost[name] for name, most in expected.items()}, abs=1e-6)
