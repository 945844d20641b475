"""Coal's results for many pairs, read at once.

A geometry's data has one result per pair, one after another in memory: the distance, the normal and
both nearest points are ten numbers in a row. Python reads them with separate calls, four for a
pair, and for a dozen pairs that takes longer than measuring them. The normal of a result is
returned as a view of that memory, so that one array over all results shows the same numbers.

The memory layout depends on coal's version. It is determined once, on a few pairs whose numbers are all
different. If it is not as described here, results are read one by one.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine.shape.shapes import CONTACT, measure_pair_again, rows_in_doubt, sphere
from backhoe_planner.native import compiled

_NUMBERS = 10  # of a result: distance, normal, nearest points
_BYTES = 8  # of a number
_DISTANCE, _NORMAL, _FIRST, _SECOND = 0, slice(1, 4), slice(4, 7), slice(7, 10)


class ResultTable:
    """The results of all P pairs of one geometry, to which no further pairs may be added.

    If the memory cannot be read at once, it gives the same numbers more slowly.

    Parameters
    ----------
    model, data: Pinocchio's; their pairs are measured at the placements in `data`.

    Attributes
    ----------
    COLUMNS: how many numbers a result has.
    """

    COLUMNS = _NUMBERS

    def __init__(self, model: pin.GeometryModel, data: pin.GeometryData) -> None:
        self._model, self._data = model, data
        self._numbers = _numbers_of(data)

    def measure(self, pairs: Indices) -> Matrix:
        """(K, 10) the results of measuring `pairs` (K,), world.

        They are the distance, the normal from the first piece to the second (3), and the nearest points of both
        (3, 3) [m].
        """
        model, data, compute = self._model, self._data, pin.computeDistance
        for pair in pairs.tolist():
            compute(model, data, pair)
        found, is_doubtful = self._read(pairs)
        if is_doubtful:
            doubtful = rows_in_doubt(found[:, _DISTANCE])
            for pair in pairs[doubtful].tolist():
                measure_pair_again(model, data, pair)
            found[doubtful] = self._read(pairs[doubtful])[0]
        return found

    def measure_all(self) -> Vector:
        """(P,) the signed distances of all pairs [m]."""
        pin.computeDistances(self._model, self._data)
        if self._numbers is None:
            distances = np.array([result.min_distance for result in self._data.distanceResults])
        else:
            distances = self._numbers[:, _DISTANCE].copy()
        for pair in rows_in_doubt(distances):
            distances[pair] = measure_pair_again(self._model, self._data, pair).min_distance
        return distances

    def _read(self, pairs: Indices) -> tuple[Matrix, bool]:
        """(K, 10) the results of `pairs` (K,), and whether any may be in doubt."""
        if self._numbers is None:
            return _read_each(self._data, pairs), True
        return read_results(self._numbers, pairs, CONTACT)


@compiled
def read_results(numbers: Matrix, pairs: Indices, contact: float, /) -> tuple[Matrix, bool]:
    """(K, 10) a copy of the rows `pairs` (K,) of `numbers` (P, 10), and whether a distance is `contact` or less."""
    found = np.asarray(numbers[pairs])  # `take` would copy all of them first
    return found, len(found) > 0 and not found[found[:, _DISTANCE].argmin(), _DISTANCE] > contact


def _read_each(data: pin.GeometryData, pairs: Indices) -> Matrix:
    """(K, 10) the results of `pairs` (K,), read one by one from the library."""
    found = np.empty((len(pairs), _NUMBERS))
    results = data.distanceResults
    for row, pair in enumerate(pairs.tolist()):
        result = results[pair]
        found[row, _DISTANCE], found[row, _NORMAL] = result.min_distance, result.normal
        found[row, _FIRST], found[row, _SECOND] = result.getNearestPoint1(), result.getNearestPoint2()
    return found


def _numbers_of(data: pin.GeometryData) -> Matrix | None:
    """(P, 10) a view of all results, or None if they cannot be read at once."""
    step = _bytes_of_a_result()
    results = data.distanceResults
    if step is None or len(results) == 0:
        return None
    first, last = results[0].normal, results[len(results) - 1].normal
    if first.flags.owndata or _address(last) - _address(first) != step * (len(results) - 1):
        return None
    return _view(first, len(results), step)


@cache
def _bytes_of_a_result() -> int | None:
    """The distance of two results in memory [bytes]; None if the layout is not as described in this module."""
    model, robot = pin.GeometryModel(), pin.Model()
    for radius, place in ((0.25, (0.1, 0.2, 0.4)), (0.75, (3.0, -1.7, 2.3)), (0.5, (-2.9, 5.1, 1.3))):
        ball = sphere(radius, pin.SE3(np.eye(3), np.array(place)))
        model.addGeometryObject(pin.GeometryObject(f"ball {radius}", 0, 0, ball.placement, ball.shape))
    for first, second in ((0, 1), (1, 2), (0, 2)):
        model.addCollisionPair(pin.CollisionPair(first, second))
    data = model.createData()
    pin.updateGeometryPlacements(robot, robot.createData(), model, data, np.zeros(0))
    pin.computeDistances(model, data)
    normals = [result.normal for result in data.distanceResults]
    steps = {_address(after) - _address(before) for before, after in pairwise(normals)}
    step = steps.pop()
    if steps or any(normal.flags.owndata or normal.dtype != np.float64 for normal in normals):
        return None
    if step < _NUMBERS * _BYTES or step % _BYTES:
        return None
    # all but the last, so that nothing beyond the results is read before their size is known
    seen, said = _view(normals[0], len(normals) - 1, step), _read_each(data, np.arange(len(normals) - 1))
    return step if np.array_equal(seen, said) else None


def _view(normal: Vector, count: int, step: int) -> Matrix:
    """(count, 10) the numbers of `count` results, `step` bytes apart; the first has this `normal` (3,)."""
    return np.asarray(_Memory(normal, (count, _NUMBERS), (step, _BYTES)))


class _Memory:
    """Memory around an array, by numpy's interface; it keeps alive what the array is a view of."""

    def __init__(self, normal: Vector, shape: tuple[int, int], strides: tuple[int, int]) -> None:
        self._holds = normal
        self.__array_interface__ = {
            "data": (_address(normal) - _BYTES, True),  # the distance is before the normal
            "shape": shape,
            "strides": strides,
            "typestr": "<f8",
            "version": 3,
        }


def _address(array: Vector) -> int:
    return int(array.__array_interface__["data"][0])
