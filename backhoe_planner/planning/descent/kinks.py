"""Kinks of a cost: terms that count only if positive, rounded off, and linear in small steps of a curve.

cost = sum_k share_k phi(y_k)        y = value + G x        phi(y) = 0 below 0
                                                            phi(y) = y^2 / (2 w) from 0 to the width w
                                                            phi(y) = y - w / 2 above
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Matrix, Vector

_SOFT = 0.2  # part of the mean cost per joint and second, by which kinks are rounded off; chosen
LEAST_WIDTH = 1e-9  # in the objective's unit per second, so that a motion that costs nothing has a width too
_LITTLE = 1e-3  # part of the cost by which a kink that is left out may change it; chosen
_CROSSED = 0.2  # part of the width by which a step must pass a kink to cross it; chosen: then a fiftieth of it is lost


@dataclass(frozen=True, eq=False)
class Kinks:
    """The terms of a cost that count only if they are positive, near one curve.

    Attributes
    ----------
    G: (K, m) how they change with a step x of the variables.
    value: (K,) present values, in the cost's unit per second.
    share: (K,) the time for which each counts [s]; divided by the unit of a descent if the cost is.
    width: w, within which they are rounded off.
    """

    G: Matrix
    value: Vector
    share: Vector
    width: float

    @classmethod
    def none(cls, variables: int) -> Kinks:
        """Those of a cost without kinks."""
        return cls(np.zeros((0, variables)), np.zeros(0), np.zeros(0), 1.0)

    @cached_property
    def rising(self) -> Vector:
        """(K,) the derivative of phi at each value, from 0 to 1."""
        return self._rising_at(self.value)

    def _rising_at(self, value: Vector) -> Vector:
        return rising(value, self.width)

    def turned(self, step: Vector) -> Vector:
        """(m,) how the slope of the cost changes with a step (m,)."""
        rising = self._rising_at(self.value + self.G @ step)
        return np.asarray((self.share * (rising - self.rising)) @ self.G)

    def over(self, unit: float) -> Kinks:
        """Those of the cost divided by a unit."""
        return replace(self, share=self.share / unit)

    def near(self, reach: Vector) -> NearKinks:
        """Those below the width that may come to count within `reach` (m,), and those above that may fall below it.

        Those that hardly change the cost are left out.
        """
        most = np.abs(self.G) @ reach
        low, least = self.value < self.width, _LITTLE / self.share
        rises, falls = low & (self.value + most > least), ~low & (self.value - most < self.width - least)
        turned = Kinks(-self.G[falls], self.width - self.value[falls], self.share[falls], self.width)
        return NearKinks.within(self.some(rises), turned)

    def some(self, which: NDArray[np.bool_]) -> Kinks:
        """Those of `which` (K,)."""
        return Kinks(self.G[which], self.value[which], self.share[which], self.width)


@dataclass(frozen=True, eq=False)
class NearKinks:
    """Kinks that one step may reach.

    A program has a variable for each kink that the step crosses. The others count as staying on their present side:
    they add a parabola or nothing. Which ones are crossed follows from the step, so they are found iteratively.

    Attributes
    ----------
    rises: kinks now below the width.
    falls: kinks now above it; the signs of G and value are reversed, and value counts from the width, so that again
        the positive part costs.
    rise_crossed, fall_crossed: (K,) which of them have a variable.
    """

    rises: Kinks
    falls: Kinks
    rise_crossed: NDArray[np.bool_]
    fall_crossed: NDArray[np.bool_]

    @classmethod
    def within(cls, rises: Kinks, falls: Kinks) -> NearKinks:
        """None of them crossed so far."""
        return cls(rises, falls, np.zeros(len(rises.value), dtype=bool), np.zeros(len(falls.value), dtype=bool))

    def variables(self) -> Kinks:
        """Those that have a variable, which is the positive part of value + G x, and costs its square."""
        rises, falls = self.rises.some(self.rise_crossed), self.falls.some(self.fall_crossed)
        return Kinks(
            np.vstack((rises.G, falls.G)), np.concatenate((rises.value, falls.value)),
            np.concatenate((rises.share, falls.share)), self.rises.width,
        )  # fmt: skip

    def slope_of_variables(self) -> Vector:
        """(m,) the part of the cost's slope that comes from those with a variable."""
        rises = self.rises.some(self.rise_crossed)
        return np.asarray((rises.share * rises.rising) @ rises.G)

    def curvature(self) -> Matrix:
        """(m, m) the curvature of those that count now and are not crossed."""
        bent = self.rises.some(~self.rise_crossed & (self.rises.value > 0.0))
        scaled = np.sqrt(bent.share / bent.width)[:, None] * bent.G
        return np.asarray(scaled.T @ scaled)  # BLAS computes half of a product with itself

    def after(self, step: Vector) -> NearKinks:
        """The same with a variable also for those that a step (m,) crosses; itself if there are none."""
        beyond = _CROSSED * self.rises.width
        rises, falls = (kinks.value + kinks.G @ step for kinks in (self.rises, self.falls))
        rise = ~self.rise_crossed & np.where(self.rises.value > 0.0, rises < -beyond, rises > beyond)
        fall = ~self.fall_crossed & (falls > beyond)
        if not rise.any() and not fall.any():
            return self
        return replace(self, rise_crossed=self.rise_crossed | rise, fall_crossed=self.fall_crossed | fall)


def suitable_width(cost: float | Vector, duration: float, joints: int) -> Vector:
    """The width by which the kinks of a cost are rounded off, or (B,) of several costs [unit per second]."""
    return np.maximum(_SOFT * cost / duration / joints, LEAST_WIDTH)


def rising(parts: Array, width: float | Array) -> Array:
    """The derivative of phi at `parts`, from 0 to 1."""
    return np.minimum(np.maximum(parts / width, 0.0), 1.0)


def rounded(parts: Array, width: float | Array) -> Array:
    """The costs phi of `parts`, with kinks rounded off."""
    positive = np.maximum(parts, 0.0)
    return np.asarray(np.where(positive < width, positive * positive / (2.0 * width), positive - 0.5 * width))
