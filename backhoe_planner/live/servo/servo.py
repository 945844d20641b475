"""The servo: it takes a wish a thousand times a second and returns a motion that is always safe.

Every step keeps one invariant: if the machine brakes from now on, all joints in proportion,
it touches nothing and passes no limit (`braking_path`). A new velocity is taken only if the
braking path that follows from it is proven clear. If there is none, the machine brakes along
the path that was proven one step earlier. So no wish, and no failure of the optimisation,
can drive the machine into a static obstacle. On a proven `Track` it may brake along that instead.
If something turns up on the braking path, the machine brakes with all its acceleration (`stop_choice`).

The nearest safe velocity is found by a small QP (`safe_velocity`). Its rows are the gaps
of the links' corners along the braking path (`path_check`), and one row for each moving
obstacle, which demands a velocity away from it that the machine can still reach.

If the machine is closer to something than allowed (from the start, or because an obstacle
was put there), this may only get better: for every obstacle the deepest violation over the
links falls at every step, and the next step must keep what was proven. If no such motion
leads out, the machine follows a route along which no violation is deeper than at the start,
and the length of that route falls at every step (`recovery`).

Within the slow distance of one of the scene's zones the wish is scaled down; its direction is kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from backhoe_planner.arrays import Indices, Vector, as_number
from backhoe_planner.errors import InputError, check_callable, check_flag, check_kind
from backhoe_planner.live.braking.braking_path import STEP_END, JointState, Placements
from backhoe_planner.live.braking.joint_bounds import BRAKING, JointBounds, Load
from backhoe_planner.live.braking.kept_rows import KeptRows
from backhoe_planner.live.braking.step_work import StepWork
from backhoe_planner.live.clearance.approach_check import SEEN_COMING, ApproachCheck
from backhoe_planner.live.clearance.box_upkeep import BoxUpkeep
from backhoe_planner.live.clearance.pair_bounds import Near, PairBounds
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.live.planes.own_pieces import NO_LOAD
from backhoe_planner.live.planes.separation import Separation
from backhoe_planner.live.recovery.recovery import Recovery
from backhoe_planner.live.servo.commands import Commands
from backhoe_planner.live.servo.feedback import Feedback
from backhoe_planner.live.servo.holding import Hold, find_hold
from backhoe_planner.live.servo.joint_stop import STRAIGHT
from backhoe_planner.live.servo.loads import Loads
from backhoe_planner.live.servo.safe_velocity import SafeVelocity, VelocityFilter, VelocityWish
from backhoe_planner.live.servo.servo_state import Command, ServoState
from backhoe_planner.live.servo.step_report import StepReport
from backhoe_planner.live.servo.stop_choice import Stop, StopChoice
from backhoe_planner.live.servo.surroundings import Surroundings
from backhoe_planner.live.servo.tip_task import TipTask
from backhoe_planner.live.servo.track import Track
from backhoe_planner.machine import Robot, solve_inverse_kinematics
from backhoe_planner.site import (
    Obstacle,
    Scene,
    build_obstacles,
    joint_positions,
    machine_on_site,
    pace,
    scaled_limits,
    swing_sectors,
)

_INFLUENCE = 0.3  # m of margin: obstacles further away do not act on the wish and are not named in the state; chosen
_STEPS = (1e-6, 1.0)  # s: shortest and longest dt; chosen, a dt outside is a slip


class Servo:
    """Drives one machine among obstacles, one step after the other.

    Parameters
    ----------
    robot, scene: the machine, and its site. Of the scene's task only the loads of a sequence's legs are used; nothing
        is carried before `carry` is called.
    dt: length of a step [s], a microsecond to a second.
    q: (n,) initial joint positions [rad or m]; by default the scene's start.
    watchdog: the machine stops when no command has come for this long [s]; infinite for never.
    circulate: whether a tip that is pushed straight into an obstacle goes around it.
    self_collision: whether the machine is also kept clear of itself.
    feedback: computes the force on the hand; `Feedback(dt)` by default.
    load: for drives that the joints share, such as one pump: load(q, v) is the part of their
        capacity that joint velocities v (n,) at q (n,) need. Wishes are scaled down so that it is at
        most 1. It may be exceeded to evade an obstacle, or to leave a violation.

    Raises
    ------
    InputError, SceneError, RobotError: the scene does not fit the machine, there is no
        start, or a number is out of its range.

    Attributes
    ----------
    robot, scene, dt: as above; the robot has the scene's tip and swing sectors, and what it carries now.
    circulate: as above; may be set.
    limits: joint limits in this scene.
    last_error: the last error inside a step, which then braked; None if there was none.

    `step` raises nothing. The servo owns its working memory: do not share one between threads.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        dt: float = 0.001,
        *,
        q: object = None,
        watchdog: float = 0.2,
        circulate: bool = False,
        self_collision: bool = True,
        feedback: Feedback | None = None,
        load: Load | None = None,
    ) -> None:
        dt = as_number(dt, key="dt", least=_STEPS[0], most=_STEPS[1])
        watchdog = as_number(watchdog, key="watchdog", least=0.0, finite=False)
        circulate = check_flag(circulate, key="circulate")
        self_collision = check_flag(self_collision, key="self_collision")
        if feedback is not None:
            check_kind(feedback, Feedback, key="feedback")
        load = check_callable(load, key="load")
        robot = machine_on_site(robot, scene)
        self.robot, self.scene, self.dt, self.circulate = robot, scene, dt, circulate
        self.limits = scaled_limits(robot, scene)
        q = _start(robot, scene) if q is None else robot.check_q(q)
        n = robot.n
        self._state = JointState(q, np.zeros(n), q)
        self._stop: Stop | None = None  # how the machine stops, if it does not straight ahead
        self._steps = 0
        self._chosen: tuple[VelocityWish, SafeVelocity] | None = None  # in the last step, unless it was a stop
        self.last_error: Exception | None = None
        self._joints = JointBounds(self.limits, dt, load)
        self._commands = Commands(robot, dt=dt, watchdog=watchdog)
        self._at = Placements(robot, STEP_END + 1)
        self._bare, self._loads = robot, Loads(robot, scene)
        self._separation = Separation(robot, q, self_collision=self_collision, laden=self._loads.laden)
        influence = min(scene.influence, _INFLUENCE)
        self._bounds = PairBounds(self._separation, influence=influence)
        self._check = PathCheck(self._separation, self._bounds, self._joints, self._at)
        self._boxes = BoxUpkeep(robot, self._check, influence=influence)
        self._tip = TipTask(robot, self._check, influence=influence)
        self._recovery = Recovery(robot, self._check)
        self._approach = ApproachCheck(robot, self._separation, self._bounds, self._joints)
        self._stops = StopChoice(robot, self._check)
        self._filter = VelocityFilter(self._check, self._recovery)
        self._sectors = [
            (zone.start + zone.stop, zone.end - zone.stop, zone.slow_distance - zone.stop)
            for zone in swing_sectors(robot, scene).values()
            if zone.slow_distance > zone.stop
        ]
        self._site = Surroundings(robot, scene, self._separation)
        self._report = StepReport(
            self._check, self._tip, self._commands, self._site,
            feedback=Feedback(dt) if feedback is None else feedback, influence=influence,
        )  # fmt: skip
        self._update_moving()
        self._measure(np.arange(len(self._separation), dtype=np.intp))
        self._add(build_obstacles(scene, robot))

    def __repr__(self) -> str:
        return f"<Servo of {self.robot.name}, obstacles: {len(self.obstacles)}, dt {self.dt:g} s, at {self.time:.3f} s>"

    # --- the joints and the obstacles --------------------------------------------------

    @property
    def q(self) -> Vector:
        """(n,) positions of the joints [rad or m]."""
        return self._state.q.copy()

    @property
    def v(self) -> Vector:
        """(n,) velocity of the last step [rad/s or m/s]."""
        return self._state.v.copy()

    @property
    def time(self) -> float:
        """Time since the servo started [s]."""
        return self._steps * self.dt

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Names of the obstacles that are present now."""
        return self._site.names

    @property
    def revision(self) -> int:
        """Count of changes: an obstacle was added, removed, moved by hand or given another velocity."""
        return self._site.revision

    def snapshot(self) -> tuple[Obstacle, ...]:
        """The obstacles present now, each at its present position and velocity. Takes some 10 us each."""
        return self._site.snapshot()

    @property
    def waiting(self) -> tuple[Obstacle, ...]:
        """The obstacles that have not appeared yet; their `appears_at` counts from the start of the servo [s]."""
        return self._site.waiting

    def is_moving(self, name: str | None = None) -> bool:
        """Whether the obstacle of that name, or any if `name` is None, has a velocity now."""
        return self._site.is_moving(name)

    def add(self, obstacle: Obstacle | Mapping[str, Any]) -> None:
        """Add an obstacle, from the next step on.

        Parameters
        ----------
        obstacle: a record as in the scene file, or an `Obstacle`. Its `appears_at` counts from now.

        Raises
        ------
        InputError: the name is in use, also by a zone of the scene, or the record does not describe an obstacle.
        """
        self._add([self._site.build(obstacle)])

    def add_points(self, name: str, points: object, *, resolution: float = 0.1, clearance: float | None = None) -> None:
        """Add a scan: every voxel that contains a point is solid. A scan of the same name is replaced.

        The new one stands still until `set_velocity` is called again. Without points there is none.

        Parameters
        ----------
        name: of the obstacle.
        points: (k, 3) [m], world.
        resolution: edge of a voxel [m].
        clearance: to be kept [m]; the scene's by default.

        Raises
        ------
        InputError: the points are not (k, 3) numbers within a kilometre, the resolution is not
            between a millimetre and a hundred metres, the clearance is not a length, or a zone
            or an obstacle of another kind has the name.
        """
        scan = self._site.build_scan(name, points, resolution=resolution, clearance=clearance)
        if name in self.obstacles:
            self.remove(name)
        if scan is not None:
            self._add([scan])

    def remove(self, name: str) -> None:
        """Remove an obstacle or a zone, also one that has not appeared yet.

        Raises
        ------
        InputError: there is none of that name.
        """
        self._bounds.keep(self._site.take_away(name))
        self._update_moving()
        self._bounds.find_inside()
        self._recovery.changed()

    def move(self, name: str, by: object) -> None:
        """Move an obstacle at once, by `by` (3,) from where it is now [m], world.

        Raises
        ------
        InputError: there is none of that name, or `by` is not three finite numbers.
        """
        self._measure(self._site.move(name, by))

    def set_velocity(self, name: str, velocity: object) -> None:
        """Let an obstacle move at `velocity` (3,) from now on [m/s], world.

        Raises
        ------
        InputError: there is none of that name, or `velocity` is not three finite numbers.
        """
        pairs = self._site.set_velocity(name, velocity)
        self._update_moving()
        self._measure(pairs)

    def carry(self, leg: str | None) -> None:
        """Carry what is carried in a leg of the scene's sequence, from the next step on; None for nothing.

        The load is a part of the machine's shape, and keeps the clearances of the link that holds it. If it is closer
        to something than allowed when it is taken up, that may only get better. Takes 20 us for each pair that is not
        known to be clear, see `prepare_to_carry`.

        Raises
        ------
        InputError: the scene has no such leg.
        """
        load = self._loads.number_of(leg)
        laden = self._bare if load == NO_LOAD else self._loads.laden[load]
        if laden is self.robot:
            return
        self.robot = laden
        self._separation.carry(load)
        path = self._check.path(self._state.q, self._state.v, step=False)
        plain, of_scans = self._separation.pairs_of_load(load)
        self._measure(np.concatenate((self._bounds.carry(plain, path), of_scans)))
        self._check.forget()
        self._boxes.forget(blocking=True)
        self._recovery.changed()
        self._stops.compare_again()

    def prepare_to_carry(self, leg: str | None) -> None:
        """Measure a few of the pairs of the load of a leg that is about to begin; takes about 0.1 ms.

        If it is called between some steps before `carry`, little is left to be measured there.

        Raises
        ------
        InputError: the scene has no such leg.
        """
        plain, _ = self._separation.pairs_of_load(self._loads.number_of(leg))
        if len(plain):
            self._tip.place(self._state.q)
            self._bounds.prepare(plain, self._at)

    @property
    def way_to_go(self) -> float | None:
        """Upper bound of the distance that any point of the machine still has to move until it is clear [m].

        It falls at every step on a route out along which violations may grow back; None otherwise.
        """
        return self._recovery.to_go

    @property
    def work(self) -> StepWork:
        """The counted work of the last step, without that for obstacles that appeared in it or may reach a track."""
        return self._check.work

    def shift_of(self, name: str) -> Vector:
        """(3,) how far an obstacle has moved from where it was added [m].

        Raises
        ------
        InputError: there is none of that name.
        """
        return self._site.shift_of(name)

    def is_proven_along_unchecked(self, track: Track) -> bool:
        """Whether a track is proven for what is there now and what the machine carries.

        Obstacles that move count if they may come too close before the machine has come to rest along the track and
        begins to give way.
        """
        changed = track.revision != self.revision or track.carried is not self.robot.carried
        if changed or self._joints.shares_load:
            return False
        return not (self._site.anything_moves and self._approach.reaches(track, self._state.v, self._steps))

    @property
    def reached_by(self) -> str:
        """Name of a moving obstacle that may reach the machine on its track, as far as was asked; empty if none may."""
        return self._site.name_of(self._approach.pair) if self._site.anything_moves else ""

    def held_by_unchecked(self) -> Hold | None:
        """What held the machine back in the last step; None if nothing did, or if it stopped along a track.

        It is to be asked before anything else changes.
        """
        if self._chosen is None:
            return None
        return find_hold(
            self._check, self._filter, self._site, *self._chosen, joints=self.robot.joint_names, time=self.time
        )

    @property
    def on_track(self) -> bool:
        """Whether the machine, if it has to stop, does so along the track of `step_along_unchecked`."""
        return isinstance(self._stop, Track)

    def _add(self, obstacles: Iterable[Obstacle]) -> None:
        pairs = self._site.put(obstacles, now=self.time)
        if len(pairs) == 0:
            return
        self._bounds.extend(pairs, slow=self._site.slow_from(pairs))
        self._update_moving()
        self._measure(pairs)

    def _update_moving(self) -> None:
        """Update which pairs there are, which of them move, and how far they move in a step."""
        self._check.forget()
        self._approach.forget()
        self._boxes.forget(blocking=True)
        per_step, coming = self.dt * self._site.speed, SEEN_COMING * self._site.speed
        # the braking path of one step later may end up to 2 / BRAKING steps later
        self._bounds.sort(self._site.stands, coming, per_step, (1.0 + 2.0 / BRAKING) * per_step)

    def _measure(self, pairs: Indices) -> None:
        """Measure `pairs` (K,) that are new or were moved."""
        if len(pairs) == 0:
            return
        self._check.forget()
        self._tip.place(self._state.q)
        self._boxes.forget()
        self._boxes.find_for(pairs, self._state)
        path = self._check.path(self._state.q, self._state.v, step=False)
        path.place(self._at)
        self._bounds.measure(pairs, path, self._at)
        if self._stop is None and self._may_stop_sooner(pairs):
            self._stop = self._stops.stops_from(self._state.v)[STRAIGHT]
            self._stops.forget()
        if self._stop is not None:
            self._require_clearance(pairs)
            self._stops.compare_again()
        if self._bounds.stands[pairs].any():
            self._recovery.changed()

    def _may_stop_sooner(self, pairs: Indices) -> bool:
        """Whether something among `pairs` (K,) is in the way of braking as it was planned, but not too near yet."""
        near = pairs[np.isin(pairs, self._bounds.inside)]
        if len(near) == 0 or not self._state.v.any():
            return False
        return bool((self._bounds.lower()[near] >= self._separation.clearance[near]).all())

    # --- one step ----------------------------------------------------------------------

    def step(
        self, tip_velocity: object = None, *, joint_velocity: object = None, pitch_rate: object = None
    ) -> ServoState:
        """Move on by dt towards the wish.

        Parameters
        ----------
        tip_velocity: (3,) wished velocity of the tip [m/s], world.
        joint_velocity: (n,) wished velocity of the joints [rad/s or m/s]; instead of `tip_velocity`.
        pitch_rate: wished rate of the bucket's pitch, with `tip_velocity` [rad/s]; without it the pitch is free.

        Without any of them the last wish holds, until the watchdog ends it. A command that is not
        finite, has the wrong shape or is contradictory counts as none. Nothing is raised.
        """
        command = self._commands.understand(tip_velocity, joint_velocity, pitch_rate)
        return self._step(command, None, 1.0)

    def step_along_unchecked(self, track: Track, *, pace: float) -> ServoState:
        """Move on by dt along a track that the machine has joined (`Track.is_joined_by`), at a pace of at most `pace`.

        The step is taken if braking straight ahead is proven clear, or else if the track is proven clear of the
        obstacles that are there now: then the machine can stop along the track. Otherwise, and in every later step
        for which no other motion is proven, it slows down along the track. Nothing is raised.
        """
        q, v, _ = self._state
        command = self._commands.understand(None, track.faster(q, v, pace), None)
        return self._step(command, track, pace)

    def step_keeping_unchecked(self, v: Vector, kept: KeptRows) -> ServoState:
        """Move on by dt towards the velocity `v` (n,) of the joints, giving way as `kept` says. Nothing is raised."""
        command = self._commands.understand(None, v, None)
        return self._step(command, None, 1.0, kept=kept)

    def _step(self, command: Command, track: Track | None, pace: float, *, kept: KeptRows | None = None) -> ServoState:
        self._steps += 1
        self._chosen, before = None, self._state
        try:
            return self._move(command, track, pace, kept)
        except Exception as error:  # noqa: BLE001  whatever the error, a way to stand still was proven before
            self.last_error = error.with_traceback(None)
            return self._brake(command, failed=True, moved=self._state is not before)

    def _move(self, command: Command, track: Track | None, most: float, kept: KeptRows | None) -> ServoState:
        """Find what is near, the joint wish and the nearest safe velocity, and take the step."""
        self._drift()
        if track is not None and not self.is_proven_along_unchecked(track):
            track = None
        covered = not self._separation.clusters or self._boxes.renew(self._state, self._steps)
        if not covered and track is None:
            return self._brake(command, failed=False)
        near = self._bounds.near(self._state.q, self._at)
        self._check.begin_step(len(near.pairs))
        if self._bounds.anything_moves:
            near = self._bounds.look_at_movers(near, self._at)
        if track is not None:
            return self._move_along(command, track, most, near, covered=covered)
        q, v, _ = self._state
        wish = self._tip.wish(q, self._commands, near, circulate=self.circulate)
        pace = min(self._bounds.pace(near), self._pace_of_sectors())
        wished = wish.v if pace == 1.0 else pace * wish.v
        request = VelocityWish(
            v=wished,
            target=self._joints.towards(wished, v),
            task=wish.task if kept is None or len(kept.near) == 0 else kept.near,
            null=wish.null,
            for_tip=self._commands.tip is not None,
            range=self._joints.velocity_range(q, v, wished),
            kept=kept,
        )
        chosen = self._filter.choose(self._state, request, near)
        if self._stop is not None:
            if chosen.end is None or not self._may_leave(self._stop, chosen.v, chosen.end):
                return self._brake(command, failed=False)
            self._stop = None
        self._chosen = request, chosen
        self._bounds.renew(near, self._at, self._steps)
        self._boxes.note(near, held_back=chosen.end is None)
        self._advance(chosen.v, chosen.end)
        return self._report.after_step(self._state, self.time, command, near, wish, request, chosen, pace)

    def _move_along(self, command: Command, track: Track, most: float, near: Near, *, covered: bool) -> ServoState:
        """Take a step along a track that is proven clear; `covered`: whether boxes hold all that could come near."""
        q, v, _ = self._state
        if len(self._bounds.inside):
            self._require_clearance(self._bounds.inside)
        pace = min(self._bounds.pace(near), self._pace_of_sectors())
        wished = track.faster(q, v, min(most, pace))
        limits = self._joints.velocity_range(q, v, wished)
        path, awake = self._check.path(q, wished), self._check.awake(self._state, limits.look)
        found = self._check.clearance(awake, path)
        straight = covered and found.clear and self._may_leave(track, wished, path.end)
        self._bounds.accept(awake.pairs, found)
        self._bounds.renew(near, self._at, self._steps)
        self._boxes.note(near, held_back=False)
        self._stops.forget()  # the track is proven
        self._go_on(track, wished, path.end, straight=straight)
        wish = self._tip.wish(q, self._commands, near, circulate=False)
        request = VelocityWish(wished, wished, None, wished, for_tip=False, range=limits._replace(cuts_wish=False))
        chosen = SafeVelocity(wished, held_back=False, evading=False, end=path.end)
        return self._report.after_step(self._state, self.time, command, near, wish, request, chosen, pace)

    def _go_on(self, stop: Stop, v: Vector, end: Vector, *, straight: bool) -> None:
        """Take a step of a stop, or along a track, at v (n,), with the `end` (n,) of its straight braking path.

        straight: whether that path is proven, so that the stop is no longer needed.
        """
        self._check.forget()
        self._stop = None if straight else stop
        self._advance(v, end)
        stop.advance()
        if self._stop is not None and not v.any():
            # at rest the machine needs no stop: what is too near here may only be left from now on
            self._stop = None
            self._measure(self._check.awake(self._state, 0.0).pairs)

    def _may_leave(self, stop: Stop, v: Vector, end: Vector) -> bool:
        """Whether braking straight to `end` (n,), after a step at v (n,), keeps joint limits and what a track keeps."""
        if not self._joints.are_kept_at(end):
            return False
        return not isinstance(stop, Track) or stop.may_be_left(self._state.q + self.dt * v, end)

    def _require_clearance(self, pairs: Indices) -> None:
        """Require the clearance of `pairs` (K,): on a track the straight braking path does not say what can be kept."""
        self._bounds.require(pairs, self._separation.clearance[pairs])
        self._bounds.find_inside()

    def _drift(self) -> None:
        """Let obstacles appear and move on, and compute the machine's placement."""
        if due := self._site.due(self.time):
            self._add(due)
        if self._site.anything_moves:
            self._site.drift(self.dt)
            self._bounds.drift()
        self._tip.place(self._state.q)

    def _pace_of_sectors(self) -> float:
        """The part of the wished speed that the slow distances of swing sectors allow."""
        if not self._sectors:
            return 1.0
        swing = float(self._state.q[0])
        return min(pace(min(swing - low, high - swing), room) for low, high, room in self._sectors)

    def _advance(self, v: Vector, end: Vector | None) -> None:
        """Take the step at v (n,). Without `end` (n,) the braking path remains the one that was proven before."""
        before, moved = self._state, v * self.dt
        self._bounds.advance(moved, None if end is None else end - before.end)
        q = before.q + moved
        self._state = JointState(q, v, self._check.path(q, v, step=False).end if end is None else end)

    def _brake(self, command: Command, *, failed: bool, moved: bool = False) -> ServoState:
        """Brake after a failure, or because nothing else is proven, unless the step was already taken."""
        straight = moved or self._stop is None
        if not moved and self._stop is not None:
            if not failed:
                self._stop = self._stops.best(self._stop, self._state, self.time)
            q, v, _ = self._state
            slower = self._stop.slower(q, v)
            self._bounds.accept_nothing()
            self._go_on(self._stop, slower, self._check.path(q, slower).end, straight=False)
        elif not moved:
            self._advance(self._joints.brake(self._state.v), None)
        return self._report.after_braking(self._state, self.time, command, failed=failed, straight=straight)


def _start(robot: Robot, scene: Scene) -> Vector:
    if scene.start is None:
        raise InputError("the scene does not say where the machine stands", key="start", allowed="start, or q=")
    if scene.start.tip is not None:
        found = solve_inverse_kinematics(robot, scene.start.tip.target)
        if not found.reached:
            raise InputError("the machine cannot stand there", key="start.tip", found=scene.start.tip.position)
        return found.q
    return joint_positions(robot, scene, scene.start.joints or {}, key="start.joints")
