"""Where to stand, as files: the answer as JSON, and for each place its job, its plan and its initial ground."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from backhoe_planner.files.output_file import check_output, check_record, whole_file
from backhoe_planner.files.provenance import installed_versions
from backhoe_planner.job import Job
from backhoe_planner.standing.result import Place, RankedPlace, StandPlan
from backhoe_planner.standing.sections import MOST_PLACES

_FORMAT = "backhoe-planner/stand"
_DIGITS = 4  # of the numbers written for the map: a tenth of a millimetre


def stand_to_dict(plan: StandPlan) -> dict[str, Any]:
    """The answer as plain data, without the plans of its places."""
    found = plan.map
    return {
        "format": _FORMAT, "version": 1, "job": plan.job.name, "objective": plan.job.objective,
        "verdict": plan.verdict, "reason": plan.reason, "message": plan.note,
        "places": [_place(place, number) for number, place in enumerate(plan.places, start=1)],
        "cost": _number(plan.cost), "bank": _number(plan.bank), "duration": _number(plan.duration),
        "work": _number(plan.work), "travel": _number(plan.travel), "gain": _number(plan.gain),
        "ranking": [_ranked(one) for one in plan.ranking],
        "map": {
            "cell": list(found.cell), "along": found.along.tolist(),
            "x": np.round(found.x, _DIGITS).tolist(), "y": np.round(found.y, _DIGITS).tolist(),
            "heading": [[round(spot.base.heading, _DIGITS) for spot in row] for row in found.spots],
            "cost": [[_number(spot.cost) for spot in row] for row in found.spots],
            "why": [[spot.why for spot in row] for row in found.spots],
        },
        "planning_time": _number(plan.planning_time), "versions": installed_versions(),
    }  # fmt: skip


def save_stand(plan: StandPlan, path: Path) -> None:
    """Write the answer and the files of its places, see `StandPlan.save`.

    Raises
    ------
    OutputError: the folder does not exist or cannot be written; or a file is one of the job's.
    """
    check_stand_outputs(path, plan.job, places=len(plan.places))
    own = files_of(path, len(plan.places))
    for number, place in enumerate(plan.places, start=1):
        job, motions, ground = own[3 * number - 2 : 3 * number + 1]
        with whole_file(job) as stream:
            yaml.safe_dump(portable(place.job), stream, sort_keys=False, allow_unicode=True, default_flow_style=None)
        place.plan.save(motions)
        with whole_file(ground) as stream:
            np.savetxt(stream, place.plan.start.surface, delimiter=",", fmt="%.6g")
    content = stand_to_dict(plan)
    for number, one in enumerate(content["places"], start=1):
        one["files"] = [file.name for file in own[3 * number - 2 : 3 * number + 1]]
    with whole_file(path) as stream:
        json.dump(content, stream, allow_nan=False, indent=1)


def check_stand_outputs(path: Path, job: Job, *, places: int = MOST_PLACES) -> None:
    """Check that an answer and the files of its places can be written, before the long search for it.

    Parameters
    ----------
    places: how many places there are at most.

    Raises
    ------
    OutputError: the folder does not exist or cannot be written; or a file is a folder, or one of the job's.
    """
    check_record(path, job.files)
    for file in files_of(path, places)[1:]:
        check_output(file, job.files)


def files_of(path: Path, places: int) -> list[Path]:
    """All files that are written for an answer: the answer, and for each place its job, its plan and its ground."""
    found = [path]
    for number in range(1, places + 1):
        stem = path.with_name(f"{path.stem}_{number}")
        found += [stem.with_suffix(".yaml"), stem.with_suffix(".json"), stem.with_name(f"{stem.name}_ground.csv")]
    return found


def portable(job: Job) -> dict[str, Any]:
    """A job as plain data that names its files by absolute paths."""
    content = job.to_dict()
    if not job.machine.startswith("example:"):
        content["machine"] = str((job.folder / job.machine).resolve())
    if job.ground.file is not None:
        content["ground"]["file"] = str((job.folder / job.ground.file).resolve())
    if job.dig.surface is not None:
        content["dig"]["surface"]["file"] = str((job.folder / job.dig.surface.file).resolve())
    for obstacle in content["site"].get("obstacles", ()):
        if "file" in obstacle:
            obstacle["file"] = str((job.site_scene.folder / obstacle["file"]).resolve())
    return content


def _place(place: Place, number: int) -> dict[str, Any]:
    plan = place.plan
    return {
        "number": number, "position": list(place.base.position), "heading": place.base.heading,
        "section": None if place.section is None else place.section.tolist(), "travel": place.travel,
        "verdict": plan.verdict, "reason": plan.reason, "cycles": len(plan.cycles), "bank": _number(plan.bank),
        "duration": _number(plan.duration), "work": _number(plan.work), "cost": _number(plan.cost),
        "undug": [one.words for one in plan.undug],
    }  # fmt: skip


def _ranked(one: RankedPlace) -> dict[str, Any]:
    return {
        "position": list(one.base.position), "heading": one.base.heading, "given": one.given,
        "rough": _number(one.rough), "estimated": _number(one.estimated), "planned": _number(one.planned),
        "bank": _number(one.bank), "verdict": None if one.plan is None else one.plan.verdict, "note": one.note,
    }  # fmt: skip


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
