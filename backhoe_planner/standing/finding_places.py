"""`stand`: finds the places from which a job is dug in least time or work."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace

from backhoe_planner.arrays import as_count
from backhoe_planner.errors import InputError, check_callable, check_kind
from backhoe_planner.job import Job, build_worksite
from backhoe_planner.planning import check_effort
from backhoe_planner.standing.dig_area import dig_area
from backhoe_planner.standing.moved_job import job_with
from backhoe_planner.standing.one_place import best_spots, rank
from backhoe_planner.standing.reach_map import reach_map
from backhoe_planner.standing.result import Place, StandPlan, StandReason
from backhoe_planner.standing.sections import dig_in_sections
from backhoe_planner.standing.site_map import REASONS, SAME_SHARE, SiteMap, SpotFinder, site_map

_ESTIMATED = {"quick": 5, "normal": 10, "thorough": 20}  # places; chosen, an estimate takes a tenth of a plan's time
_PLANNED = 2  # places that are planned in full in addition to the given one, by default


@dataclass(frozen=True)
class StandStep:
    """A progress report of the search for places.

    Attributes
    ----------
    what: what is being done, in words.
    done, total: how much of it is done, and how much there is.
    """

    what: str
    done: int
    total: int


def stand(
    job: Job,
    *,
    count: int = _PLANNED,
    effort: str = "quick",
    seed: int = 0,
    watch: Callable[[StandStep], object] | None = None,
) -> StandPlan:
    """Find the place, or the fewest places in order, from which a job is dug in least time or work per m^3.

    Parameters
    ----------
    job: its machine is to be placed; its `objective` says whether time or work counts.
    count: how many of the best places are planned in full in addition to the given one, 1 or more.
    effort: ``quick``, ``normal`` or ``thorough``: how many places are estimated, and the effort of all plans.
    seed: of every random choice, not negative.
    watch: called with a `StandStep` as the search goes on.

    Returns
    -------
    The answer in any case. If the given place can be planned, the answer digs the same soil and costs no more.

    Raises
    ------
    InputError: the job cannot be done as it is written, wherever its machine stands; or an argument is not allowed.
    """
    check_kind(job, Job, key="job")
    count = as_count(count, key="count", least=1)
    seed = as_count(seed, key="seed")
    effort, watch = check_effort(effort), check_callable(watch, key="watch")

    def told(what: str, done: int, total: int) -> None:
        if watch is not None:
            watch(StandStep(what, done, total))

    begun = clock.monotonic()
    finder = spot_finder(job, told)
    found = site_map(finder, lambda done, total: told("looking at places", done, total))
    most = max((spot.share for row in found.spots for spot in row if math.isfinite(spot.cost)), default=0.0)
    empty = StandPlan(
        job, (), (), found, finder.footprint.outlines, robot=finder.site.robot, ground=finder.site.ground,
        dumps=tuple(dump.outline for dump in finder.dumps),
    )  # fmt: skip
    trench = job.dig.trench
    if trench is not None and most < 1.0 - SAME_SHARE:
        made = dig_in_sections(job, finder, effort=effort, seed=seed, told=told)
        note = f"{made.note}; {_where_most(found)}" if made.failure else made.note
        answer = replace(empty, places=made.places, failure=made.failure, note=note)
    elif most <= 0.0:
        answer = replace(empty, failure="blocked", note=_why_nowhere(found))
    else:
        spots = best_spots(found, _ESTIMATED[effort])
        ranked = rank(job, spots, finder, count=count, effort=effort, seed=seed, told=told)
        best = ranked[0]
        places = () if best.plan is None else (Place(best.base, best.plan),)
        failure: StandReason = "" if best.plan is not None else "blocked"
        note = best.note if best.plan is None or not best.plan.verified else ""
        if most < 1.0 - SAME_SHARE:
            note = f"no place reaches more than {100.0 * most:.0f} % of what is to be dug" + (
                f"; {note}" if note else ""
            )
            failure = "unreachable"
        answer = replace(empty, places=places, ranking=tuple(ranked), failure=failure, note=note)
    return replace(answer, planning_time=clock.monotonic() - begun)


def spot_finder(job: Job, told: Callable[[str, int, int], object]) -> SpotFinder:
    """Build the `SpotFinder` that evaluates any place for a job.

    Parameters
    ----------
    told: called with what is being done, how much of it is done, and how much there is.
    """
    told("mapping the reach", 0, 1)
    free = build_worksite(job_with(job, obstacles=False))
    area = dig_area(free)
    if not len(area.points):
        raise InputError("nothing is to be dug: the design lies at or above the ground", key="dig", file=job.file)
    # ground that rises from where the machine stands is not beside the machine, where its arm would be in it
    ground = area.ground if job.ground.file is None else min(area.ground, 0.0)
    reach = reach_map(job, ground=ground, depth=ground - float(area.z.min()))
    told("mapping the reach", 1, 1)
    return SpotFinder(job, free, area, reach)


def _why_nowhere(found: SiteMap) -> str:
    """Why the machine cannot stand at the places that reach most, in words."""
    refused = [spot for row in found.spots for spot in row if spot.reason]
    best = max(refused, key=lambda spot: (spot.share, REASONS.index(spot.reason)))
    x, y = best.base.position
    if best.share <= 0.0:
        return f"no part of the dig can be dug from any place: {best.why}"
    return f"the machine cannot stand anywhere; x {x:.2f}, y {y:.2f} m, which reaches most, is ruled out: {best.why}"


def _where_most(found: SiteMap) -> str:
    """The place from which most of the soil could be dug, in words."""
    standing = [spot for row in found.spots for spot in row if math.isfinite(spot.cost)]
    if not standing:
        return _why_nowhere(found)
    best = max(standing, key=lambda spot: (spot.share, -spot.cost))
    x, y = best.base.position
    return f"most of it ({100.0 * best.share:.0f} %) could be dug from x {x:.2f}, y {y:.2f} m"
