"""Kinks of a cost: what counts only where it is positive, rounded off, and linear in small steps of a curve.

cost = sum_k share_k phi(y_k)        y = value + G x        phi(y) = 0 below 0
                                                            phi(y) = y^2 / (2 w) from 0 to the width w
                                                            phi(y) = y - w / 2 above
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector

_LITTLE = 1e-3  # part of the cost that one kink may change it by unseen; chosen


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

    def near(self, reach: Vector) -> tuple[Kinks, Kinks]:
        """Those below the width that may come to count within `reach` (m,), and those above that may come below.

        What changes the cost by next to nothing is left out. Of the latter G and value are turned round, and value
        counts from the width, so that it is again the positive part that costs.
        """
        most = np.abs(self.G) @ reach
        low, least = self.value < self.width, _LITTLE / self.share
        rises, falls = low & (self.value + most > least), ~low & (self.value - most < self.width - least)
        return (
            Kinks(self.G[rises], self.value[rises], self.share[rises], self.width),
            Kinks(-self.G[falls], self.width - self.value[falls], self.share[falls], self.width),
        )


def rounded(parts: Array, width: float) -> Array:
    """What counts of `parts`, with kinks rounded off."""
    positive = np.maximum(parts, 0.0)
    return np.asarray(np.where(positive < width, positive * positive / (2.0 * width), positive - 0.5 * width))
