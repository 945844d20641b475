"""Names of nodes in the viewer's tree."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["node_name", "node_names"]

# A slash would start a new level; the viewer keeps children in a plain JavaScript
# object, on which these names are taken before anything is added.
_SLASH = "\N{DIVISION SLASH}"
_TAKEN = frozenset(
    {
        "<object>",
        "__defineGetter__",
        "__defineSetter__",
        "__lookupGetter__",
        "__lookupSetter__",
        "__proto__",
        "constructor",
        "hasOwnProperty",
        "isPrototypeOf",
        "propertyIsEnumerable",
        "toLocaleString",
        "toString",
        "valueOf",
    }
)


def node_name(name: str) -> str:
    """`name` so that it can be one level of a path in the viewer's tree."""
    plain = name.replace("/", _SLASH).strip() or "_"
    return f"{plain}_" if plain in _TAKEN else plain


def node_names(names: Iterable[str]) -> dict[str, str]:
    """The node of every name; two names that would share one are kept apart."""
    found: dict[str, str] = {}
    used: set[str] = set()
    for name in names:
        node = node_name(name)
        number = 2
        while node in used:
            node = f"{node_name(name)} ({number})"
            number += 1
        used.add(node)
        found[name] = node
    return found
