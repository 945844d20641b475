"""Runs a session in real time: the loop, the server, the picture, and the writer of recordings."""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from backhoe_planner.files.output_file import check_record
from backhoe_planner.machine import Robot
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.timeline import FRAME
from backhoe_planner.show.page.page import live_page, read_parts
from backhoe_planner.show.teleop.picture import Picture
from backhoe_planner.show.teleop.recorder import Recorder
from backhoe_planner.show.teleop.session import AT_REST, Session
from backhoe_planner.show.viewer.live_server import LivePage, LiveServer, LiveSocket
from backhoe_planner.site import Scene

_SILENT = 5.0  # s after which a page that drives has let go: it answers each frame; chosen, longer than a browser hangs
_LATEST = 0.1  # s behind the clock after which the loop stops catching up; chosen, a longer burst would be visible


class _Socket(LiveSocket):
    server: TeleopServer
    page = 0

    def open(self, *args: str, **kwargs: str) -> None:
        super().open(*args, **kwargs)
        self.page = self.server.session.join()
        self.answer({"type": "you", "page": self.page})

    def handle(self, message: str | bytes) -> None:
        self.answer(self.server.session.hear(self.page, message))

    def on_close(self) -> None:
        self.server.session.leave(self.page)
        super().on_close()


class TeleopServer(LiveServer):
    """The server of a driving page; see `LiveServer`.

    A page that drives and sends nothing for some seconds, not even that it has shown the present state, has let go: its
    connection is lost, or its browser hangs. The machine itself stops long before, by the watchdog of the session.

    Parameters
    ----------
    session: the session that the pages watch and drive.
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

    def deliver(self) -> None:
        """Also take the controls from a page that has gone silent."""
        super().deliver()
        for page in self.pages:
            if isinstance(page, _Socket) and page.silent_for > _SILENT:
                self.session.release(page.page)


class TeleopStation:
    """Runs a session in real time and serves it, until it is closed. Use it in a ``with`` block.

    Parameters
    ----------
    robot, scene: the machine, and the site with the start.
    host, port, password, allow_anyone: see `LiveServer`.
    output: file for recordings. It is never overwritten: further recordings get a number.
    say: called with messages about recordings, in words, from another thread.

    Attributes
    ----------
    session: the machine and its driver.
    warnings: what could not be drawn as the URDF specifies, and that obstacles that move wait for a driver, in words.

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
        say: Callable[[str], None] | None = None,
    ) -> None:
        self._output = Path(output)
        check_record(self._output, (*robot.files, *scene.files))
        self.session = Session(robot, scene)
        self._server = TeleopServer(self.session, host=host, port=port, password=password, allow_anyone=allow_anyone)
        try:
            self._picture = Picture(self.session, self._server.display)
        except Exception:
            self._server.close()
            raise
        self.warnings = self._picture.warnings
        if self.session.waits:
            self.warnings += ("obstacles that move or appear later wait until somebody takes the controls",)
        self._reported: set[str] = set()
        self._ending = threading.Event()
        self._say = say or _say_nothing
        self._recorder = Recorder(self.session.robot, scene, self._output, self._tell_recorded)
        self._loop = threading.Thread(target=self._run, name="teleop loop", daemon=True)
        self._loop.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._server.url

    @property
    def url_from_elsewhere(self) -> str | None:
        """Address of the page for other computers; None if none can connect."""
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
        """Why the machine was stopped for good; otherwise empty."""
        return self.session.failure

    @property
    def unwritten(self) -> tuple[Plan, ...]:
        """Recordings that could not be written anywhere yet; writing is tried again."""
        return self._recorder.unwritten

    def close(self) -> None:
        """End everything; recordings that have ended are proven and written first. May be called again."""
        self._ending.set()
        self._loop.join(timeout=2.0)
        self._take_recordings()
        if self._recorder.busy:
            self._say("the recording is proven and written; Ctrl-C once more gives it up")
        self._recorder.close()
        for plan in self.unwritten:
            self._say(f"a recording of {plan.trajectory.duration:.1f} s could not be written anywhere")
        self._server.close()

    def __enter__(self) -> TeleopStation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        session, dt = self.session, self.session.dt
        state = session.snapshot().state
        due = frame_due = clock.monotonic()
        while not self._ending.is_set():
            if not session.waits:
                state = session.step()
            due += dt
            now = clock.monotonic()
            at_an_end = bool(session.failure) and float(np.abs(state.v).max()) < AT_REST
            if now >= frame_due or at_an_end:
                self._draw()
                self._take_recordings()
                if at_an_end:
                    return
                frame_due = now + FRAME
                now = clock.monotonic()
            if now < due:
                self._ending.wait(due - now)
            elif now - due > _LATEST:  # the computer is too slow or was asleep: skip the lost time
                due = now

    def _take_recordings(self) -> None:
        while (recording := self.session.take_recording()) is not None:
            self._recorder.take(recording)

    def _draw(self) -> None:
        """Show the present state. If that fails, the pages are told once, and the machine keeps being driven."""
        if self.session.failure:
            self._report("failure", self.session.failure)
        try:
            self._picture.show(self.session.snapshot())
        except Exception as error:  # noqa: BLE001  whatever it was, the machine must be stepped on
            self._report("picture", f"the picture cannot be drawn ({type(error).__name__}) and may be out of date")

    def _report(self, trouble: str, text: str) -> None:
        """Tell the pages once about a kind of trouble."""
        if trouble not in self._reported:
            self._reported.add(trouble)
            self._server.display.tell("trouble", {"text": text})

    def _tell_recorded(self, **content: object) -> None:
        """Report the progress of a recording to the pages and to the station's caller."""
        self._server.display.tell("recorded", content)
        if "file" in content:
            instead = f" ({content['instead']})" if content["instead"] else ""
            self._say(
                f"recording written: {content['file']}, {content['seconds']:.1f} s, {content['verdict']}{instead}"
            )
        elif "error" in content:
            self._say(f"recording: {content['error']}")


def _say_nothing(_: str) -> None:
    pass
