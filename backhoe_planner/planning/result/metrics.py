"""The figures of a motion: time, lengths, energy, detours, and the comparison with the local law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.files.records import Figure, Record
from backhoe_planner.machine import BatchKinematics
from backhoe_planner.motion import Detour, Problem, Trajectory, trajectory_costs
from backhoe_planner.planning.report.asked_speed import AskedSpeed, measure_speed
from backhoe_planner.planning.report.comparison import LawComparison, compare_with_law
from backhoe_planner.planning.stretches.stretch import LawWay
from backhoe_planner.proof import Certificate
from backhoe_planner.site import Obstruction

_APART = 0.05  # m: chosen; a measured detour begins and ends at most this far from where it was planned


class DetourTotal(Record):
    """All detours together."""

    count: int = 0
    """Number of detours."""
    length: Figure
    """Of the tip's route off the path [m]."""
    max_deviation: Figure
    """Largest distance from the path [m]."""


class ObjectiveCost(Record):
    """The cost of a motion by the objective for which it was planned."""

    objective: str
    """Its name, as in the scene file; without one there, ``time`` to a goal and ``work`` along a path."""
    value: Figure
    """Of the whole motion [unit]."""
    unit: str


class Metrics(Record):
    """The figures of a motion."""

    duration: Figure
    """[s]"""
    planning_time: Figure
    """[s]; 0 for a motion driven by hand."""
    tip_length: Figure = float("nan")
    """Length of the tip's path [m]."""
    joint_length: Figure = float("nan")
    """Length of the joint-space path, by the Euclidean norm of rad and m."""
    energy: dict[str, Figure]
    """The cost of the motion by every objective, each in its own unit."""
    cost: ObjectiveCost | None = None
    """The cost by the objective that was minimised; None for a sequence whose legs have different ones, of which each
    leg has its own, and in older files."""
    detour: DetourTotal
    """All detours together."""
    detours: tuple[Detour, ...] = ()
    """Each detour, with what it goes around."""
    objective: LawComparison | None = None
    """The cost of the motion along a path compared with that of the local law; None without a path."""
    asked_speed: AskedSpeed | None = None
    """How well the scene's speed is kept; None if the scene gives no speed."""


def measure_motion(
    problem: Problem,
    trajectory: Trajectory,
    certificate: Certificate,
    *,
    planning_time: float = 0.0,
    detours: Sequence[Obstruction] = (),
    compare: bool = False,
    law: LawWay | None = None,
) -> Metrics:
    """The figures of a motion.

    Parameters
    ----------
    certificate: of the motion.
    planning_time: of the planner [s].
    detours: what the planner left the path for, and where.
    compare: whether a motion along a path is compared with the local law's.
    law: how the law follows the path, if that is known.
    """
    tips = BatchKinematics(problem.robot).tip_positions(trajectory.q)
    found = tuple(_with_obstruction(detour, detours) for detour in certificate.detours)
    compared = compare_with_law(problem, trajectory, certificate, law=law) if compare else None
    figures = None if compared is None else compared.figures
    if figures is not None and found:
        figures = figures.model_copy(update={"law_breaks": found[0].obstruction})
    speed = None
    if problem.path is not None and certificate.tracking.done:
        speed = measure_speed(problem, trajectory, begun=certificate.tracking.approach_time)
    energy, objective = trajectory_costs(problem, trajectory), problem.objective
    return Metrics(
        duration=trajectory.duration,
        planning_time=planning_time,
        tip_length=float(np.sum(np.linalg.norm(np.diff(tips, axis=0), axis=1))),
        joint_length=float(np.sum(np.linalg.norm(np.diff(trajectory.q, axis=0), axis=1))),
        energy=energy,
        cost=None
        if len({leg.objective.name for leg in problem.legs if leg.wait is None}) > 1  # seconds and joules do not add up
        else ObjectiveCost(objective=objective.name, value=energy[objective.name], unit=objective.unit),
        detour=DetourTotal(
            count=len(found),
            length=sum(detour.length for detour in found),
            max_deviation=max((detour.max_deviation for detour in found), default=0.0),
        ),
        detours=found,
        objective=figures,
        asked_speed=speed,
    )


def _with_obstruction(detour: Detour, planned: Sequence[Obstruction]) -> Detour:
    """The detour with what it goes around, taken from the planned detour that overlaps it most along the path."""

    def overlap(other: Obstruction) -> float:
        if other.path_from is None or other.path_to is None:
            return -np.inf
        return min(other.path_to, detour.path_to) - max(other.path_from, detour.path_from)

    best = max(planned, key=overlap, default=None)
    return detour if best is None or overlap(best) < -_APART else replace(detour, obstruction=best)
