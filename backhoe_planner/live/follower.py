"""A plan, followed live: what turns up on the way slows, bends, holds or replans the motion.

The plan's own clock s runs slower the further the machine is off the plan:

    v_w = s' v_p(s) + min(k |e|, sqrt(a |e|)) sgn e,    e = q_p(s) - q,    s' = max(0, 1 - |e| / tolerance)

so that the machine waits for what is in its way, leaves the plan as far as it must, and
comes back to it. Where that leads nowhere for a while, the machine holds still, and a
way from there to the earliest place of the rest of the plan that is clear is searched
beside the loop (`rejoining`). It is followed by the same law under the same servo; the
rest of the plan behind it is unchanged. Whatever is planned, the servo alone decides
what is safe.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from types import TracebackType
from typing import Any

import numpy as np

from backhoe_planner.arrays import Array, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.live.rejoining import NoRejoining, Rejoining, RejoiningQuery, find_rejoining, is_still_clear
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.live.servo.servo_state import ServoState
from backhoe_planner.motion import Trajectory
from backhoe_planner.planning import Plan

_PULL = 10.0  # 1/s
_PART = 0.5  # of the acceleration that the way back onto the plan is braked with
_TOLERANCE = 0.03  # rad or m off the plan at which its clock stands still
_ARRIVED = 1e-3  # rad or m
_AT_REST = 1e-2  # rad/s or m/s, at the end of the plan
_STILL = 1e-6  # rad/s or m/s, where a way is to begin
_PUSHED = 0.2  # rad or m further off than it was, that is not sliding but giving way
_NEAR = 0.05  # m of margin within which an obstacle is said to be what holds it back
_NOTICED = 0.3  # s without getting on after which it says that it waits
_PATIENCE = 1.0  # s without getting on after which a way round is searched,
_PATIENCE_CROSSING = 4.0  # where what holds the machine moves
_WINDOW = 0.4  # s in which it must get on noticeably:
_PACE = 0.05  # of the planned speed,
_APPROACH = 0.1  # or of the slowest joint's greatest, nearer to the plan
_FURTHER = 0.1  # s of the plan beyond the place where it was stuck after which that is over
_LONGEST_SEARCH = 30.0  # s of the servo after which a search is given up
_ATTEMPTS = 4  # in a row before it says that it is blocked
_LONGEST_BREAK = 16.0  # s between two searches that found nothing
_OFF = 0.1  # rad or m that the machine may be from where a way begins
_RECHECK = 0.2  # s between two checks of a way while what stands around changes


class FollowerStatus(str, Enum):
    """How it goes with a plan that is being followed."""

    FOLLOWING = "following"
    WAITING = "waiting"
    GOING_ROUND = "going_round"
    BLOCKED = "blocked"
    ARRIVED = "arrived"


@dataclass(frozen=True)
class FollowerState:
    """One step of a plan that is being followed.

    Attributes
    ----------
    state: of the servo.
    plan_time: how far the plan's clock has come [s].
    behind: how much later it is than planned [s].
    deviation: of the farthest joint from the plan at `plan_time` [rad or m].
    done: the end of the plan is reached, at rest.
    status: ``following``; ``waiting``: it does not get on, and a way round is searched
        unless it soon does; ``going_round``: on a way that rejoins the plan; ``blocked``:
        no way was found, it goes on trying; ``arrived``.
    reason: what it waits for, goes round, or is blocked by, in words; else empty.
    """

    state: ServoState
    plan_time: float
    behind: float
    deviation: float
    done: bool
    status: FollowerStatus
    reason: str


class PlanFollower:
    """Drives a servo along a plan, one step after the other.

    Parameters
    ----------
    servo: its machine must have the plan's joints. Where it stands off the plan's
        beginning it goes there first.
    plan: a plan, or its trajectory alone.
    executor: in which ways round are searched (0.1 to 8 s each). By default one thread of
        its own, which shares the interpreter with the loop: a step may then come some
        milliseconds late while the machine holds still. A `ProcessPoolExecutor` avoids that.
    seed: of the searches, not negative.

    Raises
    ------
    InputError: the plan has no motion, other joints or another number of them; seed is negative.

    `step` itself raises nothing. `close`, or leaving it as a context manager, ends its own
    thread, after the search that is under way.
    """

    def __init__(
        self, servo: Servo, plan: Plan | Trajectory, *, executor: Executor | None = None, seed: int = 0
    ) -> None:
        robot = servo.robot
        if isinstance(plan, Plan) and plan.robot.joint_names != robot.joint_names:
            found, own = ", ".join(plan.robot.joint_names), ", ".join(robot.joint_names)
            raise InputError(
                "is a plan for other joints than the machine's", key="plan.robot", found=found, allowed=own
            )
        trajectory = plan.trajectory if isinstance(plan, Plan) else plan
        count = trajectory.q.shape[1]
        if count != robot.n:
            wrong = "has another number of joints than the machine"
            raise InputError(wrong, key="plan.trajectory", found=count, allowed=str(robot.n))
        if seed < 0:
            raise InputError("must not be negative", key="seed", found=seed)
        self.servo = servo
        self._trajectory = trajectory
        self._plan = _Reference(trajectory)
        self._round: _Round | None = None
        self._steps = 0
        self._slowest = float(servo.limits.velocity.min())
        self._progress = _Progress(self._slowest)
        self._searches = _Searches(executor)
        self._seed = seed
        self._failed = 0  # searches in a row that found nothing, or a way that led nowhere
        self._stuck_at = -np.inf  # s of the plan
        self._again_at = 0.0  # s: when to search again
        self._failed_at, self._failed_for = 0.0, -1  # s; revision of the surroundings
        self._may_succeed = True  # with more effort
        self._was_holding = False
        self._holding = False
        self._blocked = ""
        self._retrying = False

    def __enter__(self) -> PlanFollower:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the searching. Steps after that follow the plan, but go round nothing new."""
        self._searches.close()

    @property
    def done(self) -> bool:
        """Whether the end of the plan is reached, at rest."""
        servo = self.servo
        off = float(np.abs(self._plan.q[-1] - servo.q).max())
        return self._plan.ended and off < _ARRIVED and bool((np.abs(servo.v) < _AT_REST).all())

    def step(self) -> FollowerState:
        """Move on by the servo's dt."""
        servo = self.servo
        self._steps += 1
        self._take_answer()
        if self._must_hold():
            self._was_holding = True
            state = servo.step(joint_velocity=np.zeros(servo.robot.n))
            if not self._searches.under_way and float(np.abs(state.v).max()) < _STILL:
                if self._holding:
                    self._search()
                elif self._may_succeed and servo.time >= self._again_at:
                    # along the plan once more, and only where that still leads nowhere another search
                    self._retrying = True
        else:
            if self._was_holding:
                self._was_holding = False
                self._progress = _Progress(self._slowest)
            state = self._follow(self._plan if self._round is None else self._round.reference)
        deviation = float(np.abs(self._plan.at()[0] - state.q).max())
        done = self._plan.ended and deviation < _ARRIVED and self.done
        status, reason = self._status(state, done)
        return FollowerState(
            state=state,
            plan_time=self._plan.clock,
            behind=max(self._steps * servo.dt - self._plan.clock, 0.0),
            deviation=deviation,
            done=done,
            status=status,
            reason=reason,
        )

    def _must_hold(self) -> bool:
        """Whether it is to hold still: while a way is searched, and where there is none as long as nothing changes."""
        servo = self.servo
        if self._holding:
            return not self._searches.under_way or servo.revision == self._searches.revision
        return (
            bool(self._blocked) and not self._retrying and servo.revision == self._failed_for and not servo.is_moving()
        )

    # --- along a reference -------------------------------------------------------------

    def _follow(self, reference: _Reference) -> ServoState:
        servo = self.servo
        goal, rates = reference.at()
        off = goal - servo.q
        deviation = float(np.abs(off).max())
        pace = max(0.0, 1.0 - _late(off, rates) / _TOLERANCE)
        # no faster towards it than can be braked away again
        size = np.abs(off)
        pull = np.copysign(np.minimum(_PULL * size, np.sqrt(2.0 * _PART * servo.limits.acceleration * size)), off)
        state = servo.step(joint_velocity=pace * rates + pull)
        reference.advance(pace * servo.dt)
        if self._progress.made(reference.clock, deviation, servo.dt):
            self._got_on()
        elif self._progress.waited > _PATIENCE and not (
            reference is self._plan and reference.ended and deviation < _ARRIVED
        ):
            self._lose_patience(state)
        if self._round is not None:
            self._watch_round(deviation)
        return state

    def _got_on(self) -> None:
        if self._holding:  # what was in the way has gone meanwhile
            self._searches.drop()
        self._holding = self._retrying = False
        self._blocked = ""
        if self._round is None and self._plan.clock > self._stuck_at + _FURTHER:
            self._failed = 0
            self._again_at = 0.0

    def _lose_patience(self, state: ServoState) -> None:
        servo = self.servo
        crossing = state.obstacle is not None and servo.is_moving(state.obstacle)
        if self._holding or (crossing and self._progress.waited < _PATIENCE_CROSSING):
            return
        changed = servo.revision != self._failed_for and servo.time > self._failed_at + _PATIENCE
        if changed or servo.time >= self._again_at:
            self._searches.drop()
            self._stuck_at = self._plan.clock
            self._holding, self._retrying = True, False
            if self._round is not None:  # it led nowhere: another one
                self._round = None
                self._note_failure(f"a way round was found, but {self._held_by(state)}", servo.revision)

    def _note_failure(self, reason: str, revision: int, *, final: bool = False) -> None:
        """Another attempt, or, after several or where no effort helps, a break."""
        self._failed = max(self._failed + 1, _ATTEMPTS if final else 0)
        self._retrying = False
        self._failed_at, self._failed_for, self._may_succeed = self.servo.time, revision, not final
        if self._failed >= _ATTEMPTS:
            self._blocked = reason
            self._holding = False
            self._again_at = self.servo.time + min(2.0 ** (self._failed - _ATTEMPTS), _LONGEST_BREAK)

    def _watch_round(self, deviation: float) -> None:
        """Back on the plan at the end of the way round; given up where it is no longer clear."""
        found, servo = self._round, self.servo
        assert found is not None
        if found.reference.ended and deviation < _TOLERANCE:
            self._round = None
            self._searches.drop()
            self._plan.clock = found.rejoins_at
            self._progress = _Progress(self._slowest)
        elif servo.revision != found.checked and not self._searches.under_way and servo.time > found.check_at:
            found.checked, found.check_at = servo.revision, servo.time + _RECHECK
            rest = np.vstack((servo.q[None], found.reference.rest()))
            self._searches.begin(servo.revision, servo.time, is_still_clear, servo.robot, servo.snapshot(), rest)

    # --- searches beside the loop --------------------------------------------------------

    def _search(self) -> None:
        servo = self.servo
        query = RejoiningQuery(
            robot=servo.robot,
            scene=servo.scene,
            limits=servo.limits,
            obstacles=servo.snapshot(),
            q=servo.q,
            motion=self._trajectory,
            since=self._plan.clock,
            seed=self._seed,
            attempt=self._failed,
        )
        self._searches.begin(servo.revision, servo.time, find_rejoining, query)

    def _take_answer(self) -> None:
        answer = self._searches.answer(self.servo.time)
        if answer is None:
            return
        servo = self.servo
        if answer is False and self._round is not None:  # the way round is no longer clear
            self._round = None
            self._holding = True
        elif isinstance(answer, Rejoining):
            self._holding = False
            if float(np.abs(answer.motion.q[0] - servo.q).max()) > _OFF:
                return
            self._round = _Round(
                _Reference(answer.motion), answer.rejoins_at, answer.around, checked=self._searches.revision
            )
            self._progress = _Progress(self._slowest)
            self._blocked = ""
        elif not isinstance(answer, bool):
            final = isinstance(answer, NoRejoining) and not answer.searched
            reason = answer.reason if isinstance(answer, NoRejoining) else f"planning failed: {answer!s:.200}"
            self._note_failure(reason, self._searches.revision, final=final)

    # --- how it goes --------------------------------------------------------------------

    def _status(self, state: ServoState, done: bool) -> tuple[FollowerStatus, str]:
        if done:
            return FollowerStatus.ARRIVED, ""
        if self._blocked:
            return FollowerStatus.BLOCKED, self._blocked
        if self._holding or self._progress.waited > _NOTICED:
            return FollowerStatus.WAITING, self._held_by(state)
        if self._round is not None:
            return FollowerStatus.GOING_ROUND, "" if self._round.around is None else f"round {self._round.around}"
        return FollowerStatus.FOLLOWING, ""

    @staticmethod
    def _held_by(state: ServoState) -> str:
        if state.obstacle is None or state.margin > _NEAR:
            return "it is off the plan"
        return f"{state.link} is held back by {state.obstacle}"


class _Reference:
    """A motion with a clock of its own."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.time, self.q = trajectory.time, trajectory.q
        self._rates = trajectory.segment_velocities() if len(trajectory) > 1 else np.zeros_like(self.q)
        self._end = float(self.time[-1])
        self.clock = 0.0

    @property
    def ended(self) -> bool:
        return self.clock >= self._end

    def advance(self, by: float) -> None:
        self.clock = min(self.clock + by, self._end)

    def at(self) -> tuple[Vector, Vector]:
        """(n,), (n,) joint positions and rates now."""
        row = min(max(int(self.time.searchsorted(self.clock, side="right")) - 1, 0), len(self._rates) - 1)
        rates = self._rates[row]
        q = self.q[row] + (self.clock - float(self.time[row])) * rates
        return q, np.zeros_like(rates) if self.ended else rates

    def rest(self) -> Array:
        """(K, n) samples that are still to come."""
        return np.asarray(self.q[int(self.time.searchsorted(self.clock, side="right")) :])


@dataclass
class _Round:
    """A way round that is being followed."""

    reference: _Reference
    rejoins_at: float
    around: str | None
    checked: int  # revision of the surroundings for which it is known to be clear
    check_at: float = 0.0


def _late(off: Vector, rates: Vector) -> float:
    """How far the machine is off the plan [rad or m], where that is a reason for its clock to wait.

    Ahead of the plan is none: a clock that waited for that would ask a machine that brakes as hard as it
    can to brake harder still, and it would run further ahead.
    """
    along = float(off @ rates)
    if along < 0.0:
        off = off - (along / float(rates @ rates)) * rates
    return float(np.abs(off).max())


class _Progress:
    """Notices when neither the clock goes on nor the machine comes nearer to its place than it was.

    Sliding to and fro before an obstacle is not getting on.

    Attributes
    ----------
    waited: how long it has not got on [s], window by window.
    """

    def __init__(self, slowest: float) -> None:
        self.waited = 0.0
        self._approach = _APPROACH * _WINDOW * slowest
        self._clock = self._nearest = np.inf
        self._looked = 0.0

    def made(self, clock: float, deviation: float, dt: float) -> bool:
        """Whether this step is one in which it got on noticeably."""
        if deviation > self._nearest + _PUSHED or self._clock == np.inf:
            self._clock, self._nearest = clock, deviation
        self._looked += dt
        if clock > self._clock + _PACE * _WINDOW or deviation < self._nearest - self._approach:
            self._clock, self._nearest, self._looked, self.waited = clock, deviation, 0.0, 0.0
            return True
        if self._looked > _WINDOW:
            self.waited += self._looked
            self._clock, self._looked = clock, 0.0
        return False


class _Searches:
    """One call at a time in an executor, which is made where none was given."""

    def __init__(self, executor: Executor | None) -> None:
        self._executor = executor
        self._own: ThreadPoolExecutor | None = None
        self._future: Future[Any] | None = None
        self._closed = False
        self._begun = 0.0
        self.revision = -1

    @property
    def under_way(self) -> bool:
        return self._future is not None

    def begin(self, revision: int, now: float, function: Callable[..., Any], *args: Any) -> None:
        self.revision, self._begun = revision, now
        try:
            if self._closed:
                raise RuntimeError("the follower is closed")
            self._future = self._pool().submit(function, *args)
        except Exception as error:  # noqa: BLE001  no exception may leave the loop
            self._future = Future()
            self._future.set_exception(error)

    def answer(self, now: float) -> Any:
        """The result of the call, or the exception that it ended with; None while it runs."""
        future = self._future
        if future is None:
            return None
        if not future.done():
            if now - self._begun < _LONGEST_SEARCH:
                return None
            self.drop()
            return TimeoutError(f"no answer within {_LONGEST_SEARCH:g} s")
        self._future = None
        try:
            found = future.exception() or future.result()
        except CancelledError as error:  # by whoever owns the executor
            return error
        return TypeError("no answer came back") if found is None else found

    def drop(self) -> None:
        """Ask for the answer no longer."""
        if self._future is not None:
            self._future.cancel()
            self._future = None

    def close(self) -> None:
        self._closed = True
        self.drop()
        if self._own is not None:
            self._own.shutdown(wait=True, cancel_futures=True)

    def _pool(self) -> Executor:
        if self._executor is not None:
            return self._executor
        if self._own is None:
            self._own = ThreadPoolExecutor(max_workers=1, thread_name_prefix="rejoining")
            weakref.finalize(self, self._own.shutdown, wait=False, cancel_futures=True)
        return self._own
