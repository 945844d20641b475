"""A motion made of steps, each taken only if it is proven clear.

A `Stepper` turns desired joint velocities into a motion: the shield filters them, and the
certificate's bound checks the resulting step. A step that is not proven is tried again
with more distance from the pairs that came too near, then with half the time; if nothing
helps, the machine brakes.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law import Kept, Shield, Shielded
from backhoe_planner.machine import Configuration, Kinematics
from backhoe_planner.motion import SAMPLE_PERIOD, Problem, Trajectory
from backhoe_planner.proof import segment_is_clear
from backhoe_planner.site import Nearby, Proximity

STEP = SAMPLE_PERIOD  # s: a step is a sample of the motion
_BUFFER = 0.002  # m kept on top of every clearance, for the error of the linearised rows; chosen
_KEEP_BUFFER = 1e-4  # rad or m: a step that breaks a kept condition is tried again so much further within; chosen
_HALVINGS = 5  # of the time of a step, tried in turn; chosen: the last is about a millisecond
_CORRECTIONS = 3  # tries with more distance at one length of the step; chosen
_LONGEST_STOP = 10.0  # s after which giving way is given up; chosen: long for a stop


@dataclass(frozen=True)
class PlannerStep:
    """What a watcher gets while the planner works.

    Attributes
    ----------
    time: [s] in the motion.
    q: (n,) joint positions [rad or m].
    attempt: the attempt of the planner that the step belongs to, from 1.
    best: the cost of the best motion to a goal so far, by the problem's objective; None before there is one.
    unit: of `best`; empty if it is None.
    """

    time: float
    q: Vector
    attempt: int
    best: float | None = None
    unit: str = ""


Watcher = Callable[[PlannerStep], object]


class Stepper:
    """A motion that is being made, step by step.

    Attributes
    ----------
    q: (n,) where the joints are [rad or m].
    v: (n,) their velocity in the last step [rad/s or m/s].
    time: of the motion so far [s].
    proximity: to the obstacles that the motion keeps clear of, as they are at the time of each step.
    attempt: of the planner, from 1; shown to the watcher.
    shielded: the shield's answer to the last step; None before the first, and after a step without the shield.
    """

    def __init__(
        self,
        problem: Problem,
        q: Vector,
        *,
        proximity: Proximity,
        kinematics: Kinematics,
        watch: Watcher | None = None,
    ) -> None:
        self.problem = problem
        self.q = np.array(q, dtype=float)
        self.v = np.zeros_like(self.q)
        self.time = 0.0
        self.shielded: Shielded | None = None
        self.attempt = 1
        self.proximity = proximity
        self._kinematics = kinematics
        self._shield = Shield(problem.limits)
        limits = problem.limits
        self._acceleration, self._change = limits.acceleration, limits.acceleration * STEP
        self._ranges = list(zip(limits.lower.tolist(), limits.upper.tolist(), strict=True))
        self._longest_stop = self._shield.stopping_time(problem.limits.velocity)
        self._last_dt = STEP  # s; a longer one counts as this, in which a change of velocity has to take place
        self._watch = watch
        self._times = [0.0]
        self._path = [self.q]

    def branch(self, *, attempt: int, proximity: Proximity | None = None) -> Stepper:
        """Another motion that continues from here; this one is not changed.

        Parameters
        ----------
        attempt: of the planner, from 1.
        proximity: to the obstacles that the new motion keeps clear of; by default the same.
        """
        other = copy.copy(self)
        other.proximity = proximity or self.proximity
        other.attempt = attempt
        other._times, other._path = list(self._times), list(self._path)
        return other

    def look(self) -> tuple[Configuration, Nearby]:
        """The present configuration, and the pairs that act on the motion there.

        These are the pairs within the influence distance, and those whose distance could be
        used up before the machine stops, for any desired velocity within the limits.
        """
        dt = self._last_dt
        fastest = np.abs(self.v)
        fastest += self._change if dt == STEP else self._acceleration * (0.5 * (STEP + dt))
        nearby = self.proximity.at_unchecked(
            self.q, time=self.time, margin=self.problem.scene.influence, v=self.v, fastest=fastest,
            stop=self._shield.stopping_time_unchecked(fastest), longest=self._longest_stop,
        )  # fmt: skip
        return self._kinematics.at_unchecked(self.q), nearby

    def advance(self, wish: Vector, nearby: Nearby, J_tip: Matrix) -> bool:
        """Take the step nearest to `wish` (n,) that is proven clear, a shorter one if need be; False if none is.

        Parameters
        ----------
        wish: desired joint velocities [rad/s or m/s].
        nearby: as returned by `look` at the present configuration.
        J_tip: (3, n) position Jacobian of the tip; zeros if only the joints count.
        """
        keep = self.problem.keep
        kept = None if keep is None else Kept(*(each[0] for each in keep.rows_each(self.q[None])))
        dt = STEP
        for _ in range(_HALVINGS):
            extra: Vector | float = _BUFFER
            # the change of velocity is spread over half of this step and half of the last one, from rest over this step
            span = dt if len(self._times) == 1 and not np.any(self.v) else 0.5 * (dt + self._last_dt)
            for _ in range(_CORRECTIONS):
                shielded = self._shield.filter_unchecked(
                    wish, q=self.q, v_before=self.v, dt=span, nearby=nearby, J_tip=J_tip, extra_margin=extra, kept=kept
                )
                q = self._within_limits(self.q + shielded.v * dt)
                is_kept = self._is_kept(q)
                if is_kept and segment_is_clear(self.proximity, self.q, q, time=self.time, dt=dt):
                    self._take(q, dt, shielded)
                    return True
                extra = extra + self._shortfall(q, dt, nearby)
                if kept is not None and not is_kept:
                    kept = self._tighter(kept, q)
            dt *= 0.5
        return self._brake(dt)

    def play(self, piece: Trajectory) -> None:
        """Append a motion from rest to rest that begins where this one ends.

        If the machine was moving, it stands for one step first: otherwise the velocity would
        change twice at the seam.
        """
        if len(piece) < 2:
            return
        if np.any(self.v):
            self._take(self.q, self._last_dt, None)
        begun = self.time
        for moment, q in zip(piece.time[1:], piece.q[1:], strict=True):
            self._append(begun + float(moment), np.array(q))
        self.time = self._times[-1]
        self.q = self._path[-1]
        self.v = piece.segment_velocities()[-1].copy()
        self._last_dt = min(float(piece.time[-1] - piece.time[-2]), STEP)
        self.shielded = None

    def replay(self, motion: Trajectory, until: float) -> None:
        """Replace this motion by `motion` up to the time `until` [s], with its velocity there."""
        count = int(np.searchsorted(motion.time, until - 1e-9))
        self._times = [*motion.time[:count].tolist(), until]
        self._path = [*(np.array(q) for q in motion.q[:count]), motion.at(until)]
        self.time, self.q = until, self._path[-1]
        self.shielded = None
        self.v = np.zeros_like(self.q)
        if len(self._times) > 1:
            last_dt = self._times[-1] - self._times[-2]
            self.v = (self._path[-1] - self._path[-2]) / last_dt
            self._last_dt = min(last_dt, STEP)

    def rest(self, until: float) -> None:
        """Stand until the time `until` [s]; the motion must be at rest."""
        if until > self.time:
            self._take(self.q, until - self.time, None)

    def stopped(self) -> bool:
        """Whether the machine can be at rest after one more step."""
        return bool(np.all(np.abs(self.v) <= self.problem.limits.acceleration * STEP + 1e-12))

    def stop(self) -> None:
        """Brake all joints in proportion until they are at rest."""
        for _ in range(10_000):
            if not np.any(np.abs(self.v) > 1e-9) or not self._brake(STEP):
                break

    def give_way(self, until: float) -> bool:
        """Come to rest, giving way to moving obstacles, until the time `until` [s].

        Returns
        -------
        Whether that was possible without coming too near to anything, with the machine
        at rest at the end.
        """
        still = np.zeros_like(self.q)
        no_tip = np.zeros((3, len(self.q)))
        while self.time < until or np.any(np.abs(self.v) > 1e-9):
            _, nearby = self.look()
            if not self.advance(still, nearby, no_tip) or self.time > until + _LONGEST_STOP:
                return False
        return True

    def trajectory(self) -> Trajectory:
        """The motion so far."""
        return Trajectory.from_steps(np.array(self._times), np.array(self._path))

    def _take(self, q: Vector, dt: float, shielded: Shielded | None) -> None:
        self.v = (q - self.q) / dt
        self.q = q
        self.time += dt
        self.shielded = shielded
        self._last_dt = min(dt, STEP)
        self._append(self.time, q)

    def _append(self, time: float, q: Vector) -> None:
        self._times.append(time)
        self._path.append(q)
        if self._watch is not None:
            self._watch(PlannerStep(time, q, self.attempt))

    def _brake(self, dt: float) -> bool:
        """Brake all joints in proportion for one step; False if that step is not clear."""
        time = self._shield.braking_time(self.v)
        span = 0.5 * (dt + self._last_dt)
        v = self.v * max(1.0 - span / time, 0.0) if time > 0.0 else self.v
        q = self._within_limits(self.q + v * dt)
        if not self._is_kept(q) or not segment_is_clear(self.proximity, self.q, q, time=self.time, dt=dt):
            return False
        self._take(q, dt, None)
        return True

    def _is_kept(self, q: Vector) -> bool:
        """Whether the step to `q` (n,) satisfies `keep`; true if the present configuration does not satisfy it."""
        keep = self.problem.keep
        return keep is None or not keep.holds(self.q) or keep.segment_holds(self.q, q)

    def _tighter(self, kept: Kept, q: Vector) -> Kept:
        """The kept conditions with margins reduced according to how far the step to `q` (n,) breaks them."""
        assert self.problem.keep is not None
        missing = np.maximum(-self.problem.keep.margins(q), 0.0)
        return Kept(kept.margin - 2.0 * missing - _KEEP_BUFFER, kept.gradient)

    def _within_limits(self, q: Vector) -> Vector:
        # for a handful of joints, plain numbers cost a fraction of the time of arrays
        for position, (least, most) in zip(q.tolist(), self._ranges, strict=True):
            if position < least or position > most:
                break
        else:
            return q
        limits = self.problem.limits
        inside = (self.q >= limits.lower) & (self.q <= limits.upper)
        return np.where(inside, np.clip(q, limits.lower, limits.upper), q)

    def _shortfall(self, q: Vector, dt: float, nearby: Nearby) -> Vector:
        """(K,) how much further away each nearby pair must be kept for the step to `q` to be clear [m]."""
        reached = self.proximity.distances_of_unchecked(nearby.pair, q, time=self.time + dt)
        missing = self.proximity.clearance[nearby.pair] + 0.5 * _BUFFER - reached
        return np.where(missing > 0.0, 2.0 * missing + _BUFFER, 0.0)
