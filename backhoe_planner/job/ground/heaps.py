"""Heaps of loose soil: soil poured at a place comes to rest at the angle of repose.

The heap is the highest surface through an apex above the place that falls at the angle of repose to all sides,
wherever it is above the ground (the growing pile of Prigozhin, Variational model of sandpile growth, 1996). The
height of the apex follows from the volume. Soil that would then rest on an edge slumps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_number, as_vector
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.job.ground.slumping import slumped
from backhoe_planner.job.ground.terrain import Terrain

_LAID = 1e-6  # m of soil on a column that counts as none: rounding leaves as much
_HALVINGS_OF_APEX = 40  # of the apex height: from metres to rounding
_CLIFF = 2.5  # times the drop at the angle of repose; chosen: a trench's wall is as steep, loose soil never is
_ROUNDING = 1e-6  # m of a level, far above rounding
_HALVINGS = 12  # of a volume, to find how much fits if soil slumps: to 1 in 4,000


@dataclass(frozen=True)
class Refusal:
    """The reason why loose soil cannot be dumped at a place.

    Attributes
    ----------
    reason: why, in one sentence.
    room: the greatest volume that can be dumped there [m^3].
    """

    reason: str
    room: float


def deposited(
    terrain: Terrain, at: Sequence[float] | Vector, volume: float, *, clear_of: Flags | None = None
) -> Terrain | Refusal:
    """The ground after loose soil was poured at a place.

    Parameters
    ----------
    at: (2,) x, y [m].
    volume: loose volume [m^3].
    clear_of: (rows, columns) columns on which no soil may come to rest, such as those of a trench with the
        distance to its edge; the columns at the border of the grid always count among them.

    Returns
    -------
    The ground with `volume` more loose soil, to rounding; or a refusal if soil would come to rest where it may not.

    Raises
    ------
    InputError: an argument is of another kind, or the place is not on the grid.
    """
    check_kind(terrain, Terrain, key="terrain")
    place = _place(terrain, at)
    volume = as_number(volume, key="volume", least=0.0)
    forbidden = _forbidden(terrain, clear_of)
    after = poured(terrain, place, volume)
    laid = (after.loose - terrain.loose > _LAID) & forbidden
    if not laid.any():
        return after
    room = heap_room(terrain, at, clear_of=clear_of)
    row, column = np.argwhere(laid)[0].tolist()
    where = f"x {terrain.x[column]:.2f} m, y {terrain.y[row]:.2f} m"
    border = laid[[0, -1]].any() or laid[:, [0, -1]].any()
    why = "beyond the known ground" if border else "an area that must stay clear"
    return Refusal(
        f"a heap of {volume:.2f} m^3 at x {place[0]:.2f} m, y {place[1]:.2f} m reaches {why} ({where}); "
        f"there is room for {room:.2f} m^3",
        room,
    )


def heap_room(terrain: Terrain, at: Sequence[float] | Vector, *, clear_of: Flags | None = None) -> float:
    """The volume of loose soil that can be poured at a place [m^3].

    Parameters
    ----------
    terrain, at, clear_of: as in `deposited`.

    Raises
    ------
    InputError: as for `deposited`.
    """
    check_kind(terrain, Terrain, key="terrain")
    place = _place(terrain, at)
    forbidden = _forbidden(terrain, clear_of)

    def fits(volume: float) -> bool:
        laid = poured(terrain, place, volume).loose - terrain.loose > _LAID
        return not (laid & forbidden).any()

    # a cone whose slope ends where the nearest forbidden column begins
    start = _first_height(terrain, place)
    room = float(np.maximum(start[forbidden].min() - start, 0.0).sum()) * terrain.cell**2
    if room > 0.0 and fits(room):
        return room
    low, high = 0.0, room
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def poured(terrain: Terrain, place: Vector, volume: float) -> Terrain:
    """Like `deposited`, but soil may come to rest anywhere; none passes the border of the grid."""
    if volume <= 0.0:
        return terrain
    raised = _cone(terrain, place, volume / terrain.cell**2)
    laid = np.argwhere(raised > 0.0)
    low = terrain.low + terrain.cell * laid.min(axis=0)[::-1]
    high = terrain.low + terrain.cell * laid.max(axis=0)[::-1]
    return slumped(terrain.with_layers(terrain.bank, terrain.loose + raised), low, high)


def level_for(start: Array, most: Array, total: float) -> float:
    """The level at which columns that rise from `start`, each by at most `most`, have risen by `total` in all.

    Each begins to rise when the level passes its start. The total is piecewise linear in the level, so that the
    answer is exact.

    Parameters
    ----------
    start: height at which each begins [m].
    most: the greatest rise of each [m], infinite if unlimited.
    total: total rise [m]; at most the sum of `most`.
    """
    ends = (start + most)[np.isfinite(most)].ravel()
    levels = np.concatenate((start.ravel(), ends))
    rises = np.concatenate((np.ones(start.size), -np.ones(ends.size)))
    order = np.argsort(levels, kind="stable")
    levels, slope = levels[order], np.cumsum(rises[order])
    reached = np.concatenate(([0.0], np.cumsum(slope[:-1] * np.diff(levels))))
    last = int(np.searchsorted(reached, total, side="right")) - 1
    if slope[last] <= 0.0:
        return float(levels[last])
    return float(levels[last] + (total - reached[last]) / slope[last])


def _first_height(terrain: Terrain, place: Vector) -> Matrix:
    """(rows, columns) height of the apex at which a heap begins to cover a column [m]."""
    away = np.hypot(terrain.x[None, :] - place[0], terrain.y[:, None] - place[1])
    return np.asarray(terrain.surface + math.tan(terrain.repose) * away)


def _cone(terrain: Terrain, place: Vector, total: float) -> Matrix:
    """(rows, columns) thickness that a heap adds to each column [m], `total` [m] in all, before any of it slumps.

    The heap is connected and ends where the ground breaks off: soil that flows over such an edge slumps later.
    """
    start = _first_height(terrain, place)
    top = np.unravel_index(int(np.argmin(start)), start.shape)
    own = np.unravel_index(int(np.argmin(start - terrain.surface)), start.shape)
    open_to = ~_foots(terrain)
    open_to[own] = True

    def part(apex: float) -> Flags:
        from scipy.ndimage import label

        numbers, _ = label((start < apex) & open_to, np.ones((3, 3), dtype=int))
        return np.asarray(numbers == numbers[own]) if numbers[own] else np.zeros(start.shape, dtype=bool)

    low = _level(start[open_to], total)
    covered = part(low)
    if top == own and covered.sum() == ((start < low) & open_to).sum():
        return np.where(covered, low - start, 0.0)
    # no level below that of all columns is high enough, as the heap covers a part of them
    least, parts = low - _ROUNDING, (0, start.size)
    low, high = float(start[own]), float(start[own]) + total
    for _ in range(_HALVINGS_OF_APEX):
        middle = 0.5 * (low + high)
        if middle < least:
            low = middle
            continue
        covered = part(middle)
        if float((middle - start[covered]).sum()) < total:
            low, parts = middle, (int(covered.sum()), parts[1])
        else:
            high, parts = middle, (parts[0], int(covered.sum()))
        if parts[0] == parts[1]:  # a higher apex never covers less: every apex between covers the same columns
            break
    covered = part(high)
    return np.where(covered, np.maximum(_level(start[covered], total) - start, 0.0), 0.0)


def _level(start: Array, total: float) -> float:
    start = start.ravel()
    low, step = float(start.min()), total / len(start)
    # columns that begin above a level at which there is enough are not sorted
    while float(np.maximum(low + step - start, 0.0).sum()) <= total:
        step *= 2.0
    own = start[start <= low + step]
    return level_for(own, np.full(own.shape, np.inf), total)


def _foots(terrain: Terrain) -> Flags:
    """(rows, columns) which columns are at the foot of a step that is far steeper than loose soil."""
    surface, found = terrain.surface, np.zeros(terrain.shape, dtype=bool)
    step = _CLIFF * math.tan(terrain.repose) * terrain.cell
    for axis in (0, 1):
        rise = np.diff(surface, axis=axis)
        ahead, behind = [(slice(None),) * axis + (part,) for part in (slice(None, -1), slice(1, None))]
        found[ahead] |= rise > step
        found[behind] |= rise < -step
    return found


def _place(terrain: Terrain, at: Sequence[float] | Vector) -> Vector:
    place = as_vector(at, 2, key="at")
    if (place < terrain.low).any() or (place > terrain.high).any():
        (x0, y0), (x1, y1) = terrain.low.tolist(), terrain.high.tolist()
        raise InputError(
            "is not on the grid", key="at", found=place.tolist(),
            allowed=f"x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m",
        )  # fmt: skip
    return place


def _forbidden(terrain: Terrain, clear_of: Flags | None) -> Flags:
    found = np.zeros(terrain.shape, dtype=bool) if clear_of is None else np.array(clear_of, dtype=bool)
    if found.shape != terrain.shape:
        raise InputError("has the wrong shape", key="clear_of", found=str(found.shape), allowed=str(terrain.shape))
    found[[0, -1]] = True
    found[:, [0, -1]] = True
    return found
