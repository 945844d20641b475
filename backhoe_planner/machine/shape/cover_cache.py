"""Convex pieces of mesh files, kept in the user's cache folder because dividing a mesh takes seconds.

The key of an entry covers the bytes of a mesh file, its scale, the settings of the division, the
code that divides meshes, and the versions of the libraries that the code calls.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.files.cache import caches, keep_entry, maker_digest, read_entry
from backhoe_planner.machine.shape.convex import SPLIT_FORMATS, convex_cover, load_mesh

_LIBRARIES = ("vhacdx", "trimesh", "pycollada", "scipy", "numpy")
_MAKERS = ("convex.py", "shapes.py", "thinning.py")  # beside this file


@dataclass(frozen=True, eq=False)
class Cover:
    """Convex pieces that contain every triangle of a mesh.

    Attributes
    ----------
    pieces: corners (k, 3) of each piece [m], see `convex_cover`.
    surfaces: for each piece those triangles (m, 3, 3) of the mesh that it was grown over [m]; None if the
        piece is the mesh.
    cached: whether the pieces came from the cache folder.
    """

    pieces: list[Matrix]
    surfaces: list[Matrix | None]
    cached: bool


def cache_folder() -> Path:
    """The folder for the pieces of meshes, whether or not it exists yet."""
    return caches() / "convex_pieces"


def mesh_cover(path: Path, scale: float | Vector, *, pieces: int = 16, excess: float = 1.08) -> Cover:
    """The convex pieces of a mesh file; they are read from the cache folder, or computed and written there.

    Parameters
    ----------
    path: of the mesh.
    scale: from the file's units to metres, one number or (3,).
    pieces, excess: see `convex_cover`.

    Raises
    ------
    InputError: see `load_mesh` and `convex_cover`.
    """
    entry, key = None, b""
    if path.suffix.lower() not in SPLIT_FORMATS:
        with contextlib.suppress(OSError, RuntimeError, ImportError):  # `load_mesh` reports it; or there is no home
            key = _key(path.read_bytes(), scale, pieces, excess)
            entry = cache_folder() / f"{key.hex()}.pieces"
            kept = _read(entry, key)
            if kept is not None:
                return Cover(*kept, cached=True)
    mesh = load_mesh(path)
    mesh.apply_scale(scale)
    found = convex_cover(mesh, pieces=pieces, excess=excess)
    cover = Cover([corners for corners, _ in found], [surface for _, surface in found], cached=False)
    if entry is not None:
        _keep(entry, key, cover)
    return cover


def _key(mesh: bytes, scale: float | Vector, pieces: int, excess: float) -> bytes:
    asked = repr((np.full(3, scale, dtype=float).tolist(), pieces, excess))
    return hashlib.sha256(hashlib.sha256(mesh).digest() + _maker() + asked.encode()).digest()


@cache
def _maker() -> bytes:
    """A digest of the code that divides meshes."""
    return maker_digest(Path(__file__).parent, _MAKERS, _LIBRARIES)


def _read(entry: Path, key: bytes) -> tuple[list[Matrix], list[Matrix | None]] | None:
    """The pieces of an entry with their surfaces; None if there is no entry, or it is damaged."""
    body = read_entry(entry, key)
    if body is None:
        return None
    stream = io.BytesIO(body)
    ends, corners, surface_ends, triangles, is_mesh = (np.load(stream, allow_pickle=False) for _ in range(5))
    surfaces = zip(np.split(triangles, surface_ends), is_mesh.tolist(), strict=True)
    return np.split(corners, ends), [None if whole else surface for surface, whole in surfaces]


def _keep(entry: Path, key: bytes, cover: Cover) -> None:
    stream = io.BytesIO()
    surfaces = [np.zeros((0, 3, 3)) if surface is None else surface for surface in cover.surfaces]
    for arrays in (cover.pieces, surfaces):
        np.save(stream, np.cumsum([len(array) for array in arrays])[:-1], allow_pickle=False)
        np.save(stream, np.concatenate(arrays), allow_pickle=False)
    np.save(stream, np.array([surface is None for surface in cover.surfaces]), allow_pickle=False)
    keep_entry(entry, key, stream.getvalue())
