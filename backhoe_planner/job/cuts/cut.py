"""A cut that can be dug, or why there is none; and the ground and the load along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.job.cuts.bucket import Bucket
from backhoe_planner.job.cuts.profile import Profile
from backhoe_planner.machine import GRAVITY
from backhoe_planner.site import GroundContact


@dataclass(frozen=True, eq=False)
class CutGround:
    """The ground along one cut: local depth and slope, and what the bucket has taken so far.

    The edge moves inward all the while, so that what the bucket holds follows from where the edge is.

    Attributes
    ----------
    profile: of the ground before the cut.
    axis: (2,) x, y of the swing axis [m], world; outward: (2,) unit vector of the plane, world.
    r: (M,) radii of the edge, not increasing [m]; mass: (M,) held there [kg].
    bucket: which holds it.
    beside: (K,) mean depth of what the ends of the blade take beside the profile [m], at its radii; None for nothing.
    """

    profile: Profile
    axis: Vector
    outward: Vector
    r: Vector
    mass: Vector
    bucket: Bucket
    beside: Vector | None = None

    @property
    def held_at(self) -> Vector | None:
        """(3,) centre of what the bucket holds, in the frame of the last joint [m]."""
        return self.bucket.held_at

    def contact(self, tip_position: Array) -> GroundContact:
        """How teeth at (..., 3) [m], world, stand in the ground.

        What is held bears on the soil that enters, spread over the bucket's mouth.
        """
        tip = np.asarray(tip_position, dtype=float)
        r = (tip[..., :2] - self.axis) @ self.outward
        held = np.interp(r, self.r[::-1], self.mass[::-1])
        depth = self.profile.depth(r, tip[..., 2])
        if self.beside is not None:
            more = np.interp(r, self.profile.r, self.beside)
            depth = np.where(more > 0.0, np.maximum(depth, 0.0) + more, depth)
        return GroundContact(
            depth=depth,
            gradient=np.interp(r, self.profile.r, self.profile.slope)[..., None] * self.outward,
            surcharge=GRAVITY * held / (self.bucket.width * self.bucket.mouth),
            held=held,
        )


@dataclass(frozen=True)
class Holding:
    """How much of what a joint's cylinders can hold a cut asks for, where it asks most.

    Attributes
    ----------
    cylinder: its name, or those of all of the joint; the joint's where it has none.
    ratio: needed over available.
    needed, available: torque of the joint [N m], or force [N] where it slides.
    r, z: where the edge is then [m].
    """

    cylinder: str
    ratio: float
    needed: float
    available: float
    r: float
    z: float

    def describe(self) -> str:
        """In words."""
        figures = f"{self.needed / 1e3:.3g} of {self.available / 1e3:.3g} kN m ({100.0 * self.ratio:.0f} %)"
        return f"{self.cylinder}: {figures} with the teeth at r {self.r:.2f}, z {self.z:.2f} m"


@dataclass(frozen=True, eq=False)
class Cut:
    """A cut: where the edge goes, the joints, and what the bucket takes.

    Attributes
    ----------
    swing: angle of the arm's plane [rad]; 0 where nothing swings.
    r, z, pitch: (K,) of the edge [m, m, rad], from above the ground to above the ground.
    q: (K, n) joints.
    position: (K, 3) of the edge's middle [m], world; across: (3,) unit vector along the edge.
    bank, loose: (K,) soil taken so far, undisturbed and loose [m^3].
    depth: (K,) of the edge in the ground as it was [m].
    begin: indices at which penetration, drag, curl and lift begin.
    held: (K,) mass in the bucket [kg].
    torque: (K, n) that hold the machine and drive it against the soil [N m]; inertia left out.
    holding: which cylinder is used most.
    back: the least height of the bucket's back above the ground and the fresh cut [m].
    wanted: of loose soil in the bucket [m^3].
    swell: volume of loose soil over that of the bank.
    ground: for `Drive` and `Problem`.
    bucket: which digs.
    time, work: estimates of the duration [s] and of the work against gravity and soil [J].
    """

    swing: float
    r: Vector
    z: Vector
    pitch: Vector
    q: Matrix
    position: Matrix
    across: Vector
    bank: Vector
    loose: Vector
    depth: Vector
    begin: tuple[int, int, int, int]
    held: Vector
    torque: Matrix
    holding: Holding
    back: float
    wanted: float
    swell: float
    ground: CutGround
    bucket: Bucket
    time: float
    work: float

    @property
    def bank_volume(self) -> float:
        """Undisturbed soil that it takes [m^3]."""
        return float(self.bank[-1])

    @property
    def loose_volume(self) -> float:
        """Loose soil in the bucket after it [m^3]: swollen bank, and what was loose."""
        return float(self.bank[-1] * self.swell + self.loose[-1])

    @property
    def fill(self) -> float:
        """Loose soil in the bucket over what was wanted."""
        return self.loose_volume / self.wanted

    @property
    def is_full(self) -> bool:
        """Whether the bucket holds what was wanted, to 1 %."""
        return self.fill > 0.99

    @property
    def greatest_depth(self) -> float:
        """[m]"""
        return float(np.max(self.depth))


@dataclass(frozen=True)
class NoCut:
    """Why there is no cut.

    Attributes
    ----------
    kind: ``nothing`` to dig, out of ``reach``, the ``back`` of the bucket presses into the ground, or
        a ``cylinder`` that cannot hold the soil's force.
    reason: in words.
    r, z: where [m]; None where it is nowhere in particular.
    holding: of a ``cylinder``, which and by how much, at the least depth.
    """

    kind: Literal["nothing", "reach", "back", "cylinder"]
    reason: str
    r: float | None = None
    z: float | None = None
    holding: Holding | None = None
