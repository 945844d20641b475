"""A machine that is driven live from one of several pages: the state machine, without any network.

pages     join and leave. One of them drives: the first that takes the controls, until it
          releases them, hands them over or leaves. The machine stops if it has no driver,
          or if its driver is silent: the watchdog uses the clock, not the steps.
wishes    go to the servo, which does the nearest safe thing
site      obstacles come, move and go, as long as the machine keeps its clearance
trouble   a step that fails makes the machine brake to rest, and it stays there
recording idle -> arming (to rest) -> on -> ending (to rest) -> idle
"""

from __future__ import annotations

import contextlib
import math
import threading
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin

import backhoe_planner.show.teleop.messages as messages
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.live import Feedback, Servo, ServoState, plan_from_recording
from backhoe_planner.machine import Robot
from backhoe_planner.motion import Drive, Trajectory
from backhoe_planner.planning import Plan, RecordingNotes
from backhoe_planner.show.drawing.timeline import CriticalPoint
from backhoe_planner.show.teleop.changes import Change, ChangeKind, describe_changes
from backhoe_planner.show.teleop.live_site import LiveSite
from backhoe_planner.show.teleop.messages import Message, Sticks, Stop, Tip
from backhoe_planner.site import Level, Obstacle, Scene, ZoneLog, joints_on_site, scaled_limits, zone_log

Phase = Literal["idle", "arming", "on", "ending"]
Wish = Tip | Sticks | Stop

LARGEST_FORCE = 30.0  # N on the hand; chosen, the default of `Feedback`
AT_REST = 1e-9  # rad/s or m/s: chosen, less than this is rounding
_LONGEST_RECORDING = 600.0  # s: chosen, 120,000 samples in the file
_FULL = 0.8  # part of oil flow and power that wishes may use; chosen, lever arms of cylinders change during a motion
_PATIENCE = 5.0  # s to come to rest, after which a recording ends anyway; chosen, evading may prevent rest
_WATCHDOG = 0.4  # s without a wish after which the machine stops; chosen, a network may hold one back for so long
_UPRIGHT = 0.99  # least absolute z of an axis that counts as vertical; chosen, 8 degrees


@dataclass(frozen=True)
class Recording:
    """A motion that was driven, from rest to rest, and the obstacles around it.

    Attributes
    ----------
    dt: time between samples [s].
    q: (T, n) joint positions [rad or m].
    obstacles: records as in a scene file, with times from the beginning of the recording.
    notes: changes of the obstacles that a scene file cannot express, in words.
    """

    dt: float
    q: Matrix
    obstacles: Sequence[dict[str, Any]]
    notes: Sequence[str]

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return (len(self.q) - 1) * self.dt

    def plan(self, robot: Robot, scene: Scene) -> Plan:
        """The motion as a plan, with its certificate, and its visits to zones in the findings."""
        motion = Trajectory.from_steps(np.asarray(self.dt * np.arange(len(self.q)), dtype=np.float64), self.q)
        notes = RecordingNotes(dt=self.dt, notes=tuple(self.notes))
        zones = zone_log(robot, scene, motion)
        return plan_from_recording(robot, scene, motion, obstacles=self.obstacles, recording=notes, zones=zones)


@dataclass(frozen=True)
class Snapshot:
    """The displayed state of one moment.

    Attributes
    ----------
    state: state of the servo.
    has_wish: whether a page currently commands a motion.
    obstacles: all obstacles, as they were added.
    shifts: displacement of each (3,) [m]; None if it has not appeared yet.
    movable: names of the obstacles that a page may move and take away.
    taken: names of the scene's obstacles that were taken away and may be put back.
    names: all names in use, including those of zones.
    nearest: the critical point to each obstacle and to the machine itself.
    zones: level of every zone whose warning, slow or stop distance is passed.
    driver, pages, asking: numbers of the page that drives, of all pages, of those that ask to drive.
    recording, recorded: phase of the recording, and its length so far [s].
    circulate: whether a tip that is pushed straight into an obstacle goes round it.
    failure: why the machine was stopped for good; otherwise empty.
    waits: whether nothing moves yet, see `Session.waits`.
    """

    state: ServoState
    has_wish: bool
    obstacles: tuple[Obstacle, ...]
    shifts: dict[str, Vector | None]
    movable: frozenset[str]
    taken: tuple[str, ...]
    names: tuple[str, ...]
    nearest: dict[str, CriticalPoint | None]
    zones: dict[str, Level]
    driver: int | None
    pages: tuple[int, ...]
    asking: tuple[int, ...]
    recording: Phase
    recorded: float
    circulate: bool
    failure: str
    waits: bool


class Session:
    """One machine that is driven live. Every method may be called from any thread.

    Parameters
    ----------
    robot, scene: the machine, and the site with the start. The scene's task is not used.
    dt: length of a step [s].
    now: the clock of the watchdog, which stops the machine if no wish came for a while [s].

    Raises
    ------
    InputError, SceneError, RobotError: the scene does not fit the machine, or has no start.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        dt: float = 0.005,
        now: Callable[[], float] = clock.monotonic,
    ) -> None:
        if scene.start is None:
            raise SceneError(
                "is missing: it says where the machine stands at first", file=scene.file, key="start",
                allowed="start: {joints: {...}} or start: {tip: {...}}",
            )  # fmt: skip
        self._lock = threading.Lock()
        feedback = Feedback(dt, largest=LARGEST_FORCE)
        on_site = joints_on_site(robot, scene)
        self._drive = Drive(on_site, effort=scaled_limits(on_site, scene).effort, payload=scene.payload)
        self._servo = Servo(robot, scene, dt, watchdog=_WATCHDOG, feedback=feedback, load=self._load)
        self.robot, self.scene, self.dt = self._servo.robot, scene, dt
        self._site = LiveSite(self._servo)
        self._changes_by_itself = any(one.is_dynamic for one in self._site.obstacles)
        self._zones = ZoneLog(self.robot, scene)
        self._pages: list[int] = []
        self._asking: list[int] = []
        self._driver: int | None = None
        self._driven = False  # whether anybody has taken the controls yet
        self._next_page = 1
        self._wish: Wish | None = None
        self._held: Wish | None = None
        self._now = now
        self._wished_at = now()
        self._failure = ""
        self._upright, self._axis_at = _first_axis(self.robot)
        self._begin_phase("idle")
        self._samples: list[Vector] = []  # of the recording in progress
        self._begun = 0.0
        self._recordings: list[Recording] = []
        self._changes: list[Change] = []  # since it began
        self._state = self._servo.step()

    # --- pages -----------------------------------------------------------------------

    def join(self) -> int:
        """Register a page that has connected, and return its number."""
        with self._lock:
            page = self._next_page
            self._next_page += 1
            self._pages.append(page)
            return page

    def leave(self, page: int) -> None:
        """Remove a page that has disconnected. If it drove, nobody does, and the machine stops."""
        with self._lock:
            self._pages = [other for other in self._pages if other != page]
            if self._driver == page:
                self._let_drive(None)
            self._asking = [other for other in self._asking if other != page]

    def release(self, page: int) -> None:
        """Take the controls from a page, and the machine stops; nothing changes if that page does not drive."""
        with self._lock:
            if self._driver == page:
                self._let_drive(None)

    def hear(self, page: int, text: str | bytes) -> dict[str, Any]:
        """Do what a page requests, and return the answer as plain data. Nothing is raised, whatever the request."""
        message: Message | None = None
        try:
            message = messages.parse(text)
            with self._lock:
                said = self._obey(page, message)
        except InputError as error:
            return _answer(message, error=str(error))
        except Exception as error:  # noqa: BLE001  the page gets the error; the machine is driven on
            return _answer(message, error=f"could not be done: {_in_one_line(error)}")
        return _answer(message, said=said)

    def _obey(self, page: int, message: Message) -> str:
        if page not in self._pages:
            raise InputError("is not here any more", key="page", found=page)
        if self._failure:
            raise InputError(self._failure)
        if isinstance(message, messages.Take):
            return self._take(page)
        if self._driver is None:
            raise InputError("nobody drives", hint="take the controls first")
        if self._driver != page:
            raise InputError(f"page {self._driver} drives", hint="ask it to hand over")
        if isinstance(message, (Tip, Sticks, Stop)):
            if isinstance(message, Tip) and message.pitch_rate is not None and not self.robot.has_pitch:
                raise InputError("is not defined for this machine", key="pitch_rate")
            self._wish, self._wished_at = message, self._now()
        elif isinstance(message, messages.Release):
            self._let_drive(None)
        elif isinstance(message, messages.HandOver):
            if message.to not in self._pages:
                there = ", ".join(map(str, self._pages))
                raise InputError("there is no such page", key="to", found=message.to, allowed=there)
            self._let_drive(message.to)
        elif isinstance(message, messages.Add):
            self._site.add(message.obstacle)
        elif isinstance(message, messages.Move):
            self._site.move(message.name, message.to)
        elif isinstance(message, messages.Remove):
            self._site.remove(message.name)
            self._note("taken away", message.name)
        elif isinstance(message, messages.PutBack):
            self._site.put_back(message.name)
            self._note("put back", message.name)
        elif isinstance(message, messages.Circulate):
            self._servo.circulate = message.on
        else:
            return self._record(message)
        return ""

    def _note(self, kind: ChangeKind, name: str) -> None:
        """Note a change of the site during a recording."""
        if self._samples:
            self._changes.append(Change(self._servo.time - self._begun, name, kind))

    def _take(self, page: int) -> str:
        if self._driver is None:
            self._let_drive(page)
        if self._driver == page:
            return "you drive"
        if page not in self._asking:
            self._asking.append(page)
        raise InputError(f"page {self._driver} drives, and sees that you ask")

    def _let_drive(self, page: int | None) -> None:
        """Give the controls to a page, or to none. The machine stops, so that the new driver starts from rest."""
        self._driver, self._wish = page, Stop(type="stop")
        self._driven = self._driven or page is not None
        self._asking = [other for other in self._asking if other != page]

    def _record(self, message: messages.Record) -> str:
        if message.on and self._phase == "idle":
            self._begin_phase("arming")
        elif not message.on and self._phase == "on":
            self._begin_phase("ending")
        elif not message.on and self._phase == "arming":
            self._begin_phase("idle")
        return f"recording: {self._phase}"

    def _begin_phase(self, phase: Phase) -> None:
        self._phase: Phase = phase
        self._waited = 0.0

    # --- the loop --------------------------------------------------------------------

    @property
    def waits(self) -> bool:
        """Whether obstacles of the scene move or appear later, and nobody has taken the controls yet.

        Until then a program that steps in real time should not step, so that nothing happens before anyone sees it.
        """
        return not self._driven and self._changes_by_itself

    def step(self) -> ServoState:
        """Advance by dt. If that fails, the machine brakes to rest and stays there, and `failure` says why."""
        with self._lock:
            if not self._failure:
                try:
                    return self._step()
                except Exception as error:  # noqa: BLE001  whatever it was, the machine must not be left moving
                    self._fail(error)
            self._state = self._servo.step(joint_velocity=np.zeros(self.robot.n))
            if self._phase == "ending":  # what was recorded until then is not lost
                with contextlib.suppress(Exception):
                    self._keep(self._state)
            return self._state

    @property
    def failure(self) -> str:
        """Why the machine was stopped for good; otherwise empty."""
        return self._failure

    def _step(self) -> ServoState:
        wish, self._wish = self._wish, None
        if self._phase in ("arming", "ending"):
            wish = Stop(type="stop")
        state = self._state = self._step_towards(self._held_wish(wish))
        if self._phase != "idle":
            self._keep(state)
        return state

    def _fail(self, error: Exception) -> None:
        self._failure = f"the machine was stopped, as a step failed: {_in_one_line(error)}"
        self._driver, self._wish, self._held = None, None, None
        self._begin_phase("ending" if self._samples else "idle")

    def _held_wish(self, wish: Wish | None) -> Wish | None:
        """The given wish, otherwise the last one; once the watchdog's time is over, the wish to stop."""
        self._held = wish or self._held
        if self._held is not None and self._now() - self._wished_at >= _WATCHDOG:
            self._held = Stop(type="stop")
        return self._held

    def _load(self, q: Vector, v: Vector) -> float:
        """Use of pump, rods and engine by joint velocities v (n,) at q (n,), relative to what wishes may use."""
        if self._drive.hydraulics is None:
            return 0.0
        used = self._drive.use(q[None], v[None], np.zeros((1, len(v))))
        return max(float(used.flow[0]), float(used.power[0]), float(used.rod_speed[0].max())) / _FULL

    def _step_towards(self, wish: Wish | None) -> ServoState:
        if wish is None:
            return self._servo.step()
        if isinstance(wish, Stop):
            return self._servo.step(joint_velocity=np.zeros(self.robot.n))
        if isinstance(wish, Sticks):
            return self._servo.step(joint_velocity=messages.joint_rates(wish, self._servo.limits.velocity))
        velocity = np.array(wish.velocity)
        if wish.frame == "arm":
            velocity = self._arm_frame() @ velocity
        return self._servo.step(velocity, pitch_rate=wish.pitch_rate)

    def _arm_frame(self) -> Matrix:
        """(3, 3) outward, left and up as columns; the world's axes if the first joint's axis is not vertical."""
        x, y = (self._state.tip_position - self._axis_at)[:2]
        far = math.hypot(x, y)
        if not self._upright or far < 1e-3:
            return np.eye(3)
        return np.array([[x / far, -y / far, 0.0], [y / far, x / far, 0.0], [0.0, 0.0, 1.0]])

    def _keep(self, state: ServoState) -> None:
        """Advance the recording."""
        if self._samples:
            self._samples.append(np.array(state.q))
            if self._phase == "on" and self._recorded >= _LONGEST_RECORDING:
                self._begin_phase("ending")
        if self._phase == "on":
            return
        self._waited += self.dt
        at_rest = float(np.abs(state.v).max()) < AT_REST
        if self._phase == "arming" and at_rest:
            self._begun, self._samples = state.time, [np.array(state.q)]
            self._changes.clear()
            self._begin_phase("on")
        elif self._phase == "ending" and (at_rest or self._waited > _PATIENCE):
            obstacles, moves = self._site.records(self._begun)
            notes = describe_changes([*moves, *self._changes])
            self._recordings.append(Recording(self.dt, np.array(self._samples), obstacles, notes))
            self._samples = []
            self._begin_phase("idle")

    @property
    def _recorded(self) -> float:
        """Length of the recording so far [s]."""
        return max(len(self._samples) - 1, 0) * self.dt

    def take_recording(self) -> Recording | None:
        """Take out a recording that has ended, or None if there is none."""
        with self._lock:
            return self._recordings.pop(0) if self._recordings else None

    def snapshot(self) -> Snapshot:
        """The displayed state of the present moment."""
        with self._lock:
            state, site = self._state, self._site
            obstacles = site.obstacles
            return Snapshot(
                state=state,
                has_wish=_is_for_motion(self._held),
                obstacles=obstacles,
                shifts={obstacle.name: site.shift_of(obstacle.name) for obstacle in obstacles},
                movable=frozenset(o.name for o in obstacles if site.may_be_moved(o.name)),
                taken=site.taken,
                names=tuple(site.names),
                nearest=site.nearest(state.q),
                zones=self._zones.note(state.time, state.q),
                driver=self._driver,
                pages=tuple(self._pages),
                asking=tuple(self._asking),
                recording=self._phase,
                recorded=self._recorded,
                circulate=self._servo.circulate,
                failure=self._failure,
                waits=self.waits,
            )


def _is_for_motion(wish: Wish | None) -> bool:
    """Whether a wish is for a motion, not for rest."""
    if isinstance(wish, Tip):
        return any(wish.velocity) or bool(wish.pitch_rate)
    return isinstance(wish, Sticks) and wish.speed > 0.0 and any((*wish.left, *wish.right))


def _in_one_line(error: Exception) -> str:
    """An error as one short line; the text of some errors fills a page."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0][:200]}" if lines else type(error).__name__


def _answer(message: Message | None, *, said: str = "", error: str | None = None) -> dict[str, Any]:
    return {
        "type": "answer",
        "id": None if message is None else message.id,
        "to": None if message is None else message.type,
        "ok": error is None,
        "said": said,
        "error": error,
    }


def _first_axis(robot: Robot) -> tuple[bool, Vector]:
    """Whether the first joint's axis is vertical, and a point (3,) on the axis [m]."""
    data = robot.model.createData()
    J = pin.computeJointJacobians(robot.model, data, robot.middle).reshape(6, robot.n)
    return bool(abs(J[5, 0]) > _UPRIGHT), np.array(data.oMi[1].translation)
