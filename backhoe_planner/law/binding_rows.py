"""A quadratic program with many soft rows, solved in bounded work.

Few of hundreds of rows bind. The program is first solved without its soft rows. Then the rows
that its solution violates most are added and it is solved again, until every row that was left
out is kept, or is violated by no more than the worst of those that are in (row generation, as in
cutting-plane methods). If all rows can be kept, the result is the solution with all rows:
its optimality conditions (Karush, Kuhn and Tucker) hold with multipliers of 0 for the rows
that were left out. If they cannot, as when somebody walks into an arm, every violated row would
enter the solver's active set, whose cost grows with its cube. A few different directions of the
worst violations are then weighed against each other instead.

Programs with up to `MOST_SOFT_ROWS` soft rows are solved at once, with all of them.

Few hard rows bind, too, in a program with hundreds of them and a hundred variables, in which the solver spends most
of its time on adding rows. `NearRows` leaves out the rows that no x within the bounds comes near, and adds
those that the solution violates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.law.qp import Kind, QuadraticProgram, Rows, StackedRows, solve_program
from backhoe_planner.law.unit_metric import solve_in_unit_metric
from backhoe_planner.native import compiled

MOST_SOFT_ROWS = 48  # in a problem that is solved; an ordinary step has up to 25 (scripts/bench_servo.py)
_ROUNDS = 4  # chosen; if all rows can be kept, 2 or 3 are enough
_PER_ROUND = MOST_SOFT_ROWS // _ROUNDS  # rows added at a time
MOST_ITERATIONS = 150  # of the solver for one problem; an ordinary step takes up to 10, 48 violated rows some 100
_ALIKE = 0.98  # cosine of the angle between two rows that demand the same; chosen, some 11 degrees
_KEPT = 1e-9  # rad/s or m/s, in the measure of the cost: rounding
_NONE: Indices = np.zeros(0, dtype=np.intp)
# part of the greatest value that g x can have within the bounds; rows whose h is larger are left out at first; chosen
# among 0.02 to 0.3: with 0.1, seven of a hundred programs are solved again
_FAR = 0.1
# variables, from which a program is solved by `solve_in_unit_metric`; measured on 1,300 programs of descents: it takes
# the same time up to 120 variables, 0.8 of it up to 320, and 0.4 above
_MANY = 120
_ROUNDING = 1e-5  # m/rad: a row without a greater entry is noise; measured, coal's normals are right to some 1e-6
_MISSED = 1e-6  # in the units of the conditions: a row is violated if by more; the solver's own tolerance


class BindingSolution(NamedTuple):
    """The x of least cost, and the work to find it.

    Attributes
    ----------
    x: (n,).
    kept: (K,) indices of the soft rows that were in, counted through all blocks.
    rows: number of rows of the largest problem that was solved.
    problems, iterations: number of problems that were solved, and of the solver's iterations in all of them.
    """

    x: Vector
    kept: Indices
    rows: int
    problems: int
    iterations: int


def solve_with_binding_rows(
    program: QuadraticProgram, *, first: Indices | None = None, stacked: StackedRows | None = None
) -> BindingSolution | None:
    """The solution; None if no x keeps bounds, hard and equal rows, or the solver needs too many iterations.

    Parameters
    ----------
    first: (K,) soft rows for a warm start, such as `kept` of a similar program with the same rows.
    stacked: the program's rows, if several programs share them.
    """
    if stacked is None:
        stacked = StackedRows.of(program.rows, len(program.f))
    count = stacked.total
    if stacked.soft == count <= MOST_SOFT_ROWS:
        solved = soft_solution(*program[:4], stacked.G, stacked.high, MOST_ITERATIONS)
        return None if solved is None else BindingSolution(solved[0], _NONE, count, 1, solved[1])
    if stacked.soft <= MOST_SOFT_ROWS:
        solution = solve_program(program, most_iterations=MOST_ITERATIONS, stacked=stacked)
        return None if solution is None else BindingSolution(solution.x, _NONE, count, 1, solution.iterations)
    soft = [block for block in program.rows if block.kind is Kind.SOFT]
    others = tuple(block for block in program.rows if block.kind is not Kind.SOFT)
    G, h = np.concatenate([block.G for block in soft]), np.concatenate([block.h for block in soft])
    # a violation is measured by how far x has to move to remove it, in the measure of the cost
    direction = np.linalg.solve(np.linalg.cholesky(program.H), G.T).T
    size = np.sqrt((direction**2).sum(axis=1))
    size[~_says_something(G)] = np.inf  # see `soft_solution`
    direction /= size[:, None]
    kept, found, iterations = _NONE if first is None else first, None, 0
    for number in range(_ROUNDS + 1):
        solution = solve_program(
            program._replace(rows=(*others, Rows("binding", G[kept], h[kept]))), most_iterations=MOST_ITERATIONS
        )
        if solution is None:
            return found
        iterations += solution.iterations
        found = BindingSolution(solution.x, kept, count - len(h) + len(kept), number + 1, iterations)
        missed = (G @ solution.x - h) / size
        worst = max(float(missed[kept].max(initial=0.0)), _KEPT)
        missed[kept] = -np.inf
        room = min(_PER_ROUND, MOST_SOFT_ROWS - len(kept))
        if room == 0 or not (missed > worst).any():
            break
        kept = np.append(kept, _most_missed(direction, missed, beyond=worst, count=room))
    return found


class NearRows:
    """The rows that programs without soft rows share, of which only those that an x comes near are solved with.

    Parameters
    ----------
    program: with these rows; its bounds say which x are possible.
    """

    def __init__(self, program: QuadraticProgram) -> None:
        rows = [row for row in program.rows if row.kind is Kind.HARD and len(row.h)]
        self._equal = [row for row in program.rows if row.kind is not Kind.HARD]
        n = len(program.f)
        self._G = np.concatenate([np.zeros((0, n)), *(row.G for row in rows)])
        self._h = np.concatenate([np.zeros(0), *(row.h for row in rows)])
        most = np.maximum(self._G, 0.0) @ program.high + np.minimum(self._G, 0.0) @ program.low
        self._near = self._h < _FAR * most

    def solve(
        self, program: QuadraticProgram, *, most_iterations: int, coupled: int = 0, start: Vector | None = None
    ) -> Vector | None:
        """(n,) the x of least cost with the shared rows and those of the program; None as for `solve_program`.

        At the end x keeps every row that was left out, so that it is the x of the program with all rows. A row that it
        has needed once is not left out again.

        Parameters
        ----------
        program: it may have more variables, after those of the shared rows; none of its own rows is left out.
        coupled: so many of the first variables are coupled by H, if it is known to be diagonal in the others; else 0.
        start: as for `solve_program`.
        """
        shared = self._G.shape[1]
        while True:
            some = self._with_near(program)
            if coupled and len(program.f) >= _MANY:
                x = solve_in_unit_metric(some, coupled, most_iterations=most_iterations, start=start)
            else:
                found = solve_program(some, most_iterations=most_iterations, start=start)
                x = None if found is None else found.x
            if x is None:
                return None
            missed = ~self._near & (self._G @ x[:shared] > self._h + _MISSED)
            if not missed.any():
                return x
            self._near |= missed
            start = x

    def _with_near(self, program: QuadraticProgram) -> QuadraticProgram:
        """The program with the near ones of the shared rows; they do not depend on the variables that only it has."""
        more = len(program.f) - self._G.shape[1]
        rows = [*self._equal, Rows("near", self._G[self._near], self._h[self._near], Kind.HARD)]
        if more:
            rows = [row._replace(G=np.hstack((row.G, np.zeros((len(row.h), more))))) for row in rows]
        return program._replace(rows=(*rows, *program.rows))


def solve_with_near_rows(program: QuadraticProgram, *, most_iterations: int) -> Vector | None:
    """(n,) the x of least cost of a program without soft rows, see `NearRows.solve`."""
    return NearRows(program).solve(program._replace(rows=()), most_iterations=most_iterations)


@compiled
def soft_solution(
    H: Matrix, f: Vector, low: Vector, high: Vector, G: Matrix, h: Vector, most_iterations: int, /
) -> tuple[Vector, int] | None:
    """The x (n,) of a program with only soft rows G x <= h, and the solver's iterations; None if it needs more.

    A row of nothing but rounding is left out. Such a row arises if a link turns about an axis through the obstacle
    that it is too near to; being violated, it would demand all that the joints can do.
    """
    some = _says_something(G)
    if not some.all():
        G, h = G[some], h[some]
    stacked = StackedRows.of((Rows("soft", G, h),), len(f))
    program = QuadraticProgram(H, f, low, high)
    solution = solve_program(program, most_iterations=most_iterations, stacked=stacked)
    return None if solution is None else (solution.x, solution.iterations)


def _says_something(G: Matrix) -> Flags:
    """(K,) which rows of G (K, n) are more than rounding."""
    return np.asarray((np.abs(G) > _ROUNDING).any(axis=1))


def _most_missed(direction: Matrix, missed: Vector, *, beyond: float, count: int) -> Indices:
    """Rows that are violated by more than `beyond`, the worst of each direction, at most `count`."""
    chosen: list[int] = []
    left = missed.copy()
    while len(chosen) < count and left[row := int(left.argmax())] > beyond:
        chosen.append(row)
        left[direction @ direction[row] > _ALIKE] = -np.inf
        left[row] = -np.inf
    return np.array(chosen, dtype=np.intp)
