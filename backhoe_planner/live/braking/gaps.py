"""The gaps between the corners of the machine's links and the planes of its pairs, and room for them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix


class Memory:
    """Room for the arrays of `Separation.gaps`, which are written anew in every step and change their size."""

    def __init__(self) -> None:
        self._columns, self._gaps = np.zeros(0), np.zeros(0)

    def arrays(self, pairs: int, samples: int, corners: int) -> tuple[Array, Array]:
        """Room for the corners (pairs, 4, corners) and their gaps (pairs, samples, corners); what it held is lost."""
        if 4 * pairs * corners > len(self._columns):
            self._columns = np.zeros(8 * pairs * corners)
        if pairs * samples * corners > len(self._gaps):
            self._gaps = np.zeros(2 * pairs * samples * corners)
        columns, gaps = self._columns[: 4 * pairs * corners], self._gaps[: pairs * samples * corners]
        return columns.reshape(pairs, 4, corners), gaps.reshape(pairs, samples, corners)


class Gaps(NamedTuple):
    """The gaps between the corners of K pairs' links and their planes, at S samples.

    Attributes
    ----------
    all: (K, S, V) of every corner [m].
    nearest, least: (K, S) which corner has the least gap, and that gap [m].
    columns: (K, 4, V) the corners in the frames of their links [m], with a 1 below each.
    """

    all: Array
    nearest: Indices
    least: Matrix
    columns: Array

    def put(self, rows: Indices, others: Gaps) -> None:
        """Take over those of other pairs' gaps as `rows` (K,)."""
        for own, other in zip(self, others, strict=True):
            own[rows] = other


NO_GAPS = Gaps(np.zeros((0, 1, 1)), np.zeros((0, 1), dtype=np.intp), np.zeros((0, 1)), np.zeros((0, 4, 1)))
