"""Following a plan live: if something turns up on the path, the machine waits, gives way or goes around it.

The plan's own clock s runs slower the further the machine is off the plan:

    v_w = s' v_p(s) + min(|e| / dt, sqrt(a |e|)) sgn e,    e = q_p(s) - q,
    s' = 1 where |e| is at most d, falling linearly to 0 at the tolerance

v_p is the mean rate over the next step: with nothing in the way the machine is on the plan after
every step, and loses no time. Otherwise it waits for what is in its way, leaves the plan as far
as it must, and comes back to it. If it makes no progress for a while, it holds still, and a path
from there to the earliest clear place on the rest of the plan is searched in the background
(`detour_search`). The machine follows that path by the same law under the same servo; the rest of the
plan stays as it was. Whatever is planned, the servo alone decides what is safe.

Where the rest of the plan is proven clear of what is there, and the machine is on it, the plan is a track (`track`):
the machine keeps to it exactly, also where it cannot brake straight ahead. If the proof says where the rest is not
clear, a detour is searched from a place before that, while the machine drives there (`detour_ahead`, `stop_ahead`).
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np

from backhoe_planner.arrays import Vector, as_count, as_number
from backhoe_planner.errors import InputError, check_flag, check_kind
from backhoe_planner.live.braking_pace import BrakingPace, parts_of
from backhoe_planner.live.delay import Delay, Paces
from backhoe_planner.live.detour_search import ON_PLAN, TOLERANCE, DetourSearch
from backhoe_planner.live.detours.reference import Clocked, Reference
from backhoe_planner.live.detours.searches import Searches
from backhoe_planner.live.detours.track_proof import TrackProof
from backhoe_planner.live.follower_state import FollowerState, FollowerStatus
from backhoe_planner.live.kept_following import KeptFollowing
from backhoe_planner.live.left_out import left_out_text
from backhoe_planner.live.leg_site import LegSite
from backhoe_planner.live.pace_ramp import PaceRamp
from backhoe_planner.live.plan_fit import check_fits, refuse_failed
from backhoe_planner.live.progress import ARRIVED
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.live.servo.servo_state import ServoState, Status
from backhoe_planner.live.servo.track import Track
from backhoe_planner.motion import Keep, Trajectory, keep_of
from backhoe_planner.planning import Plan

# The numbers are chosen; validation/placements.py drives machines with them.
_PART = 0.5  # part of the acceleration for braking on the return to the plan; the rest is for following it
_RESTS_AT_END = 2e-3  # rad/s or m/s: a slower machine counts as at rest at the end of the plan
_STILL = 1e-4  # rad/s or m/s below which a detour is searched, which is planned from rest; it creeps from obstacles
_NOTICED = 0.3  # s without progress after which the status says that the machine waits
_GIVING_WAY = (Status.SLIDING, Status.STOPPED, Status.EVADING, Status.TOO_CLOSE)


class PlanFollower:
    """Drives a servo along a plan, one step after the other.

    Parameters
    ----------
    servo: of the plan's own machine and scene. If the machine is not at the beginning of the plan, it goes there
        first.
    plan: a plan, or a trajectory alone, of which only the number of joints is checked.
    executor: runs the searches for detours (0.1 to 8 s each) and the proofs. The default is threads of the follower's
        own, which share the interpreter with the loop: during a search, also while the machine drives, steps may come
        some milliseconds late, single ones up to 0.1 s. A `ProcessPoolExecutor` avoids that.
    seed: of the searches, not negative.
    allow_failed: whether a plan whose verdict is ``failed`` is followed as well, to the end of the
        motion that it has. That is not the end of its task, and the motion may violate limits and
        clearances; the servo keeps those.

    Raises
    ------
    InputError: the plan failed, and that is not allowed, or it has no motion; it is for another machine, or
        another scene, than the servo's; in one of its legs the machine carries something that the servo's scene does
        not have; the seed is negative.

    Along the plan of a sequence, obstacles that are present in some legs only are added and removed with
    these legs, and the load and the conditions to be kept are those of the leg.

    `step` raises nothing, except for a wrong `pace`. `close`, or the end of a ``with`` block, ends the follower's own
    threads once what they run is over.
    """

    def __init__(
        self,
        servo: Servo,
        plan: Plan | Trajectory,
        *,
        executor: Executor | None = None,
        seed: int = 0,
        allow_failed: bool = False,
    ) -> None:
        robot = check_kind(servo, Servo, key="servo").robot
        if executor is not None:
            check_kind(executor, Executor, key="executor")
        seed, allow_failed = as_count(seed, key="seed"), check_flag(allow_failed, key="allow_failed")
        if isinstance(plan, Plan):
            check_fits(plan, servo)
        if isinstance(plan, Plan) and not plan.verified:
            refuse_failed(plan, allowed=allow_failed)
        trajectory = plan.trajectory if isinstance(plan, Plan) else check_kind(plan, Trajectory, key="plan")
        count = trajectory.q.shape[1]
        if count != robot.n:
            wrong = "has another number of joints than the machine"
            raise InputError(wrong, key="plan.trajectory", found=count, allowed=str(robot.n))
        self.servo = servo
        self._plan = Reference(trajectory, servo.limits)
        keep = plan.problem.keep if isinstance(plan, Plan) else keep_of(robot, servo.scene)
        self._paces = BrakingPace(self._plan, servo.limits, parts_of(servo, plan, keep))
        self._legs = LegSite(servo, plan) if isinstance(plan, Plan) and plan.legs else None
        self._track = Track(self._plan, servo.limits, servo.dt)
        self._set_keep(keep)
        self._asked_pace, self._gives_way = 1.0, False
        self._ramp = PaceRamp(servo.limits.acceleration, servo.dt)
        self._proof = TrackProof(servo, plan, self._plan, self._track, executor)
        self._enter_leg()
        self._steps = 0  # until it was done
        self._was_done = False
        self._delay, self._searches = Delay(servo), Searches(executor)
        self._search = DetourSearch(
            servo, trajectory, plan=self._plan, track=self._track, proof=self._proof, legs=self._legs,
            searches=self._searches, seed=seed, delay=self._delay,
        )  # fmt: skip
        self._was_holding = False

    def __enter__(self) -> PlanFollower:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the searches. Later steps follow the plan, but no longer find detours around new obstacles."""
        self._searches.close()
        self._proof.close()

    @property
    def done(self) -> bool:
        """Whether the machine rests at the end of the plan."""
        servo, end = self.servo, self._plan.last_q
        arrived = self._plan.ended and float(np.abs(end - servo.q).max()) < ARRIVED
        return arrived and bool((np.abs(servo.v) < _RESTS_AT_END).all())

    def step(self, *, pace: float = 1.0) -> FollowerState:
        """Move on by the servo's dt.

        Parameters
        ----------
        pace: the most of the plan's speed at which the machine goes on, 0 to 1. At 0 it comes to rest on the plan and
            waits there.

        Raises
        ------
        InputError: the pace is not such a number.
        """
        self._asked_pace = as_number(pace, key="pace", least=0.0, most=1.0)
        if not self._was_done:
            self._steps += 1
        self._enter_leg()
        self._search.look()
        if self._search.must_hold:
            self._was_holding = True
            state = self._held()
            if float(np.abs(state.v).max()) < _STILL:
                self._search.search_at_rest()
        else:
            if self._was_holding:
                self._was_holding = False
                self._search.begin_to_join()
            state = self._follow()
        done = self._was_done = self.done
        status, reason = self._status(state, done)
        if state.status is Status.TOO_CLOSE and state.nearest is not None:
            reason = "; ".join(part for part in (state.nearest.describe(), reason) if part)
        return FollowerState(
            state=state,
            plan_time=self._plan.clock,
            behind=self._behind,
            deviation=float(np.abs(self._plan.q - state.q).max()),
            done=done,
            status=status,
            reason=reason,
            left_out=self._search.left_out,
        )

    @property
    def _behind(self) -> float:
        """How much later than planned the machine is [s]."""
        return max(self._steps * self.servo.dt - self._plan.clock, 0.0)

    def _enter_leg(self) -> None:
        """Set the site and the conditions to those of the leg at the plan's clock; without legs do nothing."""
        if self._legs is not None and self._legs.enter(self._plan.clock):
            self._proof.follow_leg(self._legs.leg)
            self._set_keep(self._legs.leg.problem.keep)

    def _set_keep(self, keep: Keep | None) -> None:
        self._kept, self._track.keep = KeptFollowing(keep, self.servo.limits), keep

    def _held(self) -> ServoState:
        """One step in which the machine stops, or comes back to what it has to keep."""
        servo = self.servo
        return self._drive(self._kept.held(servo.q, servo.v, servo.dt))

    def _drive(self, velocity: Vector) -> ServoState:
        """One step towards a velocity (n,); if something is in the way, it gives way at little cost of `keep`."""
        servo = self.servo
        # what stands still does not come nearer; something that is moved from step to step by hand may
        stands = not servo.is_moving() and self._search.is_steady
        kept = self._kept.rows(servo.q, servo.v, servo.dt, gives_way=self._gives_way, firm=stands)
        if kept is None:
            return servo.step(joint_velocity=velocity)
        state = servo.step_keeping_unchecked(velocity, kept)
        self._gives_way = state.status in _GIVING_WAY
        return state

    # --- along a reference -------------------------------------------------------------

    def _follow(self) -> ServoState:
        """One step along the detour, or the plan, all of it or up to where a detour begins."""
        servo, reference, track = self.servo, *self._search.followed
        deviation = float(np.abs(reference.q - servo.q).max())
        on_track = track is not None and servo.is_proven_along_unchecked(track)
        if track is not None and on_track and track.is_joined_by(servo.q, servo.v):
            self._search.join()
            self._kept.returns = False
            state = servo.step_along_unchecked(track, pace=self._asked_pace)
            if state.pace >= self._asked_pace:  # the machine is as fast as it can be; otherwise a zone slows it down
                self._ramp.pace = track.pace
            self._delay.on_track(state, track.pace, self._asked_pace)
        else:
            waits = track is not None and self._search.waits_to_join(proven=on_track)
            state = self._step_towards(reference, waits=waits)
        self._search.note_step(reference, deviation, self._ramp.pace * servo.dt, state)
        return state

    def _step_towards(self, reference: Clocked, *, waits: bool) -> ServoState:
        """One step towards where the reference is, and along with it, as far as the servo allows.

        waits: whether the reference's clock stands still.
        """
        servo, clock = self.servo, reference.clock
        # where the rest is not proven, going on beside it may lead where the servo has to hold the machine back
        running = servo.v if self._search.is_proven else np.zeros_like(servo.v)
        off, rates = reference.q - servo.q, reference.rates(servo.dt)
        pace = min(max((TOLERANCE - reference.lag(servo.q, running, servo.dt)) / (TOLERANCE - ON_PLAN), 0.0), 1.0)
        # no faster towards the plan than the machine can brake in time
        size = np.abs(off)
        pull = np.copysign(np.minimum(size / servo.dt, np.sqrt(2.0 * _PART * servo.limits.acceleration * size)), off)
        kept = self._kept.pace(servo.q, servo.v, reference, rates)
        if kept is None:
            return self._held()
        detour = self._search.detour
        if detour is None:
            stopping, time = self._paces, self._plan.clock
        else:
            stopping, time = self._search.detour_paces, detour.reference.clock
        stops = stopping.at(time)
        asked = self._ramp.towards(self._asked_pace, reference)
        paces = Paces(pace, kept, stops, asked, waits)
        pace = 0.0 if waits else min(paces[:4])
        state = self._drive(pace * rates + pull)
        if reference.clock == clock:  # unless the servo went on along the plan
            reference.advance(pace * servo.dt)
        beside = float(np.abs(reference.q - state.q).max())
        self._delay.off_track(state, paces, self._asked_pace, beside, lambda: stopping.cause(time))
        return state

    # --- how it goes --------------------------------------------------------------------

    def _status(self, state: ServoState, done: bool) -> tuple[FollowerStatus, str]:
        search, ahead = self._search, self._search.ahead
        if done:
            return FollowerStatus.ARRIVED, left_out_text(search.left_out)
        if search.blocked:
            return FollowerStatus.BLOCKED, search.blocked
        waits = search.waited > _NOTICED or self._kept.returns
        if ahead is not None and (ahead.approach.ended or not waits):
            return FollowerStatus.WAITING if waits else FollowerStatus.FOLLOWING, ahead.reason
        if search.holding or waits:
            lost = self._kept.lost(evades=state.status is Status.EVADING)
            kept = f"; {lost}" if lost else ""
            sought = "; a way round is searched for" if search.holding else ""
            return FollowerStatus.WAITING, f"{self._delay.held_by(state)}{kept}{sought}"
        if search.detour is not None:
            return FollowerStatus.GOING_ROUND, search.detour.reason
        if self._asked_pace == 0.0:
            return FollowerStatus.WAITING, "a pace of 0 is asked for"
        late = self._proof.slowed_by if self._behind > _NOTICED else ""
        return FollowerStatus.FOLLOWING, "; ".join(part for part in (late, self._delay.reason) if part)
