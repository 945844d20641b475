"""The check that nothing of a glTF or a DAE is left out or misplaced when trimesh reads it.

trimesh reads the vertices of a compressed glTF as zeros if its decoder is not installed, and leaves out instances,
poses of skeletons and whatever a DAE refers to in vain, without a word.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lxml import etree

from backhoe_planner.errors import InputError

_PLAIN = "export it without, such as from Blender"
# extensions of glTF that change where triangles are, or how many there are
_MOVING = {
    "KHR_draco_mesh_compression": "is compressed",
    "EXT_meshopt_compression": "is compressed",
    "KHR_meshopt_compression": "is compressed",
    "EXT_mesh_gpu_instancing": "repeats its parts by an extension",
}
# beginnings of the names of those that do not, or whose numbers trimesh reads
_HARMLESS = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp", "EXT_texture_")
_FAN, _TRIANGLES, _SHAPES = 6, 4, 7  # modes of a primitive: a fan, triangles, and the number of modes
_JSON = b"JSON"
_POSED = {  # elements of a DAE that pycollada or trimesh leaves out, and what they are
    "instance_controller": "is posed by a skeleton",
    "skew": "has a part that is skewed",
    "ph": "has a polygon with a hole",
}


def check_all_read(path: Path) -> None:
    """Check that a glTF or DAE has nothing that trimesh leaves out; other files are not looked at.

    Raises
    ------
    InputError: it has, or it cannot be read.
    OSError: the file cannot be read.
    """
    kind = path.suffix.lower()
    if kind in (".glb", ".gltf"):
        _check_gltf(_tree_of(path), path)
    elif kind == ".dae":
        parser = etree.XMLParser(resolve_entities=False, huge_tree=True)
        try:
            _check_collada(etree.parse(path, parser).getroot(), path)
        except etree.XMLSyntaxError as error:
            raise InputError(f"is not a mesh that can be read: {error}", file=path) from error


def _tree_of(path: Path) -> dict[str, Any]:
    """The JSON of a glTF, which in a GLB is its first chunk."""
    content = path.read_bytes()
    try:
        if path.suffix.lower() == ".glb":
            length, kind = struct.unpack_from("<I4s", content, 12)
            if kind != _JSON:
                raise ValueError("its first chunk is not JSON")
            content = content[20 : 20 + length]
        found = json.loads(content)
    except (struct.error, ValueError) as error:
        raise InputError(f"is not a mesh that can be read: {error}", file=path) from error
    if not isinstance(found, dict):
        raise InputError("is not a mesh that can be read: its JSON is no object", file=path)
    return found


def _check_gltf(tree: dict[str, Any], path: Path) -> None:
    used = [str(name) for key in ("extensionsRequired", "extensionsUsed") for name in tree.get(key, ())]
    for name in used:
        if name in _MOVING:
            raise InputError(_MOVING[name], file=path, key="extensionsUsed", found=name, allowed="none", hint=_PLAIN)
    for name in map(str, tree.get("extensionsRequired", ())):
        if not name.startswith(_HARMLESS):
            raise InputError(
                "needs an extension that is not known", file=path, key="extensionsRequired", found=name, hint=_PLAIN
            )
    meshes = tree.get("meshes", [])
    for index, node in enumerate(tree.get("nodes", ())):
        mesh = node.get("mesh", -1)
        of_mesh = meshes[mesh] if isinstance(mesh, int) and 0 <= mesh < len(meshes) else {}
        if "skin" in node and of_mesh:
            raise InputError(
                "is posed by a skeleton", file=path, key=f"nodes[{index}].skin", found=node["skin"],
                allowed="none", hint="apply it before the export, in Blender: Apply the Armature modifier",
            )  # fmt: skip
        weights = [*node.get("weights", ()), *of_mesh.get("weights", ())]
        if any(weights):
            raise InputError(
                "has weights of other shapes of a mesh", file=path, key=f"nodes[{index}].weights", found=weights,
                allowed="0", hint="apply the shape keys before the export",
            )  # fmt: skip
    for number, mesh in enumerate(meshes):
        for part, primitive in enumerate(mesh.get("primitives", ())):
            mode = primitive.get("mode", _TRIANGLES)
            if mode == _FAN or mode not in range(_SHAPES):
                raise InputError(
                    "has triangles as a fan", file=path, key=f"meshes[{number}].primitives[{part}].mode", found=mode,
                    allowed="4 or 5, triangles or strips", hint=_PLAIN,
                )  # fmt: skip


def _check_collada(root: etree._Element, path: Path) -> None:
    for name, problem in _POSED.items():
        element = next(root.iter("{*}" + name), None)
        if element is not None:
            raise InputError(
                problem, file=path, key=f"line {element.sourceline}", found=f"<{name}>", allowed="none", hint=_PLAIN
            )
    names = {element.get("id") for element in root.iter("{*}geometry", "{*}node")}
    _check_references(root.iter("{*}instance_geometry", "{*}instance_node"), names, path)


def _check_references(elements: Iterable[etree._Element], names: set[str | None], path: Path) -> None:
    for element in elements:
        url = str(element.get("url", ""))
        if not url.startswith("#") or url[1:] not in names:
            raise InputError(
                "refers to a part that is not in the file", file=path, key=f"line {element.sourceline}",
                found=repr(url), hint="export it as one file",
            )  # fmt: skip
