"""Serves the live page, and sends what is drawn to every open page.

The server runs in a thread of this process: nothing is left behind when the process ends, and passing a message to
it takes microseconds. Messages do not pile up for a slow browser: of several messages about the same thing, only
the newest is kept, and a page gets further ones only once it has processed most of the earlier ones. So a slow page
shows the present, at fewer frames a second.
"""

from __future__ import annotations

import asyncio
import json
import secrets
import threading
import time
from typing import Any

import tornado.web
import tornado.websocket

from backhoe_planner.errors import InputError
from backhoe_planner.show.page.display import Display, Key, Message, Messages
from backhoe_planner.show.page.page import live_page
from backhoe_planner.show.viewer.address import find_address
from backhoe_planner.show.viewer.connections import CappedServer
from backhoe_planner.show.viewer.entrance import Login, NotFound, OwnPages
from backhoe_planner.show.viewer.password import Password

_FLUSH_EVERY = 0.02  # s between deliveries; chosen, less than a frame
_LARGEST_MESSAGE = 4 << 20  # bytes that a page may send at once; chosen, a driving page sends some hundred
_LARGEST_BODY = 4096  # bytes of a posted form; chosen, it contains only a password
_MOST_PAGES = 64  # chosen: each page takes memory for its waiting messages
_MESSAGES_PER_SECOND, _MESSAGES_AT_ONCE = 500.0, 1000.0  # that a page may send; chosen, a driving page needs some 60
_MOST_UNREAD = 1 << 20  # bytes of answers that a page may leave unread; chosen, thousands of answers
_PING_EVERY = 60.0  # s; a page that answers none for as long is closed; chosen, a slow browser may be busy for 15 s
_MOST_UNSHOWN = 3  # deliveries that a page may have yet to process; chosen, 30 a second reach it over a slow network
_DELIVERED = json.dumps({"type": "delivered"})  # ends each delivery, and the page answers "shown"
_ENDED = 1001  # the code of WebSocket for a server that goes away; the page then says so
_FAREWELL = 0.5  # s for a rejected page to read the reason; chosen


class LivePage(OwnPages):
    """The page itself."""

    def initialize(self, page: str, server: LiveServer) -> None:
        """Store the arguments of the route."""
        self.page, self.server = page, server

    def get(self) -> None:
        """Answer with the page, or ask for the password first."""
        if self.may_enter:
            self.finish(self.page)
        else:
            self.redirect("/login", status=303)


class LiveSocket(OwnPages, tornado.websocket.WebSocketHandler):
    """The connection to one page, through which drawings and numbers are sent."""

    server: LiveServer

    def prepare(self) -> None:
        """Also refuse browsers that have not given the password, and those beyond the greatest number of pages."""
        super().prepare()
        if not self.may_enter:
            raise tornado.web.HTTPError(403)
        if self.server.full:
            raise tornado.web.HTTPError(503)

    def initialize(self, server: LiveServer) -> None:
        """Store the arguments of the route."""
        self.server = server
        self.waiting = Messages()
        self._shut_out = False
        self._unread = self._unshown = 0
        self._heard_at = time.monotonic()
        self._may_send, self._counted_at = _MESSAGES_AT_ONCE, time.monotonic()

    def open(self, *_args: str, **_kwargs: str) -> None:
        """Register a page that has connected."""
        self.set_nodelay(True)
        self.answer({"type": "program", "id": self.server.identity})
        self.server.add(self)

    def on_message(self, message: str | bytes) -> None:
        """Note what the page reports of itself, and handle everything else as a request."""
        if not self.accepts():
            return
        if message == "drawn":
            self.server.somebody_watches.set()
        elif message == "shown":
            self._unshown = max(self._unshown - 1, 0)
        else:
            self.handle(message)

    def handle(self, message: str | bytes) -> None:
        """Do what a page requests. A page that only shows has no requests, and what it sends is ignored."""

    @property
    def silent_for(self) -> float:
        """Time since anything came from the page [s]."""
        return time.monotonic() - self._heard_at

    def on_close(self) -> None:
        """Remove a page that has disconnected."""
        self.server.remove(self)

    def send_waiting(self) -> None:
        """Send the waiting messages, unless the browser is still busy with earlier ones."""
        connection = self.ws_connection
        if not self.waiting or connection is None or connection.stream is None or connection.stream.writing():
            return
        if self._unshown >= _MOST_UNSHOWN:
            return
        messages, self.waiting = self.waiting, Messages()
        self._unshown += 1
        for message in (*messages.values(), _DELIVERED):
            if not self.send(message):
                return

    def accepts(self) -> bool:
        """Count an incoming message, and say whether to process it. A page that sends too many is disconnected."""
        if self._shut_out:
            return False
        now = self._heard_at = time.monotonic()
        more = _MESSAGES_PER_SECOND * (now - self._counted_at)
        self._may_send, self._counted_at = min(self._may_send + more, _MESSAGES_AT_ONCE) - 1.0, now
        if self._may_send < 0.0:
            self.shut_out("too many messages")
            return False
        return True

    def answer(self, content: dict[str, Any]) -> None:
        """Send something to this page alone. A page that does not read its answers is disconnected."""
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
        """Send a message; False if the page has disconnected, and `on_close` follows."""
        size = len(message) if answer else 0
        try:
            written = asyncio.ensure_future(self.write_message(message, binary=isinstance(message, bytes)))
        except tornado.websocket.WebSocketClosedError:
            return False
        self._unread += size

        def read(done: asyncio.Future[None]) -> None:
            self._unread -= size
            if not done.cancelled():
                done.exception()  # if the page has disconnected in the meantime, on_close follows

        written.add_done_callback(read)
        return True


class LiveServer:
    """A web server in a thread of its own.

    Other computers can connect only if the caller says who may: with `password` or with `allow_anyone`. The
    connection is not encrypted.

    Parameters
    ----------
    host: the address on which it listens, a name, IPv4 or IPv6; by default only this computer can connect.
    port: the port on which it listens; None takes the first free one from 7000 on, 0 any free one.
    password: the password that a browser must give before it sees anything.
    allow_anyone: whether everybody who can reach `host` may connect without a password.

    Attributes
    ----------
    display: the drawing that the pages show.
    url: address of the page.
    url_from_elsewhere: its address for other computers; None if none can connect.
    openness: who can connect, and what they can do, in words.
    identity: a random word, by which a page that connects again recognises the program.
    somebody_watches: set while at least one page is open that has drawn the picture.
    left_at: when the last page was closed, by `time.monotonic` [s]; None while one is open, or before the first.

    Raises
    ------
    InputError: other computers can connect, and neither a password nor `allow_anyone` is given; `host` is not an
        address of this computer; the password is empty.
    OutputError: the port is in use.
    """

    opens = "see what is shown"  # for whoever connects

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        password: str | None = None,
        allow_anyone: bool = False,
    ) -> None:
        self._address = find_address(host)
        self.password = None if password is None else Password(password)
        if self.password is not None and allow_anyone:
            raise InputError("has no effect together with allow_anyone", key="password", hint="give one of the two")
        if not (self._address.is_of_this_computer_alone or self.password is not None or allow_anyone):
            raise InputError(
                f"everybody who can reach this address over the network could {self.opens}", key="host", found=host,
                allowed="127.0.0.1 or ::1, which only this computer can reach; any other with --password WORD or "
                "--allow-anyone (in Python: password=..., allow_anyone=True)",
            )  # fmt: skip
        self.display = Display(self._post)
        self.identity = secrets.token_hex(8)
        self.somebody_watches = threading.Event()
        self.left_at: float | None = None
        self._pages: set[LiveSocket] = set()
        self._fresh: list[tuple[Key, Message]] = []
        self._lock = threading.Lock()
        self._connections: CappedServer | None = None
        self._listening = self._address.listen(port, backlog=_MOST_PAGES)
        number = self._listening.getsockname()[1]
        self.url, self.url_from_elsewhere = self._address.url(number), self._address.url_from_elsewhere(number)
        self.cookie = f"backhoe_planner_{number}"  # browsers do not distinguish cookies of different ports
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
        """Register a page that has connected, and bring it up to date."""
        page.waiting = self.display.messages()
        self._pages.add(page)
        if self._connections is not None and page.ws_connection is not None:
            self._connections.keep(page.ws_connection.stream)
        self.left_at = None

    def remove(self, page: LiveSocket) -> None:
        """Remove a page that has disconnected."""
        self._pages.discard(page)
        if not self._pages:
            self.left_at = time.monotonic()
            self.somebody_watches.clear()

    def answers_to(self, host: str) -> bool:
        """Whether a request's Host header names this server; see `Address.answers_to`."""
        return self._address.answers_to(host)

    @property
    def openness(self) -> str:
        """Who can connect, and what they can do, in words."""
        if self._address.is_of_this_computer_alone:
            who = "only this computer can connect"
            return who if self.password is None else f"{who}, with the password"
        if self.password is None:
            return f"everybody who can reach this computer over the network can {self.opens}, without a password"
        return (
            f"everybody on the network who knows the password can {self.opens}; the connection is not encrypted, "
            "so whoever can listen to the network can read the password"
        )

    def routes(self) -> list[Any]:
        """The served addresses, as tornado's rules."""
        return [("/", LivePage, {"page": live_page(), "server": self}), ("/socket", LiveSocket, {"server": self})]

    @property
    def pages(self) -> tuple[LiveSocket, ...]:
        """The open pages; for the server's thread."""
        return tuple(self._pages)

    @property
    def full(self) -> bool:
        """Whether no further page may connect."""
        return len(self._pages) >= _MOST_PAGES

    @property
    def running(self) -> bool:
        """Whether the server has not been closed."""
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
            [*self.routes(), ("/login", Login, {"server": self})],
            default_handler_class=NotFound,
            default_handler_args={"server": self},
            log_function=lambda handler: None,
            websocket_max_message_size=_LARGEST_MESSAGE,
            websocket_ping_interval=_PING_EVERY,
            compress_response=True,
        )
        server = self._connections = CappedServer(application, max_body_size=_LARGEST_BODY)
        server.add_socket(self._listening)
        while not self._stop.is_set():
            self.deliver()
            try:
                await asyncio.wait_for(self._stop.wait(), _FLUSH_EVERY)
            except asyncio.TimeoutError:
                continue
        self.deliver()
        server.stop()
        for page in self.pages:
            page.close(_ENDED, "the program has ended")
        await server.close_all_connections()

    def deliver(self) -> None:
        """Send every page what is new; called some 50 times a second in the server's thread."""
        with self._lock:
            fresh, self._fresh = self._fresh, []
        for page in self.pages:
            for key, message in fresh:
                page.waiting.put(key, message)
            page.send_waiting()
