"""What the plan of a job says otherwise than its motions have it."""

from __future__ import annotations

from backhoe_planner.files.differences import differences
from backhoe_planner.job.result.job_plan_file import JobPlanRecord

_COMPUTED = ("cycles", "figures", "undug")
_NOT_COMPUTED = {"undug": {"words"}, "cycles": {"step"}, "legs": {"time", "q"}, "load": {"r", "mass"}}


def job_differences(said: JobPlanRecord, found: JobPlanRecord) -> list[str]:
    """In words, which figures of a file are not those of its motions, with their keys; none where all are.

    Parameters
    ----------
    said: read from the file.
    found: computed from its motions.
    """
    ours, theirs = (one.model_dump(mode="json", include=set(_COMPUTED)) for one in (said, found))
    return differences({key: ours[key] for key in _COMPUTED}, theirs, left_out=_NOT_COMPUTED)
