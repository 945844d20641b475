"""Changes of a site during a recording that a scene file cannot express: in words, many of a kind in one sentence."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

_LISTED = 3  # changes of a kind that get a sentence each, and names listed for more: as many as fit a line or two

ChangeKind = Literal["moved", "taken away", "put back"]

_ONE: dict[ChangeKind, str] = {
    "moved": "{name} was moved until {time:.2f} s; where it was before is left out",
    "taken away": "{name} was taken away at {time:.2f} s and is left out",
    "put back": "{name} was put back at {time:.2f} s; where it was before is left out",
}
_MANY: dict[ChangeKind, str] = {
    "moved": "{count} obstacles were moved until {last:.2f} s; where they were before is left out: {names}",
    "taken away": "{count} times between {first:.2f} and {last:.2f} s an obstacle was taken away and "
    "is left out: {names}",
    "put back": "{count} times between {first:.2f} and {last:.2f} s an obstacle was put back; "
    "where it was before is left out: {names}",
}


class Change(NamedTuple):
    """One change.

    Attributes
    ----------
    time: time from the beginning of the recording [s].
    name: name of the obstacle.
    kind: what happened to it.
    """

    time: float
    name: str
    kind: ChangeKind


def describe_changes(changes: Iterable[Change]) -> list[str]:
    """Changes in words: one sentence each if there are few of a kind, otherwise one sentence for all of a kind."""
    found: dict[ChangeKind, list[Change]] = {}
    for change in changes:
        found.setdefault(change.kind, []).append(change)
    return [text for kind, alike in found.items() for text in _describe(kind, alike)]


def _describe(kind: ChangeKind, changes: list[Change]) -> list[str]:
    if len(changes) <= _LISTED:
        return [_ONE[kind].format(name=change.name, time=change.time) for change in changes]
    names = list(dict.fromkeys(change.name for change in changes))
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    times = [change.time for change in changes]
    listed = ", ".join(names[:_LISTED]) + more
    return [_MANY[kind].format(count=len(changes), first=min(times), last=max(times), names=listed)]
