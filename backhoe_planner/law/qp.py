"""One quadratic program: built of named rows, open to inspection, then solved by daqp.

    min_x  1/2 x^T H x + f^T x + sum_i PRICE / 2 s_i^2 / (g_i H^-1 g_i^T)
    s.t.   low <= x <= high         bounds, always kept
           G x <= h                 rows of kind HARD
           G x  = h                 rows of kind EQUAL
           G x <= h + s             rows of kind SOFT; s is their violation

The price of s_i is daqp's: it measures the violation of a row by how far x has to move to
remove it, in the measure of the cost.

All conditions have this one sign. Building is separate from solving, so that tests can
inspect the problem, and a solution can itself tell whether it is right.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from functools import lru_cache
from typing import Any, NamedTuple

import daqp
import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.native import compiled

PRICE = 1e6  # of the violation of soft rows, see above: 1 / rho_soft of daqp
UNBOUNDED = 1e30  # daqp treats a bound of this size as none
_MISSED = 2  # daqp's flag if a soft row is violated
_KEPT = 1e-5  # in the units of the conditions: ten times daqp's tolerance


class Kind(IntEnum):
    """How a row binds; the numbers are daqp's senses."""

    HARD = 0
    EQUAL = 5
    SOFT = 8


class Rows(NamedTuple):
    """Conditions G x <= h from one source.

    Attributes
    ----------
    name: of the source, such as "clearance".
    G: (K, n).
    h: (K,).
    kind: of all rows.
    """

    name: str
    G: Matrix
    h: Vector
    kind: Kind = Kind.SOFT

    @classmethod
    def none(cls, name: str, n: int) -> Rows:
        """No condition on x (n,)."""
        return cls(name, np.zeros((0, n)), np.zeros(0))

    def are_kept_by(self, x: Vector, tolerance: float = 0.0) -> bool:
        """Whether G x <= h + tolerance at x (n,)."""
        return len(self.h) == 0 or keeps_rows(self.G, self.h, x, tolerance)


@compiled
def keeps_rows(G: Matrix, h: Vector, x: Vector, tolerance: float, /) -> bool:
    """Whether G x <= h + tolerance for rows G (K, n), h (K,) at x (n,)."""
    return not np.count_nonzero(G.dot(x) > (h + tolerance if tolerance else h))


class QuadraticProgram(NamedTuple):
    """A problem, see the module's docstring.

    Attributes
    ----------
    H: (n, n) symmetric, positive definite.
    f: (n,).
    low, high: (n,) bounds of x; -UNBOUNDED and UNBOUNDED for none.
    rows: further conditions.
    """

    H: Matrix
    f: Vector
    low: Vector
    high: Vector
    rows: tuple[Rows, ...] = ()


class StackedRows(NamedTuple):
    """All conditions of a program stacked, as daqp takes them; the bounds of x (n,) come first.

    If there are soft rows, spare rows without effect make room for the hard and equal ones.
    daqp 0.11.0 allocates memory for a working set of n + 1 conditions and one more for each soft row. If the rows of
    a set are linearly dependent, and a soft row is part of the dependence, daqp goes on as if they were independent
    (`daqp_remove_blocking`, "blocked by the slacks"), and writes beyond that memory once such a set has grown
    further. With the spare rows there is room for all conditions at once, and none is ever in the set twice.

    Attributes
    ----------
    G: (K + S, n), with S spare rows.
    low, high: (K + S,); -UNBOUNDED for none.
    senses: (n + K + S,) daqp's, of bounds and rows.
    total: K.
    soft: how many of the K rows are soft.
    """

    G: Matrix
    low: Vector
    high: Vector
    senses: Indices
    total: int
    soft: int

    @classmethod
    def of(cls, rows: tuple[Rows, ...], n: int) -> StackedRows:
        """The conditions on x (n,)."""
        blocks = [block for block in rows if len(block.h)]
        if not blocks:
            return _no_rows(n)
        if len(blocks) == 1 and blocks[0].kind is Kind.SOFT:  # the common case first
            count = len(blocks[0].h)
            unbounded, soft_senses = _soft_rows(count, n)
            return cls(blocks[0].G, unbounded, blocks[0].h, soft_senses, count, count)
        count = sum([len(block.h) for block in blocks])
        soft = sum([len(block.h) for block in blocks if block.kind is Kind.SOFT])
        if soft and count - soft > 1:
            blocks.append(_spare_rows(count - soft - 1, n))
        G, h = blocks[0].G, blocks[0].h
        if len(blocks) > 1:
            G, h = np.concatenate([block.G for block in blocks]), np.concatenate([block.h for block in blocks])
        senses: Indices = np.zeros(n + len(h), dtype=np.int32)
        low = np.full(len(h), -UNBOUNDED)
        first = 0
        for block in blocks:
            after = first + len(block.h)
            if block.kind is not Kind.HARD:
                senses[n + first : n + after] = block.kind
            if block.kind is Kind.EQUAL:
                low[first:after] = block.h
            first = after
        return cls(G, low, h, senses, count, soft)


@lru_cache(maxsize=32)
def _no_rows(n: int) -> StackedRows:
    return StackedRows(np.zeros((0, n)), np.zeros(0), np.zeros(0), np.zeros(n, dtype=np.int32), 0, 0)


@lru_cache(maxsize=128)
def _soft_rows(count: int, n: int) -> tuple[Vector, Indices]:
    """The lower sides and the senses of `count` soft rows on x (n,); do not modify them."""
    senses: Indices = np.zeros(n + count, dtype=np.int32)
    senses[n:] = Kind.SOFT
    return np.full(count, -UNBOUNDED), senses


@lru_cache(maxsize=32)
def _spare_rows(count: int, n: int) -> Rows:
    return Rows("spare", np.zeros((count, n)), np.full(count, UNBOUNDED))


class Solution(NamedTuple):
    """The x of least cost.

    Attributes
    ----------
    x: (n,).
    multipliers: (n + K,) of the bounds and of all rows, positive at an upper side.
    iterations: of the solver.
    """

    program: QuadraticProgram
    x: Vector
    multipliers: Vector
    iterations: int = 0

    @property
    def residual(self) -> float:
        """Largest violation of the optimality conditions (Karush, Kuhn and Tucker), in the units of the terms.

        It covers the gradient of the Lagrangian, violated conditions, and multipliers of
        conditions that do not bind; it is 0 at the exact solution.
        """
        program, x = self.program, self.x
        n = len(x)
        pull = program.H @ x + program.f + self.multipliers[:n]
        off = [np.maximum(program.low - x, x - program.high)]
        side = np.where(self.multipliers[:n] > 0.0, program.high - x, x - program.low)
        off.append(np.where(self.multipliers[:n] == 0.0, 0.0, side))
        first = n
        for rows in program.rows:
            force = self.multipliers[first : first + len(rows.h)]
            first += len(rows.h)
            pull = pull + rows.G.T @ force
            over = rows.G @ x - rows.h
            if rows.kind is Kind.SOFT:
                over -= force / PRICE * np.einsum("kn,nk->k", rows.G, np.linalg.solve(program.H, rows.G.T))
            off.append(over if rows.kind is not Kind.EQUAL else np.abs(over))
            if rows.kind is not Kind.EQUAL:
                off += [-force, np.where(force == 0.0, 0.0, -over)]
        return float(max(np.abs(pull).max(), *(part.max(initial=0.0) for part in off)))


def solve_program(
    program: QuadraticProgram, *, most_iterations: int = 1000, stacked: StackedRows | None = None,
    start: Vector | None = None,
) -> Solution | None:  # fmt: skip
    """The solution, or None if no x keeps bounds, hard and equal rows.

    Parameters
    ----------
    most_iterations: of the solver; if it needs more, the result is None, too.
    stacked: the program's rows, if several programs share them.
    start: an x (n,) at which nearly the same conditions bind as at the solution, if one is known.
    """
    if stacked is None:
        stacked = StackedRows.of(program.rows, len(program.f))
    upper, lower = program.high, program.low
    if stacked.total:
        upper, lower = np.concatenate((upper, stacked.high)), np.concatenate((lower, stacked.low))
    x, flag, more = solve_from(
        start, program.H, program.f, stacked.G, upper, lower, stacked.senses, most_iterations=most_iterations
    )
    if flag < 1 or not all(map(math.isfinite, x.tolist())):
        return None
    multipliers = more["lam"]
    known = len(x) + stacked.total
    if flag == _MISSED and stacked.total > stacked.soft and not _keeps(program, stacked, x):
        return None
    return Solution(program, x, multipliers if len(multipliers) == known else multipliers[:known], more["iterations"])


def solve_from(
    start: Vector | None, H: Matrix, f: Vector, G: Matrix, upper: Vector, lower: Vector, senses: Indices,
    *, most_iterations: int,
) -> tuple[Vector, int, Mapping[str, Any]]:  # fmt: skip
    """The x (n,) of daqp, its flag, and what else it says; from `start` (n,) if that is given and helps."""
    if start is not None:
        x, _, flag, more = daqp.solve(H, f, G, upper, lower, senses, iter_limit=most_iterations, primal_start=start)
        if flag >= 1:
            return x, flag, more
    x, _, flag, more = daqp.solve(H, f, G, upper, lower, senses, iter_limit=most_iterations)
    return x, flag, more


def _keeps(program: QuadraticProgram, stacked: StackedRows, x: Vector) -> bool:
    """Whether x (n,) keeps bounds, hard and equal rows, which daqp does not ensure if it violates a soft row."""
    off = np.maximum(program.low - x, x - program.high)
    Gx = stacked.G @ x
    miss = np.maximum(stacked.low - Gx, Gx - stacked.high)[stacked.senses[len(x) :] != Kind.SOFT]
    return float(off.max()) <= _KEPT and float(miss.max()) <= _KEPT


def step_on_path(
    wish: Vector, J: Matrix, *, error: Vector, low: Vector, high: Vector, rows: tuple[Rows, ...] = ()
) -> Vector | None:
    """(n,) the step dq nearest to `wish` (n,) with J dq = error [rad or m], or None if there is none.

    Parameters
    ----------
    J: (m, n) task Jacobian; error: (m,) the error that the step must remove.
    low, high: (n,) bounds of the step.
    rows: further conditions that the step must keep.

    Unlike in the shield, the task is not weighed against safety.
    """
    path = Rows("path", J, error, Kind.EQUAL)
    solution = solve_program(QuadraticProgram(np.eye(len(wish)), -wish, low, high, (path, *rows)))
    return None if solution is None else solution.x
