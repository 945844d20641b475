"""Whether the machine can hold its load where a motion begins and ends at rest, and on the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.motion import DRIVE_TOLERANCE, Problem, Trajectory, drive_of
from backhoe_planner.proof import LimitUse, machine_uses


def unheld_load(problem: Problem, q: Vector) -> LimitUse | None:
    """The joint that lacks most to hold arm and payload at rest at `q` (n,) [rad or m]; None if all hold.

    It is what the certificate says of any motion that begins or ends there. Soil does not act on a tip at rest.
    """
    if holds_load(problem, q[None]).all():  # a fifth of the time of what follows
        return None
    _, _, effort, _ = machine_uses(problem, Trajectory.from_steps(np.zeros(1), q[None]))
    return None if effort is None or effort.kept else effort


def holds_load(problem: Problem, q: Matrix) -> Flags:
    """(N,) in which of the configurations `q` (N, n) [rad or m] every joint holds arm and payload at rest."""
    return is_held(holding_use(problem, q))


def holding_use(problem: Problem, q: Matrix) -> Vector:
    """(N,) the greatest torque of a joint that holds arm and payload at rest at `q` (N, n), over what it can."""
    drive = drive_of(problem)
    return np.asarray(np.max(drive.static_use(q), axis=1)) if drive.limited else np.zeros(len(q))


def is_held(use: Vector) -> Flags:
    """(N,) for which uses (N,) of the joints by the load, see `holding_use`, the certificate says that they hold it."""
    return np.asarray(use <= 1.0 + DRIVE_TOLERANCE)


def moves_load(problem: Problem, motion: Trajectory) -> bool:
    """Whether a motion keeps the limits on torque, or breaks them only by how fast it is.

    It may pass postures in which a joint could not hold arm and payload at rest.
    """
    if holds_load(problem, motion.q).all():
        return True
    _, _, effort, _ = machine_uses(problem, motion)
    return effort is None or effort.kept


def largest_payload(problem: Problem, q: Vector) -> float | None:
    """The largest payload that the machine can hold at rest at `q` (n,) [kg]; None if it cannot even hold itself.

    Static torques are linear in the payload: those without one and those of 1 kg give all others.
    """
    scene = problem.scene
    empty, light = (
        drive_of(replace(problem, scene=scene.model_copy(update={"payload": mass}))) for mass in (0.0, 1.0)
    )  # fmt: skip
    at = q[None]
    own = empty.gravity_torques(at)[0]
    each = light.gravity_torques(at)[0] - own
    limits = empty.torque_limits(at)
    if np.any(own > limits.positive[0]) or np.any(-own > limits.negative[0]):
        return None
    left = np.where(each > 0.0, limits.positive[0] - own, limits.negative[0] + own)
    with np.errstate(divide="ignore"):
        return float(np.min(left / np.abs(each)))
