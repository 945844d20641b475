"""A web server that keeps few connections: silent ones are closed after a while, and the oldest when there are many.

Each connection takes one of the process's descriptors, of which there are often only some
hundred; a file cannot be opened when none is left. Connections of open pages are counted and
limited by themselves (`LiveServer.full`).
"""

from __future__ import annotations

import resource
from typing import Any

import tornado.httpserver
import tornado.iostream
import tornado.web

_MOST = 48  # connections without a page: a browser opens up to 6 to load one
_PART = 0.25  # of the descriptors that the process may have, at most
_IDLE = 10.0  # s without a request, or in the middle of one; a browser sends it at once, and connects anew


class CappedServer(tornado.httpserver.HTTPServer):
    """See the module.

    Parameters
    ----------
    application: what is served.
    max_body_size: of a request [bytes].
    """

    def initialize(self, application: tornado.web.Application, *, max_body_size: int) -> None:  # type: ignore[override]
        """Take what tornado's own constructor hands on."""
        super().initialize(application, idle_connection_timeout=_IDLE, body_timeout=_IDLE, max_body_size=max_body_size)
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        self._most = _MOST if soft == resource.RLIM_INFINITY else max(1, min(_MOST, int(_PART * soft)))
        self._plain: list[tornado.iostream.IOStream] = []

    def handle_stream(self, stream: tornado.iostream.IOStream, address: Any) -> None:
        """Take a new connection; of too many without a page the one that has been open longest is closed."""
        self._plain = [known for known in self._plain if not known.closed()]
        while len(self._plain) >= self._most:
            self._plain.pop(0).close()
        self._plain.append(stream)
        super().handle_stream(stream, address)

    def keep(self, stream: tornado.iostream.IOStream | None) -> None:
        """Count a connection no longer: it is that of a page."""
        if stream in self._plain:
            self._plain.remove(stream)
