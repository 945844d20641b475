"""Brings a session to pages in the browser, and what they say to the session."""

from __future__ import annotations

from typing import Any

from backhoe_planner.show.page.page import live_page, read_parts
from backhoe_planner.show.teleop.session import Session
from backhoe_planner.show.viewer.live_server import LivePage, LiveServer, LiveSocket

__all__ = ["TeleopServer"]


class _Socket(LiveSocket):
    server: TeleopServer
    page = 0

    def open(self, *args: str, **kwargs: str) -> None:
        super().open(*args, **kwargs)
        self.page = self.server.session.join()
        self.answer({"type": "you", "page": self.page})

    def on_message(self, message: str | bytes) -> None:
        if message == "drawn":
            super().on_message(message)
        elif self.heeds():
            self.answer(self.server.session.hear(self.page, message))

    def on_close(self) -> None:
        self.server.session.leave(self.page)
        super().on_close()


class TeleopServer(LiveServer):
    """A web server in a thread of its own; see `LiveServer`.

    Parameters
    ----------
    session: that the pages watch and drive.
    """

    def __init__(self, session: Session, *, host: str = "127.0.0.1", port: int | None = None) -> None:
        self.session = session
        super().__init__(host=host, port=port)

    def routes(self) -> list[Any]:
        """What is served; tornado's rules."""
        css, body, script = read_parts("backhoe_planner.show.teleop", "teleop.css", "teleop.html", "teleop.js")
        page = live_page(css=css, body=body, script=script)
        return [
            ("/", LivePage, {"page": page, "server": self}),
            ("/socket", _Socket, {"server": self}),
        ]
