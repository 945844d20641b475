"""The soil that a moving blade takes out of the ground: geometry alone.

The edge sweeps a surface, ruled by its positions. Soil above that surface is removed, loose soil before
undisturbed soil. Each column is sampled at `_PARTS` x `_PARTS` points. The part that the end of the blade cuts
from the square around a point is the exact area of a square on one side of a line.

If the blade covers a column in part, only the column's mean height is known. The part that is not covered is
taken to be as high as the next column on the side away from the blade. Hence a trench dug in many layers stays
as wide as the blade, and two passes side by side leave no ridge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector, as_array, as_number, as_rows
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.job.ground.slumping import slumped
from backhoe_planner.job.ground.terrain import Terrain

_PARTS = 5  # of a column along each axis; chosen: 1 cm, so that the length of a cut of 1.2 m is right to within 1 %
_MOST_ENTRIES = 2_000_000  # points times moments that are computed at once: some 50 MB
_WHOLE = 1e-9  # of a column: less is rounding
_UPRIGHT = 0.1  # horizontal part of the edge's direction; with less the edge cannot cut from above


@dataclass(frozen=True, eq=False)
class BladeSweep:
    """The path of a cutting edge.

    Attributes
    ----------
    edge: (K, 3) positions of its middle [m], world.
    across: (K, 3) unit vectors along the edge, world; (3,) if it keeps its direction.
    width: width of the blade [m].

    Raises
    ------
    InputError: one of them has another shape, or the edge is upright.
    """

    edge: Matrix
    across: Array
    width: float

    def __post_init__(self) -> None:
        edge = as_array(self.edge, None, 3, key="edge")
        if len(edge) < 2:
            raise InputError("is no way", key="edge", found=f"{len(edge)} positions", allowed="2 or more")
        across = np.broadcast_to(as_rows(self.across, 3, key="across"), edge.shape)
        length = np.linalg.norm(across, axis=1)
        if (np.hypot(across[:, 0], across[:, 1]) < _UPRIGHT * length).any() or (length == 0.0).any():
            raise InputError("is upright", key="across", allowed="a direction that is about level")
        object.__setattr__(self, "edge", edge)
        object.__setattr__(self, "across", across / length[:, None])
        object.__setattr__(self, "width", as_number(self.width, key="width", above=0.0))


@dataclass(frozen=True, eq=False)
class Sweep:
    """The soil that a blade took.

    Attributes
    ----------
    terrain: the ground afterwards; loose soil that lost its support has slumped.
    bank, loose: (K,) undisturbed and loose soil taken up to each moment [m^3].
    """

    terrain: Terrain
    bank: Vector
    loose: Vector

    @property
    def volume(self) -> Vector:
        """(K,) loose volume of all soil taken up to each moment [m^3]: what the bucket holds and what it spilt."""
        return self.terrain.swell * self.bank + self.loose


def swept(terrain: Terrain, blade: BladeSweep, *, slump: bool = True) -> Sweep:
    """The ground after a blade went through it.

    Parameters
    ----------
    slump: whether loose soil that lost its support slumps to rest.

    Raises
    ------
    InputError: `terrain` or `blade` is of another kind.
    """
    check_kind(terrain, Terrain, key="terrain")
    check_kind(blade, BladeSweep, key="blade")
    moments = len(blade.edge)
    reach = 0.5 * blade.width * np.abs(blade.across[:, :2])
    low, high = (blade.edge[:, :2] - reach).min(axis=0), (blade.edge[:, :2] + reach).max(axis=0)
    rows, columns = terrain.columns_within(low, high, margin=terrain.cell)
    surface = terrain.surface
    patch = surface[rows, columns]
    if not patch.size or blade.edge[:, 2].min() - 0.5 * blade.width > patch.max():
        nothing = np.zeros(moments)
        return Sweep(terrain, nothing, nothing)
    crossings = _crossings(blade, *_parts(terrain, rows, columns), terrain.cell / _PARTS)
    number = crossings.part // _PARTS**2
    flat = patch.ravel()
    cuts = crossings.z < flat[number]
    number, crossings = number[cuts], crossings.only(cuts)
    cover = _cover(patch, crossings)
    heights = _covered_heights(surface, patch, (rows.start, columns.start), cover)
    taken = _taken(crossings, heights[number], number, (patch.size, moments))
    loose = np.minimum(taken, (cover * terrain.loose[rows, columns]).reshape(-1, 1))
    bank = taken - loose
    new_bank, new_loose = terrain.bank.copy(), terrain.loose.copy()
    new_bank[rows, columns] -= bank[:, -1].reshape(patch.shape)
    new_loose[rows, columns] -= loose[:, -1].reshape(patch.shape)
    after = terrain.with_layers(new_bank, new_loose)
    if slump:
        after = slumped(after, low - terrain.cell, high + terrain.cell)
    return Sweep(after, bank.sum(axis=0) * terrain.cell**2, loose.sum(axis=0) * terrain.cell**2)


def _parts(terrain: Terrain, rows: slice, columns: slice) -> tuple[Matrix, Indices]:
    """(n, 2) x, y of the sample points of all columns in a rectangle [m], by column, and their indices (n,)."""
    inner = ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5) * terrain.cell
    x = terrain.x[columns][None, :, None, None] + inner[None, None, None, :]
    y = terrain.y[rows][:, None, None, None] + inner[None, None, :, None]
    x, y = np.broadcast_arrays(x, y)
    return np.column_stack((x.ravel(), y.ravel())), np.arange(x.size)


@dataclass(frozen=True, eq=False)
class _Crossings:
    """Where the edge passes over points: which `part`, at which `moment`, at height `z` [m], which `share` of it."""

    part: Indices
    moment: Indices
    z: Vector
    share: Vector

    def only(self, these: Flags | Indices) -> _Crossings:
        return _Crossings(self.part[these], self.moment[these], self.z[these], self.share[these])


def _crossings(blade: BladeSweep, points: Matrix, parts: Indices, edge: float) -> _Crossings:
    """All crossings, by part and in the order of moments; `edge` of the square around each point [m]."""
    level = np.hypot(blade.across[:, 0], blade.across[:, 1])
    along = blade.across[:, :2] / level[:, None]
    half = 0.5 * blade.width * level
    slope = blade.across[:, 2] / level
    ahead = np.column_stack((-along[:, 1], along[:, 0]))
    origin = (blade.edge[:, :2] * ahead).sum(axis=1)
    found = []
    size = max(_MOST_ENTRIES // len(blade.edge), 1)
    for start in range(0, len(points), size):
        own = points[start : start + size]
        past = own @ ahead.T - origin  # (n, K) signed distance of a point ahead of the edge
        turns = (past[:, :-1] < 0.0) != (past[:, 1:] < 0.0)
        part, moment = np.nonzero(turns)
        before, behind = past[part, moment], past[part, moment + 1]
        t = before / (before - behind)
        middle = blade.edge[moment] + t[:, None] * (blade.edge[moment + 1] - blade.edge[moment])
        way = along[moment] + t[:, None] * (along[moment + 1] - along[moment])
        beside = ((own[part] - middle[:, :2]) * way).sum(axis=1)
        share = _area(beside + half[moment], way, edge) - _area(beside - half[moment], way, edge)
        z = middle[:, 2] + beside * slope[moment]
        there = share > 0.0
        found.append(_Crossings(parts[start + part[there]], moment[there] + 1, z[there], share[there]))
    return _Crossings(
        np.concatenate([one.part for one in found]), np.concatenate([one.moment for one in found]),
        np.concatenate([one.z for one in found]), np.concatenate([one.share for one in found]),
    )  # fmt: skip


def _area(distance: Vector, way: Matrix, edge: float) -> Vector:
    """The part of squares that is behind a line whose unit normal is `way` (n, 2).

    distance: (n,) from the line to the middle of the square, along `way` [m]; positive if the middle is behind.
    """
    a, b = np.sort(np.abs(way), axis=1).T * edge
    a = np.maximum(a, 1e-12 * edge)
    # the projection of the square on the normal is a trapezium: flat over b - a, sloping over a on both sides
    d = np.clip(distance, -0.5 * (a + b), 0.5 * (a + b))
    lower, upper = np.maximum(0.5 * (a + b) + d, 0.0), np.maximum(0.5 * (a + b) - d, 0.0)
    tail = np.minimum(lower, upper)
    small = np.where(tail < a, tail * tail / (2.0 * a * b), (tail - 0.5 * a) / b)
    return np.asarray(np.where(lower <= upper, small, 1.0 - small))


def _cover(patch: Matrix, crossings: _Crossings) -> Matrix:
    """(rows, columns of the patch) the part of each column that the blade cuts."""
    share = np.zeros(patch.size * _PARTS**2)
    np.maximum.at(share, crossings.part, crossings.share)  # a point that is passed twice counts once
    return np.asarray(share.reshape(*patch.shape, _PARTS**2).mean(axis=2))


def _covered_heights(surface: Matrix, patch: Matrix, corner: tuple[int, int], cover: Matrix) -> Vector:
    """(columns of the patch,) height of the covered part of each column [m]."""
    down, right = np.gradient(np.pad(cover, 1))
    way = np.stack((down, right), axis=-1)[1:-1, 1:-1]
    length = np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)
    step = np.round(2.0 * way / length).astype(int)  # to a wholly covered column; backwards, to one not covered
    row, column = np.indices(patch.shape) + np.reshape(corner, (2, 1, 1))
    sides = [
        surface[
            np.clip(row + sign * step[..., 0], 0, surface.shape[0] - 1),
            np.clip(column + sign * step[..., 1], 0, surface.shape[1] - 1),
        ]
        for sign in (1, -1)
    ]
    partly = (cover > _WHOLE) & (cover < 1.0 - _WHOLE)
    left = (patch - (1.0 - cover) * sides[1]) / np.where(partly, cover, 1.0)
    # on a slope that overshoots: the part is no further from the mean than the column on the covered side
    left = np.clip(left, np.minimum(patch, sides[0]), np.maximum(patch, sides[0]))
    return np.asarray(np.where(partly, left, patch).ravel())


def _taken(crossings: _Crossings, top: Vector, number: Indices, size: tuple[int, int]) -> Matrix:
    """(columns, K) the lowering of each column up to each moment [m].

    top: (n,) height of the soil above each crossing [m].
    """
    order = np.lexsort((crossings.moment, crossings.part))
    crossings, top, number = crossings.only(order), top[order], number[order]
    depth = np.maximum(top - crossings.z, 0.0) * crossings.share
    # a crossing takes more only if it is deeper than all earlier ones of the same part
    starts = np.flatnonzero(np.diff(crossings.part, prepend=-1))
    rank = np.arange(len(depth)) - np.repeat(starts, np.diff(np.append(starts, len(depth))))
    before, most = np.zeros(len(depth)), depth.copy()
    for turn in range(1, int(rank.max(initial=0)) + 1):
        at = np.flatnonzero(rank == turn)
        before[at] = most[at - 1]
        most[at] = np.maximum(most[at - 1], depth[at])
    steps = np.zeros(size)
    np.add.at(steps, (number, crossings.moment), (most - before) / _PARTS**2)
    return np.asarray(np.cumsum(steps, axis=1))
