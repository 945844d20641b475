"""The stations of layers on a path, and those that the law checks."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.motion import TURN_LEVER, TipPath
from backhoe_planner.planning.paths.layer_stations import waypoint_stations  # no motion shows them
from backhoe_planner.planning.paths.local_resolution import sample_stations
from backhoe_planner.site import Waypoint


def turning_path(*turns: tuple[float, float, float]) -> TipPath:
    """The tip turns on the spot by one rotation vector after the other, each in ten steps."""
    rotations = [np.eye(3)]
    for turn in turns:
        rotations += [rotations[-1] @ pin.exp3(part * np.array(turn)) for part in np.linspace(0.1, 1.0, 10)]
    waypoints = []
    for rotation in rotations:
        turned = pin.Quaternion(rotation)
        waypoints.append(Waypoint(position=(1.0, 0.0, 0.0), quaternion=(turned.w, turned.x, turned.y, turned.z)))
    return TipPath(waypoints)


def test_layers_on_a_path_of_many_small_turns_have_the_usual_distance() -> None:
    path = turning_path((0.0, 0.0, 2.0))  # of 0.25 m for each radian
    assert path.length == pytest.approx(2.0 * TURN_LEVER)
    found = waypoint_stations(path, 0.0, 0.1)  # waypoints are 0.05 m apart
    np.testing.assert_allclose(found, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5], atol=1e-9)


def test_there_is_a_layer_where_the_axis_of_rotation_changes() -> None:
    path = turning_path((0.0, 0.0, 2.0), (2.0, 0.0, 0.0))
    found = waypoint_stations(path, 0.0, 0.3)
    np.testing.assert_allclose(found, [0.0, 0.3, 0.5, 0.8, 1.0], atol=1e-9)


def test_the_law_checks_points_within_a_leg_unless_the_leg_is_short() -> None:
    """Legs of 1, 15 and 50 mm: one step, two steps, and steps of at most 20 mm."""
    corners = np.cumsum([0.0, 0.001, 0.015, 0.05])
    path = TipPath([Waypoint(position=(x, 0.0, 0.0)) for x in corners.tolist()])
    within = [0.0, 0.001, 0.0085, 0.016, 0.016 + 0.05 / 3.0, 0.016 + 0.1 / 3.0, 0.066]
    np.testing.assert_allclose(sample_stations(path, 0.0), within, atol=1e-12)
