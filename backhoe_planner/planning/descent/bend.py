"""A model of how the cost of a curve changes with its control points: a slope, and a curvature that is learnt.

The curvature begins as that of the squared second derivative of the curve, so that steps bend the curve smoothly
(CHOMP, Zucker et al. 2013), and is updated by every step (BFGS, damped after Powell 1978). If a step shows less
curvature than the model, all of it is reduced (self-scaling, Oren and Luenberger 1974): otherwise a curvature that
was learnt far away would hold back all directions in which no step has gone since.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.planning.descent.curve import basis
from backhoe_planner.planning.descent.kinks import Kinks

_PLACES_PER_PIECE = 3  # at which the second derivative is squared; it is linear on a piece
_EVEN = 0.02  # curvature of a shift of all control points, as a part of that of the sharpest bend; chosen
_BOLD = 6.0  # approximate length of the first step without constraints, in sizes of the box; chosen among 2 to 15
_LEAST_CURVED = 0.2  # part of the modelled curvature that a step must show to be used undamped (Powell 1978)
_LEAST_SCALED = 0.6  # least factor on the curvature if a step shows less; chosen among 0.3 to 1, measured


@dataclass(frozen=True, eq=False)
class Bend:
    """The cost of a small step of the control points that may move, as a part of the cost now.

    Attributes
    ----------
    slope: (m,) with respect to the control points, one after the other [1 per rad or m], and T [1 per s].
    curvature: (m, m) symmetric, positive definite: the learnt part.
    known: (m, m) the part that is known exactly, positive semidefinite; it changes with the curve.
    kinks: of the cost, in addition to both.
    """

    slope: Vector
    curvature: Matrix
    known: Matrix
    kinks: Kinks

    @classmethod
    def smooth(
        cls, slope: Vector, known: Matrix, kinks: Kinks, pieces: int, unit: Vector, box: float, duration: float
    ) -> Bend:
        """The model at the beginning of a descent.

        Parameters
        ----------
        pieces: of the curve.
        unit: (n,) rad or m of each joint that count alike.
        box: how far a step may move a control point, in these units.
        duration: T now [s].
        """
        moving = (len(slope) - 1) // len(unit)
        each = bending(pieces, moving)
        curvature = np.zeros((len(slope), len(slope)))
        curvature[:-1, :-1] = np.kron(each, np.diag(1.0 / unit**2))
        curvature[-1, -1] = _EVEN * moving / duration**2
        length = float(np.sqrt(slope @ np.linalg.solve(curvature, slope)))
        return cls(slope, np.asarray(curvature * (max(length, 1e-9) / (_BOLD * box))), known, kinks)

    @cached_property
    def smooth_curvature(self) -> Matrix:
        """(m, m) without that of the kinks."""
        return self.curvature + self.known

    def after(self, step: Vector, slope: Vector, known: Matrix, kinks: Kinks) -> Bend:
        """The model after a step (m,), with the new slope (m,), known curvature and kinks."""
        along, turned = self.curvature @ step, slope - self.slope - known @ step - self.kinks.turned(step)
        expected, seen = float(step @ along), float(step @ turned)
        if not expected > 0.0:
            return replace(self, slope=slope, known=known, kinks=kinks)
        scale = min(max(seen / expected, _LEAST_SCALED), 1.0)
        along, expected = scale * along, scale * expected
        part = 1.0 if seen >= _LEAST_CURVED * expected else (1.0 - _LEAST_CURVED) * expected / (expected - seen)
        change = part * turned + (1.0 - part) * along
        curvature = (
            scale * self.curvature - np.outer(along, along) / expected + np.outer(change, change) / float(step @ change)
        )
        return Bend(slope, np.asarray(0.5 * (curvature + curvature.T)), known, kinks)

    def stiffer(self, factor: float) -> Bend:
        """The model after a failed step, with `factor` times the curvature, for shorter steps."""
        return replace(self, curvature=factor * self.curvature)


def bending(pieces: int, moving: int) -> Matrix:
    """(moving, moving) curvature of the squared second derivative by the first control points after the start.

    That of the sharpest bend is about 1, and a shift of all control points has a little, too.
    """
    second = basis(pieces, _PLACES_PER_PIECE * pieces + 1, 2)[:, 1 : 1 + moving]
    second = second / np.linalg.norm(second, 2)
    return np.asarray(second.T @ second + _EVEN * np.eye(moving))
