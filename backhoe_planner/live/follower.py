"""Following a plan live: if something turns up on the path, the machine waits, gives way or goes around it.

The plan's own clock s runs slower the further the machine is off the plan:

    v_w = s' v_p(s) + min(|e| / dt, sqrt(a |e|)) sgn e,    e = q_p(s) - q,
    s' = 1 where |e| is at most d, falling linearly to 0 at the tolerance

v_p is the mean rate over the next step: with nothing in the way the machine is on the plan after
every step, and loses no time. Otherwise it waits for what is in its way, leaves the plan as far
as it must, and comes back to it. If it makes no progress for a while, it holds still, and a path
from there to the earliest clear place on the rest of the plan is searched in the background
(`rejoining`). The machine follows that path by the same law under the same servo; the rest of the
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
from backhoe_planner.live.braking_pace import BrakingPace, PlanPart, StopRule, parts_of
from backhoe_planner.live.delay import Delay, Paces
from backhoe_planner.live.detours.attempts import Attempts
from backhoe_planner.live.detours.detour import Detour
from backhoe_planner.live.detours.detour_ahead import DetourAhead
from backhoe_planner.live.detours.reference import Clocked, Reference
from backhoe_planner.live.detours.rejoining import (
    NoRejoining,
    Rejoining,
    RejoiningQuery,
    find_rejoining,
    is_still_clear,
)
from backhoe_planner.live.detours.searches import Searches
from backhoe_planner.live.detours.stop_ahead import pace_along, stop_before
from backhoe_planner.live.detours.track_proof import Blockage, TrackProof
from backhoe_planner.live.follower_state import FollowerState, FollowerStatus
from backhoe_planner.live.kept_following import KeptFollowing
from backhoe_planner.live.left_out import LeftOut, left_out_text, part_left_out
from backhoe_planner.live.leg_site import LegSite
from backhoe_planner.live.pace_ramp import PaceRamp
from backhoe_planner.live.plan_fit import check_fits, refuse_failed
from backhoe_planner.live.progress import ARRIVED, Progress
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.live.servo.servo_state import ServoState, Status
from backhoe_planner.live.servo.track import Track
from backhoe_planner.motion import Keep, Trajectory, keep_of
from backhoe_planner.planning import Plan

# The numbers are chosen; validation/placements.py drives machines with them.
_PART = 0.5  # part of the acceleration for braking on the return to the plan; the rest is for following it
_TOLERANCE = 0.03  # rad or m off the plan at which its clock stands still
_NEAR = 2.0 * _TOLERANCE  # rad or m: a machine that is held back beside its plan is just beyond the tolerance; chosen
_ON_PLAN = ARRIVED  # rad or m off the plan within which its clock does not wait
_RESTS_AT_END = 2e-3  # rad/s or m/s: a slower machine counts as at rest at the end of the plan
_STILL = 1e-4  # rad/s or m/s below which a detour is searched, which is planned from rest; it creeps from obstacles
_NOTICED = 0.3  # s without progress after which the status says that the machine waits
_PATIENCE = 1.0  # s without progress after which a detour is searched
_PATIENCE_CROSSING = 4.0  # s, if the obstacle that holds the machine moves: it may pass
_JOINS = 0.8  # s for which a machine off the plan may come onto its track before it goes on; shorter than the patience
_AHEAD_AGAIN = 0.5  # s between two searches ahead of the machine, while obstacles on the plan change
_STEADY = 0.5  # s since the last change of the surroundings after which they count as steady; chosen
_GIVING_WAY = (Status.SLIDING, Status.STOPPED, Status.EVADING, Status.TOO_CLOSE)
_OFF = 0.1  # rad or m that the machine may have moved from the start of a detour
_RECHECK = 0.2  # s between two checks of a detour while the surroundings change


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
        self._trajectory = trajectory
        self._plan = Reference(trajectory, servo.limits)
        self._detour: Detour | None = None
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
        self._left_out: tuple[LeftOut, ...] = ()
        self._delay = Delay(servo)
        self._slowest = float(servo.limits.velocity.min())
        self._progress = Progress(self._slowest)
        self._searches = Searches(executor)
        self._blockage: Blockage | None = None  # that a detour is searched for before the machine is held back by it
        self._ahead: DetourAhead | None = None
        self._ahead_from = -np.inf  # s: from then on the next detour may be searched ahead of the machine
        self._seed = seed
        self._attempts = Attempts()
        self._seen, self._seen_at = servo.revision, -np.inf  # revision of the surroundings, and s, of the last change
        self._was_holding = False
        self._was_proven = False
        self._holding = False
        self._held_at, self._held_on_proven = -1, False  # revision, and whether the plan was proven, as holding began
        self._joins_until = -np.inf  # s

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
        servo, self._asked_pace = self.servo, as_number(pace, key="pace", least=0.0, most=1.0)
        if not self._was_done:
            self._steps += 1
        self._enter_leg()
        self._look_around()
        self._take_answer()
        self._go_round_ahead()
        self._go_back()
        if self._must_hold():
            self._was_holding = True
            state = self._held()
            if not self._searches.under_way and float(np.abs(state.v).max()) < _STILL:
                if self._holding:
                    self._search()
                elif self._attempts.may_retry(servo.time):
                    self._attempts.retry()
        else:
            if self._was_holding:
                self._was_holding = False
                self._joins_until = servo.time + _JOINS
                self._progress = Progress(self._slowest)
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
            left_out=self._left_out,
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
        stands = not servo.is_moving() and self._is_steady
        kept = self._kept.rows(servo.q, servo.v, servo.dt, gives_way=self._gives_way, firm=stands)
        if kept is None:
            return servo.step(joint_velocity=velocity)
        state = servo.step_keeping_unchecked(velocity, kept)
        self._gives_way = state.status in _GIVING_WAY
        return state

    @property
    def _is_steady(self) -> bool:
        """Whether nothing was added, removed, moved or steered for a while."""
        return self.servo.time > self._seen_at + _STEADY

    def _look_around(self) -> None:
        """Restart the patience when the site has changed, as what was in the way may be gone, and prove the rest anew.

        The patience of a site that changes all the time, such as one with a tracked obstacle, is restarted only if the
        rest is proven clear, because otherwise no search would ever begin.
        """
        servo = self.servo
        if servo.revision != self._seen:
            if servo.time > self._seen_at + _PATIENCE_CROSSING:
                self._progress.waited = 0.0
            self._seen, self._seen_at = servo.revision, servo.time
        self._proof.begin(steady=self._is_steady)
        self._take_proof()
        proven = servo.is_proven_along_unchecked(self._track)
        if proven and not self._was_proven and self._detour is None and np.abs(self._plan.q - servo.q).max() < _NEAR:
            self._resume()  # one that is further off may need a way back
        self._was_proven = proven

    def _must_hold(self) -> bool:
        """Whether to hold still: while a detour is searched, and, if none was found, until something changes."""
        servo = self.servo
        if self._holding:
            # if what it stopped for may have gone since, it tries the plan while the search goes on
            gone = servo.revision != self._held_at or (self._was_proven and not self._held_on_proven)
            return not (self._searches.under_way and gone)
        return self._attempts.blocks(servo.revision) and not servo.is_moving()

    # --- along a reference -------------------------------------------------------------

    def _follow(self) -> ServoState:
        """One step along the detour, or the plan, all of it or up to where a detour begins."""
        servo, reference, track = self.servo, *self._followed()
        deviation = float(np.abs(reference.q - servo.q).max())
        on_track = track is not None and servo.is_proven_along_unchecked(track)
        if track is not None and on_track and track.is_joined_by(servo.q, servo.v):
            self._joins_until, self._kept.returns = -np.inf, False
            state = servo.step_along_unchecked(track, pace=self._asked_pace)
            if state.pace >= self._asked_pace:  # the machine is as fast as it can be; otherwise a zone slows it down
                self._ramp.pace = track.pace
            self._delay.on_track(state, track.pace, self._asked_pace)
        else:
            state = self._step_towards(reference, waits=track is not None and self._waits_to_join(proven=on_track))
        if self._progress.made(reference, deviation, self._ramp.pace * servo.dt):
            self._got_on()
        elif self._progress.waited > _PATIENCE and not (
            reference.ended and deviation < ARRIVED and self._detour is None
        ):
            self._lose_patience(state)
        if self._detour is not None:
            self._watch_detour(deviation)
        return state

    def _followed(self) -> tuple[Clocked, Track | None]:
        """What the machine follows now, and the track along it if it is to be proven."""
        if self._detour is not None:
            return self._detour.followed, None
        if self._ahead is not None:
            return self._ahead.approach, self._ahead.track
        return self._plan, self._track

    def _step_towards(self, reference: Clocked, *, waits: bool) -> ServoState:
        """One step towards where the reference is, and along with it, as far as the servo allows.

        waits: whether the reference's clock stands still.
        """
        servo, clock = self.servo, reference.clock
        # where the rest is not proven, going on beside it may lead where the servo has to hold the machine back
        running = servo.v if self._was_proven else np.zeros_like(servo.v)
        off, rates = reference.q - servo.q, reference.rates(servo.dt)
        pace = min(max((_TOLERANCE - reference.lag(servo.q, running, servo.dt)) / (_TOLERANCE - _ON_PLAN), 0.0), 1.0)
        # no faster towards the plan than the machine can brake in time
        size = np.abs(off)
        pull = np.copysign(np.minimum(size / servo.dt, np.sqrt(2.0 * _PART * servo.limits.acceleration * size)), off)
        kept = self._kept.pace(servo.q, servo.v, reference, rates)
        if kept is None:
            return self._held()
        if self._detour is None:
            stopping, time = self._paces, self._plan.clock
        else:
            stopping, time = self._detour_paces, self._detour.reference.clock
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

    def _waits_to_join(self, *, proven: bool) -> bool:
        """Whether a machine that was held, or comes from a detour, is to come exactly onto the plan at its clock.

        There it can go on along the track, if that is proven or being proven. Beside it, it would have to gather speed
        among obstacles and conditions that leave room for the plan alone.
        """
        return self.servo.time < self._joins_until and (proven or self._proof.under_way)

    def _got_on(self) -> None:
        if self._holding:  # what was in the way has gone meanwhile
            self._searches.drop()
            self._blockage = None
        self._holding = False
        self._attempts.go_on()
        if self._detour is None:
            self._attempts.get_past(self._plan.clock)

    def _lose_patience(self, state: ServoState) -> None:
        servo = self.servo
        crossing = state.nearest is not None and servo.is_moving(state.nearest.name)
        if self._holding or (crossing and self._progress.waited < _PATIENCE_CROSSING):
            return
        if self._attempts.may_search(servo.revision, servo.time):
            self._blockage = None
            self._hold()
            if self._detour is not None:  # it led nowhere: search another one
                self._detour = None
                self._note_failure(f"a way round was found, but {self._delay.held_by(state)}", servo.revision)

    def _hold(self) -> None:
        """Come to rest, and search a detour from there."""
        self._ahead = None
        self._searches.drop()
        self._attempts.begin(self._plan.clock)
        self._begin_holding()

    def _begin_holding(self) -> None:
        self._holding, self._held_at, self._held_on_proven = True, self.servo.revision, self._was_proven

    def _note_failure(self, reason: str, revision: int, *, final: bool = False) -> None:
        """Count a search that failed. After several, or if no effort helps (`final`), pause the searches."""
        self._attempts.note(reason, revision, self.servo.time, final=final)
        if self._attempts.blocked:
            self._holding = False

    def _watch_detour(self, deviation: float) -> None:
        """Go back to the plan at the end of the detour, and check that the detour is still clear."""
        found, servo = self._detour, self.servo
        assert found is not None
        if found.reference.ended and deviation < _TOLERANCE:
            self._detour = None
            self._searches.drop()
            part = part_left_out(servo.robot, self._trajectory, self._plan.clock, found.rejoins_at)
            self._left_out += () if part is None else (part,)
            self._plan.clock = found.rejoins_at
            self._proof.begin_again()
            self._joins_until = servo.time + _JOINS
            self._progress = Progress(self._slowest)
        elif servo.revision != found.checked and not self._searches.under_way and servo.time > found.check_at:
            found.checked, found.check_at = servo.revision, servo.time + _RECHECK
            rest = np.vstack((servo.q[None], found.reference.rest()))
            self._searches.begin(servo.revision, servo.time, is_still_clear, servo.robot, servo.snapshot(), rest)

    def _ahead_motion(self) -> Trajectory:
        """The motion that a detour may rejoin: for a sequence, up to the end of the leg."""
        if self._legs is None:
            return self._trajectory
        rows = slice(0, self._legs.leg.last + 1)
        return Trajectory.from_steps(self._trajectory.time[rows], self._trajectory.q[rows])

    # --- searches beside the loop --------------------------------------------------------

    def _search(self, start: Vector | None = None, since: float | None = None) -> None:
        """Begin to search a way from where the machine is, or from a `start` (n,), to the plan from `since` [s] on."""
        servo, around = self.servo, self._blockage
        query = RejoiningQuery(
            robot=servo.robot,
            scene=servo.scene if self._legs is None else self._legs.leg.problem.scene,
            limits=servo.limits,
            obstacles=servo.snapshot(),
            q=servo.q if start is None else start,
            motion=self._ahead_motion(),
            since=self._plan.clock if since is None else since,
            seed=self._seed,
            attempt=self._attempts.failed if around is None else 0,
            beyond=around is not None,
        )
        self._searches.begin(servo.revision, servo.time, find_rejoining, query)

    def _take_proof(self) -> None:
        """Take the answer whether the rest of the plan is clear: go along it, or search a detour ahead."""
        proof = self._proof.answer()
        if proof is None:
            return
        if proof.blockage is None:
            if self._ahead is not None:
                self._resume()
        elif not self.servo.is_moving():
            self._look_ahead(proof.blockage)

    def _look_ahead(self, blockage: Blockage) -> None:
        """Search a detour around a blockage from a place before it, if there is one on the present leg."""
        if self._holding or self._attempts.blocked or self._detour is not None:
            return
        if self._ahead is not None:
            if self._ahead.is_around(blockage):
                return
            self._resume()
        servo, plan = self.servo, self._plan
        if not blockage.ends or blockage.begins > self._ahead_motion().time[-1]:
            return
        if servo.time < self._ahead_from:
            self._proof.begin_again()
            return
        self._blockage = blockage
        approach = stop_before(plan, servo.limits, pace_along(plan, servo.v, servo.dt), blockage)
        if approach is not None:
            track = Track(approach, servo.limits, servo.dt)
            track.keep = self._kept.keep
            track.revision, track.carried = servo.revision, servo.robot.carried  # proven up to the blockage
            self._ahead, self._ahead_from = DetourAhead(approach, track, blockage), servo.time + _AHEAD_AGAIN
            self._search(approach.last_q, approach.place)
        else:  # the sooner the machine rests, the more room it has
            self._hold()

    def _resume(self) -> None:
        """Go on along the plan, without waiting for a detour."""
        if self._holding or self._ahead is not None:
            self._searches.drop()
        self._ahead = self._blockage = None
        self._holding = False
        self._attempts.go_on()
        self._progress = Progress(self._slowest)

    def _go_round_ahead(self) -> None:
        """Begin the detour ahead once the machine is there; leave it if there is none, or something moves."""
        ahead, servo = self._ahead, self.servo
        if ahead is None:
            return
        if ahead.found is None and not self._searches.under_way:  # dropped, as the follower is closed
            ahead.failed = True
        if servo.is_moving() or (ahead.failed and (ahead.approach.ended or servo.revision != ahead.track.revision)):
            self._resume()
        elif ahead.found is not None and ahead.approach.ended and np.abs(self._plan.q - servo.q).max() < _ON_PLAN:
            self._ahead = None
            self._attempts.begin(self._plan.clock)
            self._go_round(ahead.found, self._searches.revision)

    def _go_back(self) -> None:
        """Search a way back from a detour once the plan is clear without it, and begin it where it begins."""
        detour, servo = self._detour, self.servo
        if detour is None:
            return
        back = detour.back
        if back is None:
            if self._was_proven and not self._searches.under_way:
                back = detour.look_back(self._plan, servo.revision)
                if back is not None:
                    self._search(back.approach.last_q, back.since)
        elif back.found is None:
            if servo.revision != back.revision or back.is_late or not self._searches.under_way:
                self._searches.drop()
                detour.go_on()
        elif not self._was_proven:  # something is in the way again
            detour.go_on()
        elif back.approach.ended and np.abs(back.approach.last_q - servo.q).max() < _ON_PLAN:
            self._searches.drop()
            self._go_round(back.found, back.revision)

    def _go_round(self, found: Rejoining, revision: int) -> None:
        """Begin a detour that is clear at a `revision` of the surroundings."""
        limits, keep = self.servo.limits, self._kept.keep
        self._detour = Detour(found, limits, revision)
        part = PlanPart(0.0, None if keep is None else StopRule(keep, None))
        self._detour_paces = BrakingPace(self._detour.reference, limits, [part])
        self._progress = Progress(self._slowest)
        self._attempts.go_on()
        self._blockage = None

    def _take_answer(self) -> None:
        answer = self._searches.answer(self.servo.time)
        if answer is None:
            return
        if self._ahead is not None and isinstance(answer, Rejoining):
            self._ahead.found = answer
        elif self._blockage is not None and not isinstance(answer, Rejoining | bool):
            # the machine goes on as far as the plan leads, and searches with more effort there
            self._attempts.note_ahead(self._blockage.begins)
            if self._ahead is None:
                self._resume()
            else:
                self._ahead.failed = True
        elif self._detour is not None and self._detour.back is not None and self._detour.back.found is None:
            self._detour.take(answer)
        elif answer is False and self._detour is not None:  # the detour is no longer clear
            self._detour = None
            self._begin_holding()
        elif isinstance(answer, Rejoining):
            self._holding = False
            if float(np.abs(answer.motion.q[0] - self.servo.q).max()) <= _OFF:
                self._go_round(answer, self._searches.revision)
        elif not isinstance(answer, bool):
            final = isinstance(answer, NoRejoining) and not answer.searched
            reason = answer.reason if isinstance(answer, NoRejoining) else f"planning failed: {answer!s:.200}"
            self._note_failure(reason, self._searches.revision, final=final)

    # --- how it goes --------------------------------------------------------------------

    def _status(self, state: ServoState, done: bool) -> tuple[FollowerStatus, str]:
        if done:
            return FollowerStatus.ARRIVED, left_out_text(self._left_out)
        if self._attempts.blocked:
            return FollowerStatus.BLOCKED, self._attempts.blocked
        waits = self._progress.waited > _NOTICED or self._kept.returns
        if self._ahead is not None and (self._ahead.approach.ended or not waits):
            return FollowerStatus.WAITING if waits else FollowerStatus.FOLLOWING, self._ahead.reason
        if self._holding or waits:
            lost = self._kept.lost(evades=state.status is Status.EVADING)
            kept = f"; {lost}" if lost else ""
            sought = "; a way round is searched for" if self._holding else ""
            return FollowerStatus.WAITING, f"{self._delay.held_by(state)}{kept}{sought}"
        if self._detour is not None:
            return FollowerStatus.GOING_ROUND, self._detour.reason
        if self._asked_pace == 0.0:
            return FollowerStatus.WAITING, "a pace of 0 is asked for"
        late = self._proof.slowed_by if self._behind > _NOTICED else ""
        return FollowerStatus.FOLLOWING, "; ".join(part for part in (late, self._delay.reason) if part)
