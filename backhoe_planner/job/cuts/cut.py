"""A cut that can be dug, or why there is none; and the ground and the load along a cut."""

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
    """The ground along one cut: local depth and slope, and the contents of the bucket so far.

    The edge only moves inward, so that the contents of the bucket follow from the position of the edge.

    Attributes
    ----------
    profile: the ground before the cut.
    axis: (2,) x, y of the swing axis [m], world; outward: (2,) unit vector of the plane, world.
    r: (M,) radii of the edge, not increasing [m]; mass: (M,) mass in the bucket there [kg].
    bucket: the bucket that digs.
    beside: (K,) mean depth that the ends of the blade take beside the profile [m], at its radii; None for nothing.
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
        """(3,) centre of the contents of the bucket, in the frame of the last joint [m]."""
        return self.bucket.held_at

    def contact(self, tip_position: Array) -> GroundContact:
        """The contact of teeth at (..., 3) [m], world, with the ground.

        The contents bear on the soil that enters, spread over the bucket's mouth.
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
    """The greatest use of a joint's cylinders along a cut, relative to what they can hold.

    Attributes
    ----------
    cylinder: name of the cylinder, or names of all cylinders of the joint; the joint's name if it has none.
    ratio: needed divided by available.
    needed, available: torque of the joint [N m], or force [N] if it is prismatic.
    r, z: position of the edge there [m].
    """

    cylinder: str
    ratio: float
    needed: float
    available: float
    r: float
    z: float

    def describe(self) -> str:
        """The same in words."""
        figures = f"{self.needed / 1e3:.3g} of {self.available / 1e3:.3g} kN m ({100.0 * self.ratio:.0f} %)"
        return f"{self.cylinder}: {figures} with the teeth at r {self.r:.2f}, z {self.z:.2f} m"


@dataclass(frozen=True, eq=False)
class Cut:
    """A cut: the path of the edge, the joints, and the soil that the bucket takes.

    Attributes
    ----------
    swing: angle of the arm's plane [rad]; 0 if nothing swings.
    r, z, pitch: (K,) path of the edge [m, m, rad], from above the ground to above the ground.
    q: (K, n) joints.
    position: (K, 3) middle of the edge [m], world; across: (3,) unit vector along the edge.
    bank, loose: (K,) soil taken so far, undisturbed and loose [m^3].
    depth: (K,) depth of the edge below the original ground [m].
    begin: indices at which penetration, drag, curl and lift begin.
    held: (K,) mass in the bucket [kg].
    torque: (K, n) torques that hold the machine and drive it against the soil [N m]; inertia is left out.
    holding: the cylinder that is used most.
    back: the least height of the bucket's back above the ground and the fresh cut [m].
    wanted: wanted volume of loose soil in the bucket [m^3].
    swell: volume of loose soil divided by that of the bank.
    ground: the ground along the cut, for `Drive` and `Problem`.
    bucket: the bucket that digs.
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
        """Undisturbed soil that the cut takes [m^3]."""
        return float(self.bank[-1])

    @property
    def loose_volume(self) -> float:
        """Loose soil in the bucket after the cut [m^3]: swollen bank, and soil that was loose."""
        return float(self.bank[-1] * self.swell + self.loose[-1])

    @property
    def fill(self) -> float:
        """Loose soil in the bucket divided by the wanted volume."""
        return self.loose_volume / self.wanted

    @property
    def is_full(self) -> bool:
        """Whether the bucket holds the wanted volume, to 1 %."""
        return self.fill > 0.99

    @property
    def greatest_depth(self) -> float:
        """The greatest depth below the original ground [m]."""
        return float(np.max(self.depth))


@dataclass(frozen=True)
class NoCut:
    """Why there is no cut.

    Attributes
    ----------
    kind: ``nothing`` to dig, out of ``reach``, the ``back`` of the bucket presses into the ground, or
        a ``cylinder`` that cannot hold the soil's force.
    reason: the same in words.
    r, z: the place [m]; None if there is no particular one.
    holding: for a ``cylinder``, which one and by how much, at the least depth.
    """

    kind: Literal["nothing", "reach", "back", "cylinder"]
    reason: str
    r: float | None = None
    z: float | None = None
    holding: Holding | None = None
