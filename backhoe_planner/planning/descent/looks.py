"""Where along a curve its clearances are looked at: at equal steps, and between them where a link got in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backhoe_planner.motion import Keep
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.linear_model import Margin, find_margins
from backhoe_planner.site import ClearanceScreen, Proximity

_FINER = 16  # times more places than equal steps, a power of two
_APART = 0.04  # m between two places of the point that moves most, at which a link is noticed; chosen
_NEAR = 0.08  # m: margins above are not linearised, however far a step moves a link; chosen, 0.25 takes twice as long
_FAR, _MUCH = 0.4, 0.01
KEPT_PART = 0.5  # of the spare, which is kept between equal steps


class Looks:
    """The places at which one descent looks; what is noticed between equal steps is looked at from then on.

    Parameters
    ----------
    keep: what is to be kept beside the clearances.
    steps: equal ones over the curve.
    spare: to be kept beyond every clearance at the places [m]; half of it between them.
    time: the obstacles stand where they are at this time [s].

    Attributes
    ----------
    places: how many equally spaced places are told apart, which `Margin.place` counts.
    """

    def __init__(
        self, proximity: Proximity, screen: ClearanceScreen, keep: Keep | None, *, steps: int, spare: float, time: float
    ) -> None:
        self._proximity, self._screen, self._keep = proximity, screen, keep
        self._spare, self._time = spare, time
        self.allowed = KEPT_PART * spare
        self.places = _FINER * steps + 1
        self._s = np.linspace(0.0, 1.0, self.places)
        self._reach = np.full(self.places, _NEAR)
        self.looked_at = np.arange(0, self.places, _FINER)

    def find_margins(self, curve: JointCurve) -> tuple[float, list[Margin]]:
        """The least margin of a curve, infinite where nothing is near, and all that are small."""
        least, margins = self._margins_at(curve, self.looked_at)
        noticed = self._notice(curve)
        if len(noticed):
            self.looked_at = np.union1d(self.looked_at, noticed)
            less, more = self._margins_at(curve, noticed)
            least, margins = min(least, less), margins + more
        return least, margins

    def widen(self, margins: list[Margin]) -> bool:
        """Look further from now on where a curve has missed its clearances by much; whether any place is new."""
        before = int(np.count_nonzero(self._reach > _NEAR))
        for found in margins:
            if found.margin.min() < -_MUCH:
                self._reach[found.place] = _FAR
        return int(np.count_nonzero(self._reach > _NEAR)) > before

    def _margins_at(self, curve: JointCurve, index: np.ndarray) -> tuple[float, list[Margin]]:
        least, margins = find_margins(
            self._proximity, self._keep, curve(self._s[index]), spare=self._spare, reach=self._reach[index], time=self._time
        )
        return least, [replace(found, place=int(index[found.place])) for found in margins]

    def _notice(self, curve: JointCurve) -> np.ndarray:
        """Places that are not clear, one between each two that are and at which it is looked."""
        q = curve(self._s)
        self._proximity.cover_unchecked(q)
        at = self.looked_at
        travel = np.abs(np.diff(q, axis=0)) @ self._travel()
        noticed = []
        along = np.concatenate(([0.0], np.cumsum(travel)))
        for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
            if b == a + 1:
                continue
            looks = min(int((along[b] - along[a]) / _APART), b - a - 1)
            for part in range(1, looks + 1):
                place = a + (part * (b - a)) // (looks + 1)
                if a < place < b and not self._screen.keeps_unchecked(q[place]):
                    noticed.append(place)
                    break
        return np.array(noticed, dtype=np.intp)

    def _travel(self) -> np.ndarray:
        return np.asarray(self._proximity.travel.max(axis=0)) if len(self._proximity.travel) else np.zeros(self._proximity.robot.n)
