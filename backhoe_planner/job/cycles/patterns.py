"""Patterns: the order in which the soil is cut, and the next cut from the present ground.

- Level layers: one after the other over the whole length, each from the far end to the near one.
- A face: the farthest part is dug to the bottom first, then the next, each cut as deep as is allowed.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.job.cuts.cut import Cut, NoCut
from backhoe_planner.job.cuts.finding import find_cut
from backhoe_planner.job.cuts.profile import Profile
from backhoe_planner.job.cycles.walls import cut_of_walls
from backhoe_planner.job.ground.sweep import BladeSweep, Sweep, swept
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.schema.work import Face, Layers
from backhoe_planner.job.worksite.lanes import LEAVE, Lane
from backhoe_planner.job.worksite.worksite import Worksite

WALLS = "walls"  # the step of a cut that takes what others have left along a wall
PLAIN = 0.15  # m, layers of the plain pattern: as an operator's manual specifies for cuts after the first
_LEFT = 0.6  # of the tolerance: soil above the floor that is not worth a cut; chosen
_SHORTEST = 0.1  # m of radius: shorter cuts are not searched for; chosen
_FACES = (0.2, 0.3, 0.4, 0.55)  # m, depths of the cuts of a face that are compared; chosen
_LAYERS = (0.1, 0.2, 0.3)  # m, depths of the level layers that are compared with the plain one; chosen
_RUN_INS = (0.3, 0.0)  # m beyond the remaining soil: beginning of a cut, at the end of a trench along its wall; chosen
_INWARD = 0.3  # m of radius between the places from which a cut is tried; chosen
_EVERY = 3  # every third place of a cut is checked for whether the arm clears the ground: 9 cm apart
_EVEN = 0.1  # m of radius: lanes whose far ends are this close to each other are dug in their order; chosen
_MOST_LAYERS = 1000  # of a pattern; chosen, it only ends what would not end
_AHEAD = 3  # layers that are tried at a time, if nothing more of the first can be cut; chosen
_SHALLOWER = (0.7, 0.5, 0.35)  # of the depth, tried in turn if a cut fills less than it might; chosen
_THINNEST = 0.01  # m: shallower cuts are not searched for, as in a lane that is dug but for a strip at its edge; chosen
# of the wanted volume: above the first no better cut is searched for; below the second it does not count as a cut;
# below the third a full one is searched for elsewhere; chosen
_FULL, _WORTH, _MEAGRE = 0.8, 0.01, 0.1
_CLOSE = 0.97  # of the wanted volume: close enough
_MOST_MORE = 1.25  # times the wanted volume: the most that is requested from a profile; chosen, above what was seen
_ENTRIES = (None, 0.8, 0.45)  # rad, angle of the edge into the ground: steep, and gentler if nothing else works; chosen
_REST = 12.0  # s of a cycle in addition to its cut, approximately


@dataclass(frozen=True)
class Pattern:
    """A way to cut.

    Attributes
    ----------
    kind: ``layers`` or ``face``.
    depth: depth of a layer, or the greatest depth of a cut of a face below the ground, smoothed over 0.3 m [m]: below
        the ground itself, a cut is deeper where it passes the step that an earlier one has left.
    """

    kind: Literal["layers", "face"]
    depth: float

    @property
    def name(self) -> str:
        """The pattern in words."""
        if self.kind == "layers":
            return f"level layers of {self.depth:.2f} m"
        return f"far end first, cuts of {self.depth:.2f} m"


@dataclass(frozen=True, eq=False)
class NextCut:
    """The next cut of a pattern.

    Attributes
    ----------
    lane: the lane of the cut.
    cut: the cut itself.
    step: its part of the pattern, in words.
    sweep: what its blade takes of the ground that it was found on, before loose soil slumps; None if not computed.
    """

    lane: Lane
    cut: Cut
    step: str
    sweep: Sweep | None = None


def patterns_to_compare(site: Worksite) -> tuple[Pattern, ...]:
    """All patterns to be compared, the plain one first; if one is prescribed, only that."""
    choice = site.job.pattern
    if isinstance(choice, Layers):
        return (Pattern("layers", choice.layers),)
    if isinstance(choice, Face):
        return (Pattern("face", choice.face),)
    plain = Pattern("layers", PLAIN)
    if choice == "plain":
        return (plain,)
    return (plain, *(Pattern("layers", depth) for depth in _LAYERS), *(Pattern("face", depth) for depth in _FACES))


def next_cut(
    site: Worksite, lanes: Sequence[Lane], pattern: Pattern, ground: Terrain, *, done: Sequence[tuple[int, float]] = ()
) -> NextCut | NoCut | None:
    """The next cut; None if nothing is left, or the reason why the rest cannot be cut.

    Parameters
    ----------
    ground: the ground as it is now.
    done: lanes, by index, and the radii [m] beyond which nothing more is tried in them.
    """
    limits = dict(done)
    refused: NoCut | None = None
    best: tuple[int, str, Vector, Cut] | None = None
    held_up = False  # whether boom or stick would touch the ground next to a cut
    under = [_LaneGround(site, lane, ground) for lane in lanes]
    floors = _floors(site, lanes, pattern, [one.profile for one in under])
    # soil that fills little of the bucket is left for later if there is more elsewhere; the bucket is drawn in only if
    # no other cut fills more of it, because that search takes longer
    for drawn_in in (False, True):
        for number, (step, floor) in floors:
            lane = lanes[number]
            places = _left(site, lane, under[number].profile, floor)
            places = places[places < limits.get(number, np.inf)]
            if not len(places) or lane.start - lane.end < _SHORTEST:
                continue
            tries = _Tries(under[number], floor, drawn_in=drawn_in)
            found = _best(tries, lane, places, pattern)
            held_up = held_up or tries.held_up
            if isinstance(found, NoCut):
                refused = refused or found
                continue
            if best is None or found.fill > _FULL:
                best = (number, step, floor, found)
            if best[3].fill > _MEAGRE:
                break
        if not held_up or (best is not None and best[3].fill > _MEAGRE):
            break
    if best is not None:
        number, step, floor, cut = best
        return _filled(under[number], floor, NextCut(lanes[number], cut, step))
    beside = cut_of_walls(site, lanes, ground, limits)
    return NextCut(*beside, WALLS) if beside is not None else refused


@dataclass(frozen=True, eq=False)
class _LaneGround:
    """The present ground under a lane.

    Attributes
    ----------
    site, lane: the lane of a worksite.
    ground: the ground.
    """

    site: Worksite
    lane: Lane
    ground: Terrain

    @cached_property
    def profile(self) -> Profile:
        """The ground under the blade."""
        site = self.site
        return Profile.of_terrain(self.ground, site.plane, self.lane.swing, width=site.bucket.width)

    @cached_property
    def raised(self) -> tuple[Vector, Vector]:
        """Radii and heights below which no point of the arm may be, see `ArmOutline.raised`."""
        site = self.site
        return site.arm.raised(Profile.of_terrain(self.ground, site.plane, self.lane.swing, width=site.arm.span))

    def is_cleared_by(self, cut: Cut) -> bool:
        """Whether boom and stick stay above the ground on a cut."""
        return bool(self.site.arm.clears(cut.q[::_EVERY], self.raised).all())


class _Tries:
    """Cuts that are tried one after the other for the same soil: the best, and the first reason for a refusal.

    Parameters
    ----------
    under: the ground under the lane.
    floor: (K,) height of the floor at the radii of the lane [m].
    drawn_in: whether the bucket is turned so that boom and stick stay above the ground beside the cut.
    """

    def __init__(self, under: _LaneGround, floor: Vector, *, drawn_in: bool) -> None:
        self._under, self.floor, self.drawn_in = under, floor, drawn_in
        self.profile = under.profile
        self.best: Cut | None = None
        self.refused: NoCut | None = None
        self.held_up = False  # whether one is out of reach because boom or stick would touch the ground next to it
        self._too_hard = set[float]()  # radii [m] from which even the thinnest cut is too much for a cylinder
        self._known: dict[tuple[float, float, float | None], Cut | None] = {}

    def find(self, start: float, depth: float, entry: float | None) -> Cut | None:
        """The cut from a radius [m] with at most a given depth [m]; None if there is none."""
        if start in self._too_hard:
            return None
        asked = (start, depth, entry)
        if asked not in self._known:
            self._known[asked] = self._found(*asked)
        return self._known[asked]

    def _found(self, start: float, depth: float, entry: float | None) -> Cut | None:
        under, site, lane = self._under, self._under.site, self._under.lane
        found = find_cut(
            site.digger, self.profile, swing=lane.swing, start=start, end=lane.end, depth=depth,
            floor=(lane.r, self.floor), volume=site.volume, entry=entry, leave=LEAVE,
            clears=(lambda q: site.arm.clears(q, under.raised)) if self.drawn_in else None,
        )  # fmt: skip
        if isinstance(found, Cut) and not under.is_cleared_by(found):
            words = f"boom or stick would touch the ground with the teeth at {start:.2f} m from the swing axis"
            found = NoCut("reach", words, start)
        if isinstance(found, NoCut):
            self.held_up = self.held_up or found.kind == "reach"
            self.refused = self.refused or found
            if found.kind == "cylinder":
                self._too_hard.add(start)
            return None
        self.best = found if self.best is None or _rate(found) > _rate(self.best) else self.best
        return found


def _best(tries: _Tries, lane: Lane, left: Vector, pattern: Pattern) -> Cut | NoCut:
    """The cut from the far end of what is left, at radii `left` (k,) [m], or from further in if there is none.

    If it fills less than most of the bucket, shallower cuts and other beginnings are tried, too.
    """
    profile, floor = tries.profile, tries.floor
    depth = pattern.depth if pattern.kind == "face" else float(np.max(profile.mean)) - float(np.min(floor)) + 1.0
    # fractions of what there is to cut, which may be less than a cut of the pattern
    high = min(depth, float(np.max(profile.height(left) - np.interp(left, lane.r, floor))))
    shallower = () if tries.drawn_in else tuple(part * high for part in _SHALLOWER if part * high > _THINNEST)
    entries = _ENTRIES[:1] if tries.drawn_in else _ENTRIES
    places = left[::-1][:: max(int(_INWARD / (left[1] - left[0])), 1)] if len(left) > 1 else left
    for entry, place, most in itertools.product(entries, places.tolist(), (depth, *shallower)):
        if entry is not None and tries.best is not None and tries.best.fill >= _WORTH:
            break
        for run_in in _RUN_INS:
            start = min(max(place + run_in, lane.end + _SHORTEST), lane.start)
            found = tries.find(start, most, entry)
            if found is not None and (
                found.fill > _FULL or (found.r[-1] < left[0] and place == left[-1] and found.fill >= _WORTH)
            ):
                return found
    if tries.best is None or tries.best.fill < _WORTH:
        nothing = f"what is left at r {left[-1]:.2f} m fills less than {100 * _WORTH:.0f} %"
        return tries.refused or NoCut("nothing", nothing)
    return tries.best


def _filled(under: _LaneGround, floor: Vector, chosen: NextCut) -> NextCut:
    """The cut, lengthened if the sweep over the columns of the ground takes less than the profile says.

    Under the ends of the edge, the profile counts partly cut columns as soil that is still there.
    """
    site, lane, cut = under.site, under.lane, chosen.cut
    sweep = sweep_of(cut, under.ground)
    chosen, taken = replace(chosen, sweep=sweep), float(sweep.volume[-1])
    if not cut.is_full or taken <= 0.0 or taken > _CLOSE * site.volume:
        return chosen
    more = min(site.volume / taken, _MOST_MORE) * site.volume
    found = find_cut(
        site.digger, under.profile, swing=lane.swing, start=float(cut.r[0]), end=lane.end,
        depth=max(cut.greatest_depth, 1e-3), floor=(lane.r, floor), volume=more, leave=LEAVE,
    )  # fmt: skip
    if isinstance(found, NoCut) or found.loose_volume < cut.loose_volume:
        return chosen
    return replace(chosen, cut=found, sweep=None) if under.is_cleared_by(found) else chosen


def sweep_of(cut: Cut, ground: Terrain) -> Sweep:
    """What the blade of a cut takes of the ground, before loose soil slumps."""
    return swept(ground, BladeSweep(cut.position, cut.across, cut.bucket.width), slump=False)


def shallower(site: Worksite, chosen: NextCut, ground: Terrain, part: float) -> NextCut | None:
    """The same cut with at most `part` of its depth, and longer accordingly; None if there is none.

    Parameters
    ----------
    ground: the ground as it is now.
    """
    cut, lane = chosen.cut, chosen.lane
    profile = Profile.of_terrain(ground, site.plane, lane.swing, width=site.bucket.width)
    found = find_cut(
        site.digger, profile, swing=lane.swing, start=float(cut.r[0]), end=lane.end,
        depth=max(part * cut.greatest_depth, 1e-3), floor=(lane.r, lane.line), volume=cut.wanted, leave=LEAVE,
    )  # fmt: skip
    return None if isinstance(found, NoCut) else replace(chosen, cut=found)


def _rate(cut: Cut) -> float:
    """Soil divided by the approximate time of the cycle [m^3/s]."""
    return cut.loose_volume / (cut.time + _REST)


def _floors(
    site: Worksite, lanes: Sequence[Lane], pattern: Pattern, profiles: Sequence[Profile]
) -> list[tuple[int, tuple[str, Vector]]]:
    """Lanes by index with the floor to which each is dug now, in the order in which they are tried."""
    every = range(len(lanes))
    if pattern.kind == "face":
        # the lane that reaches farthest out is first, so that the face retreats evenly
        def far(number: int) -> float:
            places = _left(site, lanes[number], profiles[number], lanes[number].line)
            return round(float(places[-1]) / _EVEN) if len(places) else -np.inf

        order = sorted(every, key=far, reverse=True)
        return [(number, (f"lane {number + 1}" if len(lanes) > 1 else "face", lanes[number].line)) for number in order]
    found: list[tuple[int, tuple[str, Vector]]] = []
    layers, firsts = 0, [_first_ground(site, lane) for lane in lanes]
    for layer in range(1, _MOST_LAYERS):
        last, here = True, []
        for number in every:
            lane = lanes[number]
            level = firsts[number] - layer * pattern.depth
            floor = np.maximum(lane.line, level)
            last = last and bool(np.all(floor <= lane.line + 1e-9))
            if len(_left(site, lane, profiles[number], floor)):
                here.append((number, (f"layer {layer}", floor)))
        found += here
        layers += bool(here)
        # soil of one layer that cannot be cut is cut with the next
        if last or layers == _AHEAD:
            break
    return found


def _first_ground(site: Worksite, lane: Lane) -> Vector:
    """(K,) height of the ground in a lane before the first cut [m]."""
    profile = Profile.of_terrain(site.ground, site.plane, lane.swing, width=site.bucket.width)
    return np.asarray(profile.height(lane.r))


def _left(site: Worksite, lane: Lane, profile: Profile, floor: Vector) -> Vector:
    """Radii of a lane at which there is soil above a floor that is worth a cut [m]."""
    middle = np.median(profile.surface, axis=1)
    # a steep end counts as met up to one cell beside it
    step = site.ground.cell
    upper = np.max([np.interp(lane.r + off, lane.r, floor) for off in (-step, 0.0, step)], axis=0)
    above = np.interp(lane.r, profile.r, middle) - upper
    inside = (lane.r >= lane.end - 1e-9) & (lane.r <= lane.start + 1e-9)
    return np.asarray(lane.r[inside & (above > _LEFT * site.job.dig.tolerance)])
