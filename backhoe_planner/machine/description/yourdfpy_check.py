"""The check by yourdfpy of a URDF that names mesh files, done once for each text.

yourdfpy loads trimesh and its dependencies before it reads anything. The result that a URDF is valid is therefore
kept in the user's cache folder, for these bytes, this code and this version of yourdfpy.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
from pathlib import Path

from lxml import etree

from backhoe_planner.files.cache import caches, keep_entry, maker_digest, read_entry

_VALID = b"valid"


def check_by_yourdfpy(root: etree._Element) -> None:
    """Check the URDF below a `root`, unless yourdfpy found the same URDF valid before.

    Raises
    ------
    ValueError: it is not valid according to yourdfpy.
    """
    entry, key = None, b""
    with contextlib.suppress(OSError, RuntimeError, ImportError):  # `_ask` reports it; or there is no home
        maker = maker_digest(Path(__file__).parent, [Path(__file__).name], ["yourdfpy"])
        key = hashlib.sha256(maker + etree.tostring(root)).digest()
        entry = caches() / "read_by_yourdfpy" / f"{key.hex()}.urdf"
        if read_entry(entry, key) == _VALID:
            return
    _ask(root)
    if entry is not None:
        keep_entry(entry, key, _VALID)


def _ask(root: etree._Element) -> None:
    """Let yourdfpy read and check the URDF, with its log silenced."""
    import yourdfpy

    quiet = logging.getLogger("yourdfpy")
    level = quiet.level
    quiet.setLevel(logging.CRITICAL)
    try:
        read = yourdfpy.URDF(
            robot=yourdfpy.URDF._parse_robot(xml_element=root), build_scene_graph=False, load_meshes=False
        )
        valid, errors = read.validate(), read.errors
    except Exception as error:  # yourdfpy lets through any exception of its parsing
        raise ValueError(str(error)) from error
    finally:
        quiet.setLevel(level)
    if not valid:
        raise ValueError("; ".join(str(getattr(error, "msg", error)) for error in errors))
