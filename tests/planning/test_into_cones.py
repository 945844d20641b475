"""Descents within cones: margins with a spare that fits into the cone, and curves that are moved back into it."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Keep, build_problem
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.into_cones import IntoCones
from backhoe_planner.planning.descent.kept_margins import KeptMargins

UP = bp.Tilt(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]))  # of a cup in a hand that points down
Q = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 1.9, 0.8])


def upright(panda: bp.Robot, position: list[float]) -> Vector:
    """A posture with the cup exactly upright."""
    found = bp.solve_inverse_kinematics(panda, bp.TipTarget(np.array(position), tilt=UP), start=Q)
    assert found.reached
    return found.q


def cup(panda: bp.Robot, tolerance: float) -> bp.Scene:
    """A cup from one place to another, past nothing."""
    start = dict(zip(panda.joint_names, upright(panda, [0.45, 0.35, 0.54]).tolist(), strict=True))
    keep = {"tilt": {"axis": [0, 0, -1], "tolerance": tolerance}}
    task = {"goal": {"position": [0.5, -0.35, 0.3]}, "keep": keep}
    return bp.scene_from_dict({"version": 1, "tip": "panda_hand_tcp", "start": {"joints": start}, "task": task})


def keep_of(panda: bp.Robot, tolerance: float) -> Keep:
    keep = build_problem(panda, cup(panda, tolerance)).keep
    assert keep is not None
    return keep


def test_a_straight_line_between_upright_postures_is_bent_into_a_cone_of_a_milliradian(panda: bp.Robot) -> None:
    keep, start, end = keep_of(panda, 1e-3), upright(panda, [0.45, 0.35, 0.54]), upright(panda, [0.5, -0.35, 0.3])
    line = JointCurve.straight(start, end, 12)
    u = np.linspace(0.0, 1.0, 500)
    assert float(np.min(keep.rows_each(line.at(u))[0])) < -0.02
    kept = KeptMargins(keep, spare=0.003, allowed=0.0015, ends=[start])
    moved = IntoCones(kept).moved(line, panda.limits)
    assert float(np.min(keep.rows_each(moved.at(u))[0])) > 0.0
    np.testing.assert_array_equal(moved.control[[0, -1]], line.control[[0, -1]])
    assert float(np.max(np.abs(moved.control - line.control))) < 0.3  # no detour


@pytest.mark.parametrize("tolerance", [1e-3, 0.2])
def test_a_curve_counts_as_clear_if_it_uses_half_of_the_spare_in_a_cone(panda: bp.Robot, tolerance: float) -> None:
    """With a spare of 3 mm, of which half may be missed: 0.3 mrad in a wide cone, and a tenth of a narrow one."""
    keep = keep_of(panda, tolerance)
    kept = KeptMargins(keep, spare=0.003, allowed=0.0015)
    spare = min(3e-4, 0.1 * tolerance)
    assert kept.spares == pytest.approx([spare])
    tipped = np.array([upright(panda, [0.5, 0.0, 0.4])] * 4)
    # the cup is tipped by the last but one joint alone, as it is upright and that joint's axis level
    tipped[:, 5] += [0.0, tolerance - 0.6 * spare, tolerance - 0.4 * spare, tolerance + 0.01]
    inside, half, more, far = kept.at(tipped)[1].min(axis=1).tolist()
    assert inside > 0.0
    assert 0.0 > half > -0.0015
    assert -0.0015 > more > -0.0031
    assert far == pytest.approx(-0.01 - spare - 0.0015, rel=1e-3)


def test_a_cup_within_a_milliradian_is_carried_nearly_as_soon_as_one_within_a_tenth(panda: bp.Robot) -> None:
    """The cone takes two of seven freedoms, but where nothing is in the way a swing of the base needs neither."""
    narrow, wide = (bp.plan(panda, cup(panda, tolerance), effort="quick") for tolerance in (1e-3, 0.1))
    assert narrow.verified, narrow.message
    assert wide.verified, wide.message
    assert narrow.trajectory.duration < 1.15 * wide.trajectory.duration
