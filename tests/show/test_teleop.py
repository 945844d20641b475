"""Tele-operation without a browser: the session, the messages, and what the server accepts."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time as clock
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tornado.httpclient
import tornado.httputil
import tornado.websocket
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from waiting import PATIENCE

import backhoe_planner as bp
from backhoe_planner.errors import InputError, OutputError
from backhoe_planner.live import Command, ServoState, Status, is_recording, problem_to_show, unrecorded_changes
from backhoe_planner.machine import Robot
from backhoe_planner.planning import Findings, RecordingNotes
from backhoe_planner.show import (
    LARGEST,
    Add,
    Caption,
    LiveServer,
    LiveSocket,
    SceneGraph,
    Session,
    Sticks,
    TeleopServer,
    TeleopStation,
    Wording,
    free_name,
    joint_rates,
    parse,
    site_mesh,
)
from backhoe_planner.show.viewer import live_server
from backhoe_planner.site import Obstruction, Proximity, build_obstacle, build_obstacles

Data = dict[str, Any]

ROOT = Path(__file__).resolve().parents[2]
SITE: Data = {
    "version": 1,
    "name": "a yard",
    "start": {"joints": {"swing": 0.0, "boom": 0.3, "stick": -0.9, "bucket": -0.5}},  # the tip at (4.74, 0, -0.66)
    "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
    "clearance": 0.1,
    "obstacles": [{"name": "pole", "shape": "cylinder", "radius": 0.15, "length": 6, "position": [3, -3, 0]}],
    "zones": [{"kind": "ceiling", "name": "power line", "height": 5.0, "stop": 0.5, "slow": 1.0, "warn": 3.5}],
}
BALL: Data = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [4.7, 1.6, -0.6]}
SCREEN: Data = {"name": "screen", "shape": "box", "size": [8, 0.4, 8], "position": [4, 1.8, 0]}
LEFT: Data = {"type": "tip", "velocity": [0.0, 0.6, 0.0]}


GROUND: Data = {"name": "ground", "shape": "halfspace", "point": [0, 0, -1.0], "normal": [0, 0, 1]}
STEP = 0.02  # s, where the length of a step is not the point: a quarter of the work of the default


class Stepped(Session):
    """A session whose clock advances with its steps."""

    def __init__(self, robot: Robot, *, dt: float = STEP, **more: Any) -> None:
        self.passed = 0.0
        super().__init__(robot, bp.scene_from_dict({**SITE, **more}), dt=dt, now=lambda: self.passed)

    def step(self) -> ServoState:
        self.passed += self.dt
        return super().step()


def make(backhoe: Robot, **more: Any) -> Session:
    return Stepped(backhoe, **more)


def say(session: Session, page: int, **content: Any) -> Data:
    return session.hear(page, json.dumps(content))


def done(session: Session, page: int, **content: Any) -> None:
    answer = say(session, page, **content)
    assert answer["ok"], answer["error"]


def drive(session: Session, page: int, seconds: float, **wish: Any) -> None:
    for k in range(round(seconds / session.dt)):
        if k % 5 == 0:
            done(session, page, **wish)
        session.step()


def advance(session: Session, seconds: float) -> None:
    for _ in range(round(seconds / session.dt)):
        session.step()


# --- who drives ----------------------------------------------------------------------------


def test_the_first_page_that_asks_drives_and_the_others_watch(backhoe: Robot) -> None:
    session = make(backhoe)
    one, two = session.join(), session.join()
    assert "take the controls first" in say(session, one, **LEFT)["error"]
    done(session, one, type="take")
    for content in (LEFT, {"type": "record", "on": True}, {"type": "add", "obstacle": BALL}, {"type": "stop"}):
        assert "page 1 drives" in say(session, two, **content)["error"]
    assert "sees that you ask" in say(session, two, type="take")["error"]
    before = session.snapshot()
    assert (before.driver, before.pages, before.asking) == (one, (one, two), (two,))
    done(session, one, type="hand_over", to=two)
    assert session.snapshot().driver == two
    assert session.snapshot().asking == ()
    done(session, two, **LEFT)
    assert not say(session, one, **LEFT)["ok"]
    assert "no such page" in say(session, two, type="hand_over", to=9)["error"]
    done(session, two, type="release")
    done(session, one, type="take")


def test_the_machine_stops_when_its_driver_disappears(backhoe: Robot) -> None:
    session = make(backhoe)
    page = session.join()
    done(session, page, type="take")
    drive(session, page, 1.0, **LEFT)
    assert np.abs(session.snapshot().state.v).max() > 0.05
    session.leave(page)
    assert session.snapshot().driver is None
    acceleration = session.robot.limits.acceleration
    previous = session.snapshot().state.v
    for _ in range(round(2.5 / session.dt)):
        v = session.step().v
        assert np.all(np.abs(v - previous) <= acceleration * session.dt * (1.0 + 1e-9))
        previous = v
    assert np.all(previous == 0.0)
    assert "not here" in say(session, page, **LEFT)["error"]


def test_the_watchdog_counts_clock_time_and_not_steps(backhoe: Robot) -> None:
    """A machine that is stepped too slowly, as under load, stops equally soon after the last command."""
    now = 100.0
    session = Session(backhoe, bp.scene_from_dict(SITE), now=lambda: now)
    page = session.join()
    done(session, page, type="take")
    for _ in range(100):
        done(session, page, **LEFT)
        session.step()
        now += session.dt
    assert session.snapshot().has_wish
    going = np.abs(session.step().v).max()
    now += 0.39
    assert np.abs(session.step().v).max() >= 0.9 * going
    assert session.snapshot().has_wish
    now += 0.02  # 0.41 s without a command, and two steps
    slower = [float(np.abs(session.step().v).max()) for _ in range(5)]
    assert slower[0] < going
    assert slower == sorted(slower, reverse=True)
    assert not session.snapshot().has_wish


def test_a_failing_step_brakes_the_machine_to_rest(backhoe: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    session = make(backhoe)
    page = session.join()
    done(session, page, type="take")
    drive(session, page, 1.0, **LEFT)
    previous = session.snapshot().state.v
    assert np.abs(previous).max() > 0.05

    def broken(*_: object) -> float:
        raise ArithmeticError("no number\nand more")

    monkeypatch.setattr(session, "_held_wish", broken)
    acceleration = session.robot.limits.acceleration
    session.step()
    assert session.failure == "the machine was stopped, as a step failed: ArithmeticError: no number"
    previous = session.snapshot().state.v
    for _ in range(round(2.5 / session.dt)):
        v = session.step().v
        assert np.all(np.abs(v - previous) <= acceleration * session.dt * (1.0 + 1e-9))
        previous = v
    assert np.all(previous == 0.0)
    assert "was stopped" in say(session, page, type="take")["error"]
    assert session.snapshot().failure == session.failure


# --- wishes --------------------------------------------------------------------------------


def test_tip_velocities_are_in_the_frame_of_the_arm(backhoe: Robot) -> None:
    session = make(backhoe, start={"joints": {"swing": 0.8, "boom": 0.3, "stick": -0.9, "bucket": -0.5}}, obstacles=[])
    page = session.join()
    done(session, page, type="take")
    axis = np.array(session.robot.model.jointPlacements[1].translation)
    outward = (session.snapshot().state.tip_position - axis)[:2]
    outward = outward / np.linalg.norm(outward)
    for velocity, along in (([-0.3, 0, 0], -outward), ([0, 0.3, 0], np.array([-outward[1], outward[0]]))):
        before = session.snapshot().state.tip_position
        drive(session, page, 0.8, type="tip", velocity=velocity)
        moved = (session.snapshot().state.tip_position - before)[:2]
        assert moved @ along / np.linalg.norm(moved) > 0.99
        drive(session, page, 1.5, type="stop")


def test_the_iso_and_sae_patterns_map_sticks_to_joint_rates() -> None:
    rates = np.array([0.8, 0.5, 0.8, 1.1])

    def asked(pattern: str, left: tuple[float, float], right: tuple[float, float], speed: float = 1.0) -> list[float]:
        message = Sticks.model_validate(
            {"type": "sticks", "pattern": pattern, "left": left, "right": right, "speed": speed}
        )
        return [float(rate) for rate in joint_rates(message, rates)]

    for pattern in ("iso", "sae"):
        assert asked(pattern, (1, 0), (0, 0)) == [-0.8, 0, 0, 0]  # to the right: clockwise from above
        assert asked(pattern, (0, 0), (-1, 0)) == [0, 0, 0, -1.1]  # curled in
    assert asked("iso", (0, 1), (0, 0)) == [0, 0, 0.8, 0]  # stick out
    assert asked("iso", (0, 0), (0, -1), 0.5) == [0, 0.25, 0, 0]  # boom up
    assert asked("sae", (0, -1), (0, 0)) == [0, 0.5, 0, 0]  # boom up
    assert asked("sae", (0, 0), (0, -1)) == [0, 0, -0.8, 0]  # stick in


def test_sticks_drive_the_machine(backhoe: Robot) -> None:
    session = make(backhoe)
    page = session.join()
    done(session, page, type="take")
    before = session.snapshot().state.q
    drive(session, page, 0.5, type="sticks", pattern="sae", left=[0, -0.5], right=[0, 0])
    moved = session.snapshot().state.q - before
    assert moved[1] > 0.02
    assert np.abs(moved[[0, 2, 3]]).max() < 1e-6


# --- the site ------------------------------------------------------------------------------


@pytest.mark.long
def test_an_obstacle_dropped_in_the_way_is_not_touched(backhoe: Robot) -> None:
    session = make(backhoe)
    page = session.join()
    done(session, page, type="take")
    done(session, page, type="add", obstacle=SCREEN)
    scene = bp.scene_from_dict({**SITE, "obstacles": [*SITE["obstacles"], SCREEN]})
    proximity = Proximity(backhoe, build_obstacles(scene, backhoe))
    near = False
    for k in range(300):
        if k % 5 == 0:
            done(session, page, **LEFT)
        state = session.step()
        margin = float(np.min(proximity.distances(state.q) - proximity.clearance))
        assert margin >= 0.0
        near |= margin < 0.02
    assert near
    assert state.status in (Status.SLIDING, Status.STOPPED)
    assert state.nearest is not None
    assert state.nearest.name == "screen"
    assert state.feedback_force[1] < -1.0  # pushes back
    spot = session.snapshot().nearest["screen"]
    assert spot is not None
    own = float(
        min(
            d
            for d, pair in zip(proximity.distances(state.q), proximity.pairs, strict=True)
            if pair.obstacle == "screen"
        )
    )
    assert spot.distance == pytest.approx(own, abs=1e-6)  # what the bar shows
    done(session, page, type="remove", name="screen")
    before = session.snapshot().state.tip_position[1]
    drive(session, page, 2.0, **LEFT)
    assert session.snapshot().state.tip_position[1] > before + 0.2


def test_obstacles_cannot_be_placed_in_the_machine_or_its_braking_path(backhoe: Robot) -> None:
    session = make(backhoe)
    page = session.join()
    done(session, page, type="take")
    at = session.snapshot().state.tip_position
    inside = {**BALL, "position": at.tolist()}
    assert "too close" in say(session, page, type="add", obstacle=inside)["error"]
    done(session, page, type="add", obstacle=BALL)
    assert "too close" in say(session, page, type="move", name="ball", to=(at - BALL["position"]).tolist())["error"]
    assert session.snapshot().shifts["ball"] == pytest.approx([0, 0, 0])
    done(session, page, type="move", name="ball", to=[0.0, 2.0, 0.0])
    assert session.snapshot().shifts["ball"] == pytest.approx([0, 2, 0])
    assert session.snapshot().nearest["ball"] is None  # out of sight
    drive(session, page, 2.0, **LEFT)
    state = session.snapshot().state  # it cannot stop at once
    ahead = {**BALL, "name": "ahead", "position": (state.tip_position + np.array([0.0, 0.55, 0.0])).tolist()}
    assert "too close" in say(session, page, type="add", obstacle=ahead)["error"]
    drive(session, page, 3.0, type="stop")
    assert np.abs(session.snapshot().state.v).max() == 0.0


def test_zones_cannot_be_changed_and_names_are_unique(backhoe: Robot) -> None:
    session = make(backhoe)
    page = session.join()
    done(session, page, type="take")
    assert "zone" in say(session, page, type="remove", name="power line")["error"]
    assert "zone" in say(session, page, type="move", name="power line", to=[0, 0, 1])["error"]
    assert "no obstacle of that name" in say(session, page, type="remove", name="nobody")["error"]
    assert "is the name of an obstacle" in say(session, page, type="add", obstacle={**BALL, "name": "pole"})["error"]
    assert "no such link" in say(session, page, type="add", obstacle={**BALL, "links": ["tail"]})["error"]
    assert "stands still" in say(session, page, type="add", obstacle={**BALL, "velocity": [1, 0, 0]})["error"]
    done(session, page, type="move", name="pole", to=[0.0, -0.5, 0.0])
    assert session.snapshot().movable == {"pole"}
    for k in range(50):
        last = say(session, page, type="add", obstacle={**BALL, "name": f"b{k}", "position": [8 + k, 8, 0]})
    assert "enough" in last["error"]
    assert session.snapshot().zones == {"power line": "warn"}


def test_ground_cannot_be_removed_and_removed_obstacles_can_be_put_back(backhoe: Robot, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "heights.csv", np.full((5, 5), -3.0), delimiter=",")
    np.savetxt(tmp_path / "scan.csv", np.array([[-4.0, 0.0, 0.0], [-4.0, 0.3, 0.0]]), delimiter=",")
    terrain = {"name": "terrain", "shape": "heightmap", "file": "heights.csv", "size": [20, 20]}
    scan = {"name": "scan", "shape": "pointcloud", "file": "scan.csv", "resolution": 0.2}
    content = {**SITE, "obstacles": [*SITE["obstacles"], GROUND, terrain, scan]}
    session = Session(backhoe, bp.scene_from_dict(content, folder=tmp_path))
    page = session.join()
    done(session, page, type="take")
    assert session.snapshot().movable == {"pole"}
    for name in ("ground", "terrain", "scan"):
        assert f"{name}: is ground or terrain" in say(session, page, type="remove", name=name)["error"]
        assert f"{name}: is ground or terrain" in say(session, page, type="move", name=name, to=[0, 0, 1])["error"]
    assert "no obstacle of that name was taken away" in say(session, page, type="put_back", name="pole")["error"]

    done(session, page, type="move", name="pole", to=[0.0, -0.5, 0.0])
    done(session, page, type="remove", name="pole")
    assert session.snapshot().taken == ("pole",)
    assert "pole" not in session.snapshot().shifts
    assert "may be put back" in say(session, page, type="add", obstacle={**BALL, "name": "pole"})["error"]
    done(session, page, type="put_back", name="pole")
    snapshot = session.snapshot()
    assert snapshot.taken == ()
    assert snapshot.movable == {"pole"}
    assert snapshot.shifts["pole"] == pytest.approx([0.0, -0.5, 0.0])

    # a dropped obstacle is gone for good, and no obstacle is put back into the machine
    done(session, page, type="add", obstacle=BALL)
    done(session, page, type="remove", name="ball")
    assert session.snapshot().taken == ()
    done(session, page, type="remove", name="pole")
    turned = make(backhoe, obstacles=[{**BALL, "name": "rock", "clearance": 0.05}])
    page = turned.join()
    done(turned, page, type="take")
    done(turned, page, type="remove", name="rock")
    drive(turned, page, 3.0, **LEFT)
    drive(turned, page, 1.0, type="stop")
    assert turned.snapshot().state.tip_position[1] > 1.0  # into the rock's place
    assert "too close" in say(turned, page, type="put_back", name="rock")["error"]
    assert turned.snapshot().taken == ("rock",)


# --- captions ---------------------------------------------------------------------------------


@pytest.mark.long
def test_the_caption_says_held_only_during_a_refused_wish(backhoe: Robot) -> None:
    session = make(backhoe, obstacles=[GROUND])
    page = session.join()
    done(session, page, type="take")
    wording = Wording()

    def told() -> Caption:
        snapshot = session.snapshot()
        return wording.next(snapshot.state, has_wish=snapshot.has_wish)

    for _ in range(50):  # no wish: the tip is 0.24 m from the ground's clearance
        session.step()
        found = told()
        assert (found.kind, found.word) == ("rest", "At rest")
        assert found.more.startswith("near ground, 0.2")

    kinds = []
    for k in range(100):
        if k % 5 == 0:
            done(session, page, type="tip", velocity=[0.0, 0.0, -0.3])
        session.step()
        kinds.append(told().kind)
    assert kinds[-1] == "held"
    assert "ground" in told().word
    first = kinds.index("held")
    assert set(kinds[first:]) == {"held"}  # it does not flicker
    assert kinds[0] == "free"

    done(session, page, type="stop")
    for _ in range(50):
        session.step()
        assert told().kind == "rest"
    assert told() == Caption("rest", "At rest", "near ground, 0.00 m")


def test_a_better_caption_is_shown_only_once_it_has_lasted() -> None:
    zero = np.zeros(3)

    def state(time: float, status: Status, margin: float) -> ServoState:
        road = Obstruction("obstacle", "road", "bucket", margin, margin)
        return ServoState(
            time, np.zeros(4), np.full(4, 0.1), status, Command.NEW, road, zero, zero, zero, zero, True, 1
        )

    wording = Wording()
    assert wording.next(state(1.0, Status.OK, 0.25), has_wish=True) == Caption("free", "Free", "bucket, 0.25 m")
    assert wording.next(state(1.1, Status.SLIDING, 0.2), has_wish=True).word == "Slowed before road"
    assert wording.next(state(1.2, Status.SLIDING, 0.01), has_wish=True).word == "Sliding along road"
    better = wording.next(state(1.3, Status.NEAR_OBSTACLE, 0.02), has_wish=True)
    assert better == Caption("held", "Sliding along road", "bucket, 0.02 m")
    assert wording.next(state(1.75, Status.NEAR_OBSTACLE, 0.02), has_wish=True).word == "Near road"
    assert wording.next(state(1.8, Status.STOPPED, 0.2), has_wish=True).word == "Held by a limit"
    assert wording.next(state(1.81, Status.STOPPED, 0.004), has_wish=False).word == "Coming to rest"
    assert wording.next(state(1.9, Status.EVADING, -0.01), has_wish=False).kind == "held"
    assert wording.next(state(2.0, Status.TOO_CLOSE, -0.01), has_wish=True).word == "Too close to road"


def test_obstacles_that_move_wait_until_somebody_takes_the_controls(backhoe: Robot, tmp_path: Path) -> None:
    cart = {"name": "cart", "shape": "box", "size": [1, 1, 1], "position": [2, -9, 0.5], "velocity": [0.5, 0, 0]}
    late = {"name": "late", "shape": "sphere", "radius": 1, "position": [-3, 9, 0.5], "appears_at": 0.2}
    scene = bp.scene_from_dict({**SITE, "obstacles": [cart, late]})
    with TeleopStation(backhoe, scene, port=0, output=tmp_path / "driven.json") as station:
        session = station.session
        assert any("wait until somebody takes the controls" in warning for warning in station.warnings)
        begun = session.snapshot()
        clock.sleep(0.1)
        page = session.join()  # to watch is not to drive
        clock.sleep(0.1)
        there = session.snapshot()
        assert there.waits
        assert there.state.time == begun.state.time
        assert Wording().next(there.state, has_wish=False, waits=True).word == "Nothing moves yet"
        done(session, page, type="take")
        wait(lambda: session.snapshot().state.time >= begun.state.time + 0.3)
        now = session.snapshot()
        assert now.shifts["late"] is not None  # it has appeared
        shift = now.shifts["cart"]
        assert shift is not None
        assert 0.1 < shift[0] <= 0.5 * now.state.time + 1e-9
        session.leave(page)
        assert not session.snapshot().waits  # what has begun goes on
    for obstacles, waits in (([cart], True), ([late], True), (SITE["obstacles"], False)):
        assert make(backhoe, obstacles=obstacles).waits is waits


# --- recording -----------------------------------------------------------------------------


def test_a_recording_becomes_a_verified_plan(backhoe: Robot, tmp_path: Path) -> None:
    scene = bp.scene_from_dict(SITE)
    session = Session(backhoe, scene, dt=STEP)
    page = session.join()
    done(session, page, type="take")
    drive(session, page, 0.7, **LEFT)  # it moves when the button is pressed
    done(session, page, type="record", on=True)
    assert session.snapshot().recording == "arming"
    advance(session, 2.0)
    assert session.snapshot().recording == "on"
    begun = session.snapshot().state.time - session.snapshot().recorded
    drive(session, page, 0.5, **LEFT)
    added = session.snapshot().state.time
    done(session, page, type="add", obstacle={**BALL, "position": [4.5, 2.6, -0.6]})
    done(session, page, type="move", name="pole", to=[0.5, 0.0, 0.0])
    drive(session, page, 3.0, **LEFT)
    done(session, page, type="record", on=False)
    assert session.take_recording() is None
    advance(session, 2.5)
    recording = session.take_recording()
    assert recording is not None
    assert session.snapshot().recording == "idle"
    plan = recording.plan(backhoe, scene)
    assert plan.verified, plan.message
    assert plan.certificate.safe
    assert plan.method == "teleop"
    listed = {obstacle.name: obstacle for obstacle in plan.scene.obstacles}
    assert list(listed) == ["pole", "ball"]
    assert listed["ball"].appears_at == pytest.approx(added - begun)
    assert listed["pole"].position == pytest.approx((3.5, -3, 0))  # type: ignore[union-attr]
    assert any("pole was moved" in note for note in unrecorded_changes(plan))
    assert [visit.zone for visit in plan.findings.zones] == ["power line"]
    assert begun > 0.7

    plan.save(tmp_path / "driven.json")
    again = bp.load_plan(tmp_path / "driven.json")
    assert again.verified
    assert again.certificate.min_clearance == plan.certificate.min_clearance
    np.testing.assert_array_equal(again.trajectory.q, recording.q)


def test_a_recording_states_that_it_was_driven_and_what_it_leaves_out(
    backhoe: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = bp.scene_from_dict(SITE)
    session = Session(backhoe, scene, dt=STEP)
    page = session.join()
    done(session, page, type="take")
    done(session, page, type="add", obstacle={**BALL, "name": "{0} ball", "position": [4.7, 3.0, 2.0]})
    done(session, page, type="record", on=True)
    advance(session, 0.5)
    assert session.snapshot().recording == "on"
    begun = session.snapshot().state.time - session.snapshot().recorded
    for content in ({"type": "remove", "name": "{0} ball"}, {"type": "remove", "name": "pole"}):
        done(session, page, **content)
    gone = session.snapshot().state.time - begun
    drive(session, page, 0.5, **LEFT)
    done(session, page, type="put_back", name="pole")
    back = session.snapshot().state.time - begun
    done(session, page, type="record", on=False)
    advance(session, 1.5)
    recording = session.take_recording()
    assert recording is not None
    notes = [
        f"{{0}} ball was taken away at {gone:.2f} s and is left out",
        f"pole was taken away at {gone:.2f} s and is left out",
        f"pole was put back at {back:.2f} s; where it was before is left out",
    ]
    assert recording.notes == notes
    plan = recording.plan(backhoe, scene)
    assert [obstacle.name for obstacle in plan.scene.obstacles] == ["pole"]
    assert plan.scene.obstacles[0].appears_at == pytest.approx(back)
    plan.save(tmp_path / "driven.json")
    assert problem_to_show(plan).goals == ()
    assert unrecorded_changes(plan) == tuple(notes)

    from backhoe_planner.cli import main

    for words in (["check"], ["view", "--html", str(tmp_path / "driven.html")]):
        monkeypatch.setattr(sys, "argv", ["backhoe-planner", words[0], str(tmp_path / "driven.json"), *words[1:]])
        with pytest.raises(SystemExit) as caught:
            main()
        assert caught.value.code == 0
        said = capsys.readouterr().out
        assert f"driven by hand, {plan.trajectory.duration:.2f} s" in said
        assert all(note in said for note in notes)
        assert "tip error" not in said


def test_no_obstacle_of_the_site_is_missing_in_a_recording(backhoe: Robot) -> None:
    """A swing sector has no solid: an obstacle of its name would be taken for that and left out."""
    sector = {"kind": "swing_sector", "name": "swing", "start": -1.0, "end": 1.0}
    session = make(backhoe, zones=[*SITE["zones"], sector])
    page = session.join()
    done(session, page, type="take")
    assert "a zone" in say(session, page, type="add", obstacle={**BALL, "name": "swing"})["error"]
    assert "a zone" in say(session, page, type="add", obstacle={**BALL, "name": "power line"})["error"]
    assert "is no name" in say(session, page, type="add", obstacle={**BALL, "name": "self: boom"})["error"]
    assert set(session.snapshot().names) == {"swing", "power line", "pole"}
    done(session, page, type="remove", name="pole")
    assert "pole" in session.snapshot().names  # it may be put back
    done(session, page, type="add", obstacle=BALL)
    done(session, page, type="record", on=True)
    advance(session, 0.1)
    done(session, page, type="record", on=False)
    advance(session, 0.1)
    recording = session.take_recording()
    assert recording is not None
    assert [record["name"] for record in recording.obstacles] == ["ball"]
    assert recording.notes == []


def test_an_obstacle_moved_during_the_recording_is_noted(backhoe: Robot) -> None:
    """At the end it is at its original place, but not all the time."""
    session = make(backhoe)
    page = session.join()
    done(session, page, type="take")
    done(session, page, type="move", name="pole", to=[0.5, 0.0, 0.0])
    done(session, page, type="record", on=True)
    advance(session, 0.1)
    begun = session.snapshot().state.time - session.snapshot().recorded
    done(session, page, type="move", name="pole", to=[0.0, 0.0, 0.0])
    done(session, page, type="add", obstacle={**BALL, "position": [4.7, 3.0, -0.6]})  # needs no note
    moved = session.snapshot().state.time - begun
    done(session, page, type="record", on=False)
    advance(session, 0.1)
    recording = session.take_recording()
    assert recording is not None
    pole, ball = recording.obstacles
    assert (pole["position"], pole["appears_at"]) == ([3, -3, 0], pytest.approx(moved))
    assert ball["appears_at"] == pytest.approx(moved)
    assert recording.notes == [f"pole was moved until {moved:.2f} s; where it was before is left out"]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 3))])
def test_every_change_of_the_site_is_in_the_recording_or_its_notes(seed: int, backhoe: Robot) -> None:
    """At every moment, obstacles are present and placed as in the recording, or a note names them."""
    rng = np.random.default_rng(seed)
    cart = {"name": "cart", "shape": "box", "size": [1, 1, 1], "position": [2, -9, 0.5], "velocity": [0.5, 0, 0]}
    late = {"name": "late", "shape": "sphere", "radius": 1, "position": [-3, 9, 0.5], "appears_at": 0.2}
    session = make(backhoe, dt=0.005, obstacles=[*SITE["obstacles"], cart, late])
    page = session.join()
    done(session, page, type="take")
    seen: list[tuple[float, dict[str, np.ndarray]]] = []
    begun, recording = 0.0, None
    for k in range(200):
        if k in (10, 60):
            done(session, page, type="record", on=k == 10)
        if k < 60 and rng.random() < 0.25:
            kind, name = rng.choice(["add", "move", "remove", "put_back"]), str(rng.choice(["pole", "late", "a"]))
            place = [0.0, 0.0, 0.0] if rng.random() < 0.4 else rng.uniform(-6.0, 6.0, 3).tolist()
            content: Data = {"name": name}
            if kind == "add":
                content = {"obstacle": {"name": name, "shape": "sphere", "radius": 0.2, "position": place}}
            elif kind == "move":
                content["to"] = place
            say(session, page, type=kind, **content)
        session.step()
        snapshot = session.snapshot()
        if snapshot.recording in ("on", "ending"):
            begun = begun or snapshot.state.time
            shifts = {o.name: (o, snapshot.shifts[o.name]) for o in snapshot.obstacles if o.zone is None}
            where = {
                n: o.pieces[0].placement.translation + shift for n, (o, shift) in shifts.items() if shift is not None
            }
            seen.append((snapshot.state.time - begun, where))
        recording = recording or session.take_recording()
    assert recording is not None
    assert len(seen) > 40
    scene = bp.scene_from_dict({**SITE, "obstacles": list(recording.obstacles), "zones": []})
    listed = {obstacle.name: obstacle for obstacle in build_obstacles(scene, backhoe)}
    for time, there in seen:
        for name in {*there, *listed}:
            standing = listed.get(name)
            if any(note.startswith(f"{name} was ") for note in recording.notes):
                continue
            assert standing is not None, f"{name} stood there at {time:.3f} s"
            since = time - standing.appears_at
            if abs(since) <= session.dt:
                continue
            assert (name in there) == (since > 0.0), f"{name} at {time:.3f} s"
            if name in there:
                expected = standing.pieces[0].placement.translation + since * standing.velocity
                np.testing.assert_allclose(there[name], expected, atol=2 * session.dt)


@pytest.mark.long
def test_only_a_recording_has_unrecorded_changes(backhoe: Robot) -> None:
    plan = bp.plan(backhoe, bp.scene_from_dict(SITE))
    assert (is_recording(plan), unrecorded_changes(plan)) == (False, ())
    assert problem_to_show(plan).goals
    assert unrecorded_changes(replace(plan, method="teleop")) == ()
    findings = Findings(recording=RecordingNotes(dt=0.001, notes=("1", "a")))
    assert unrecorded_changes(replace(plan, method="teleop", findings=findings)) == ("1", "a")
    assert unrecorded_changes(replace(plan, findings=findings)) == ()


def test_moving_obstacles_are_recorded_where_they_were(backhoe: Robot) -> None:
    cart = {"name": "cart", "shape": "box", "size": [1, 1, 1], "position": [2, -7, 0.5], "velocity": [0.5, 0, 0]}
    session = make(backhoe, dt=0.01, obstacles=[cart, {**cart, "name": "late", "appears_at": 3.0}])
    page = session.join()
    done(session, page, type="take")
    advance(session, 2.0 - session.dt)
    done(session, page, type="record", on=True)
    session.step()
    begun = session.snapshot().state.time
    assert session.snapshot().shifts["late"] is None
    advance(session, 2.0)
    done(session, page, type="record", on=False)
    session.step()
    recording = session.take_recording()
    assert recording is not None
    first, late = recording.obstacles
    assert (first["position"], first["appears_at"]) == (pytest.approx([2 + 0.5 * begun, -7, 0.5], abs=0.01), 0.0)
    assert (late["position"], late["appears_at"]) == (pytest.approx([2, -7, 0.5], abs=0.01), pytest.approx(3.0 - begun))


def test_an_existing_recording_is_not_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "driven.json"
    assert free_name(file) == file
    file.touch()
    (tmp_path / "driven-2.json").touch()
    assert free_name(file) == tmp_path / "driven-3.json"


# --- messages ------------------------------------------------------------------------------

_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
_TYPES = ["take", "release", "hand_over", "tip", "sticks", "stop", "add", "move", "remove", "put_back", "record",
          "circulate"]  # fmt: skip
_NEARLY = st.fixed_dictionaries(
    {"type": st.sampled_from(_TYPES)},
    optional={
        "id": _JSON,
        "to": _JSON | st.lists(st.floats(-3, 3), min_size=3, max_size=3),
        "velocity": _JSON | st.lists(st.floats(), min_size=3, max_size=3),
        "frame": st.sampled_from(["arm", "world", 3]),
        "pitch_rate": _JSON,
        "pattern": st.sampled_from(["iso", "sae", ""]),
        "left": st.lists(st.floats(-2, 2), max_size=3),
        "right": st.lists(st.floats(-1, 1), min_size=2, max_size=2),
        "name": st.sampled_from(["pole", "power line", "ball", "", "x" * 100]) | st.text(max_size=5),
        "on": _JSON,
        "obstacle": _JSON
        | st.fixed_dictionaries(
            {"name": st.text(max_size=5), "shape": st.sampled_from(["sphere", "box", "mesh", "halfspace"])},
            optional={
                "radius": st.floats(),
                "position": st.lists(st.floats(-9, 9), min_size=3, max_size=3),
                "file": st.just("/etc/passwd"),
            },
        ),
    },
)  # fmt: skip
_ANYTHING = st.one_of(
    st.text(max_size=60),
    st.binary(max_size=60),
    _JSON.map(json.dumps),
    _NEARLY.map(json.dumps),
    st.sampled_from(
        ["[" * 100_000, "{" * 5_000, "1" * 20_000, '{"type": "take"}' * 2, '"\\ud800"', "\ud800", "NaN", ""]
    ),
)


@pytest.fixture(scope="module")
def driven(backhoe: Robot) -> tuple[Session, int]:
    session = make(backhoe)
    return session, session.join()


@settings(max_examples=150)
@given(text=_ANYTHING)
def test_every_message_of_a_page_is_answered(driven: tuple[Session, int], text: str | bytes) -> None:
    session, page = driven
    session.hear(page, '{"type": "take"}')
    answer = session.hear(page, text)
    assert set(answer) == {"type", "id", "to", "ok", "said", "error"}
    assert answer["ok"] is (answer["error"] is None)
    json.dumps(answer, allow_nan=False).encode("utf-8")
    assert len(answer["error"] or "") < 1000
    assert np.all(np.isfinite(session.step().q))


def dropped(shape: str, **sizes: Any) -> str:
    return json.dumps({"type": "add", "obstacle": {"name": "t", "shape": shape, "position": [5, -3, 3], **sizes}})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nonsense", "JSON"),
        ("{}", "type"),
        ('{"type": "fly"}', "'take'"),
        ('{"type": "take", "speed": 1}', "speed"),
        ('{"type": "tip", "velocity": [0, 0]}', "velocity"),
        ('{"type": "tip", "velocity": [0, 0, 1e400]}', "velocity.2"),
        ('{"type": "record", "on": "yes"}', "on"),
        ('{"type": "add", "obstacle": {"name": "m", "shape": "mesh", "file": "/etc/passwd"}}', "'sphere'"),
        ('{"type": "take", "id": 1}' + " " * LARGEST, "too long"),
        (dropped("sphere", radius=1e-300), "sphere.radius"),
        (dropped("sphere", radius=1e-5), "radius: is not the size of an obstacle"),
        (dropped("sphere", radius=2000.0), "allowed: 0.001 to 1000 m"),
        (dropped("box", size=[1.0, 0.0009, 1.0]), "size"),
        (dropped("cylinder", radius=0.1, length=1e-9), "length"),
        (dropped("sphere", radius=0.1, position=[0.0, 2000.0, 0.0]), "too far away"),
    ],
)
def test_an_invalid_message_is_refused_with_the_reason(text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text)
    assert said in str(caught.value)


# --- the server ----------------------------------------------------------------------------


@pytest.fixture
def server(backhoe: Robot) -> Iterator[TeleopServer]:
    opened = TeleopServer(make(backhoe), port=0)
    yield opened
    opened.close()


def talk(server: LiveServer, conversation: Callable[[str], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(conversation(server.url.replace("http", "ws") + "socket"), PATIENCE))


def request(url: str, **headers: str) -> tornado.httpclient.HTTPRequest:
    return tornado.httpclient.HTTPRequest(url, headers=tornado.httputil.HTTPHeaders(headers))


async def hear(connection: tornado.websocket.WebSocketClientConnection, kind: str) -> Data:
    while True:
        message = await connection.read_message()
        assert message is not None, "the connection was closed"
        if isinstance(message, str) and (content := json.loads(message))["type"] == kind:
            assert isinstance(content, dict)
            return content


async def leave(*connections: tornado.websocket.WebSocketClientConnection) -> None:
    """Close connections, and wait until their sockets are closed too."""
    for connection in connections:
        connection.close()
        while await connection.read_message() is not None:
            pass


def test_the_server_accepts_only_its_own_pages(server: TeleopServer) -> None:
    port = server.url.rsplit(":", 1)[1].strip("/")

    async def conversation(url: str) -> None:
        refused: list[dict[str, str]] = [
            {"Origin": "http://evil.example"},
            {"Origin": f"http://localhost:{port}"},  # the page was loaded from 127.0.0.1
            {"Origin": f"http://127.0.0.1:{int(port) + 1}"},
            {"Origin": f"https://127.0.0.1:{port}"},  # the page is served over http
            {"Origin": "null"},
            {"Origin": f"http://evil.example:{port}", "Host": f"evil.example:{port}"},  # a name made to point here
            {"Host": f"evil.example:{port}"},
            {"Host": "[::1"},
            {"Origin": "http://[::1"},
            {"Origin": "http://[::1", "Host": "[::1"},
        ]
        for headers in refused:
            with pytest.raises(tornado.httpclient.HTTPClientError, match="403"):
                await tornado.websocket.websocket_connect(request(url, **headers))
        for headers in (
            {"Origin": f"http://127.0.0.1:{port}"},
            {"Origin": f"http://localhost:{port}", "Host": f"localhost:{port}"},
        ):
            connection = await tornado.websocket.websocket_connect(request(url, **headers))
            assert (await hear(connection, "you"))["page"] > 0
            await leave(connection)
        client = tornado.httpclient.AsyncHTTPClient()
        with pytest.raises(tornado.httpclient.HTTPClientError, match="403"):
            await client.fetch(request(server.url, Host="evil.example"))
        with pytest.raises(tornado.httpclient.HTTPClientError, match="403"):
            await client.fetch(request(server.url, Host="[::1"))
        assert b"teleop" in (await client.fetch(server.url)).body

    talk(server, conversation)
    with socket.socket() as probe:  # on this machine alone
        outside = [info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)]
        for address in outside:
            if not str(address).startswith("127."):
                assert probe.connect_ex((str(address), int(port))) != 0


def test_one_of_two_pages_drives_until_it_leaves(server: TeleopServer) -> None:
    async def conversation(url: str) -> None:
        one, two = [await tornado.websocket.websocket_connect(url) for _ in range(2)]
        number = [(await hear(page, "you"))["page"] for page in (one, two)]
        await one.write_message('{"type": "take", "id": 1}')
        assert (await hear(one, "answer"))["ok"]
        await two.write_message('{"type": "take", "id": 2}')
        answer = await hear(two, "answer")
        assert (answer["ok"], answer["id"]) == (False, 2)
        for text in ("nonsense", b"\xff\xfe", "x" * 1_000_000):  # malformed, binary, huge: answered, and nothing lost
            await one.write_message(text, binary=isinstance(text, bytes))
            assert not (await hear(one, "answer"))["ok"]
        await one.write_message(json.dumps({**LEFT, "id": 3}))
        assert (await hear(one, "answer")) == {
            "type": "answer",
            "id": 3,
            "to": "tip",
            "ok": True,
            "said": "",
            "error": None,
        }
        assert server.session.snapshot().driver == number[0]
        await leave(one)
        deadline = clock.monotonic() + PATIENCE
        while server.session.snapshot().driver is not None and clock.monotonic() < deadline:
            await asyncio.sleep(0.01)
        await two.write_message('{"type": "take", "id": 4}')
        assert (await hear(two, "answer"))["ok"]
        assert server.session.snapshot().pages == (number[1],)
        await leave(two)

    talk(server, conversation)


def test_a_page_that_closes_during_a_write_does_no_harm(server: TeleopServer, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = threading.Event()

    def gone(*_: object, **__: object) -> None:
        tried.set()
        raise tornado.websocket.WebSocketClosedError

    async def conversation(url: str) -> None:
        first = await tornado.websocket.websocket_connect(url)
        await hear(first, "you")
        with monkeypatch.context() as patch:
            patch.setattr(LiveSocket, "write_message", gone)
            server.display.tell("news", {})
            while not tried.is_set():
                await asyncio.sleep(0.01)
        second = await tornado.websocket.websocket_connect(url)
        assert (await hear(second, "you"))["page"] == 2
        await leave(first, second)

    talk(server, conversation)
    assert server.running


def test_a_page_that_floods_is_disconnected_and_the_others_stay(
    server: TeleopServer, caplog: pytest.LogCaptureFixture
) -> None:
    async def conversation(url: str) -> None:
        driver, flooder = [await tornado.websocket.websocket_connect(url) for _ in range(2)]
        await hear(driver, "you")
        number = (await hear(flooder, "you"))["page"]
        heard = 0
        try:
            for k in range(40_000):
                await flooder.write_message("{")
                heard = k
        except tornado.websocket.WebSocketClosedError:
            pass
        assert heard >= 999  # what a page may send at once
        deadline = clock.monotonic() + PATIENCE
        while number in server.session.snapshot().pages and clock.monotonic() < deadline:
            await asyncio.sleep(0.01)
        assert number not in server.session.snapshot().pages
        answers = 0
        while (message := await flooder.read_message()) is not None:
            answers += '"answer"' in str(message)
        assert 0 < answers < 3000
        flooder.close()
        await driver.write_message('{"type": "take"}')
        assert (await hear(driver, "answer"))["ok"]
        late = await tornado.websocket.websocket_connect(url)
        await hear(late, "you")
        await leave(driver, late)

    with caplog.at_level("ERROR"):
        talk(server, conversation)
        gc.collect()
    assert caplog.text == ""


@pytest.mark.long
def test_a_page_that_does_not_read_is_disconnected(
    server: TeleopServer, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_server, "_MESSAGES_AT_ONCE", 1e9)  # so that it is the answers that count
    largest = 0

    async def conversation(url: str) -> None:
        nonlocal largest
        idle = await tornado.websocket.websocket_connect(url, max_message_size=1 << 24)
        number = (await hear(idle, "you"))["page"]
        port = int(url.split(":")[2].split("/")[0])
        slow = socket.socket()
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", port))
        _, writer = await asyncio.open_connection(sock=slow, limit=1024)
        writer.write(
            f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        deadline = clock.monotonic() + PATIENCE
        while len(server.session.snapshot().pages) < 2 and clock.monotonic() < deadline:
            await asyncio.sleep(0.01)
        said = b'{"type":"take","%s":1}' % (100 * b"x")  # is answered at length
        with contextlib.suppress(ConnectionError):
            for _ in range(600):
                writer.write((b"\x81%c" % (128 + len(said)) + bytes(4) + said) * 100)
                await asyncio.wait_for(writer.drain(), PATIENCE)
                # opens the wall: how much is kept for a page that does not read is nobody else's business
                largest = max(largest, *(page._unread for page in list(server._pages)))
        while len(server.session.snapshot().pages) > 1 and clock.monotonic() < deadline:
            await asyncio.sleep(0.01)
        assert server.session.snapshot().pages == (number,)
        with contextlib.suppress(ConnectionError):
            writer.close()
            await writer.wait_closed()
        await leave(idle)

    with caplog.at_level("ERROR"):
        talk(server, conversation)
        gc.collect()
    assert caplog.text == ""
    assert 0 < largest < 1.1 * live_server._MOST_UNREAD


def test_pages_beyond_the_limit_are_refused(server: TeleopServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_server, "_MOST_PAGES", 2)

    async def conversation(url: str) -> None:
        pages = [await tornado.websocket.websocket_connect(url) for _ in range(2)]
        for page in pages:
            await hear(page, "you")
        with pytest.raises(tornado.httpclient.HTTPClientError, match="503"):
            await tornado.websocket.websocket_connect(url)
        await leave(*pages)

    talk(server, conversation)


def test_the_machine_stays_drivable_when_drawing_fails(
    backhoe: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with TeleopStation(backhoe, bp.scene_from_dict(SITE), port=0, output=tmp_path / "driven.json") as station:
        session = station.session
        page = session.join()
        done(session, page, type="take")

        def told(kind: str) -> list[Data]:
            # opens the wall: the messages as every page gets them, without a browser
            found = [json.loads(m) for m in station._server.display.messages().values() if isinstance(m, str)]
            return [content for content in found if content["type"] == kind]

        def broken(*_: object, **__: object) -> None:
            raise ArithmeticError("no picture")

        # one obstacle that cannot be drawn: the rest is
        with monkeypatch.context() as patch:
            patch.setattr(SceneGraph, "add", broken)
            done(session, page, type="add", obstacle={**BALL, "position": [4.7, 3.0, -0.6]})
            wait(lambda: told("trouble") != [])
        assert told("trouble")[0]["text"] == "ball cannot be drawn: ArithmeticError"
        before = session.snapshot().state.time
        wait(lambda: told("teleop")[0]["time"] > before + 0.1)
        assert "ball" in told("teleop")[0]["movable"]
        assert "ball" not in told("teleop")[0]["nodes"]
        done(session, page, type="remove", name="ball")

        # no picture at all: the steps go on
        with monkeypatch.context() as patch:
            patch.setattr(SceneGraph, "move", broken)
            wait(lambda: "picture" in told("trouble")[0]["text"])
            before = session.snapshot().state.time
            done(session, page, **LEFT)
            wait(lambda: session.snapshot().state.time > before + 0.2)
            assert station.running
            assert session.snapshot().state.tip_position[1] > 0.001
        before = session.snapshot().state.time
        wait(lambda: told("teleop")[0]["time"] > before)

        # a failing step ends it once the machine is at rest
        done(session, page, **LEFT)
        wait(lambda: bool(np.abs(session.snapshot().state.v).max() > 0.02))
        monkeypatch.setattr(session, "_held_wish", broken)
        wait(lambda: not station.running)
        assert np.abs(session.snapshot().state.v).max() == 0.0
        assert "ArithmeticError: no picture" in station.failure
        assert told("trouble")[0]["text"] == station.failure
        assert told("teleop")[0]["failure"] == station.failure


@pytest.mark.long
@settings(max_examples=20)
@given(
    radius=st.sampled_from([0.001, 0.0011, 0.5, 1000.0]),
    at=st.lists(st.sampled_from([-1000.0, -3.0, 0.1, 1000.0]), min_size=3, max_size=3),
    length=st.sampled_from([0.001, 1.0, 1000.0]),
    clearance=st.sampled_from([0.0, 1e-9, 0.1, 1e5]),
)
def test_every_allowed_obstacle_can_be_drawn(radius: float, at: list[float], length: float, clearance: float) -> None:
    scene = bp.scene_from_dict(SITE)
    forms: list[Data] = [
        {"shape": "sphere", "radius": radius, "position": at},
        {"shape": "box", "size": [radius, length, 0.001], "position": at, "rpy": [0.3, 0.2, 0.1]},
        {
            "shape": "cylinder",
            "radius": radius,
            "length": min(max(length, 2e-5 * radius), 5e4 * radius),
            "position": at,
        },
        {"shape": "capsule", "from": at, "to": at, "radius": radius},
        {"shape": "capsule", "from": at, "to": [at[0], at[1], at[2] * 0.5], "radius": radius},
    ]
    for form in forms:
        text = json.dumps({"type": "add", "obstacle": {"name": "t", "clearance": clearance, **form}})
        message = parse(text)
        assert isinstance(message, Add)
        obstacle = build_obstacle(message.obstacle, folder=scene.folder, clearance=0.1)
        drawn = site_mesh(obstacle, scene, centre=np.zeros(3), reach=6.0)
        assert np.all(np.isfinite(drawn.facets.vertices))
        extent = np.ptp(drawn.facets.vertices, axis=0)
        assert np.all(extent > 0.0)


def test_a_station_runs_in_real_time_and_ends(backhoe: Robot, tmp_path: Path) -> None:
    with TeleopStation(backhoe, bp.scene_from_dict(SITE), port=0, output=tmp_path / "driven.json") as station:
        assert not any("wait" in warning for warning in station.warnings)  # no obstacle moves
        begun, first = clock.monotonic(), station.session.snapshot().state.time
        clock.sleep(0.2)
        passed = station.session.snapshot().state.time - first
        assert 0.0 < passed < clock.monotonic() - begun + 0.2  # never ahead of the clock
        page = station.session.join()
        done(station.session, page, type="take")
        done(station.session, page, type="record", on=True)
        wait(lambda: station.session.snapshot().recorded > 0.1)
        done(station.session, page, type="record", on=False)
        wait(lambda: (tmp_path / "driven.json").exists())
    assert not station.running
    assert [file.name for file in tmp_path.iterdir()] == ["driven.json"]
    assert bp.load_plan(tmp_path / "driven.json").verified
    with pytest.raises(OutputError, match="does not exist"):
        TeleopStation(backhoe, bp.scene_from_dict(SITE), port=0, output=tmp_path / "nowhere" / "driven.json")


def wait(condition: Callable[[], bool]) -> None:
    deadline = clock.monotonic() + PATIENCE
    while not condition():
        assert clock.monotonic() < deadline
        clock.sleep(0.02)


# --- the command line ----------------------------------------------------------------------


def test_ctrl_c_ends_teleop_with_status_130_and_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(SITE), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-c", "from backhoe_planner.cli import main; main()", "teleop", "example:backhoe",
         "scene.yaml", "--port", "0", "--no-browser"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, stderr=subprocess.PIPE, text=True,
        # ignored where the tests run in the background
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert process.stderr is not None
    with process.stderr:
        url = next(word for word in process.stderr.readline().split() if word.startswith("http"))

        async def conversation(_: str) -> None:
            page = await tornado.websocket.websocket_connect(url.replace("http", "ws") + "socket")
            for content in ({"type": "take"}, {"type": "record", "on": True}, LEFT):
                await page.write_message(json.dumps(content))
                assert (await hear(page, "answer"))["ok"]
            process.send_signal(signal.SIGINT)
            await leave(page)

        asyncio.run(conversation(""))
        assert process.wait(timeout=PATIENCE) == 130
        assert "Traceback" not in process.stderr.read()
    assert [file.name for file in tmp_path.iterdir()] == ["scene.yaml"]


def test_a_scene_without_a_start_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from backhoe_planner.cli import main

    monkeypatch.chdir(tmp_path)
    path = {"path": {"waypoints": [{"position": [4, 0, 0]}, {"position": [3, 0, 0]}]}}
    content = {key: value for key, value in SITE.items() if key != "start"} | {"task": path}
    Path("scene.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["backhoe-planner", "teleop", "example:backhoe", "scene.yaml", "--no-browser"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert "scene.yaml: start: is missing" in said
    assert "q=" not in said
