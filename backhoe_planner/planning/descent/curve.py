"""A curve in joint space from rest to rest: a cubic B-spline over a parameter s from 0 to 1.

The start and the end are double control points, so that dq/ds is 0 at both. A joint stays between the
least and the greatest of its control points. A curve that is run at an even pace has t = T s. Its pieces
may have different lengths in s; in u, from 0 to 1, all are equally long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Trajectory

_DEGREE = 3
_SAMPLES_PER_PIECE = 10  # of a motion to which a curve is fitted; chosen
_PLACES_OF_JERK, _BESIDE = 400, 4  # places at which accelerations are compared, and reach of the jerk's average; chosen
_EVEN = 0.5  # part of the mean density of knots that is added everywhere to that for the jerk; chosen


@dataclass(frozen=True, eq=False)
class JointCurve:
    """A curve from rest to rest.

    Attributes
    ----------
    control: (L + 1, n) control points of a curve of L pieces: the start, L - 1 between, the end [rad or m].
    knots: (L + 1,) the s at which pieces begin and end, from 0 to 1; empty if they are equally long, and u is s.
    """

    control: Matrix
    knots: tuple[float, ...] = ()

    @property
    def pieces(self) -> int:
        """The number of its polynomials."""
        return len(self.control) - 1

    def __call__(self, s: Vector, derivative: int = 0) -> Matrix:
        """(K, n) the joints at s (K,), or a derivative with respect to s."""
        u = np.interp(s, self.knots, np.linspace(0.0, 1.0, len(self.knots))) if self.knots else s
        return self.at(u, derivative)

    def at(self, u: Vector, derivative: int = 0) -> Matrix:
        """(K, n) the joints at u (K,), or a derivative with respect to s."""
        return _read(self._coefficients, u, derivative, self.knots)

    def weights(self, places: int, derivative: int = 0) -> Matrix:
        """(places, L + 1) weights of the control points at equally spaced u, or their derivatives by s."""
        return basis(self.pieces, places, derivative, self.knots)

    def support(self, places: int) -> tuple[Indices, Array]:
        """The control points that act at equally spaced u, and their weights, see the function `support`."""
        return support(self.pieces, places, self.knots)

    def shares(self, places: int) -> Vector:
        """(places,) weights of a sum over equally spaced u that approximates an integral over s (trapezium rule)."""
        return _shares(places, self.knots)

    def moved_to(self, control: Matrix) -> JointCurve:
        """The curve with the same pieces and other control points (L + 1, n)."""
        return JointCurve(control, self.knots)

    @cached_property
    def _coefficients(self) -> Array:
        """(L, 4, n), see `_read`."""
        doubled = np.vstack((self.control[:1], self.control, self.control[-1:]))
        polynomials = _polynomials(self.pieces, self.knots)
        return np.asarray(polynomials @ doubled[np.arange(self.pieces)[:, None] + np.arange(_DEGREE + 1)])

    @classmethod
    def straight(cls, start: Vector, end: Vector, pieces: int) -> JointCurve:
        """The straight line from `start` to `end` (n,)."""
        return cls.straight_to_each(start, end[None, :], pieces)[0]

    @classmethod
    def straight_to_each(cls, start: Vector, ends: Matrix, pieces: int) -> list[JointCurve]:
        """The straight lines from `start` (n,) to each of `ends` (C, n)."""
        part = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        return [cls(control) for control in start + from_rest_to_rest(part) * (ends - start)[:, None, :]]

    def finer(self, pieces: int, unit: Vector) -> JointCurve:
        """The same curve with at least `pieces` pieces, shorter where accelerations change more.

        Each piece is divided into equal ones, so that the curve does not change.

        Parameters
        ----------
        unit: (n,) rad or m of each joint that count alike.
        """
        s = np.linspace(0.0, 1.0, _PLACES_OF_JERK + 1)
        jerk = np.abs(np.diff(self(s, 2) / unit, axis=0)).sum(axis=1)
        beside = np.pad(jerk, _BESIDE, mode="edge")
        jerk = np.convolve(beside, np.full(2 * _BESIDE + 1, 1.0 / (2 * _BESIDE + 1)), "valid")
        density = np.sqrt(jerk)
        density += _EVEN * (density.mean() or 1.0)
        counted = np.concatenate(([0.0], np.cumsum(density)))
        knots = _place(np.linspace(0.0, 1.0, self.pieces + 1), self.knots)
        each, parts = np.diff(np.interp(knots, s, counted)), np.ones(self.pieces, dtype=int)
        while parts.sum() < pieces:
            parts[np.argmax(each / parts)] += 1
        divided = [
            np.linspace(a, b, count, endpoint=False)
            for a, b, count in zip(knots[:-1], knots[1:], parts.tolist(), strict=True)
        ]
        finer = tuple(np.append(np.concatenate(divided), 1.0).tolist())
        q = self(_place(np.linspace(0.0, 1.0, _SAMPLES_PER_PIECE * (len(finer) - 1) + 1), finer))
        return JointCurve(_control_near(q, len(finer) - 1, finer), finer)

    def divided_evenly(self, pieces: int, limits: JointLimits) -> JointCurve:
        """The nearest curve of so many pieces, equally long, within joint limits: the same if each is a part of one."""
        q = self(np.linspace(0.0, 1.0, _SAMPLES_PER_PIECE * max(pieces, self.pieces) + 1))
        return JointCurve(_within(limits, _control_near(q, pieces, ())))

    def ending_at(self, end: Vector) -> JointCurve:
        """The curve with its end moved to `end` (n,), and the rest moved with it, less and less towards the start."""
        part = np.linspace(0.0, 1.0, len(self.control))[:, None]
        return self.moved_to(self.control + from_rest_to_rest(part) * (end - self.control[-1]))

    def moved_aside(self, aside: Vector, skew: Vector, limits: JointLimits) -> JointCurve:
        """The curve between the same ends with its control points moved aside, within joint limits.

        Parameters
        ----------
        aside: (n,) by how much each joint is moved where it is moved most [rad or m].
        skew: (n,) powers of u, above 0: a joint is moved most at u = 0.5^(1 / skew).
        """
        u = np.linspace(0.0, 1.0, len(self.control))[1:-1, None]
        moved = self.control.copy()
        moved[1:-1] = np.clip(moved[1:-1] + aside * np.sin(np.pi * u**skew), limits.lower, limits.upper)
        return self.moved_to(moved)

    @classmethod
    def fitted(cls, motion: Trajectory, pieces: int, limits: JointLimits) -> JointCurve:
        """The curve within joint limits that is nearest to a motion over its time, with the same ends."""
        s = np.linspace(0.0, 1.0, _SAMPLES_PER_PIECE * pieces + 1)
        return cls(_within(limits, _control_near(motion.at(motion.duration * s), pieces, ())))

    @classmethod
    def through(cls, s: Vector, q: Matrix, pieces: int, limits: JointLimits) -> JointCurve:
        """The curve within joint limits that is nearest to straight lines between q (K, n) at s (K,), 0 to 1."""
        at = np.linspace(0.0, 1.0, _SAMPLES_PER_PIECE * pieces + 1)
        lines = np.column_stack([np.interp(at, s, column) for column in q.T])
        return cls(_within(limits, _control_near(lines, pieces, ())))


def divided_evenly(control: Array, pieces: int, limits: JointLimits) -> Array:
    """(B, pieces + 1, n) control points as of `JointCurve.divided_evenly`, of B curves (B, L + 1, n) of even pieces."""
    count, before, n = len(control), control.shape[1] - 1, control.shape[2]
    q = basis(before, _SAMPLES_PER_PIECE * max(pieces, before) + 1, 0) @ control
    found = _control_near(q.transpose(1, 0, 2).reshape(-1, count * n), pieces, ()).reshape(-1, count, n)
    return np.ascontiguousarray(_within(limits, found).transpose(1, 0, 2))


def from_rest_to_rest(part: Array) -> Array:
    """The part of the distance that is covered at a part of the time, 0 to 1."""
    return np.asarray(part * part * (3.0 - 2.0 * part))


def moment_changes(acting: Indices, weights: Array, slopes: Matrix, n: int) -> Array:
    """(R, k, n) derivatives, by the k control points `acting` (R, k), of R values with `slopes` (R, 3 n) by q, v, a.

    Parameters
    ----------
    weights: (3, R, k) of these control points in q, v and a.
    """
    found = weights[0][:, :, None] * slopes[:, None, :n]
    found += weights[1][:, :, None] * slopes[:, None, n : 2 * n]
    found += weights[2][:, :, None] * slopes[:, None, 2 * n :]
    return np.asarray(found)


def spread(acting: Indices, changes: Array, moving: slice, pieces: int, *, more: int = 0) -> Matrix:
    """(R, m + more) the same by all control points that are `moving`, one after the other, from `changes` (R, k, n).

    Then `more` columns of zeros, for other variables.
    """
    count, _, n = changes.shape
    of_all = (pieces + 1) * n
    found = np.zeros((count, of_all + more))
    found[:, :of_all].reshape(count, pieces + 1, n)[np.arange(count)[:, None], acting] = changes
    first, last = (n * point for point in moving.indices(pieces + 1)[:2])
    found[:, last : last + more] = 0.0
    return found[:, first : last + more]


def _control_near(q: Matrix, pieces: int, knots: tuple[float, ...]) -> Matrix:
    """(pieces + 1, n) control points of the curve nearest to q (K, n) at equally spaced u, with the same ends."""
    weights = basis(pieces, len(q), 0, knots)
    control = np.zeros((pieces + 1, q.shape[1]))
    control[0], control[-1] = q[0], q[-1]
    control[1:-1] = np.linalg.lstsq(weights[:, 1:-1], q - weights @ control, rcond=None)[0]
    return control


def _within(limits: JointLimits, control: Array) -> Array:
    """(pieces + 1, ..., n) control points, those between the ends moved into the limits."""
    control[1:-1] = np.clip(control[1:-1], limits.lower, limits.upper)
    return control


@lru_cache(maxsize=64)
def basis(pieces: int, places: int, derivative: int, knots: tuple[float, ...] = ()) -> Matrix:
    """(places, pieces + 1) weights of the control points at equally spaced u, or their derivatives by s."""
    each = _read(_polynomials(pieces, knots), np.linspace(0.0, 1.0, places), derivative, knots)
    first = _piece_of(np.linspace(0.0, 1.0, places), pieces)
    weights = np.zeros((places, pieces + _DEGREE))
    np.put_along_axis(weights, first[:, None] + np.arange(_DEGREE + 1), each, axis=1)
    found = weights[:, 1:-1].copy()
    found[:, 0] += weights[:, 0]
    found[:, -1] += weights[:, -1]
    found.setflags(write=False)
    return found


@lru_cache(maxsize=64)
def support(pieces: int, places: int, knots: tuple[float, ...] = ()) -> tuple[Indices, Array]:
    """(places, k) the k control points that act at equally spaced u, at most four, and (3, places, k) their weights.

    The weights are those of `basis`, then their first and second derivatives by s.
    """
    dense = np.array([basis(pieces, places, derivative, knots) for derivative in range(3)])
    count = min(_DEGREE + 1, pieces + 1)
    first = np.clip(_piece_of(np.linspace(0.0, 1.0, places), pieces) - 1, 0, pieces + 1 - count)
    acting = first[:, None] + np.arange(count)
    weights = dense[:, np.arange(places)[:, None], acting]
    acting.setflags(write=False)
    weights.setflags(write=False)
    return acting, weights


@lru_cache(maxsize=64)
def _shares(places: int, knots: tuple[float, ...]) -> Vector:
    """(places,) see `JointCurve.shares`."""
    steps = np.diff(_place(np.linspace(0.0, 1.0, places), knots))
    found = np.asarray(0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)))
    found.setflags(write=False)
    return found


def _place(u: Vector, knots: tuple[float, ...]) -> Vector:
    """(K,) s at u (K,)."""
    return np.asarray(np.interp(u, np.linspace(0.0, 1.0, len(knots)), knots)) if knots else u


def _piece_of(u: Vector, pieces: int) -> NDArray[np.intp]:
    """(K,) the number of the piece that contains each u (K,)."""
    return np.minimum(np.maximum((u * pieces).astype(np.intp), 0), pieces - 1)


def _read(coefficients: Array, u: Vector, derivative: int, knots: tuple[float, ...]) -> Matrix:
    """(K, m) a piecewise polynomial at u (K,), or its derivative with respect to s.

    Parameters
    ----------
    coefficients: (L, 4, m) of each piece, of the powers of x = L (s - the knot where it begins), the lowest first.
    """
    pieces = len(coefficients)
    piece = _piece_of(u, pieces)
    part = u * pieces - piece
    x = (part * (pieces * np.diff(knots))[piece] if knots else part)[:, None]
    own = coefficients[piece]
    if derivative:
        own = own * np.array([math.perm(power, derivative) for power in range(_DEGREE + 1)])[:, None]
    found = own[:, _DEGREE]
    for power in range(_DEGREE - 1, derivative - 1, -1):
        found = found * x + own[:, power]
    return found * float(pieces) ** derivative if derivative else found


@lru_cache(maxsize=64)
def _polynomials(pieces: int, inner: tuple[float, ...]) -> Array:
    """(L, 4, 4) every piece of a cubic B-spline: powers of x by the four control points that act on it.

    The recursion of Cox and de Boor over the knots 0, 0, 0, 0, 1, 2, ..., L, L, L, L, or over L times those of `inner`
    with the ends repeated as often, for all pieces at once.
    """
    knots = np.clip(np.arange(-_DEGREE, pieces + _DEGREE + 1), 0, pieces).astype(float)
    if inner:
        knots[_DEGREE : _DEGREE + pieces + 1] = pieces * np.array(inner)
    left = knots[_DEGREE : _DEGREE + pieces].copy()  # knot at which a piece begins
    basis_functions = [np.eye(1, _DEGREE + 1) * np.ones((pieces, 1))]
    for degree in range(1, _DEGREE + 1):
        higher = [np.zeros((pieces, _DEGREE + 1)) for _ in range(degree + 1)]
        for r, lower in enumerate(basis_functions):
            before = knots[_DEGREE + 1 + r - degree + np.arange(pieces)]
            after = knots[_DEGREE + 1 + r + np.arange(pieces)]
            part = lower / (after - before)[:, None]
            times_x = np.roll(part, 1, axis=1)  # the highest power is 0 until the last degree
            higher[r] += (after - left)[:, None] * part - times_x
            higher[r + 1] += (left - before)[:, None] * part + times_x
        basis_functions = higher
    found = np.stack(basis_functions, axis=2)
    found.setflags(write=False)
    return found
