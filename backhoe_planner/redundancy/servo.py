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
what was proven of it is what the next step must keep (`recovery`). Only where no motion of
the joints makes it smaller, the machine is pinched and stays as deep as it is.

Within the slow distance of one of the scene's zones the wish is scaled down, direction kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError
from backhoe_planner.machine.inverse_kinematics import solve_inverse_kinematics
from backhoe_planner.machine.kinematics import Configuration, Kinematics
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.target import TipTarget, movable_rows
from backhoe_planner.redundancy.braking_path import MOST_PARTS, BrakingPath, Placements
from backhoe_planner.redundancy.completed import CompletedLaw
from backhoe_planner.redundancy.feedback import Feedback
from backhoe_planner.redundancy.recovery import way_back
from backhoe_planner.redundancy.separation import Separation
from backhoe_planner.redundancy.servo_state import Command, ServoState, Status
from backhoe_planner.redundancy.surroundings import Surroundings
from backhoe_planner.site import scene as schema
from backhoe_planner.site.limits import scaled_limits, within_sectors
from backhoe_planner.site.obstacles import Obstacle, build_obstacles
from backhoe_planner.site.proximity import Nearby
from backhoe_planner.site.zones import pace

__all__ = ["Servo"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]

_BRAKING = 0.8  # part of the acceleration that braking is planned with; the rest corrects
_BUFFER = 0.002  # m kept on top of every clearance, for what the linear rows leave out
_ATTEMPTS = 3
_BLENDS = (0.5, 0.2)
_LOOKS = 12  # pairs that are looked at closely per step at most
_RECOVERY = 1.0  # 1/s
_SLOWEST_RECOVERY, _FASTEST_RECOVERY = 0.02, 0.25  # m/s or rad/s
_HOLDS = 2.0  # 1/s: how soon what is not the deepest is taken hold of
_SOFT, _HARD = 8, 0  # daqp's senses
_UNBOUNDED = -1e30
_FREE = 0.005  # weight of the null space beside the tip
_TOLERANCE = 1e-9  # m
_VIOLATED = 1e-7  # m
_INFLUENCE = 0.3  # m: further away the null space need not care
_REMEMBERED = 0.02  # s for which being held back counts
_FAR_RENEWED_EVERY = 4  # steps, where nothing is within
_NEAR_RENEWED_EVERY = 2  # and where something is near
_WARN = 0.10  # m of margin within which it says so
_AT_REST = 1e-3  # rad/s or m/s: what creeps more slowly is told as standing
_FAR = 1e3  # m
_INSIDE_SPEED = 0.5  # m/s
_STEP_END = MOST_PARTS + 1  # row of the placements
_FALLS = 1e-8  # m: by so much at least the deepest violation falls in a step
_FASTEST_WISH = 100.0  # m/s or rad/s


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
    dt: length of a step [s].
    q: (n,) where the joints stand; by default the scene's start.
    watchdog: without a command for this long the machine stops [s].
    circulate: whether a tip that is pushed straight into an obstacle goes round it.
    self_collision: whether the machine is also kept clear of itself.

    Raises
    ------
    InputError, SceneError, RobotError: the scene does not fit the machine, there is no
        start, or dt is not positive.

    `step` itself raises nothing. The servo owns its working memory: do not share one
    between threads.
    """

    def __init__(
        self,
        robot: Robot,
        scene: schema.Scene,
        dt: float = 0.001,
        *,
        q: object = None,
        watchdog: float = 0.2,
        circulate: bool = False,
        self_collision: bool = True,
        feedback: Feedback | None = None,
    ) -> None:
        if not (dt > 0.0 and math.isfinite(dt)):
            raise InputError("is the length of a step", key="dt", found=dt, allowed="a positive number of seconds")
        robot = within_sectors(robot.with_tip(scene.tip), scene)
        self.robot, self.scene, self.dt = robot, scene, float(dt)
        self.limits = scaled_limits(robot, scene)
        self.watchdog, self.circulate = watchdog, circulate
        self._q = _start(robot, scene) if q is None else robot.check_q(q)
        n = robot.n
        self._v = np.zeros(n)
        self._free_v = [0.0] * n
        self._end = self._q.copy()
        self._steps = 0
        self._acceleration = _BRAKING * self.limits.acceleration
        self._change = self.limits.acceleration * self.dt * (1.0 - 1e-9)
        self._holds = max(math.ceil(_REMEMBERED / self.dt), 1)
        self._held_back_for = 0
        # the joint rates from which braking ends within the limits, however soon they can be had
        self._least, self._most = -self.limits.velocity, self.limits.velocity
        self._look = self.dt  # s: of the longest braking path that this step could begin
        self._forgets = 1.0 - math.exp(-self.dt / _REMEMBERED)
        self._changes: list[float] = self._change.tolist()
        self._braking: list[float] = self._acceleration.tolist()
        self._per_acceleration: list[float] = (1.0 / self._acceleration).tolist()
        limits = self.limits
        self._ranges = list(zip(limits.lower.tolist(), limits.upper.tolist(), limits.velocity.tolist(), strict=True))
        self._law = CompletedLaw(robot, influence=min(scene.influence, _INFLUENCE))
        self._feedback = Feedback(self.dt) if feedback is None else feedback
        self._at = Placements(robot, MOST_PARTS + 2)
        frame = robot.model.frames[robot.tip_frame]
        self._tip_joint = int(frame.parentJoint)
        self._tip_t = np.array(frame.placement.translation)
        self._jacobian = np.zeros((6, n))
        # of the last wish: the task's Jacobian, and the part of it in the null space
        self._task, self._beside = self._jacobian[:3], np.zeros(n)
        self._to_tip = np.eye(6)  # takes a twist at the world's origin to the tip
        self._separation = Separation(robot, self_collision=self_collision)
        count = len(self._separation)
        # of every pair: the distance proven over the braking path, and at its start, each
        # with the odometer at that moment; what must be kept; when its plane was measured
        self._proven, self._proven_at = np.full(count, -_FAR), np.zeros(count)
        self._distance, self._distance_at = np.full(count, -_FAR), np.zeros(count)
        self._required = self._separation.clearance.copy()
        self._renewed_at = np.zeros(count, dtype=np.int64)
        self._inside: Indices = np.zeros(0, dtype=np.intp)  # pairs of what stands that are not clear yet
        # how far beyond its clearance a pair is looked at; and slows the machine down
        self._reach, self._slow_from = np.full(count, self._law.influence), np.zeros(count)
        self._sectors = [
            (zone.start + zone.stop, zone.end - zone.stop, zone.slow_distance - zone.stop)
            for zone in scene.zones
            if isinstance(zone, schema.SwingSector) and zone.slow_distance > zone.stop
        ]
        self._pace = 1.0
        classes = len(self._separation.travel)
        self._path_odometer, self._start_odometer = np.zeros(classes), np.zeros(classes)
        # no point moves faster than this by one joint while the machine is inside something
        self._slow = np.array([_INSIDE_SPEED / max(radius, 0.1) for radius in self._separation.furthest])
        self._site = Surroundings(robot, scene, self._separation)
        self._renewed_bounds: tuple[Indices, Vector, Indices] | None = None
        self._sort()
        self._wish: tuple[Vector | None, Vector | None, float | None] = (None, None, None)
        self._since_command = math.inf
        self._blocking = np.zeros(3)
        self._task_rows: NDArray[np.bool_] = np.ones(3, dtype=bool)
        self._sense = np.zeros(3)
        self._place_start()
        self._task_rows = self._movable_tip_rows()
        self._all_rows = bool(self._task_rows.all())
        self._take_in(np.arange(count, dtype=np.intp))
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
    def time(self) -> float:
        """[s] since the servo began."""
        return self._steps * self.dt

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Names of what stands around now."""
        return self._site.names

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
        InputError: the points are not (k, 3) finite numbers, or resolution is not positive.
        """
        scan = self._site.scanned(name, points, resolution=resolution, clearance=clearance)
        if name in self.obstacles:
            self.remove(name)
        if scan is not None:
            self._add(scan)

    def remove(self, name: str) -> None:
        """Take an obstacle away.

        Raises
        ------
        InputError: there is none of that name.
        """
        kept = self._site.take_away(name)
        for array in _PER_PAIR:
            setattr(self, array, getattr(self, array)[kept])
        self._sort()
        self._find_inside()

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
        count = len(pairs)
        far, none = np.full(count, -_FAR), np.zeros(count)
        self._proven, self._proven_at = np.append(self._proven, far), np.append(self._proven_at, none)
        self._distance, self._distance_at = np.append(self._distance, far), np.append(self._distance_at, none)
        self._required = np.append(self._required, self._separation.clearance[pairs])
        self._renewed_at = np.append(self._renewed_at, np.zeros(count, dtype=np.int64))
        self._slow_from = np.append(self._slow_from, np.full(count, obstacle.slow))
        self._reach = np.append(self._reach, np.full(count, max(obstacle.slow, self._law.influence)))
        self._sort()
        self._take_in(pairs)

    def _sort(self) -> None:
        site = self._site
        self._moving_pairs, self._stands = site.moving_pairs, site.stands
        self._within = self._separation.clearance + self._reach
        self._some_slow = bool(self._slow_from.any())
        self._per_step = self.dt * site.speed
        # the braking path of one step later may end up to 2 / _BRAKING steps later
        self._per_step_on_path = (1.0 + 2.0 / _BRAKING) * self._per_step

    def _take_in(self, pairs: Indices) -> None:
        """Measure pairs that are new or were moved, and note what the braking path leaves of them."""
        if len(pairs) == 0:
            return
        separation = self._separation
        self._place_start()
        path = self._path(self._v, step=False)
        path.place(self._at)
        for pair in pairs.tolist():
            self._distance[pair] = separation.renew(pair, self._at, 0)
        self._renewed_at[pairs] = self._steps
        self._distance_at[pairs] = self._start_odometer[separation.classes[pairs]]
        bound, _ = separation.least_on(pairs, path, self._at, path.time)
        for row in (bound < separation.clearance[pairs]).nonzero()[0].tolist():
            bound[row] = max(bound[row], separation.closer_look(int(pairs[row]), path, self._at, path.time))
        self._proven[pairs] = bound
        self._proven_at[pairs] = self._path_odometer[separation.classes[pairs]]
        self._required[pairs] = np.minimum(separation.clearance[pairs], bound)
        self._find_inside()

    def _find_inside(self) -> None:
        """Pairs of what stands that are closer than allowed."""
        short = self._required < self._separation.clearance - _TOLERANCE
        self._inside = (self._stands & short).nonzero()[0]

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
        command = self._understand(tip_velocity, joint_velocity, pitch_rate)
        before = self._q
        try:
            return self._moved(command)
        except Exception:  # noqa: BLE001  braking was proven before; what went wrong does not matter to it
            return self._braked(command, moved=self._q is not before)

    def _understand(self, tip_velocity: object, joint_velocity: object, pitch_rate: object) -> Command:
        if tip_velocity is None and joint_velocity is None and pitch_rate is None:
            found = Command.HELD
        else:
            tip = None if tip_velocity is None else _numbers(tip_velocity, 3)
            joints = None if joint_velocity is None else _numbers(joint_velocity, self.robot.n)
            pitch = None if pitch_rate is None else _numbers(pitch_rate, 1)
            understood = (
                (tip is not None) != (joints is not None)
                and (tip_velocity is None or tip is not None)
                and (joint_velocity is None or joints is not None)
                and (pitch_rate is None or (pitch is not None and tip is not None and self.robot.has_pitch))
            )
            if understood:
                tip, joints = _capped(tip), _capped(joints)
                self._wish = (tip, joints, None if pitch is None else float(pitch[0]))
                self._since_command = 0.0
                return Command.NEW
            found = Command.INVALID
        self._since_command += self.dt
        if self._since_command > self.watchdog:
            self._wish = (None, None, None)
            return Command.TIMED_OUT if found is Command.HELD else found
        return found

    def _moved(self, command: Command) -> ServoState:
        self._appear()
        self._drift()
        self._place_start()
        near, gaps = self._near()
        wish, tip_wish, singular = self._wished(near, gaps)
        self._pace = self._slowed(near)
        if self._pace < 1.0:
            wish = self._pace * wish
        low, high, at_limit = self._velocity_bounds(wish)
        chosen = self._choose(wish, low, high, near, gaps)
        self._renew(near)
        self._advance(chosen.v, chosen.end)
        return self._state(command, chosen, wish, tip_wish, near, at_limit, singular)

    def _braked(self, command: Command, *, moved: bool) -> ServoState:
        """The way out where something failed: brake, unless the step was taken already."""
        if not moved:
            self._advance(self._brake(), None)
        tip = self._jacobian[:3] @ self._v
        wish = _ZERO if self._wish[0] is None else self._wish[0]
        return ServoState(
            time=self.time,
            q=self.q,
            v=self.v,
            status=Status.STOPPED,
            command=command,
            margin=math.inf,
            link=None,
            obstacle=None,
            tip_position=self._tip.copy(),
            tip_velocity=tip,
            refused=wish - tip,
            feedback_force=self._feedback.next(wish, _ZERO, _ZERO, 0.0),
            proven=False,
        )

    def _appear(self) -> None:
        for obstacle in self._site.due(self.time):
            self._add(obstacle)

    def _drift(self) -> None:
        """Let the obstacles move on, and what is known of them with them."""
        if len(self._moving_pairs) == 0:
            return
        self._site.drift(self.dt)
        self._distance -= self._per_step
        self._proven -= self._per_step_on_path

    def _place_start(self) -> None:
        """Forward kinematics at q, and the tip's Jacobian."""
        at = self._at
        at.place(0, self._q)
        R, t, J = at.R[0, self._tip_joint], at.t[0, self._tip_joint], at.J[0]
        tip = R @ self._tip_t + t
        self._tip = tip
        x, y, z = tip.tolist()
        to = self._to_tip  # its upper right part is omega -> omega x tip
        to[0, 4], to[0, 5], to[1, 3], to[1, 5], to[2, 3], to[2, 4] = z, -y, -z, x, y, -x
        np.matmul(to, J, out=self._jacobian)

    def _movable_tip_rows(self) -> NDArray[np.bool_]:
        """(3,) which directions any joint can move the tip in at all."""
        rng, kinematics = np.random.default_rng(0), Kinematics(self.robot)
        found = [movable_rows(kinematics.at(self.robot.random_q(rng)).jacobian[:3]) for _ in range(8)]
        return np.asarray(np.any(found, axis=0))

    # --- what is wished ------------------------------------------------------------------

    def _near(self) -> tuple[Indices, Matrix]:
        """Pairs within the influence distance, and the gaps of their corners (K, V) at q."""
        separation = self._separation
        odometer = self._start_odometer.take(separation.classes)
        lower = self._distance + self._distance_at - odometer
        near = (lower < self._within).nonzero()[0]
        if len(near) == 0:
            return near, np.zeros((0, 1))
        gaps = separation.gaps(near, self._at, 1)[0]
        self._distance[near] = np.maximum(gaps.min(axis=1), lower.take(near))
        self._distance_at[near] = odometer.take(near)
        return near, gaps

    def _slowed(self, near: Indices) -> float:
        """Part of the wished speed that the zones leave."""
        part = 1.0
        rows = self._slow_from[near].nonzero()[0] if self._some_slow else _NOBODY.pair
        if len(rows):
            slow = self._slow_from[near]
            margin = self._distance[near[rows]] - self._separation.clearance[near[rows]]
            part = min(pace(left, room) for left, room in zip(margin.tolist(), slow[rows].tolist(), strict=True))
        swing = float(self._q[0])
        for low, high, room in self._sectors:
            part = min(part, pace(min(swing - low, high - swing), room))
        return part

    def _nearby(self, near: Indices, gaps: Matrix) -> Nearby:
        """The same as the law wants it: one row each, of the nearest corner."""
        separation = self._separation
        margin = self._distance[near] - separation.clearance[near]
        acts = (margin < self._law.influence).nonzero()[0]
        if len(acts) == 0:
            return _NOBODY
        pairs = near[acts]
        rows = separation.rows(pairs, 0, gaps[acts].argmin(axis=1), self._at)
        drift = separation.drift[pairs]
        return Nearby(
            pair=pairs,
            distance=self._distance[pairs],
            margin=margin[acts],
            normal=_NOTHING,
            point_link=_NOTHING,
            point_obstacle=_NOTHING,
            gradient=-rows,
            drift=drift,
            moves=_NONE,
        )

    def _wished(self, near: Indices, gaps: Matrix) -> tuple[Vector, Vector, bool]:
        """(n,) joint velocity that is wished, within the joints' rates; the tip's; whether near a singularity."""
        tip, joints, pitch = self._wish
        if joints is not None:
            return joints / self._over_rates(joints), self._jacobian[:3] @ joints, False
        if tip is None:
            self._task, self._beside = self._jacobian[:3], np.zeros(self.robot.n)
            return np.zeros(self.robot.n), np.zeros(3), False
        J, xdot = self._jacobian[:3], self._around(tip)
        if not self._all_rows:
            J, xdot = J[self._task_rows], xdot[self._task_rows]
        if pitch is not None:
            turn = self._jacobian[3:]
            J = np.vstack((J, self.robot.pitch_sense * turn[:, -1] @ turn))
            xdot = np.append(xdot, pitch)
        nearby, damped = self._nearby(near, gaps), False
        quick = self._law.wish_with_one_spare(self._q, J, xdot, nearby)
        if quick is None:
            at = Configuration(self.robot, self._q, None, self._jacobian, self._at.J[0], _NOTHING)
            wish = self._law.wish(at, J, xdot, nearby)
            v, beside, damped = wish.v, wish.null, wish.resolved.damping > 0.0
        else:
            v, beside = quick
        over = self._over_rates(v)
        self._task, self._beside = J, beside / over
        return v / over, tip, damped

    def _over_rates(self, v: Vector) -> float:
        """By how much joint rates go beyond the limits, 1 where they do not."""
        ranges = self._ranges
        return max(1.0, max(abs(rate) / fastest for rate, (_, _, fastest) in zip(v.tolist(), ranges, strict=True)))

    def _around(self, tip: Vector) -> Vector:
        """The tip's wish, turned along the surface that blocks it where that is asked for."""
        if not self.circulate:
            return tip
        normal = self._blocking
        into = float(tip @ normal)
        if into <= 0.0:
            self._sense = np.zeros(3)
            return tip
        along = tip - into * normal
        size = math.sqrt(float(along @ along))
        if size > 0.2 * into:
            self._sense = along / size
        else:
            sense = self._sense - (self._sense @ normal) * normal
            if not sense.any():
                sense = _UP - normal[2] * normal
                if abs(normal[2]) > 0.9 or not self._task_rows[2]:
                    sense = np.array([-normal[1], normal[0], 0.0])
            self._sense = sense / max(math.sqrt(float(sense @ sense)), 1e-9)
        return np.asarray(tip + into * self._sense)

    # --- what is safe --------------------------------------------------------------------

    def _brake(self) -> Vector:
        """(n,) the next velocity while braking in proportion."""
        time = float((np.abs(self._v) / self._acceleration).max())
        return self._v * max(1.0 - self.dt / time, 0.0) if time > 0.0 else self._v

    def _velocity_bounds(self, wish: Vector) -> tuple[Vector, Vector, bool]:
        """(n,), (n,) the velocities from which braking in proportion ends within the joint limits.

        Also whether they cut the wish. Beyond a limit a joint must come back.
        """
        dt = self.dt
        time = max(abs(rate) * per for rate, per in zip(self._v.tolist(), self._per_acceleration, strict=True))
        look = self._look = dt + 0.5 * (time + dt / _BRAKING)
        lows, highs = [], []
        tight = cut = False
        rates = self._v.tolist()
        for position, rate, wished, change, (lower, upper, fastest) in zip(
            self._q.tolist(), rates, wish.tolist(), self._changes, self._ranges, strict=True
        ):
            above, below = upper - position, position - lower
            high, low = min(above / look, fastest), max(-below / look, -fastest)
            if above < -_TOLERANCE:
                high = -min(max(-_RECOVERY * above, _SLOWEST_RECOVERY), _FASTEST_RECOVERY)
                low = min(low, high)
            elif below < -_TOLERANCE:
                low = min(max(-_RECOVERY * below, _SLOWEST_RECOVERY), _FASTEST_RECOVERY)
                high = max(low, high)
            else:
                tight |= high < rate - change or low > rate + change
            cut |= wished > high + 1e-9 or wished < low - 1e-9
            highs.append(high)
            lows.append(low)
        if tight:
            # a joint needs the whole of its way to brake: the others must not make that longer
            caps = (self._acceleration * max(time - dt, 0.0)).tolist()
            highs = [min(high, cap) for high, cap in zip(highs, caps, strict=True)]
            lows = [max(low, -cap) for low, cap in zip(lows, caps, strict=True)]
        self._least, self._most = np.array(lows), np.array(highs)
        reach = [(rate - change, rate + change) for rate, change in zip(rates, self._changes, strict=True)]
        low_bounds = [min(max(low, down), up) for low, (down, up) in zip(lows, reach, strict=True)]
        high_bounds = [min(max(high, down), up) for high, (down, up) in zip(highs, reach, strict=True)]
        return np.array(low_bounds), np.array(high_bounds), cut

    def _choose(self, wish: Vector, low: Vector, high: Vector, near: Indices, gaps: Matrix) -> _Chosen:
        """The velocity nearest to the wish whose braking path is proven clear."""
        if len(self._inside):
            return self._choose_back(wish, low, high, near, gaps)
        v = self._within_limits(wish, low, high)
        awake, budget = self._awake()
        urgent_rows, urgent_bounds = self._urgent(near, gaps, low, high)
        held_back = evading = False
        tried = v
        for attempt in range(_ATTEMPTS):
            late = len(urgent_bounds) > 0 and bool((urgent_rows @ v > urgent_bounds + _TOLERANCE).any())
            path = self._path(v)
            proof = self._prove(awake, path)
            if (proof.free if attempt == 0 else proof.clear) and not late:
                return self._accepted(path, held_back, evading, awake, proof)
            if attempt == _ATTEMPTS - 1:
                tried = v
                if proof.stands_clear:
                    return self._accepted(path, True, evading, awake, proof)
                break
            rows, bounds = self._rows(awake, budget, path, proof)
            rows, bounds = np.vstack((rows, urgent_rows)), np.concatenate((bounds, urgent_bounds))
            solved = self._within_rows(wish, low, high, rows, bounds)
            evading |= late
            held_back = True
            if np.abs(solved - v).max() < 1e-12:
                if proof.stands_clear:
                    return self._accepted(path, True, evading, awake, proof)
                tried = v
                break
            v = solved
        brake = np.minimum(np.maximum(self._brake(), self._v - self._change), self._v + self._change)
        for part in _BLENDS:
            v = np.minimum(np.maximum(brake + part * (tried - brake), low), high)
            path = self._path(v)
            proof = self._prove(awake, path)
            if proof.stands_clear:
                return self._accepted(path, True, evading, awake, proof)
        return _Chosen(self._brake(), True, evading, None)

    def _within_limits(self, wish: Vector, low: Vector, high: Vector) -> Vector:
        """(n,) the next velocity on the way to the wish, or to what the joints' limits leave of it."""
        target = self._towards(wish)
        v = np.minimum(np.maximum(target, low), high)
        if self._wish[0] is None or not np.count_nonzero(v != target):
            return v
        # the other joints alone would lead the tip elsewhere
        none, nothing = np.zeros((0, len(v))), np.zeros(0)
        self._beside = np.zeros(len(v))
        target = self._towards(self._solve(wish, self._least, self._most, none, nothing))
        v = np.minimum(np.maximum(target, low), high)
        return self._solve(target, low, high, none, nothing) if np.count_nonzero(v != target) else v

    def _within_rows(self, wish: Vector, low: Vector, high: Vector, rows: Matrix, bounds: Vector) -> Vector:
        """(n,) the next velocity on the way to what rows and limits leave of the wish, row @ v <= bound.

        What would be left in the end is asked for first: from step to step alone, each
        within the joints' accelerations, the nearest need not lead there.
        """
        target = self._towards(self._solve(wish, self._least, self._most, rows, bounds))
        v = np.minimum(np.maximum(target, low), high)
        if np.count_nonzero(v != target) or np.count_nonzero(rows @ v > bounds):
            return self._solve(target, low, high, rows, bounds)
        return v

    def _towards(self, wish: Vector) -> Vector:
        """(n,) on the straight way from the present velocity to the wish, as far as acceleration allows."""
        rates = self._v.tolist()
        change = [wished - rate for wished, rate in zip(wish.tolist(), rates, strict=True)]
        part = 1.0
        for amount, largest in zip(change, self._changes, strict=True):
            if abs(amount) * part > largest:
                part = largest / abs(amount)
        return np.array([rate + part * amount for rate, amount in zip(rates, change, strict=True)])

    def _path(self, v: Vector, *, step: bool = True) -> BrakingPath:
        return BrakingPath(
            self._q,
            v,
            self.dt if step else 0.0,
            acceleration=self._braking,
            furthest=self._separation.furthest,
            turning=self._separation.turning,
        )

    def _awake(self) -> tuple[Indices, Vector]:
        """Pairs that could come into question this step; and by how much the path may change (C,) [m]."""
        separation = self._separation
        look = self._look
        # the end moves with the step taken, and with the change of velocity
        later = self.dt / _BRAKING
        now = zip(self._q.tolist(), self._v.tolist(), self._end.tolist(), self._changes, strict=True)
        budget = separation.travel @ np.array(
            [
                abs(position + rate * look - end) + look * change + abs(rate) * later
                for position, rate, end, change in now
            ]
        )
        # what is within the buffer is always looked at: else a wish would be held back every other step
        left = self._proven + self._proven_at - self._required - _BUFFER
        awake = left < (self._path_odometer + budget).take(separation.classes)
        if len(self._inside):  # these are looked at by themselves
            awake[self._inside] = False
        return awake.nonzero()[0], budget

    def _prove(self, awake: Indices, path: BrakingPath) -> _Proof:
        separation = self._separation
        if len(awake) == 0:
            return _Proof(True, True, True, np.zeros(0), np.zeros((0, 0, 0)), np.zeros(0, dtype=bool))
        path.place(self._at)
        required = self._required[awake]
        drift_time = path.time if len(self._moving_pairs) else 0.0
        bound, gaps = separation.least_on(awake, path, self._at, drift_time)
        closely = np.zeros(len(awake), dtype=bool)
        short = (bound < required - _TOLERANCE).nonzero()[0]
        if len(short):
            # first with a plane measured where it is tightest, then with several
            for row in short[:_LOOKS].tolist():
                separation.renew(int(awake[row]), self._at, int(gaps[:, row].min(axis=1).argmin()))
            again = short[:_LOOKS]
            better, gaps[:, again] = separation.least_on(awake[again], path, self._at, drift_time)
            bound[again] = np.maximum(bound[again], better)
            for row in again[better < required[again] - _TOLERANCE].tolist():
                pair = int(awake[row])
                found = separation.closer_look(pair, path, self._at, 0.0 if self._stands[pair] else drift_time)
                bound[row] = max(bound[row], found)
                closely[row] = True
            if closely.any():
                gaps[:, closely] = separation.gaps(awake[closely], self._at, path.parts + 1)
            self._renewed_at[awake[again]] = 0
            short = (bound < required - _TOLERANCE).nonzero()[0]
        stands_clear = not self._stands[awake[short]].any()
        free = len(short) == 0 and bool((bound >= required + _BUFFER).all())
        return _Proof(free, len(short) == 0, stands_clear, bound, gaps, closely)

    def _rows(self, awake: Indices, budget: Vector, path: BrakingPath, proof: _Proof) -> tuple[Matrix, Vector]:
        """Rows and bounds, row @ v <= bound, of what could bind along the path [m/s]."""
        separation = self._separation
        n = self.robot.n
        if len(awake) == 0:
            return np.zeros((0, n)), np.zeros(0)
        classes = separation.classes[awake]
        required = self._required[awake]
        wanted = required + _BUFFER
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
            return np.zeros((0, n)), np.zeros(0)
        part = samples / path.parts
        rows = separation.rows(awake[k], samples, corners, self._at) @ path.D / path.look
        bounds = room[samples, k, corners] / (part * path.look) + rows @ path.v
        # never ask for more of a way back than the start itself is short of
        short = np.maximum(wanted[k] - proof.gaps[0, k, corners], 0.0)
        return rows, np.maximum(bounds, -2.0 * short)

    def _choose_back(self, wish: Vector, low: Vector, high: Vector, near: Indices, gaps: Matrix) -> _Chosen:
        """The velocity by which the deepest violation falls fastest, measured to be falling where it leads.

        The violated pairs are measured where the step ends and along its braking path.
        Where the linear rows promised more than that, what was found there is one more
        row (a cutting plane), and the velocity is asked for anew.
        """
        pairs, at, separation = self._inside, self._at, self._separation
        owner = separation.owner[pairs]
        distance, rows = separation.gradients(pairs, at, 0)
        self._distance[pairs] = distance
        self._distance_at[pairs] = self._start_odometer[separation.classes[pairs]]
        depth = separation.clearance[pairs] - distance
        deepest = _by_owner(depth, owner)
        fastest = min(max(_RECOVERY * float(deepest.max()), _SLOWEST_RECOVERY), _FASTEST_RECOVERY)
        slack = _HOLDS * (deepest - depth)
        # slowly, so that little lies between what is measured of the braking path
        up, down = self._v + self._change, self._v - self._change
        low = np.minimum(np.maximum(np.maximum(low, -self._slow), down), up)
        high = np.minimum(np.maximum(np.minimum(high, self._slow), down), up)
        target = np.minimum(np.maximum(self._towards(wish), low), high)
        awake, budget = self._awake()
        soft_rows, soft_bounds = self._urgent(near, gaps, low, high)
        brake = np.minimum(np.maximum(self._brake(), self._v - self._change), self._v + self._change)
        tried = brake
        all_rows, all_slack = rows, slack
        for attempt in range(_ATTEMPTS + len(_BLENDS)):
            if attempt < _ATTEMPTS:
                found = way_back(
                    all_rows, all_slack, target=target, low=low, high=high,
                    fastest=fastest, soft_rows=soft_rows, soft_bounds=soft_bounds,
                )  # fmt: skip
                if found is None:
                    continue
                v = tried = found[0]
            else:
                v = brake + _BLENDS[attempt - _ATTEMPTS] * (tried - brake)
            path = self._path(v)
            if len(awake) == 0:
                path.place(at)
            proof = self._prove(awake, path)
            at.place(_STEP_END, self._q + v * self.dt)
            falls, before = True, deepest - _FALLS
            ends = [(_STEP_END, self.dt), *((part, path.look * part / path.parts) for part in range(1, path.parts + 1))]
            for sample, span in ends:
                there, cuts = separation.gradients(pairs, at, sample)
                deep = separation.clearance[pairs] - there
                now = _by_owner(deep, owner)
                worse = deep > np.maximum(before, 0.0)
                # still falling there, so that it falls all the way, braking too
                worse |= (deep > np.maximum(now - _FALLS, 0.0)) & (cuts @ v >= 0.0)
                if sample == _STEP_END:
                    level = now
                before = now
                if worse.any():
                    falls = False
                    more = slack[worse] + (there - distance)[worse] / span + cuts[worse] @ v
                    all_rows, all_slack = np.vstack((all_rows, cuts[worse])), np.append(all_slack, more)
                    break
            if falls and proof.stands_clear and (proof.clear or attempt == _ATTEMPTS - 1):
                self._required[pairs] = separation.clearance[pairs] - np.maximum(level, 0.0)
                self._let_out(path, level)
                return self._accepted(path, True, False, awake, proof)
            if not proof.clear:
                more_rows, bounds = self._rows(awake, budget, path, proof)
                # nothing may be asked for that the way back could not give
                soft_rows = np.vstack((soft_rows, more_rows))
                soft_bounds = np.append(soft_bounds, np.maximum(bounds, 0.0))
        return _Chosen(self._brake(), True, False, None)

    def _let_out(self, path: BrakingPath, level: Vector) -> None:
        """Hold what is out to its clearance again, once that is proven of the braking path."""
        separation = self._separation
        pairs = self._inside[level <= 0.0]
        if len(pairs) == 0:
            return
        bound, _ = separation.least_on(pairs, path, self._at, 0.0)
        for row in (bound < separation.clearance[pairs]).nonzero()[0].tolist():
            bound[row] = max(bound[row], separation.closer_look(int(pairs[row]), path, self._at, 0.0))
        out = bound >= separation.clearance[pairs]
        self._proven[pairs[out]] = bound[out]
        self._proven_at[pairs[out]] = self._path_odometer[separation.classes[pairs[out]]]
        self._inside = self._inside[~np.isin(self._inside, pairs[out])]

    def _urgent(self, near: Indices, gaps: Matrix, low: Vector, high: Vector) -> tuple[Matrix, Vector]:
        """Rows and bounds, row @ v <= bound, of obstacles that come nearer and of what is too close already."""
        separation = self._separation
        n = self.robot.n
        if len(near) == 0:
            return np.zeros((0, n)), np.zeros(0)
        clearance = separation.clearance[near]
        too_close = np.maximum(self._distance[near], self._required[near]) < clearance - _VIOLATED
        too_close &= ~self._stands[near]
        drift = separation.drift[near]
        chosen = ((drift < 0.0) | too_close).nonzero()[0]
        if len(chosen) == 0:
            return np.zeros((0, n)), np.zeros(0)
        own = gaps[chosen]
        k, corners = np.nonzero(own < np.maximum(own.min(axis=1), clearance[chosen])[:, None] + 0.02)
        pairs = near[chosen[k]]
        rows = separation.rows(pairs, 0, corners, self._at)
        comes = drift[chosen[k]]
        moves = comes < 0.0
        margin = own[k, corners] - clearance[chosen[k]] - np.where(moves, 2.0 * _BUFFER, 0.0)
        authority = 0.5 * np.abs(rows) @ self.limits.acceleration
        allowed = np.sqrt(2.0 * authority * np.maximum(margin, 0.0))
        back = -np.minimum(np.maximum(-_RECOVERY * margin, _SLOWEST_RECOVERY), _FASTEST_RECOVERY)
        bounds = np.where(margin >= 0.0, np.where(moves, allowed, np.inf), back) + np.minimum(comes, 0.0)
        could = np.maximum(rows * low, rows * high).sum(axis=1) > bounds
        return rows[could], bounds[could]

    def _solve(self, target: Vector, low: Vector, high: Vector, rows: Matrix, bounds: Vector) -> Vector:
        """The velocity nearest to the target within rows and bounds, as the tip notices it."""
        n, count = len(target), len(bounds)
        if self._wish[1] is None:
            # what the target does for the tip is asked of the tip alone: that of each joint
            # would drive the others on where one cannot follow
            J = self._task
            serves = J.T @ J
            H = _FREE * np.eye(n) + serves
            f = -(serves @ target) - _FREE * self._beside
        else:
            H = np.eye(n)
            f = -target
        sense = np.full(n + count, _SOFT, dtype=np.int32)
        sense[:n] = _HARD
        x, _, flag, _ = daqp.solve(
            H,
            f,
            np.ascontiguousarray(rows),
            np.concatenate((high, bounds)),
            np.concatenate((low, np.full(count, _UNBOUNDED))),
            sense,
        )
        if flag < 1 or not np.isfinite(x).all():
            x = self._brake()
        return np.asarray(np.minimum(np.maximum(x, low), high))

    def _accepted(self, path: BrakingPath, held_back: bool, evading: bool, awake: Indices, proof: _Proof) -> _Chosen:
        if len(awake):
            classes = self._separation.classes[awake]
            self._renewed_bounds = (awake, proof.bound, classes)
            stands = self._stands[awake]
            lowest = np.where(stands, np.maximum(self._required[awake], proof.bound), proof.bound)
            self._required[awake] = np.minimum(self._separation.clearance[awake], lowest)
        else:
            self._renewed_bounds = None
        return _Chosen(path.v, held_back, evading, path.end)

    def _advance(self, v: Vector, end: Vector | None) -> None:
        """Take the step."""
        separation = self._separation
        if end is not None:
            self._path_odometer += separation.travel @ np.abs(end - self._end)
            self._end = end
            if self._renewed_bounds is not None:
                awake, bound, classes = self._renewed_bounds
                self._proven[awake] = bound
                self._proven_at[awake] = self._path_odometer[classes]
        moved = v * self.dt
        self._moved_by = separation.travel @ np.abs(moved)
        self._start_odometer += self._moved_by
        self._q = self._q + moved
        self._v = v
        if end is None:  # what is left of the path that was proven before
            self._end = self._path(v, step=False).end

    def _renew(self, near: Indices) -> None:
        """Measure the planes that are oldest anew, a few at a time."""
        if len(near) == 0:
            return
        separation = self._separation
        margin = self._distance[near] - separation.clearance[near]
        nearest = int(margin.argmin())
        if self._steps % (_FAR_RENEWED_EVERY if margin[nearest] > _WARN else _NEAR_RENEWED_EVERY):
            return
        # the nearer, the sooner; the placements of row 0 are those of the beginning of the step
        value = (self._steps - self._renewed_at[near]) / (0.02 + np.maximum(margin, 0.0))
        # and every other step the nearest of all
        turn = self._steps // _NEAR_RENEWED_EVERY % 2
        pair = int(near[nearest if margin[nearest] < _WARN and turn else value.argmax()])
        self._distance[pair] = separation.renew(pair, self._at, 0)
        self._distance_at[pair] = self._start_odometer[separation.classes[pair]]
        self._renewed_at[pair] = self._steps

    # --- what is said ----------------------------------------------------------------------

    def _state(
        self,
        command: Command,
        chosen: _Chosen,
        wish: Vector,
        tip_wish: Vector,
        near: Indices,
        at_limit: bool,
        singular: bool,
    ) -> ServoState:
        J = self._jacobian[:3]
        v = self._v
        rates, wished = v.tolist(), wish.tolist()
        margin, link, obstacle, normal = math.inf, None, None, _ZERO
        separation = self._separation
        if len(near):
            margins = self._distance[near] - separation.clearance[near] - self._moved_by[separation.classes[near]]
            row = int(margins.argmin())
            found, pair = float(margins[row]), int(near[row])
            if found < self._law.influence:
                margin = found
                if margin < 0.0 and chosen.proven and self._stands[pair]:  # then this much was proven of it
                    margin = max(margin, float(self._required[pair] - separation.clearance[pair]))
                link = separation.link(pair)
                obstacle = self._site.said(pair)
                if margin < _WARN:
                    normal = separation.world_normals(near[row : row + 1], self._at)[0]
        self._held_back_for = self._holds if chosen.held_back else self._held_back_for - 1
        if chosen.held_back or at_limit:
            towards = zip(self._free_v, wished, self._changes, strict=True)
            self._free_v = [free + min(max(aim - free, -most), most) for free, aim, most in towards]
        else:
            self._free_v = [
                free + self._forgets * (rate - free) for free, rate in zip(self._free_v, rates, strict=True)
            ]
        held = [free - rate - aim for free, rate, aim in zip(self._free_v, rates, wished, strict=True)]
        tip_velocity, refused = np.array((rates, held)) @ J.T
        refused += tip_wish
        self._blocking = normal if chosen.held_back else _ZERO
        nearness = 0.5 * (1.0 + math.cos(math.pi * min(max(margin / _WARN, 0.0), 1.0)))
        hand = self._wish[0] if self._wish[0] is not None else tip_wish
        force = self._feedback.next(hand, refused, normal, nearness)
        moving = max(map(abs, rates)) > _AT_REST
        wishes = max(map(abs, wished)) > 1e-6
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
        elif singular:
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
            tip_position=self._tip.copy(),
            tip_velocity=tip_velocity,
            refused=refused,
            feedback_force=force,
            proven=chosen.proven,
            pace=self._pace,
        )


class _Proof(NamedTuple):
    """What is known of a braking path.

    Attributes
    ----------
    free: whether every pair that was looked at keeps the buffer too.
    clear: whether every pair that was looked at keeps what is required.
    stands_clear: the same for the pairs whose obstacle stands still.
    bound: (K,) proven distance [m].
    gaps: (S, K, V) of the corners.
    closely: (K,) which were measured at every part of the path.
    """

    free: bool
    clear: bool
    stands_clear: bool
    bound: Vector
    gaps: Matrix
    closely: NDArray[np.bool_]


_PER_PAIR = (
    "_proven", "_proven_at", "_distance", "_distance_at", "_required", "_renewed_at", "_reach", "_slow_from",
)  # fmt: skip
_ZERO = np.zeros(3)
_ZERO.setflags(write=False)
_UP = np.array([0.0, 0.0, 1.0])
_NOTHING = np.zeros((0, 3))
_NONE = np.zeros((0, 0), dtype=bool)
_NOBODY = Nearby(
    pair=np.zeros(0, dtype=np.intp),
    distance=np.zeros(0),
    margin=np.zeros(0),
    normal=_NOTHING,
    point_link=_NOTHING,
    point_obstacle=_NOTHING,
    gradient=_NOTHING,
    drift=np.zeros(0),
    moves=_NONE,
)


def _by_owner(depth: Vector, owner: Indices) -> Vector:
    """(K,) of every pair the deepest of its obstacle."""
    deepest = np.zeros(len(depth))
    for number in set(owner.tolist()):
        own = owner == number
        deepest[own] = depth[own].max()
    return deepest


def _numbers(values: object, count: int) -> Vector | None:
    """(count,) finite numbers, or None."""
    try:
        found = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None
    if count == 1 and found.ndim == 0:
        found = found.reshape(1)
    if found.shape != (count,) or not all(map(math.isfinite, found.tolist())):
        return None
    return found


def _capped(wish: Vector | None) -> Vector | None:
    """The same direction, no larger than any machine moves."""
    if wish is None:
        return None
    largest = max(map(abs, wish.tolist()))
    return wish if largest <= _FASTEST_WISH else wish / largest * _FASTEST_WISH


def _start(robot: Robot, scene: schema.Scene) -> Vector:
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
