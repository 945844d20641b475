"""Whether a motion empties the bucket, and where the soil falls: the same check for planned motions and for files."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.job.cycles.dumping import OPEN, POURS_AT
from backhoe_planner.job.worksite.worksite import Worksite

_AS_OPEN = 0.02  # rad short of `OPEN` at which the bucket still empties; chosen, planned dumps reach it to 1e-5 rad
_SAME_PLACE = 1e-6  # m: rounding
_ASIDE = 0.05  # m from the place at which the soil may fall; chosen, a column of the ground, planned dumps have 0


def broken_dump_rules(site: Worksite, q: Matrix, place: Vector) -> list[str]:
    """In words, why a motion does not dump a bucketful at a place (2,) [m]; empty if it does.

    Parameters
    ----------
    q: (K, n) joints, one after the other.
    """
    plane, length = site.plane, site.bucket.length
    _, _, pitch = plane.place(q)
    tips = plane.kinematics.at(q).tip_position[:, :2]
    headings = np.array([plane.heading(float(row[0])) for row in q])
    ahead = np.stack((np.cos(headings), np.sin(headings)), axis=-1)
    falls = tips + (POURS_AT - length * np.cos(pitch))[:, None] * ahead
    found = []
    heap = site.job.dump.heap
    if heap is not None and min(float(np.hypot(*(place - at))) for at in heap.places) > _SAME_PLACE:
        found.append(f"x {place[0]:.2f}, y {place[1]:.2f} m is no place at which the job dumps (dump.heap.at)")
    if pitch[-1] < OPEN - _AS_OPEN:
        short = np.degrees(OPEN - pitch[-1])
        found.append(f"the bucket is not open at its end, it lacks {short:.0f} degrees")
    off = np.linalg.norm(falls - place, axis=1)
    if float(np.max(off)) > _ASIDE:
        x, y = falls[int(np.argmax(off))]
        found.append(f"the soil falls at x {x:.2f}, y {y:.2f} m, not at x {place[0]:.2f}, y {place[1]:.2f} m")
    return found
