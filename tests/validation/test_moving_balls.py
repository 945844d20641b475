"""The figures of drives among moving balls."""

from __future__ import annotations

import numpy as np
import pytest

from validation.moving_balls import BallDrive, figures_of


def drive(speeds: list[float], distances: list[float], *, lost: float, late: float) -> BallDrive:
    return BallDrive(
        machine="panda", duration=2.0, speeds=speeds, distances=distances, clearance=0.05, lost=lost,
        arrived=late < 9.0, late=late, too_close=3, unproven=0,
    )  # fmt: skip


def test_touches_and_what_is_missing_are_counted_as_by_hand() -> None:
    drives = [
        drive([0.1, 2.0], [0.2, -0.03], lost=0.0, late=1.0),  # the fast ball alone is touched
        drive([0.3], [-0.01], lost=0.02, late=10.0),
        drive([1.0], [0.04], lost=5e-4, late=3.0),
        drive([0.5], [np.inf], lost=0.0, late=2.0),
    ]
    found = figures_of(drives)
    assert [one.touched for one in drives] == [[2.0], [0.3], [], []]
    assert (found["drives"], found["touched"], found["touched, by a ball slower than 0.55 m/s"]) == (4, 2, 1)
    assert found["depth of all touches [m]"] == pytest.approx(0.04)
    assert found["missing to clearances [m]"] == pytest.approx(0.08 + 0.06 + 0.01)
    assert (found["broke what is kept"], found["not arrived in time"], found["steps too close"]) == (1, 1, 12)
    assert found["later than planned [s], median, p90"][0] == pytest.approx(2.5)
