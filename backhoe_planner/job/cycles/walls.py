"""The walls of a trench that is wider than the bucket: strips that are left next to the cuts.

A lane is sampled across less than the width of the blade, because only the mean height of the columns at its ends
is known. It counts as dug if most of that width is dug. The rest is a strip that only an end of the blade reaches.
A sweep along the floor of the lane tells how much of the strip the whole blade would take. Spread over the width
of the blade, that volume is the ground for which a cut is searched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.job.cuts.cut import Cut
from backhoe_planner.job.cuts.finding import find_cut
from backhoe_planner.job.cuts.profile import RIM, Profile
from backhoe_planner.job.cycles.cut_leg import blade_of
from backhoe_planner.job.ground.sweep import Sweep, swept
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.worksite.lanes import LEAVE, Lane, allowed_heights
from backhoe_planner.job.worksite.worksite import Worksite

_WHOLE = 1.0 - 1e-9  # of a column: then it counts as wholly within the design
_THIN = 0.05  # m of that soil, for a cut to be found; chosen
_PROGRESS = 1e-3  # m^3, the least that a cut takes; chosen
# least part of a bucketful for a cut if no lane runs along the walls, so that some soil stays anyway; chosen
_ASKEW_PROGRESS = 0.05
_WORTH = 1e-3  # m of soil, spread over the width of the blade; chosen
_INWARD = 0.3  # m of radius between the places from which a cut is tried; chosen
_RUN_IN = 0.3  # m beyond the remaining soil at which a cut begins; chosen
_SHORTEST = 0.1  # m of radius
_SPARE = 0.01  # m beyond the clearance of the arm, for positions between the sampled ones; chosen


def cut_of_walls(
    site: Worksite, lanes: Sequence[Lane], ground: Terrain, limits: Mapping[int, float]
) -> tuple[Lane, Cut] | None:
    """A cut of what remains next to the other cuts, with its lane; None if nothing remains, or it cannot be cut.

    Parameters
    ----------
    ground: the ground as it is now.
    limits: radii [m] beyond which nothing more is tried, by index of the lane.
    """
    if len(lanes) < 2:
        return None
    allowed, _ = allowed_heights(site, lanes, site.design_heights())
    over = ground.surface - allowed
    stays = (over > site.job.dig.tolerance) & (site.share > _WHOLE)
    if not stays.any():
        return None
    points, high, surface = site.nodes[stays] - site.plane.axis, over[stays], ground.surface[stays]
    under: list[tuple[float, int]] = []
    for number, lane in enumerate(lanes):
        out, left = site.plane.directions(lane.swing)
        along, aside = points @ out, np.abs(points @ left)
        covered = np.clip((0.5 * site.bucket.width - aside) / ground.cell + 0.5, 0.0, 1.0)
        covered[(along < lane.end) | (along > lane.start)] = 0.0
        taken = covered * np.clip(surface - np.interp(along, lane.r, lane.line), 0.0, high)
        if taken.any():
            under.append((float(taken.sum()), number))
    for _, number in sorted(under, key=lambda one: -one[0]):
        found = _cut_in(site, lanes[number], ground, limits.get(number, np.inf))
        if found is not None:
            return lanes[number], found
    return None


def _cut_in(site: Worksite, lane: Lane, ground: Terrain, limit: float) -> Cut | None:
    """A cut in one lane of the soil that the whole blade would take there."""
    profile, thickness = _spread(site, lane, ground)
    left = profile.r[(thickness > _WORTH) & (profile.r < limit)]
    if not len(left):
        return None
    # all of the ground under the arm, because the remaining strip is to one side
    under = Profile.of_terrain(ground, site.plane, lane.swing, width=site.arm.span + 2.0 * RIM * ground.cell)
    at, highest = site.arm.raised(under)
    raised = (at, highest + _SPARE)
    least = _PROGRESS if site.job.dig.trench is not None else max(_PROGRESS, _ASKEW_PROGRESS * site.volume)
    for place in np.arange(left[-1], left[0] + _SHORTEST, -_INWARD).tolist():
        start = min(max(place + _RUN_IN, lane.end + _SHORTEST), lane.start)
        for drawn_in in (False, True):
            found = find_cut(
                site.digger, profile, swing=lane.swing, start=start, end=lane.end, depth=float(np.max(thickness)) + 1.0,
                floor=(lane.r, lane.line), volume=site.volume, leave=LEAVE,
                clears=(lambda q: site.arm.clears(q, raised)) if drawn_in else None,
            )  # fmt: skip
            if (
                isinstance(found, Cut)
                and site.arm.clears(found.q, raised).all()
                and float(_sweep(site, ground, found.position, lane.swing).volume[-1]) > least
            ):
                return found
    return None


def _spread(site: Worksite, lane: Lane, ground: Terrain) -> tuple[Profile, Vector]:
    """The floor of a lane plus the soil that the blade takes above it, spread over its width, and (K,) its height [m].

    Beyond the lane's ends, the profile is the present ground.
    """
    inside = (lane.r >= lane.end) & (lane.r <= lane.start)
    r = lane.r[inside][::-1]
    bank, loose = np.zeros(len(lane.r)), np.zeros(len(lane.r))
    if len(r) > 1:
        edge = site.plane.world(lane.swing, r, lane.line[inside][::-1])
        sweep = _sweep(site, ground, edge, lane.swing)
        area = site.bucket.width * -np.gradient(r)
        bank[inside] = np.maximum(np.gradient(sweep.bank) / area, 0.0)[::-1]
        loose[inside] = np.maximum(np.gradient(sweep.loose) / area, 0.0)[::-1]
    # soil that is too thin for a cut of the whole blade is made higher: it is that thick where it really is
    more = max(_THIN / max(float(np.max(bank + loose)), _WORTH), 1.0)
    around = Profile.of_terrain(ground, site.plane, lane.swing, width=site.bucket.width)
    floor = np.where(inside, lane.line, around.height(lane.r))
    return Profile(lane.r, (floor + more * bank)[:, None], more * loose[:, None]), bank + loose


def _sweep(site: Worksite, ground: Terrain, edge: Matrix, swing: float) -> Sweep:
    """The soil that the blade takes along its path."""
    return swept(ground, blade_of(site, edge, swing), slump=False)
