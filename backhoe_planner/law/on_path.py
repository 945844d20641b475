"""The law along a path that must be kept: the nearest joint step that stays on it.

    min_dq |dq - dq_w|^2   s.t.   J dq = e,  -g_i dq <= part margin_i,  limits

Here the task is not weighed against safety as in the shield: where no step keeps the
path, every clearance and every limit, the answer is None.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law.qp import Kind, QuadraticProgram, Rows, solve_program

__all__ = ["step_on_path"]


def step_on_path(
    wish: Vector, J: Matrix, *, error: Vector, low: Vector, high: Vector, rows: tuple[Rows, ...] = ()
) -> Vector | None:
    """(n,) the step nearest to `wish` (n,) with J dq = error [rad or m], or None where there is none.

    Parameters
    ----------
    J: (m, n) task Jacobian; error: (m,) what the step must take back.
    low, high: (n,) bounds of the step.
    rows: further conditions that it must keep.
    """
    path = Rows("path", J, error, Kind.EQUAL)
    solution = solve_program(QuadraticProgram(np.eye(len(wish)), -wish, low, high, (path, *rows)))
    return None if solution is None else solution.x
