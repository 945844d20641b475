"""The lower bounds for any motion from the start of a plan to its goals."""

from __future__ import annotations

from pydantic import Field

from backhoe_planner.files.records import Figure, Record
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.proof import Certificate, least_duration, least_duration_of_all, least_work

_SHORTEST = 0.005  # s: a smaller bound is printed as 0.00 s, and a percentage of it says nothing


class Bound(Record):
    """Lower bounds for any motion from the start of a plan to any of its goals.

    The duration follows from the machine, its limits in the scene and the goals alone. Obstacles, torques and
    engine power are left out, so that even the fastest possible motion may take longer. The energy
    is what is lifted; 0 if the goal may be as low as the start.
    """

    duration: Figure
    """A lower bound on the duration of any motion [s]."""
    longer_percent: Figure
    """How much longer than that the plan's motion takes [%]."""
    settled: bool
    """Whether the bound is as tight as is sought: to 1 % of the least time to the posture in which the plan ends."""
    energy: dict[str, Figure] = Field(default_factory=dict)
    """Lower bounds on the cost, by objective and in its unit; if the plan minimises `work` or `hydraulic`."""

    @property
    def excess(self) -> str:
        """How much longer the plan takes, in words; empty if the bound itself rounds to 0."""
        return f"this one takes {self.longer_percent:.0f} % longer" if self.duration >= _SHORTEST else ""

    def least_energy(self, objective: str) -> float | None:
        """The proven lower bound by the objective of this name [its unit]; None if there is none above 0."""
        least = self.energy.get(objective, 0.0)
        return least if least > 0.0 else None


def measure_bound(problem: Problem, trajectory: Trajectory, certificate: Certificate, *, boxes: int) -> Bound | None:
    """The bounds for motions from the start of a plan; None along a path, and if the plan is not verified.

    Parameters
    ----------
    trajectory, certificate: of the plan.
    boxes: how many boxes of configurations may be examined.
    """
    if not problem.goals or not certificate.verified:
        return None
    q, duration = trajectory.q, trajectory.duration
    found = least_duration(problem, q[0], known=duration, end=q[-1], boxes=boxes)
    least, settled = found.duration, found.settled
    # a slow motion makes this bound weak; for a machine that stays, no bound can be above 0 s
    if duration > 0.0 and not problem.objective.is_time:
        alone = least_duration_of_all(problem, q[0], boxes=boxes)
        least, settled = max(least, alone), settled and alone <= least
    longer = 100.0 * (duration / least - 1.0) if least > 0.0 else 0.0
    # only if work is minimised: beside the bound of the time it would take a third of the computing time of both
    lifted = least_work(problem, q[0], end=q[-1], boxes=boxes) if problem.objective.lifts else None
    energy = _least_energy(problem, lifted)
    return Bound(duration=least, longer_percent=longer, settled=settled, energy=energy)


def _least_energy(problem: Problem, work: float | None) -> dict[str, float]:
    """The lower bounds by objective, from that of the joints' `work` [J]; empty if it is None."""
    if work is None:
        return {}
    hydraulics = problem.robot.hydraulics
    # the pump delivers at least the work of the rods, if they move all joints
    by_rods = hydraulics is not None and set(hydraulics.joint_of.tolist()) == set(range(problem.robot.n))
    return {"work": work} | ({"hydraulic": work} if by_rods else {})
