"""What a step of the servo tells: its status, what is nearest, what is refused, and the force on the hand."""

from __future__ import annotations

import math

import numpy as np

from backhoe_planner.arrays import Indices, Vector
from backhoe_planner.live.braking.braking_path import STEP_END, JointState
from backhoe_planner.live.braking.step_work import MOST_TOLD
from backhoe_planner.live.clearance.pair_bounds import CLOSE, Near
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.live.planes.narrow_phase import measure_pair
from backhoe_planner.live.planes.plane_gaps import world_normal
from backhoe_planner.live.servo.commands import Commands
from backhoe_planner.live.servo.feedback import Feedback, Recently, Refusal, refused_part
from backhoe_planner.live.servo.safe_velocity import SafeVelocity, VelocityWish
from backhoe_planner.live.servo.servo_state import Command, ServoState, Status
from backhoe_planner.live.servo.surroundings import Surroundings
from backhoe_planner.live.servo.tip_task import JointWish, TipTask
from backhoe_planner.site import Obstruction

_CREEPS = 1e-3  # rad/s or m/s: a slower machine counts as stopped; chosen, too slow to be seen
_PARTLY = 0.1  # refused part of the wish above which a machine near an obstacle counts as sliding along it; chosen
_LOST = 1e-3  # m by which a distance falls short of its clearance from which the pair is told as too close; chosen
_MOSTLY = 0.5  # refused part of the wish above which a machine at rest counts as held; chosen


class StepReport:
    """Makes the `ServoState` of each step of one servo.

    Parameters
    ----------
    check: of the servo's braking paths; its placements hold the machine at the beginning of the step in row 0.
    tip, commands, site: of the servo.
    feedback: computes the force on the hand.
    influence: margin within which obstacles are named [m].
    """

    def __init__(
        self, check: PathCheck, tip: TipTask, commands: Commands, site: Surroundings,
        *, feedback: Feedback, influence: float,
    ) -> None:  # fmt: skip
        self._separation, self._bounds, self._at = check.separation, check.bounds, check.at
        self._tip, self._commands, self._site = tip, commands, site
        self._feedback, self._influence = feedback, influence
        dt = check.joints.dt
        self._refusal = Refusal(dt, check.joints.changes)
        self._held_back, self._gives_way = Recently(dt), Recently(dt)

    def after_step(
        self, state: JointState, time: float, command: Command, near: Near, wish: JointWish, request: VelocityWish,
        chosen: SafeVelocity, pace: float,
    ) -> ServoState:  # fmt: skip
        """The state at `time` [s] after a step that was chosen.

        Parameters
        ----------
        state: of the joints, after the step.
        command: what became of the command.
        near: the pairs that were near.
        wish, request: of the joints, and what was asked of the filter.
        chosen: the velocity of the step.
        pace: part of the wished speed that the zones allow.
        """
        v, J = state.v, self._tip.jacobian[:3]
        pair, margin = self._bounds.tightest(near)
        nearest, normal = self._nearest(pair, margin, time), _ZERO
        if nearest is None:
            margin = math.inf
        elif margin < CLOSE:
            normal = world_normal(self._separation, pair, self._at)
        self._tip.blocking = normal if chosen.held_back else _ZERO
        beyond = self._refusal.next(v, wish=request.v, target=request.target)
        difference = J.dot(beyond - request.v) + wish.tip
        nearness = 0.5 * (1.0 + math.cos(math.pi * min(max(margin / CLOSE, 0.0), 1.0)))
        force, refused = self._feedback.next(wish.tip, difference, normal, nearness), refused_part(wish.tip, difference)
        status = self._status(
            v, command, margin, wish.tip, refused, held_back=chosen.held_back, evading=chosen.evading,
            at_limit=request.range.cuts_wish, singular=wish.singular,
        )  # fmt: skip
        lost = self._lost_clearance(state.q, near.pairs, time) if margin < -_LOST else None
        if lost is not None:
            status, nearest = Status.TOO_CLOSE, lost
        proven = chosen.end is not None
        return self._state(state, time, command, status, nearest, refused, force, proven=proven, pace=pace)

    def after_braking(
        self, state: JointState, time: float, command: Command, *, failed: bool, straight: bool
    ) -> ServoState:
        """The state at `time` [s] after a step in which nothing new was proven, or that failed; see `after_step`.

        straight: whether the machine braked straight ahead, along the path that was proven before.
        """
        J, commands = self._tip.jacobian[:3], self._commands
        wish = _ZERO if commands.tip is None else commands.tip
        if commands.joints is not None:
            wish = J.dot(commands.joints)
        pair, margin = self._bounds.tightest_of_all()
        nearest, force = self._nearest(pair, margin, time), self._feedback.next(wish, _ZERO, _ZERO, 0.0)
        refused = refused_part(wish, wish - J.dot(state.v))
        status = self._status(state.v, command, margin, wish, refused, held_back=True)
        lost = self._lost_clearance(state.q, None, time, straight=straight) if margin < -_LOST else None
        if lost is not None:
            status, nearest = Status.TOO_CLOSE, lost
        status = Status.STOPPED if failed else status
        return self._state(state, time, command, status, nearest, refused, force, proven=False, pace=1.0)

    def _state(
        self, state: JointState, time: float, command: Command, status: Status, nearest: Obstruction | None,
        refused: Vector, force: Vector, *, proven: bool, pace: float,
    ) -> ServoState:  # fmt: skip
        tip = self._tip
        return ServoState(
            time=time,
            q=state.q.copy(),
            v=state.v.copy(),
            status=status,
            command=command,
            nearest=nearest,
            tip_position=tip.position,
            tip_velocity=tip.jacobian[:3].dot(state.v),
            refused=refused,
            feedback_force=force,
            proven=proven,
            pace=pace,
        )

    def _nearest(self, pair: int, margin: float, time: float) -> Obstruction | None:
        """The tightest pair as an obstruction; None if it is beyond the influence distance."""
        return self._site.obstruction(pair, margin, time) if margin < self._influence else None

    def _lost_clearance(
        self, q: Vector, pairs: Indices | None, time: float, *, straight: bool = True
    ) -> Obstruction | None:
        """The worst of `pairs` (K,), or of all, that are too close at q (n,), at the end of the step; None if none is.

        Bounds may be far below the distance of what moves, so the few pairs with the least are measured.

        Parameters
        ----------
        time: at the end of the step [s].
        straight: whether the machine keeps to what was proven of its braking straight ahead. A box of a scan may be
            nearer than all its cells, for which the required distance was proven.
        """
        if pairs is None:
            pairs = np.arange(len(self._separation), dtype=np.intp)
        distance = self._bounds.kept(pairs) if straight else self._bounds.lower()[pairs]
        clearance = self._separation.clearance[pairs]
        left, worst, short = distance - clearance, -_LOST, -1
        self._at.place(STEP_END, q)
        for row in np.argsort(left)[:MOST_TOLD].tolist():
            if left[row] >= worst:
                break
            found = measure_pair(self._separation, int(pairs[row]), self._at, STEP_END)
            margin = found.distance - float(clearance[row])
            if margin < worst:
                worst, short = margin, int(pairs[row])
        return None if short < 0 else self._site.obstruction(short, worst, time)

    def _status(
        self, v: Vector, command: Command, margin: float, wish: Vector, refused: Vector,
        *, held_back: bool, evading: bool = False, at_limit: bool = False, singular: bool = False,
    ) -> Status:  # fmt: skip
        """What the servo does after a step. `wish` (3,) is the tip's, and `refused` (3,) the part not followed."""
        held_back, asks = self._held_back.next(holds=held_back), self._commands.asks
        if evading:
            return Status.EVADING
        if max(map(abs, v.tolist())) <= _CREEPS:
            # a machine that begins to move, or that has no wish to move, is slow as well
            held = asks and (held_back or at_limit or refused.dot(refused) > _MOSTLY**2 * wish.dot(wish))
            if held or command in (Command.TIMED_OUT, Command.INVALID):
                return Status.STOPPED
        # the chosen velocity may equal the wish of the joints when that already gave way to an obstacle nearby
        gives_way = margin < CLOSE and refused.dot(refused) > _PARTLY**2 * wish.dot(wish)
        if asks and (held_back or self._gives_way.next(holds=bool(gives_way))):
            return Status.SLIDING
        if margin < CLOSE:
            return Status.NEAR_OBSTACLE
        if at_limit:
            return Status.NEAR_LIMIT
        return Status.NEAR_SINGULARITY if singular else Status.OK


_ZERO = np.zeros(3)
_ZERO.setflags(write=False)
