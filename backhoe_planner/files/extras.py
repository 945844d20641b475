"""Packages that only some functions need: if one is missing, the message says what to install."""

from __future__ import annotations

import importlib.util

from backhoe_planner.errors import InputError


def need_package(package: str, *, extra: str, what: str) -> None:
    """Check that a package of an extra is installed.

    Parameters
    ----------
    package: its name in import statements.
    extra: the extra of this package that installs it.
    what: what needs it, for the message, in the plural: ``studies``.

    Raises
    ------
    InputError: it is not installed.
    """
    if importlib.util.find_spec(package) is None:
        raise InputError(f"{what} need {package}", hint=f'pip install "backhoe_planner[{extra}]"')
