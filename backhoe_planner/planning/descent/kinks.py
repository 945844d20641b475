"""Kinks of a cost: what counts only where it is positive, rounded off, and linear in small steps of a curve.

cost = sum_k share_k phi(y_k)        y = value + G x        phi(y) = 0 below 0
                                                            phi(y) = y^2 / (2 w) from 0 to the width w
                                                            phi(y) = y - w / 2 above
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Matrix, Vector

_LITTLE = 1e-3  # part of the cost that one kink may change it by unseen; chosen
_CROSSED = 0.2  # of the width, by which a step is beyond a kink that it crosses; chosen, a fiftieth of it is then lost


@dataclass(frozen=True, eq=False)
class Kinks:
    """The parts of a cost that only count where they are positive, near one curve.

    Attributes
    ----------
    G: (K, m) how they change with a step x of what may move.
    value: (K,) now, in the cost's unit per second.
    share: (K,) [s] that each counts for; over the unit of a descent where the cost is.
    width: w, within which they are rounded off.
    """

    G: Matrix
    value: Vector
    share: Vector
    width: float

    @classmethod
    def none(cls, variables: int) -> Kinks:
        """Of a cost that has none."""
        return cls(np.zeros((0, variables)), np.zeros(0), np.zeros(0), 1.0)

    def rising(self, step: Vector | None = None) -> Vector:
        """(K,) by how much the cost of each rises with its value, after a step (m,); from 0 to 1."""
        value = self.value if step is None else self.value + self.G @ step
        return np.clip(value / self.width, 0.0, 1.0)

    def turned(self, step: Vector) -> Vector:
        """(m,) how the slope of the cost changes with a step (m,)."""
        return np.asarray((self.share * (self.rising(step) - self.rising())) @ self.G)

    def over(self, unit: float) -> Kinks:
        """Of the cost over a unit."""
        return replace(self, share=self.share / unit)

    def near(self, reach: Vector) -> NearKinks:
        """Those below the width that may come to count within `reach` (m,), and those above that may come below.

        What changes the cost by next to nothing is left out.
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
    """Kinks that one step may get to.

    A program has a variable for each of those that the step crosses. The others are on the side on which they are
    now: they add a parabola or nothing. Which are crossed is seen from the step, and so learnt step by step.

    Attributes
    ----------
    rises: from below the width.
    falls: from above it; G and value are turned round, and value counts from the width, so that it is again the
        positive part that costs.
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

    def all_crossed(self) -> NearKinks:
        """The same with a variable for each."""
        return replace(self, rise_crossed=self.rise_crossed | True, fall_crossed=self.fall_crossed | True)

    def variables(self) -> Kinks:
        """Those that have a variable: it is the positive part of value + G x, and costs its square."""
        rises, falls = self.rises.some(self.rise_crossed), self.falls.some(self.fall_crossed)
        return Kinks(
            np.vstack((rises.G, falls.G)), np.append(rises.value, falls.value), np.append(rises.share, falls.share),
            self.rises.width,
        )  # fmt: skip

    def slope_of_variables(self) -> Vector:
        """(m,) what the slope of the cost has of those with a variable."""
        rises = self.rises.some(self.rise_crossed)
        return np.asarray((rises.share * rises.rising()) @ rises.G)

    def curvature(self) -> Matrix:
        """(m, m) that of those which count now and are not crossed."""
        bent = self.rises.some(~self.rise_crossed & (self.rises.value > 0.0))
        return np.asarray((bent.G.T * (bent.share / bent.width)) @ bent.G)

    def after(self, step: Vector) -> NearKinks:
        """The same with a variable for those that a step (m,) crosses too; itself where there is none."""
        beyond = _CROSSED * self.rises.width
        rises, falls = (kinks.value + kinks.G @ step for kinks in (self.rises, self.falls))
        rise = ~self.rise_crossed & np.where(self.rises.value > 0.0, rises < -beyond, rises > beyond)
        fall = ~self.fall_crossed & (falls > beyond)
        if not rise.any() and not fall.any():
            return self
        return replace(self, rise_crossed=self.rise_crossed | rise, fall_crossed=self.fall_crossed | fall)


def rounded(parts: Array, width: float) -> Array:
    """What counts of `parts`, with kinks rounded off."""
    positive = np.maximum(parts, 0.0)
    return np.asarray(np.where(positive < width, positive * positive / (2.0 * width), positive - 0.5 * width))
