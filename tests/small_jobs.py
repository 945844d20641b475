"""A job of a few cycles: a short, shallow trench on a small piece of ground."""

from __future__ import annotations

from typing import Any

from backhoe_planner.job import Job, job_from_dict


def small_job(**keys: Any) -> Job:
    """The job, with some of its keys replaced."""
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
