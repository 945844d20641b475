"""The servo: a wish in, a thousand times a second, and a motion out that is always safe.

Every step holds to one invariant: if the machine were to brake from here on, in
proportion, nothing would be touched and no limit passed (`braking_path`). A new velocity is
taken only where the braking path that follows from it is proven clear; where none
is, the machine brakes along the path that was proven one step earlier. So no wish, and
no failure of the optimisation, can drive it into an obstacle that stands still.

Which velocity is the nearest safe one says a small QP. Its rows are the gaps of the
links' corners along the braking path, so that it sees what the proof will see:

    min_v |v - v_w|_W   s.t.   gap_i(s) - s g_i D (v - v_ref) >= clearance_i

with D the derivative of the path's end by v. An obstacle that moves is met by one more
row, which asks for a velocity away from it while the machine can still reach it:

    g v + u.n >= -sqrt(2 a_n margin),   a_n = sum_j |g_j| a_j / 2

What is closer than allowed already (it began so, or an obstacle was put there) may only
get better: of every obstacle the deepest violation over the links falls at every step, and
what was proven of it is what the next step must keep. Where no such motion leads out, the
machine goes by a way that is nowhere deeper than where it began, and the length of that way
falls at every step (`recovery`).

Within the slow distance of one of the scene's zones the wish is scaled down, direction kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError
from backhoe_planner.law import QuadraticProgram, Rows, solve_program
from backhoe_planner.live.braking.braking_path import MOST_PARTS, BrakingPath, Placements
from backhoe_planner.live.braking.joint_bounds import (
    BRAKING,
    FASTEST_RECOVERY,
    RECOVERY,
    SLOWEST_RECOVERY,
    JointBounds,
    Load,
)
from backhoe_planner.live.braking.pair_bounds import BUFFER, TOLERANCE, Near, PairBounds
from backhoe_planner.live.braking.proof import Proof
from backhoe_planner.live.braking.separation import Separation
from backhoe_planner.live.recovery.recovery import Recovery, Step
from backhoe_planner.live.servo.commands import Commands
from backhoe_planner.live.servo.feedback import Feedback
from backhoe_planner.live.servo.servo_state import Command, ServoState, Status
from backhoe_planner.live.servo.surroundings import Surroundings, number_within
from backhoe_planner.live.servo.tip_task import TipTask, Wished
from backhoe_planner.machine import Robot, TipTarget, solve_inverse_kinematics
from backhoe_planner.site import Obstacle, build_obstacles, pace, scaled_limits, scene_file, within_sectors

__all__ = ["Servo"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]

_ATTEMPTS = 3
_BLENDS = (0.5, 0.2)
_LOOKS = 12  # pairs that are looked at closely per step at most
_FREE = 0.005  # weight of the null space beside the tip
_VIOLATED = 1e-7  # m
_REMEMBERED = 0.02  # s for which being held back counts
_WARN = 0.10  # m of margin within which it says so
_AS_ASKED = 1e-9  # rad/s or m/s
_AT_REST = 1e-3  # rad/s or m/s: what creeps more slowly is told as standing
_STEPS = (1e-6, 1.0)  # s
_MOST_ROWS = 400  # of the QP: the tightest


class _Chosen(NamedTuple):
    """The velocity of a step, and why."""

    v: Vector
    held_back: bool
    evading: bool
    end: Vector | None  # of its braking path; None where the machine brakes on the path of before

    @property
    def proven(self) -> bool:
        return self.end is not None


class Servo:
    """Drives one machine among obstacles, one step after the other.

    Parameters
    ----------
    robot, scene: the machine, and the site in which it stands. The scene's task is not used.
    dt: length of a step [s], a microsecond to a second.
    q: (n,) where the joints stand; by default the scene's start.
    watchdog: without a command for this long the machine stops [s]; infinite for never.
    circulate: whether a tip that is pushed straight into an obstacle goes round it.
    self_collision: whether the machine is also kept clear of itself.
    feedback: how the force on the hand is made; `Feedback(dt)` by default.
    load: load(q, v) is the part of what drives all joints together, as the oil of one pump, that
        joint velocities v (n,) at q (n,) take; wishes are cut back so that it is at most 1. To get
        away from what comes nearer, or out of what is violated, more may be asked for.

    Raises
    ------
    InputError, SceneError, RobotError: the scene does not fit the machine, there is no
        start, or a number is out of its range.

    Attributes
    ----------
    last_error: what last went wrong inside a step, which then braked; None if nothing ever did.

    `step` itself raises nothing. The servo owns its working memory: do not share one
    between threads.
    """

    def __init__(
        self,
        robot: Robot,
        scene: scene_file.Scene,
        dt: float = 0.001,
        *,
        q: object = None,
        watchdog: float = 0.2,
        circulate: bool = False,
        self_collision: bool = True,
        feedback: Feedback | None = None,
        load: Load | None = None,
    ) -> None:
        dt = number_within("dt", dt, *_STEPS)
        watchdog = number_within("watchdog", watchdog, 0.0, math.inf)
        robot = within_sectors(robot.with_tip(scene.tip), scene)
        self.robot, self.scene, self.dt = robot, scene, dt
        self.limits = scaled_limits(robot, scene)
        self._q = _start(robot, scene) if q is None else robot.check_q(q)
        n = robot.n
        self._v = np.zeros(n)
        self._free_v = [0.0] * n
        self._asked = np.zeros(n)  # the next velocity if nothing were in the way
        self._end = self._q.copy()
        self._steps = 0
        self.last_error: Exception | None = None
        self._joints = JointBounds(self.limits, dt, load)
        self._holds = max(math.ceil(_REMEMBERED / dt), 1)
        self._held_back_for = 0
        self._forgets = 1.0 - math.exp(-dt / _REMEMBERED)
        self._feedback = Feedback(dt) if feedback is None else feedback
        self._commands = Commands(robot, dt=dt, watchdog=watchdog)
        self._at = Placements(robot, MOST_PARTS + 2)
        self._separation = Separation(robot, self_collision=self_collision)
        self._tip = TipTask(
            robot, self._separation, self._joints, self._at, influence=scene.influence, circulate=circulate
        )
        self._task: Matrix | None = None
        self._beside = np.zeros(n)
        self._bounds = PairBounds(self._separation, influence=self._tip.law.influence)
        self._sectors = [
            (zone.start + zone.stop, zone.end - zone.stop, zone.slow_distance - zone.stop)
            for zone in scene.zones
            if isinstance(zone, scene_file.SwingSector) and zone.slow_distance > zone.stop
        ]
        self._pace = 1.0
        self._recovery = Recovery(robot, self.limits, self._separation, self._at, dt, self._joints.change)
        self._site = Surroundings(robot, scene, self._separation)
        self._sort()
        self._take_in(np.arange(len(self._separation), dtype=np.intp))
        for obstacle in build_obstacles(scene, robot):
            self._add(obstacle)

    # --- what stands around ----------------------------------------------------------

    @property
    def q(self) -> Vector:
        """(n,) where the joints are [rad or m]."""
        return self._q.copy()

    @property
    def v(self) -> Vector:
        """(n,) velocity of the last step [rad/s or m/s]."""
        return self._v.copy()

    @property
    def circulate(self) -> bool:
        """Whether a tip that is pushed straight into an obstacle goes round it; may be set."""
        return self._tip.circulate

    @circulate.setter
    def circulate(self, value: bool) -> None:
        self._tip.circulate = value

    @property
    def time(self) -> float:
        """[s] since the servo began."""
        return self._steps * self.dt

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Names of what stands around now."""
        return self._site.names

    @property
    def revision(self) -> int:
        """How often what stands around was changed: put there, taken away, moved by hand, given another velocity."""
        return self._site.revision

    def snapshot(self) -> tuple[Obstacle, ...]:
        """What stands around now, each where it is now, with its present velocity. Takes some 10 us each."""
        return self._site.snapshot()

    def is_moving(self, name: str | None = None) -> bool:
        """Whether there is an obstacle of that name, or any, that has a velocity now."""
        return self._site.moves(name)

    def add(self, obstacle: Obstacle | Mapping[str, Any]) -> None:
        """Put an obstacle there, from the next step on.

        Parameters
        ----------
        obstacle: as in the scene file, or already built. Its `appears_at` counts from now.

        Raises
        ------
        InputError: the name is taken, or the record is not one of an obstacle.
        """
        self._add(self._site.built(obstacle))

    def add_points(self, name: str, points: object, *, resolution: float = 0.1, clearance: float | None = None) -> None:
        """Put a scan there: every voxel in which a point lies is solid. A scan of that name is replaced.

        Parameters
        ----------
        points: (k, 3) [m], world.
        resolution: edge of a voxel [m].
        clearance: to be kept [m]; the scene's by default.

        Raises
        ------
        InputError: the points are not (k, 3) numbers within a kilometre, a voxel's edge is not
            between a millimetre and a hundred metres, the clearance is not a length, or the
            name is that of another kind of obstacle.
        """
        scan = self._site.scanned(name, points, resolution=resolution, clearance=clearance)
        if name in self.obstacles:
            self.remove(name)
        if scan is not None:
            self._add(scan)

    def remove(self, name: str) -> None:
        """Take an obstacle away, also one that has not appeared yet. A zone is one too.

        Raises
        ------
        InputError: there is none of that name.
        """
        self._bounds.keep(self._site.take_away(name))
        self._sort()
        self._bounds.find_inside()
        self._recovery.changed()

    def move(self, name: str, by: object) -> None:
        """Put an obstacle elsewhere at once, `by` (3,) from where it is now [m], world.

        Raises
        ------
        InputError: there is none of that name, or `by` is not three finite numbers.
        """
        self._take_in(self._site.move(name, by))

    def set_velocity(self, name: str, velocity: object) -> None:
        """Let an obstacle move at `velocity` (3,) from now on [m/s], world.

        Raises
        ------
        InputError: there is none of that name, or `velocity` is not three finite numbers.
        """
        pairs = self._site.set_velocity(name, velocity)
        self._sort()
        self._take_in(pairs)

    @property
    def way_to_go(self) -> float | None:
        """No point of the machine has further than this to go until it is clear [m].

        Only where the way back leads past what is no shallower; it falls at every step. None elsewhere.
        """
        return self._recovery.to_go

    def shift_of(self, name: str) -> Vector:
        """(3,) how far an obstacle has moved from where it was put [m].

        Raises
        ------
        InputError: there is none of that name.
        """
        return self._site.shift_of(name)

    def _add(self, obstacle: Obstacle) -> None:
        pairs = self._site.put(obstacle, now=self.time)
        if len(pairs) == 0:
            return
        self._bounds.extend(pairs, slow=obstacle.slow)
        self._sort()
        self._take_in(pairs)

    def _sort(self) -> None:
        per_step = self.dt * self._site.speed
        # the braking path of one step later may end up to 2 / BRAKING steps later
        self._bounds.sort(self._site.stands, per_step, (1.0 + 2.0 / BRAKING) * per_step)

    def _take_in(self, pairs: Indices) -> None:
        """Measure pairs that are new or were moved."""
        if len(pairs) == 0:
            return
        self._tip.place(self._q)
        path = self._path(self._v, step=False)
        path.place(self._at)
        self._bounds.measure(pairs, path, self._at, self._steps)
        if self._bounds.stands[pairs].any():
            self._recovery.changed()

    # --- one step ----------------------------------------------------------------------

    def step(
        self, tip_velocity: object = None, *, joint_velocity: object = None, pitch_rate: object = None
    ) -> ServoState:
        """Move on by dt towards the wish.

        Parameters
        ----------
        tip_velocity: (3,) wished for the tip [m/s], world.
        joint_velocity: (n,) wished for the joints [rad/s or m/s]; only one of the two.
        pitch_rate: wished for the bucket's pitch [rad/s]; left out, pitch is free.

        A wish is held until the next one, or until the watchdog ends it. What is not
        finite, of the wrong shape or contradictory counts as no wish. Nothing is raised.
        """
        self._steps += 1
        command = self._commands.understand(tip_velocity, joint_velocity, pitch_rate)
        before = self._q
        try:
            return self._moved(command)
        except Exception as error:  # noqa: BLE001  braking was proven before; what went wrong does not matter to it
            self.last_error = error.with_traceback(None)
            return self._braked(command, moved=self._q is not before)

    def _moved(self, command: Command) -> ServoState:
        for obstacle in self._site.due(self.time):
            self._add(obstacle)
        if self._site.anything_moves:
            self._site.drift(self.dt)
            self._bounds.drift()
        self._tip.place(self._q)
        near = self._bounds.near(self._at)
        wished = self._tip.wished(self._q, self._commands, near)
        self._task, self._beside = wished.task, wished.beside
        self._pace = min(self._bounds.pace(near), self._pace_of_sectors())
        wish = wished.v if self._pace == 1.0 else self._pace * wished.v
        low, high, at_limit = self._joints.within(self._q, self._v, wish)
        self._asked = self._joints.towards(wish, self._v)
        chosen = self._choose(wish, low, high, near)
        self._bounds.renew(near, self._at, self._steps)
        self._advance(chosen.v, chosen.end)
        return self._state(command, chosen, wish, wished, near, at_limit)

    def _braked(self, command: Command, *, moved: bool) -> ServoState:
        """The way out where something failed: brake, unless the step was taken already."""
        if not moved:
            self._advance(self._joints.brake(self._v), None)
        pair, margin = self._bounds.tightest_of_all()
        near = margin < self._tip.law.influence
        tip = self._tip.jacobian[:3] @ self._v
        wish = _ZERO if self._commands.tip is None else self._commands.tip
        return ServoState(
            time=self.time,
            q=self.q,
            v=self.v,
            status=Status.STOPPED,
            command=command,
            margin=margin if near else math.inf,
            link=self._separation.link(pair) if near else None,
            obstacle=self._site.name_of(pair) if near else None,
            tip_position=self._tip.position,
            tip_velocity=tip,
            refused=wish - tip,
            feedback_force=self._feedback.next(wish, _ZERO, _ZERO, 0.0),
            proven=False,
        )

    def _pace_of_sectors(self) -> float:
        """Part of the wished speed that the swing sectors leave."""
        swing = float(self._q[0])
        return min((pace(min(swing - low, high - swing), room) for low, high, room in self._sectors), default=1.0)

    # --- what is safe --------------------------------------------------------------------

    def _choose(self, wish: Vector, low: Vector, high: Vector, near: Near) -> _Chosen:
        """The velocity nearest to the wish whose braking path is proven clear."""
        if len(self._bounds.inside) or self._recovery.held_outside(self._q):
            return self._choose_back(wish, low, high, near)
        v = self._within_limits(wish, low, high)
        awake, budget = self._awake()
        evasion = self._evasion_rows(near, low, high)
        held_back = evading = False
        tried = v
        straight: tuple[BrakingPath, Proof] | None = None
        for attempt in range(_ATTEMPTS):
            late = not evasion.are_kept_by(v, TOLERANCE)
            path = self._path(v)
            proof = self._prove(awake, path)
            if (proof.free if attempt == 0 else proof.clear) and not late:
                return self._accepted(path, held_back, evading, awake, proof)
            if attempt == 0 and proof.clear and not late:
                straight = path, proof
            if attempt == _ATTEMPTS - 1:
                tried = v
                if proof.stands_clear:
                    return self._accepted(path, True, evading, awake, proof)
                break
            solved = self._within_rows(wish, low, high, (self._braking_rows(awake, budget, path, proof), evasion))
            evading |= late
            held_back = True
            if np.abs(solved - v).max() < 1e-12:
                if proof.stands_clear:
                    return self._accepted(path, True, evading, awake, proof)
                tried = v
                break
            v = solved
        if straight is not None:  # only the buffer is missing, and asking for it leads nowhere
            return self._accepted(straight[0], True, evading, awake, straight[1])
        brake = self._braking()
        for part in _BLENDS:
            v = np.minimum(np.maximum(brake + part * (tried - brake), low), high)
            path = self._path(v)
            proof = self._prove(awake, path)
            if proof.stands_clear:
                return self._accepted(path, True, evading, awake, proof)
        return _Chosen(self._joints.brake(self._v), True, evading, None)

    def _braking(self) -> Vector:
        """(n,) braking, where that stays within what a step can change."""
        change = self._joints.change
        return np.minimum(np.maximum(self._joints.brake(self._v), self._v - change), self._v + change)

    def _within_limits(self, wish: Vector, low: Vector, high: Vector) -> Vector:
        """(n,) the next velocity on the way to the wish, or to what the joints' limits leave of it."""
        target = self._asked
        joints = zip(target.tolist(), low.tolist(), high.tolist(), strict=True)
        if all(least <= rate <= most for rate, least, most in joints):
            return target
        if self._commands.tip is None:
            return np.minimum(np.maximum(target, low), high)
        # the other joints alone would lead the tip elsewhere
        self._beside = np.zeros(len(target))
        target = self._joints.towards(self._steady(wish, ()), self._v)
        v = np.minimum(np.maximum(target, low), high)
        return self._solve(target, low, high, ()) if np.count_nonzero(v != target) else v

    def _within_rows(self, wish: Vector, low: Vector, high: Vector, rows: tuple[Rows, ...]) -> Vector:
        """(n,) the next velocity on the way to what rows and limits leave of the wish.

        What would be left in the end is asked for first: from step to step alone, each
        within the joints' accelerations, the nearest need not lead there.
        """
        target = self._joints.towards(self._steady(wish, rows), self._v)
        v = np.minimum(np.maximum(target, low), high)
        kept = not np.count_nonzero(v != target) and all(block.are_kept_by(v) for block in rows)
        return v if kept else self._solve(target, low, high, rows)

    def _steady(self, wish: Vector, rows: tuple[Rows, ...]) -> Vector:
        """(n,) what rows and limits leave of the wish in the end, however long it takes to get there."""
        found = self._solve(wish, self._joints.least, self._joints.most, rows)
        less = found / self._joints.over_rates(self._q, found)
        return less if all(block.are_kept_by(less, TOLERANCE) for block in rows) else found

    def _path(self, v: Vector, *, step: bool = True) -> BrakingPath:
        return BrakingPath(
            self._q,
            v,
            self.dt if step else 0.0,
            acceleration=self._joints.braking,
            furthest=self._separation.furthest,
            turning=self._separation.turning,
        )

    def _awake(self) -> tuple[Indices, Vector]:
        """Pairs that could come into question this step; and by how much the path may change (C,) [m]."""
        look, later = self._joints.look, self.dt / BRAKING
        now = zip(self._q.tolist(), self._v.tolist(), self._end.tolist(), self._joints.changes, strict=True)
        # the end moves with the step taken, and with the change of velocity
        change = [
            abs(position + rate * look - end) + look * change + abs(rate) * later for position, rate, end, change in now
        ]
        return self._bounds.awake(np.array(change))

    def _prove(self, awake: Indices, path: BrakingPath) -> Proof:
        separation = self._separation
        if len(awake) == 0:
            return Proof(True, True, True, np.zeros(0), np.zeros((0, 0, 0)), np.zeros(0, dtype=bool))
        path.place(self._at)
        required, stands = self._bounds.required[awake], self._bounds.stands
        drift_time = path.time if self._site.anything_moves else 0.0
        bound, gaps = separation.least_on(awake, path, self._at, drift_time)
        closely = np.zeros(len(awake), dtype=bool)
        if (bound - required).min() >= BUFFER:
            return Proof(True, True, True, bound, gaps, closely)
        short = (bound < required - TOLERANCE).nonzero()[0]
        if len(short):
            # first with a plane measured where it is tightest, then with several
            for row in short[:_LOOKS].tolist():
                separation.renew(int(awake[row]), self._at, int(gaps[:, row].min(axis=1).argmin()))
            again = short[:_LOOKS]
            better, gaps[:, again] = separation.least_on(awake[again], path, self._at, drift_time)
            bound[again] = np.maximum(bound[again], better)
            for row in again[better < required[again] - TOLERANCE].tolist():
                pair = int(awake[row])
                found = separation.closer_look(pair, path, self._at, 0.0 if stands[pair] else drift_time)
                bound[row] = max(bound[row], found)
                closely[row] = True
            if closely.any():
                gaps[:, closely] = separation.gaps(awake[closely], self._at, path.parts + 1)
            self._bounds.renew_soon(awake[again])
            short = (bound < required - TOLERANCE).nonzero()[0]
        stands_clear = not stands[awake[short]].any()
        free = len(short) == 0 and bool((bound >= required + BUFFER).all())
        return Proof(free, len(short) == 0, stands_clear, bound, gaps, closely)

    def _braking_rows(self, awake: Indices, budget: Vector, path: BrakingPath, proof: Proof) -> Rows:
        """The rows of what could bind along the path [m/s]."""
        separation = self._separation
        n = self.robot.n
        if len(awake) == 0:
            return Rows("braking", np.zeros((0, n)), np.zeros(0))
        classes = separation.classes[awake]
        required = self._bounds.required[awake]
        wanted = required + BUFFER
        room = proof.gaps - (path.off_chord(separation.travel[classes]) + wanted)[None, :, None]
        counts = room < (2.0 * budget[classes])[None, :, None]
        counts[0] = False
        # seen closely, only where the plane that was kept is right: at its tightest
        settled = proof.closely & (proof.bound >= wanted + 2.0 * budget[classes])
        if settled.any():
            counts[:, settled] = False
        for row in (proof.closely & ~settled).nonzero()[0].tolist():
            tight = int(proof.gaps[1:, row].min(axis=1).argmax()) + 1
            only = counts[tight, row].copy()
            counts[:, row] = False
            counts[tight, row] = only
        samples, k, corners = np.nonzero(counts)
        if len(k) == 0:
            return Rows("braking", np.zeros((0, n)), np.zeros(0))
        if len(k) > _MOST_ROWS:
            tightest = np.argpartition(room[samples, k, corners], _MOST_ROWS)[:_MOST_ROWS]
            samples, k, corners = samples[tightest], k[tightest], corners[tightest]
        part = samples / path.parts
        rows = separation.rows(awake[k], samples, corners, self._at) @ path.D / path.look
        bounds = room[samples, k, corners] / (part * path.look) + rows @ path.v
        # never ask for more of a way back than the start itself is short of
        short = np.maximum(wanted[k] - proof.gaps[0, k, corners], 0.0)
        return Rows("braking", rows, np.maximum(bounds, -2.0 * short))

    def _choose_back(self, wish: Vector, low: Vector, high: Vector, near: Near) -> _Chosen:
        """The velocity of the way back, with what was proven of it held from now on."""
        bounds, clearance = self._bounds, self._separation.clearance
        pairs = bounds.inside
        low, high = self._recovery.slowed(self._q, self._v, low, high)
        awake, budget = self._awake()
        step = Step(
            q=self._q, v=self._v, low=low, high=high, target=np.minimum(np.maximum(self._asked, low), high),
            brake=self._braking(),
            evasion=self._evasion_rows(near, low, high), path=self._path,
            prove=lambda path: self._prove(awake, path),
            rows=lambda path, proof: self._braking_rows(awake, budget, path, proof),
        )  # fmt: skip
        depth, way = self._recovery.choose(pairs, bounds.stands, step)
        bounds.is_at(pairs, clearance[pairs] - depth)
        if way is None:
            return _Chosen(self._joints.brake(self._v), True, False, None)
        bounds.required[pairs] = clearance[pairs] - np.maximum(way.level, 0.0)
        out, bound = self._recovery.out(pairs, way)
        bounds.is_proven(out, bound)
        if len(out):  # held to its clearance again
            bounds.inside = pairs[~np.isin(pairs, out)]
        return self._accepted(way.path, True, False, awake, way.proof)

    def _evasion_rows(self, near: Near, low: Vector, high: Vector) -> Rows:
        """The rows of obstacles that come nearer and of what is too close already."""
        separation = self._separation
        n = self.robot.n
        if len(near.pairs) == 0:
            return Rows("evasion", np.zeros((0, n)), np.zeros(0))
        clearance = separation.clearance[near.pairs]
        too_close = np.maximum(near.distance, self._bounds.required[near.pairs]) < clearance - _VIOLATED
        too_close &= ~self._bounds.stands[near.pairs]
        drift = separation.drift[near.pairs]
        chosen = ((drift < 0.0) | too_close).nonzero()[0]
        if len(chosen) == 0:
            return Rows("evasion", np.zeros((0, n)), np.zeros(0))
        own = near.gaps[chosen]
        if len(chosen) > _MOST_ROWS:
            chosen = chosen[np.argpartition(own.min(axis=1), _MOST_ROWS)[:_MOST_ROWS]]
            own = near.gaps[chosen]
        k, corners = np.nonzero(own < np.maximum(own.min(axis=1), clearance[chosen])[:, None] + 0.02)
        pairs = near.pairs[chosen[k]]
        rows = separation.rows(pairs, 0, corners, self._at)
        comes = drift[chosen[k]]
        moves = comes < 0.0
        margin = own[k, corners] - clearance[chosen[k]] - np.where(moves, 2.0 * BUFFER, 0.0)
        authority = 0.5 * np.abs(rows) @ self.limits.acceleration
        allowed = np.sqrt(2.0 * authority * np.maximum(margin, 0.0))
        back = -np.minimum(np.maximum(-RECOVERY * margin, SLOWEST_RECOVERY), FASTEST_RECOVERY)
        bounds = np.where(margin >= 0.0, np.where(moves, allowed, np.inf), back) + np.minimum(comes, 0.0)
        could = np.maximum(rows * low, rows * high).sum(axis=1) > bounds
        return Rows("evasion", rows[could], bounds[could])

    def _solve(self, target: Vector, low: Vector, high: Vector, rows: tuple[Rows, ...]) -> Vector:
        """The velocity nearest to the target within rows and bounds, as the tip notices it."""
        if self._task is not None:
            # what the target does for the tip is asked of the tip alone: that of each joint
            # would drive the others on where one cannot follow
            serves = self._task.T @ self._task
            H = _FREE * np.eye(len(target)) + serves
            f = -(serves @ target) - _FREE * self._beside
        else:
            H, f = np.eye(len(target)), -target
        solution = solve_program(QuadraticProgram(H, f, low, high, rows))
        x = self._joints.brake(self._v) if solution is None else solution.x
        return np.minimum(np.maximum(x, low), high)

    def _accepted(self, path: BrakingPath, held_back: bool, evading: bool, awake: Indices, proof: Proof) -> _Chosen:
        self._bounds.accept(awake, proof)
        return _Chosen(path.v, held_back, evading, path.end)

    def _advance(self, v: Vector, end: Vector | None) -> None:
        """Take the step."""
        moved = v * self.dt
        self._bounds.advance(moved, None if end is None else end - self._end)
        self._q = self._q + moved
        self._v = v
        # without an end, what is left of the path that was proven before
        self._end = self._path(v, step=False).end if end is None else end

    # --- what is said ----------------------------------------------------------------------

    def _state(
        self, command: Command, chosen: _Chosen, wish: Vector, wished: Wished, near: Near, at_limit: bool
    ) -> ServoState:
        J = self._tip.jacobian[:3]
        rates, aims = self._v.tolist(), wish.tolist()
        pair, margin = self._bounds.tightest(near)
        link, obstacle, normal = None, None, _ZERO
        if margin < self._tip.law.influence:
            link, obstacle = self._separation.link(pair), self._site.name_of(pair)
            if margin < _WARN:
                normal = self._separation.world_normals(np.array([pair]), self._at)[0]
        else:
            margin = math.inf
        self._held_back_for = self._holds if chosen.held_back else self._held_back_for - 1
        # a joint that was let go its way has caught up with what it would have done
        joints = zip(self._free_v, aims, rates, self._asked.tolist(), self._joints.changes, strict=True)
        self._free_v = [
            free
            + (min(max(aim - free, -most), most) if abs(rate - asked) > _AS_ASKED else self._forgets * (rate - free))
            for free, aim, rate, asked, most in joints
        ]
        held = [free - rate - aim for free, rate, aim in zip(self._free_v, rates, aims, strict=True)]
        tip_velocity, refused = J @ self._v, J @ held + wished.tip
        self._tip.blocking = normal if chosen.held_back else _ZERO
        nearness = 0.5 * (1.0 + math.cos(math.pi * min(max(margin / _WARN, 0.0), 1.0)))
        hand = wished.tip if self._commands.tip is None else self._commands.tip
        force = self._feedback.next(hand, refused, normal, nearness)
        moving = max(map(abs, rates)) > _AT_REST
        wishes = max(map(abs, aims)) > 1e-6
        if chosen.evading:
            status = Status.EVADING
        elif not moving and (wishes or command in (Command.TIMED_OUT, Command.INVALID)):
            status = Status.STOPPED
        elif self._held_back_for > 0 and wishes:
            status = Status.SLIDING if moving else Status.STOPPED
        elif margin < _WARN:
            status = Status.NEAR_OBSTACLE
        elif at_limit:
            status = Status.NEAR_LIMIT
        elif wished.singular:
            status = Status.NEAR_SINGULARITY
        else:
            status = Status.OK
        return ServoState(
            time=self.time,
            q=self.q,
            v=self.v,
            status=status,
            command=command,
            margin=margin,
            link=link,
            obstacle=obstacle,
            tip_position=self._tip.position,
            tip_velocity=tip_velocity,
            refused=refused,
            feedback_force=force,
            proven=chosen.proven,
            pace=self._pace,
        )


_ZERO = np.zeros(3)
_ZERO.setflags(write=False)


def _start(robot: Robot, scene: scene_file.Scene) -> Vector:
    if scene.start is None:
        raise InputError("the scene does not say where the machine stands", key="start", allowed="start, or q=")
    if scene.start.tip is not None:
        pose = scene.start.tip
        found = solve_inverse_kinematics(
            robot, TipTarget(position=np.array(pose.position), pitch=pose.pitch_range, rotation=pose.rotation)
        )
        if not found.reached:
            raise InputError("the machine cannot stand there", key="start.tip", found=pose.position)
        return found.q
    joints: Mapping[str, float] = scene.start.joints or {}
    missing = [name for name in robot.joint_names if name not in joints]
    if missing:
        raise InputError(f"joints are missing: {', '.join(missing)}", key="start.joints")
    return robot.check_q([joints[name] for name in robot.joint_names], what="start.joints")
