"""What the plan of a job says otherwise than its motions have it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from backhoe_planner.job.result.job_plan_file import JobPlanRecord

_SAME = 1e-6  # of a figure, or of 1 in its unit: rounding of another machine's libraries
_COMPUTED = ("cycles", "figures", "undug")
_NOT_COMPUTED = {"undug": {"words"}, "cycles": {"step"}, "legs": {"time", "q"}, "load": {"r", "mass"}}


def differences(said: JobPlanRecord, found: JobPlanRecord) -> list[str]:
    """In words, which figures of a file are not those of its motions, with their keys; none where all are.

    Parameters
    ----------
    said: read from the file.
    found: computed from its motions.
    """
    ours, theirs = (one.model_dump(mode="json", include=set(_COMPUTED)) for one in (said, found))
    return [line for key in _COMPUTED for line in _compared(ours[key], theirs[key], key, key)]


def _compared(said: Any, found: Any, key: str, name: str) -> Iterator[str]:
    if isinstance(said, dict):
        for each in (one for one in said if one not in _NOT_COMPUTED.get(name, ())):
            yield from _compared(said[each], found[each], f"{key}.{each}", each)
    elif isinstance(said, list) and len(said) == len(found):
        for index, (a, b) in enumerate(zip(said, found, strict=True)):
            yield from _compared(a, b, f"{key}[{index}]", name)
    elif not _same(said, found):
        yield f"{key}: the file says {_brief(said)}, the motions have {_brief(found)}"


def _same(said: Any, found: Any) -> bool:
    if isinstance(said, float) and isinstance(found, float):
        return math.isclose(said, found, rel_tol=_SAME, abs_tol=_SAME) or (math.isnan(said) and math.isnan(found))
    return bool(said == found)


def _brief(value: Any) -> str:
    if isinstance(value, list):
        return f"{len(value)}"
    return f"{value:.6g}" if isinstance(value, float) else f"{value}"
