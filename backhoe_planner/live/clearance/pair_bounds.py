"""Bounds of every pair's distance, without measuring it at every step.

A distance that was measured, or proven over a braking path, stays valid if the travel of
the pair's points since then is subtracted. That travel is counted once for all pairs that
have the same radii: one odometer per class adds up how far points can have moved. A bound is
stored as the value that it would have had at odometer 0.

Pairs that are far away are not examined in a step: the pairs that are near or a little further
away are chosen once, and chosen again when the odometers have moved by that extra distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Vector
from backhoe_planner.live.boxes.box_places import KnownDistances
from backhoe_planner.live.braking.braking_path import BUFFER, BrakingPath, PathClearance, Placements
from backhoe_planner.live.braking.gaps import NO_GAPS, Gaps
from backhoe_planner.live.braking.joint_bounds import TOLERANCE
from backhoe_planner.live.braking.odometers import count_travel, keep_proven
from backhoe_planner.live.braking.step_work import MOST_NEAR
from backhoe_planner.live.planes.close_look import proven_along
from backhoe_planner.live.planes.narrow_phase import is_exact_bound, renew_plane
from backhoe_planner.live.planes.pair_choice import margins_now, near_now, not_proven, stalest_pair, tightest_pair
from backhoe_planner.live.planes.plane_gaps import gaps_here
from backhoe_planner.live.planes.separation import FAR, Separation
from backhoe_planner.site import pace

CLOSE = 0.10  # m of margin within which planes are renewed more often, and the servo warns; chosen
_NEAR_RENEWED_EVERY = 2  # steps, if something is within `CLOSE`; chosen, one measurement costs some 20 us
_FAR_RENEWED_EVERY = 4 * _NEAR_RENEWED_EVERY  # steps, if nothing is
_AT_ONCE = 2048  # pairs; chosen, so that their gaps along a path need some 10 MB
_PREPARED_WITHIN = 1.0  # m of margin within which pairs of a load are measured before it is carried; chosen
_PREPARED_AT_ONCE = 4  # pairs in a step, some 20 us each; chosen, a tenth of a step of 1 ms
_SEEN_ANEW = 0.005  # m of travel after which pairs further away than `CLOSE` are examined again; chosen, 5 % of that
_SKIN = 0.2  # m of travel after which pairs are chosen again; chosen, some hundred steps of a quick motion
_URGENT = 0.02  # m of margin: chosen, nearer pairs are renewed about equally often
_MOVED = 0.1  # of margin + `_URGENT`: chosen, planes are renewed after 2 mm at a wall, and after 2 cm at 0.2 m from it
_STALE = CLOSE, _URGENT, _MOVED
_MOST_MOVERS = 8  # pairs of moving obstacles that are measured at the beginning of a step; chosen, some 20 us each
_EXACT = (
    0.1 * BUFFER
)  # m by which a bound may be below the distance without being measured again; chosen, hardly anything


_NOTHING = np.zeros(0, dtype=np.intp), np.zeros(0)


class Near(NamedTuple):
    """The pairs that are near at the beginning of a step, as they were when last examined.

    They are examined in the same step if anything is close, moves or slows the machine down. Otherwise the machine
    has moved by no more than `_SEEN_ANEW` since then.

    Attributes
    ----------
    q: (n,) joint positions at that time [rad or m].
    pairs: (K,) their indices.
    gaps: from every corner of the link to the pair's plane, at one sample.
    distance, margin: (K,) proven lower bounds of the distance, and of distance minus clearance [m].
    next: the tightest of the pairs that are left out because too many are near; -1 if none is left out.
    next_margin: of that pair [m].
    """

    q: Vector
    pairs: Indices
    gaps: Gaps
    distance: Vector
    margin: Vector
    next: int = -1
    next_margin: float = math.inf


class Awake(NamedTuple):
    """The pairs that could come too close in a step.

    Attributes
    ----------
    pairs: (K,) their indices.
    budget: (C,) how far points of each class may leave the braking path of the step before [m].
    """

    pairs: Indices
    budget: Vector


class _Watch:
    """The pairs (K,) to examine, and their classes, until the odometers have moved by `until` [m]."""

    def __init__(self) -> None:
        self.pairs: Indices = np.zeros(0, dtype=np.intp)
        self.classes: Indices = self.pairs
        self.until = -math.inf

    def choose(self, pairs: Indices, classes: Indices, *, until: float = _SKIN) -> None:
        """From now on examine `pairs` (K,); `classes` (P,) are those of all pairs."""
        self.pairs, self.classes, self.until = pairs, classes.take(pairs), until


class PairBounds:
    """Lower bounds of the distances of all pairs: where the machine is, and over its braking path.

    Parameters
    ----------
    influence: margin within which a pair is examined, unless its obstacle may come from farther away [m].

    Attributes
    ----------
    influence: as above.
    required: (P,) distance that must be kept [m]: the clearance, or, for a pair that is closer
        than allowed, the distance that was proven last.
    inside: indices of the pairs that are closer than allowed and whose obstacle stands still.
    stands: (P,) whether the pair's obstacle stands still.
    anything_moves: whether the obstacle of any pair moves.
    """

    def __init__(self, separation: Separation, *, influence: float) -> None:
        self._separation = separation
        self.influence = influence
        count, classes = len(separation), len(separation.travel)
        # bounds over the braking path and at its start, each plus the odometer's value at that time
        self._proven, self._distance = np.full(count, -FAR), np.full(count, -FAR)
        self.required = separation.clearance.copy()
        self._renewed_at = np.full(count, -np.inf)  # the odometer's value when a pair was last measured
        # margins within which a pair is examined, and within which it slows the machine down
        self._reach, self._slow_from = np.full(count, influence), np.zeros(count)
        self.inside: Indices = np.zeros(0, dtype=np.intp)
        self.stands: Flags = np.ones(count, dtype=bool)
        self.anything_moves = False
        self._path_odometer, self._start_odometer = np.zeros(classes), np.zeros(classes)
        self._moved_by = np.zeros(classes)
        # the pairs that may be near now, and those that may be near on the braking path
        self._around, self._around_path = _Watch(), _Watch()
        # the pairs found near when last examined, and the travel for which this remains valid [m]
        self._seen: tuple[Near | None, float] = None, 0.0
        self._accepted: tuple[Indices, Vector] = _NOTHING

    # --- which pairs there are -----------------------------------------------------------

    def extend(self, pairs: Indices, *, slow: Vector) -> None:
        """Add new `pairs` (K,); within the margins `slow` (K,) they slow the machine down [m]."""
        count = len(pairs)
        far = np.full(count, -FAR)
        self._proven, self._distance = np.append(self._proven, far), np.append(self._distance, far)
        self.required = np.append(self.required, self._separation.clearance[pairs])
        self._renewed_at = np.append(self._renewed_at, np.full(count, -np.inf))
        self._slow_from = np.append(self._slow_from, slow)
        self._reach = np.append(self._reach, np.maximum(slow, self.influence))

    def keep(self, kept: Flags) -> None:
        """Remove the pairs for which `kept` (P,) is false."""
        for name in ("_proven", "_distance", "required", "_renewed_at", "_reach", "_slow_from"):
            setattr(self, name, getattr(self, name)[kept])
        self._accepted = _NOTHING

    def sort(self, stands: Flags, coming: Vector, per_step: Vector, per_step_on_path: Vector) -> None:
        """Set which pairs' obstacles stand still, and how fast the others move.

        Parameters
        ----------
        stands: (P,) whether the obstacle does.
        coming: (P,) margin within which a pair is examined because its obstacle may come [m].
        per_step: (P,) how far it moves in a step [m].
        per_step_on_path: (P,) how much nearer it may come to a braking path that is one step later [m].
        """
        self.stands, self.anything_moves = stands, not stands.all()
        self._per_step, self._per_step_on_path = per_step, per_step_on_path
        self._coming = coming
        self._set_within()
        self._slows = bool(self._slow_from.any())
        self._furthest_step = float(per_step_on_path.max(initial=0.0))
        self.look_at_all()

    def _set_within(self) -> None:
        """Set the distances within which pairs are examined."""
        self._within = self._separation.clearance + np.maximum(self._reach, self._coming)

    def look_at_all(self) -> None:
        """Choose again which pairs are examined, because the pairs or their motion have changed."""
        self._around.until = self._around_path.until = -math.inf
        self._seen = None, 0.0

    def drift(self) -> None:
        """Update the bounds for obstacles that move on for a step."""
        self._distance -= self._per_step
        self._proven -= self._per_step_on_path
        self._renewed_at -= self._per_step
        self._around.until -= self._furthest_step
        self._around_path.until -= self._furthest_step

    def measure(self, pairs: Indices, path: BrakingPath, at: Placements) -> None:
        """Measure `pairs` that are new or were moved, and note their distances over the braking path."""
        separation = self._separation
        self.set_distance(pairs, np.array([renew_plane(separation, pair, at, 0) for pair in pairs.tolist()]))
        self.note_renewed(pairs)
        parts = [pairs[first : first + _AT_ONCE] for first in range(0, len(pairs), _AT_ONCE)]
        bound = np.concatenate([proven_along(separation, part, path, at, path.time) for part in parts])
        self.set_proven(pairs, bound)
        self.required[pairs] = np.minimum(separation.clearance[pairs], bound)
        self.find_inside()

    # --- what is carried -----------------------------------------------------------------

    def carry(self, pairs: Indices, path: BrakingPath) -> Indices:
        """Update the bounds after a change of load: the pairs of a load that is no longer carried stop counting.

        Parameters
        ----------
        pairs: (K,) of the load that is carried now.
        path: the present braking path.

        Returns
        -------
        Those of `pairs` about which too little is known: they must be measured before the next step.
        """
        separation = self._separation
        self.required = np.minimum(self.required, separation.clearance)
        self._set_within()
        self.look_at_all()
        bound = self.lower()[pairs] - separation.travel.dot(np.abs(path.delta))[separation.classes[pairs]]
        clear = self.stands[pairs] & (bound >= separation.clearance[pairs] + BUFFER)
        known = pairs[clear]
        self.set_proven(known, bound[clear])
        self.required[known] = separation.clearance[known]
        self.find_inside()
        return np.asarray(pairs[~clear])

    def prepare(self, pairs: Indices, at: Placements) -> None:
        """Measure a few of the `pairs` (K,) of a load that is carried soon, the ones that have moved most first.

        Only pairs that may be near are measured, at the placements' row 0.
        """
        separation = self._separation
        near = pairs[self.lower()[pairs] < separation.full_clearance[pairs] + _PREPARED_WITHIN]
        moved = self._start_odometer[separation.classes[near]] - self._renewed_at[near]
        for pair in near[np.argsort(-moved, kind="stable")[:_PREPARED_AT_ONCE]].tolist():
            self.set_distance(np.array([pair]), np.array([renew_plane(separation, pair, at, 0)]))
            self.note_renewed(pair)

    # --- single bounds -------------------------------------------------------------------

    @property
    def known(self) -> KnownDistances:
        """The known bounds of all distances; read-only."""
        return KnownDistances(self._distance, self._start_odometer, self._proven, self._path_odometer)

    @property
    def columns(self) -> tuple[Vector, ...]:
        """The arrays with what is known and required of every pair, (P,) each."""
        return self._distance, self._renewed_at, self._proven, self.required

    def odometer(self, classes: int) -> float:
        """How far points of a class can have moved since the odometers began [m]."""
        return float(self._start_odometer[classes])

    def lower_after(self, pairs: Indices, classes: int, way: float) -> Vector:
        """(K,) lower bounds of the distances of `pairs` (K,) of one class after their points moved by `way` [m]."""
        bound = self._distance.take(pairs)
        bound -= self.odometer(classes) + way
        return bound

    def find_inside(self) -> None:
        """Find the pairs of static obstacles that are closer than allowed."""
        short = self.required < self._separation.clearance - TOLERANCE
        self.inside = (self.stands & short).nonzero()[0]

    def set_distance(self, pairs: Indices, distance: Vector) -> None:
        """Note the distances (K,) of `pairs` (K,) at the beginning of this step [m]."""
        self._distance[pairs] = distance + self._start_odometer[self._separation.classes[pairs]]
        self._around.until = -math.inf
        self._seen = None, 0.0

    def require(self, pairs: Indices, distance: Vector) -> None:
        """Require `pairs` (K,) to keep these distances (K,) from now on [m]."""
        self.required[pairs] = distance
        self._around_path.until = -math.inf

    def room_of_braking(self, pairs: Indices) -> Vector:
        """(K,) by how much the proven distances over the present braking path exceed the required ones [m]."""
        separation = self._separation
        proven = self._proven.take(pairs)
        proven -= self._path_odometer.take(separation.classes.take(pairs))
        return np.asarray(proven - self.required.take(pairs))

    def set_proven(self, pairs: Indices, bound: Vector) -> None:
        """Note the distances `bound` (K,) that are proven over the present braking path [m]."""
        self._proven[pairs] = bound + self._path_odometer[self._separation.classes[pairs]]
        self._around_path.until = -math.inf

    # --- during a step -------------------------------------------------------------------

    def near(self, q: Vector, at: Placements) -> Near:
        """The pairs that may be within the influence distance at q (n,), the placements' row 0; of many the tightest.

        The bound of a pair that is left out falls with every step, so that its turn comes.
        """
        seen, left = self._seen
        if seen is not None and left >= 0.0:
            return seen
        found = self._near(q, at)
        if len(found.pairs) > 0 and found.next < 0 and not (self.anything_moves or self._slows):
            self._seen = found, _SEEN_ANEW if found.margin[found.margin.argmin()] > CLOSE + _SEEN_ANEW else 0.0
        return found

    def look_at_movers(self, near: Near, at: Placements) -> Near:
        """The near pairs after those of moving obstacles whose planes are old were measured, at the placements' row 0.

        A plane keeps its normal while the obstacle passes. If it were not measured again, the machine would evade an
        obstacle that has gone by. The pairs that moved the most relative to their margin come first.
        """
        pairs = near.pairs[~self.stands.take(near.pairs)]
        if len(pairs) == 0:
            return near
        separation, odometer = self._separation, self._start_odometer
        classes = separation.classes.take(pairs)
        margin = margins_now(pairs, self._distance, separation.clearance, separation.classes, odometer)
        counted = odometer.take(classes)
        moved = (counted - self._renewed_at.take(pairs)) / (_URGENT + np.maximum(margin, 0.0))
        old = (moved > _MOVED).nonzero()[0]
        if len(old) == 0:
            return near
        if len(old) > _MOST_MOVERS:
            old = old[np.argpartition(-moved[old], _MOST_MOVERS - 1)[:_MOST_MOVERS]]
        again = pairs[old]
        self._distance[again] = counted[old] + [renew_plane(separation, pair, at, 0) for pair in again.tolist()]
        self._renewed_at[again] = counted[old]
        return self._near(near.q, at)

    def _near(self, q: Vector, at: Placements) -> Near:
        """The near pairs, examined now."""
        separation = self._separation
        watch = self._around
        if watch.until < 0.0:
            left = self.lower() - self._within
            watch.choose((left < _SKIN).nonzero()[0], separation.classes)
        pairs, lower, counted = near_now(self._distance, self._within, watch.pairs, watch.classes, self._start_odometer)
        if len(pairs) == 0:
            return Near(q, pairs, NO_GAPS, lower, lower)
        left_out = -1, math.inf
        if len(pairs) > MOST_NEAR:
            kept, left_out = self._tightest_of(pairs, lower - separation.clearance.take(pairs))
            pairs, lower, counted = pairs[kept], lower[kept], counted[kept]
        gaps, distance, margin = gaps_here(separation, pairs, lower, counted, at, self._distance)
        return Near(q, pairs, gaps, distance, margin, *left_out)

    def _tightest_of(self, pairs: Indices, margin: Vector) -> tuple[Flags, tuple[int, float]]:
        """Which of `pairs` (K,) are the tightest or slow the machine down; the tightest of the others and its margin.

        margin: (K,) of the pairs [m].
        """
        kept = self._slow_from.take(pairs) > 0.0
        kept[margin.argpartition(MOST_NEAR)[:MOST_NEAR]] = True
        margin[kept] = np.inf
        rest = int(margin.argmin())
        return kept, (-1 if kept[rest] else int(pairs[rest]), float(margin[rest]))

    def pace(self, near: Near) -> float:
        """The part of the wished speed that the slow distances of zones allow."""
        if not self._slows:
            return 1.0
        slow = self._slow_from[near.pairs]
        rows = slow.nonzero()[0]
        rooms = zip(near.margin[rows].tolist(), slow[rows].tolist(), strict=True)
        return min((pace(left, room) for left, room in rooms), default=1.0)

    def awake(self, change: Vector) -> Awake:
        """The pairs that matter if the braking path's end moves by up to `change` (n,) [rad or m]."""
        separation = self._separation
        budget = separation.travel.dot(change)
        watch = self._around_path
        if watch.until < budget[budget.argmax()]:
            left = self._proven - self.required
            left -= self._path_odometer.take(separation.classes)
            most = _SKIN + float(budget.max())
            watch.choose((left < most + BUFFER).nonzero()[0], separation.classes, until=most)
        # pairs within the buffer are always examined: otherwise a wish would be held back every other step
        pairs = not_proven(self._proven, self.required, watch.pairs, watch.classes, self._path_odometer, budget, BUFFER)
        if len(self.inside):  # the way out of these is found separately
            pairs = pairs[~np.isin(pairs, self.inside)]
        return Awake(pairs, budget)

    def accept(self, awake: Indices, clearance: PathClearance) -> None:
        """Note that a braking path is about to be taken, with its `clearance` for the pairs `awake` (K,)."""
        self._accepted = awake, clearance.bound
        keep_proven(awake, clearance.bound, self._separation.clearance, self.stands, self.required)

    def accept_nothing(self) -> None:
        """Note that a step is about to be taken of whose braking path nothing new is known."""
        self._accepted = _NOTHING

    def advance(self, moved: Vector, end_moved: Vector | None) -> None:
        """Note that the joints moved by `moved` (n,), and the end of the braking path by `end_moved` (n,) [rad or m].

        `end_moved` is None if the machine goes on along the braking path that was accepted before.
        """
        separation = self._separation
        self._moved_by, most, most_on_path = count_travel(
            separation.travel, moved, end_moved, *self._accepted, separation.classes,
            self._start_odometer, self._path_odometer, self._proven,
        )  # fmt: skip
        self._around.until -= most
        self._around_path.until -= most_on_path
        self._seen = self._seen[0], self._seen[1] - most

    def renew(self, near: Near, at: Placements, step: int) -> None:
        """Measure one plane again every few steps, at the placements' row 0.

        The nearer a pair is and the further it has moved since it was measured, the sooner its turn comes; every other
        time it is the nearest of all. Pairs that have hardly moved relative to their margin are left out.
        """
        if len(near.pairs) == 0 or step % _NEAR_RENEWED_EVERY:
            return
        separation = self._separation
        turn, far = step // _NEAR_RENEWED_EVERY % 2 > 0, step % _FAR_RENEWED_EVERY == 0
        pair = stalest_pair(  # without near.margin: some pairs were measured since the beginning of the step
            near.pairs, self._distance, separation.clearance, self._renewed_at, separation.classes,
            self._start_odometer, turn, far, _STALE,
        )  # fmt: skip
        if pair < 0:
            return
        counted = self._start_odometer[separation.classes[pair]]
        bound = float(self._distance[pair] - counted)
        if not (self._renewed_at[pair] > -math.inf and is_exact_bound(separation, pair, at, 0, bound, _EXACT)):
            self._distance[pair] = renew_plane(separation, pair, at, 0) + counted
            self._seen = None, 0.0
        self._renewed_at[pair] = counted

    def note_renewed(self, pairs: Indices | int) -> None:
        """Note that `pairs` (K,) were measured in this step."""
        self._renewed_at[pairs] = self._start_odometer[self._separation.classes[pairs]]

    def renew_soon(self, pairs: Indices) -> None:
        """Have these pairs measured soon: their planes were not measured where the machine is."""
        self._renewed_at[pairs] = -np.inf

    # --- after it ------------------------------------------------------------------------

    def tightest(self, near: Near) -> tuple[int, float]:
        """The near pair with the least margin, and that margin after the step [m]; -1 if none is near."""
        pairs = near.pairs
        if len(pairs) == 0:
            return -1, math.inf
        separation = self._separation
        pair, margin = tightest_pair(
            pairs, self._distance, separation.clearance, separation.classes, self._start_odometer
        )
        if margin < 0.0:
            lower = self.lower()[pairs]
            margins = self.kept(pairs) - separation.clearance[pairs]
            row = np.lexsort((lower, margins))[0]
            pair, margin = int(pairs[row]), float(margins[row])
        if near.next >= 0:
            beyond = near.next_margin - float(self._moved_by.max())
            if beyond < 0.0 and self.stands[near.next]:
                beyond = max(beyond, float(self.required[near.next] - separation.clearance[near.next]))
            if beyond < margin:
                pair, margin = near.next, beyond
        return pair, margin

    def lower(self) -> Vector:
        """(P,) lower bounds of all distances at the machine's present configuration [m]."""
        return self._distance - self._start_odometer[self._separation.classes]

    def kept(self, pairs: Indices) -> Vector:
        """(K,) lower bounds of the distances of `pairs` (K,) now, unless the machine stops along another path [m].

        Of what stands still the required distance was proven, for this step or for earlier braking straight ahead.
        """
        lower = self.lower()[pairs]
        return np.where(self.stands[pairs], np.maximum(lower, self.required[pairs]), lower)

    def tightest_of_all(self) -> tuple[int, float]:
        """The pair with the least margin of all pairs, and that margin [m], from the bounds alone; -1 without pairs."""
        separation = self._separation
        margins = self.lower() - separation.clearance
        if len(margins) == 0:
            return -1, math.inf
        pair = int(margins.argmin())
        return pair, float(margins[pair])
