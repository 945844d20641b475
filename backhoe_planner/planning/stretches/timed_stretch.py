"""A stretch of a path with its corners rounded, and the fastest motions along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Problem, TipPath, Trajectory, join_at_stops
from backhoe_planner.planning.stretches.corners import round_corners, time_stretch
from backhoe_planner.planning.stretches.stretch import Stretch
from backhoe_planner.site import Proximity


@dataclass(frozen=True, eq=False)
class TimedStretch:
    """A stretch with its corners rounded where that is clear, and the fastest motions along it.

    Attributes
    ----------
    rounded: the stretch with rounded corners.
    stops: (C,) arc lengths of the other sharp corners [m].
    motions: from stop to stop, each from rest to rest with time from 0; none if they have not been computed.
    """

    rounded: Stretch
    stops: Vector
    motions: tuple[Trajectory, ...] = ()

    @cached_property
    def motion(self) -> Trajectory:
        """The motions one after the other; the machine rests for one step between two."""
        return join_motions(self.motions)


def time_rounded(
    problem: Problem, path: TipPath, stretch: Stretch, *, proximity: Proximity, time: float = 0.0
) -> TimedStretch:
    """The fastest motions along a stretch, at rest at both ends and at corners that cannot be rounded.

    Parameters
    ----------
    time: at which the positions of the obstacles are taken [s].
    """
    rounded, stops = round_corners(problem, path, stretch, proximity=proximity, time=time)
    return TimedStretch(rounded, stops, tuple(time_stretch(problem, path, rounded, stops=stops)))


def join_motions(motions: Sequence[Trajectory]) -> Trajectory:
    """Motions from rest to rest, one after the other; the machine rests for one step between them."""
    moving = [motions[0], *(motion for motion in motions[1:] if len(motion) > 1)]
    return join_at_stops(moving, [np.diff(motion.time[-2:]) for motion in moving[:-1]])
