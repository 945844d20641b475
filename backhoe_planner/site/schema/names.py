"""Names of obstacles and zones: one rule for the scene, the servo and the driving page; and titles of files."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from typing import Annotated

from pydantic import AfterValidator, Field

from backhoe_planner.errors import InputError

# reports and plan files write these before a link or a joint of the machine
_RESERVED = ("self: ", "the machine itself", "the limit of joint ")


def check_name(name: object, *, in_use: Mapping[str, str] | None = None, key: str | None = "name") -> str:
    """A name that an obstacle or a zone may have.

    Parameters
    ----------
    in_use: names already taken, each with its owner: ``{"swing": "a zone"}``.
    key: what the message calls the place.

    Raises
    ------
    InputError: it is no text, blank, more than a line, in use, or begins with words that reports use for the machine.
    """
    if not isinstance(name, str) or not name.strip() or not _is_printable(name) or name.startswith(_RESERVED):
        allowed = "one line of printable text that is not blank and does not begin with " + " or ".join(
            map(repr, _RESERVED)
        )
        raise InputError("is no name", key=key, found=repr(name), allowed=allowed)
    if in_use is not None and name in in_use:
        raise InputError(f"is the name of {in_use[name]}", key=key, found=name)
    return name


def _is_printable(text: str) -> bool:
    """Whether a text is one line that can be written: no control characters, no surrogates."""
    return not any(unicodedata.category(sign) in ("Cc", "Cs") for sign in text)


def _title(text: str) -> str:
    if not _is_printable(text):
        raise InputError("is no title", found=ascii(text), allowed="one line of printable text, or nothing")
    return text


def _of_a_record(name: str) -> str:
    return check_name(name, key=None)  # the reader of the record adds the place


Name = Annotated[str, Field(min_length=1), AfterValidator(_of_a_record)]
Title = Annotated[str, AfterValidator(_title)]
"""The title of a scene, a job or a study, in reports and on pages; may be empty."""
