"""The site of a sequence that is followed: what is there for some legs only comes and goes with them."""

from __future__ import annotations

from backhoe_planner.errors import InputError
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.planning import Plan, PlannedLeg


class LegSite:
    """Puts the obstacles that are there for some legs only, and takes them away, as the plan goes on.

    Whatever else is put there or taken away by hand stays as it is.

    Parameters
    ----------
    servo: whose surroundings are kept in step with the plan.
    plan: of a sequence.

    Raises
    ------
    InputError: the machine carries something in a leg: a servo does not know its shape.
    """

    def __init__(self, servo: Servo, plan: Plan) -> None:
        for leg in plan.legs:
            if leg.problem.robot.carried is not None:
                raise InputError(
                    "a plan in which the machine carries something is not followed: the servo knows the machine alone",
                    key="plan", found=f"{leg.problem.robot.carried[0]} in leg {leg.name!r}",
                )  # fmt: skip
        self._servo, self._legs = servo, plan.legs
        self._some = {one.name: one for one in plan.problem.obstacles if one.spec.legs is not None and one.zone is None}
        self._away: set[str] = set()
        self._index = -1

    @property
    def leg(self) -> PlannedLeg:
        """The leg for which the site is now."""
        return self._legs[max(self._index, 0)]

    def enter(self, clock: float) -> bool:
        """Let the site be that of the leg at `clock` of the plan [s]; whether it is another leg than before."""
        index = sum(leg.begins <= clock for leg in self._legs) - 1
        if index == self._index:
            return False
        self._index = index
        name = self._legs[index].name
        for obstacle in self._some.values():
            here = name in (obstacle.spec.legs or ())
            if here and obstacle.name in self._away:
                self._away.discard(obstacle.name)
                if obstacle.name not in self._servo.obstacles:
                    self._servo.add(obstacle)
            elif not here and obstacle.name in self._servo.obstacles:
                self._servo.remove(obstacle.name)
                self._away.add(obstacle.name)
        return True
