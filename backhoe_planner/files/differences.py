"""The differences between the figures in a file and those recomputed from its content."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any

_TOLD = 5  # differences that are listed one by one; chosen
SAME_FIGURE = 1e-6  # part of a figure, or of 1 in its unit: rounding of another computer's libraries


def differences(
    said: Mapping[str, Any], found: Mapping[str, Any], *, left_out: Mapping[str, Collection[str]]
) -> list[str]:
    """The figures of a file that differ from the computed ones, in words and with their keys; empty if there are none.

    If there are many, the first ones and the number of the others.

    Parameters
    ----------
    said: read from the file.
    found: computed from its motions, with the same keys.
    left_out: by the name of a key, the keys below it that are not compared.
    """
    lines = [line for key in said for line in _compared(said[key], found[key], key, key, left_out)]
    more = [f"and {len(lines) - _TOLD} figures more"] if len(lines) > _TOLD else []
    return lines[:_TOLD] + more


def _compared(
    said: Any, found: Any, key: str, name: str, left_out: Mapping[str, Collection[str]]
) -> Iterator[str]:  # fmt: skip
    if isinstance(said, dict) and isinstance(found, dict):
        for each in (one for one in said if one not in left_out.get(name, ())):
            yield from _compared(said[each], found.get(each), f"{key}.{each}", each, left_out)
    elif isinstance(said, list) and isinstance(found, list) and len(said) == len(found):
        for index, (a, b) in enumerate(zip(said, found, strict=True)):
            yield from _compared(a, b, f"{key}[{index}]", name, left_out)
    elif not _same(said, found):
        yield f"{key}: the file says {_brief(said)}, the motions have {_brief(found)}"


def _same(said: Any, found: Any) -> bool:
    if isinstance(said, float) and isinstance(found, float):
        return math.isclose(said, found, rel_tol=SAME_FIGURE, abs_tol=SAME_FIGURE) or (
            math.isnan(said) and math.isnan(found)
        )
    return bool(said == found)


def _brief(value: Any) -> str:
    if isinstance(value, list | dict):
        return f"{len(value)} entries"
    return f"{value:.6g}" if isinstance(value, float) else f"{value}"
