"""Runs a session in real time: the loop, the server, the picture, and the writer of recordings."""

from __future__ import annotations

import queue
import threading
import time as clock
from pathlib import Path
from typing import Any

import numpy as np

from backhoe_planner.errors import InputError
from backhoe_planner.files.output_file import check_writable
from backhoe_planner.machine import Robot
from backhoe_planner.show.drawing.timeline import FRAME
from backhoe_planner.show.page.page import live_page, read_parts
from backhoe_planner.show.teleop.picture import Picture
from backhoe_planner.show.teleop.session import AT_REST, Recording, Session
from backhoe_planner.show.viewer.live_server import LivePage, LiveServer, LiveSocket
from backhoe_planner.site import Scene

_LATEST = 0.1  # s behind the clock at which the loop stops catching up; chosen, a longer burst would be seen


class _Socket(LiveSocket):
    server: TeleopServer
    page = 0

    def open(self, *args: str, **kwargs: str) -> None:
        super().open(*args, **kwargs)
        self.page = self.server.session.join()
        self.answer({"type": "you", "page": self.page})

    def on_message(self, message: str | bytes) -> None:
        if message == "drawn":
            super().on_message(message)
        elif self.accepts():
            self.answer(self.server.session.hear(self.page, message))

    def on_close(self) -> None:
        self.server.session.leave(self.page)
        super().on_close()


class TeleopServer(LiveServer):
    """The server of a driving page; see `LiveServer`.

    Parameters
    ----------
    session: what the pages watch and drive.
    """

    opens = "see the machine and drive it"

    def __init__(
        self,
        session: Session,
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        password: str | None = None,
        allow_anyone: bool = False,
    ) -> None:
        self.session = session
        super().__init__(host=host, port=port, password=password, allow_anyone=allow_anyone)

    def routes(self) -> list[Any]:
        """The addresses that are served, as tornado's rules."""
        css, body, script = read_parts("backhoe_planner.show.teleop", "teleop.css", "teleop.html", "teleop.js")
        page = live_page(css=css, body=body, script=script)
        return [("/", LivePage, {"page": page, "server": self}), ("/socket", _Socket, {"server": self})]


class TeleopStation:
    """Runs a session in real time and serves it, until it is closed. Use it in a ``with`` block.

    Parameters
    ----------
    robot, scene: the machine, and the site with the start.
    host, port, password, allow_anyone: see `LiveServer`.
    output: file for recordings. It is never overwritten: further recordings get a number.
    dt: length of a step [s].

    Attributes
    ----------
    session: the machine and its driver.
    warnings: what could not be drawn as the URDF asks, in words.

    Raises
    ------
    InputError, SceneError, RobotError: the scene does not fit the machine; or other computers can connect,
        and neither a password nor `allow_anyone` is given.
    OutputError: the port is in use, or recordings cannot be written there.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        password: str | None = None,
        allow_anyone: bool = False,
        output: str | Path = "teleop.json",
        dt: float = 0.005,
    ) -> None:
        self._output = Path(output)
        check_writable(self._output)
        self.session = Session(robot, scene, dt=dt)
        self._server = TeleopServer(self.session, host=host, port=port, password=password, allow_anyone=allow_anyone)
        try:
            self._picture = Picture(self.session, self._server.display)
        except Exception:
            self._server.close()
            raise
        self.warnings = self._picture.warnings
        self._reported: set[str] = set()
        self._ending = threading.Event()
        self._writing = threading.Lock()
        self._recordings: queue.SimpleQueue[Recording | None] = queue.SimpleQueue()
        self._loop = threading.Thread(target=self._run, name="teleop loop", daemon=True)
        self._writer = threading.Thread(target=self._write, name="teleop recordings", daemon=True)
        self._loop.start()
        self._writer.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._server.url

    @property
    def url_from_elsewhere(self) -> str | None:
        """Address of the page for other computers; None where none can connect."""
        return self._server.url_from_elsewhere

    @property
    def openness(self) -> str:
        """Who can connect, and what they can do, in words."""
        return self._server.openness

    @property
    def running(self) -> bool:
        """Whether the machine is still being stepped and served."""
        return self._loop.is_alive() and self._server.running

    @property
    def failure(self) -> str:
        """Why the machine was stopped for good; else empty."""
        return self.session.failure

    def close(self) -> None:
        """End everything; a file that is being written is finished first. May be called again."""
        self._ending.set()
        self._recordings.put(None)
        self._loop.join(timeout=2.0)
        with self._writing:  # a file is there whole or not at all
            pass
        self._server.close()

    def __enter__(self) -> TeleopStation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        session, dt = self.session, self.session.dt
        due = frame_due = clock.monotonic()
        while not self._ending.is_set():
            state = session.step()
            due += dt
            now = clock.monotonic()
            at_an_end = bool(session.failure) and float(np.abs(state.v).max()) < AT_REST
            if now >= frame_due or at_an_end:
                self._draw()
                if at_an_end:
                    return
                recording = session.take_recording()
                if recording is not None:
                    self._recordings.put(recording)
                frame_due = now + FRAME
                now = clock.monotonic()
            if now < due:
                self._ending.wait(due - now)
            elif now - due > _LATEST:  # the computer is too slow or was asleep: the lost time is not made up
                due = now

    def _draw(self) -> None:
        """Show the present state. If that fails, the pages are told once, and the machine is driven on."""
        if self.session.failure:
            self._report("failure", self.session.failure)
        try:
            self._picture.show(self.session.snapshot())
        except Exception as error:  # noqa: BLE001  whatever it was, the machine must be stepped on
            self._report("picture", f"the picture cannot be drawn ({type(error).__name__}) and may be out of date")

    def _report(self, trouble: str, text: str) -> None:
        """Tell the pages of a kind of trouble, once."""
        if trouble not in self._reported:
            self._reported.add(trouble)
            self._server.display.tell("trouble", {"text": text})

    def _write(self) -> None:
        while (recording := self._recordings.get()) is not None:
            self._tell(writing=True)
            try:
                plan = recording.plan(self.session.robot, self.session.scene)
                with self._writing:
                    if self._ending.is_set():
                        return
                    file = free_name(self._output)
                    plan.save(file)
                notes, zones = recording.notes, len(plan.findings.zones)
                self._tell(
                    file=str(file), verdict=plan.verdict, seconds=recording.duration, zones=zones, left_out=notes
                )
            except InputError as error:
                self._tell(error=str(error))
            except Exception as error:  # noqa: BLE001  the next recording is written all the same
                self._tell(error=f"the recording could not be written: {type(error).__name__}")

    def _tell(self, **content: object) -> None:
        self._server.display.tell("recorded", content)


def free_name(path: Path) -> Path:
    """`path`, or, where that exists, the first of ``name-2``, ``name-3``, ... that does not."""
    found, number = path, 2
    while found.exists():
        found = path.with_name(f"{path.stem}-{number}{path.suffix}")
        number += 1
    return found
