"""The provenance that a plan file states: the paths of its inputs, and the versions of the software that made it."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
from pathlib import Path

from backhoe_planner.native import native_version

_PACKAGES = ("backhoe_planner", "pin", "coal", "numpy")  # the numbers of a plan depend on these


def relative_path(path: Path, folder: Path | None) -> str:
    """A path relative to `folder`; unchanged if `folder` is None."""
    if folder is None:
        return str(path)
    try:
        return os.path.relpath(path.resolve(), folder.resolve())
    except ValueError:  # another drive
        return str(path.resolve())


def installed_versions() -> dict[str, str]:
    """The versions of Python and of the packages that make a plan, as far as they are installed and used."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    native = native_version()
    if native is not None:  # otherwise no number depends on it
        found["backhoe_planner_native"] = native
    return found
