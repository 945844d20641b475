"""A plan: what was asked, the motion that was found, and what is proven of it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import MotionEnergy, Robot
from backhoe_planner.motion import Trajectory, build_problem, trajectory_energy
from backhoe_planner.proof import Certificate
from backhoe_planner.site import Scene

__all__ = ["METHODS", "Method", "Plan", "Reason"]

Method = Literal["auto", "reactive", "optimal", "paper", "teleop"]
# those that plan; "teleop" was driven by hand
METHODS: tuple[Method, ...] = ("auto", "reactive", "optimal", "paper")

Reason = Literal["", "unreachable", "start_in_collision", "goal_in_collision", "outside_limits", "blocked", "budget"]


@dataclass(frozen=True, eq=False)
class Plan:
    """The result of planning, verified or not.

    Attributes
    ----------
    verdict: ``verified`` is said only by the certificate.
    reason: why it failed, one of `Reason`; empty where verified.
    message: the same in a sentence, with its numbers.
    robot: the machine, as it was planned for.
    scene: as it was given.
    method, seed: as they were asked.
    trajectory: the motion; where planning failed, the best that was found, which may
        be the start alone.
    certificate: what is proven of it.
    metrics: duration [s], planning_time [s], path lengths [m], what the motion costs by
        every objective; along a path also ``objective``: what was made small, beside what
        the local law needs.
    details: numbers behind `reason`.
    """

    verdict: Literal["verified", "failed"]
    reason: Reason
    message: str
    robot: Robot
    scene: Scene
    method: Method
    seed: int
    trajectory: Trajectory
    certificate: Certificate
    metrics: Mapping[str, Any]
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def verified(self) -> bool:
        """Whether the certificate holds."""
        return self.verdict == "verified"

    def tip_path(self) -> NDArray[np.float64]:
        """(T, 3) positions of the tip at the samples [m], world."""
        from backhoe_planner.machine import Kinematics

        kinematics = Kinematics(self.robot)
        return np.array([kinematics.at(q).tip_position for q in self.trajectory.q])

    def energy(self) -> MotionEnergy:
        """Torques, power and work over the samples, with the scene's payload and soil."""
        return trajectory_energy(build_problem(self.robot, self.scene), self.trajectory)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan file (JSON), whole or not at all.

        Raises
        ------
        OutputError: the folder does not exist or cannot be written.
        """
        from backhoe_planner.planning.result.plan_file import save_plan

        save_plan(self, path)
