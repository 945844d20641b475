"""Which of many cuts: good ones to begin with, by time or work per cubic metre.

Cuts from several places, of several depths, are found and priced without planning how the bucket
gets there and away: what that takes is an assumption of the caller, the same for each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from backhoe_planner.arrays import Array, Vector, as_array, as_count, as_number
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.job.cuts.cut import Cut
from backhoe_planner.job.cuts.digger import Digger
from backhoe_planner.job.cuts.finding import find_cut
from backhoe_planner.job.cuts.profile import Profile

# m below the ground; chosen: an operator's manual has 75 to 150 mm, and deeper ones fill this bucket over a shorter way
_DEPTHS = (0.1, 0.2, 0.35)
_STARTS = 3  # places; chosen: the furthest with soil, and two nearer ones
_LEAST = 0.03  # m of soil above the floor at a place where a cut may begin; chosen, below the usual tolerance
_BESIDES = 12.0  # s of a cycle besides the cut; chosen, cycles of this class take 15 to 35 s and cuts 4 to 9
_BESIDES_WORK = 30e3  # J of a cycle besides the cut; chosen, a bucket of 500 kg is lifted by some 3 m, and the arm


def price(cut: Cut, *, by: Literal["time", "work"] = "time", besides: float | None = None) -> float:
    """What a cut and the rest of its cycle cost per cubic metre of undisturbed soil [s/m^3 or J/m^3].

    Parameters
    ----------
    by: ``time`` or ``work``.
    besides: what the rest of the cycle takes [s or J]; by default 12 s or 30 kJ.
    """
    own, usual = (cut.time, _BESIDES) if by == "time" else (cut.work, _BESIDES_WORK)
    return (own + (usual if besides is None else besides)) / max(cut.solid_volume, 1e-9)


def cut_candidates(
    digger: Digger,
    profile: Profile,
    *,
    swing: float,
    end: float,
    start: float,
    floor: tuple[Vector, Vector],
    depths: Sequence[float] | Array = _DEPTHS,
    starts: int = _STARTS,
    volume: float | None = None,
    by: Literal["time", "work"] = "time",
    besides: float | None = None,
) -> tuple[Cut, ...]:
    """Cuts between two radii, the cheapest per cubic metre first; none where nothing can be dug there.

    Parameters
    ----------
    digger, profile, swing, floor, volume: as of `find_cut`.
    start, end: the furthest and the nearest radius at which the edge may be in the ground [m].
    depths: of the cuts, at most [m].
    starts: at how many places they begin: the furthest with soil above the floor, and others towards `end`.
    by, besides: as of `price`.

    Raises
    ------
    InputError: see `find_cut`.
    """
    check_kind(profile, Profile, key="profile")
    as_count(starts, key="starts", least=1)
    start, end = as_number(start, key="start"), as_number(end, key="end")
    if by not in ("time", "work"):
        raise InputError("is no price", key="by", found=str(by), allowed="time, work")
    depth = as_array(depths, None, key="depths")
    found = [
        find_cut(digger, profile, swing=swing, start=at, end=end, depth=float(d), floor=floor, volume=volume)
        for at in _places(profile, floor, (end, start), starts)
        for d in depth
    ]
    cuts = [one for one in found if isinstance(one, Cut)]
    return tuple(sorted(cuts, key=lambda cut: price(cut, by=by, besides=besides)))


def _places(profile: Profile, floor: tuple[Vector, Vector], between: tuple[float, float], count: int) -> list[float]:
    """Radii at which cuts begin, the furthest first [m]."""
    r = profile.r
    soil = (profile.mean - np.interp(r, *floor) > _LEAST) & (r >= between[0]) & (r <= between[1])
    if not soil.any():
        return []
    step = float(np.max(np.diff(r)))
    furthest = min(float(r[np.flatnonzero(soil)[-1]]) + step, between[1])
    nearest = float(r[np.flatnonzero(soil)[0]])
    places = np.linspace(furthest, nearest, count + 1)[:-1]
    return [float(at) for at in places if at > between[0] + step and not math.isclose(at, between[0])]
