"""Recordings of the driving page survive Ctrl-C, a full disk, a lack of descriptors and a failing step."""

from __future__ import annotations

import contextlib
import os
import resource
import socket
import threading
import time as clock
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tornado.httpclient
from waiting import PATIENCE

import backhoe_planner as bp
from backhoe_planner.errors import OutputError
from backhoe_planner.machine import Robot
from backhoe_planner.planning import Plan
from backhoe_planner.show import (
    Change,
    LiveServer,
    Recorder,
    Recording,
    Session,
    TeleopStation,
    describe_changes,
)
from backhoe_planner.show.teleop import recorder
from backhoe_planner.show.viewer import connections

Data = dict[str, Any]

START = {"swing": 0.0, "boom": 0.3, "stick": -0.9, "bucket": -0.5}
SITE: Data = {"version": 1, "start": {"joints": START}, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}}


@pytest.fixture
def scene() -> bp.Scene:
    return bp.scene_from_dict(SITE)


@pytest.fixture
def driven() -> Recording:
    """A recording of 0.05 s at rest."""
    return Recording(0.005, np.tile(list(START.values()), (11, 1)), [], [])


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only other folder for recordings; it does not exist yet."""
    folder = tmp_path / "elsewhere"
    monkeypatch.setattr(recorder, "other_folders", lambda: (folder,))
    return folder


def wait(condition: Callable[[], bool]) -> None:
    deadline = clock.monotonic() + PATIENCE
    while not condition():
        assert clock.monotonic() < deadline
        clock.sleep(0.005)


# --- Ctrl-C -------------------------------------------------------------------------------


def test_a_recording_still_being_proven_when_the_station_closes_is_written(
    backhoe: Robot, scene: bp.Scene, driven: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proving, may_end, prove = threading.Event(), threading.Event(), Recording.plan
    ended = [driven]

    def slowly(recording: Recording, *args: Any) -> Plan:
        proving.set()
        assert may_end.wait(PATIENCE)
        return prove(recording, *args)

    monkeypatch.setattr(Recording, "plan", slowly)
    said: list[str] = []
    station = TeleopStation(backhoe, scene, port=0, output=tmp_path / "driven.json", say=said.append)
    monkeypatch.setattr(station.session, "take_recording", lambda: ended.pop() if ended else None)
    assert proving.wait(PATIENCE)
    closing = threading.Thread(target=station.close)
    closing.start()
    wait(lambda: said != [])
    assert not (tmp_path / "driven.json").exists()
    may_end.set()
    closing.join(PATIENCE)
    assert bp.load_plan(tmp_path / "driven.json").verified
    assert "Ctrl-C once more" in said[0]
    assert said[1] == f"recording written: {tmp_path / 'driven.json'}, 0.1 s, verified"


def test_a_recording_is_kept_when_a_step_fails(
    backhoe: Robot, scene: bp.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(backhoe, scene)
    page = session.join()
    for text in ('{"type": "take"}', '{"type": "record", "on": true}'):
        assert session.hear(page, text)["ok"]
    session.step()
    assert session.snapshot().recording == "on"
    assert session.hear(page, '{"type": "tip", "velocity": [0.0, 0.6, 0.0]}')["ok"]
    for _ in range(40):
        session.step()
    moving = session.snapshot().state
    assert moving.v.any()

    def broken(*_: object) -> None:
        raise ArithmeticError

    monkeypatch.setattr(session, "_held_wish", broken)
    for _ in range(300):
        session.step()
    recording = session.take_recording()
    assert recording is not None
    assert session.failure
    assert np.abs(recording.q - moving.q).max(axis=1).min() == 0.0  # it contains the place of the failure
    at_rest = session.snapshot().state  # it goes on until the machine is at rest
    np.testing.assert_array_equal(at_rest.v, 0.0)
    np.testing.assert_allclose(recording.q[-1], at_rest.q, atol=1e-9)


# --- no disk space ------------------------------------------------------------------------------


def test_a_recording_whose_folder_is_gone_is_written_elsewhere_and_reported(
    backhoe: Robot, scene: bp.Scene, driven: Recording, tmp_path: Path, elsewhere: Path
) -> None:
    elsewhere.mkdir()
    told: list[Data] = []
    written = Recorder(backhoe, scene, tmp_path / "gone" / "driven.json", lambda **content: told.append(content))
    written.take(driven)
    written.close()
    assert told[-1]["file"] == str(elsewhere / "driven.json")
    assert "gone/driven.json: the folder does not exist" in told[-1]["instead"]
    assert bp.load_plan(elsewhere / "driven.json").verified


def test_a_recording_that_cannot_be_written_is_kept_and_written_later(
    backhoe: Robot, scene: bp.Scene, driven: Recording, tmp_path: Path, elsewhere: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(recorder, "_AGAIN", 0.01)
    told: list[Data] = []
    folder = tmp_path / "folder"
    written = Recorder(backhoe, scene, folder / "driven.json", lambda **content: told.append(content))
    written.take(driven)
    wait(lambda: len(told) > 1)
    assert "the folder does not exist" in told[1]["error"]
    assert "is kept, and tried again" in told[1]["error"]
    assert [plan.verdict for plan in written.unwritten] == ["verified"]
    folder.mkdir()
    wait(lambda: "file" in told[-1])
    written.close()
    assert written.unwritten == ()
    assert bp.load_plan(folder / "driven.json").verified
    assert not elsewhere.exists()


def test_closing_tries_once_more_to_write_a_recording(
    backhoe: Robot, scene: bp.Scene, driven: Recording, tmp_path: Path, elsewhere: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The disk is full until then."""
    told: list[Data] = []
    written = Recorder(backhoe, scene, tmp_path / "driven.json", lambda **content: told.append(content))

    def full(*_: object) -> None:
        raise OutputError("cannot be written: No space left on device", file=tmp_path / "driven.json")

    with monkeypatch.context() as patch:
        patch.setattr(Plan, "save", full)
        written.take(driven)
        wait(lambda: len(told) > 1)
    assert "No space left on device" in told[1]["error"]
    written.close()
    assert told[-1]["file"] == str(tmp_path / "driven.json")
    assert not elsewhere.exists()


def test_a_recording_is_written_when_all_descriptors_are_in_use(
    backhoe: Robot, scene: bp.Scene, driven: Recording, tmp_path: Path
) -> None:
    told: list[Data] = []
    written = Recorder(backhoe, scene, tmp_path / "driven.json", lambda **content: told.append(content))
    limits, taken = resource.getrlimit(resource.RLIMIT_NOFILE), []
    try:
        highest = max(int(entry.name) for entry in Path("/dev/fd").iterdir())
        resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 20, limits[1]))
        with contextlib.suppress(OSError):  # too many open files
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        written.take(driven)
        written.close()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        for descriptor in taken:
            os.close(descriptor)
    assert told[-1].get("file") == str(tmp_path / "driven.json"), told[-1]


# --- connections --------------------------------------------------------------------------


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[LiveServer]:
    monkeypatch.setattr(connections, "_MOST", 6)
    opened = LiveServer(port=0)
    yield opened
    opened.close()


def silent(server: LiveServer) -> socket.socket:
    port = int(server.url.rsplit(":", 1)[1].strip("/"))
    return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)


def is_closed(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


def test_only_the_newest_of_many_silent_connections_stay_open(server: LiveServer) -> None:
    opened = [silent(server) for _ in range(40)]
    wait(lambda: sum(map(is_closed, opened)) == 34)
    assert not any(map(is_closed, opened[-6:]))
    client = tornado.httpclient.HTTPClient()
    assert client.fetch(server.url).code == 200
    client.close()
    for connection in opened:
        connection.close()


def test_a_silent_connection_is_closed_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "_IDLE", 0.05)
    server = LiveServer(port=0)
    connection = silent(server)
    wait(lambda: is_closed(connection))
    connection.close()
    server.close()


# --- what a scene file cannot hold --------------------------------------------------------


def test_many_changes_of_one_kind_are_reported_in_one_sentence() -> None:
    few = [Change(1.0, "a", "taken away"), Change(2.5, "a", "put back")]
    assert describe_changes(few) == [
        "a was taken away at 1.00 s and is left out",
        "a was put back at 2.50 s; where it was before is left out",
    ]
    many = [Change(0.1 * k, f"ball {k}", "taken away") for k in range(525)]
    assert describe_changes([*many, few[1]]) == [
        "525 times between 0.00 and 52.40 s an obstacle was taken away and is left out: "
        "ball 0, ball 1, ball 2 and 522 more",
        "a was put back at 2.50 s; where it was before is left out",
    ]
    again = [Change(float(k), "pole", "moved") for k in range(4)]
    assert describe_changes(again) == ["4 obstacles were moved until 3.00 s; where they were before is left out: pole"]


def test_a_machine_with_a_held_bucket_is_driven_and_recorded(backhoe: Robot, tmp_path: Path) -> None:
    start = {"joints": {name: q for name, q in START.items() if name != "bucket"}}
    held = bp.scene_from_dict({**SITE, "start": start, "hold": {"bucket": -0.5}})
    assert Session(backhoe, held).robot.joint_names == ("swing", "boom", "stick")
    driven = Recording(0.005, np.tile([0.0, 0.3, -0.9], (11, 1)), [], [])
    plan = driven.plan(backhoe, held)
    plan.save(tmp_path / "driven.json")
    read = bp.load_plan(tmp_path / "driven.json")
    assert read.verified == plan.verified
    assert read.robot.hold == {"bucket": -0.5}
