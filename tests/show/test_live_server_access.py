"""Access to a live page: for whom, from where and in which frames, without a browser."""

from __future__ import annotations

import asyncio
import re
import socket
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import pytest
import tornado.httpclient
import tornado.httputil
import tornado.websocket
import yaml
from waiting import PATIENCE

import backhoe_planner as bp
from backhoe_planner.errors import InputError
from backhoe_planner.machine import Robot
from backhoe_planner.show import (
    LiveServer,
    Password,
    Session,
    TeleopServer,
    TeleopStation,
    Viewer,
    find_address,
)

SITE: dict[str, Any] = {
    "version": 1,
    "start": {"joints": {"swing": 0.0, "boom": 0.3, "stick": -0.9, "bucket": -0.5}},
    "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
}
HAS_IPV6 = socket.has_ipv6 and Path("/proc/net/if_inet6").exists()
ipv6 = pytest.mark.skipif(not HAS_IPV6, reason="this computer has no IPv6")


def talk(conversation: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(conversation(), PATIENCE))


async def ask(
    url: str, *, form: dict[str, str] | None = None, method: str | None = None, **headers: str
) -> tornado.httpclient.HTTPResponse:
    """The response, whatever its status; a redirect is not followed."""
    request = tornado.httpclient.HTTPRequest(
        url,
        method=method or ("GET" if form is None else "POST"),
        body=None if form is None else urlencode(form),
        headers=tornado.httputil.HTTPHeaders(headers),
        follow_redirects=False,
        allow_nonstandard_methods=True,
    )
    return await tornado.httpclient.AsyncHTTPClient().fetch(request, raise_error=False)


async def connect(server: LiveServer, **headers: str) -> int:
    """The status with which a page's connection is answered."""
    request = tornado.httpclient.HTTPRequest(
        server.url.replace("http", "ws") + "socket", headers=tornado.httputil.HTTPHeaders(headers)
    )
    try:
        connection = await tornado.websocket.websocket_connect(request)
    except tornado.httpclient.HTTPClientError as error:
        return int(error.code)
    connection.close()
    while await connection.read_message() is not None:
        pass
    return 101


# --- framing by other pages ---------------------------------------------------------------


@pytest.mark.parametrize("kind", ["live view", "driving page"])
def test_no_page_may_frame_any_response(kind: str, backhoe: Robot) -> None:
    session = Session(backhoe, bp.scene_from_dict(SITE)) if kind == "driving page" else None
    server = LiveServer(port=0) if session is None else TeleopServer(session, port=0)

    async def conversation() -> None:
        asked = [
            (200, await ask(server.url)),
            (403, await ask(server.url, Host="evil.example")),
            (404, await ask(server.url + "nothing")),
            (405, await ask(server.url, form={})),
            (303, await ask(server.url + "login")),
            (400, await ask(server.url + "socket")),
            (403, await ask(server.url + "socket", Origin="http://evil.example")),
            (404, await ask(server.url + "nothing", method="OPTIONS")),
        ]
        for status, response in asked:
            assert response.code == status, response.effective_url
            assert response.headers["X-Frame-Options"] == "DENY"
            policy = [part.strip() for part in response.headers["Content-Security-Policy"].split(";")]
            assert "frame-ancestors 'none'" in policy

    talk(conversation)
    server.close()


# --- who may connect -------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["0.0.0.0", "", "192.0.2.7", "0", pytest.param("::", marks=ipv6)])
def test_a_network_address_without_password_or_permission_is_refused(host: str, backhoe: Robot, tmp_path: Path) -> None:
    scene = bp.scene_from_dict(SITE)
    makers: list[Callable[[], object]] = [
        lambda: LiveServer(host=host, port=0),
        lambda: Viewer(host=host, port=0),
        lambda: TeleopStation(backhoe, scene, host=host, port=0, output=tmp_path / "driven.json"),
    ]
    for make in makers:
        with pytest.raises(InputError) as caught:
            make()
        said = str(caught.value)
        assert said.startswith("host: everybody who can reach this address over the network could see")
        assert "--password" in said
        assert "--allow-anyone" in said
    assert "drive" in said


def test_the_server_describes_who_can_connect(backhoe: Robot) -> None:
    session = Session(backhoe, bp.scene_from_dict(SITE))
    anybody = "everybody who can reach this computer over the network can see the machine and drive it"
    cases: list[tuple[dict[str, Any], str]] = [
        ({}, "only this computer can connect"),
        ({"password": "spade"}, "only this computer can connect, with the password"),
        ({"host": "0.0.0.0", "allow_anyone": True}, f"{anybody}, without a password"),
        (
            {"host": "0.0.0.0", "password": "spade"},
            "everybody on the network who knows the password can see the machine and drive it; the connection is not "
            "encrypted, so whoever can listen to the network can read the password",
        ),
    ]
    for keys, words in cases:
        server = TeleopServer(session, port=0, **keys)
        assert server.openness == words
        elsewhere = server.url_from_elsewhere
        port = server.url.rsplit(":", 1)[1]
        assert elsewhere == (f"http://{socket.gethostname().lower()}:{port}" if "host" in keys else None)
        assert server.url == f"http://127.0.0.1:{port}"
        server.close()


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"password": ""}, "password: is empty"),
        ({"password": 7}, "password: is empty"),
        ({"password": "a", "allow_anyone": True}, "password: has no effect together with allow_anyone"),
        ({"host": "192.0.2.7", "allow_anyone": True}, "host: is no address of this computer; found 192.0.2.7"),
        (
            {"host": "nobody.invalid", "allow_anyone": True},
            "host: is no address of this computer; found nobody.invalid",
        ),
        ({"host": "a\0b"}, "host: is no address of this computer"),
        ({"host": "fe80::1%lo"}, "host: names a network interface"),
    ],
)
def test_invalid_addresses_and_passwords_are_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match="^" + re.escape(said)):
        LiveServer(port=0, **keys)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.1", "LOCALHOST"])
def test_a_loopback_address_needs_no_password(host: str) -> None:
    server = LiveServer(host=host, port=0)
    assert find_address(host).is_of_this_computer_alone

    async def conversation() -> None:
        assert (await ask(server.url)).code == 200
        assert await connect(server) == 101

    talk(conversation)
    server.close()


@ipv6
@pytest.mark.parametrize(("host", "shown"), [("::1", "[::1]"), ("[::1]", "[::1]"), ("::", "[::1]")])
def test_an_ipv6_address_is_served_and_shown_in_brackets(host: str, shown: str) -> None:
    server = LiveServer(host=host, port=0, allow_anyone=True)
    port = server.url.rsplit(":", 1)[1].strip("/")
    assert server.url == f"http://{shown}:{port}/"

    async def conversation() -> None:
        assert (await ask(server.url)).code == 200
        assert await connect(server, Origin=f"http://[::1]:{port}") == 101
        assert await connect(server, Origin="http://evil.example") == 403
        assert await connect(server, Host=f"evil.example:{port}") == 403
        if host == "::":  # IPv4 as well
            assert (await ask(f"http://127.0.0.1:{port}/")).code == 200

    talk(conversation)
    server.close()


@pytest.mark.parametrize(
    ("host", "asked", "answered"),
    [
        ("127.0.0.1", "127.0.0.1:7000", True),
        ("127.0.0.1", "localhost:7000", True),
        ("127.0.0.1", "[::1]:7000", True),
        ("127.0.0.1", "192.0.2.7:7000", False),
        ("127.0.0.1", "evil.example", False),
        ("192.0.2.7", "192.0.2.7", True),
        ("2001:db8::7", "[2001:db8:0:0::7]:7000", True),
        ("2001:db8::7", "[2001:db8::8]:7000", False),
        ("0.0.0.0", "192.0.2.7", True),  # any address, but no name that somebody else owns
        ("0.0.0.0", "evil.example", False),
        ("::", "[2001:db8::7]", True),
        ("::", "[::1", False),
    ],
)
def test_the_server_answers_only_to_its_own_names(host: str, asked: str, answered: bool) -> None:
    assert find_address(host).answers_to(asked) is answered


@pytest.mark.parametrize(
    ("host", "alone"),
    [("::ffff:127.0.0.1", True), ("::ffff:192.0.2.7", False), ("127.8.9.10", True), ("0", False), ("::1", True)],
)
def test_every_form_of_a_loopback_address_is_recognized(host: str, alone: bool) -> None:
    assert find_address(host).is_of_this_computer_alone is alone


# --- the password ----------------------------------------------------------------------------


def test_the_page_is_not_served_without_the_password() -> None:
    server = LiveServer(port=0, password="Spaten & Söhne")
    server.display.tell("news", {"text": "secret"})

    async def conversation() -> None:
        page = await ask(server.url)
        assert (page.code, page.headers["Location"], page.body) == (303, "/login", b"")
        form = await ask(server.url + "login")
        assert form.code == 200
        assert b'name="password"' in form.body
        assert b"MeshCat" not in form.body  # the viewer of the page itself
        assert await connect(server) == 403
        assert await connect(server, Cookie=f"{server.cookie}=guess") == 403

        for word in ("", "spaten & söhne", "Spaten & Söhne "):
            wrong = await ask(server.url + "login", form={"password": word})
            assert wrong.code == 403
            assert "Set-Cookie" not in wrong.headers
            assert b"That is not the password." in wrong.body
        foreign = await ask(server.url + "login", form={"password": "Spaten & Söhne"}, Origin="http://evil.example")
        assert foreign.code == 403
        assert "Set-Cookie" not in foreign.headers

        right = await ask(server.url + "login", form={"password": "Spaten & Söhne"}, Origin=server.url.rstrip("/"))
        assert (right.code, right.headers["Location"]) == (303, "/")
        cookie, *attributes = right.headers["Set-Cookie"].split("; ")
        assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(attributes)
        assert "Spaten" not in cookie
        assert len(cookie.split("=")[1]) > 40
        assert (await ask(server.url, Cookie=cookie)).code == 200
        assert await connect(server, Cookie=cookie) == 101
        assert await connect(server, Cookie=cookie, Origin="http://evil.example") == 403
        assert (await ask(server.url, Cookie=cookie, Host="evil.example")).code == 403
        assert (await ask(server.url + "login", Cookie=cookie)).code == 303

        other = LiveServer(port=0, password="Spaten & Söhne")
        assert await connect(other, Cookie=cookie.replace(server.cookie, other.cookie)) == 403  # another key
        other.close()
        assert (await ask(server.url + "?password=Spaten+%26+S%C3%B6hne")).code == 303  # never from the URL

    talk(conversation)
    server.close()


def test_a_client_has_to_wait_after_five_wrong_passwords() -> None:
    server = LiveServer(port=0, password="spade")
    server.password = Password("spade", now=lambda: 0.0)  # however slow this computer is

    async def conversation() -> None:
        for _ in range(5):
            assert (await ask(server.url + "login", form={"password": "shovel"})).code == 403
        right = await ask(server.url + "login", form={"password": "spade"})
        assert right.code == 429
        assert right.headers["Retry-After"] == "10"
        assert b"Too many wrong passwords" in right.body
        assert right.headers["X-Frame-Options"] == "DENY"
        assert (await ask(server.url + "login", form={"password": "x" * 10_000})).code == 400  # not even read

    talk(conversation)
    server.close()


def test_the_wait_after_wrong_passwords_ends_with_time() -> None:
    """5 at once and one every 10 s from one address; 50 at once and one a second from all of them."""
    now = 1000.0
    password = Password("spade", now=lambda: now)
    for _ in range(5):
        assert password.wait("192.0.2.1") == 0.0
        assert not password.try_word("shovel", client="192.0.2.1")
    assert password.wait("192.0.2.1") == pytest.approx(10.0)
    assert password.wait("192.0.2.2") == 0.0  # others are not kept out
    assert password.try_word("spade", client="192.0.2.2")
    now += 9.9
    assert password.wait("192.0.2.1") == pytest.approx(0.1)
    now += 0.2
    assert password.wait("192.0.2.1") == 0.0
    now += 1000.0
    for number in range(50):
        assert password.wait(f"198.51.100.{number}") == 0.0
        password.try_word("shovel", client=f"198.51.100.{number}")
    assert password.wait("203.0.113.1") == pytest.approx(1.0)


def test_addresses_of_one_owner_share_their_attempts() -> None:
    password = Password("spade", now=lambda: 0.0)
    for number in range(5):
        password.try_word("shovel", client=f"2001:db8:1:2::{number:x}")
    assert password.wait("2001:db8:1:2:ffff::1") > 0.0
    assert password.wait("2001:db8:1:3::1") == 0.0
    for _ in range(5):
        password.try_word("shovel", client="::ffff:192.0.2.1")
    assert password.wait("192.0.2.1") > 0.0
    assert password.wait("192.0.2.2") == 0.0


# --- the command line ------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["0.0.0.0", pytest.param("::", marks=[ipv6, pytest.mark.long])])
def test_teleop_needs_a_password_or_allow_anyone_on_the_network(
    host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from backhoe_planner.cli import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("BACKHOE_PLANNER_PASSWORD", raising=False)
    Path("scene.yaml").write_text(yaml.safe_dump(SITE), encoding="utf-8")
    words = ["teleop", "example:backhoe", "scene.yaml", "--no-browser", "--port", "0", "--host", host]

    def run(*more: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["backhoe-planner", *words, *more])
        with pytest.raises(SystemExit) as caught:
            main()
        return int(str(caught.value.code)), capsys.readouterr().err

    status, said = run()
    assert status == 2
    assert "host: everybody who can reach this address over the network could see the machine and drive it" in said
    assert f"found {host}" in said
    assert "--password WORD or --allow-anyone" in said
    assert run("--password", "a", "--allow-anyone")[0] == 2
    assert run("--password", "")[0] == 2

    monkeypatch.setattr(TeleopStation, "running", property(lambda _: False))  # it ends at once
    status, said = run("--allow-anyone")
    assert status == 1
    assert "warning: everybody who can reach this computer over the network can see the machine and drive it" in said
    assert f"from other computers: http://{socket.gethostname().lower()}:" in said
    monkeypatch.setenv("BACKHOE_PLANNER_PASSWORD", "spade")
    status, said = run()
    assert status == 1
    assert "warning: everybody on the network who knows the password can see the machine and drive it" in said
    assert "spade" not in said
