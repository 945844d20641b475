"""A web server that keeps few connections: it closes silent ones after a while, and the oldest if there are too many.

Each connection takes one of the process's descriptors, of which there are often only some hundred; a file cannot be
opened if none is left. Connections of open pages are counted and limited separately (`LiveServer.full`).
"""

from __future__ import annotations

import resource
from typing import Any

import tornado.httpserver
import tornado.iostream
import tornado.web

_MOST = 48  # connections without a page: a browser opens up to 6 to load one
_PART = 0.25  # of the descriptors that the process may have, at most
_IDLE = 10.0  # s without a request, or during one; a browser sends it at once, and reconnects


class CappedServer(tornado.httpserver.HTTPServer):
    """A server with a limited number of connections; see the module.

    Parameters
    ----------
    application: the application that is served.
    max_body_size: greatest size of a request [bytes].
    """

    def initialize(self, application: tornado.web.Application, *, max_body_size: int) -> None:  # type: ignore[override]
        """Initialise with the arguments that tornado's own constructor passes on."""
        super().initialize(application, idle_connection_timeout=_IDLE, body_timeout=_IDLE, max_body_size=max_body_size)
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        self._most = _MOST if soft == resource.RLIM_INFINITY else max(1, min(_MOST, int(_PART * soft)))
        self._plain: list[tornado.iostream.IOStream] = []

    def handle_stream(self, stream: tornado.iostream.IOStream, address: Any) -> None:
        """Accept a new connection; if there are too many without a page, close the one that has been open longest."""
        self._plain = [known for known in self._plain if not known.closed()]
        while len(self._plain) >= self._most:
            self._plain.pop(0).close()
        self._plain.append(stream)
        super().handle_stream(stream, address)

    def keep(self, stream: tornado.iostream.IOStream | None) -> None:
        """Stop counting a connection, because it now belongs to a page."""
        if stream in self._plain:
            self._plain.remove(stream)
