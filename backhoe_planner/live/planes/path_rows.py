"""The gaps along a braking path, the corners that could bind there, and the rows made from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.live.braking.braking_path import place_on_line
from backhoe_planner.live.braking.gaps import corner_gaps, least_over_path, left_over_path, plane_rows
from backhoe_planner.native import compiled


@compiled
def gaps_along_path(
    q: Vector, delta: Vector, parts: int, bend: Vector, factors: Matrix, slides: Vector, travel: Matrix, pairs: Indices,
    planes: Matrix, joint: Indices, other: Indices | None, piece: Indices, corners: Array, drift: Vector | None,
    step: float, classes: Indices, required: Vector, tolerance: float, T: Array, J: Array, gaps: Array, /,
) -> tuple[Vector, Indices, Matrix, Vector, Vector, Indices]:  # fmt: skip
    """Place the bodies along a path, and find the gaps and proven distances of `pairs` (K,).

    Returns
    -------
    (C,) how far points may be off the chords of its parts [m]; which corner of each pair has the least gap at each
    sample (K, S), and that gap (K, S) [m]; (K,) the proven distance over the path [m], and by how much it exceeds
    the required one [m]; the rows of the pairs for which it is too small.

    Parameters
    ----------
    q, delta: (n,) start and displacement of the path [rad or m], in `parts` parts; bend: (n,) its `bend_weights`.
    factors, slides: see `place_on_line`; travel: (C, n) see `Separation`.
    planes, joint, other, piece, corners, drift, step: see `corner_gaps`.
    classes, required, tolerance: see `least_over_path` and `left_over_path`.
    T, J: see `Placements`; its rows 1 to `parts` are written. Row 0 must already be filled.
    gaps: (K, S, V) output: the gaps of all corners [m].
    """
    place_on_line(q, delta, parts, 1, factors, slides, T, J)
    off = travel.dot(bend) / (8.0 * parts * parts)
    nearest, least = corner_gaps(pairs, planes, joint, other, piece, corners, T[: parts + 1], drift, step, gaps)
    bound = least_over_path(pairs, least, classes, off)
    return off, nearest, least, bound, *left_over_path(pairs, bound, required, tolerance)


class Candidates(NamedTuple):
    """The corners that could become rows, of K pairs with M entries each.

    Attributes
    ----------
    gaps: (K, M) of every corner [m].
    within: (K,) gaps below this count [m]; -inf for pairs that are left out.
    nearest: (K,) the column of the least gap.
    room: (K,) what is left of a pair's least gap, in the unit in which pairs are compared.
    pairs: rows of the pairs that are considered, each with a corner that counts.
    """

    gaps: Matrix
    within: Vector
    nearest: Indices
    room: Vector
    pairs: Indices

    def among(self, those: Flags) -> Candidates:
        """The candidates without the pairs for which `those` (K,) is false."""
        return Candidates(self.gaps, self.within, self.nearest, self.room, self.pairs[those[self.pairs]])

    def all_of(self, most: int) -> tuple[Indices, Indices] | None:
        """Pair and column of every corner that counts; None if there are more than `most`."""
        if len(self.pairs) > most:
            return None
        counts = self.gaps < self.within[:, None]
        if np.count_nonzero(counts) > most:
            return None
        k, columns = counts.nonzero()
        return k, columns

    def tightest(self, most: int) -> tuple[Indices, Indices]:
        """Pair and column of the corners with the least gaps of every pair, at most `most` of all pairs together.

        All pairs get the same share, so that a pair with many corners does not crowd out the others. If there
        are more pairs than `most`, those with the least room are taken. Both results ascend.
        """
        pairs = self.pairs
        if len(pairs) > most:
            pairs = np.sort(pairs[self.room.take(pairs).argpartition(most - 1)[:most]])
        if 2 * len(pairs) > most:
            return pairs, self.nearest.take(pairs)
        gaps = self.gaps[pairs]
        each = min(most // max(len(pairs), 1), gaps.shape[1])
        columns = np.sort(gaps.argpartition(each - 1, axis=1)[:, :each], axis=1).reshape(-1)
        k = np.arange(len(pairs)).repeat(each)
        pairs = pairs.take(k)
        real = gaps[k, columns] < self.within.take(pairs)
        return pairs[real], columns[real]


@compiled
def binding_corners(
    pairs: Indices, gaps: Array, nearest: Indices, least: Matrix, bound: Vector, closely: Indices, required: Vector,
    classes: Indices, off: Vector, budget: Vector, stands: Flags | None, rules: tuple[float, ...], /,
) -> tuple[Indices, Indices, Indices, Vector, Vector]:  # fmt: skip
    """The corners of `pairs` (K,) that could bind along a path: row of the pair, sample and corner, (R,) each.

    Also (R,) by how much the gap there exceeds the needed one, and (R,) by how much the gap of the same corner at the
    first sample falls short of what is to be kept [m].

    Parameters
    ----------
    gaps, nearest, least: (K, S, V), (K, S), (K, S) see `Gaps`. The first sample gives no rows: no velocity changes it.
    bound, closely: (K,) see `PathClearance`.
    required, classes: (P,) the distance that must be kept [m], and the row of `off` and `budget` (C,).
    off: (C,) how far points may be off the chords of the path's parts [m].
    budget: (C,) how far they may leave the path [m].
    stands: (P,) whether the obstacle stands still, if corners of static and moving obstacles are counted separately.
    rules: what is to be kept beyond `required` [m], the most corners, and the most of them for static obstacles.
    """
    buffer, most, of_standing = rules[0], int(rules[1]), int(rules[2])
    each = classes.take(pairs)
    wanted = required.take(pairs) + buffer
    needed = off.take(each) + wanted
    within = needed + 2.0 * budget.take(each)
    count, samples, corners = gaps.shape
    on_path = gaps.reshape(count, -1)[:, corners:]
    tight = least[:, 1:].argmin(axis=1)
    looked = (closely > 0).nonzero()[0]
    if len(looked):
        within[(closely > 0) & (bound >= within - needed + wanted)] = -np.inf
        # a pair that was measured closely keeps one plane, which is only exact where it was measured
        on_path = on_path.copy()
        for row in looked.tolist():
            tight[row] = closely[row] - 1
            on_path[row].reshape(samples - 1, -1)[np.arange(samples - 1) != tight[row]] = np.inf
    rows = np.arange(count)
    found = least[rows, 1 + tight]
    within[found >= within] = -np.inf
    columns = corners * tight + nearest[rows, 1 + tight]
    binding = Candidates(on_path, within, columns, found - needed, (within > -np.inf).nonzero()[0])
    chosen = binding.all_of(most)
    if chosen is None and stands is not None and np.count_nonzero(standing := stands.take(pairs)) < count:
        own, other = binding.among(standing).tightest(of_standing), binding.among(~standing)
        k, columns = map(np.append, own, other.tightest(most - of_standing))
    else:
        k, columns = chosen or binding.tightest(most)
    at, corner = np.divmod(columns, corners)
    return k, at + 1, corner, on_path[k, columns] - needed.take(k), wanted.take(k) - gaps[k, 0, corner]


@compiled
def rows_of_path(
    pairs: Indices, gaps: Array, nearest: Indices, least: Matrix, bound: Vector, closely: Indices, required: Vector,
    classes: Indices, off: Vector, budget: Vector, stands: Flags | None, rules: tuple[float, ...], planes: Matrix,
    joint: Indices, other: Indices | None, piece: Indices, corners: Array, mask: Matrix, T: Array, J: Array,
    drift: Vector, parts: int, v: Vector, look: float, slowest: int, sharper: float, start: Vector, end: Vector,
    now_start: Vector | None, now_end: Vector | None, dt: float, /,
) -> tuple[Indices, Matrix, Vector]:  # fmt: skip
    """The pairs (R,) whose corners could bind along a path, and their rows G (R, n), h (R,).

    Parameters
    ----------
    pairs, gaps, nearest, least, bound, closely, required, classes, off, budget, stands, rules: see `binding_corners`.
    planes, joint, other, mask, T, J: see `plane_rows`.
    piece, corners: (P,) the piece whose corners count, and (M, V, 4) those of all pieces, with a 1 appended [m].
    drift: (P,) rates at which the planes move on along their normals [m/s].
    parts, v, look, slowest, sharper: see `rows_by_velocity`.
    start, end: (n,) of the path [rad or m].
    now_start, now_end: (n,) of the path a step later, if the rows are to be for that one; otherwise None.
    dt: how much later that is [s].
    """
    k, samples, corner, room, short = binding_corners(
        pairs, gaps, nearest, least, bound, closely, required, classes, off, budget, stands, rules
    )
    pairs = pairs.take(k)
    if len(pairs) == 0:
        return pairs, np.zeros((0, len(v))), np.zeros(0)
    moves = comes = None
    if now_start is not None and now_end is not None:
        moves = np.array((now_start - start, now_end - end))
        comes = dt * drift.take(pairs)
    falls = plane_rows(pairs, samples, corners[piece.take(pairs), corner], planes, joint, other, mask, T, J)
    return pairs, *rows_by_velocity(falls, room, short, samples, parts, v, look, slowest, sharper, moves, comes)


@compiled
def rows_by_velocity(
    G: Matrix, room: Vector, short: Vector, samples: Indices, parts: int, v: Vector, look: float, slowest: int,
    sharper: float, moves: Matrix | None, comes: Vector | None, /,
) -> tuple[Matrix, Vector]:  # fmt: skip
    """G (R, n) and h (R,) of the rows G v <= h that keep gaps along a path [m/s].

    The end of the path changes with v by D = look I + sharper v e_slowest^T, and a sample by its part of that.

    Parameters
    ----------
    G: (R, n) how fast the gaps fall with the joints [m/rad]; room: (R,) how much is left of them [m].
    short: (R,) how much is missing at the path's start [m]. It limits the retreat that a row demands.
    samples: (R,) the sample of each gap, from 1 to `parts`.
    v, look: (n,) velocity of the path [rad/s or m/s], and the time in which v covers the path [s].
    slowest, sharper: the joint that takes longest to brake, and by how much the path becomes longer with its speed;
        see `BrakingPath.bend_of_end`.
    moves: (2, n) from the start and end of this path to those of the path that the rows are for [rad or m]; None if
        it is the same path.
    comes: (R,) how far the planes move on in the same time [m]; with `moves`.
    """
    part = samples / parts
    if moves is not None and comes is not None:
        moved = G.dot(moves.T)
        moved -= comes[:, None]
        short = short + moved[:, 0]
        room = room - (moved[:, 0] + part * (moved[:, 1] - moved[:, 0]))
    rows = look * G
    rows[:, slowest] += sharper * G.dot(v)
    rows /= look
    return rows, np.maximum(room / (part * look) + rows.dot(v), -2.0 * np.maximum(short, 0.0))
