"""The tele-operation page, driven in a real browser as a person would."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import PATIENCE

import backhoe_planner as bp
from backhoe_planner.live import unrecorded_changes
from backhoe_planner.machine import Robot
from backhoe_planner.show import TeleopStation, write_page
from backhoe_planner.show.teleop import station as teleop_station
from backhoe_planner.show.teleop.session import Session
from backhoe_planner.show.viewer import live_server

# without a graphics card every pixel costs: a quarter of them shows the same page
COARSE = {"reduced_motion": "reduce", "device_scale_factor": 0.5}
HOSTILE = "<img src=x onerror='window.pwned=1'> \"q\" a/b &amp;"


def open_page(browser: Any, url: str, *, password: str = "", height: int = 420) -> tuple[Any, list[str]]:
    page = browser.new_page(viewport={"width": 860, "height": height}, **COARSE)
    page.set_default_timeout(1e3 * PATIENCE)
    complaints = browser.complaints_of(page)
    page.goto(url)
    if password:
        assert page.url == f"{url}login"
        page.locator("#password:focus").fill(password)
        page.keyboard.press("Enter")
        page.wait_for_url(url)  # the page that asks for the password lets nothing be evaluated
    page.wait_for_function("window.backhoe && backhoe.teleop && backhoe.teleop.state && backhoe.teleop.page !== null")
    return page, complaints


def unexpected(complaints: list[str]) -> list[str]:
    return [text for text in complaints if not any(w in text for w in ("WebSocket", "has no shadow", "GPU"))]


def rest(page: Any) -> None:
    page.wait_for_function("backhoe.teleop.state.speed === 0")


def test_a_machine_is_driven_from_the_page(backhoe: Robot, browser: Any, tmp_path: Path) -> None:
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "name": HOSTILE,
            "start": {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "clearance": 0.1,
            "obstacles": [{"name": HOSTILE, "shape": "box", "size": [1, 1, 1], "position": [1, -6, 0.5]}],
            "zones": [{"kind": "ceiling", "name": "power line", "height": 5.0, "stop": 0.5, "warn": 3.5}],
        }
    )
    file = tmp_path / "driven.json"
    with TeleopStation(backhoe, scene, port=0, output=file) as station:
        page, complaints = open_page(browser, station.url)
        tip = "backhoe.teleop.state.tip"
        start = page.evaluate(tip)

        # keys move the tip
        page.locator("#take").click()
        page.wait_for_function("backhoe.teleop.driving")
        page.keyboard.down("KeyW")
        page.wait_for_function(f"{tip}[0] > {start[0]} + 0.3")
        page.keyboard.up("KeyW")
        rest(page)
        assert page.locator("#take").inner_text() == "Let go"
        assert abs(page.evaluate(tip)[1]) < 0.02
        assert page.locator("#zones .warn").inner_text() == "power line: warn"

        page.locator("#record").click()
        page.wait_for_function("backhoe.teleop.state.recording === 'on'")

        # an obstacle is dropped in the way of the bucket, and dragged
        x, y, _ = page.evaluate(tip)
        page.evaluate(f"backhoe.teleop.drop('post', [{x}, {y} + 1.4, -3.0])")
        page.evaluate(f"backhoe.teleop.drop('block', [{x}, {y} + 1.4, -2.0])")
        page.wait_for_function("'post 1' in backhoe.teleop.state.nodes && 'block 1' in backhoe.teleop.state.nodes")
        name = page.locator(".margin", has_text="block 1")
        name.locator(".remove").click()
        page.wait_for_function("!('block 1' in backhoe.teleop.state.nodes)")

        page.keyboard.down("KeyA")
        least, forces, shown = np.inf, [], set()
        row = page.locator(".margin", has_text="post 1")
        for _ in range(600):
            page.wait_for_timeout(100)
            snapshot = station.session.snapshot()
            spot = snapshot.nearest["post 1"]
            if spot is not None:
                least = min(least, spot.margin)
                shown.add(row.locator(".value").inner_text())
            forces.append(page.evaluate("backhoe.teleop.state.force"))
            if least < 0.01 and max(forces) > 3.0:
                if len(shown) > 3:
                    break
                # a busy page shows few values on the way: go back and approach again
                page.keyboard.up("KeyA")
                page.keyboard.down("KeyD")
                page.wait_for_timeout(500)
                page.keyboard.up("KeyD")
                page.keyboard.down("KeyA")
                least, forces = np.inf, []
        page.keyboard.up("KeyA")
        assert 0.0 <= least < 0.05  # it came near, and was not touched
        assert len(shown) > 3  # the bar showed it coming
        assert max(forces) > 1.0  # and the hand felt it
        rest(page)
        spot = station.session.snapshot().nearest["post 1"]
        assert spot is not None
        page.wait_for_function(
            "(m) => Math.abs(parseFloat([...document.querySelectorAll('.margin')].find("
            "(row) => row.textContent.includes('post 1')).querySelector('.value').textContent) - m) < 0.011",
            arg=spot.margin,
        )
        width = "document.querySelectorAll('.margin')[2].querySelector('.fill').style.transform"
        assert float(page.evaluate(width)[7:-1]) < 0.3

        # somebody else watches, asks, and gets the controls
        session, other = station.session, station.session.join()
        assert not session.hear(other, '{"type": "take"}')["ok"]
        page.locator("#hand-over").click()
        page.wait_for_function(f"backhoe.teleop.state.driver === {other}")
        assert page.locator("#take").inner_text() == f"Ask page {other}"
        assert page.locator("#record").is_disabled()
        assert session.hear(other, '{"type": "record", "on": false}')["ok"]
        page.wait_for_function("document.getElementById('recorded').textContent.includes('driven.json')")
        assert "verified" in page.locator("#recorded").inner_text(), bp.load_plan(file).message
        assert "block 1 was taken away at" in page.locator("#recorded").inner_text()
        session.leave(other)
        page.wait_for_function("backhoe.teleop.state.driver === null")
        assert page.evaluate("window.pwned") is None
        page.close()
    assert unexpected(complaints) == []

    # the recording plays, and is safe
    plan = bp.load_plan(file)
    assert plan.verified, plan.message
    assert plan.certificate.safe
    kept = {clearance.obstacle: clearance.margin for clearance in plan.certificate.clearances}
    assert -1e-4 <= kept["post 1"] < 0.05
    assert any("block 1 was taken away" in note for note in unrecorded_changes(plan))
    write_page(plan, tmp_path / "driven.html")
    replay = browser.new_page(viewport={"width": 560, "height": 400}, **COARSE)
    replay.goto((tmp_path / "driven.html").as_uri())
    replay.wait_for_function("window.backhoe !== undefined && backhoe.plan !== null")
    assert "Verified" in replay.locator("#verdict").inner_text()
    assert replay.locator("#subtitle").inner_text() == f"{backhoe.name}, driven by hand"
    facts = replay.locator("#facts").inner_text()
    assert "driven by hand" in facts
    assert "block 1 was taken away at" in facts
    assert "Tip error" not in facts
    assert replay.evaluate("backhoe.viewer.scene_tree.find(['task', 'goal']).object.children.length") == 0
    swing = "backhoe.viewer.scene_tree.find(['machine', 'swing_post']).object.quaternion.toArray()"
    replay.evaluate(f"backhoe.seek({plan.trajectory.duration})")
    assert abs(replay.evaluate(swing)[2]) == pytest.approx(np.sin(abs(plan.trajectory.q[-1, 0]) / 2.0), abs=1e-3)
    replay.close()


@pytest.mark.long
def test_ground_cannot_be_dragged_or_removed_and_a_removed_pole_is_put_back(
    backhoe: Robot, browser: Any, tmp_path: Path
) -> None:
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": 0.0, "boom": 0.3, "stick": -0.9, "bucket": -0.5}},  # the tip at z = -0.66
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "clearance": 0.1,
            "obstacles": [
                {"name": "ground", "shape": "halfspace", "point": [0, 0, -1.0], "normal": [0, 0, 1]},
                {"name": "pole", "shape": "cylinder", "radius": 0.2, "length": 4, "position": [2, 3.5, 1]},
            ],
        }
    )
    with TeleopStation(backhoe, scene, port=0, output=tmp_path / "driven.json") as station:
        page, complaints = open_page(browser, station.url)

        # before any wish: calm, with the nearest obstacle
        assert page.locator("#status-word").inner_text() == "At rest"
        assert page.locator("#status-more").inner_text().startswith("near ground, 0.2")
        assert page.locator("#status").get_attribute("class") == "rest"
        page.locator("#take").click()
        page.wait_for_function("backhoe.teleop.driving")
        page.wait_for_selector(".margin.removable")
        assert page.locator(".margin.removable .name").all_inner_texts() == ["pole"]

        # a drag on the ground turns the camera
        eye = "backhoe.viewer.camera.getWorldPosition(new MeshCat.THREE.Vector3()).toArray()"
        project = """(at) => { const v = new MeshCat.THREE.Vector3(at[0], at[2], -at[1]).project(backhoe.viewer.camera);
            const box = document.getElementById('meshcat-pane').getBoundingClientRect();
            return [box.left + (0.5 + 0.5 * v.x) * box.width, box.top + (0.5 - 0.5 * v.y) * box.height]; }"""
        before = page.evaluate(eye)
        x, y = page.evaluate(project, [3.0, -2.5, -1.0])
        page.mouse.move(x, y)
        page.mouse.down()
        for step in range(1, 6):
            page.mouse.move(x + 12 * step, y)
            page.wait_for_timeout(40)
        page.mouse.up()
        page.wait_for_function(f"(a) => {eye}.some((x, k) => Math.abs(x - a[k]) > 0.3)", arg=before)
        assert station.session.snapshot().shifts["ground"] == pytest.approx([0.0, 0.0, 0.0])

        # a request to remove it is refused with the reason
        page.evaluate("backhoe.send({type: 'remove', name: 'ground'})")
        page.wait_for_function("!document.getElementById('toast').hidden")
        assert "ground: is ground or terrain of the scene, which stays" in page.locator("#toast").inner_text()
        assert "ground" in station.session.snapshot().shifts

        # an obstacle removed by mistake is put back
        page.locator(".margin", has_text="pole").locator(".remove").click()
        page.wait_for_selector("#taken button")
        assert "pole" not in station.session.snapshot().shifts
        assert page.locator("#taken").inner_text().split("\n")[0] == "pole, taken away"
        page.locator("#taken button").click()
        page.wait_for_function("document.getElementById('taken').hidden")
        assert "pole" in station.session.snapshot().shifts
        page.wait_for_function("backhoe.viewer.scene_tree.find(['site', 'pole']).object.children.length > 0")

        # red only during a refused wish
        page.evaluate("document.activeElement.blur()")
        page.keyboard.down("KeyQ")
        page.wait_for_function("document.getElementById('status').className === 'held'")
        assert "ground" in page.locator("#status-word").inner_text()
        page.keyboard.up("KeyQ")
        page.wait_for_function("document.getElementById('status').className === 'rest'")
        rest(page)
        seen = set()
        for _ in range(10):
            page.wait_for_timeout(60)
            seen.add(tuple(page.locator("#status").inner_text().split("\n")))
        assert {words[0] for words in seen} == {"At rest"}
        assert all(words[1].startswith("near ground") for words in seen)

        # trouble stays on the page
        # opens the wall: no scene that can be loaded makes drawing fail
        station._server.display.tell("trouble", {"text": "a rock cannot be drawn: Error"})
        page.wait_for_selector("#trouble")
        assert page.locator("#trouble").inner_text() == "A rock cannot be drawn: Error"
        page.close()
    assert unexpected(complaints) == []


@pytest.mark.long
def test_obstacles_are_dropped_and_dragged_with_the_mouse(backhoe: Robot, browser: Any, tmp_path: Path) -> None:
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": -0.6, "boom": 0.4, "stick": -1.6, "bucket": -0.9}},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
        }
    )
    with TeleopStation(backhoe, scene, port=0, output=tmp_path / "driven.json") as station:
        page, _ = open_page(browser, station.url)
        page.locator("#take").click()
        page.wait_for_function("backhoe.teleop.driving")
        project = """(at) => { const v = new MeshCat.THREE.Vector3(at[0], at[2], -at[1]).project(backhoe.viewer.camera);
            const box = document.getElementById('meshcat-pane').getBoundingClientRect();
            return [box.left + (0.5 + 0.5 * v.x) * box.width, box.top + (0.5 - 0.5 * v.y) * box.height]; }"""
        page.locator("[data-drop=ball]").click()
        page.mouse.click(*page.evaluate(project, [3.4, 1.0, 0.0]))
        page.wait_for_function("'ball 1' in backhoe.teleop.state.nodes")
        ball = next(obstacle for obstacle in station.session.snapshot().obstacles if obstacle.name == "ball 1")
        assert ball.pieces[0].placement.translation == pytest.approx([3.4, 1.0, 0.3], abs=0.03)

        page.wait_for_function("backhoe.viewer.scene_tree.find(['site', 'ball 1']).object.children.length > 0")
        page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        page.mouse.move(*page.evaluate(project, [3.4, 1.0, 0.3]))
        page.mouse.down()
        for part in np.linspace(0.0, 1.0, 6):
            page.mouse.move(*page.evaluate(project, [3.4 - 0.4 * part, 1.0 + 0.6 * part, 0.3]))
            page.wait_for_timeout(60)
        page.mouse.up()
        page.wait_for_function("backhoe.teleop.state.shifts['ball 1'][1] > 0.4")
        shift = station.session.snapshot().shifts["ball 1"]
        assert shift is not None
        assert shift[2] == 0.0
        assert shift[:2] == pytest.approx([-0.4, 0.6], abs=0.12)

        page.mouse.move(*page.evaluate(project, [3.0, 1.6, 0.3]))
        page.keyboard.press("Space")
        page.locator("#mode").select_option("sae")
        before = station.session.snapshot().state.q
        page.keyboard.down("KeyS")  # boom up
        page.wait_for_function(f"backhoe.teleop.state.tip[2] > {page.evaluate('backhoe.teleop.state.tip')[2]} + 0.1")
        page.keyboard.up("KeyS")
        rest(page)
        moved = station.session.snapshot().state.q - before
        assert moved[1] > 0.02
        assert np.abs(moved[[0, 2, 3]]).max() < 1e-3
        page.close()


def test_only_a_click_on_the_button_takes_the_controls(backhoe: Robot, browser: Any, tmp_path: Path) -> None:
    joints = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    scene = bp.scene_from_dict(
        {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}}
    )
    with TeleopStation(backhoe, scene, port=0, password="spade", output=tmp_path / "driven.json") as station:
        session = station.session

        # a foreign page frames it invisibly
        foreign = browser.new_page()
        foreign.set_content(f"<iframe src='{station.url}' style='opacity: 0; position: fixed; inset: 0'></iframe>")
        foreign.wait_for_timeout(300)
        assert not any(frame.url.startswith(station.url) for frame in foreign.frames)
        assert session.snapshot().pages == ()
        foreign.close()

        page, complaints = open_page(browser, station.url, password="spade", height=200)
        page.evaluate(PAD)
        assert page.locator("#take").inner_text() == "Take the controls"
        at = session.snapshot().state.q

        # keys, mouse and gamepad do nothing
        page.wait_for_timeout(100)  # the stick was seen at its middle
        page.evaluate("window.axes[1] = -1")
        page.keyboard.down("KeyW")
        page.mouse.click(200, 100)
        page.wait_for_function("document.getElementById('toast').textContent === 'Take the controls first'")
        page.wait_for_timeout(300)
        assert session.snapshot().driver is None
        np.testing.assert_array_equal(session.snapshot().state.q, at)

        # nor do keys and sticks that are still held at the click
        def take() -> None:
            page.locator("#take").click()
            page.wait_for_function("backhoe.teleop.driving")
            assert page.locator("#take").inner_text() == "Let go"

        def go() -> None:
            page.keyboard.down("KeyW")
            page.wait_for_function("backhoe.teleop.state.speed > 0.1")

        def braked() -> None:
            page.wait_for_function("backhoe.teleop.state.driver === null && backhoe.teleop.state.speed === 0")
            assert page.locator("#take").inner_text() == "Take the controls"
            page.keyboard.up("KeyW")

        take()
        page.wait_for_timeout(300)
        np.testing.assert_array_equal(session.snapshot().state.q, at)
        page.evaluate("window.axes[1] = 0")
        page.keyboard.up("KeyW")

        # letting go brakes: by the button, by Esc, and by leaving the window
        ways: list[Callable[[], object]] = [
            lambda: page.locator("#take").click(),
            lambda: page.keyboard.press("Escape"),
            lambda: page.evaluate("window.dispatchEvent(new Event('blur'))"),
        ]
        for let_go in ways:
            go()
            let_go()
            braked()
            take()
        go()
        page.close()
        assert_let_go(session)
        assert unexpected(complaints) == []


def assert_let_go(session: Session) -> None:
    """Nobody drives any more, and the machine stands still, within the time that a slow computer needs."""
    for _ in range(round(10 * PATIENCE)):
        if session.snapshot().driver is None and not session.snapshot().state.v.any():
            break
        clock.sleep(0.1)
    assert session.snapshot().driver is None
    assert not session.snapshot().state.v.any()


def lose(station: TeleopStation) -> None:
    """Cut the connections of all pages, without a word, as a network does."""
    server = station._server  # opens the wall: nothing in the program cuts a connection
    for socket in server.pages:
        assert socket.ws_connection is not None
        assert socket.ws_connection.stream is not None
        server._loop.call_soon_threadsafe(socket.ws_connection.stream.close)


def test_a_page_that_loses_its_connection_lets_go_and_comes_back_to_the_present(
    backhoe: Robot, browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "obstacles": [
                {"name": "pole", "shape": "cylinder", "radius": 0.2, "length": 4, "position": [-2, -3, 1]},
                {"name": "rock", "shape": "sphere", "radius": 0.3, "position": [-2, 3, 0]},
            ],
        }
    )
    with TeleopStation(backhoe, scene, port=0, output=tmp_path / "driven.json") as station:
        session = station.session
        page, _ = open_page(browser, station.url)
        page.locator("#take").click()
        page.wait_for_function("backhoe.teleop.driving")
        page.keyboard.down("KeyW")
        page.wait_for_function("backhoe.teleop.state.speed > 0.1")

        with monkeypatch.context() as patch:
            patch.setattr(live_server, "_MOST_PAGES", 0)  # it cannot come back yet
            lose(station)
            page.wait_for_function("document.getElementById('notice').textContent === 'Connection lost, trying again…'")
            assert page.locator("#notice").is_visible()
            assert not page.evaluate("backhoe.teleop.driving")
            for control in ("#take", "#record", "#mode", "#drive-speed", "#circulate", "[data-drop=ball]"):
                assert page.locator(control).is_disabled(), control
            assert page.locator("#status-word").inner_text() == "Not connected"
            assert page.locator(".margin .remove").count() == 0
            assert_let_go(session)

            other = session.join()  # what happens in the meantime
            assert session.hear(other, '{"type": "take"}')["ok"]
            assert session.hear(other, '{"type": "remove", "name": "rock"}')["ok"]
            session.leave(other)

        page.wait_for_function("document.getElementById('notice').hidden")
        page.wait_for_function("backhoe.teleop.state.taken.includes('rock') && backhoe.teleop.page > 2")
        nodes = "Object.keys(backhoe.viewer.scene_tree.children.site.children)"
        assert page.evaluate(nodes) == ["pole"]
        assert page.locator("#margins .name").all_inner_texts() == ["pole", "the machine itself"]
        assert not page.evaluate("backhoe.teleop.driving")  # a key that is still held drives nothing
        page.keyboard.up("KeyW")
        page.locator("#take").click()
        page.wait_for_function("backhoe.teleop.driving")
        page.keyboard.down("KeyW")
        page.wait_for_function("backhoe.teleop.state.speed > 0.1")

        # a page that hangs while it drives has let go when it is back
        monkeypatch.setattr(teleop_station, "_SILENT", 0.5)
        page.evaluate("() => { const until = performance.now() + 1500; while (performance.now() < until); }")
        page.wait_for_function("backhoe.teleop.state.driver === null && backhoe.teleop.state.speed === 0")
        assert "silent for too long" in page.locator("#toast").inner_text()
        assert page.locator("#take").inner_text() == "Take the controls"
    page.wait_for_function("document.getElementById('notice').textContent.includes('that shows this has ended.')")
    assert page.locator("#take").is_disabled()
    page.close()


PAD = "window.axes = [0, 0, -1]; navigator.getGamepads = () => [null, {connected: true, axes: window.axes}];"


@pytest.mark.long
def test_a_gamepad_drives_and_an_axis_that_rests_at_its_end_does_not(backhoe: Robot, browser: Any) -> None:
    """Three axes: the left stick, and a trigger that rests at -1, as some pads have it."""
    joints = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    scene = bp.scene_from_dict(
        {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}}
    )
    with TeleopStation(backhoe, scene, port=0, output=Path("not_written.json")) as station:
        page, complaints = open_page(browser, station.url)
        page.evaluate(PAD)
        page.wait_for_function("!document.getElementById('gamepad').hidden")
        tip = "backhoe.teleop.state.tip"
        start = page.evaluate(tip)
        page.locator("#take").click()
        page.wait_for_function("backhoe.teleop.driving")
        page.wait_for_timeout(400)
        np.testing.assert_array_equal(page.evaluate(tip), start)

        page.evaluate("window.axes[1] = -1")  # the stick forward: out
        page.wait_for_function(f"{tip}[0] > {start[0]} + 0.2")
        page.evaluate("window.axes[1] = 0.05")  # within what a worn stick shows at rest
        rest(page)
        reached = page.evaluate(tip)
        assert abs(reached[1] - start[1]) < 0.01
        page.evaluate("window.axes[0] = 1")  # to the right
        page.wait_for_function(f"{tip}[1] < {reached[1]} - 0.2")
        page.evaluate("window.axes[0] = 0")
        rest(page)
        assert unexpected(complaints) == []
        page.close()
