"""The law along a path that must be kept: the nearest joint step that stays on it.

    min_dq |dq - dq_w|^2   s.t.   J dq = e,  g_i dq >= -part margin_i,  limits

Here the task is not weighed against safety as in the shield: a step that would leave
the path, a clearance or a limit does not exist, and that it does not is the answer.
"""

from __future__ import annotations

import daqp
import numpy as np
from numpy.typing import NDArray

__all__ = ["step_on_path"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_EQUALITY = 5  # daqp's sense
_UNBOUNDED = 1e30


def step_on_path(
    wish: Vector, J: Matrix, error: Vector, low: Vector, high: Vector, rows: Matrix, lower: Vector
) -> Vector | None:
    """(n,) the step nearest to `wish` with J dq = error, or None where there is none.

    Parameters
    ----------
    J: (m, n) task Jacobian; error: (m,) what the step must take back.
    low, high: (n,) bounds of the step.
    rows, lower: (k, n) and (k,), further rows: rows @ dq >= lower.
    """
    n, m, k = len(wish), len(error), len(lower)
    sense = np.zeros(n + m + k, dtype=np.int32)
    sense[n : n + m] = _EQUALITY
    x, _, flag, _ = daqp.solve(
        np.eye(n),
        -wish,
        np.ascontiguousarray(np.vstack((J, rows))),
        np.concatenate((high, error, np.full(k, _UNBOUNDED))),
        np.concatenate((low, error, lower)),
        sense,
    )
    return np.array(x) if flag >= 1 and np.all(np.isfinite(x)) else None
