"""Drawing commands and figures as messages for the page in the browser.

``meshcat.Visualizer`` accepts a `Display` in place of its window, so that drawing needs no server: the messages go
into a page, or to the connected browsers.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import meshcat
import numpy as np
import umsgpack

Key = tuple[str, str, str]  # the subject of a message: its kind, a path or a name, a property
Message = bytes | str

_DIGITS = 4  # after the point; chosen, 0.1 mm, 0.1 ms and 0.006 degrees are finer than what a page shows


class Messages(dict[Key, Message]):
    """Only the newest of several messages about the same thing, in the order in which they came."""

    def put(self, key: Key, message: Message) -> None:
        """Keep a message. If it deletes a node, it replaces all messages about that node and those below it."""
        kind, path, _ = key
        if kind == "delete":
            below = path.rstrip("/") + "/"
            for other in [k for k in self if k[1] == path or k[1].startswith(below)]:
                del self[other]
        self.pop(key, None)  # the newest one also comes last
        self[key] = message


class Display:
    """Keeps the messages that make up the present picture.

    Drawing commands are bytes, for meshcat's viewer; figures are JSON, for the page around it.
    One thread may write while others read.

    Parameters
    ----------
    listener: called with every message when it comes.
    """

    def __init__(self, listener: Callable[[Key, Message], None] | None = None) -> None:
        self._messages = Messages()
        self._listener = listener
        self._lock = threading.Lock()

    def messages(self) -> Messages:
        """All messages that a browser needs to show the present picture."""
        with self._lock:
            return Messages(self._messages)

    def visualizer(self) -> Any:
        """A ``meshcat.Visualizer`` that draws on this display, at the root of its tree."""
        return meshcat.Visualizer(window=self)["/"]

    def send(self, command: Any) -> None:
        """Accept a meshcat command."""
        content = command.lower()
        key = (str(content["type"]), str(content["path"]), str(content.get("property", "")))
        self._post(key, umsgpack.packb(content))

    def tell(self, kind: str, content: Mapping[str, Any]) -> None:
        """Send the page a message of a `kind`, which replaces the last one of this kind; values as for `plain`."""
        text = json.dumps(plain({"type": kind, **content}), allow_nan=False, separators=(",", ":"))
        self._post(("tell", kind, ""), text)

    def forget(self, *kinds: str) -> None:
        """Drop the messages of these kinds."""
        with self._lock:
            for kind in kinds:
                self._messages.pop(("tell", kind, ""), None)

    def _post(self, key: Key, message: Message) -> None:
        with self._lock:
            self._messages.put(key, message)
            if key[0] == "delete":
                del self._messages[key]  # a later browser has nothing to delete
        if self._listener is not None:
            self._listener(key, message)


def plain(value: Any) -> Any:
    """`value` in JSON types.

    Numbers are rounded; those that are not finite become null. Arrays, tuples and sets become lists, sets in sorted
    order. A record becomes an object with its fields.
    """
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, float):
        return round(value, _DIGITS) if math.isfinite(value) else None
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, (set, frozenset)):
        return [plain(part) for part in sorted(value)]
    return [plain(part) for part in value] if isinstance(value, (list, tuple)) else value
