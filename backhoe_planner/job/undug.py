"""The part of the design that stays undug, and why."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Flags, Matrix
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.result.job_plan import JobReason, Undug, UndugReason
from backhoe_planner.job.worksite.lanes import ENTRY, LEAVE, Lane, passes_beside
from backhoe_planner.job.worksite.worksite import Worksite

_ASKEW = 0.1  # sine of the angle between arm and trench; chosen: it is less along walls that are parallel to the lanes
_LEAST = 1e-4  # m^3: less is rounding
_EARLY: dict[JobReason, str] = {
    "full": "not dug: no soil could be dumped any more",
    "blocked": "not dug: the job ended early",
    "unreachable": "not dug: the job ended early",
}


def find_undug(
    site: Worksite,
    lanes: Sequence[Lane],
    heights: tuple[Matrix, Matrix, NDArray[np.int64]],
    end: Terrain,
    *,
    hard: str = "",
    ended: JobReason = "",
) -> tuple[Undug, ...]:
    """All soil that stays above the design by more than the tolerance, by reason, the largest volume first.

    Parameters
    ----------
    lanes: the lanes that were dug.
    heights: (rows, columns) the design, what may be dug, and the index of the lane, see `allowed_heights`.
    end: the ground after the last cycle.
    hard: the cylinder that cannot cut what is left, in words; empty if there is none.
    ended: why the job ended early; empty if it did not.
    """
    design, allowed, by = heights
    tolerance = site.job.dig.tolerance
    surface = site.within_design(end)
    stays = surface - design > tolerance
    found: dict[tuple[UndugReason, str], Flags] = {}

    def add(reason: UndugReason, cause: str, row: int, column: int) -> None:
        flags = found.setdefault((reason, cause), np.zeros(design.shape, dtype=bool))
        flags[row, column] = True

    points = site.nodes - site.plane.axis
    for row, column in np.argwhere(stays).tolist():
        number = int(by[row, column])
        if number < 0:
            add("out_of_reach", "no plane of the arm has room for the bucket there", row, column)
        elif surface[row, column] - allowed[row, column] > tolerance:
            add("too_hard" if hard else "left", hard or _EARLY.get(ended, ""), row, column)
        else:
            lane = lanes[number]
            r = float(points[row, column] @ site.plane.directions(lane.swing)[0])
            add(*_cause(site, lane, r), row, column)
    each = np.where(stays, (surface - design) * site.share, 0.0) * end.cell**2
    undug = [_undug(site, each, flags, reason, cause) for (reason, cause), flags in found.items()]
    return tuple(sorted((one for one in undug if one.volume > _LEAST), key=lambda one: -one.volume))


def _cause(site: Worksite, lane: Lane, r: float) -> tuple[UndugReason, str]:
    """Why a lane cannot be dug deeper at a radius [m]: the limit of the floor there, otherwise the steepest line."""
    reach = np.abs(lane.r - r) <= site.ground.cell
    causes = lane.cause[reach]
    if causes.any():
        kind, name = lane.causes[int(causes[causes > 0][0])]
        return ("protected" if kind == "protected" else "out_of_reach"), name
    # if a limit raises the floor nearby, a line above the floor is there because of that limit
    raised = np.flatnonzero(lane.cause > 0)
    line, floor = float(np.interp(r, lane.r, lane.line)), float(np.interp(r, lane.r, lane.floor))
    if len(raised) and line > floor:
        nearest = int(raised[np.argmin(np.abs(lane.r[raised] - r))])
        ends = min(abs(r - lane.start), abs(r - lane.end))
        if abs(float(lane.r[nearest]) - r) < ends:
            kind, name = lane.causes[int(lane.cause[nearest])]
            return ("protected" if kind == "protected" else "out_of_reach"), name
    return "out_of_reach", _too_steep(site, lane)


def _too_steep(site: Worksite, lane: Lane) -> str:
    how = f"the teeth go in at most at {np.degrees(ENTRY):.0f} and come out at most at {np.degrees(LEAVE):.0f} degrees"
    trench = site.job.dig.trench
    if trench is not None:
        across = abs(float(trench.ahead @ site.plane.directions(lane.swing)[1]))
        if across > _ASKEW and passes_beside(site, trench) > trench.tolerance:
            return (
                f"the arm is askew to the trench and meets its walls as ends, which are too steep: {how}; it digs all "
                "of a trench whose line passes through the swing axis (backhoe-planner stand finds such a place)"
            )
    return f"the ends are too steep: {how}"


def _undug(site: Worksite, each: Matrix, columns: Flags, reason: UndugReason, cause: str) -> Undug:
    nodes = site.nodes[columns]
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    volume = float(np.sum(each[columns]))
    where = f"{volume:.2f} m^3 {_places(site, each, columns)}"
    why = {
        "protected": f"protected by {cause}",
        "out_of_reach": cause or "out of the machine's reach",
        "too_hard": cause,
        "left": cause or "left between cuts",
    }[reason]
    by = "" if reason == "left" else cause
    return Undug(reason, by, columns, volume, low, high, f"{where}: {why}")


def _places(site: Worksite, each: Matrix, columns: Flags) -> str:
    """The location of `columns` in words, from corner to corner; if there are several places, that of the largest."""
    from scipy.ndimage import label  # importing it takes long

    apart, count = label(columns, structure=np.ones((3, 3)))
    volumes = np.bincount(apart.ravel(), weights=np.where(columns, each, 0.0).ravel())
    nodes = site.nodes[apart == int(np.argmax(volumes))]
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    where = f"from x {low[0]:.2f}, y {low[1]:.2f} to x {high[0]:.2f}, y {high[1]:.2f} m"
    return where if count == 1 else f"in {count} places, the largest ({volumes.max():.2f} m^3) {where}"
