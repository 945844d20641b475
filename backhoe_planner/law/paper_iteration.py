"""The paper's iteration: equation (12) as printed, without the completed law's changes.

Newton-Raphson on x_e(q): xdot_e = goal - x_e, q <- q + v, a hundred times. There is one
critical point, the nearest of any link to any obstacle. It is pushed away with a constant
speed once it is within the influence distance; its whole velocity is a task, as in (10). The
gains are the scene's, or those of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.law.directionality import Magnification, Reference, link_chain, link_jacobian, link_velocities
from backhoe_planner.law.law import joint_velocity
from backhoe_planner.machine import Configuration, Kinematics, TipTarget, movable_rows
from backhoe_planner.motion import Problem
from backhoe_planner.site import Gains, Nearby, Proximity

ITERATIONS = 100  # steps of one run, as in the paper
_PUSH = 0.2  # m per iteration, |xdot_o|; chosen
_RUNAWAY = 1e6  # rad or m: a longer step is meaningless


@dataclass(frozen=True)
class Push:
    """A critical point and its wanted velocity: J_o (3, n) and xdot_o (3,)."""

    J_o: Matrix
    xdot_o: Vector


def paper_gains(joint_names: tuple[str, ...]) -> Gains:
    """The gains of the paper's last figure: s_o = 0.2, s_1 = s_2 = 0.01; s_e = 0.2."""
    return Gains(s_e=0.2, s_o=0.2, s_k=dict.fromkeys(joint_names[:2], 0.01))


def paper_step(
    at: Configuration,
    goal: TipTarget,
    push: Push | None,
    gains: Gains,
    *,
    magnification: Magnification = "printed",
    reference: Reference = "tip_referenced",
) -> Vector:
    """(n,) the joint step of equation (12) towards `goal`.

    Parameters
    ----------
    at: the configuration.
    push: the critical point within the influence distance; None if there is none.
    gains: s_e, s_o and s_k.
    magnification, reference: see `directionality`.
    """
    error, J = goal.error(at), goal.jacobian(at)
    rows = movable_rows(J)
    planar = movable_rows(at.jacobian[:3])
    terms: list[tuple[float, Matrix, Vector]] = []
    if push is not None and gains.s_o > 0.0:
        terms.append((gains.s_o, push.J_o[planar], push.xdot_o[planar]))
    names = at.robot.joint_names
    if any(gains.s_k.get(name, 0.0) > 0.0 for name in names[:-1]):
        chain = link_chain(at)
        turns = link_velocities(chain, error[:3], D=np.ones(len(names) - 1), magnification=magnification)
        for k in range(1, len(names)):
            gain = gains.s_k.get(names[k - 1], 0.0)
            if gain > 0.0:
                terms.append((gain, link_jacobian(chain, k, reference=reference)[planar], turns[k - 1][planar]))
    return joint_velocity(J[rows], error[rows], terms, s_e=gains.s_e)


def run_iteration(
    problem: Problem, start: Vector, goal: TipTarget, *, proximity: Proximity, kinematics: Kinematics
) -> Matrix:
    """(ITERATIONS + 1, n) the joint positions after each iteration.

    It ends early if a step is not finite or absurdly long, because the law as printed has no bound.

    Parameters
    ----------
    problem: machine and site; its gains are used, or the paper's if it gives none.
    start: (n,) the first joint positions [rad or m].
    goal: where the tip is to arrive.
    proximity, kinematics: of the problem's machine and obstacles.
    """
    gains = problem.scene.gains
    if gains == "auto":
        gains = paper_gains(problem.robot.joint_names)
    found = [np.array(start, dtype=float)]
    for _ in range(ITERATIONS):
        at = kinematics.at(found[-1])
        nearby = proximity.at(at.q, within=problem.scene.influence)
        obstacles = nearby.only(proximity.owner[nearby.pair] >= 0)  # the paper does not consider self-collision
        step = paper_step(at, goal, _push(at, obstacles, proximity.moves), gains)
        if not np.all(np.isfinite(step)) or float(np.max(np.abs(step))) > _RUNAWAY:
            break
        found.append(found[-1] + step)
    return np.array(found)


def _push(at: Configuration, nearby: Nearby, moves: Flags) -> Push | None:
    """The nearest of the critical points `nearby`, pushed straight away; `moves` as in `Proximity`."""
    if len(nearby) == 0:
        return None
    row = int(np.argmin(nearby.distance))
    J_o = at.J_world[:3] + np.cross(at.J_world[3:].T, nearby.point_link[row]).T
    return Push(J_o=np.where(moves[nearby.pair[row]], J_o, 0.0), xdot_o=-_PUSH * nearby.normal[row])
