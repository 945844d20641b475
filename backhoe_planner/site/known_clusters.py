"""Scans, terrains and fine meshes that are already in use, by the content of their files."""

from __future__ import annotations

import hashlib
from pathlib import Path
from weakref import WeakValueDictionary

import pinocchio as pin

from backhoe_planner.files.files_beside import files_beside
from backhoe_planner.machine import SPLIT_FORMATS, Cluster
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.schema import obstacle_shapes

# keys of an obstacle's record on which its solid does not depend
_BESIDE = {"name", "clearance", "links", "legs", "appears_at", "position", "rpy", "quaternion"}

_KNOWN: WeakValueDictionary[tuple[str, bytes], Cluster] = WeakValueDictionary()


def body_of(spec: obstacle_shapes.ObstacleSpec, folder: Path) -> list[shapes.Piece] | Cluster:
    """The pieces or the cluster of an obstacle; the solid of a cluster in use with the same file is shared.

    Reading a scan of a million points takes some seconds, and a program plans to many goals on one site. The place of
    an obstacle makes no difference, so a car that is parked in fifty places is read once. A cluster that is no longer
    in use is forgotten.

    Raises
    ------
    InputError: its file is missing, empty or malformed, or needs too many pieces.
    """
    key = _key(spec, folder)
    known = None if key is None else _KNOWN.get(key)
    found = spec.body(folder) if known is None else known.moved_to(_placement(spec))
    if key is None or not isinstance(found, Cluster):
        return found
    if known is not None or key == _key(spec, folder):  # otherwise the file was written meanwhile
        _KNOWN[key] = found  # the newest will be in use for longest
    return found


def _placement(spec: obstacle_shapes.ObstacleSpec) -> pin.SE3:
    """T_world_shape of an obstacle with a file: all of those have one."""
    assert isinstance(spec, obstacle_shapes.PlacedRecord)
    return spec.placement


def _key(spec: obstacle_shapes.ObstacleSpec, folder: Path) -> tuple[str, bytes] | None:
    """What the solid depends on; None if there is no file, none that can be read, or other files beside it."""
    name = getattr(spec, "file", None)
    if name is None or name.lower().endswith(SPLIT_FORMATS) or files_beside(folder / name):
        return None
    try:
        content = (folder / name).read_bytes()
    except (OSError, ValueError):  # reported by the function that reads it in full
        return None
    return spec.model_dump_json(exclude=_BESIDE), hashlib.sha256(content).digest()
