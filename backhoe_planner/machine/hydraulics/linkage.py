"""How the length of a cylinder depends on the angle of the joint that it moves.

Everything is in the plane across the joint's axis, with the axis at the origin and
angles positive about it. There are two linkages: a cylinder straight across the joint
(`Triangle`), and one that turns a rocker whose link turns the joint (`FourBar`), such as on a
bucket. Both give the length for an angle and the angles for a length, for arrays of any shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from backhoe_planner.arrays import Array

_ROUNDING = 1e-9  # a cosine this far beyond 1 is 1 but for rounding; chosen, well above that of some ten operations


class Linkage(Protocol):
    """How a cylinder's length depends on its joint's angle; angles [rad] of any shape."""

    @property
    def length_range(self) -> tuple[float, float]:
        """Shortest and longest possible distance of the pins [m]."""

    def length(self, angle: Array) -> Array:
        """Pin-to-pin length l(q) [m]; nan where the linkage does not close."""

    def arm(self, angle: Array) -> Array:
        """Moment arm r = dl/dq [m/rad]; nan where the linkage does not close."""

    def arm_slope(self, angle: Array) -> Array:
        """dr/dq [m/rad^2]; nan where the linkage does not close."""

    def angles(self, length: Array) -> Array:
        """(k, ...) every angle q in (-pi, pi] that may have this length; nan if there is none."""


@dataclass(frozen=True)
class Triangle:
    """A cylinder straight across the joint.

        l^2 = a^2 + b^2 - 2 a b cos(phi) + h^2,   phi = q + phi0,   dl/dq = a b sin(phi) / l

    Attributes
    ----------
    a: distance of the joint's axis from the fixed pin [m].
    b: distance of the joint's axis from the moving pin [m].
    phi0: angle from the first pin to the second at q = 0 [rad].
    offset: h, distance of the pins along the axis [m].
    """

    a: float
    b: float
    phi0: float
    offset: float = 0.0

    @property
    def length_range(self) -> tuple[float, float]:
        """See `Linkage`; reached at the dead centres phi = 0 and pi."""
        return float(np.hypot(self.a - self.b, self.offset)), float(np.hypot(self.a + self.b, self.offset))

    def length(self, angle: Array) -> Array:
        """See `Linkage`."""
        # (a - b)^2 + 4 a b sin^2(phi / 2): the same, without cancellation near the dead centre
        half = np.sin(0.5 * (angle + self.phi0))
        return np.asarray(np.sqrt((self.a - self.b) ** 2 + self.offset**2 + 4.0 * self.a * self.b * half * half))

    def arm(self, angle: Array) -> Array:
        """See `Linkage`."""
        return np.asarray(self.a * self.b * np.sin(angle + self.phi0) / self.length(angle))

    def arm_slope(self, angle: Array) -> Array:
        """See `Linkage`; from l r = a b sin(phi)."""
        arm = self.arm(angle)
        return np.asarray((self.a * self.b * np.cos(angle + self.phi0) - arm * arm) / self.length(angle))

    def angles(self, length: Array) -> Array:
        """See `Linkage`; k = 2."""
        squared = (length**2 - self.offset**2 - (self.a - self.b) ** 2) / (4.0 * self.a * self.b)
        phi = 2.0 * np.arcsin(np.sqrt(_within(squared, 0.0, 1.0)))
        return _wrapped(np.stack((phi, -phi)) - self.phi0)


@dataclass(frozen=True)
class FourBar:
    """A cylinder that turns a rocker, whose link turns the joint.

    The joint's axis O and the rocker's pivot A are fixed. The link, of length L, runs
    from the rocker's pin R, at distance r from A, to the pin B of the moved body, at
    distance b from O. With d = |AB|, the rocker's angle is

        theta = angle(AB) + s arccos((r^2 + d^2 - L^2) / (2 r d)),

    where s is the side of the line AB on which R is, and its derivative is (Freudenstein)

        dtheta/dq = (R - B) . (k x B) / ((R - B) . (k x (R - A))).

    Attributes
    ----------
    pivot: A (2,) [m].
    rocker: r [m]. link: L [m].
    pin: b [m]. pin_angle: angle of B at q = 0 [rad].
    side: s, 1 or -1.
    drive: the triangle of cylinder and rocker about A; its angle is theta.
    """

    pivot: tuple[float, float]
    rocker: float
    link: float
    pin: float
    pin_angle: float
    side: float
    drive: Triangle

    @property
    def length_range(self) -> tuple[float, float]:
        """See `Linkage`; it is the range that the rocker allows."""
        return self.drive.length_range

    def length(self, angle: Array) -> Array:
        """See `Linkage`."""
        return self.drive.length(self.rocker_angle(angle))

    def arm(self, angle: Array) -> Array:
        """See `Linkage`."""
        theta, B, AR = self._pins(angle)
        link = AR + self._pivot - B
        turned = _dot(link, _crossed(B)) / _dot(link, _crossed(AR))
        return np.asarray(self.drive.arm(theta) * turned)

    def arm_slope(self, angle: Array) -> Array:
        """See `Linkage`; by the product rule, with d(R - A)/dq = dtheta/dq k x (R - A) and dB/dq = k x B."""
        theta, B, AR = self._pins(angle)
        link, of_B, of_AR = AR + self._pivot - B, _crossed(B), _crossed(AR)
        over, under = _dot(link, of_B), _dot(link, of_AR)
        turned = over / under
        of_link = of_AR * turned[..., None] - of_B
        of_over = _dot(of_link, of_B) - _dot(link, B)
        of_under = _dot(of_link, of_AR) - turned * _dot(link, AR)
        of_turned = (of_over - turned * of_under) / under
        return np.asarray(self.drive.arm_slope(theta) * turned**2 + self.drive.arm(theta) * of_turned)

    def rocker_angle(self, angle: Array) -> Array:
        """Angle theta of the rocker's pin about A [rad]; nan where the four-bar does not close."""
        AB = self._pin(np.asarray(angle)) - self._pivot
        d = np.hypot(AB[..., 0], AB[..., 1])
        cosine = (self.rocker**2 + d**2 - self.link**2) / (2.0 * self.rocker * d)
        return np.asarray(np.arctan2(AB[..., 1], AB[..., 0]) + self.side * np.arccos(_within(cosine, -1.0, 1.0)))

    def joint_pin(self, angle: Array) -> Array:
        """(..., 2) the pin B [m]."""
        return self._pin(np.asarray(angle))

    def rocker_pin(self, angle: Array) -> Array:
        """(..., 2) the pin R [m]."""
        return np.asarray(_polar(self.rocker, self.rocker_angle(angle)) + self._pivot)

    def angles(self, length: Array) -> Array:
        """See `Linkage`; k = 4."""
        R = _polar(self.rocker, self.drive.angles(length)) + self._pivot
        e = np.hypot(R[..., 0], R[..., 1])
        cosine = (self.pin**2 + e**2 - self.link**2) / (2.0 * self.pin * e)
        # a rocker angle from which the link does not reach the pin is not possible
        beyond = np.abs(cosine) > 1.0 + _ROUNDING
        spread = np.arccos(_within(np.where(beyond, np.nan, cosine), -1.0, 1.0))
        towards = np.arctan2(R[..., 1], R[..., 0])
        return _wrapped(np.concatenate((towards + spread, towards - spread)) - self.pin_angle)

    def _pins(self, angle: Array) -> tuple[Array, Array, Array]:
        """The rocker's angle theta (...), B (..., 2), and R - A (..., 2)."""
        angle = np.asarray(angle)
        theta = self.rocker_angle(angle)
        return theta, self._pin(angle), _polar(self.rocker, theta)

    @property
    def _pivot(self) -> Array:
        return np.asarray(self.pivot, dtype=float)

    def _pin(self, angle: Array) -> Array:
        return _polar(self.pin, angle + self.pin_angle)


def _polar(radius: float, angle: Array) -> Array:
    return np.asarray(radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1))


def _crossed(vectors: Array) -> Array:
    """The product k x vector: a quarter turn about the axis."""
    return np.stack((-vectors[..., 1], vectors[..., 0]), axis=-1)


def _within(values: Array, low: float, high: float) -> Array:
    """Values clipped to [low, high] if only rounding put them outside; nan if they are further outside."""
    beyond = (values < low - _ROUNDING) | (values > high + _ROUNDING)
    return np.where(beyond, np.nan, np.clip(values, low, high))


def _wrapped(angle: Array) -> Array:
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))
