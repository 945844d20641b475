"""How the ground changes during a job, moment by moment, reduced to what a page needs."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Matrix
from backhoe_planner.job import BladeSweep, Cycle, JobPlan, Terrain, swept
from backhoe_planner.show.job.job_frames import Part

_CUT_MOMENTS = 10  # per cut; chosen, two a second
_DUMP_MOMENTS = 5  # per dump; chosen
_POURS_FROM = 0.35  # part of the dump after which the soil falls; chosen, the bucket is half open by then
_MILLIMETRES = 1000.0
_VISIBLE = 5e-4  # m, least change that is shown
_COVERS = 0.04  # m of loose soil that hide what is below; chosen, a heap's rim then has no teeth


def start_of(ground: Terrain) -> dict[str, Any]:
    """The grid and its heights [mm] at the beginning."""
    return {
        "low": ground.low,
        "cell": ground.cell,
        "shape": ground.shape,
        "heights": _packed(_millimetres(ground.surface), "<i2"),
        "loose": _packed(_cover(ground.loose), "u1"),
    }


def changes_of(plan: JobPlan, parts: Sequence[Part]) -> list[dict[str, Any]]:
    """What changes and when: time [s], indices of columns, their heights [mm], and how much loose soil covers them."""
    found: list[dict[str, Any]] = []
    for cycle in plan.cycles:
        own = {part.name: part for part in parts if part.cycle == cycle.number}
        if "cut" in own:
            found += _cut(cycle, own["cut"])
        if "dump" in own:
            found += _dump(cycle, own["dump"])
    return found


def _cut(cycle: Cycle, part: Part) -> list[dict[str, Any]]:
    digging, before = cycle.digging, cycle.before
    count = len(digging.time)
    changes, last = [], before
    for end in np.unique(np.linspace(1, count - 1, _CUT_MOMENTS).astype(int))[:-1]:
        blade = BladeSweep(digging.edge[: end + 1], digging.across, digging.width)
        now = swept(before, blade, slump=False).terrain
        changes += _between(last, now, part.begin + float(digging.time[end]))
        last = now
    return changes + _between(last, cycle.dug, part.begin + float(digging.time[-1]))


def _dump(cycle: Cycle, part: Part) -> list[dict[str, Any]]:
    """The heap grows evenly while the bucket opens."""
    dug, after = cycle.dug, cycle.after
    columns = np.flatnonzero(dug.unlike(after))
    if not len(columns):
        return []
    below, above = dug.surface.ravel()[columns], after.surface.ravel()[columns]
    loose = _cover(after.loose.ravel()[columns])
    begin = part.begin + _POURS_FROM * (part.end - part.begin)
    found = []
    for step in range(1, _DUMP_MOMENTS + 1):
        share = step / _DUMP_MOMENTS
        time = begin + share * (part.end - begin)
        found.append(_change(time, columns, below + share * (above - below), loose))
    return found


def _between(before: Terrain, after: Terrain, time: float) -> list[dict[str, Any]]:
    columns = np.flatnonzero(np.abs(after.surface - before.surface) > _VISIBLE)
    if not len(columns):
        return []
    return [_change(time, columns, after.surface.ravel()[columns], _cover(after.loose.ravel()[columns]))]


def _change(time: float, columns: NDArray[np.intp], heights: Array, cover: Array) -> dict[str, Any]:
    return {
        "time": time,
        "columns": _packed(columns, "<u4"),
        "heights": _packed(_millimetres(heights), "<i2"),
        "loose": _packed(cover, "u1"),
    }


def _cover(loose: Array) -> Array:
    """From 0 for no loose soil to 255 where it hides what is below."""
    return np.round(255.0 * np.clip(loose / _COVERS, 0.0, 1.0))


def _millimetres(heights: Matrix) -> Array:
    return np.clip(np.round(_MILLIMETRES * heights), -32_000, 32_000)


def _packed(values: NDArray[Any], kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")
