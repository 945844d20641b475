"""A stretch of a path that the tip follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import TipPath, Trajectory
from backhoe_planner.proof import AT_CLEARANCE
from backhoe_planner.site import Obstruction

STRAIGHT_STEP = 0.03  # rad or m of a joint from sample to sample on the straight line between two nodes; chosen
BENT = 3.0  # times that a step of the actual joint motion may exceed that of the straight line; chosen
NEARER = 0.5 * AT_CLEARANCE  # m by which a sample may be too near; half, as a curve through samples comes nearer still
JUMP = 0.02  # rad or m by which such a step may be longer still, for short straight steps; chosen


@dataclass(frozen=True, eq=False)
class Stretch:
    """Joint positions with the tip on a path.

    Attributes
    ----------
    stations: (K,) arc lengths [m], not decreasing.
    q: (K, n) joint positions there [rad or m].
    obstruction: what ended the stretch before the end of the path; None if nothing did.
    """

    stations: Vector
    q: Matrix
    obstruction: Obstruction | None = None

    @property
    def reached(self) -> float:
        """Its last arc length [m]."""
        return float(self.stations[-1])

    def followed_by(self, motion: Stretch) -> tuple[Stretch, Vector]:
        """Both stretches as one, if `motion` begins at the end; and (n,) the whole turns by which its joints shift."""
        turns = 2.0 * np.pi * np.round((self.q[-1] - motion.q[0]) / (2.0 * np.pi))
        q = np.vstack((self.q, motion.q[1:] + turns))
        return Stretch(np.concatenate((self.stations, motion.stations[1:])), q), np.asarray(turns)


@dataclass(frozen=True, eq=False)
class LawWay:
    """How the local law follows a whole path among static obstacles.

    Attributes
    ----------
    fastest: the fastest motion along the stretch; None if it has not been computed.
    """

    path: TipPath
    stretch: Stretch
    fastest: Trajectory | None = None
