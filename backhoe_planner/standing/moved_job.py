"""The same job from another place, or a part of the job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from backhoe_planner.job import Job, job_from_dict
from backhoe_planner.machine import Base

_SWING = "swing_sector"  # the only zones that turn with the machine


def job_with(
    job: Job,
    *,
    base: Base | None = None,
    obstacles: bool = True,
    dig: Mapping[str, Any] | None = None,
    ground: Mapping[str, Any] | None = None,
    heaps: Sequence[Sequence[float]] | None = None,
    name: str | None = None,
) -> Job:
    """A job with some of its parts replaced; a part that is None is kept.

    Parameters
    ----------
    base: where the machine stands.
    obstacles: whether obstacles and zones are kept; swing sectors are kept in any case.
    dig, ground: as in a job file.
    heaps: places of `dump.heap.at`.
    """
    content = job.to_dict()
    site = dict(content["site"])
    if base is not None:
        site["base"] = {"position": list(base.position), "heading": base.heading}
    if not obstacles:
        site.pop("obstacles", None)
        site["zones"] = [zone for zone in site.get("zones", ()) if zone.get("kind") == _SWING]
    content["site"] = site
    if dig is not None:
        content["dig"] = dict(dig)
    if ground is not None:
        content["ground"] = dict(ground)
    if heaps is not None:
        content["dump"] = {"heap": {**content["dump"]["heap"], "at": [list(place) for place in heaps]}}
    if name is not None:
        content["name"] = name
    return job_from_dict(content, folder=job.folder, site_folder=job.site_scene.folder, file=job.file)
