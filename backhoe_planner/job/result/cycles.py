"""The cycles of a job: their legs, the ground that they change, and the soil that they move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.proof import Certificate

LegName = Literal["approach", "cut", "swing", "dump"]


@dataclass(frozen=True, eq=False)
class CycleLeg:
    """One motion of a cycle, from rest to rest.

    Attributes
    ----------
    name: the kind of motion.
    problem: machine, task, and all obstacles as they are during this motion, the ground among them.
    trajectory: the motion.
    certificate: what is proven about the motion.
    payload: mass in the bucket [kg]; for a cut, the mass at its end; for a dump, the mass at its beginning.
    work: work of the joints [J].
    hydraulic: energy of the pump: highest pressure times whole flow [J]; nan for a machine without hydraulics.
    pump, engine: mean use of the pump's flow and of the engine's power, 0 to 1; nan for a machine without hydraulics.
    """

    name: LegName
    problem: Problem
    trajectory: Trajectory
    certificate: Certificate
    payload: float
    work: float
    hydraulic: float
    pump: float
    engine: float

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.trajectory.duration


@dataclass(frozen=True, eq=False)
class Digging:
    """How the ground changes during a cut.

    Attributes
    ----------
    time: (K,) moments within the cut [s].
    edge: (K, 3) the middle of the cutting edge at these moments [m], world.
    across: (3,) unit vector along the edge, world.
    width: width of the edge [m].
    bank: (K,) undisturbed soil dug up to each moment, as it lay in the ground [m^3].
    loose: (K,) loose soil taken up to each moment [m^3].
    """

    time: Vector
    edge: Matrix
    across: Vector
    width: float
    bank: Vector
    loose: Vector


@dataclass(frozen=True, eq=False)
class Load:
    """The load of the bucket during the cut, by the position of the teeth.

    Attributes
    ----------
    swing: angle of the arm's plane [rad].
    r: (M,) distances of the teeth from the swing axis, not increasing [m].
    mass: (M,) mass in the bucket at these distances [kg].
    """

    swing: float
    r: Vector
    mass: Vector


@dataclass(frozen=True, eq=False)
class Cycle:
    """One cycle, from above the cut to the empty bucket.

    Attributes
    ----------
    number: number of the cycle, from 1.
    legs: approach, cut, swing, dump.
    digging: how the ground changes during the cut.
    load: the load of the bucket during the cut.
    before: the ground at the beginning of the cycle.
    dug: the ground after the cut.
    after: the ground after the dump, the heap on it.
    bank: undisturbed soil that left the ground, as it lay there [m^3].
    taken: loose soil that was taken up with it [m^3].
    held: loose soil in the bucket when it is lifted [m^3]: bank times swell plus taken, minus what is spilt.
    spilt: loose soil that falls back beside the cut [m^3].
    place: (3,) where the soil is dumped: the top of what is there afterwards [m], world.
    truck: number of the truck, from 1; 0 for a heap.
    truck_load: the load of the truck after the dump, in the axes of its bed: floor at z = 0, its middle the origin;
        None for a heap.
    step: the part of the pattern that the cycle belongs to, in words: ``layer 2``.
    filled: part of the bucket's capacity that is filled.
    depth: greatest depth of the edge along the cut, below the ground before it at the same place [m].
    """

    number: int
    legs: tuple[CycleLeg, ...]
    digging: Digging
    load: Load
    before: Terrain
    dug: Terrain
    after: Terrain
    bank: float
    taken: float
    held: float
    spilt: float
    place: Vector
    truck: int
    truck_load: Terrain | None
    step: str
    filled: float
    depth: float

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return sum(leg.duration for leg in self.legs)

    @property
    def work(self) -> float:
        """Work of the joints [J]."""
        return sum(leg.work for leg in self.legs)

    @property
    def hydraulic(self) -> float:
        """Energy that the pump delivers [J]; nan for a machine without hydraulics."""
        return sum(leg.hydraulic for leg in self.legs)

    @property
    def verified(self) -> bool:
        """Whether the certificates of all legs hold."""
        return all(leg.certificate.verified for leg in self.legs)

    def leg(self, name: LegName) -> CycleLeg | None:
        """The leg of that name; None if the cycle has none.

        Raises
        ------
        InputError: no leg has such a name.
        """
        if not isinstance(name, str) or name not in get_args(LegName):
            raise InputError.unknown_name("is no leg", name, names=get_args(LegName), key="name")
        return next((leg for leg in self.legs if leg.name == name), None)
