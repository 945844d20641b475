"""What has been drawn and told, as messages for the page in the browser.

A `Recording` stands where ``meshcat.Visualizer`` expects its window, so that drawing
needs no server: the messages go into a page, or to browsers that are connected. Of
several messages about the same thing only the last is kept.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

import meshcat
import umsgpack

__all__ = ["Key", "Message", "Recording"]

Key = tuple[str, str, str]
Message = bytes | str


class Recording:
    """Keeps the messages that lead to the present picture, in order.

    Drawing commands are bytes, for meshcat's viewer; what is told is JSON, for the
    page around it. One thread may write while others read.

    Parameters
    ----------
    listener: is handed every message as it comes.
    """

    def __init__(self, listener: Callable[[Key, Message], None] | None = None) -> None:
        self._messages: dict[Key, Message] = {}
        self._listener = listener
        self._lock = threading.Lock()

    def messages(self) -> list[tuple[Key, Message]]:
        """All that a browser needs to show the present picture."""
        with self._lock:
            return list(self._messages.items())

    def visualizer(self) -> Any:
        """A ``meshcat.Visualizer`` that draws into this recording, at the root of the tree."""
        return meshcat.Visualizer(window=self)["/"]

    def send(self, command: Any) -> None:
        """Take a meshcat command."""
        content = command.lower()
        kind, path = str(content["type"]), str(content["path"])
        message = umsgpack.packb(content)
        key = (kind, path, str(content.get("property", "")))
        if kind == "delete":
            below = path.rstrip("/") + "/"
            with self._lock:
                for other in [k for k in self._messages if k[1] == path or k[1].startswith(below)]:
                    del self._messages[other]
        else:
            self._keep(key, message)
        if self._listener is not None:
            self._listener(key, message)

    def tell(self, content: dict[str, Any]) -> None:
        """Tell the page something; `content` names its kind under ``type``."""
        key = ("tell", str(content["type"]), "")
        message = json.dumps(content, allow_nan=False, separators=(",", ":"))
        self._keep(key, message)
        if self._listener is not None:
            self._listener(key, message)

    def forget(self, kind: str) -> None:
        """No longer tell what was told under this kind."""
        with self._lock:
            self._messages.pop(("tell", kind, ""), None)

    def _keep(self, key: Key, message: Message) -> None:
        with self._lock:
            self._messages.pop(key, None)  # the last one also comes last
            self._messages[key] = message
