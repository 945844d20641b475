"""The site while a sequence is followed: obstacles and loads of some legs only come and go with these legs."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from itertools import count
from weakref import WeakKeyDictionary

from backhoe_planner.errors import InputError
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.live.servo.surroundings import shifted
from backhoe_planner.planning import Plan, PlannedLeg
from backhoe_planner.site import Obstacle, offset_at

_AHEAD = 0.3  # s before a leg at which measuring its load begins; chosen, 60 pairs at steps of 20 ms


# by servo: the plans' obstacles that a follower took away, for it to bring them back, or another one after it
_AWAY: WeakKeyDictionary[Servo, set[str]] = WeakKeyDictionary()
# by servo: the names of those that came back under another one
_CALLED: WeakKeyDictionary[Servo, dict[str, str]] = WeakKeyDictionary()


class LegSite:
    """Adds and removes the obstacles that are present in some legs only, as the plan goes on.

    It does the same with what the machine carries. It leaves alone whatever else is added or removed by hand, also
    under the name of one of these obstacles: then the plan's own comes back under another name.

    Parameters
    ----------
    servo: its surroundings and load are kept in step with the plan.
    plan: of a sequence.

    Raises
    ------
    InputError: the machine carries something in a leg, and the servo's scene has no leg of that name with that load.
    """

    def __init__(self, servo: Servo, plan: Plan) -> None:
        self._servo, self._legs = servo, plan.legs
        self._carries = any(leg.problem.robot.carried is not None for leg in plan.legs)
        if self._carries:
            _check_loads(servo, plan)
        self._some = {one.name: one for one in plan.problem.obstacles if one.spec.legs is not None and one.zone is None}
        self._away, self._called = _AWAY.setdefault(servo, set()), _CALLED.setdefault(servo, {})
        self._index, self._begun = -1, servo.time

    @property
    def leg(self) -> PlannedLeg:
        """The leg that the site is set up for now."""
        return self._legs[max(self._index, 0)]

    def enter(self, clock: float) -> bool:
        """Set up the site for the leg at `clock` of the plan [s]; return whether it is another leg than before."""
        index = sum(leg.begins <= clock for leg in self._legs) - 1
        if self._carries and index + 1 < len(self._legs) and self._legs[index + 1].begins - clock < _AHEAD:
            self._servo.prepare_to_carry(self._legs[index + 1].name)
        if index == self._index:
            return False
        self._index = index
        name, servo = self._legs[index].name, self._servo
        here = {one.name: name in (one.spec.legs or ()) for one in self._some.values()}
        present = {one.name: one.spec for one in (*servo.snapshot(), *servo.waiting)} if self._some else {}
        for obstacle in [one for one in self._some if not here[one] and one not in self._away]:
            called = self._called.get(obstacle, obstacle)
            if present.get(called) == self._some[obstacle].spec:  # otherwise another one has that name
                servo.remove(called)
                self._away.add(obstacle)
        if self._carries:
            servo.carry(name)
        for obstacle in [one for one in self._some if here[one] and one in self._away]:
            self._away.discard(obstacle)
            self._called[obstacle] = self._add(self._some[obstacle])
        return True

    def _add(self, obstacle: Obstacle) -> str:
        """Add an obstacle to the servo, and return the name under which it is there."""
        passed = self._servo.time - self._begun  # more than on the plan's clock if the machine is late
        left = max(obstacle.appears_at - passed, 0.0)  # appears_at counts from the beginning of the plan
        obstacle = shifted(obstacle, offset_at(obstacle, passed))  # and it has moved since then
        for number in count(1):
            name = obstacle.name if number == 1 else f"{obstacle.name} ({number})"
            with contextlib.suppress(InputError):  # the name is in use: the obstacle itself is the plan's
                self._servo.add(replace(obstacle, name=name, appears_at=left))
                return name
        raise AssertionError


def _check_loads(servo: Servo, plan: Plan) -> None:
    """Check that the servo's scene has the plan's loads: a servo only knows the shapes that its own scene names."""
    known = {leg.name: leg.carries for leg in servo.scene.task.sequence or ()}
    for leg in plan.scene.task.sequence or ():
        same_files = plan.scene.folder == servo.scene.folder or not hasattr(leg.carries, "file")
        if leg.name not in known or known[leg.name] != leg.carries or not same_files:
            carried = "nothing" if leg.carries is None else leg.carries.name
            raise InputError(
                "the servo's scene does not have what the machine carries in a leg", key="plan",
                found=f"{carried} in leg {leg.name!r}", allowed="a servo of the plan's own scene",
            )  # fmt: skip
