"""The rows that demand a velocity away from what moves."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.law import Rows
from backhoe_planner.live.braking.braking_path import BUFFER
from backhoe_planner.live.braking.kept_rows import KeptRows

# opens the wall: the rows are only used within the servo
from backhoe_planner.live.clearance.evasion import _LEAST_AUTHORITY, Evasion, EvasionRows

Q = np.array([0.0, 0.3, -0.9, -0.5])  # the arm along x, its sides across y
CLEARANCE, NEAR = 0.05, 0.3  # m


def facing_a_wall(backhoe: bp.Robot, speed: float, kept: KeptRows | None = None) -> tuple[bp.Servo, EvasionRows]:
    """The rows at rest beside a wall that comes along -y, from `NEAR` beside the widest link."""
    start = {"joints": dict(zip(backhoe.joint_names, Q.tolist(), strict=True))}
    scene = {"version": 1, "start": start, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}, "clearance": CLEARANCE}
    servo = bp.Servo(backhoe, bp.scene_from_dict(scene))
    place = {"size": [6.0, 1.0, 8.0], "position": [4.0, 5.0, 0.0], "links": ["boom", "stick", "bucket"]}
    servo.add({"name": "wall", "shape": "box", **place})
    gap = float(bp.Proximity(backhoe, servo.snapshot(), self_collision=False).distances(Q).min())
    servo.move("wall", [0.0, NEAR - gap, 0.0])
    servo.set_velocity("wall", [0.0, -speed, 0.0])
    near, most = servo._bounds.near(Q, servo._at), servo.limits.velocity
    return servo, Evasion(servo._check).find(near, -most, most, kept)


def check_rows(servo: bp.Servo, pairs: np.ndarray, rows: Rows, speed: float, *, part: float) -> None:
    """Against the hand calculation: only the swing moves a corner along y, by its x in m/rad.

    part: of the greatest acceleration of that corner with which the machine gives way.
    """
    proximity = bp.Proximity(servo.robot, servo.snapshot(), self_collision=False)
    distances = dict(zip((pair.piece for pair in proximity.pairs), proximity.distances(Q).tolist(), strict=True))
    assert len(rows.h) > 0
    np.testing.assert_allclose(rows.G[:, 1:], 0.0, atol=1e-9)
    assert (rows.G[:, 0] > 1.0).all()
    for pair, x, h in zip(pairs.tolist(), rows.G[:, 0].tolist(), rows.h.tolist(), strict=True):
        margin = distances[int(servo._separation.piece[pair])] - CLEARANCE - 2.0 * BUFFER
        most = x * servo.limits.acceleration[0]
        assert h == pytest.approx(np.sqrt(2.0 * part * most * margin) - speed, abs=1e-6)


@pytest.mark.parametrize("speed", [0.8, 1.2])
def test_a_machine_gives_way_with_half_of_its_acceleration(backhoe: bp.Robot, speed: float) -> None:
    servo, found = facing_a_wall(backhoe, speed)
    ((pairs, rows),) = found.of_pairs
    assert rows is found.rows
    check_rows(servo, pairs, rows, speed, part=0.5)


def test_a_wall_that_goes_away_or_stands_still_demands_nothing(backhoe: bp.Robot) -> None:
    for speed in (-1.0, 0.0):
        assert facing_a_wall(backhoe, speed)[1].of_pairs == ()


@pytest.mark.parametrize(("joints", "left"), [([0.0, 1.0, 1.0, 1.0], 1.0), ([1.0, 0.0, 0.0, 0.0], _LEAST_AUTHORITY)])
def test_a_machine_that_keeps_a_condition_of_the_swing_gives_way_earlier(
    backhoe: bp.Robot, joints: list[float], left: float
) -> None:
    """A condition of the other joints leaves all of the swing's acceleration, one of the swing none: the floor."""
    nothing = Rows.none("keep", 4)
    kept = KeptRows(nothing.G, nothing.h, np.array([joints]), nothing, firm=False)
    servo, found = facing_a_wall(backhoe, 0.6, kept)
    (_, rows), (pairs, early) = found.of_pairs
    assert rows is found.rows
    assert early is found.early
    check_rows(servo, pairs, early, 0.6, part=0.5 * left)
