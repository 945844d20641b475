"""Lanes: the planes in which the arm digs, and how deep the edge may and can go in each of them.

A position of the teeth is checked at several pitches against the machine's limits, and against every obstacle and
zone with its clearance. Only positions that can be reached from the ground down without a gap count. They give the
floor of a lane. Above the floor, the lowest line of an edge goes down and up at no more than two angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.job.cuts.arm_plane import ArmPlane
from backhoe_planner.job.cuts.attitude import back_heights
from backhoe_planner.job.cuts.edge_path import Descent, Underground
from backhoe_planner.job.cuts.profile import Profile
from backhoe_planner.job.schema.work import Trench
from backhoe_planner.job.worksite.worksite import Worksite
from backhoe_planner.site import ClearanceScreen, Proximity, obstacles_in_reach

# rad: 80 and 69 degrees; an edge that leaves more steeply pushes the soil out again. Chosen: with 86 and 80, 0.15 m^3
# less is left at the ends of a trench of 3 m, but it takes 21 cuts instead of 14
ENTRY, LEAVE = 1.4, 1.2
_STEP = 0.025  # m of radius: half of a cell of 5 cm
_ACROSS = 7  # places across the blade; chosen, less than two cells of 5 cm apart
_PITCHES = np.linspace(-2.7, -0.6, 12)  # rad at which teeth may dig: from nearly level to a plate that points down
_DOWN = 0.05  # m by which each step of the check goes deeper; chosen, a cell
_SPARE = 0.01  # m beyond every clearance, for positions between the sampled ones; chosen
_SAME = 1e-9  # m
_BACK = 0.05  # m between the bucket's back and the remaining ground; chosen: cuts keep 3 cm, and turn only slowly
_ARM = 0.05  # m that boom and stick keep from that ground beyond the clearance; chosen, for the same reason
_AGAIN = 3  # times that the floor is checked again, because the ground left beside a place is raised too; chosen
_FAN = 0.04  # rad between lanes of a wide design: 20 cm at 5 m; chosen, a third of a bucket's width
_BESIDE = 1e-3  # m to each side of the blade: a trench that is no wider than that is dug in one lane; chosen
_OUT = 0.98  # of the tolerance, by which a blade along a wall may go beyond it; chosen, below 1 for rounding
_NEAREST = 0.2  # of the distance to a trench's far end: nothing nearer can be dug
_ENTERING = 0.05  # m; chosen: the corners of an edge's line are rounded
_STRIPS = 40  # strips across a column, each checked for whether a blade reaches it; chosen, 2.5 cm in 1 m
_CLOSEST = 0.15  # m of radius from one lane along a wall to the next; chosen
_OVERLAP = 0.8  # of the blade's width from one lane to the next, at the far end of a trench; chosen


@dataclass(frozen=True, eq=False)
class Lane:
    """One plane of the arm, and the soil that is dug in it.

    Attributes
    ----------
    swing: angle of the plane [rad].
    r: (K,) radii [m].
    design: (K,) height of the design under the blade [m]; nan where nothing is to be dug.
    floor: (K,) the lowest height that the edge may and can have [m]; at the ground where nothing is to be dug.
    line: (K,) the lowest line of an edge above that floor [m].
    cause: (K,) what raised the floor above the design, as an index into `causes`; 0 where nothing did.
    causes: kind and name of each cause: ``protected`` by an obstacle or zone, or ``out_of_reach``; the first is empty.
    start, end: radii between which the lane is dug [m].
    """

    swing: float
    r: Vector
    design: Vector
    floor: Vector
    line: Vector
    cause: NDArray[np.int64]
    causes: tuple[tuple[str, str], ...]
    start: float
    end: float


def lanes_of(site: Worksite) -> tuple[Lane, ...]:
    """All lanes of a design; empty if no plane of the arm has the whole width of a bucket in the design."""
    plane, outline = site.plane, site.design.outline
    off = outline - plane.axis
    headings = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    middle = _swing_to(plane, outline.mean(axis=0) - plane.axis)
    half = 0.5 * float(np.ptp(headings))
    count = int(half / _FAN)
    swings = middle + _FAN * np.arange(-count, count + 1)
    if site.job.dig.trench is not None:
        own = _along_trench(site, middle)
        swings = swings if own is None else own
    proximity = Proximity(site.robot, obstacles_in_reach(site.robot, site.problem.obstacles))
    screen = ClearanceScreen(proximity, spare=_SPARE)
    found = [_lane(site, float(swing), screen, proximity) for swing in swings]
    return tuple(lane for lane in found if lane is not None)


def passes_beside(site: Worksite, trench: Trench) -> float:
    """Distance between the line of a trench and the swing axis [m]."""
    off = site.plane.axis - trench.start
    return abs(float(off[0] * trench.ahead[1] - off[1] * trench.ahead[0]))


def _swing_to(plane: ArmPlane, direction: Vector, *, beside: float = 0.0) -> float:
    """The swing angle of the plane in a direction (2,), turned by `beside` about z [rad]."""
    zero = plane.heading(0.0)
    turned = float(np.arctan2(direction[1], direction[0])) + beside - zero
    wrapped = float((turned + np.pi) % (2.0 * np.pi) - np.pi)
    return wrapped if plane.heading(1.0) > zero else -wrapped


def _along_trench(site: Worksite, near: float) -> Vector | None:
    """(L,) the swing angles that fill a trench that points at the machine; None for any other trench.

    Parameters
    ----------
    near: swing angle of the middle of the trench [rad].

    The blade runs along a wall where its plane crosses the wall. Further out it goes beyond the trench, by at most the
    tolerance; further in it leaves a wedge, for which there is another lane.
    """
    trench = site.job.dig.trench
    assert trench is not None
    plane, slack = site.plane, trench.tolerance
    offsets = np.array([trench.start, trench.end]) - plane.axis
    far, close = sorted(offsets.tolist(), key=lambda one: -float(np.hypot(*one)))
    ahead = np.subtract(far, close) / trench.length
    left = np.array([-ahead[1], ahead[0]])
    aside = float(np.mean(offsets @ left))
    reach = float(np.dot(far, ahead))
    room = 0.5 * (trench.width - site.bucket.width)
    if room <= _BESIDE:
        # one lane is enough if a blade of another width fills the trench within the tolerance
        return np.array([near]) if float(np.abs(offsets @ plane.directions(near)[1]).max()) <= slack else None
    if reach <= 0.0 or abs(aside) >= room:
        return None
    nearest = max(float(np.dot(close, ahead)), _NEAREST * reach)
    # at the far end of every lane the edge goes down at an angle
    entry = (trench.depth + max(trench.slope, 0.0) * trench.length) / np.tan(ENTRY) + _ENTERING
    walls = [side * np.array(_wall(room + side * aside, slack, (reach, nearest), entry)) for side in (1.0, -1.0)]
    first, last = walls[1][0], walls[0][0]
    between = int(np.ceil((last - first) * reach / (_OVERLAP * site.bucket.width)))
    turned = np.unique(np.concatenate((walls[1], np.linspace(first, last, between + 1)[1:-1], walls[0])))
    return np.sort([_swing_to(plane, ahead, beside=one) for one in turned.tolist()])


def _wall(room: float, slack: float, between: tuple[float, float], entry: float) -> list[float]:
    """Angles from the direction of a trench [rad] at which the blade's end runs along a wall, the farthest out first.

    Parameters
    ----------
    room: distance from the blade's end to the wall, with the blade in the trench's direction [m].
    slack: distance by which the blade may go beyond the wall [m].
    between: distances of the trench's far and near end from the swing axis [m].
    entry: length at the far end of a lane over which its edge goes down [m].
    """
    reach, nearest = between
    found: list[float] = []
    while True:
        out = (room + _OUT * slack) / reach
        along = room / nearest
        found.append(float(np.arctan(min(out, along))))
        if along <= out:
            return found
        reach = min(room / out + entry, reach - _CLOSEST)


def _lane(site: Worksite, swing: float, screen: ClearanceScreen, proximity: Proximity) -> Lane | None:
    plane, design, width = site.plane, site.design, site.bucket.width
    profile = Profile.of_terrain(site.ground, plane, swing, width=width)
    r = np.arange(profile.r[0], profile.r[-1], _STEP)
    blade = _blade_points(site, swing, r)
    # a blade may exceed the width of the design by as much as the tolerance
    inside = design.within(blade, site.job.dig.tolerance).all(axis=1)
    heights = design.height(blade)
    known = np.isfinite(heights).any(axis=1)
    inside &= known
    if np.count_nonzero(inside) < 2:
        return None
    deepest = np.where(inside, np.max(np.where(np.isfinite(heights), heights, -np.inf), axis=1), np.nan)
    ground = profile.height(r)
    inside &= deepest < ground - _SAME
    if np.count_nonzero(inside) < 2:
        return None
    places = _Places(site, swing, r, screen, proximity)
    first = np.where(inside, deepest, np.nan)
    floor, cause, causes = places.reachable(first, ground, None)
    line, reached = _line(profile, r, floor, ground, inside), floor
    for _ in range(_AGAIN):
        if line is None:
            break
        # check next to the ground that is left; ground that is raised is left, too
        left = np.where(inside, line[0], ground)
        again = places.reachable(np.where(inside, np.maximum(floor, first), np.nan), ground, left)
        reached, raised = again[0], again[0] > left + _SAME
        if not raised.any():
            break
        shift = len(causes) - 1
        cause = np.where(raised, np.where(again[1] > 0, again[1] + shift, 0), cause)
        # only a cause that holds the line up counts: each repetition the line stays above its floor by a step
        floor, causes = np.where(raised, reached, floor), (*causes, *again[2][1:])
        line = _line(profile, r, floor, ground, inside)
    if line is None:
        return Lane(swing, r, deepest, ground, ground, cause, causes, float(r[-1]), float(r[0]))
    lowest, start, end = line
    reached = np.maximum(floor, reached)
    return Lane(swing, r, deepest, reached, np.where(inside, lowest, ground), cause, causes, start, end)


def _line(
    profile: Profile, r: Vector, floor: Vector, ground: Vector, inside: Flags
) -> tuple[Vector, float, float] | None:
    """(K,) the lowest line of an edge above a floor, and the radii between which it is dug; None if nothing is dug."""
    dug = np.flatnonzero(inside & (floor < ground - _SAME))
    if len(dug) < 2:
        return None
    start, end = float(r[dug[-1]]), float(r[dug[0]])
    under = Underground(profile, (r, floor), end=end, start=start)
    lowest = under.line(float(np.max(ground - floor)) + 1.0, end, Descent(ENTRY, LEAVE))
    return np.minimum(np.interp(r, under.r, lowest), ground), start, end


def _blade_points(site: Worksite, swing: float, r: Vector) -> Array:
    """(K, A, 2) x, y of points under a blade at radii (K,) [m]."""
    _, left = site.plane.directions(swing)
    offsets = site.bucket.width * np.linspace(-0.5, 0.5, _ACROSS)
    middle = site.plane.world(swing, r, np.zeros(len(r)))[:, :2]
    return np.asarray(middle[:, None, :] + offsets[:, None] * left)


class _Places:
    """The possible positions of the teeth in one plane."""

    def __init__(
        self, site: Worksite, swing: float, r: Vector, screen: ClearanceScreen, proximity: Proximity
    ) -> None:  # fmt: skip
        self._site, self._swing, self._r, self._screen, self._proximity = site, swing, r, screen, proximity
        self._raised: tuple[Vector, Vector] | None = None
        self._final: Vector | None = None

    def reachable(
        self, design: Vector, ground: Vector, final: Vector | None
    ) -> tuple[Vector, NDArray[np.int64], tuple[tuple[str, str], ...]]:
        """(K,) the lowest heights that the teeth can reach, (K,) what stops them there, and a list of these causes.

        Parameters
        ----------
        design: (K,) greatest depth to be reached; nan where nothing is dug.
        ground: (K,) the ground before the first cut.
        final: (K,) the final ground, which arm and the bucket's back must not touch; None to leave it out. Where the
            teeth reach it there is no cause.
        """
        self._final = final
        if final is not None:
            site = self._site
            wide = Profile.of_terrain(site.ground, site.plane, self._swing, width=site.arm.span)
            beside = np.fmin(np.interp(self._r, wide.r, np.max(wide.surface, axis=1)), final)
            self._raised = (self._r, site.arm.raise_by_clearance(beside) + _ARM)
        dug = np.flatnonzero(np.isfinite(design))
        begin, held_up = ground.copy(), np.isfinite(design)
        if final is not None:
            # where the teeth reach the line itself nothing is dug below it, and what stops them there is not a cause
            reached = dug[self._free(self._r[dug], final[dug])]
            begin[reached], held_up[reached] = final[reached], False
        floor, cause = begin.copy(), np.zeros(len(self._r), dtype=np.int64)
        down = [np.array([*np.arange(begin[k], design[k], -_DOWN)[1:].tolist(), design[k]]) for k in dug.tolist()]
        blocked: dict[int, float] = {}
        going, depth = np.arange(len(dug)), 0
        while len(going):
            at = np.array([down[k][depth] for k in going.tolist()])
            free = self._free(self._r[dug[going]], at)
            floor[dug[going[free]]] = at[free]
            blocked.update(zip(dug[going[~free]].tolist(), at[~free].tolist(), strict=True))
            depth += 1
            going = np.array([k for k in going[free].tolist() if depth < len(down[k])], dtype=np.int64)
        causes: list[tuple[str, str]] = [("", "")]
        stuck = [index for index in sorted(blocked) if held_up[index]]
        stops = self._stops(self._r[stuck], np.array([blocked[index] for index in stuck])) if stuck else []
        for index, stopped in zip(stuck, stops, strict=True):
            if stopped not in causes:
                causes.append(stopped)
            cause[index] = causes.index(stopped)
        return floor, cause, tuple(causes)

    def _free(self, r: Vector, z: Vector) -> Flags:
        """(K,) whether the teeth can be at radii and heights (K,) [m], at some pitch."""
        q, _, above = self._postures(r, z)
        return np.array(
            [any(map(self._screen.keeps_unchecked, rows[free])) for rows, free in zip(q, above, strict=True)],
            dtype=bool,
        )

    def _stops(self, r: Vector, z: Vector) -> list[tuple[str, str]]:
        """What blocks the teeth at radii and heights (K,) [m] where they are not free, each as kind and name."""
        return [self._stop(*place) for place in zip(*self._postures(r, z), strict=True)]

    def _stop(self, q: Matrix, reached: Flags, above: Flags) -> tuple[str, str]:
        """What blocks the teeth at one place; q (P, n), reached, above (P,): see `_postures`."""
        if not reached.any():
            return "out_of_reach", ""
        if not above.any():
            return "out_of_reach", "boom, stick or the bucket's back would touch the ground beside it"
        named = [one for row in q[above] if (one := self._proximity.tightest(row)) is not None]
        best = max(named, key=lambda one: one.margin)
        return ("protected" if best.kind == "obstacle" else "out_of_reach"), best.name

    def _postures(self, r: Vector, z: Vector) -> tuple[Array, Flags, Flags]:
        """(K, P, n) joints with the teeth at r, z (K,) [m] at every pitch; (K, P) whether they are within the limits.

        And (K, P) whether, in addition, the bucket's back, boom and stick are above the ground that is left.
        """
        q = self._site.plane.joints(self._swing, r[:, None], z[:, None], _PITCHES)
        reached = ~np.isnan(q[..., 0])
        if self._final is None or self._raised is None:
            return q, reached, reached
        above = reached & (self._back(r, z) >= _BACK)
        above[above] = self._site.arm.clears(q[above], self._raised)
        return q, reached, above

    def _back(self, r: Vector, z: Vector) -> Matrix:
        """(K, P) height of the bucket's back above the ground that is left behind the teeth, at each pitch [m]."""
        final = self._final
        assert final is not None

        def below(at: Array, teeth: Array) -> Array:
            return np.where(at > teeth, np.interp(at, self._r, final), -np.inf)

        at_r, at_z, pitch = np.broadcast_arrays(r[:, None], z[:, None], _PITCHES)
        return back_heights(self._site.bucket, at_r, at_z, pitch, below)


def allowed_heights(site: Worksite, lanes: Sequence[Lane], design: Matrix) -> tuple[Matrix, NDArray[np.int64]]:
    """(rows, columns) the lowest heights that can be dug, nan where nothing is to be; and the index of the lane, or -1.

    If a blade reaches only a part of a column, the rest is as high as another lane leaves it, or as the ground.

    Parameters
    ----------
    design: (rows, columns) see `Worksite.design_heights`.
    """
    nodes, cell = site.nodes, site.ground.cell
    found = np.where(np.isfinite(design), site.ground.surface, np.nan)
    by = np.full(design.shape, -1, dtype=np.int64)
    rows, columns = np.nonzero(np.isfinite(design))
    points, wanted = nodes[rows, columns] - site.plane.axis, design[rows, columns]
    # strips of each column side by side across the lanes; a column on the edge of the design is dug only in part, and
    # counts as reached if a blade may reach that part
    strips = np.tile(found[rows, columns], (_STRIPS, 1))
    on_edge = site.share[rows, columns] < 1.0
    sideways = np.where(on_edge, 0.0, cell * ((np.arange(_STRIPS)[:, None] + 0.5) / _STRIPS - 0.5))
    reach = 0.5 * site.bucket.width + np.where(on_edge, cell, 0.0)
    for number, lane in enumerate(lanes):
        out, left = site.plane.directions(lane.swing)
        along, aside = points @ out, points @ left
        # a column on a steep end is measured at the upper end of the slope
        line = np.max([np.interp(along + off, lane.r, lane.line) for off in (-cell, 0.0, cell)], axis=0)
        under = np.abs(aside + sideways) <= reach
        some = under.any(axis=0)
        by[rows[some], columns[some]] = np.maximum(by[rows[some], columns[some]], number)
        covered = under & (line < strips - _SAME)
        strips = np.where(covered, np.maximum(line, wanted), strips)
        lowered = covered.any(axis=0)
        by[rows[lowered], columns[lowered]] = number
    found[rows, columns] = strips.mean(axis=0)
    return found, by
