"""The check of a braking path: it is proven clear, or turned into rows that a clear path satisfies.

If a braking path is not clear, its rows are the gaps of the links' corners along it,

    gap_i(s) - s g_i D (v - v_ref) >= clearance_i

with s from 0 to 1 along the path, and D the derivative of its end with respect to v. So the
next velocity is chosen by the same gaps that will be checked.

The rows only lead to good velocities: no proof rests on them. The check also covers pairs that
the rows leave out, and pairs that are not measured because the step has used up its share of
work (`step_work`), with the bound that is known for them. A path is taken only if all pairs
are clear.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.law import BindingSolution, Kind, Rows
from backhoe_planner.live.braking.braking_path import BUFFER, BrakingPath, JointState, PathClearance, Placements
from backhoe_planner.live.braking.gaps import NO_GAPS, Gaps, Memory, left_over_path
from backhoe_planner.live.braking.joint_bounds import TOLERANCE, JointBounds
from backhoe_planner.live.braking.step_work import CLOSER_LOOK, MOST_DISTANCES, MOST_TOLD, StepWork
from backhoe_planner.live.clearance.pair_bounds import Awake, PairBounds
from backhoe_planner.live.planes.close_look import look_closely
from backhoe_planner.live.planes.narrow_phase import renew_plane
from backhoe_planner.live.planes.path_rows import rows_of_path
from backhoe_planner.live.planes.plane_gaps import bound_along, gaps_along, gaps_at, path_row_arguments
from backhoe_planner.live.planes.separation import Separation

MOST_CANDIDATES = 24  # rows of one kind, among which the binding ones are searched; chosen
_OF_STANDING = 16  # of these for static obstacles, if there are static and moving ones; chosen, most of them
_LOOKS = 12  # pairs that are measured again per path at most; chosen
_MOVING_LOOKS = 3  # the same if only moving obstacles are too near: they do not decide whether a path may be taken
# distances for the end of a step: of a pair that is clear again, of the oldest plane, and of pairs that are too close
_RESERVED = CLOSER_LOOK + 1 + MOST_TOLD
_WHOLE = 3.0  # a whole part adds this many times the chord error of its halves
_RULES = BUFFER, float(MOST_CANDIDATES), float(_OF_STANDING)
_SHARE = 3  # a path may use one in so many of the distances that a step has left; the rest are for the next paths


class PathCheck:
    """The braking paths of one machine among all pairs.

    Parameters
    ----------
    separation, bounds, joints: the pairs, their bounds, and the bounds of the joint velocities.
    at: placements; row 0 holds the machine, and a check fills the rows after it.

    Attributes
    ----------
    separation, bounds, joints, at: as above.
    """

    def __init__(self, separation: Separation, bounds: PairBounds, joints: JointBounds, at: Placements) -> None:
        self.separation, self.bounds, self.joints, self.at = separation, bounds, joints, at
        self._before = 0
        self._in_halves = False
        self._memory = Memory()
        self._last: tuple[Awake, BrakingPath, PathClearance] | None = None
        self._paths = self._rows = self._problems = self._iterations = self._pairs = 0

    # --- work --------------------------------------------------------------------------

    def begin_step(self, near: int) -> None:
        """Begin to count the work of a new step, in which `near` pairs are near."""
        self._before = self.separation.measured
        self._pairs = near
        self._paths = self._rows = self._problems = self._iterations = 0

    def note(self, solution: BindingSolution | None) -> None:
        """Count a quadratic program that was solved in this step."""
        if solution is not None:
            self._rows = max(self._rows, solution.rows)
            self._problems += solution.problems
            self._iterations += solution.iterations

    @property
    def distances_left(self) -> int:
        """How many more distances this step may measure for paths."""
        return max(MOST_DISTANCES - _RESERVED + self._before - self.separation.measured, 0)

    @property
    def work(self) -> StepWork:
        """The work of this step so far."""
        distances = self.separation.measured - self._before
        return StepWork(self._rows, self._problems, self._iterations, self._paths, distances, self._pairs)

    # --- paths -------------------------------------------------------------------------

    def path(self, q: Vector, v: Vector, *, step: bool = True) -> BrakingPath:
        """The path of a step at v (n,) from q (n,) followed by braking; without `step`, of braking alone."""
        joints, separation = self.joints, self.separation
        dt = joints.dt if step else 0.0
        return BrakingPath(
            q, v, dt, acceleration=joints.braking, furthest=separation.furthest, turning=separation.turning
        )

    def awake(self, state: JointState, look: float) -> Awake:
        """The pairs that could come too close in a step; for `look` [s] see `VelocityRange`."""
        return self.bounds.awake(self.joints.changes_of_end(*state, look))

    def clearance(self, awake: Awake, path: BrakingPath, *, by_rows: bool = False) -> PathClearance:
        """The proven clearance of a path for the pairs `awake`. If there are any, the placements hold the path then.

        by_rows: whether the path's velocity already keeps rows. Moving obstacles are not measured again then.
        """
        pairs = awake.pairs
        self._paths += 1
        if len(pairs) == 0:
            found = _NOTHING_AWAKE
        else:
            if self._in_halves:
                path.halve()
            found = self._look_along(pairs, path, by_rows=by_rows, in_halves=self._in_halves)
        self._last = awake, path, found
        return found

    def _look_along(self, pairs: Indices, path: BrakingPath, *, by_rows: bool, in_halves: bool) -> PathClearance:
        """The clearance for static and moving `pairs` (K,), with the path's parts or their halves."""
        separation, at = self.separation, self.at
        required, stands = self.bounds.required, self.bounds.stands
        drift_time = path.time if self.bounds.anything_moves else 0.0
        gaps, bound, left, short = gaps_along(
            separation, pairs, path, at, drift_time, required=required, tolerance=TOLERANCE, memory=self._memory
        )
        closely = np.zeros(len(pairs), dtype=np.intp)
        if not in_halves and len(short) and self._may_be_bent(pairs, short, left, path, by_rows=by_rows):
            path.halve(at)
            in_halves = True
            bound, gaps = bound_along(separation, pairs, path, at, drift_time, memory=self._memory)
            # a plane that was kept until it fell short is old: it would hold the machine back needlessly
            left, short = left_over_path(pairs, bound, required, -BUFFER)
        if len(short):
            # a moving obstacle that may touch is measured in its turn, at the beginning of a step: measuring a
            # penetration takes longest
            decides = stands[pairs[short]]
            again = short[decides if by_rows else decides | (bound[short] > 0.0)]
            if len(again):
                self._look_again(pairs, again, path, drift_time, bound, gaps, closely)
            left, short = left_over_path(pairs, bound, required, TOLERANCE)
        self._in_halves = in_halves and self._needs_halves(pairs, left, path)
        stands_clear = len(short) == 0 or not np.count_nonzero(stands[pairs[short]])
        free = len(short) == 0 and bool(left[left.argmin()] >= BUFFER)
        return PathClearance(free, len(short) == 0, stands_clear, bound, gaps, closely)

    def _may_be_bent(self, pairs: Indices, short: Indices, left: Vector, path: BrakingPath, *, by_rows: bool) -> bool:
        """Whether static obstacles may fall `short` only because points may be off the chords of the path's parts.

        left: (K,) by how much each pair's bound exceeds what is required [m].
        """
        standing = short[self.bounds.stands.take(pairs.take(short))]
        if len(standing) == 0 or by_rows:
            return len(standing) > 0
        off = path.off_chord(self.separation.travel).take(self.separation.classes.take(pairs.take(standing)))
        return not np.count_nonzero(off < -left.take(standing))

    def _needs_halves(self, pairs: Indices, left: Vector, path: BrakingPath) -> bool:
        """Whether static obstacles that have room `left` (K,) [m] with half parts would fall short with whole ones."""
        off = path.off_chord(self.separation.travel).take(self.separation.classes.take(pairs))
        return bool(np.count_nonzero((left < _WHOLE * off) & self.bounds.stands.take(pairs)))

    def _look_again(
        self,
        pairs: Indices,
        short: Indices,
        path: BrakingPath,
        drift_time: float,
        bound: Vector,
        gaps: Gaps,
        closely: Indices,
    ) -> None:
        """Measure pairs whose bound falls short with one plane each, then static obstacles with several.

        Static obstacles come first, and among them those that fall short the most: they decide whether
        the path may be taken. `bound`, `gaps` and `closely` are those of `PathClearance`, to be improved.
        """
        separation, at = self.separation, self.at
        required, stands = self.bounds.required[pairs], self.bounds.stands[pairs]
        left = self.distances_left // _SHARE
        order = short[np.lexsort((bound[short] - required[short], ~stands[short]))] if len(short) > 1 else short
        standing = int(np.count_nonzero(stands[short]))
        again = order[: min(max(standing, _MOVING_LOOKS), _LOOKS, left)]
        if len(again) == 0:
            return
        until, enough = separation.measured + left, (required + BUFFER).tolist()
        for row in again.tolist():
            renew_plane(separation, int(pairs[row]), at, int(gaps.least[row].argmin()))
        better, anew = bound_along(separation, pairs[again], path, at, drift_time)
        gaps.put(again, anew)
        bound[again] = np.maximum(bound[again], better)
        for row in again[(better < required[again] - TOLERANCE) & stands[again]].tolist():
            if separation.measured + CLOSER_LOOK > until:
                break
            closer, tightest = look_closely(separation, int(pairs[row]), path, at, 0.0, enough=enough[row])
            bound[row], closely[row] = max(bound[row], closer), max(tightest, 1)
        looked = closely.nonzero()[0]
        if len(looked):
            gaps.put(looked, gaps_at(separation, pairs[looked], at, path.parts + 1))
        self.bounds.renew_soon(pairs[again])

    def keep(self, path: BrakingPath) -> None:
        """Note that a path was taken: if it was checked last, its rows are valid for the next step, too."""
        if self._last is not None and self._last[1] is not path:
            self._last = None

    def forget(self) -> None:
        """Drop the result for the path that was taken: it is no longer valid."""
        self._last = None

    def path_before(self) -> tuple[Any, ...] | None:
        """The arguments of `velocity_held_as_before` for the path that was taken a step ago; None if unknown."""
        if self._last is None or len(self._last[0].pairs) == 0:
            return None
        separation, ((pairs, budget), path, found) = self.separation, self._last
        return (
            pairs, *found.gaps, found.bound, found.closely, self.bounds.required, separation.classes,
            path.off_chord(separation.travel), budget, None, _RULES, *path_row_arguments(separation, self.at),
            path.parts, path.q, path.end,
        )  # fmt: skip

    def rows_before(self, q: Vector, v: Vector, *, firm: bool) -> tuple[Rows, ...]:
        """The rows of the path of a step at v (n,) from q (n,), derived from the path that was taken a step ago.

        There are none if nothing is known of that path.

        The two paths are so close to each other that the gaps along one follow from those along the
        other and from how fast these fall.
        """
        return () if self._last is None else self.rows(*self._last, firm=firm, now=self.path(q, v))

    def rows_of_last(self) -> tuple[Indices, Rows] | None:
        """The pairs (R,) and rows of the path that was taken; None if it was clear from the start."""
        if self._last is None or len(self._last[0].pairs) == 0:
            return None
        pairs, G, h = self._pairs_and_rows(*self._last, firm=False, now=None)
        return pairs, Rows("braking", G, h)

    def worst_of_last(self) -> int:
        """The pair that keeps the path that was checked last from being taken; -1 if it is not known."""
        if self._last is None or len(self._last[0].pairs) == 0:
            return -1
        (pairs, _), _, found = self._last
        return int(pairs[int((found.bound - self.bounds.required.take(pairs)).argmin())])

    def rows(
        self,
        awake: Awake,
        path: BrakingPath,
        found: PathClearance,
        *,
        firm: bool = False,
        now: BrakingPath | None = None,
    ) -> tuple[Rows, ...]:
        """The rows that could bind along a path [m/s]. The placements must hold the path.

        Parameters
        ----------
        found: the clearance of that path, with the gaps of all pairs.
        now: a path one step later; the rows are then for that path.
        firm: whether the rows of static obstacles are hard, and those of moving ones a block of their own. If all were
            soft, they would be traded off against a person who walks into the machine, and the result could run into
            a post behind it. A machine that stands still keeps the hard rows.
        """
        if len(awake.pairs) == 0:
            return (Rows.none("braking", len(path.v)),)
        pairs, G, h = self._pairs_and_rows(awake, path, found, firm=firm, now=now)
        if not firm or len(h) == 0:
            return (Rows("braking", G, h),)
        hard = self.bounds.stands.take(pairs)
        soft = ~hard | (h < 0.0)  # a return to the buffer is wished for, not demanded
        return (
            Rows("braking", G[hard], np.maximum(h[hard], 0.0), Kind.HARD),
            Rows("braking, soft", G[soft], h[soft]),
        )

    def _pairs_and_rows(
        self, awake: Awake, path: BrakingPath, found: PathClearance, *, firm: bool, now: BrakingPath | None
    ) -> tuple[Indices, Matrix, Vector]:
        """The pairs (R,) whose corners could bind along a path, and their rows; see `rows`."""
        separation, (pairs, budget), bounds = self.separation, awake, self.bounds
        of = path if now is None else now
        planes, joint, other, piece, corners, mask, T, J, drift = path_row_arguments(separation, self.at)
        return rows_of_path(
            pairs, *found.gaps, found.bound, found.closely, bounds.required, separation.classes,
            path.off_chord(separation.travel), budget, bounds.stands if firm else None, _RULES,
            planes, joint, other, piece, corners, mask, T, J, drift,
            path.parts, of.v, of.look, *of.bend_of_end, path.q, path.end,
            None if now is None else now.q, None if now is None else now.end, self.joints.dt,
        )  # fmt: skip


_NOTHING_AWAKE = PathClearance(True, True, True, np.zeros(0), NO_GAPS, np.zeros(0, dtype=np.intp))
