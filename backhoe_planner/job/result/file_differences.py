"""The figures of a job's plan file that disagree with its motions."""

from __future__ import annotations

from backhoe_planner.files.differences import differences
from backhoe_planner.job.result.job_plan_file import JobPlanRecord

_COMPUTED = ("cycles", "figures", "undug")
_NOT_COMPUTED = {"undug": {"words"}, "cycles": {"step"}, "legs": {"time", "q"}, "load": {"r", "mass"}}


def job_differences(said: JobPlanRecord, found: JobPlanRecord) -> list[str]:
    """In words, with their keys, the figures of a file that differ from those of its motions; empty if none does.

    Parameters
    ----------
    said: the record read from the file.
    found: the record computed from its motions.
    """
    ours, theirs = (one.model_dump(mode="json", include=set(_COMPUTED)) for one in (said, found))
    return differences({key: ours[key] for key in _COMPUTED}, theirs, left_out=_NOT_COMPUTED)
