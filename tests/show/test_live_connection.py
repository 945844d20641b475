"""The connection between a live page and its program: what a slow page gets, and what happens to a lost one."""

from __future__ import annotations

import asyncio
import json
import time as clock
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
import tornado.websocket
from waiting import PATIENCE

import backhoe_planner as bp
from backhoe_planner.machine import Robot
from backhoe_planner.motion import build_problem
from backhoe_planner.show import Session, TeleopServer, Viewer
from backhoe_planner.show.teleop import station
from backhoe_planner.show.viewer.live_server import LiveServer

JOINTS = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
SITE = {"version": 1, "start": {"joints": JOINTS}, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}}


def talk(server: LiveServer, conversation: Callable[[str], Awaitable[None]]) -> None:
    try:
        asyncio.run(asyncio.wait_for(conversation(server.url.replace("http", "ws") + "socket"), PATIENCE))
    finally:
        server.close()


async def read(connection: tornado.websocket.WebSocketClientConnection) -> Any:
    message = await connection.read_message()
    return None if message is None else json.loads(message)


async def leave(connection: tornado.websocket.WebSocketClientConnection) -> None:
    """Close a connection, and wait until its socket is closed too."""
    connection.close()
    while await connection.read_message() is not None:
        pass


def test_a_page_that_shows_nothing_gets_three_deliveries_and_then_the_present() -> None:
    server = LiveServer(port=0)

    async def conversation(url: str) -> None:
        page = await tornado.websocket.websocket_connect(url)
        assert (await read(page))["type"] == "program"
        for number in range(3):
            server.display.tell("step", {"number": number})
            assert await read(page) == {"type": "step", "number": number}
            assert await read(page) == {"type": "delivered"}
        for number in range(3, 40):
            server.display.tell("step", {"number": number})
            await asyncio.sleep(0.005)
        await asyncio.sleep(0.1)
        await page.write_message("shown")
        assert await read(page) == {"type": "step", "number": 39}  # those in between are past
        assert await read(page) == {"type": "delivered"}
        await leave(page)

    talk(server, conversation)


def test_the_program_says_that_it_ends() -> None:
    server = LiveServer(port=0)

    async def conversation(url: str) -> None:
        page = await tornado.websocket.websocket_connect(url)
        assert (await read(page))["type"] == "program"
        await asyncio.get_running_loop().run_in_executor(None, server.close)
        assert await read(page) is None
        assert page.close_code == 1001
        page.close()

    talk(server, conversation)


def test_a_driver_that_sends_nothing_has_let_go(backhoe: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station, "_SILENT", 0.3)
    session = Session(backhoe, bp.scene_from_dict(SITE))
    server = TeleopServer(session, port=0)

    async def drives() -> bool:
        await asyncio.sleep(0.02)
        return session.snapshot().driver is not None

    async def conversation(url: str) -> None:
        page = await tornado.websocket.websocket_connect(url)
        await page.write_message('{"type": "take"}')
        while not await drives():
            pass
        begun = clock.monotonic()
        while clock.monotonic() - begun < 0.8:  # it shows what it gets, and nothing is wished for
            await page.write_message("shown")
            assert await drives()
        begun = clock.monotonic()
        while await drives():
            pass
        assert clock.monotonic() - begun > 0.2
        await page.write_message('{"type": "take"}')  # it is still connected
        while not await drives():
            pass
        await leave(page)

    talk(server, conversation)


def test_a_plan_goes_on_where_it_was_after_the_connection_was_lost(backhoe: Robot, browser: Any) -> None:
    scene = bp.scene_from_dict({**SITE, "task": {"goal": {"joints": {**JOINTS, "swing": 0.6}}}})
    plan = bp.plan(backhoe, scene, effort="quick")
    with Viewer(port=0) as viewer:
        viewer.show_problem(build_problem(backhoe, scene))
        viewer.play(plan)
        page = browser.new_page(viewport={"width": 560, "height": 400}, reduced_motion="reduce")
        page.set_default_timeout(1e3 * PATIENCE)
        page.goto(viewer.url)
        page.wait_for_function("window.backhoe !== undefined && backhoe.plan !== null")
        page.evaluate("backhoe.seek(0.5)")
        page.mouse.move(200, 200)
        page.mouse.wheel(0, 300)  # the person looks from elsewhere
        eye = "backhoe.viewer.camera.position.toArray().map((x) => x.toFixed(6)).join()"
        page.wait_for_timeout(300)
        seen = page.evaluate(eye)
        page.evaluate("window.before = backhoe.plan")
        server = viewer._server  # opens the wall: nothing in the program cuts a connection
        (connected,) = server.pages
        assert connected.ws_connection is not None
        assert connected.ws_connection.stream is not None
        server._loop.call_soon_threadsafe(connected.ws_connection.stream.close)
        page.wait_for_function("backhoe.plan !== null && backhoe.plan !== window.before && backhoe.time === 0.5")
        page.wait_for_function("document.getElementById('notice').hidden")
        assert page.evaluate(eye) == seen
        assert page.evaluate("Object.keys(backhoe.viewer.scene_tree.children).includes('machine')")
        assert viewer.alive()
        page.close()
