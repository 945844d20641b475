"""The bound beside a plan to a goal: what no motion from its start could fall short of."""

from __future__ import annotations

from pydantic import Field

from backhoe_planner.files.records import Figure, Record
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.proof import Certificate, least_duration, least_duration_of_all, least_work

_SHORTEST = 0.005  # s: less is printed as 0.00 s, and a percentage of it says nothing


class Bound(Record):
    """What no motion from the start of a plan to any of its goals can fall short of.

    The duration follows from the machine, its limits in the scene and the goals alone. Obstacles, torques and
    engine power are left out, so that the fastest motion there is may well take longer. The energy
    is what is lifted; 0 where the goal may be as low as the start.
    """

    duration: Figure
    """No motion takes less [s]."""
    longer_percent: Figure
    """What the plan's motion takes longer than that [%]."""
    settled: bool
    """Whether the duration is as near as it is sought: to 1 % of the time to the posture in which the plan ends."""
    energy: dict[str, Figure] = Field(default_factory=dict)
    """What no motion costs less than, by objective and in its unit; where the plan minimises `work` or `hydraulic`."""

    @property
    def excess(self) -> str:
        """How much longer the plan takes, in words; empty where the bound itself rounds to 0."""
        return f"this one takes {self.longer_percent:.0f} % longer" if self.duration >= _SHORTEST else ""

    def least_energy(self, objective: str) -> float | None:
        """What is proven to be needed by the objective of this name [its unit]; None where that is nothing."""
        least = self.energy.get(objective, 0.0)
        return least if least > 0.0 else None


def measure_bound(problem: Problem, trajectory: Trajectory, certificate: Certificate, *, boxes: int) -> Bound | None:
    """The bound of the motions from where a plan begins; None along a path, and where the plan is not verified.

    Parameters
    ----------
    trajectory, certificate: the plan's motion, and what is proven of it.
    boxes: how many boxes of configurations may be looked at.
    """
    if not problem.goals or not certificate.verified:
        return None
    q, duration = trajectory.q, trajectory.duration
    found = least_duration(problem, q[0], known=duration, end=q[-1], boxes=boxes)
    least, settled = found.duration, found.settled
    # a motion that need not be fast makes it weak; nothing is less than the 0 s of a machine that stays
    if duration > 0.0 and not problem.objective.is_time:
        alone = least_duration_of_all(problem, q[0], boxes=boxes)
        least, settled = max(least, alone), settled and alone <= least
    longer = 100.0 * (duration / least - 1.0) if least > 0.0 else 0.0
    # of what is minimised alone: where that is the time, the work's bound is a third of the time for both
    lifted = least_work(problem, q[0], end=q[-1], boxes=boxes) if problem.objective.lifts else None
    energy = _least_energy(problem, lifted)
    return Bound(duration=least, longer_percent=longer, settled=settled, energy=energy)


def _least_energy(problem: Problem, work: float | None) -> dict[str, float]:
    """By objective, where no motion takes less than this `work` of the joints [J]."""
    if work is None:
        return {}
    hydraulics = problem.robot.hydraulics
    # the pump gives at least what the rods do, and these move all joints
    by_rods = hydraulics is not None and set(hydraulics.joint_of.tolist()) == set(range(problem.robot.n))
    return {"work": work} | ({"hydraulic": work} if by_rods else {})
