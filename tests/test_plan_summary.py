"""What `plan` and `check` print of a plan."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.cli.plan_summary import _back_at


@pytest.mark.parametrize(
    ("path_to", "elbow", "words"),
    [
        (2.5, 1.0, "at 2.50 m"),
        (2.004, 0.39, "at the same place"),  # the elbow has moved by 0.09 rad since the detour began
        (2.004, 0.41, "at the same place in another posture"),
        (2.004, -1.0, "at the same place in another posture"),
    ],
)
def test_a_detour_ends_in_another_posture_if_a_joint_stands_more_than_a_tenth_of_a_radian_aside(
    path_to: float, elbow: float, words: str
) -> None:
    along = bp.Trajectory.from_steps(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.3], [0.5, 1.5], [0.05, elbow]]))
    detour = bp.Detour(time_from=0.0, time_to=2.0, path_from=2.0, path_to=path_to, length=3.0, max_deviation=1.0)
    assert _back_at(along, detour) == words
