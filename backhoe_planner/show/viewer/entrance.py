"""The entrance of a live page: only its own names and pages, never in a frame, and with the password if one is set."""

from __future__ import annotations

import html
import math
from functools import cache
from typing import Protocol
from urllib.parse import urlsplit

import tornado.web

from backhoe_planner.show.page.page import read_parts
from backhoe_planner.show.viewer.password import Password

_HEADERS = {
    # a foreign page could place this one invisibly over its own, so that a click there drives
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "frame-ancestors 'none'; base-uri 'none'; form-action 'self'; object-src 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class Guarded(Protocol):
    """The server behind the entrance, as far as the entrance uses it.

    Attributes
    ----------
    password: None if anyone may enter.
    opens: what it gives access to, in words.
    """

    password: Password | None
    opens: str

    @property
    def cookie(self) -> str:
        """The name of the cookie that holds the key."""
        ...

    def answers_to(self, host: str) -> bool:
        """Whether `host`, as a browser sends it, is one of the server's names."""
        ...


class OwnPages(tornado.web.RequestHandler):
    """Answers only requests to this server's names and from its own pages; no other page may frame them."""

    server: Guarded

    def set_default_headers(self) -> None:
        """Give every response, also an error, the headers that keep foreign pages out."""
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse requests to a name that is not this server's, and requests from other pages."""
        origin = self.request.headers.get("Origin")
        if not self.server.answers_to(self.request.host) or not (origin is None or self.check_origin(origin)):
            raise tornado.web.HTTPError(403)

    def check_origin(self, origin: str) -> bool:
        """Whether `origin` is this server's own."""
        try:
            found = urlsplit(origin)
        except ValueError:  # not an address
            return False
        # another program may serve a page on the same port with another protocol
        return found.scheme == self.request.protocol and found.netloc.lower() == self.request.host.lower()

    @property
    def may_enter(self) -> bool:
        """Whether no password is required, or this browser has given it."""
        password = self.server.password
        return password is None or password.opens(self.get_cookie(self.server.cookie))


class NotFound(OwnPages):
    """The answer to requests for unknown addresses."""

    def initialize(self, server: Guarded) -> None:
        """Store the arguments of the route."""
        self.server = server

    def prepare(self) -> None:
        """Refuse the request."""
        super().prepare()
        raise tornado.web.HTTPError(404)


class Login(OwnPages):
    """Asks for the password."""

    def initialize(self, server: Guarded) -> None:
        """Store the arguments of the route."""
        self.server = server

    def get(self) -> None:
        """Answer with the form, unless this browser has given the password."""
        if self.may_enter:
            self.redirect("/", status=303)
        else:
            self._ask("")

    def post(self) -> None:
        """Check the password, and give a browser that has it the key as a cookie that no script can read."""
        password, client = self.server.password, self.request.remote_ip or ""
        if password is None:
            self.redirect("/", status=303)
            return
        wait = password.wait(client)
        if wait > 0.0:
            self.set_status(429)
            self.set_header("Retry-After", str(math.ceil(wait)))
            self._ask(f"Too many wrong passwords. Try again in {math.ceil(wait)} s.")
        elif password.try_word(self.get_body_argument("password", "", strip=False), client=client):
            self.set_cookie(self.server.cookie, password.key, path="/", httponly=True, samesite="Strict")
            self.redirect("/", status=303)
        else:
            self.set_status(403)
            self._ask("That is not the password.")

    def _ask(self, problem: str) -> None:
        page = _login_page()
        for name, text in {"opens": self.server.opens, "problem": problem}.items():
            page = page.replace(f"{{{name}}}", html.escape(text))
        self.finish(page)


@cache
def _login_page() -> str:
    """The page that asks for the password, with placeholders for what it opens and for errors."""
    (css,) = read_parts("backhoe_planner.show.page", "page.css")
    login_css, body = read_parts("backhoe_planner.show.viewer", "login.css", "login.html")
    return body.replace("{css}", css + login_css)
