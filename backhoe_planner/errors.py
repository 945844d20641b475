"""The errors that misuse raises; expected outcomes are values instead.

    PlannerError
    +-- InputError (also ValueError)      something handed in from outside is wrong
        +-- RobotError                    the URDF, or a name in it
        +-- SceneError                    the scene file, or a file it names
        +-- StudyError                    the study file, or the folder of its results
        +-- PlanFileError                 the plan file
        +-- OutputError                   a result cannot be written where asked

A message says where (file and key), what was found, and what is allowed.
"""

from __future__ import annotations

import difflib
import os
import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from typing_extensions import Self

_Kind = TypeVar("_Kind")
_Called = TypeVar("_Called")
_LONG = 200  # characters; chosen
# part of the letters that two names must share, in order, for one to be suggested for the other; chosen: one wrong
# letter in four is accepted, a common ending with another word is not
_SIMILAR = 0.7
_MOST_NAMES, _NEAREST = 20, 8  # names listed in full, and the most similar ones of a longer list; chosen
_FEWEST_LETTERS = 3  # of a name that is cut short, such as pos; chosen


class PlannerError(Exception):
    """Root of every error that this package raises on purpose."""


class InputError(PlannerError, ValueError):
    """Something handed in from outside is wrong.

    Parameters
    ----------
    problem: one sentence that says what is wrong.
    file: the file that has the problem.
    key: the place in the file, such as ``obstacles[2].radius``.
    found, allowed: what is there, and what may be there.
    hint: what to do about it.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | Path | None = None,
        key: str | None = None,
        found: object = None,
        allowed: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.key = key
        self.found = found
        self.allowed = allowed
        self.hint = hint
        where = ": ".join(part for part in (self.file, key) if part)
        text = f"{where}: {problem}" if where else problem
        if found is not None:
            text += f"; found {found!r}" if not isinstance(found, str) else f"; found {found}"
        parts = [f"; allowed: {allowed}" if allowed is not None else "", f" ({hint})" if hint is not None else ""]
        # a hint after a long list would be overlooked
        text += "".join(parts if len(parts[0]) < _LONG else reversed(parts))
        super().__init__(text)

    @classmethod
    def of(cls, error: InputError, *, file: str | Path | None, key: str | None) -> Self:
        """The same problem, with what is found, allowed and to be done, at another place.

        Parameters
        ----------
        error: the error at the place where it was noticed.
        file, key: the place where it is to be mended, as for the class.
        """
        return cls(error.problem, file=file, key=key, found=error.found, allowed=error.allowed, hint=error.hint)

    @classmethod
    def unknown_name(
        cls,
        problem: str,
        name: str,
        *,
        names: Iterable[str],
        file: str | Path | None = None,
        key: str | None = None,
        other_words: Mapping[str, str] = MappingProxyType({}),
    ) -> Self:
        """The error for a `name` that is none of `names`; the message lists them and suggests the most similar one.

        Of a long list it has the most similar names, and how many others there are.

        Parameters
        ----------
        problem, file, key: as for the class.
        name: what was found.
        names: all names that are allowed.
        other_words: words that are not allowed, each with the name to suggest instead.
        """
        known = list(names)
        near = nearest_name(name, (*known, *other_words)) if isinstance(name, str) else None
        hint = f"did you mean {other_words.get(near, near)!r}?" if near else None
        found = name if isinstance(name, str) and name.strip() else reprlib.repr(name)
        return cls(problem, file=file, key=key, found=found, allowed=_listed(known, str(found)), hint=hint)


class RobotError(InputError):
    """The URDF cannot be used, or a name is not in it."""


class SceneError(InputError):
    """The scene file, or a file it names, cannot be used."""


class StudyError(InputError):
    """The study cannot be run as it is written, or its results cannot go into this folder."""


class PlanFileError(InputError):
    """The plan file cannot be read."""


class OutputError(InputError):
    """A result cannot be written to the requested place."""


def _listed(names: list[str], like: str) -> str:
    """The names in words; of many, the most similar ones and how many others there are."""
    if len(names) <= _MOST_NAMES:
        return ", ".join(names) or "none"
    near = difflib.get_close_matches(like, names, n=_NEAREST, cutoff=0.0)
    return f"{', '.join(near)} and {len(names) - len(near)} others"


def nearest_name(name: str, names: Iterable[str]) -> str | None:
    """The entry of `names` most similar to `name`, or the only one that begins with it; None if there is none."""
    names = list(names)
    close = difflib.get_close_matches(name, names, n=1, cutoff=_SIMILAR)
    if not close and len(name) >= _FEWEST_LETTERS:
        close = [one for one in names if one.startswith(name)]
    return close[0] if len(close) == 1 else None


def check_kind(value: Any, kind: type[_Kind], *, key: str) -> _Kind:
    """`value`, which must be a `kind`.

    Raises
    ------
    InputError: it is something else; the message names it by `key`.
    """
    if isinstance(value, kind):
        return value
    raise InputError(f"is not a {kind.__name__}", key=key, found=reprlib.repr(value), allowed=f"a {kind.__name__}")


def check_flag(value: Any, *, key: str) -> bool:
    """`value`, which must be true or false.

    Raises
    ------
    InputError: it is something else; the message names it by `key`.
    """
    if type(value).__name__ in ("bool", "bool_"):  # numpy's too, without importing it here
        return bool(value)
    raise InputError("is neither true nor false", key=key, found=reprlib.repr(value), allowed="True, False")


def check_callable(value: _Called, *, key: str) -> _Called:
    """`value`, which must be callable, or None.

    Raises
    ------
    InputError: it is something else; the message names it by `key`.
    """
    if value is None or callable(value):
        return value
    raise InputError("cannot be called", key=key, found=reprlib.repr(value))


def check_path(value: Any, *, key: str) -> Path:
    """`value` as a file path.

    Raises
    ------
    InputError: it is neither text nor a path; the message names it by `key`.
    """
    if isinstance(value, (str, os.PathLike)) and "\0" not in str(value):
        return Path(value)
    raise InputError("is not a path", key=key, found=reprlib.repr(value), allowed="text or a path")
