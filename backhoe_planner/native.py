"""Compiled versions of some functions on arrays, used if the package `backhoe_planner_native` is installed.

The arithmetic that runs at every step of a motion, or in every round of a search, is in functions that take and
return only arrays and numbers. Each is written in plain Python in the module where it belongs, and marked so:

    @compiled
    def bounds_after(lower, travel, q_0, q, /): ...

and in C under the same name, in the folder `native` of the source. The marked function is the compiled one if
the installed package has it. The plain version defines what is computed, is the reference in the tests of the
compiled one, and runs if there is no compiled one. Both give the same results to rounding.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, TypeVar, cast

_PACKAGE = "backhoe_planner_native"
_INTERFACE = 20  # version of the functions' interface, in Python and C; increased if arguments or results change
_PLAIN_ONLY = "BACKHOE_PLANNER_PLAIN"  # if set in the environment, the compiled versions are not used

_Function = TypeVar("_Function", bound=Callable[..., Any])


@cache
def find_compiled() -> ModuleType | None:
    """The package of compiled functions; None if it is not installed, has another interface, or is not wanted.

    It is looked for only once, when the first function is marked, because it loads numpy.
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
    """The compiled version of a function if the installed package has one, otherwise the function itself."""
    _plain[plain.__name__] = plain
    found = find_compiled()
    if found is None:
        return plain
    found.plain[plain.__name__] = plain  # called when the compiled one has no room for so many joints
    return cast(_Function, getattr(found, plain.__name__, plain))


def is_compiled(function: Callable[..., Any]) -> bool:
    """Whether a marked function runs compiled; if not, another library may be quicker than its plain version."""
    return _plain[function.__name__] is not function


def plain_versions() -> dict[str, Callable[..., Any]]:
    """The plain versions of the marked functions of all modules that are loaded, by name."""
    return dict(_plain)


def native_version() -> str | None:
    """The version of the compiled functions that are in use; None if everything runs in plain Python."""
    import importlib.metadata  # imported here because it takes long to load

    if find_compiled() is None:
        return None
    try:
        return importlib.metadata.version(_PACKAGE)
    except importlib.metadata.PackageNotFoundError:  # built in place
        return "unknown"
