"""The gaps between the corners of the machine's links and the planes of its pairs, and room for them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix


class Memory:
    """Room for the arrays of `Separation.gaps`, which are written anew in every step and change their size."""

    def __init__(self) -> None:
        self._columns, self._gaps = np.zeros(0), np.zeros(0)
        self._shape, self._firsts = (0, 0, 0), np.zeros((0, 0), dtype=np.intp)
        self._pieces = b""  # of the columns that are there, as bytes: two of these are compared at once

    def columns(self, corners: Array, pieces: Indices) -> Array:
        """(K, 4, V) of `corners` (M, 4, V), which never change, those of `pieces` (K,).

        Most steps look at the same pieces as the one before, whose corners are still there.
        """
        most = corners.shape[2]
        size = 4 * len(pieces) * most
        if size > len(self._columns):
            self._columns, self._pieces = np.zeros(2 * size), b""
        columns = self._columns[:size].reshape(len(pieces), 4, most)
        key = pieces.tobytes()
        if key != self._pieces:
            corners.take(pieces, axis=0, out=columns, mode="clip")
            self._pieces = key
        return columns

    def gaps(self, pairs: int, samples: int, corners: int) -> Array:
        """Room for the gaps (pairs, samples, corners); what it held is lost."""
        size = pairs * samples * corners
        if size > len(self._gaps):
            self._gaps = np.zeros(2 * size)
        return self._gaps[:size].reshape(pairs, samples, corners)

    def firsts(self, pairs: int, samples: int, corners: int) -> Indices:
        """(pairs, samples) where each row of the gaps (pairs, samples, corners) begins, to be read only."""
        shape = pairs, samples, corners
        if shape != self._shape:
            self._shape = shape
            self._firsts = np.arange(0, pairs * samples * corners, corners).reshape(pairs, samples)
        return self._firsts


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
