"""The errors that misuse raises; expected outcomes are values instead.

    PlannerError
    +-- InputError (also ValueError)      something handed in from outside is wrong
        +-- RobotError                    the URDF, or a name in it
        +-- SceneError                    the scene file, or a file it names
        +-- PlanFileError                 the plan file
        +-- OutputError                   a result cannot be written where asked

A message says where (file and key), what was found, and what is allowed.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self


class PlannerError(Exception):
    """Root of every error that this package raises on purpose."""


class InputError(PlannerError, ValueError):
    """Something handed in from outside is wrong.

    Parameters
    ----------
    problem: one sentence saying what is wrong.
    file: the file in which it stands.
    key: the place in the file, such as ``obstacles[2].radius``.
    found, allowed: what stands there, and what may stand there.
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
        if allowed is not None:
            text += f"; allowed: {allowed}"
        if hint is not None:
            text += f" ({hint})"
        super().__init__(text)

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

        Parameters
        ----------
        problem, file, key: as of the class.
        name: what was found.
        names: all that is allowed.
        other_words: words that are not allowed, and the name to suggest where one of them was meant.
        """
        known = list(names)
        near = nearest_name(name, (*known, *other_words))
        hint = f"did you mean {other_words.get(near, near)!r}?" if near else None
        return cls(problem, file=file, key=key, found=name, allowed=", ".join(known) or "none", hint=hint)


class RobotError(InputError):
    """The URDF cannot be used, or a name is not in it."""


class SceneError(InputError):
    """The scene file, or a file it names, cannot be used."""


class PlanFileError(InputError):
    """The plan file cannot be read."""


class OutputError(InputError):
    """A result cannot be written where it was asked for."""


def nearest_name(name: str, names: Iterable[str]) -> str | None:
    """The entry of `names` that is most similar to `name`; None where none is similar."""
    close = difflib.get_close_matches(name, list(names), n=1)
    return close[0] if close else None
