"""The unit and the upward axis of a mesh file.

What other programs do, and why this package does the same:

- glTF is in metres with y up by its standard. Blender, Drake and (since 2025) RViz turn it so that z is up. trimesh
  writes coordinates as they are, and nearly always z is up in the program that calls it.
- A DAE states a unit, which RViz and Gazebo apply. It also states an upward axis, which RViz ignores: MeshLab and
  trimesh write `Y_UP` into every DAE, whatever is up, and so most such files of published robots have z up.
- 3MF states a unit and has z up. STL, OBJ, PLY and OFF state nothing.
"""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from lxml import etree

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.found_file import is_file

Axis = Literal["x", "y", "z"]

_GLTF = (".glb", ".gltf")
_TRIMESH, _HEADER = b"mikedh/trimesh", 4096  # the generator, within the first bytes of a glTF
_BY_TRIMESH = (
    "was written by trimesh, which does not turn axes; z counts as up in it, not y as in other glTF files: `up: y` if "
    "y is up, `up: z` confirms z"
)
_SAID_BY_COLLADA = (
    "says that {axis} is up, which is not applied, because many programs write the same into every DAE: `up: {axis}` "
    "applies it, `up: z` confirms that z is up"
)
_UNITS_OF_3MF = {
    "micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0,
}  # fmt: skip
_MODEL = ".model"  # the end of the name of the part of a 3MF that holds meshes
_UP_AXES: dict[str, Axis] = {"X_UP": "x", "Y_UP": "y", "Z_UP": "z"}
# x, y, z of the site from those of a file, by the axis of the file that is up; as COLLADA defines its three systems
_TURNS: dict[Axis, list[list[float]]] = {
    "x": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
    "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
}


class MeshAxes(NamedTuple):
    """What a mesh file says of its coordinates.

    Attributes
    ----------
    unit: what 1 is in it [m].
    up: the axis that is up by the standard of its format, or as its program writes it.
    doubt: in words, why another axis may be up, and what to do about it in a scene; None if there is no doubt.
    """

    unit: float = 1.0
    up: Axis = "z"
    doubt: str | None = None


def mesh_axes(path: Path) -> MeshAxes:
    """The unit and the upward axis of a mesh file; metres with z up if the file does not say.

    Raises
    ------
    InputError: there is no such file, it cannot be read, the unit that it states is none, or it is no XML or archive.
    """
    if not is_file(path):
        raise InputError("no such mesh file", file=path)
    kind = path.suffix.lower()
    try:
        if kind in _GLTF:
            with path.open("rb") as file:
                return MeshAxes(doubt=_BY_TRIMESH) if _TRIMESH in file.read(_HEADER) else MeshAxes(up="y")
        if kind == ".dae":
            return _axes_of_collada(path)
        if kind == ".3mf":
            return MeshAxes(unit=_unit_of_3mf(path))
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from error
    except Exception as error:  # zipfile and lxml pass on whatever their decoders raise
        raise InputError(f"is not a mesh that can be read: {error}", file=path) from error
    return MeshAxes()


def upright(up: Axis) -> Matrix:
    """(3, 3) the rotation that turns an axis of a file upwards: coordinates of the site from those of the file."""
    return np.array(_TURNS[up], dtype=float)


def along_file_axes(scale: Vector, up: Axis) -> Vector:
    """(3,) the factors along the axes of a file, from those (3,) along the axes of the site."""
    return np.asarray(np.square(upright(up)).T @ scale)


def _axes_of_collada(path: Path) -> MeshAxes:
    """What the `<asset>` of a DAE says, which comes before all else."""
    # events of the root and of what is directly in it: other elements may have an asset of their own
    depth = 0
    with path.open("rb") as file:
        for event, element in etree.iterparse(file, events=("start", "end"), resolve_entities=False, huge_tree=True):
            depth += 1 if event == "start" else -1
            if event == "end" and depth == 1 and etree.QName(element).localname == "asset":
                unit, up = element.find("{*}unit"), element.findtext("{*}up_axis") or ""
                text = "1" if unit is None else str(unit.get("meter", "1"))
                said = _UP_AXES.get(up.strip().upper(), "z")
                doubt = None if said == "z" else _SAID_BY_COLLADA.format(axis=said)
                return MeshAxes(_metres(text, path), doubt=doubt)
    return MeshAxes()


def _metres(text: str, path: Path) -> float:
    try:
        found = float(text)
    except ValueError:
        found = 0.0
    if not 0.0 < found < math.inf:
        raise InputError(
            "is not a unit", file=path, key="asset > unit @meter", found=repr(text), allowed="metres, such as 0.001"
        )
    return found


def _unit_of_3mf(path: Path) -> float:
    with zipfile.ZipFile(path) as parts:
        models = [name for name in parts.namelist() if name.lower().endswith(_MODEL)]
        # of several, the one that the others are placed in is not in a folder of objects
        name = min(models, key=lambda one: (one.count("/"), one), default=None)
        if name is None:
            raise InputError("is not a mesh that can be read: the archive has no model", file=path)
        with parts.open(name) as model:
            _, root = next(iter(etree.iterparse(model, events=("start",), resolve_entities=False, huge_tree=True)))
    unit = str(root.get("unit", "millimeter"))
    if unit not in _UNITS_OF_3MF:
        raise InputError(
            "is not a unit", file=path, key="model @unit", found=repr(unit), allowed=", ".join(_UNITS_OF_3MF)
        )
    return _UNITS_OF_3MF[unit]
