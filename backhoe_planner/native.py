"""Compiled versions of some functions on arrays, where the package `backhoe_planner_native` is installed.

What runs at every step of a motion, or in every round of a search, has its arithmetic in functions that take and
return arrays and numbers alone. Each stands in plain Python where it belongs, marked so:

    @compiled
    def bounds_after(lower, travel, q_0, q, /): ...

and in C under the same name, in the folder `native` of the source. The marked function is the compiled one where
the installed package has it. Its plain version says what is computed, is what the compiled one is tested against, and
runs where there is none. Both give the same results to rounding.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, TypeVar, cast

_PACKAGE = "backhoe_planner_native"
_INTERFACE = 17  # of the functions, in both versions; counted up where one takes or returns something else
_PLAIN_ONLY = "BACKHOE_PLANNER_PLAIN"  # set in the environment, it leaves the compiled versions alone

_Function = TypeVar("_Function", bound=Callable[..., Any])


@cache
def find_compiled() -> ModuleType | None:
    """The package of compiled functions; None where it is not installed, is of another version, or is not wanted.

    It is looked for once, when the first function is marked: it loads numpy.
    """
    if os.environ.get(_PLAIN_ONLY):
        return None
    try:
        found = importlib.import_module(_PACKAGE)
    except ImportError:
        return None
    return found if getattr(found, "INTERFACE", None) == _INTERFACE else None


_plain: dict[str, Callable[..., Any]] = {}


def compiled(plain: _Function) -> _Function:
    """The compiled version of a function where the installed package has one, else the function itself."""
    _plain[plain.__name__] = plain
    found = find_compiled()
    if found is None:
        return plain
    found.plain[plain.__name__] = plain  # it answers where the compiled one has no room for so many joints
    return cast(_Function, getattr(found, plain.__name__, plain))


def plain_versions() -> dict[str, Callable[..., Any]]:
    """The plain versions of the marked functions of all modules that are loaded, by name."""
    return dict(_plain)


def native_version() -> str | None:
    """The version of the compiled functions that are in use; None where all runs in plain Python."""
    import importlib.metadata  # takes long to load

    if find_compiled() is None:
        return None
    try:
        return importlib.metadata.version(_PACKAGE)
    except importlib.metadata.PackageNotFoundError:  # built in place
        return "unknown"
