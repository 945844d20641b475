"""The page of a sequence: its legs, its loads, and obstacles that are absent in a leg."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from waiting import PATIENCE

from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.motion import build_problem
from backhoe_planner.planning import Plan, export_plan, plan
from backhoe_planner.show import Display, SceneGraph, label_rows, timeline, write_page
from backhoe_planner.show.page import page_content
from backhoe_planner.site import scene_from_dict

POSTURE = {"boom": 0.4, "stick": -1.6, "bucket": -0.9}
STONE = {"name": "a/b <stone>", "shape": "sphere", "radius": 0.3, "position": [0.0, 0.5, 0.0]}
LEGS: list[dict[str, Any]] = [
    {"name": "there", "goal": {"joints": POSTURE | {"swing": 0.2}}},
    {"name": "laden", "goal": {"joints": POSTURE | {"swing": 0.6}}, "carries": STONE},
    {"name": "rest", "wait": 0.4, "carries": STONE},
    {"name": "back", "goal": {"joints": POSTURE | {"swing": 0.3}}},
]
KERB = {"name": "kerb", "shape": "sphere", "radius": 0.2, "position": [2.0, -3.0, 0.0], "legs": ["there"]}


@pytest.fixture(scope="module")
def done(backhoe: Robot) -> Plan:
    start = {"joints": POSTURE | {"swing": 0.0}}
    scene = scene_from_dict({"version": 1, "start": start, "task": {"sequence": LEGS}, "obstacles": [KERB]})
    found = plan(backhoe, scene, effort="quick")
    assert found.verified, found.message
    return found


def test_a_load_moves_with_the_tip_and_is_shown_in_its_legs_only(backhoe: Robot, done: Plan) -> None:
    """The stone's middle is 0.5 m to the left of the tip, along the bucket's level edge."""
    frames = timeline(done.problem, done.trajectory)
    graph = SceneGraph(Display().visualizer(), done.problem)
    (load,) = graph.loads
    assert load["name"] == STONE["name"]
    path = f"{graph.prefix}/{'/'.join(load['node'])}"
    tracks = {track.kind: track.values for track in graph.animation(frames).tracks if track.path == path}
    begins = {leg.name: leg.begins for leg in done.legs}
    laden = (frames.time >= begins["laden"]) & (frames.time < begins["back"])
    assert 0 < laden.sum() < len(laden)
    np.testing.assert_array_equal(tracks["scale"][laden], 1.0)
    assert np.all(tracks["scale"][~laden] < 1e-3)
    kinematics = Kinematics(backhoe)
    for q, position, turn in zip(frames.q, tracks["position"], tracks["quaternion"], strict=True):
        middle = position + pin.Quaternion(*turn[[3, 0, 1, 2]]).toRotationMatrix() @ load["anchor"]
        left = np.array([-np.sin(q[0]), np.cos(q[0]), 0.0])
        np.testing.assert_allclose(middle, kinematics.at(q).tip_position + 0.5 * left, atol=1e-3)


def test_a_problem_is_drawn_with_the_load_of_its_first_leg(backhoe: Robot) -> None:
    start = {"joints": POSTURE | {"swing": 0.0}}
    for legs, size in ((LEGS, 1e-5), (LEGS[1:], 1.0)):
        display = Display()
        problem = build_problem(backhoe, scene_from_dict({"version": 1, "start": start, "task": {"sequence": legs}}))
        graph = SceneGraph(display.visualizer(), problem)
        placed = graph._placed["carried", graph.loads[0]["node"][1]]
        assert np.linalg.norm(placed[:3, 0]) == pytest.approx(size)


def test_exports_name_the_load_of_every_leg(done: Plan, tmp_path: Path) -> None:
    export_plan(done, tmp_path / "plan.npz")
    with np.load(tmp_path / "plan.npz") as arrays:
        assert arrays["leg_carries"].tolist() == ["", STONE["name"], STONE["name"], ""]


@pytest.mark.long
def test_the_page_of_a_sequence_shows_legs_and_loads(browser: Any, done: Plan, tmp_path: Path) -> None:
    write_page(done, tmp_path / "plan.html")
    page = browser.new_page(viewport={"width": 390, "height": 600}, reduced_motion="reduce")
    page.set_default_timeout(1e3 * PATIENCE)
    complaints = browser.complaints_of(page)
    page.goto((tmp_path / "plan.html").as_uri())
    page.wait_for_function("window.backhoe !== undefined && document.querySelector('#joints td') !== null")

    def seen(moment: float) -> tuple[str, str, list[str]]:
        page.evaluate(f"backhoe.seek({moment})")
        for _ in range(3):  # frames
            page.evaluate("new Promise(requestAnimationFrame)")
        names = "[...document.querySelectorAll('#names span')].filter((e) => e.style.visibility === 'visible')"
        named = page.evaluate(f"{names}.map((e) => e.textContent)")
        return page.inner_text("#leg"), page.inner_text("#margins .value >> nth=0"), sorted(named)

    begins = [leg.begins for leg in done.legs]
    leg, margin, names = seen(0.5 * begins[1])
    assert leg == "1/4 there"
    assert margin != "not in this leg"
    assert "kerb" in names
    assert STONE["name"] not in names
    leg, margin, names = seen(0.5 * (begins[1] + begins[2]))
    assert leg == "2/4 laden"
    assert margin == "not in this leg"
    assert "kerb" not in names
    assert STONE["name"] in names
    blocks = page.locator("#leg-strip button")
    assert blocks.count() == 4
    ends = [*begins[1:], done.trajectory.duration]
    for index, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        box, strip = blocks.nth(index).bounding_box(), page.locator("#leg-strip").bounding_box()
        assert box["width"] / strip["width"] == pytest.approx((end - begin) / done.trajectory.duration, abs=0.01)
    blocks.nth(3).click()
    assert page.inner_text("#leg") == "4/4 back"
    assert f"carries {STONE['name']}" in page.inner_text("#facts")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert complaints == []
    page.close()


def test_names_above_a_figure_do_not_cover_each_other() -> None:
    """By hand: the second begins within the first, the third within both, the fourth behind the first."""
    assert label_rows([0.0, 10.0, 12.0, 40.0], [20.0, 5.0, 50.0, 5.0]) == [0, 1, 2, 0]
    assert label_rows([0.0, 20.0], [20.0, 20.0]) == [0, 0]
    assert label_rows([], []) == []


def test_what_two_legs_keep_has_one_row_with_figures_at_their_frames_alone(backhoe: Robot) -> None:
    """The pitch is the same all the time; legs 1 and 3 keep the same range of it."""
    keep = {"pitch": [-2.3, -1.9]}
    legs = [{"name": f"leg {k}", "goal": {"joints": POSTURE | {"swing": 0.3 * k}}} for k in (1, 2, 3)]
    legs = [legs[0] | {"keep": keep}, legs[1], legs[2] | {"keep": keep}]
    scene = scene_from_dict({"version": 1, "start": {"joints": POSTURE | {"swing": 0.0}}, "task": {"sequence": legs}})
    found = plan(backhoe, scene, effort="quick")
    (kept,) = page_content._kept(found, timeline(found.problem, found.trajectory))  # opens the wall: the page's figures
    known = [value is not None for value in kept["margins"]]
    changes = [k for k in range(1, len(known)) if known[k] != known[k - 1]]
    assert (known[0], known[-1], len(changes)) == (True, True, 2)
    pitch = sum(POSTURE.values())  # each of the three turns about the same axis
    left = np.degrees(min(-1.9 - pitch, pitch + 2.3))
    assert {round(value, 6) for value in kept["margins"] if value is not None} == {round(float(left), 6)}
