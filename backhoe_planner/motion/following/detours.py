"""The parts of a motion in which the tip leaves its path and returns to it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.motion.following.tip_stations import TipStations
from backhoe_planner.motion.goals import ANGLE_TOLERANCE
from backhoe_planner.motion.path import TipPath
from backhoe_planner.site import Obstruction

_LEAST_SHOWN = 5e-4  # m: less is printed as 0.000 m
_MARKS = 33  # places of the path that a detour leaves out, besides waypoints, measured from the detour; chosen


@dataclass(frozen=True)
class Detour:
    """A part of the motion that leaves the specified path and returns to it.

    Attributes
    ----------
    time_from, time_to: when it begins and ends [s].
    path_from, path_to: where the tip leaves the path and where it rejoins it [m].
    length: distance that the tip moves in between [m].
    max_deviation: largest distance of the tip from the path, or of the left-out part of the path from the tip [m].
    max_angle: largest angle from the required orientation [rad].
    obstruction: what the detour goes around, if a planner knows it; a certificate does not.
    """

    time_from: float
    time_to: float
    path_from: float
    path_to: float
    length: float
    max_deviation: float
    max_angle: float = 0.0
    obstruction: Obstruction | None = None

    @property
    def place(self) -> str:
        """The part of the path, for a sentence: ``from 1.20 m to 1.80 m``, or ``at 1.20 m``."""
        begin, end = f"{self.path_from:.2f} m", f"{self.path_to:.2f} m"
        return f"at {begin}" if begin == end else f"from {begin} to {end}"

    @property
    def size(self) -> str:
        """How far it is off the path, for a sentence: ``by up to 0.120 m``, ``by up to 12.3 deg``."""
        if self.max_deviation >= _LEAST_SHOWN:
            return f"by up to {self.max_deviation:.3f} m"
        if self.max_angle > ANGLE_TOLERANCE:
            return f"by up to {np.degrees(self.max_angle):.1f} deg"
        return f"leaving out {self.path_to - self.path_from:.2f} m of it"


def close_gaps(on: Flags, first: int, last: int, station: Vector, shortest: float) -> None:
    """Join two detours between which the tip is on the path for less than `shortest` [m]."""
    edges = np.flatnonzero(np.diff(on[first : last + 1].astype(int))) + first + 1
    for start, end in pairwise([first, *edges.tolist(), last + 1]):
        if on[start] and start > first and end <= last and station[end - 1] - station[start] < shortest:
            on[start:end] = False


def find_gaps(on: Flags, arcs: Vector, tips: Matrix, tolerance: float) -> list[tuple[int, int]]:
    """The samples before and behind each detour: the tip is off the path, or advances on it by more than it moves.

    Parameters
    ----------
    arcs: (T,) how far along the path the tip is [m], turns not counted.
    """
    way = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    skips = np.diff(arcs) > 1.5 * way + 4.0 * tolerance
    return [(a, b) for a, b in pairwise(np.flatnonzero(on).tolist()) if b > a + 1 or skips[a]]


def measure_detour(path: TipPath, tip: TipStations, gap: tuple[int, int], angle: Vector, time: Vector) -> Detour:
    """The detour between two samples at which the tip is on the path.

    Parameters
    ----------
    gap: the samples before and behind the detour.
    angle: (T,) the greatest angle from the asked orientation next to each sample [rad].
    time: (T,) of the samples [s].
    """
    a, b = gap
    station, tips = tip.station, tip.tips
    left_out = _farthest_left_out(path, float(station[a]), float(station[b]), tips[a : b + 1])
    return Detour(
        time_from=float(time[a]), time_to=float(time[b]),
        path_from=path.arc(float(station[a])), path_to=path.arc(float(station[b])),
        length=float(np.sum(np.linalg.norm(np.diff(tips[a : b + 1], axis=0), axis=1))),
        max_deviation=max(float(np.max(tip.error[a + 1 : b], initial=0.0)), left_out),
        max_angle=float(np.max(angle[a + 1 : b], initial=0.0)),
    )  # fmt: skip


def _farthest_left_out(path: TipPath, begin: float, end: float, tips: Matrix) -> float:
    """The farthest that the path from one s to another [m] is from the tip's track (K, 3), at waypoints and between.

    A spike of the path may be left out by a track that is near the path everywhere.
    """
    stations = path.stations[(path.stations > begin) & (path.stations < end)]
    marks = np.union1d(np.linspace(begin, end, _MARKS), stations)
    way = np.diff(tips, axis=0)
    size = np.maximum(np.sum(way * way, axis=1), np.finfo(float).tiny)
    farthest = 0.0
    for place in map(path, marks.tolist()):
        off = place - tips[:-1]
        part = np.clip(np.sum(off * way, axis=1) / size, 0.0, 1.0)
        farthest = max(farthest, float(np.min(np.linalg.norm(off - part[:, None] * way, axis=1))))
    return farthest
