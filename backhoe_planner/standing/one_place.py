"""One place for a whole job: the best of the map are estimated; the best of these and the given place are planned."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.errors import InputError
from backhoe_planner.job import Job, JobEstimate, JobPlan, estimate_job, plan_estimated
from backhoe_planner.machine import Base
from backhoe_planner.standing.moved_job import job_with
from backhoe_planner.standing.result import RankedPlace
from backhoe_planner.standing.site_map import SAME_SHARE, SiteMap, Spot, SpotFinder

_APART = 0.35  # m between places that are estimated; chosen, so that these are not all next to each other
_SAME_PLACE = 1e-6  # m and rad: chosen far above rounding
_SAME_BANK = 0.01  # of the soil: how much less an answer may dig than the given place
_NOTED = 0.005  # m^3 left undug: less is not reported
_FEW = 0.98  # of the most soil by the estimates: places that dig less are planned last


def best_spots(found: SiteMap, count: int) -> list[Spot]:
    """The cheapest places of a map among those that reach the most soil, some distance apart from each other."""
    every = [spot for row in found.spots for spot in row if math.isfinite(spot.cost)]
    most = max((spot.share for spot in every), default=0.0)
    cheapest = sorted((one for one in every if one.share >= most - SAME_SHARE), key=lambda one: one.cost)
    return first_apart(cheapest, count, distance=_APART)


def first_apart(spots: Iterable[Spot], count: int, *, distance: float) -> list[Spot]:
    """The first `count` of `spots` that are at least a `distance` [m] apart from each other."""
    kept: list[Spot] = []
    for spot in spots:
        if len(kept) == count:
            break
        if all(math.dist(spot.base.position, other.base.position) >= distance for other in kept):
            kept.append(spot)
    return kept


def job_at(job: Job, spot: Spot, finder: SpotFinder) -> Job:
    """A job with its machine at a place, and with the heaps that are used from there."""
    heaps = None
    if job.dump.heap is not None:
        heaps = [finder.dumps[number].place.tolist() for number in spot.dumps]
    return job_with(job, base=spot.base, heaps=heaps)


def rank(
    job: Job, spots: Sequence[Spot], finder: SpotFinder, *, count: int, effort: str, seed: int,
    told: Callable[[str, int, int], object],
) -> list[RankedPlace]:  # fmt: skip
    """Places, the best first; the place of the job's file is one of them.

    Parameters
    ----------
    spots: to be estimated, except one that equals the given place.
    count: how many of them are planned in full, in addition to the given place.
    told: called with what is being done, how much of it is done, and how much there is.
    """
    own = finder.at(finder.site.plane.axis)
    here = job.site_scene.base
    given = Base(here.position, here.heading)
    others = [(job_at(job, spot, finder), spot) for spot in spots]
    others = [(one, spot) for one, spot in others if not _is_alike(one, job)]
    jobs = [job, *(one for one, _ in others)]
    rough = [own.cost, *(spot.cost for _, spot in others)]
    bases = [given, *(spot.base for _, spot in others)]
    ranked: list[RankedPlace] = []
    estimates: list[JobEstimate | InputError] = []
    for number, (one, cost, base) in enumerate(zip(jobs, rough, bases, strict=True)):
        told("estimating places", number, len(jobs))
        estimates.append(_estimate(one))
        ranked.append(_estimated(estimates[-1], RankedPlace(base, number == 0, cost)))
    most = max((one.bank for one in ranked if math.isfinite(one.estimated)), default=0.0)
    order = sorted(
        (number for number in range(1, len(jobs)) if math.isfinite(ranked[number].estimated)),
        key=lambda number: (ranked[number].bank < _FEW * most, ranked[number].estimated),
    )
    wanted = [0, *order[:count]]
    for index, number in enumerate(wanted):
        told("planning in full", index, len(wanted))
        ranked[number] = _planned(estimates[number], ranked[number], finder, effort=effort, seed=seed)
    told("planning in full", len(wanted), len(wanted))
    return in_order(ranked)


def _is_alike(one: Job, other: Job) -> bool:
    """Whether two versions of one job have the machine at the same place and use the same heaps."""
    first, second = one.site_scene.base, other.site_scene.base
    if math.dist(first.position, second.position) > _SAME_PLACE or abs(first.heading - second.heading) > _SAME_PLACE:
        return False
    if one.dump.heap is None or other.dump.heap is None:
        return one.dump.heap is other.dump.heap
    return np.array_equal(np.atleast_2d(one.dump.heap.at), np.atleast_2d(other.dump.heap.at))


def in_order(ranked: Sequence[RankedPlace]) -> list[RankedPlace]:
    """The best first: those that are verified, dig as much as the given place and cost least, then the rest.

    One of them is the given place. What is planned and verified, but digs less than that, has this in its note.
    """
    given = next(one for one in ranked if one.given)
    least = (1.0 - _SAME_BANK) * given.bank if given.plan is not None and given.plan.verified else 0.0

    def key(one: RankedPlace) -> tuple[bool, bool, bool, float]:
        plan = one.plan
        verified = plan is not None and plan.verified
        cost = one.planned if plan is not None else one.estimated
        return plan is None, not verified, one.bank < least, cost if math.isfinite(cost) else math.inf

    def told(one: RankedPlace) -> RankedPlace:
        if one.plan is None or not one.plan.verified or one.bank >= least:
            return one
        less = f"digs {100.0 * (1.0 - one.bank / given.bank):.1f} % less than the given place"
        return replace(one, note="; ".join(filter(None, (less, one.note))))

    return [told(one) for one in sorted(ranked, key=key)]


def _estimate(job: Job) -> JobEstimate | InputError:
    """The estimate of a job, or why it cannot be done as it is written."""
    try:
        return estimate_job(job)
    except InputError as error:
        return error


def _estimated(estimate: JobEstimate | InputError, place: RankedPlace) -> RankedPlace:
    if isinstance(estimate, InputError):
        return replace(place, note=_briefly(estimate))
    best = estimate.best
    return replace(place, estimated=best.cost if math.isfinite(best.cost) else math.nan, bank=best.bank)


def _planned(
    estimate: JobEstimate | InputError, place: RankedPlace, finder: SpotFinder, *, effort: str, seed: int
) -> RankedPlace:
    if isinstance(estimate, InputError):
        return place
    try:
        plan = plan_estimated(estimate, effort=effort, seed=seed)
    except InputError as error:
        return replace(place, note=_briefly(error))
    note = plan.note if plan.failure else "; ".join(one.words for one in plan.undug if one.volume >= _NOTED)
    if reaches_machine(plan, place.base, finder):
        plan = replace(plan, failure="blocked", note="the heap reaches the machine")
        note = plan.note
    return replace(place, plan=plan, bank=plan.bank, note=note)


def reaches_machine(plan: JobPlan, base: Base, finder: SpotFinder) -> bool:
    """Whether a plan puts loose soil on the ground that the machine covers."""
    end = plan.end
    fresh = end.loose - plan.start.loose > end.cell
    nodes = np.stack(np.meshgrid(end.x, end.y), axis=-1)[fresh]
    return bool(len(nodes)) and float(finder.footprint.distances(base, nodes).min()) <= 0.0


def _briefly(error: InputError) -> str:
    found = "" if error.found is None else f": {error.found}"
    return f"{error.problem}{found}"
