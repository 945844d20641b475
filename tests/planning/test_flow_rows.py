"""Rows of the pump's flow in the program of a descent, for joints that reverse within one step."""

import itertools

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem, drive_of
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.linear_model import PLACES_PER_PIECE, LinearModel

START = np.array([0.0, 0.4, -1.6, -0.9])
PIECES = 8


@pytest.mark.parametrize("ways", list(itertools.product((-1.0, 1.0), repeat=3)))
def test_the_rows_predict_the_flow_of_joints_that_start_to_move_in_either_direction(
    backhoe: bp.Robot, ways: tuple[float, ...]
) -> None:
    """The boom moves, 3 joints are at rest: the flow to all of them after a step, against the drive's own figure."""
    names = dict(zip(backhoe.joint_names, START.tolist(), strict=True))
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": names}, "task": {"goal": {"joints": names}}})
    problem = build_problem(backhoe, scene)
    drive = drive_of(problem)
    curve = JointCurve.straight(START, START + np.array([0.0, 0.5, 0.0, 0.0]), PIECES)
    u = np.linspace(0.0, 1.0, PLACES_PER_PIECE * PIECES + 1)
    T = float(np.max(drive.flow_use(curve(u), curve(u, 1)))) / 0.95  # the boom takes 95 % of the pump at most
    model = LinearModel(problem, curve, T, end_moves=False, box=np.full(4, 0.05))
    model.keep_drive_limits(drive)
    program = model.program(20.0)
    x = np.zeros(len(program.f))
    x[: 4 * (PIECES - 1)].reshape(-1, 4)[PIECES // 2] = 1e-3 * np.insert(np.array(ways), 1, 0.0)
    control, duration = model.step(x)
    after = JointCurve(control)
    use = float(np.max(drive.flow_use(after(u), after(u, 1) / duration)))
    assert use > float(np.max(drive.flow_use(curve(u), curve(u, 1) / T)))  # they take oil in either direction
    over = np.concatenate([rows.G @ x - rows.h for rows in program.rows if rows.name == "drive"])
    assert float(np.max(over)) == pytest.approx(use - 1.0, abs=2e-5)
