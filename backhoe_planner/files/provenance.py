"""What a plan's file says of where it comes from: paths, and versions of what made it."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
from pathlib import Path

from backhoe_planner.native import native_version

_PACKAGES = ("backhoe_planner", "pin", "coal", "numpy")  # on which the numbers of a plan depend


def relative_path(path: Path, folder: Path | None) -> str:
    """A path as a file in `folder` names it; with None as it is."""
    if folder is None:
        return str(path)
    try:
        return os.path.relpath(path.resolve(), folder.resolve())
    except ValueError:  # another drive
        return str(path.resolve())


def installed_versions() -> dict[str, str]:
    """Of Python and of the packages that make a plan, as far as they are installed and used."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    native = native_version()
    if native is not None:  # else no number depends on it
        found["backhoe_planner_native"] = native
    return found
