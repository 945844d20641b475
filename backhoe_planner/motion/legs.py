"""The legs of a sequence and the parts of a motion that belong to them."""

from __future__ import annotations

from dataclasses import dataclass

from backhoe_planner.errors import InputError
from backhoe_planner.motion.problem import Problem
from backhoe_planner.motion.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class LegPart:
    """One leg of a sequence, as far as a motion goes through it.

    Attributes
    ----------
    name: of the leg; empty if the problem is not a sequence.
    first, last: its samples in the whole motion; the last is the first of the next leg.
    begins: when it begins [s].
    problem: of the leg, with the start at the joints where it begins, on its own clock.
    motion: its part of the whole motion, on that clock.
    """

    name: str
    first: int
    last: int
    begins: float
    problem: Problem
    motion: Trajectory


def leg_parts(problem: Problem, trajectory: Trajectory) -> tuple[LegPart, ...]:
    """The part of every leg that a motion has begun; the whole motion if the problem is not a sequence.

    Raises
    ------
    InputError: the motion has the beginnings of more or fewer legs than the sequence can have.
    """
    begins = trajectory.begins
    if not problem.legs:
        if len(begins) > 1:
            raise InputError(
                "the motion has legs, the scene has no sequence", key="trajectory.begins", found=list(begins),
            )  # fmt: skip
        return (LegPart("", 0, len(trajectory) - 1, 0.0, problem, trajectory),)
    if not 1 <= len(begins) <= len(problem.legs):
        raise InputError(
            "does not fit the sequence", key="trajectory.begins", found=list(begins),
            allowed=f"the first sample of each leg, of 1 to {len(problem.legs)} legs",
        )  # fmt: skip
    found = []
    for index, (leg, first) in enumerate(zip(problem.legs, begins, strict=False)):
        last = begins[index + 1] if index + 1 < len(begins) else len(trajectory) - 1
        part, time = trajectory.part(first, last), float(trajectory.time[first])
        own = leg if index == 0 and leg.wait is None else leg.beginning(part.q[0], time)
        found.append(LegPart(leg.name, first, last, time, own, part))
    return tuple(found)
