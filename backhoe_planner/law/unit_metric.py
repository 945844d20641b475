"""A program with many variables, solved in variables z in which its quadratic cost is 1/2 z^T z.

    x = F z        F^T H F = 1        min_z  1/2 z^T z + (F^T f)^T z
                                      s.t.   low <= F z <= high,  G F z <= h or = h

daqp does the same by itself, in plain loops, which take most of its time if there are hundreds of variables. Here BLAS
does it, and leaves out the variables that stand alone in H: for each of them F has one entry.
"""

from __future__ import annotations

import math

import numpy as np

from backhoe_planner.arrays import Indices, Vector
from backhoe_planner.law.qp import UNBOUNDED, Kind, QuadraticProgram, solve_from

# conditions that bind at a start, from which it is not used: daqp adds them one by one before its first iteration. On
# four sites (three machines) 172 programs with more took 11.2 s from their starts and 2.8 s without, and 1,404
# others 1.4 and 2.0 s
_MOST_BINDING = 150
_BINDS = 1e-6  # by which a condition that binds may be off, as in daqp


def solve_in_unit_metric(
    program: QuadraticProgram, coupled: int, *, most_iterations: int, start: Vector | None = None
) -> Vector | None:
    """(n,) the x of least cost of a program without soft rows; None as for `solve_program`, or if H is not definite.

    Parameters
    ----------
    coupled: so many of the first variables are coupled by H; it is diagonal in the others.
    start: as for `solve_program`; it is not used if so many conditions bind there that it would not help.
    """
    alone, own = len(program.f) - coupled, np.diag(program.H)[coupled:]
    if alone and not own.min() > 0.0:
        return None
    try:
        L = np.linalg.cholesky(program.H[:coupled, :coupled])
    except np.linalg.LinAlgError:
        return None
    F = np.linalg.inv(L).T
    f = 1.0 / np.sqrt(own)
    rows = [row for row in program.rows if len(row.h)]
    count = sum(len(row.h) for row in rows)
    # the variables that stand alone come first, as their bounds remain bounds
    A = np.zeros((coupled + count, alone + coupled))
    A[:coupled, alone:] = F
    upper = np.full(alone + 2 * coupled + count, UNBOUNDED)
    senses: Indices = np.zeros(len(upper), dtype=np.int32)
    lower = -upper
    for bounds, given in ((upper, program.high), (lower, program.low)):
        bounds[:alone] = np.clip(given[coupled:] / f, -UNBOUNDED, UNBOUNDED)
        bounds[alone + coupled : alone + 2 * coupled] = given[:coupled]
    first = coupled
    for row in rows:
        those: slice = slice(first, first + len(row.h))
        A[those, alone:] = row.G[:, :coupled] @ F
        A[those, :alone] = row.G[:, coupled:] * f
        first = those.stop
        bound: slice = slice(alone + coupled + those.start, alone + coupled + those.stop)
        upper[bound] = row.h
        if row.kind is Kind.EQUAL:
            lower[bound], senses[bound] = row.h, Kind.EQUAL
    pull = np.concatenate((program.f[coupled:] * f, program.f[:coupled] @ F))
    z_start = None if start is None else np.concatenate((start[coupled:] / f, start[:coupled] @ L))
    if z_start is not None:
        at = np.concatenate((z_start, A @ z_start))
        binding = np.minimum(np.abs(upper - at), np.abs(at - lower)) <= _BINDS
        z_start = z_start if np.count_nonzero(binding) <= _MOST_BINDING else None
    z, flag, _ = solve_from(z_start, np.eye(len(pull)), pull, A, upper, lower, senses, most_iterations=most_iterations)
    if flag < 1 or not all(map(math.isfinite, z.tolist())):
        return None
    return np.concatenate((F @ z[alone:], z[:alone] * f))
