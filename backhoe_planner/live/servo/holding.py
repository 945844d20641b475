"""What held the machine back in a step of the servo: the row that binds, and the pair that it is of.

The nearest obstacle need not be the one that is in the way. The velocity x towards which the machine goes is the one
nearest to the wish w among rows G x <= h, so with the weights H of the program

    H (w - x) = sum_i lambda_i g_i,   lambda_i >= 0,   lambda_i = 0 unless the row i binds

Of the rows that bind, the one along which most of H (w - x) points is told. This is only computed when it is asked
for, after the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.law import Rows, solve_with_binding_rows
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.live.servo.kept_velocity import keeping
from backhoe_planner.live.servo.safe_velocity import SafeVelocity, VelocityFilter, VelocityWish, velocity_program
from backhoe_planner.live.servo.surroundings import Surroundings
from backhoe_planner.site import Obstruction

_HELD = 1e-5  # rad/s or m/s off the target from which a machine counts as held back; the solver's tolerance is 1e-6
_BINDS = 1e-4  # rad/s or m/s: a row that is kept with more to spare does not bind; chosen, far above that tolerance
_NOTHING = 1e-12  # keeps quotients finite


class Hold(NamedTuple):
    """What held the machine back in a step.

    Attributes
    ----------
    obstruction: the pair whose row binds the most, or a joint's limit; None if no row of a pair binds.
    keeps: whether a condition to be kept binds, where the machine comes to rest straight ahead.
    """

    obstruction: Obstruction | None
    keeps: bool


def find_hold(
    check: PathCheck, velocity_filter: VelocityFilter, site: Surroundings, request: VelocityWish, chosen: SafeVelocity,
    *, joints: tuple[str, ...], time: float,
) -> Hold | None:  # fmt: skip
    """What held the machine back in the step that was taken last; None if nothing did.

    Parameters
    ----------
    check: of the braking paths.
    velocity_filter: that chose the velocity.
    site: names the pairs.
    request, chosen: what was asked of the filter, and its answer.
    joints: names of the joints.
    time: at the end of the step [s].
    """
    bounds = check.bounds
    if float(np.abs(request.target - chosen.v).max()) < _HELD:
        return None

    def of_pair(pair: int, *, keeps: bool = False) -> Hold:
        margin = float(bounds.lower()[pair] - check.separation.clearance[pair])
        return Hold(site.obstruction(pair, margin, time), keeps)

    if len(bounds.inside):  # the machine is led out of the deepest violation
        depth = check.separation.clearance[bounds.inside] - bounds.lower()[bounds.inside]
        return of_pair(int(bounds.inside[int(depth.argmax())]))
    if chosen.end is None:  # nothing was proven
        worst = check.worst_of_last()
        return Hold(None, keeps=False) if worst < 0 else of_pair(worst)
    of_path = check.rows_of_last()
    evasion = (*velocity_filter.evasion.of_pairs[:1], *(() if of_path is None else (of_path,)))
    early = velocity_filter.evasion.of_pairs[1:]
    least, most, kept = request.range.least, request.range.most, request.kept
    program = velocity_program(request, request.v, least, most, tuple(rows for _, rows in evasion))
    n, H = len(request.v), program.H
    if kept is not None:
        program = keeping(program, kept.ahead, *(rows for _, rows in early))
    solution = solve_with_binding_rows(program)
    x = chosen.v if solution is None else np.clip(solution.x[:n], least, most)
    off = request.v - x
    push = H @ off
    pair, along = -1, 0.0
    for pairs, rows in (*evasion, *early):
        row, part = _binding(rows, x, push)
        if part > along:
            pair, along = int(pairs[row]), part
    keeps = kept is not None and _binding(kept.ahead, x, push)[1] > 0.0
    if pair >= 0:
        return of_pair(pair, keeps=keeps)
    at_limit = ((x > most - _BINDS) & (off > _HELD)) | ((x < least + _BINDS) & (off < -_HELD))
    if keeps or not at_limit.any():
        return Hold(None, keeps)
    return Hold(Obstruction.joint_limit(joints[int(np.where(at_limit, np.abs(off), 0.0).argmax())]), keeps)


def _binding(rows: Rows, x: Vector, push: Vector) -> tuple[int, float]:
    """The row (K,) that binds at x (n,) and along which `push` (n,) points most, and how much; 0 if none does."""
    if len(rows.h) == 0:
        return 0, 0.0
    size = np.maximum(np.linalg.norm(rows.G, axis=1), _NOTHING)
    along = np.where(rows.h - rows.G @ x < _BINDS * size, rows.G @ push / size, 0.0)
    row = int(along.argmax())
    return row, float(along[row])
