"""Sections of a trench that is too long for one place, dug from the far one on while the machine moves back.

The machine stands on the line of the trench, on ground that is not dug yet, and digs towards the part that is already
open. The near end of a section is left as a slope, which belongs to the next section.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.job import LEAVE, Job, Terrain, Trench, build_worksite, plan_job
from backhoe_planner.standing.dig_area import EDGE, dig_area
from backhoe_planner.standing.moved_job import job_with
from backhoe_planner.standing.one_place import first_apart, reaches_machine
from backhoe_planner.standing.result import Place, StandReason
from backhoe_planner.standing.site_map import LINE_STEP, SAME_SHARE, Spot, SpotFinder

_SPARE = 0.05  # m of radius by which a section is within the reach at both ends; chosen
_OVERLAP = 0.1  # m by which a section extends beyond the slope that the previous one leaves; chosen
MOST_PLACES = 50  # along one trench; chosen
_TRIES = 2  # places of a section that are planned, the best first
_AROUND = 1.0  # m of ground around everything that is dug, heaped and reached
_APART = 0.4  # m between places of a section that are tried


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a trench.

    Attributes
    ----------
    start, end: distances from the end of the trench where digging begins [m]; the machine stands beyond `end`.
    dig: the section as a trench of its own, as in a job file.
    spots: places for the machine, the best first.
    """

    start: float
    end: float
    dig: dict[str, Any]
    spots: tuple[Spot, ...]


@dataclass(frozen=True, eq=False)
class Sections:
    """The result of digging in sections.

    Attributes
    ----------
    places: in order.
    failure, note: why they do not dig the whole trench; empty if they do.
    """

    places: tuple[Place, ...]
    failure: StandReason = ""
    note: str = ""


def dig_in_sections(
    job: Job, finder: SpotFinder, *, effort: str, seed: int, told: Callable[[str, int, int], object]
) -> Sections:
    """Dig a trench from the fewest places, in order.

    Parameters
    ----------
    told: called with what is being done, how much of it is done, and how much there is.
    """
    laid_out = layout(job, finder)
    if isinstance(laid_out, str):
        return Sections((), "unreachable", laid_out)
    ground = _whole_ground(job, finder)
    terrain: Terrain | None = None
    places: list[Place] = []
    for number, section in enumerate(laid_out):
        told("planning sections", number, len(laid_out))
        made = _dig(job, finder, section, (number + 1, ground, terrain), effort=effort, seed=seed)
        if isinstance(made, str):
            words = f"section {number + 1} of {len(laid_out)} cannot be dug: {made}"
            return Sections(tuple(places), "not_done", words)
        before = places[-1].base.position if places else made.base.position
        places.append(replace(made, travel=math.dist(before, made.base.position)))
        terrain = made.plan.end
        if not made.plan.verified:
            words = (
                f"section {number + 1} of {len(laid_out)} is not dug as designed: {made.plan.note or made.plan.reason}"
            )
            return Sections(tuple(places), "not_done", words)
    told("planning sections", len(laid_out), len(laid_out))
    return Sections(tuple(places))


def layout(job: Job, finder: SpotFinder) -> tuple[Section, ...] | str:
    """The fewest possible sections of a trench, with the places for them; or why there are none.

    Digging begins at the end from which the whole trench costs less by the site map.
    """
    trench = job.dig.trench
    assert trench is not None
    area = finder.area
    reach = finder.reach.depth_range(float(area.z.min()) + job.dig.tolerance)
    if reach is None:
        return f"the teeth cannot reach a depth of {area.depth:.2f} m at any distance"
    slope = area.depth / math.tan(LEAVE) + _OVERLAP
    longest = reach[1] - max(reach[0], EDGE) - 2.0 * _SPARE
    if longest <= slope + _OVERLAP:
        return f"the teeth reach {area.depth:.2f} m deep over only {max(longest, 0.0):.2f} m, too short for its slopes"
    fewest = max(math.ceil((trench.length - slope) / (longest - slope) - 1e-9), 1)
    why = ""
    for count in range(fewest, min(fewest + 2, MOST_PLACES) + 1):
        found = []
        for backward in (False, True):
            sections = _laid_out(job, finder, trench, count, slope, reach, backward=backward)
            if isinstance(sections, str):
                why = why or sections
            else:
                cost = sum(one.spots[0].cost * (one.end - one.start) for one in sections)
                found.append((cost, backward, sections))
        if found:
            return min(found, key=lambda one: one[:2])[2]
    return why or f"it takes more than {MOST_PLACES} places"


def _laid_out(
    job: Job,
    finder: SpotFinder,
    trench: Trench,
    count: int,
    slope: float,
    reach: tuple[float, float],
    *,
    backward: bool,
) -> tuple[Section, ...] | str:
    length = (trench.length + (count - 1) * slope) / count
    begin, ahead = _line(trench, backward)
    found = []
    for number in range(count):
        start = number * (length - slope)
        end = trench.length if number == count - 1 else start + length
        dig = _section(finder, trench, (start, end), backward=backward)
        spots = _spots(job, finder, dig, (start, end), (begin, ahead), reach)
        if isinstance(spots, str):
            return f"section {number + 1} of {count}, {start:.2f} to {end:.2f} m along the trench: {spots}"
        found.append(Section(start, end, dig, spots))
    return tuple(found)


def _line(trench: Trench, backward: bool) -> tuple[Vector, Vector]:
    """(2,) where digging begins, and (2,) the direction in which the machine moves back."""
    a, b = np.array(trench.start), np.array(trench.end)
    if backward:
        a, b = b, a
    return a, (b - a) / trench.length


def _section(finder: SpotFinder, trench: Trench, part: tuple[float, float], *, backward: bool) -> dict[str, Any]:
    """A part of a trench as a trench of its own: its depth counts from the ground at its own beginning."""
    begin, ahead = _line(trench, backward)
    first, last = begin + part[0] * ahead, begin + part[1] * ahead
    along = trench.length - part[0] if backward else part[0]
    slope = -trench.slope if backward else trench.slope
    start, here = (float(h) for h in finder.site.ground.height_at(np.array([trench.start, first])))
    depth = here - (start - trench.depth - trench.slope * along)
    return {
        "trench": {
            "from": _rounded(first), "to": _rounded(last), "width": trench.width, "depth": round(depth, 6),
            "slope": slope, "tolerance": trench.tolerance,
        }
    }  # fmt: skip


def _rounded(point: Vector) -> list[float]:
    return [round(value, 6) + 0.0 for value in point.tolist()]


def _spots(
    job: Job, finder: SpotFinder, dig: dict[str, Any], part: tuple[float, float], line: tuple[Vector, Vector],
    reach: tuple[float, float],
) -> tuple[Spot, ...] | str:  # fmt: skip
    begin, ahead = line
    area = dig_area(build_worksite(job_with(job, obstacles=False, dig=dig)))
    own = finder.for_area(area)
    away = np.arange(part[1] + reach[0] + _SPARE, part[0] + reach[1] - _SPARE + 1e-9, LINE_STEP)
    clear = _clear_of_the_way(own, begin + part[1] * ahead, ahead)
    every = [own.at(begin + float(u) * ahead, toward=-ahead, dumps=clear) for u in away]
    fine = [spot for spot in every if math.isfinite(spot.cost) and spot.share >= 1.0 - SAME_SHARE]
    if not fine:
        refused = [spot for spot in every if not math.isfinite(spot.cost)]
        return refused[len(refused) // 2].why if refused else "out of reach"
    return tuple(sorted(fine, key=lambda spot: spot.cost))


def _clear_of_the_way(finder: SpotFinder, start: Vector, ahead: Vector) -> list[int]:
    """Numbers of the dumps that are clear of the machine when it drives back along a line from `start` (2,) [m]."""
    half = max((float(np.abs(outline[:, 1]).max()) for outline in finder.footprint.outlines), default=0.0)
    found = []
    for number, dump in enumerate(finder.dumps):
        off = dump.keep_off - start
        along, aside = off @ ahead, np.abs(off @ np.array([-ahead[1], ahead[0]]))
        if not ((along > -dump.distance) & (aside < half + dump.distance)).any():
            found.append(number)
    return found


def _whole_ground(job: Job, finder: SpotFinder) -> dict[str, Any]:
    """The common ground of all sections: each begins on the ground that the previous one leaves."""
    given = job.model_dump(mode="json", by_alias=True, exclude_unset=True).get("ground", {})
    if job.ground.file is not None or job.ground.low is not None:
        return dict(given)
    trench = job.dig.trench
    assert trench is not None
    farthest = finder.reach.farthest + _AROUND
    ends = np.array([trench.start, trench.end])
    points: list[Matrix] = [ends - farthest, ends + farthest]
    points += [dump.keep_off - dump.distance for dump in finder.dumps]
    points += [dump.keep_off + dump.distance for dump in finder.dumps]
    every, cell = np.vstack(points), job.ground.cell
    low, high = np.floor(every.min(axis=0) / cell) * cell, np.ceil(every.max(axis=0) / cell) * cell
    return dict(given) | {"low": _rounded(low), "high": _rounded(high), "cell": cell}


def _dig(
    job: Job, finder: SpotFinder, section: Section, at: tuple[int, dict[str, Any], Terrain | None], *, effort: str,
    seed: int,
) -> Place | str:  # fmt: skip
    """One section, planned from the best of its places that works; or why none works.

    Parameters
    ----------
    at: the number of the section, the ground of all sections, and its present terrain.
    """
    number, ground, terrain = at
    best: Place | None = None
    why = ""
    for spot in first_apart(section.spots, _TRIES, distance=_APART):
        heaps = None
        if job.dump.heap is not None:
            heaps = [finder.dumps[index].place.tolist() for index in spot.dumps]
        name = f"{job.name or 'trench'}, section {number}"
        own = job_with(job, base=spot.base, dig=section.dig, ground=ground, heaps=heaps, name=name)
        try:
            plan = plan_job(own, effort=effort, seed=seed, terrain=terrain)
        except InputError as error:
            why = why or str(error)
            continue
        if reaches_machine(plan, spot.base, finder):
            plan = replace(plan, failure="blocked", note="the heap reaches the machine")
        trench = own.dig.trench
        assert trench is not None
        place = Place(spot.base, plan, np.array([trench.start, trench.end]))
        if plan.verified:
            return place
        if best is None or plan.bank > best.plan.bank:
            best = place
    return why if best is None else best
