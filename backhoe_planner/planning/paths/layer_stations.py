"""How dense the nodes of a path's graph are, and the arc lengths at which its layers are."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import TURN_LEVER, TipPath
from backhoe_planner.planning.stretches.corners import SHARP

_MANY_LAYERS = 160  # chosen to bound the work: on a path that needs more they are further apart,
_WIDEST_LAYER = 0.25  # m, but at most this: five times the usual
_SAME = 1e-9  # m of path: layers nearer than this are at one place


@dataclass(frozen=True, eq=False)
class Layering:
    """How dense the nodes of the graph are along a path and at each place of it.

    Attributes
    ----------
    spacing: arc length between layers [m].
    grid: step of the free parameter, if there is one [rad; m for a slide].
    joint_steps: (n,) how far a joint may move from waypoint to waypoint [rad or m]; then the layers
        are at waypoints. None if all may move freely.
    """

    spacing: float = 0.05  # chosen
    grid: float = float(np.radians(5.0))  # chosen: refined afterwards
    joint_steps: Vector | None = None

    def stations(self, path: TipPath, since: float) -> Vector:
        """(L,) arc lengths of the layers [m] from `since` to the end."""
        if self.joint_steps is None:
            return layer_stations(path, since, self.spacing)
        return waypoint_stations(path, since, self.spacing)


def layer_stations(path: TipPath, since: float, spacing: float) -> Vector:
    """(L,) arc lengths [m] from `since` to the end, so dense that the tip neither moves nor turns far between them."""
    fine = np.unique(np.concatenate((np.linspace(since, path.length, 201), path.stations[path.stations > since])))
    turns = [path.turn(float(a), float(b)) for a, b in pairwise(fine)]
    measure = np.concatenate(([0.0], np.cumsum(np.diff(fine) + TURN_LEVER * np.array(turns))))
    fewer = max(_MANY_LAYERS, int(np.ceil(measure[-1] / _WIDEST_LAYER)))
    count = min(max(int(np.ceil(measure[-1] / spacing)), 1), fewer)
    found = np.interp(np.linspace(0.0, measure[-1], count + 1), measure, fine)
    found[0], found[-1] = since, path.length
    # a sharp turn gets a layer of its own, in place of one near it
    marks = _sharp_turns(path)
    marks = marks[(marks > since) & (marks < path.length)]
    if len(marks):
        near = 0.5 * (path.length - since) / count
        inner = [s for s in found[1:-1] if np.min(np.abs(marks - s)) > near]
        found = np.unique(np.concatenate((found[[0, -1]], inner, marks)))
    return np.asarray(found)


def waypoint_stations(path: TipPath, since: float, spacing: float) -> Vector:
    """(L,) arc lengths of waypoints [m] from `since` to the end; waypoints near each other are thinned out."""
    marks = np.unique(path.stations[path.stations > since + _SAME])
    kept, must = [since], set(_sharp_turns(path).tolist())
    spacing = max(spacing, (path.length - since) / _MANY_LAYERS)
    for mark in marks[:-1].tolist():
        if mark in must or mark - kept[-1] > spacing - _SAME:
            kept.append(mark)
    return np.array([*kept, marks[-1]])


def _sharp_turns(path: TipPath) -> Vector:
    """(M,) arc lengths at which a turn begins or ends and the joints change their direction sharply [m]."""
    marks = path.stations[path.turned_waypoints]
    return np.asarray(marks[np.isin(marks, path.corners(SHARP))])
