"""Moments inside the long segments of a motion: what a limit there asks must not hang on how few samples there are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.motion.trajectory import Trajectory

__all__ = ["Between", "between_samples"]

Array = NDArray[np.float64]

_LONG = 0.025  # rad or m of a joint between two samples
_MOST = 200_000  # moments


@dataclass(frozen=True, eq=False)
class Between:
    """K moments inside the long segments of a sampled motion, in order.

    Attributes
    ----------
    segment: (K,) index of the segment.
    time: (K,) [s].
    q, v: (K, n) joints, and the constant velocity of the segment.
    """

    segment: NDArray[np.int64]
    time: Array
    q: Array
    v: Array


def between_samples(trajectory: Trajectory) -> Between:
    """Where a motion must be looked at besides its samples: no joint gets on by more than 0.025 rad unseen.

    The motions that are planned have none such; a motion of few samples has.
    """
    steps = np.max(np.abs(np.diff(trajectory.q, axis=0)), axis=1, initial=0.0)
    parts = np.ceil(steps / _LONG)
    parts = np.maximum(np.ceil(parts * min(1.0, _MOST / max(float(np.sum(parts)), 1.0))), 1.0).astype(np.int64)
    inside = parts - 1
    segment = np.repeat(np.arange(len(parts)), inside)
    number = np.arange(len(segment)) - np.repeat(np.cumsum(inside) - inside, inside) + 1
    part = number / parts[segment]
    time, q = trajectory.time, trajectory.q
    return Between(
        segment=segment,
        time=time[segment] + part * (time[segment + 1] - time[segment]),
        q=q[segment] + part[:, None] * (q[segment + 1] - q[segment]),
        v=trajectory.segment_velocities()[segment],
    )
