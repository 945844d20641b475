"""Serves the live page, and sends to every open page what is drawn.

The server runs in a thread of this process: nothing is left behind when the process ends,
and giving it a message costs microseconds. Messages do not pile up for a slow browser: of
several about the same thing only the newest waits.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import socket
import threading
import time
from typing import Any
from urllib.parse import urlsplit

import tornado.httpserver
import tornado.web
import tornado.websocket

from backhoe_planner.errors import OutputError
from backhoe_planner.show.page.display import Display, Key, Message, Messages
from backhoe_planner.show.page.page import live_page

_FIRST_PORT, _PORTS = 7000, 100  # meshcat's own server begins at the same port; how many are tried is chosen
_FLUSH_EVERY = 0.02  # s between deliveries; chosen, less than a frame
_LARGEST_MESSAGE = 4 << 20  # bytes that a page may send at once; chosen, a driving one sends some hundred
_MOST_PAGES = 64  # chosen: each costs memory for what waits for it
_MESSAGES_PER_SECOND, _MESSAGES_AT_ONCE = 500.0, 1000.0  # that a page may send; chosen, a driving one needs some 60
_MOST_UNREAD = 1 << 20  # bytes of answers that a page may leave unread; chosen, thousands of answers
_FAREWELL = 0.5  # s for a page that is shut out to read why; chosen


class LivePage(tornado.web.RequestHandler):
    """The page itself."""

    def initialize(self, page: str, server: LiveServer) -> None:
        """Take what the route gives."""
        self.page, self.server = page, server

    def prepare(self) -> None:
        """Refuse requests by a name that is not this server's."""
        if not self.server.answers_to(self.request.host):
            raise tornado.web.HTTPError(403)

    def get(self) -> None:
        """Answer with the page."""
        self.set_header("Cache-Control", "no-store")
        self.finish(self.page)


class LiveSocket(tornado.websocket.WebSocketHandler):
    """The connection to one page, through which drawings and numbers are sent."""

    def prepare(self) -> None:
        """Refuse requests by another name, from other pages, and beyond the greatest number of pages."""
        origin = self.request.headers.get("Origin")
        if not self.server.answers_to(self.request.host) or not (origin is None or self.check_origin(origin)):
            raise tornado.web.HTTPError(403)
        if self.server.full:
            raise tornado.web.HTTPError(503)

    def check_origin(self, origin: str) -> bool:
        """Whether a page from `origin` may connect: only this server's own."""
        try:
            found = urlsplit(origin)
        except ValueError:  # no address at all
            return False
        return found.scheme in ("http", "https") and found.netloc.lower() == self.request.host.lower()

    def initialize(self, server: LiveServer) -> None:
        """Take what the route gives."""
        self.server = server
        self.waiting = Messages()
        self._shut_out = False
        self._unread = 0
        self._may_send, self._counted_at = _MESSAGES_AT_ONCE, time.monotonic()

    def open(self, *_args: str, **_kwargs: str) -> None:
        """A page has connected."""
        self.set_nodelay(True)
        self.server.add(self)

    def on_message(self, message: str | bytes) -> None:
        """A page says that it has drawn the picture. Other messages are ignored."""
        if self.accepts() and message == "drawn":
            self.server.somebody_watches.set()

    def on_close(self) -> None:
        """A page has gone."""
        self.server.remove(self)

    def send_waiting(self) -> None:
        """Send the messages that wait, unless the browser is still busy with earlier ones."""
        connection = self.ws_connection
        if not self.waiting or connection is None or connection.stream is None or connection.stream.writing():
            return
        messages, self.waiting = self.waiting, Messages()
        for message in messages.values():
            if not self.send(message):
                return

    def accepts(self) -> bool:
        """Count a message that came, and say whether to follow it. A page that sends too many is shut out."""
        if self._shut_out:
            return False
        now = time.monotonic()
        more = _MESSAGES_PER_SECOND * (now - self._counted_at)
        self._may_send, self._counted_at = min(self._may_send + more, _MESSAGES_AT_ONCE) - 1.0, now
        if self._may_send < 0.0:
            self.shut_out("too many messages")
            return False
        return True

    def answer(self, content: dict[str, Any]) -> None:
        """Send something to this page alone. A page that does not read its answers is shut out."""
        if self._shut_out:
            return
        if self._unread > _MOST_UNREAD:
            self.shut_out("answers are not read")
        else:
            self.send(json.dumps(content, allow_nan=False), answer=True)

    def shut_out(self, reason: str) -> None:
        """End the connection: for incoming messages at once, for outgoing ones soon, so that `reason` is read."""
        self._shut_out = True
        connection = self.ws_connection
        self.close(1008, reason)
        stream = None if connection is None else connection.stream
        if stream is not None:
            asyncio.get_running_loop().call_later(_FAREWELL, stream.close)
        self.on_close()

    def send(self, message: Message, *, answer: bool = False) -> bool:
        """Send a message; False where the page has gone, and `on_close` follows."""
        size = len(message) if answer else 0
        try:
            written = asyncio.ensure_future(self.write_message(message, binary=isinstance(message, bytes)))
        except tornado.websocket.WebSocketClosedError:
            return False
        self._unread += size

        def read(done: asyncio.Future[None]) -> None:
            self._unread -= size
            if not done.cancelled():
                done.exception()  # if the page has gone meanwhile, on_close follows

        written.add_done_callback(read)
        return True


class LiveServer:
    """A web server in a thread of its own.

    Parameters
    ----------
    host: the address on which it listens; by default this machine alone can connect.
    port: where it listens; None takes the first free one from 7000 on, 0 any free one.

    Attributes
    ----------
    display: what is drawn on it, the pages show.
    url: address of the page.
    somebody_watches: set while at least one page is open that has drawn the picture.
    left_at: when the last page was closed, by `time.monotonic` [s]; None while one is open, or none was yet.

    Raises
    ------
    OutputError: the port is in use.
    """

    def __init__(self, *, host: str = "127.0.0.1", port: int | None = None) -> None:
        self.display = Display(self._post)
        self.somebody_watches = threading.Event()
        self.left_at: float | None = None
        self._pages: set[LiveSocket] = set()
        self._fresh: list[tuple[Key, Message]] = []
        self._lock = threading.Lock()
        self._host = host
        self._listening = _listen(host, port)
        number = self._listening.getsockname()[1]
        self.url = f"http://{'127.0.0.1' if host in ('', '0.0.0.0') else host}:{number}/"
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="live view", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close every page's connection and end the thread. May be called again."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(timeout=5.0)

    def add(self, page: LiveSocket) -> None:
        """Take in a page that has connected, and bring it up to date."""
        page.waiting = self.display.messages()
        self._pages.add(page)
        self.left_at = None

    def remove(self, page: LiveSocket) -> None:
        """Forget a page that has gone."""
        self._pages.discard(page)
        if not self._pages:
            self.left_at = time.monotonic()
            self.somebody_watches.clear()

    def answers_to(self, host: str) -> bool:
        """Whether a request's Host header names this server.

        The owner of another name can make it point to this machine. A page from there would then
        count as one of this server.
        """
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:  # no address at all
            return False
        if name in ("localhost", self._host, socket.gethostname().lower()):
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or self._host in ("", "0.0.0.0", "::") or name == self._host

    def routes(self) -> list[Any]:
        """The addresses that are served, as tornado's rules."""
        return [("/", LivePage, {"page": live_page(), "server": self}), ("/socket", LiveSocket, {"server": self})]

    @property
    def full(self) -> bool:
        """Whether no further page may connect."""
        return len(self._pages) >= _MOST_PAGES

    @property
    def running(self) -> bool:
        """Whether it has not been closed."""
        return self._thread.is_alive()

    def _post(self, key: Key, message: Message) -> None:
        with self._lock:
            self._fresh.append((key, message))

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.run_until_complete(self._loop.shutdown_default_executor())
            self._loop.close()

    async def _serve(self) -> None:
        application = tornado.web.Application(
            self.routes(),
            log_function=lambda handler: None,
            websocket_max_message_size=_LARGEST_MESSAGE,
            websocket_ping_interval=5,
            compress_response=True,
        )
        server = tornado.httpserver.HTTPServer(application)
        server.add_socket(self._listening)
        while not self._stop.is_set():
            self._deliver()
            try:
                await asyncio.wait_for(self._stop.wait(), _FLUSH_EVERY)
            except asyncio.TimeoutError:
                continue
        self._deliver()
        server.stop()
        for page in list(self._pages):
            page.close()
        await server.close_all_connections()

    def _deliver(self) -> None:
        with self._lock:
            fresh, self._fresh = self._fresh, []
        for page in list(self._pages):
            for key, message in fresh:
                page.waiting.put(key, message)
            page.send_waiting()


def _listen(host: str, port: int | None) -> socket.socket:
    tried: Any = range(_FIRST_PORT, _FIRST_PORT + _PORTS) if port is None else [port]
    for number in tried:
        try:
            listening = socket.create_server((host, number), backlog=_MOST_PAGES)
        except OSError as error:
            if port is not None:
                raise OutputError("the port cannot be used", key="port", found=port, hint=str(error)) from error
            continue
        listening.setblocking(False)
        return listening
    raise OutputError("no free port", key="port", allowed=f"{_FIRST_PORT} to {_FIRST_PORT + _PORTS - 1}")
