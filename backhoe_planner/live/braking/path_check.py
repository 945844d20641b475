"""The check of a braking path: proven clear, or turned into rows that a clear one satisfies.

Where a braking path is not clear, its rows are the gaps of the links' corners along it,

    gap_i(s) - s g_i D (v - v_ref) >= clearance_i

with s from 0 to 1 along the path, and D the derivative of its end by v. So the next
velocity is chosen by the same gaps that will be checked.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.law import Rows
from backhoe_planner.live.braking.braking_path import BUFFER, BrakingPath, JointState, PathClearance, Placements
from backhoe_planner.live.braking.joint_bounds import BRAKING, TOLERANCE, JointBounds
from backhoe_planner.live.braking.pair_bounds import Awake, PairBounds
from backhoe_planner.live.braking.separation import Separation

MOST_ROWS = 400  # of one kind in a problem, the tightest; chosen, so that the work of a step is bounded
_LOOKS = 12  # pairs that are measured anew per path at most; chosen, each costs some 20 us


class PathCheck:
    """The braking paths of one machine among all pairs.

    Parameters
    ----------
    separation, bounds, joints: the pairs, their bounds, and what the joints can do.
    at: placements; row 0 holds the machine, and a check fills the rows behind it.

    Attributes
    ----------
    separation, bounds, joints, at: as above.
    """

    def __init__(self, separation: Separation, bounds: PairBounds, joints: JointBounds, at: Placements) -> None:
        self.separation, self.bounds, self.joints, self.at = separation, bounds, joints, at

    def path(self, q: Vector, v: Vector, *, step: bool = True) -> BrakingPath:
        """The path of a step at v (n,) from q (n,) and braking after it; without `step`, of braking alone."""
        joints, separation = self.joints, self.separation
        dt = joints.dt if step else 0.0
        return BrakingPath(
            q, v, dt, acceleration=joints.braking, furthest=separation.furthest, turning=separation.turning
        )

    def awake(self, state: JointState, look: float) -> Awake:
        """The pairs that could come too close in a step; for `look` [s] see `VelocityRange`."""
        q, v, end = state
        later = self.joints.dt / BRAKING
        joints = zip(q.tolist(), v.tolist(), end.tolist(), self.joints.changes, strict=True)
        # the end moves with the step taken, and with the change of velocity
        change = [abs(q + rate * look - end) + look * change + abs(rate) * later for q, rate, end, change in joints]
        return self.bounds.awake(np.array(change))

    def clearance(self, awake: Awake, path: BrakingPath) -> PathClearance:
        """What is proven of a path for the pairs `awake`. If there are any, the placements hold the path then."""
        separation, at, pairs = self.separation, self.at, awake.pairs
        if len(pairs) == 0:
            return _NOTHING_AWAKE
        path.place(at)
        required, stands = self.bounds.required[pairs], self.bounds.stands
        drift_time = path.time if self.bounds.anything_moves else 0.0
        bound, gaps = separation.least_on(pairs, path, at, drift_time)
        closely = np.zeros(len(pairs), dtype=bool)
        if (bound - required).min() >= BUFFER:
            return PathClearance(True, True, True, bound, gaps, closely)
        short = (bound < required - TOLERANCE).nonzero()[0]
        if len(short):
            # first with a plane measured where it is tightest, then with several
            for row in short[:_LOOKS].tolist():
                separation.renew(int(pairs[row]), at, int(gaps[:, row].min(axis=1).argmin()))
            again = short[:_LOOKS]
            better, gaps[:, again] = separation.least_on(pairs[again], path, at, drift_time)
            bound[again] = np.maximum(bound[again], better)
            for row in again[better < required[again] - TOLERANCE].tolist():
                pair = int(pairs[row])
                found = separation.closer_look(pair, path, at, 0.0 if stands[pair] else drift_time)
                bound[row] = max(bound[row], found)
                closely[row] = True
            if closely.any():
                gaps[:, closely] = separation.gaps(pairs[closely], at, path.parts + 1)
            self.bounds.renew_soon(pairs[again])
            short = (bound < required - TOLERANCE).nonzero()[0]
        stands_clear = not stands[pairs[short]].any()
        free = len(short) == 0 and bool((bound >= required + BUFFER).all())
        return PathClearance(free, len(short) == 0, stands_clear, bound, gaps, closely)

    def rows(self, awake: Awake, path: BrakingPath, found: PathClearance) -> Rows:
        """The rows of what could bind along a path [m/s]. The placements must hold the path."""
        separation, (pairs, budget) = self.separation, awake
        if len(pairs) == 0:
            return Rows.none("braking", len(path.v))
        classes = separation.classes[pairs]
        wanted = self.bounds.required[pairs] + BUFFER
        room = found.gaps - (path.off_chord(separation.travel[classes]) + wanted)[None, :, None]
        counts = room < (2.0 * budget[classes])[None, :, None]
        counts[0] = False
        # a pair that was measured closely keeps one plane, which is right where the pair is tightest
        settled = found.closely & (found.bound >= wanted + 2.0 * budget[classes])
        if settled.any():
            counts[:, settled] = False
        for row in (found.closely & ~settled).nonzero()[0].tolist():
            tight = int(found.gaps[1:, row].min(axis=1).argmax()) + 1
            only = counts[tight, row].copy()
            counts[:, row] = False
            counts[tight, row] = only
        samples, k, corners = np.nonzero(counts)
        if len(k) == 0:
            return Rows.none("braking", len(path.v))
        if len(k) > MOST_ROWS:
            tightest = np.argpartition(room[samples, k, corners], MOST_ROWS)[:MOST_ROWS]
            samples, k, corners = samples[tightest], k[tightest], corners[tightest]
        part = samples / path.parts
        G = separation.rows(pairs[k], samples, corners, self.at) @ path.D / path.look
        h = room[samples, k, corners] / (part * path.look) + G @ path.v
        # never ask for more than the start itself is short of
        short = np.maximum(wanted[k] - found.gaps[0, k, corners], 0.0)
        return Rows("braking", G, np.maximum(h, -2.0 * short))


_NOTHING_AWAKE = PathClearance(True, True, True, np.zeros(0), np.zeros((0, 0, 0)), np.zeros(0, dtype=np.bool_))
