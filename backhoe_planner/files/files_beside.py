"""Files beside a file of a site that are read with it."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import unquote

from backhoe_planner.files.found_file import is_file

NOTED_BESIDE = ".aux.xml"  # the end of the name of a file in which GDAL notes what it cannot note in tags
_TIFF = (".tif", ".tiff")


def world_files(path: Path) -> list[Path]:
    """The world files of a raster that exist, such as ``ground.tfw`` of ``ground.tif``."""
    kind = path.suffix[1:].lower()
    ends = dict.fromkeys((f"{kind[0]}{kind[-1]}w", f"{kind}w", "wld"))
    names = dict.fromkeys(path.with_suffix(f".{end}") for low in ends for end in (low, low.upper()))
    return [file for file in names if is_file(file)]


def files_beside(path: Path) -> tuple[Path, ...]:
    """The files beside `path` that exist and are read with it, or are refused: of a GeoTIFF and of a glTF."""
    kind = path.suffix.lower()
    if kind in _TIFF:
        noted = (path.with_name(path.name + end) for end in (NOTED_BESIDE, ".msk"))
        return (*filter(is_file, (*noted, path.with_suffix(".prj"))), *world_files(path))
    if kind != ".gltf":
        return ()
    try:
        tree = json.loads(path.read_bytes())
        uris = [
            unquote(str(part["uri"])) for key in ("buffers", "images") for part in tree.get(key, ()) if "uri" in part
        ]
    except (OSError, ValueError, AttributeError, TypeError):
        return ()  # reported by the function that reads it
    return tuple(file for uri in uris if not uri.startswith("data:") and is_file(file := path.parent / uri))
