"""Whether one segment of a motion is clear: what planners and the servo ask of every step.

On a segment from q_a to q_b, joints moving linearly, no point of a link moves further than
B = sum_j |dq_j| r_j relative to an obstacle (its own travel added), so the distance
anywhere between is at least (d_a + d_b - B) / 2. Where that bound does not decide, the
segment is halved.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.site import Proximity

__all__ = ["TOUCH", "path_segment_is_clear", "segment_is_clear"]


TOUCH = 5e-5  # m: a path at exactly its clearance is clear to within this, half of `clearances.RESOLUTION`
_TOUCHING_DEPTH = 9  # halvings: 1/512 of a step of 0.02 m moves no point by more than `TOUCH`


def segment_is_clear(
    proximity: Proximity, q_a: Vector, q_b: Vector, *, time: float = 0.0, dt: float = 0.0, depth: int = 6,
    spare: float = 0.0,
) -> bool:  # fmt: skip
    """Whether every clearance provably holds on one segment.

    Parameters
    ----------
    q_a, q_b: (n,) its ends; the joints move linearly between them.
    time, dt: when it begins, and how long it takes [s].
    depth: how often it may be halved.
    spare: to be kept beyond every clearance [m]; less than 0 allows as much less.
    """
    if spare <= 0.0 and proximity.is_at(q_a, time=time) and proximity.stays_clear(q_b, time=time + dt):
        return True
    travel = np.abs(q_b - q_a) @ proximity.travel.T + dt * proximity.speed
    least = proximity.clearance + spare
    floor = least + travel
    present = proximity.appears_at <= time + dt
    d_a, _ = proximity.lower_bounds(q_a, time=time, floor=floor)
    d_b, _ = proximity.lower_bounds(q_b, time=time + dt, floor=floor)
    bound = 0.5 * (d_a + d_b - travel)
    undecided = present & (bound < least)
    if not np.any(undecided):
        return True
    if np.any(present & ((d_a < least) | (d_b < least))) or depth == 0:
        return False
    middle = 0.5 * (q_a + q_b)
    return segment_is_clear(
        proximity, q_a, middle, time=time, dt=0.5 * dt, depth=depth - 1, spare=spare
    ) and segment_is_clear(
        proximity, middle, q_b, time=time + 0.5 * dt, dt=0.5 * dt, depth=depth - 1, spare=spare
    )  # fmt: skip


def path_segment_is_clear(proximity: Proximity, q_a: Vector, q_b: Vector, *, time: float = 0.0) -> bool:
    """The same for a segment along a bucket path, which may run at exactly its clearance: to within `TOUCH`."""
    return segment_is_clear(proximity, q_a, q_b, time=time, depth=_TOUCHING_DEPTH, spare=-TOUCH)
