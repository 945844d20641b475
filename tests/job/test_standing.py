"""Moving machine and site together does not change a job."""

from __future__ import annotations

import math

import pytest
from small_jobs import small_job

from backhoe_planner.job import plan_job

AT = (20.0, 10.0)  # m, a whole number of columns of the ground


def _moved(*point: float) -> list[float]:
    """A point of the site after a quarter turn and a shift by `AT`."""
    x, y, *z = point
    return [AT[0] - y, AT[1] + x, *z]


@pytest.mark.long
def test_moving_a_job_with_its_machine_keeps_duration_and_volume() -> None:
    trench = {"width": 0.6, "depth": 0.15}
    here = plan_job(small_job(dig={"trench": {"from": [4.4, 0.0], "to": [3.6, 0.0], **trench}}), effort="quick")
    there = plan_job(
        small_job(
            site={
                "base": {"position": list(AT), "heading": math.pi / 2.0},
                "obstacles": [
                    {"name": "pipe", "shape": "capsule", "from": _moved(3.6, -2, -1), "to": _moved(3.6, 2, -1),
                     "radius": 0.1}
                ],
            },
            ground={"low": _moved(0.5, 1.5), "high": _moved(6.0, -4.5)},
            dig={"trench": {"from": _moved(4.4, 0.0), "to": _moved(3.6, 0.0), **trench}},
            dump={"heap": {"at": _moved(2.5, -3.0)}},
        ),
        effort="quick",
    )  # fmt: skip
    assert here.verdict == there.verdict == "verified"
    assert len(there.cycles) == len(here.cycles)
    assert there.duration == pytest.approx(here.duration, rel=1e-6)
    assert [cycle.bank for cycle in there.cycles] == pytest.approx([cycle.bank for cycle in here.cycles], rel=1e-6)
