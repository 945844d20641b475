"""From where a path is resolved, and what that gives: stretches on the path, detours, and what is in the way."""

from __future__ import annotations

from dataclasses import dataclass

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import WaypointStep
from backhoe_planner.planning.stretches.stretch import Stretch
from backhoe_planner.site import Obstruction


@dataclass(frozen=True, eq=False)
class Departure:
    """From where and when a path is resolved.

    Attributes
    ----------
    since: arc length [m].
    begin: (n,) joints with the tip on the path there, from which it has to be followed; None for any.
    time: at which the positions of the obstacles are taken [s].
    """

    since: float = 0.0
    begin: Vector | None = None
    time: float = 0.0


@dataclass(frozen=True, eq=False)
class Bypass:
    """A detour: the tip leaves the path and comes back.

    Attributes
    ----------
    q: (K, n) joint positions, straight lines between them.
    obstruction: what it goes around, with the part of the path that it leaves out.
    """

    q: Matrix
    obstruction: Obstruction


@dataclass(frozen=True, eq=False)
class Resolution:
    """A path resolved into joint positions.

    Attributes
    ----------
    pieces: in order; if the path is blocked, those up to the blocked part.
    obstruction: what is in the way, and on which part of the path; None if the pieces
        lead to its end.
    step: if only steps between waypoints are too long, the shortest one that was found.
    routes: how many routes through the layers were tested.
    gave_up: whether the search ended before all routes were tested.
    """

    pieces: tuple[Stretch | Bypass, ...]
    obstruction: Obstruction | None = None
    step: WaypointStep | None = None
    routes: int = 0
    gave_up: bool = False
