"""The provenance that a plan file states: the paths of its inputs, and the versions of the software that made it."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path

from backhoe_planner.native import native_version

# packages on which the numbers of a plan depend, and their modules, which tell the version sooner than their metadata
_PACKAGES = {"backhoe_planner": "backhoe_planner", "pin": "pinocchio", "coal": "coal", "numpy": "numpy"}


def relative_path(path: Path, folder: Path | None) -> str:
    """A path relative to `folder`; unchanged if `folder` is None."""
    if folder is None:
        return str(path)
    try:
        return os.path.relpath(path.resolve(), folder.resolve())
    except ValueError:  # another drive
        return str(path.resolve())


def installed_versions() -> dict[str, str]:
    """The versions of Python and of the packages that make a plan, as far as they are in use."""
    found = {"python": platform.python_version()}
    for name, module in _PACKAGES.items():
        if module in sys.modules:
            found[name] = sys.modules[module].__version__
    native = native_version()
    if native is not None:  # otherwise no number depends on it
        found["backhoe_planner_native"] = native
    return found
