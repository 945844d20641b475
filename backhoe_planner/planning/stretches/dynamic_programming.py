"""Makes resolved stretches cheaper by searching the redundancy ever more finely around a route.

The route through the layered graph is the optimum of a coarse grid. Here every knot k of
a stretch gets a few neighbours in its null space, q_k + i delta d_k with i = -3 ... 3,
and Bellman's recursion finds the cheapest route through these layers; this is repeated
around the result with a smaller delta. The method is iterative dynamic programming
(R. Luus, Optimal control by dynamic programming using systematic reduction in grid
size, Int. J. Control 51, 1990). It needs no gradients, which an objective like the
integral of max(tau v, 0) does not have where it matters: at the kinks, where a joint rests.

A null space of more dimensions gets a grid of neighbours in up to three directions at once, since one direction
after the other stops at any kink that is oblique to them. The directions are turned at random from sweep to
sweep. Frames of the null spaces that turn as little as possible from knot to knot make a direction the same all
along the stretch, so that the whole stretch can slide along it.

Between knots the joints follow a smooth curve that is projected onto the path sample by sample.
A new stretch is accepted only if it is cheaper over all samples, clear, and within the limits.
"""

from __future__ import annotations

import itertools
import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, solve_batch
from backhoe_planner.motion import Nodes, PathCost, Problem, TipPath, step_lengths
from backhoe_planner.native import compiled
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.stretches.corners import SHARP
from backhoe_planner.planning.stretches.kept_cones import kept_targets
from backhoe_planner.planning.stretches.monotone_curve import monotone_curve
from backhoe_planner.planning.stretches.smoothing import ENOUGH, ROOM, margins_to_keep, null_bases, strict_targets
from backhoe_planner.planning.stretches.step_bounds import StepBounds
from backhoe_planner.planning.stretches.stretch import NEARER, Stretch
from backhoe_planner.proof import TOUCH, path_segment_is_clear
from backhoe_planner.site import ClearanceScreen, Proximity

Mask = NDArray[np.bool_]

# neighbours on either side of a knot in each direction, and how many steps away the others may be in all directions
# together, for each number of directions at once; chosen: with turns the work grows by the cube of all neighbours
_WIDTHS, _STEPS_AWAY = (0, 3, 2, 1), (0, 3, 2, 3)
_MOST_DIRECTIONS = len(_WIDTHS) - 1
_FURTHEST = 3.0  # times the distance of neighbours in one direction: how far off the last is, in any number of them
# levels, one after the other: rad or m between neighbours, and m of path between knots; chosen, each about
# half of the one before. First for the curve through the knots, then for a curve that is added to the stretch
_LEVELS = (
    ((0.12, 0.2), (0.06, 0.1), (0.024, 0.05), (0.01, 0.05), (0.004, 0.025), (1.6e-3, 0.025)),
    ((0.03, 0.2), (0.012, 0.1), (5e-3, 0.05), (2e-3, 0.025), (6e-4, 0.025)),
)
_ROUGH = 2  # of these for a rough search; chosen
_KNOT_TURN = 3.0  # rad or m of a joint that count like 1 m of path between knots; chosen
_ROUNDS = 15  # at one distance of the neighbours; chosen: ends iterations that do not converge
_MORE_ROUNDS = 40  # the same with more than one direction; chosen
_DULL = 3  # sweeps in a row that gain too little, with differently turned directions, end a distance; chosen
_TRIES = 3  # to find a clear stretch in one sweep; chosen
_STRAY = 0.3  # rad or m between a neighbour and its guess, at most; chosen: further off is another posture
_ROUNDING = 1e-9  # m; far above the rounding of two sums for the same bound
_AHEAD = 0.2  # m beyond the floor up to which distances are measured; chosen: bounds then hold for several sweeps


def cheapen_stretch(
    problem: Problem,
    path: TipPath,
    stretch: Stretch,
    *,
    cost: PathCost,
    proximity: Proximity,
    time: float = 0.0,
    free_start: bool = False,
    free_end: bool = False,
    roughly: bool = False,
    work: Work | None = None,
) -> Stretch:
    """A stretch with the same tip positions whose cost is not higher.

    Parameters
    ----------
    stretch: a clear stretch of `path`.
    cost: of motions along the path.
    time: at which the positions of the obstacles are taken [s].
    free_start, free_end: whether the joints may change at the first and at the last sample too.
    roughly: whether only the largest distances are searched, to tell a cheap stretch from a dear one.
    work: every sweep over the knots is subtracted from it; if no sweep or no time is left,
        the best so far is kept.
    """
    work = work or Work()
    if len(stretch.q) < 3:
        return stretch
    descent = _Descent(problem, path, stretch, cost=cost, proximity=proximity, time=time)
    levels = [(bool(turn), level) for turn, levels in enumerate(_LEVELS) for level in levels]
    for added, (delta, spacing) in levels[:_ROUGH] if roughly else levels:
        descent.tie(spacing, added=added, free_start=free_start, free_end=free_end)
        several, dull = descent.free > 1, 0
        for _ in range(0 if not descent.free else _MORE_ROUNDS if several else _ROUNDS):
            if work.sweeps <= 0 or work.brake.is_used_up():
                return Stretch(stretch.stations, descent.q)
            work.sweeps -= 1
            gained = descent.step(delta * (0.5 if dull % 2 else 1.0))
            dull = dull + 1 if gained <= ENOUGH * abs(descent.least) else 0
            if dull == (_DULL if several else 1):
                break
    return Stretch(stretch.stations, descent.q)


class _Descent:
    """One stretch, and its best version so far.

    Attributes
    ----------
    q: (K, n) the best joint positions so far [rad or m].
    least: their cost [rad].
    free: the dimensions of the null spaces at the knots, when these were chosen.
    """

    def __init__(
        self,
        problem: Problem,
        path: TipPath,
        stretch: Stretch,
        *,
        cost: PathCost,
        proximity: Proximity,
        time: float,
    ) -> None:
        self._cost = cost
        self._proximity = proximity
        self._time = time
        self._kinematics = BatchKinematics(problem.robot)
        self._bounds = StepBounds(path, stretch, problem.joint_steps)
        self._stations = stations = stretch.stations
        self.q = q = stretch.q
        self._targets = kept_targets(problem, path, stations)
        self._corners = np.isin(np.round(stations, 9), np.round(path.corners(SHARP), 9))
        self._measure = np.concatenate(([0.0], np.cumsum(step_lengths(stations, q, least=1e-9))))
        self.least = cost.of_run(stations, q)
        self._there = None if np.all(proximity.appears_at <= time) else proximity.appears_at <= time  # (P,) by pairs
        unknown = np.full((len(q), len(proximity.pairs)), -np.inf)
        self._lower = self._distances_of_each(q, np.full(len(q), _AHEAD), unknown)
        margin = np.min(self._lower - proximity.clearance, axis=1, initial=np.inf)
        self._floor = margins_to_keep(margin)
        self._screen = ClearanceScreen(proximity, time=time, spare=ROOM)
        self._rng = np.random.default_rng(0)
        self.free = 0

    def tie(self, spacing: float, *, added: bool, free_start: bool, free_end: bool) -> None:
        """Choose the knots, `spacing` [m] apart, and which of them move.

        Parameters
        ----------
        added: whether the curve through the knots is added to the stretch; see `_LEVELS`.
        """
        self._added = added
        self._knots = _knots(self._stations, self.q, self._corners, spacing)
        self._knot_targets = self._targets.take(self._knots)
        self._strict = strict_targets(self._knot_targets)
        corners = np.flatnonzero(self._corners[self._knots])
        self._legs = np.unique(np.concatenate(([0], corners, [len(self._knots) - 1])))
        self._held = np.zeros(len(self._knots), dtype=bool)
        self._held[0], self._held[-1] = not free_start, not free_end
        self._tip = self._cost.tip_velocities(self.q[self._knots])
        self.free = null_bases(self._kinematics, self._strict, self.q[self._knots]).shape[2]

    def step(self, delta: float) -> float:
        """Search once among neighbours of the knots; returns how much the cost fell [rad].

        Parameters
        ----------
        delta: between neighbours in one direction [rad or m]; in several they are as much further apart as they are
            fewer.
        """
        here = self.q[self._knots]
        neighbours, usable = self._neighbours(here, delta)
        same = neighbours.shape[1] // 2
        nodes = self._nodes(neighbours)
        spans = np.diff(self._stations[self._knots])[:, None, None]
        steps = self._cost.between(nodes[:-1, :, None], nodes[1:, None, :], spans)
        rates = None
        if self._cost.counts_rate_changes and len(here) > 2:
            rates = self._cost.rates(neighbours[:-1, :, None], neighbours[1:, None, :], spans)
            for end in (0, -1):  # the motion begins and ends at rest
                steps[end] += self._cost.rate_changes(np.zeros_like(rates[:, end]), rates[:, end])
        for _ in range(_TRIES):
            closed = np.where(usable, 0.0, np.inf)
            if rates is None:
                chosen = _cheapest(steps, closed)
            else:
                chosen = cheapest_with_turns(steps, rates, closed, self._cost.time_price)
            if np.all(chosen == same):
                return 0.0
            moved = self._between_knots(neighbours[np.arange(len(here)), chosen])
            if moved is None:
                return 0.0
            cost = self._cost.of_run(self._stations, moved)
            if not cost < self.least:
                return 0.0
            bad, lower = self._bad_knots(moved)
            if not bad.any():
                fallen = self.least - cost
                self.q, self.least, self._lower = moved, cost, lower
                return fallen
            usable[bad] = False
            usable[:, same] = True
        return 0.0

    # --- neighbours -----------------------------------------------------------------

    def _neighbours(self, here: Matrix, delta: float) -> tuple[Array, Mask]:
        """(M, C, n) neighbours of each knot in its null space, the knot in the middle; (M, C) which are usable."""
        frames = null_bases(self._kinematics, self._strict, here)  # fewer or more than before, after a singularity
        if frames.shape[2] > 1:
            frames = _aligned(frames) @ self._any_directions(frames.shape[2])
        guesses = here[:, None, :] + np.einsum("mnc,oc->mon", frames, delta * _offsets(frames.shape[2]))
        count, width, n = guesses.shape
        rows = np.repeat(np.arange(count), width)
        found, reached = solve_batch(
            self._kinematics, self._knot_targets.take(rows), guesses.reshape(-1, n), iterations=6
        )
        found, usable = found.reshape(guesses.shape), reached.reshape(count, width)
        usable &= np.max(np.abs(found - guesses), axis=2) < min(_STRAY, 4.0 * _FURTHEST * delta)
        usable[self._held] = False
        found[:, width // 2], usable[:, width // 2] = here, True
        if self._proximity.pairs:
            self._keep_clear(here, found, usable)
        return found, usable

    def _any_directions(self, free: int) -> Matrix:
        """(r, c) up to three directions at right angles in a null space of r dimensions (`free`), turned at random."""
        Q, _ = np.linalg.qr(self._rng.normal(size=(free, free)))
        return np.asarray(Q[:, :_MOST_DIRECTIONS])

    def _keep_clear(self, here: Matrix, found: Array, usable: Mask) -> None:
        """Remove the neighbours that are too near to something."""
        asked = self._proximity.clearance + self._floor[self._knots][:, None]
        moved, lower, travel = np.abs(found - here[:, None, :]), self._lower[self._knots], self._proximity.travel.T
        # knots at which a neighbour may be too near, by the largest move of each joint among all neighbours
        near = np.flatnonzero((lower - moved.max(axis=1) @ travel < asked + _ROUNDING).any(axis=1))
        unsure = np.zeros_like(usable)
        unsure[near] = (lower[near][:, None, :] - moved[near] @ travel < asked[near][:, None, :]).any(axis=2)
        unsure &= usable
        unsure[:, unsure.shape[1] // 2] = False
        rows = np.argwhere(unsure)
        # no knot keeps a larger margin than the screen, which decides nearly all without measuring a distance
        rows = rows[~self._screen.keeps(found[unsure])] if len(rows) else rows
        as_much = self._floor[self._knots][rows[:, 0]] > ROOM - 2.0 * NEARER  # they keep as much as the screen
        usable[tuple(rows[as_much].T)] = False
        rows = rows[~as_much]
        for k, c in rows.tolist():
            usable[k, c] = bool(np.all(self._distances(found[k, c], asked[k]) >= asked[k]))

    def _nodes(self, neighbours: NDArray[np.float64]) -> Nodes:
        count, width, n = neighbours.shape
        before, after = (None if v is None else np.repeat(v, width, axis=0) for v in self._tip)
        return self._cost.nodes(neighbours.reshape(-1, n), (before, after)).reshape(count, width)

    # --- samples --------------------------------------------------------------------

    def _between_knots(self, at_knots: Matrix) -> Matrix | None:
        """(K, n) samples of a smooth curve through the knots, projected onto the path; None if that fails."""
        at = self._measure[self._knots]
        through = at_knots - self.q[self._knots] if self._added else at_knots
        guess = monotone_curve(at, through, self._measure, legs=self._legs)
        if self._added:
            guess += self.q
        moved, reached = solve_batch(self._kinematics, self._targets, guess, iterations=6)
        moved[self._knots] = at_knots
        if not reached.all() or np.max(np.abs(moved - guess)) > _STRAY:
            return None
        return moved

    def _bad_knots(self, moved: Matrix) -> tuple[Mask, Matrix]:
        """(M,) the knots next to samples that are not clear; (K, P) lower bounds of the distances along `moved`."""
        bad = np.zeros(len(self._knots), dtype=bool)
        clearance, travel = self._proximity.clearance, self._proximity.travel
        asked = clearance + self._floor[:, None]
        lower = self._lower - np.abs(moved - self.q) @ travel.T
        rows = np.flatnonzero((lower < asked).any(axis=1))
        lower[rows] = self._distances_of_each(moved[rows], self._floor[rows] + _AHEAD, lower[rows])
        tight = (lower < asked).any(axis=1)
        swept = np.abs(np.diff(moved, axis=0)) @ travel.T
        unsure = (0.5 * (lower[1:] + lower[:-1] - swept) < clearance - TOUCH).any(axis=1)
        for k in np.flatnonzero(unsure).tolist():
            if not path_segment_is_clear(self._proximity, moved[k], moved[k + 1], time=self._time):
                tight[k] = True
        tight |= self._bounds.broken(moved)
        after = np.searchsorted(self._knots, np.flatnonzero(tight))
        for shift in (-2, -1, 0, 1):  # the curve between two knots depends on four
            bad[np.clip(after + shift, 0, len(bad) - 1)] = True
        return bad, lower

    def _distances_of_each(self, q: Matrix, margin: Vector, known: Matrix) -> Matrix:
        """(N, P) lower bounds of the distances at each of q (N, n), exact within `margin` (N,) of the clearances [m].

        known: (N, P) known lower bounds [m].
        """
        together = None if len(self._proximity.clusters) else self._proximity.near_in_each_unchecked(q, margin, known)
        if together is not None:
            return together.lower
        found = known.copy()
        for row in range(len(q)):
            found[row] = self._distances(q[row], self._proximity.clearance + margin[row])
        return found

    def _distances(self, q: Vector, floor: Vector) -> Vector:
        """(P,) lower bounds of the distances at q (n,), exact if they are below `floor` (P,) [m]."""
        lower, _ = self._proximity.lower_bounds(q, time=self._time, floor=floor)
        return lower if self._there is None else np.where(self._there, lower, np.inf)


@lru_cache(maxsize=len(_WIDTHS))
def _offsets(directions: int) -> Array:
    """(C, directions) where the neighbours are, in distances of neighbours in one direction; the middle one at 0."""
    width = _WIDTHS[directions]
    steps = np.array(list(itertools.product(range(-width, width + 1), repeat=directions)), dtype=float)
    near = np.abs(steps).sum(axis=1) <= _STEPS_AWAY[directions]
    return np.asarray(_FURTHEST / max(width, 1) * steps[near])


def _aligned(bases: Array) -> Array:
    """(M, n, r) orthonormal bases of the same null spaces (M, n, r), each turned to be nearest to the one before.

    The turn that is nearest in the sense of least squares is the polar factor of their products (the orthogonal
    problem of Procrustes).
    """
    found = bases.copy()
    turn = _polar_of_two if bases.shape[2] == 2 else _polar
    for k in range(1, len(bases)):
        found[k] = bases[k].dot(turn(bases[k].T.dot(found[k - 1])))
    return found


def _polar(A: Matrix) -> Matrix:
    """The orthogonal factor of A (r, r)."""
    U, _, V = np.linalg.svd(A)
    return np.asarray(U @ V)


def _polar_of_two(A: Matrix) -> Matrix:
    """`_polar` for r = 2: the nearer one of the nearest turn and the nearest reflection."""
    (a, b), (c, d) = A.tolist()
    turn, reflection = math.hypot(a + d, c - b), math.hypot(a - d, c + b)
    if turn >= reflection:
        x, y = (1.0, 0.0) if turn == 0.0 else ((a + d) / turn, (c - b) / turn)
        return np.array(((x, -y), (y, x)))
    x, y = (a - d) / reflection, (c + b) / reflection
    return np.array(((x, y), (y, -x)))


def _knots(stations: Vector, q: Matrix, corners: Mask, spacing: float) -> NDArray[np.intp]:
    """(M,) rows that are knots: both ends, every corner, and as many as needed between them."""
    found = [0]
    at, sharp, joints = stations.tolist(), corners.tolist(), q.tolist()  # for a few joints, lists are quicker
    for row in range(1, len(at) - 1):
        last = found[-1]
        if not sharp[row] and at[row] - at[last] <= spacing - 1e-9:
            turn = max(abs(a - b) for a, b in zip(joints[row], joints[last], strict=True))
            if turn <= _KNOT_TURN * spacing:
                continue
        found.append(row)
    return np.array([*found, len(at) - 1])


def _cheapest(steps: Array, closed: Matrix) -> Indices:
    """(M,) one neighbour of every knot, so that the sum of `steps` (M - 1, C, C) is least.

    closed: (M, C) infinite for neighbours that cannot be used, otherwise 0.
    """
    value = closed[0]
    sources = []
    for row, cost in enumerate(steps):
        total = value[:, None] + cost
        source = np.argmin(total, axis=0)
        value = total[source, np.arange(len(source))] + closed[row + 1]
        sources.append(source)
    chosen = [int(np.argmin(value))]
    for source in reversed(sources):
        chosen.append(int(source[chosen[-1]]))
    return np.array(chosen[::-1])


@compiled
def cheapest_with_turns(steps: Array, rates: Array, closed: Matrix, price: float, /) -> Indices:
    """Like `_cheapest`, with changes of the joints' rates between two steps: Bellman's recursion over pairs.

    Parameters
    ----------
    rates: (n, M - 1, C, C) of n joints on each of the steps.
    price: of the largest change among the joints.
    """
    value = closed[0][:, None] + steps[0] + closed[1][None, :]
    sources = []
    for row in range(len(steps) - 1):
        total = np.abs(rates[:, row + 1, None] - rates[:, row, :, :, None]).max(axis=0)
        total *= price
        total += value[:, :, None]
        source = total.argmin(axis=0)
        value = total.min(axis=0) + steps[row + 1] + closed[row + 2]
        sources.append(source)
    a, b = np.unravel_index(int(np.argmin(value)), value.shape)
    chosen = [int(b), int(a)]
    for source in reversed(sources):
        chosen.append(int(source[chosen[-1], chosen[-2]]))
    return np.array(chosen[::-1])
