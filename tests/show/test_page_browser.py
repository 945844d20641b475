"""The page and the live view in a real browser."""

from __future__ import annotations

import io
import socket
import threading
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from waiting import PATIENCE

from backhoe_planner.errors import InputError, OutputError
from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.motion import Trajectory, build_problem
from backhoe_planner.planning import Bound, FastMotion, Findings, ObjectiveCost, Plan, measure_motion
from backhoe_planner.proof import certify_problem
from backhoe_planner.show import Viewer, plan_page, write_page
from backhoe_planner.site import Scene, scene_from_dict

HOSTILE = "</script><script>window.pwned=1</script><img src=x onerror='window.pwned=1'> \"q\" \u2028 \u4e2d a/b &amp;"
START = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
END = [0.9, 0.6, -1.3, -0.5]
SWING = "backhoe.viewer.scene_tree.find(['machine', 'swing_post']).object.quaternion.toArray()"


class Tab:
    """A page of the browser, with all its complaints and network requests."""

    def __init__(self, browser: Any, *, drawn: bool = False) -> None:
        self.page = browser.new_page(drawn=drawn, viewport={"width": 560, "height": 400}, reduced_motion="reduce")
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.complaints = browser.complaints_of(self.page)
        self.requests: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))

    def open(self, url: str) -> None:
        self.page.goto(url)
        self.page.wait_for_function("window.backhoe !== undefined && document.querySelector('#joints td') !== null")

    def ask(self, expression: str) -> Any:
        return self.page.evaluate(expression)

    def wait_for_picture(self) -> None:
        """Wait for three frames: whatever was requested before is then on the canvas."""
        for _ in range(3):
            self.ask("new Promise(requestAnimationFrame)")

    def picture(self) -> np.ndarray[Any, Any]:
        return np.asarray(Image.open(io.BytesIO(self.page.locator("#meshcat-pane canvas").screenshot())).convert("RGB"))


@pytest.fixture
def tab(browser: Any) -> Iterator[Tab]:
    opened = Tab(browser)
    yield opened
    opened.page.close()


@pytest.fixture
def drawn_tab(browser: Any) -> Iterator[Tab]:
    opened = Tab(browser, drawn=True)
    yield opened
    opened.page.close()


def the_scene(name: str) -> Scene:
    return scene_from_dict(
        {
            "version": 1,
            "name": name,
            "start": {"joints": START},
            "task": {"goal": {"position": [3.0, 1.0, 0.0], "pitch": [-2.0, -1.0]}},
            "obstacles": [
                {"name": "gas pipe", "shape": "capsule", "from": [1, -3, -2], "to": [1, 3, -2], "radius": 0.1},
                {"name": HOSTILE, "shape": "box", "size": [1, 1, 1], "position": [5.0, -1.5, 0.5], "clearance": 0.3},
                {"name": "constructor", "shape": "cylinder", "radius": 0.2, "length": 2, "position": [4.6, 2.0, 1.0]},
                {"name": "__proto__", "shape": "halfspace", "point": [0, 0, 7], "normal": [0, 0, -1], "clearance": 1},
                {"name": "late", "shape": "sphere", "radius": 0.3, "position": [-2, -3, 1], "appears_at": 1.0,
                 "velocity": [0.5, 0, 0]},
            ],
        }
    )  # fmt: skip


def the_plan(robot: Robot, *, verified: bool = True, name: str = HOSTILE) -> Plan:
    scene = the_scene(name)
    part = np.linspace(0.0, 1.0, 60)[:, None]
    first = np.array([START[joint] for joint in robot.joint_names])
    q = first + (10 * part**3 - 15 * part**4 + 6 * part**5) * (np.array(END) - first)
    trajectory = Trajectory.from_steps(4.0 * part[:, 0], q)
    problem = build_problem(robot, scene)
    certificate = certify_problem(problem, trajectory)
    metrics = measure_motion(problem, trajectory, certificate, planning_time=0.5)
    plan = Plan(
        problem=problem,
        method="reactive",
        seed=0,
        trajectory=trajectory,
        certificate=replace(certificate, problems=() if verified else ("blocked",)),
        metrics=metrics.model_copy(update={"energy": metrics.energy | {"work": 1234.0}}),
        failure="" if verified else "blocked",
        note="" if verified else f"{HOSTILE} blocks the way",
    )
    assert plan.verified == verified
    return plan


def test_the_page_shows_the_plan_without_a_network(backhoe: Robot, drawn_tab: Tab, tmp_path: Path) -> None:
    tab = drawn_tab
    file = tmp_path / "plan.html"
    assert write_page(the_plan(backhoe), file) == ()
    assert list(tmp_path.iterdir()) == [file]
    tab.open(file.as_uri())
    tab.ask("backhoe.seek(0)")
    tab.wait_for_picture()
    before, straight = tab.picture(), tab.ask(SWING)
    assert before.std(axis=(0, 1)).min() > 8.0  # not blank
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 500

    tab.page.locator("#scrubber").fill("4")
    tab.wait_for_picture()
    turned = tab.ask(SWING)
    assert abs(turned[2]) == pytest.approx(np.sin(END[0] / 2.0), abs=1e-4)  # about z by the swing angle
    assert straight == pytest.approx([0.0, 0.0, 0.0, 1.0])
    assert np.mean(np.any(np.abs(tab.picture().astype(int) - before) > 12, axis=2)) > 0.01
    assert tab.page.locator("#clock").inner_text() == "4.00 / 4.00 s"
    assert f"{np.degrees(END[0]):.1f}°" in tab.page.locator("#joints").inner_text()

    assert "Verified" in tab.page.locator("#verdict").inner_text()
    assert tab.page.locator("#title").text_content() == HOSTILE
    assert "1.234 kJ" in tab.page.locator("#facts").inner_text()
    assert tab.ask("window.pwned") is None
    assert tab.ask("document.querySelectorAll('#panel img').length") == 0
    assert tab.ask("[...document.querySelectorAll('.margin .name')].map((e) => e.textContent)")[:4] == [
        "gas pipe", HOSTILE, "constructor", "__proto__",
    ]  # fmt: skip
    assert tab.complaints == []
    assert [url for url in tab.requests if not url.startswith(("file:", "data:"))] == []


@pytest.mark.long
def test_the_page_shows_the_bound_the_kept_ranges_and_the_reached_goal(
    backhoe: Robot, tab: Tab, tmp_path: Path
) -> None:
    """The pitch goes from -2.1 to -1.2 rad; the motion ends at the second of two goals."""
    plan = the_plan(backhoe)
    content = plan.scene.to_dict()
    end = {"joints": dict(zip(backhoe.joint_names, END, strict=True))}
    goals = [{"position": [4.0, -1.0, 1.0]}, end]
    content |= {"name": "full", "objective": "kinetic", "task": {"goal": goals, "keep": {"pitch": [-2.3, -1.1]}}}
    problem = build_problem(backhoe, scene_from_dict(content))
    certificate = certify_problem(problem, plan.trajectory)
    assert certificate.goal == 2
    bound = Bound(duration=2.5, longer_percent=60.0, settled=True)
    metrics = measure_motion(problem, plan.trajectory, certificate).model_copy(
        update={"cost": ObjectiveCost(objective="kinetic", value=12345.0, unit="J s")}
    )
    fast = Findings(fast=FastMotion(duration=3.0, cost=24690.0))
    shown = replace(plan, problem=problem, certificate=certificate, metrics=metrics, findings=fast)
    vars(shown)["bound"] = bound  # in place of the computed one
    write_page(shown, tmp_path / "plan.html")
    tab.open((tmp_path / "plan.html").as_uri())
    facts = tab.page.locator("#facts").inner_text()
    assert "no motion can take less than 2.50 s" in facts
    assert "longer" not in facts  # it is slow on purpose
    assert "kinetic 12.35 kJ s" in facts
    assert "50 % less than a motion of 3.00 s, which takes 24.69 kJ s" in facts
    assert "Goal reached\n2 of 2" in facts
    assert "Kept: pitch\n5.73° left" in facts  # 0.1 rad at the end
    assert tab.page.locator("#names .reached").inner_text() == "goal 2, reached"
    tab.ask("backhoe.seek(0)")
    assert tab.page.locator("#kept").inner_text().split("\n") == ["pitch −131.8 to −63.03°", "11.5°"]
    tab.ask("backhoe.seek(4)")
    assert tab.page.locator("#kept .value").inner_text() == "5.7°"
    assert tab.page.locator("#kept .value").get_attribute("title") == "now −68.8°"
    assert tab.complaints == []


def test_margins_to_obstacles_and_to_itself_are_apart_and_a_fixed_gap_leaves_the_time_bar_green(
    backhoe: Robot, tab: Tab, tmp_path: Path
) -> None:
    """The tip reaches its place, and is turned by 0.1 rad from the required pitch."""
    there = Kinematics(backhoe).at(np.array(END))
    plan = the_plan(backhoe, name="a site")
    content = plan.scene.to_dict()
    content["task"] = {"goal": {"position": there.tip_position.tolist(), "pitch": float(there.pitch) + 0.1}}
    problem = build_problem(backhoe, scene_from_dict(content))
    certificate = replace(certify_problem(problem, plan.trajectory), problems=())
    near, own = certificate.obstacle_clearance, certificate.self_clearance
    assert near is not None
    assert own is not None
    assert (near.kind, own.kind) == ("obstacle", "machine")
    assert certificate.min_clearance in (near, own)
    write_page(replace(plan, problem=problem, certificate=certificate), tmp_path / "plan.html")
    tab.open((tmp_path / "plan.html").as_uri())
    facts = tab.page.locator("#facts").inner_text().replace("\N{MINUS SIGN}", "-")
    assert f"Tightest margin\n{near.margin:.3f} m\n{near.link} to {near.obstacle} at" in facts
    assert f"Margin to itself\n{own.margin:.3f} m\n{own.link} to {own.obstacle} at" in facts
    assert "Tip error\n0.0 mm, 5.73°" in facts

    def redness(margin_to_itself: str, *, margin: float = 9.0) -> list[bool]:
        """Whether the time bar is more red than green, at its beginning and its end."""
        tab.ask(
            "() => { const { margins } = backhoe.plan, last = margins.length - 1; for (const row of margins)"
            f" row.forEach((_, k) => {{ row[k] = row === margins[last] ? {margin_to_itself} : {margin}; }}); }}"
        )
        tab.page.set_viewport_size({"width": 560 + (tab.ask("innerWidth") == 560), "height": 400})  # draws it anew
        tab.page.wait_for_timeout(300)
        return [
            tab.page.evaluate(
                "(end) => { const bar = document.getElementById('heat'), x = end * (bar.width - 1);"
                " const [r, g] = bar.getContext('2d').getImageData(x, 2, 1, 1).data; return r > g; }", end,
            ) for end in (0, 1)
        ]  # fmt: skip

    assert redness("0.02") == [False, False]  # links side by side
    assert redness("k > 60 ? 0.002 : 0.02") == [False, True]
    assert redness("0.02", margin=0.02) == [True, True]  # an obstacle that stays near is near
    assert redness("-0.01") == [True, True]
    assert [text for text in tab.complaints if "Canvas2D" not in text] == []  # bars are not read again and again


@pytest.mark.long
def test_the_page_plays_and_its_switches_work(backhoe: Robot, tab: Tab, tmp_path: Path) -> None:
    write_page(the_plan(backhoe, verified=False, name="a site"), tmp_path / "plan.html")
    tab.open((tmp_path / "plan.html").as_uri())
    badge = tab.page.locator("#verdict")
    assert badge.get_attribute("class") == "failed"
    assert badge.inner_text().startswith("Failed: blocked")
    assert f"{HOSTILE} blocks the way".split()[-3:] == badge.inner_text().split()[-3:]

    assert tab.ask("backhoe.time") == 0  # no autoplay with reduced motion
    tab.page.locator("#speed").select_option("4")
    tab.page.locator("#play").click()
    tab.page.wait_for_function("backhoe.time > 0.5")
    tab.page.locator("#play").click()
    stopped = tab.ask("backhoe.time")
    tab.wait_for_picture()
    assert tab.ask("backhoe.time") == stopped

    shells = "backhoe.viewer.scene_tree.find(['clearance']).object.visible"
    assert tab.ask(shells) is False
    tab.page.locator("[data-node=clearance]").check()
    assert tab.ask(shells) is True

    late = "backhoe.viewer.scene_tree.find(['site', 'late']).object"
    tab.ask("backhoe.seek(0.5)")
    assert tab.ask(f"{late}.scale.x") < 1e-3  # not there yet
    row = tab.page.locator(".margin", has_text="late").locator(".value")
    assert row.inner_text() == "from 1.0 s on"
    tab.ask("backhoe.seek(3)")
    assert row.inner_text().endswith(" m")
    assert tab.ask(f"[{late}.scale.x, {late}.position.x]") == pytest.approx([1.0, 1.0], abs=0.02)

    # the longest name that a thing on a job's ground has
    tab.ask("document.getElementById('names').append(document.createElement('span'))")
    label = "document.querySelector('#names span:last-child')"
    tab.ask(f"{label}.textContent = 'what stands at x -12.8, y -12.7 m'")
    assert tab.ask(f"{label}.scrollWidth <= {label}.clientWidth")
    tab.ask(f"{label}.remove()")

    assert not tab.page.locator(".dg.main").is_visible()
    tab.page.locator("#tree").click()
    assert tab.page.locator(".dg.main").is_visible()
    assert tab.complaints == []


def test_a_page_that_cannot_be_written_leaves_no_file(backhoe: Robot, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist"):
        write_page(the_plan(backhoe), tmp_path / "nowhere" / "plan.html")
    assert list(tmp_path.iterdir()) == []


def test_a_plan_of_one_sample_has_a_page(backhoe: Robot) -> None:
    whole = the_plan(backhoe, verified=False)
    trajectory = Trajectory.from_steps(np.zeros(1), whole.trajectory.q[:1])
    certificate = certify_problem(whole.problem, trajectory)
    metrics = measure_motion(whole.problem, trajectory, certificate)
    page, _ = plan_page(replace(whole, trajectory=trajectory, certificate=certificate, metrics=metrics))
    assert "<script>window.pwned" not in page
    assert "the picture shows the posture at the start" in page
    assert '"Tip error"' not in page


def test_the_page_of_a_posture_that_breaks_keep_says_of_no_goal_that_it_is_reached(
    backhoe: Robot, tab: Tab, tmp_path: Path
) -> None:
    """It is the posture on the second of two goals, where the pitch is -1.2 rad: 0.1 rad, or 5.7 degrees, too low."""
    plan = the_plan(backhoe, verified=False)
    end = {"joints": dict(zip(backhoe.joint_names, END, strict=True))}
    task = {"goal": [{"position": [4.0, -1.0, 1.0]}, end], "keep": {"pitch": [-1.1, -0.5]}}
    problem = build_problem(backhoe, scene_from_dict(plan.scene.to_dict() | {"task": task}))
    trajectory = Trajectory.from_steps(np.zeros(1), np.array([END]))
    certificate = certify_problem(problem, trajectory)
    assert certificate.goal == 2
    metrics = measure_motion(problem, trajectory, certificate)
    shown = replace(plan, problem=problem, trajectory=trajectory, certificate=certificate, metrics=metrics)
    write_page(replace(shown, failure="goal_breaks_keep"), tmp_path / "plan.html")
    tab.open((tmp_path / "plan.html").as_uri())
    facts = tab.page.locator("#facts").inner_text()
    assert "Motion\nnone" in facts
    assert "Goal reached" not in facts
    assert "whole motion" not in facts
    assert tab.page.locator("#names .reached").count() == 0
    assert tab.page.locator("#kept .value").inner_text() == "\u22125.7°"


def test_the_live_view_shows_steps_and_then_the_plan(backhoe: Robot, tab: Tab, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = the_plan(backhoe)
    given = plan.scene.to_dict()
    kept = given | {"task": given["task"] | {"keep": {"tilt": {"axis": [0, 0, 1], "tolerance": 2.0}}}}
    with Viewer(port=0) as viewer:
        assert viewer.show_problem(build_problem(backhoe, scene_from_dict(kept))) == ()
        assert not viewer.wait_for_browser(0.05)
        tab.open(viewer.url)
        assert viewer.wait_for_browser(PATIENCE)
        assert viewer.alive()

        key = tab.page.locator("#kept-key")  # of the arrow and the cone in the picture
        key.wait_for(state="visible")
        assert key.inner_text().strip() == "the kept axis at the tip, and its cone"
        assert key.locator(".swatch").evaluate("(e) => e.style.background") == "rgb(122, 79, 191)"

        with monkeypatch.context() as patch:
            patch.setattr("time.perf_counter", lambda: 1e6)  # however long the first takes, the second comes at once
            assert viewer.show_step(plan.trajectory.q[-1], 4.0)
            assert not viewer.show_step(plan.trajectory.q[0], 4.0)  # too soon
        tab.page.wait_for_function(f"Math.abs({SWING}[2]) > 0.3")
        assert abs(tab.ask(SWING)[2]) == pytest.approx(np.sin(END[0] / 2.0), abs=1e-6)
        # the panel follows with the next frame
        told = f"document.getElementById('joints').innerText.includes('{np.degrees(END[0]):.1f}°')"
        tab.page.wait_for_function(told)

        viewer.play(plan)
        tab.page.wait_for_function("backhoe.plan !== null")
        tab.ask("backhoe.seek(0)")
        assert tab.ask(SWING) == pytest.approx([0.0, 0.0, 0.0, 1.0])
        assert "Verified" in tab.page.locator("#verdict").inner_text()
        assert not key.is_visible()  # the plan keeps nothing
        viewer.show_problem(build_problem(backhoe, scene_from_dict(kept)))
        key.wait_for(state="visible")
    assert not viewer.alive()
    tab.page.wait_for_function("!document.getElementById('notice').hidden")
    # three.js warns if a frame is drawn before a new light is set to cast no shadow
    expected = ("WebSocket", "has no shadow")
    assert [text for text in tab.complaints if not any(word in text for word in expected)] == []


@pytest.mark.long
def test_frequent_steps_cost_little_processor_time(backhoe: Robot) -> None:
    plan = the_plan(backhoe)
    with Viewer(port=0) as viewer:
        viewer.show_problem(build_problem(backhoe, plan.scene))
        begun, drawn, spent = time.perf_counter(), 0, 0.0
        while (elapsed := time.perf_counter() - begun) < 1.0 or drawn < 5:  # a busy machine draws fewer in a second
            busy = time.thread_time()  # the processor's, which other processes do not lengthen
            shown = viewer.show_step(plan.trajectory.q[drawn % 60], 0.0)
            drawn += shown
            spent += (time.thread_time() - busy) if shown else 0.0
        assert drawn <= 30.0 * elapsed + 1.0
        assert spent < 0.1  # 4 %, and room for one slow step


def test_a_closed_viewer_leaves_no_thread_and_no_open_port(backhoe: Robot) -> None:
    viewer = Viewer(port=0)
    with urllib.request.urlopen(viewer.url, timeout=PATIENCE) as answer:
        assert b"meshcat-pane" in answer.read()
    viewer.close()
    viewer.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "live view"]
    port = int(viewer.url.rsplit(":", 1)[1].strip("/"))
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0


def test_a_port_in_use_is_an_error() -> None:
    with Viewer(port=0) as viewer:
        port = int(viewer.url.rsplit(":", 1)[1].strip("/"))
        with pytest.raises(OutputError, match="port"):
            Viewer(port=port)


def test_the_viewer_refuses_calls_from_another_thread(backhoe: Robot) -> None:
    problem = build_problem(backhoe, the_scene("a site"))
    caught: list[BaseException] = []

    def misuse(viewer: Viewer) -> None:
        try:
            viewer.show_problem(problem)
        except InputError as error:
            caught.append(error)

    with Viewer(port=0) as viewer:
        other = threading.Thread(target=misuse, args=(viewer,))
        other.start()
        other.join()
        with pytest.raises(InputError, match="problem first"):
            viewer.show_step(np.zeros(4))
    assert "thread" in str(caught[0])
