"""When a way around something on a plan is searched, and what the machine follows: the plan or a detour.

A detour is searched from rest where the machine has made no progress for a while, or, while it drives on, from a place
before the first blockage of a plan whose proof names one (`detour_ahead`). Along a detour, a way back is searched once
the plan is clear without it (`detour`). How the machine follows what is chosen here is in `follower`.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.live.braking_pace import BrakingPace, PlanPart, StopRule
from backhoe_planner.live.delay import Delay
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
from backhoe_planner.live.left_out import LeftOut, part_left_out
from backhoe_planner.live.leg_site import LegSite
from backhoe_planner.live.progress import ARRIVED, Progress
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.live.servo.servo_state import ServoState
from backhoe_planner.live.servo.track import Track
from backhoe_planner.motion import Trajectory

# The numbers are chosen; validation/placements.py drives machines with them.
TOLERANCE = 0.03  # rad or m off the plan at which its clock stands still
_NEAR = 2.0 * TOLERANCE  # rad or m: a machine that is held back beside its plan is just beyond the tolerance; chosen
ON_PLAN = ARRIVED  # rad or m off the plan within which its clock does not wait
_PATIENCE = 1.0  # s without progress after which a detour is searched
_PATIENCE_CROSSING = 4.0  # s, if the obstacle that holds the machine moves: it may pass
_JOINS = 0.8  # s for which a machine off the plan may come onto its track before it goes on; shorter than the patience
_AHEAD_AGAIN = 0.5  # s between two searches ahead of the machine, while obstacles on the plan change
_STEADY = 0.5  # s since the last change of the surroundings after which they count as steady; chosen
_OFF = 0.1  # rad or m that the machine may have moved from the start of a detour
_RECHECK = 0.2  # s between two checks of a detour while the surroundings change


class DetourSearch:
    """Decides when a detour is searched, and what the machine follows.

    Parameters
    ----------
    servo: drives the machine.
    motion: of the plan.
    plan: the same motion, with the clock that the follower moves on.
    track: of the plan; its `keep` is that of the present leg.
    proof: proves the rest of the plan.
    legs: the legs of the plan, None if it has none.
    searches: runs the searches.
    seed: of the searches.
    delay: says in words what holds the machine back.

    Attributes
    ----------
    detour: the detour that is followed; None if it is the plan.
    detour_paces: the greatest paces along it.
    ahead: the detour that is searched, or that begins, ahead of the machine; None if there is none.
    holding: whether the machine holds still while a detour is searched.
    is_proven: whether the rest of the plan is proven clear of what is there now.
    left_out: the parts of the plan that detours have left out.
    """

    detour_paces: BrakingPace

    def __init__(
        self,
        servo: Servo,
        motion: Trajectory,
        *,
        plan: Reference,
        track: Track,
        proof: TrackProof,
        legs: LegSite | None,
        searches: Searches,
        seed: int,
        delay: Delay,
    ) -> None:
        self._servo, self._trajectory, self._plan, self._track = servo, motion, plan, track
        self._proof, self._legs, self._searches, self._seed, self._delay = proof, legs, searches, seed, delay
        self._slowest = float(servo.limits.velocity.min())
        self._progress = Progress(self._slowest)
        self._attempts = Attempts()
        self.detour: Detour | None = None
        self.ahead: DetourAhead | None = None
        self._ahead_from = -np.inf  # s: from then on the next detour may be searched ahead of the machine
        self._blockage: Blockage | None = None  # that a detour is searched for before the machine is held back by it
        self._seen, self._seen_at = servo.revision, -np.inf  # revision of the surroundings, and s, of the last change
        self.is_proven = self.holding = False
        self._held_at, self._held_on_proven = -1, False  # revision, and whether the plan was proven, as holding began
        self._joins_until = -np.inf  # s
        self.left_out: tuple[LeftOut, ...] = ()

    # --- what the follower asks and tells ----------------------------------------------

    def look(self) -> None:
        """Look at the surroundings, at the proof and at what the searches have found, before a step."""
        self._look_around()
        self._take_answer()
        self._go_round_ahead()
        self._go_back()

    @property
    def must_hold(self) -> bool:
        """Whether to hold still: while a detour is searched, and, if none was found, until something changes."""
        servo = self._servo
        if self.holding:
            # if what it stopped for may have gone since, it tries the plan while the search goes on
            gone = servo.revision != self._held_at or (self.is_proven and not self._held_on_proven)
            return not (self._searches.under_way and gone)
        return self._attempts.blocks(servo.revision) and not servo.is_moving()

    @property
    def followed(self) -> tuple[Clocked, Track | None]:
        """What the machine follows now, and the track along it if it is to be proven."""
        if self.detour is not None:
            return self.detour.followed, None
        if self.ahead is not None:
            return self.ahead.approach, self.ahead.track
        return self._plan, self._track

    @property
    def is_steady(self) -> bool:
        """Whether nothing was added, removed, moved or steered for a while."""
        return self._servo.time > self._seen_at + _STEADY

    @property
    def waited(self) -> float:
        """How long there has been no progress, see `Progress` [s]."""
        return self._progress.waited

    @property
    def blocked(self) -> str:
        """Why there is no detour, in words, once several searches failed; otherwise empty."""
        return self._attempts.blocked

    def waits_to_join(self, *, proven: bool) -> bool:
        """Whether a machine that was held, or comes from a detour, is to come exactly onto the plan at its clock.

        There it can go on along the track, if that is proven or being proven. Beside it, it would have to gather speed
        among obstacles and conditions that leave room for the plan alone.
        """
        return self._servo.time < self._joins_until and (proven or self._proof.under_way)

    def begin_to_join(self) -> None:
        """Note that the machine may move again, and comes onto the plan."""
        self._joins_until = self._servo.time + _JOINS
        self._progress = Progress(self._slowest)

    def join(self) -> None:
        """Note that the machine is on its track."""
        self._joins_until = -np.inf

    def search_at_rest(self) -> None:
        """Begin a search from where the machine rests, or try the plan once more."""
        if self._searches.under_way:
            return
        if self.holding:
            self._search()
        elif self._attempts.may_retry(self._servo.time):
            self._attempts.retry()

    def note_step(self, reference: Clocked, deviation: float, could: float, state: ServoState) -> None:
        """Note how far a step has led along the `reference`: without progress for a while, search a detour.

        Parameters
        ----------
        deviation, could: see `Progress.made`.
        state: of the machine after the step.
        """
        if self._progress.made(reference, deviation, could):
            self._got_on()
        elif self._progress.waited > _PATIENCE and not (
            reference.ended and deviation < ARRIVED and self.detour is None
        ):
            self._lose_patience(state)
        if self.detour is not None:
            self._watch_detour(deviation)

    # --- when to search ------------------------------------------------------------------

    def _look_around(self) -> None:
        """Restart the patience when the site has changed, as what was in the way may be gone, and prove the rest anew.

        The patience of a site that changes all the time, such as one with a tracked obstacle, is restarted only if the
        rest is proven clear, because otherwise no search would ever begin.
        """
        servo = self._servo
        if servo.revision != self._seen:
            if servo.time > self._seen_at + _PATIENCE_CROSSING:
                self._progress.waited = 0.0
            self._seen, self._seen_at = servo.revision, servo.time
        self._proof.begin(steady=self.is_steady)
        self._take_proof()
        proven = servo.is_proven_along_unchecked(self._track)
        if proven and not self.is_proven and self.detour is None and np.abs(self._plan.q - servo.q).max() < _NEAR:
            self._resume()  # one that is further off may need a way back
        self.is_proven = proven

    def _got_on(self) -> None:
        if self.holding:  # what was in the way has gone meanwhile
            self._searches.drop()
            self._blockage = None
        self.holding = False
        self._attempts.go_on()
        if self.detour is None:
            self._attempts.get_past(self._plan.clock)

    def _lose_patience(self, state: ServoState) -> None:
        servo = self._servo
        crossing = state.nearest is not None and servo.is_moving(state.nearest.name)
        if self.holding or (crossing and self._progress.waited < _PATIENCE_CROSSING):
            return
        if self._attempts.may_search(servo.revision, servo.time):
            self._blockage = None
            self._hold()
            if self.detour is not None:  # it led nowhere: search another one
                self.detour = None
                self._note_failure(f"a way round was found, but {self._delay.held_by(state)}", servo.revision)

    def _hold(self) -> None:
        """Come to rest, and search a detour from there."""
        self.ahead = None
        self._searches.drop()
        self._attempts.begin(self._plan.clock)
        self._begin_holding()

    def _begin_holding(self) -> None:
        self.holding, self._held_at, self._held_on_proven = True, self._servo.revision, self.is_proven

    def _note_failure(self, reason: str, revision: int, *, final: bool = False) -> None:
        """Count a search that failed. After several, or if no effort helps (`final`), pause the searches."""
        self._attempts.note(reason, revision, self._servo.time, final=final)
        if self._attempts.blocked:
            self.holding = False

    # --- searches beside the loop --------------------------------------------------------

    def _search(self, start: Vector | None = None, since: float | None = None) -> None:
        """Begin to search a way from where the machine is, or from a `start` (n,), to the plan from `since` [s] on."""
        servo, around = self._servo, self._blockage
        query = RejoiningQuery(
            robot=servo.robot,
            scene=servo.scene if self._legs is None else self._legs.leg.problem.scene,
            limits=servo.limits,
            obstacles=servo.snapshot(),
            q=servo.q if start is None else start,
            motion=self._motion_ahead(),
            since=self._plan.clock if since is None else since,
            seed=self._seed,
            attempt=self._attempts.failed if around is None else 0,
            beyond=around is not None,
        )
        self._searches.begin(servo.revision, servo.time, find_rejoining, query)

    def _motion_ahead(self) -> Trajectory:
        """The motion that a detour may rejoin: for a sequence, up to the end of the leg."""
        if self._legs is None:
            return self._trajectory
        rows = slice(0, self._legs.leg.last + 1)
        return Trajectory.from_steps(self._trajectory.time[rows], self._trajectory.q[rows])

    def _take_proof(self) -> None:
        """Take the answer whether the rest of the plan is clear: go along it, or search a detour ahead."""
        proof = self._proof.answer()
        if proof is None:
            return
        if proof.blockage is None:
            if self.ahead is not None:
                self._resume()
        elif not self._servo.is_moving():
            self._look_ahead(proof.blockage)

    def _look_ahead(self, blockage: Blockage) -> None:
        """Search a detour around a blockage from a place before it, if there is one on the present leg."""
        if self.holding or self._attempts.blocked or self.detour is not None:
            return
        if self.ahead is not None:
            if self.ahead.is_around(blockage):
                return
            self._resume()
        servo, plan = self._servo, self._plan
        if not blockage.ends or blockage.begins > self._motion_ahead().time[-1]:
            return
        if servo.time < self._ahead_from:
            self._proof.begin_again()
            return
        self._blockage = blockage
        approach = stop_before(plan, servo.limits, pace_along(plan, servo.v, servo.dt), blockage)
        if approach is not None:
            track = Track(approach, servo.limits, servo.dt)
            track.keep = self._track.keep
            track.revision, track.carried = servo.revision, servo.robot.carried  # proven up to the blockage
            self.ahead, self._ahead_from = DetourAhead(approach, track, blockage), servo.time + _AHEAD_AGAIN
            self._search(approach.last_q, approach.place)
        else:  # the sooner the machine rests, the more room it has
            self._hold()

    def _resume(self) -> None:
        """Go on along the plan, without waiting for a detour."""
        if self.holding or self.ahead is not None:
            self._searches.drop()
        self.ahead = self._blockage = None
        self.holding = False
        self._attempts.go_on()
        self._progress = Progress(self._slowest)

    def _take_answer(self) -> None:
        answer = self._searches.answer(self._servo.time)
        if answer is None:
            return
        if self.ahead is not None and isinstance(answer, Rejoining):
            self.ahead.found = answer
        elif self._blockage is not None and not isinstance(answer, Rejoining | bool):
            # the machine goes on as far as the plan leads, and searches with more effort there
            self._attempts.note_ahead(self._blockage.begins)
            if self.ahead is None:
                self._resume()
            else:
                self.ahead.failed = True
        elif self.detour is not None and self.detour.back is not None and self.detour.back.found is None:
            self.detour.take(answer)
        elif answer is False and self.detour is not None:  # the detour is no longer clear
            self.detour = None
            self._begin_holding()
        elif isinstance(answer, Rejoining):
            self.holding = False
            if float(np.abs(answer.motion.q[0] - self._servo.q).max()) <= _OFF:
                self._go_round(answer, self._searches.revision)
        elif not isinstance(answer, bool):
            final = isinstance(answer, NoRejoining) and not answer.searched
            reason = answer.reason if isinstance(answer, NoRejoining) else f"planning failed: {answer!s:.200}"
            self._note_failure(reason, self._searches.revision, final=final)

    # --- detours -------------------------------------------------------------------------

    def _go_round_ahead(self) -> None:
        """Begin the detour ahead once the machine is there; leave it if there is none, or something moves."""
        ahead, servo = self.ahead, self._servo
        if ahead is None:
            return
        if ahead.found is None and not self._searches.under_way:  # dropped, as the follower is closed
            ahead.failed = True
        if servo.is_moving() or (ahead.failed and (ahead.approach.ended or servo.revision != ahead.track.revision)):
            self._resume()
        elif ahead.found is not None and ahead.approach.ended and np.abs(self._plan.q - servo.q).max() < ON_PLAN:
            self.ahead = None
            self._attempts.begin(self._plan.clock)
            self._go_round(ahead.found, self._searches.revision)

    def _go_back(self) -> None:
        """Search a way back from a detour once the plan is clear without it, and begin it where it begins."""
        detour, servo = self.detour, self._servo
        if detour is None:
            return
        back = detour.back
        if back is None:
            if self.is_proven and not self._searches.under_way:
                back = detour.look_back(self._plan, servo.revision)
                if back is not None:
                    self._search(back.approach.last_q, back.since)
        elif back.found is None:
            if servo.revision != back.revision or back.is_late or not self._searches.under_way:
                self._searches.drop()
                detour.go_on()
        elif not self.is_proven:  # something is in the way again
            detour.go_on()
        elif back.approach.ended and np.abs(back.approach.last_q - servo.q).max() < ON_PLAN:
            self._searches.drop()
            self._go_round(back.found, back.revision)

    def _go_round(self, found: Rejoining, revision: int) -> None:
        """Begin a detour that is clear at a `revision` of the surroundings."""
        limits, keep = self._servo.limits, self._track.keep
        self.detour = Detour(found, limits, revision)
        part = PlanPart(0.0, None if keep is None else StopRule(keep, None))
        self.detour_paces = BrakingPace(self.detour.reference, limits, [part])
        self._progress = Progress(self._slowest)
        self._attempts.go_on()
        self._blockage = None

    def _watch_detour(self, deviation: float) -> None:
        """Go back to the plan at the end of the detour, and check that the detour is still clear."""
        found, servo = self.detour, self._servo
        assert found is not None
        if found.reference.ended and deviation < TOLERANCE:
            self.detour = None
            self._searches.drop()
            part = part_left_out(servo.robot, self._trajectory, self._plan.clock, found.rejoins_at)
            self.left_out += () if part is None else (part,)
            self._plan.clock = found.rejoins_at
            self._proof.begin_again()
            self.begin_to_join()
        elif servo.revision != found.checked and not self._searches.under_way and servo.time > found.check_at:
            found.checked, found.check_at = servo.revision, servo.time + _RECHECK
            rest = np.vstack((servo.q[None], found.reference.rest()))
            self._searches.begin(servo.revision, servo.time, is_still_clear, servo.robot, servo.snapshot(), rest)
