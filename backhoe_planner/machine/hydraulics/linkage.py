"""How the length of a cylinder depends on the angle of the joint that it moves.

Everything is in the plane across the joint's axis, with the axis at the origin and
angles positive about it. There are two linkages: a cylinder straight across the joint
(`Triangle`), and one that turns a rocker whose link turns the joint (`FourBar`), such as on a
bucket. Both give the length for an angle and the angles for a length, for arrays of any shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from backhoe_planner.arrays import Array

_Plane = tuple[Array, Array]  # (...) each: vectors in the plane across the axis

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

    Each is (k,) for k cylinders at once (`all_of`), whose angles are (..., k).
    """

    a: float | Array
    b: float | Array
    phi0: float | Array
    offset: float | Array = 0.0

    @classmethod
    def all_of(cls, each: Sequence[Triangle]) -> Triangle:
        """All of k cylinders at once."""
        return cls(*(np.array([getattr(one, field.name) for one in each], dtype=float) for field in fields(cls)))

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
        theta, B, AR, link = self._pins(angle)
        return np.asarray(self.drive.arm(theta) * (_turn(link, B) / _turn(link, AR)))

    def arm_slope(self, angle: Array) -> Array:
        """See `Linkage`; by the product rule, with d(R - A)/dq = dtheta/dq k x (R - A) and dB/dq = k x B."""
        theta, B, AR, link = self._pins(angle)
        over, under = _turn(link, B), _turn(link, AR)
        turned = over / under
        of_link = -AR[1] * turned + B[1], AR[0] * turned - B[0]
        of_over = _turn(of_link, B) - _dot(link, B)
        of_under = _turn(of_link, AR) - turned * _dot(link, AR)
        of_turned = (of_over - turned * of_under) / under
        return np.asarray(self.drive.arm_slope(theta) * turned**2 + self.drive.arm(theta) * of_turned)

    def rocker_angle(self, angle: Array) -> Array:
        """Angle theta of the rocker's pin about A [rad]; nan where the four-bar does not close."""
        return self._rocker_angle(_polar(self.pin, np.asarray(angle) + self.pin_angle))

    def joint_pin(self, angle: Array) -> Array:
        """(..., 2) the pin B [m]."""
        return np.stack(_polar(self.pin, np.asarray(angle) + self.pin_angle), axis=-1)

    def rocker_pin(self, angle: Array) -> Array:
        """(..., 2) the pin R [m]."""
        x, y = _polar(self.rocker, self.rocker_angle(angle))
        return np.stack((x + self.pivot[0], y + self.pivot[1]), axis=-1)

    def angles(self, length: Array) -> Array:
        """See `Linkage`; k = 4."""
        x, y = _polar(self.rocker, self.drive.angles(length))
        x, y = x + self.pivot[0], y + self.pivot[1]
        e = np.hypot(x, y)
        cosine = (self.pin**2 + e**2 - self.link**2) / (2.0 * self.pin * e)
        # a rocker angle from which the link does not reach the pin is not possible
        beyond = np.abs(cosine) > 1.0 + _ROUNDING
        spread = np.arccos(_within(np.where(beyond, np.nan, cosine), -1.0, 1.0))
        towards = np.arctan2(y, x)
        return _wrapped(np.concatenate((towards + spread, towards - spread)) - self.pin_angle)

    def _pins(self, angle: Array) -> tuple[Array, _Plane, _Plane, _Plane]:
        """The rocker's angle theta (...), B, R - A, and the link R - B."""
        B = _polar(self.pin, np.asarray(angle) + self.pin_angle)
        theta = self._rocker_angle(B)
        AR = _polar(self.rocker, theta)
        return theta, B, AR, (AR[0] + self.pivot[0] - B[0], AR[1] + self.pivot[1] - B[1])

    def _rocker_angle(self, B: _Plane) -> Array:
        x, y = B[0] - self.pivot[0], B[1] - self.pivot[1]
        d = np.hypot(x, y)
        cosine = (self.rocker**2 + d**2 - self.link**2) / (2.0 * self.rocker * d)
        return np.asarray(np.arctan2(y, x) + self.side * np.arccos(_within(cosine, -1.0, 1.0)))


def _polar(radius: float, angle: Array) -> _Plane:
    return np.asarray(radius * np.cos(angle)), np.asarray(radius * np.sin(angle))


def _dot(a: _Plane, b: _Plane) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1])


def _turn(a: _Plane, b: _Plane) -> Array:
    """The inner product of a and k x b, a quarter turn of b about the axis."""
    return np.asarray(a[0] * -b[1] + a[1] * b[0])


def _within(values: Array, low: float, high: float) -> Array:
    """Values clipped to [low, high] if only rounding put them outside; nan if they are further outside."""
    beyond = (values < low - _ROUNDING) | (values > high + _ROUNDING)
    return np.where(beyond, np.nan, np.clip(values, low, high))


def _wrapped(angle: Array) -> Array:
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))
