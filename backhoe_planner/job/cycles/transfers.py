"""The motions of a cycle through the air: to the cut, with the full bucket to the dump, and the opening there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.job.result.cycles import CycleLeg, LegName
from backhoe_planner.machine import Kinematics, TipTarget
from backhoe_planner.motion import Goal, Keep, PitchBand, Problem, Trajectory, trajectory_energy
from backhoe_planner.planning import EFFORTS, Effort, plan_motion
from backhoe_planner.proof import Certificate, certify_problem
from backhoe_planner.site import Obstacle

LEVEL = -np.pi  # rad: the pitch at which the mouth of a full bucket is level
_TILT = 0.6  # rad that a full bucket may be tilted in either direction; chosen, the usual angle of repose


@dataclass(frozen=True, eq=False)
class Transfer:
    """A motion through the air, or why there is none.

    Attributes
    ----------
    leg: the motion; None if there is none.
    why: the reason in words; empty if there is a motion.
    stands_in: what the machine is in or too near to at the start, if that is the reason; empty otherwise.
    """

    leg: CycleLeg | None
    why: str = ""
    stands_in: str = ""


class Transfers:
    """Plans motions through the air.

    Parameters
    ----------
    problem: the machine on its site without the ground.
    effort: name of the effort.
    seed: seed of every random choice.
    """

    def __init__(self, problem: Problem, *, effort: str, seed: int) -> None:
        self._problem = problem
        self._effort: Effort = EFFORTS[effort]  # type: ignore[index]
        self._seed = seed
        self._kinematics = Kinematics(problem.robot)

    def to(
        self,
        name: LegName,
        start: Vector,
        ends: Sequence[Vector],
        *,
        ground: Sequence[Obstacle],
        payload: float,
        level: bool = False,
    ) -> Transfer:
        """Plan from rest at `start` (n,) to rest at one of `ends`, each (n,).

        Parameters
        ----------
        name: name of the leg.
        ground: obstacles in addition to those of the site, as they are during the motion.
        payload: mass in the bucket [kg].
        level: whether the bucket's mouth faces up during the whole motion.
        """
        keep = Keep(self._problem.robot, [level_band(self._problem)]) if level else None
        problem = self.problem(start, ends, ground=ground, payload=payload, keep=keep)
        outcome, certificate = plan_motion(problem, effort=self._effort, seed=self._seed)
        if not certificate.verified:
            found = outcome.findings.obstruction if outcome.reason == "start_in_collision" else None
            why = outcome.message or "; ".join(certificate.problems)
            return Transfer(None, why, stands_in="" if found is None else found.name)
        return Transfer(make_leg(name, problem, outcome.trajectory, certificate))

    def problem(
        self,
        start: Vector,
        ends: Sequence[Vector],
        *,
        ground: Sequence[Obstacle],
        payload: float,
        keep: Keep | None = None,
    ) -> Problem:
        """The problem of one motion; see `to`."""
        return leg_problem(
            self._problem, start, ends, ground=ground, payload=payload, keep=keep, kinematics=self._kinematics
        )


def leg_problem(
    base: Problem,
    start: Vector,
    ends: Sequence[Vector],
    *,
    ground: Sequence[Obstacle],
    payload: float,
    keep: Keep | None,
    kinematics: Kinematics,
) -> Problem:
    """A problem for one motion of the machine from `start` (n,) to one of `ends`, each (n,).

    Parameters
    ----------
    base: the machine on its site without the ground.
    ground: obstacles in addition to those of the site.
    payload: mass in the bucket [kg].
    keep: constraints that hold during the whole motion.
    kinematics: kinematics of the machine.
    """
    goals = []
    for number, end in enumerate(ends, start=1):
        at = kinematics.at(end)
        name = "goal" if len(ends) == 1 else f"goal {number}"
        goals.append(Goal(TipTarget(at.tip_position, rotation=at.tip_rotation), q=end, name=name))
    scene = base.scene.model_copy(update={"payload": payload})
    return replace(
        base,
        scene=scene,
        obstacles=(*base.obstacles, *ground),
        start_q=np.asarray(start, dtype=float),
        start_target=None,
        goals=tuple(goals),
        path=None,
        keep=keep,
    )


def level_band(problem: Problem) -> PitchBand:
    """The pitch range that a full bucket keeps."""
    return PitchBand(problem.robot, LEVEL - _TILT, LEVEL + _TILT)


def make_leg(name: LegName, problem: Problem, motion: Trajectory, certificate: Certificate | None = None) -> CycleLeg:
    """A leg with its figures.

    Parameters
    ----------
    certificate: certificate of the motion, if it is known.
    """
    energy = trajectory_energy(problem, motion)
    hydraulic = float("nan") if energy.hydraulic is None else float(energy.hydraulic[-1])
    pump, engine = mean_use(problem, motion, hydraulic)
    return CycleLeg(
        name,
        problem,
        motion,
        certify_problem(problem, motion) if certificate is None else certificate,
        payload=problem.scene.payload,
        work=float(energy.work[-1]),
        hydraulic=hydraulic,
        pump=pump,
        engine=engine,
    )


def mean_use(problem: Problem, motion: Trajectory, hydraulic: float) -> tuple[float, float]:
    """The mean use of the pump's flow and of the engine's power over a motion; nan without hydraulics.

    Parameters
    ----------
    hydraulic: energy that the pump delivers [J].
    """
    hydraulics = problem.robot.hydraulics
    if hydraulics is None or motion.duration == 0.0:
        return float("nan"), float("nan")
    middle = 0.5 * (motion.q[1:] + motion.q[:-1])
    flow = hydraulics.total_flow(middle, motion.segment_velocities()) / hydraulics.pump_flow
    volume = float(np.sum(flow * np.diff(motion.time)))
    return volume / motion.duration, hydraulic / (hydraulics.power_limit * motion.duration)
