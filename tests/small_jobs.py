"""Jobs of a few cycles: short, shallow trenches on small pieces of ground."""

from __future__ import annotations

from functools import cache
from typing import Any

from backhoe_planner.job import Job, JobPlan, job_from_dict, plan_job

TINY: dict[str, Any] = {
    "version": 1,
    "start": {"swing": 0.0, "boom": 0.9, "stick": -1.6, "bucket": -1.8},
    "site": {"clearance": 0.1},
    "ground": {"low": [0.5, -4.5], "high": [5.5, 1.0], "level": 0.0},
    "dig": {"trench": {"from": [4.2, 0.0], "to": [3.2, 0.0], "width": 0.6, "depth": 0.4}},
    "dump": {"heap": {"at": [2.4, -2.8], "edge_distance": 0.6}},
    "bucket": {"capacity": 0.2},
    "pattern": {"face": 0.4},
}


@cache
def tiny_plan() -> JobPlan:
    """The plan of `TINY`."""
    return plan_job(job_from_dict(TINY), effort="quick")


def small_job(**keys: Any) -> Job:
    """The job with some of its keys replaced."""
    content: dict[str, Any] = {
        "version": 1,
        "name": "short trench",
        "start": {"swing": 0.0, "boom": 0.9, "stick": -1.6, "bucket": -1.8},
        "site": {
            "obstacles": [
                {"name": "pipe", "shape": "capsule", "from": [3.6, -2, -1], "to": [3.6, 2, -1], "radius": 0.1}
            ]
        },
        "ground": {"low": [0.5, -4.5], "high": [6.0, 1.5]},
        "dig": {"trench": {"from": [4.4, 0.0], "to": [3.2, 0.0], "width": 0.6, "depth": 0.3}},
        "dump": {"heap": {"at": [2.5, -3.0]}},
        "bucket": {"capacity": 0.2},
        "pattern": {"layers": 0.3},
    }
    return job_from_dict(content | keys)
