"""What a follower left out of its plan, because detours round something rejoined it further on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.machine import BatchKinematics, Robot
from backhoe_planner.motion import Trajectory

_LEAST = 1e-6  # s: less is rounding of a detour that ends where it began


@dataclass(frozen=True)
class LeftOut:
    """A part of a plan that a detour left out.

    Attributes
    ----------
    begins, ends: the times along the plan between which the machine was not on it [s].
    length: of the tip's way along that part [m].
    """

    begins: float
    ends: float
    length: float

    def __str__(self) -> str:
        return f"{self.length:.2f} m from {self.begins:.1f} to {self.ends:.1f} s"

    def __repr__(self) -> str:
        return f"<LeftOut: {self}>"


def part_left_out(robot: Robot, motion: Trajectory, begins: float, ends: float) -> LeftOut | None:
    """The part of a motion between two times [s]; None if they are the same."""
    if ends - begins < _LEAST:
        return None
    within = (motion.time > begins) & (motion.time < ends)
    q = np.vstack((motion.at(begins)[None], motion.q[within], motion.at(ends)[None]))
    steps = np.diff(BatchKinematics(robot).tip_positions(q), axis=0)
    return LeftOut(begins, ends, float(np.linalg.norm(steps, axis=1).sum()))


def left_out_text(parts: Sequence[LeftOut]) -> str:
    """The parts in words, such as ``1.37 m and 3.2 s of the plan were left out, from 1.2 to 4.4 s``; empty for none."""
    if not parts:
        return ""
    length, time = sum(part.length for part in parts), sum(part.ends - part.begins for part in parts)
    ranges = " and ".join(f"from {part.begins:.1f} to {part.ends:.1f} s" for part in parts)
    return f"{length:.2f} m and {time:.1f} s of the plan were left out, {ranges}"
