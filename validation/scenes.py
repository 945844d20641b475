"""Build a scene from a start, obstacles and a task."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pinocchio as pin

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from validation.obstacles import Record

NO_TASK: Record = {"goal": {"position": [4.0, 0.0, 0.0]}}  # for scenes without planning, since a scene needs a task


def scene_of(
    robot: bp.Robot,
    obstacles: Sequence[Record],
    *,
    start: Vector | None,
    task: Record = NO_TASK,
    folder: Path | None = None,
    **rest: Any,
) -> bp.Scene:
    """The scene with these entries; without a start if `start` (n,) is None. Files of obstacles are in `folder`."""
    content: Record = {"version": 1, "task": task, "obstacles": list(obstacles), **rest}
    if start is not None:
        content["start"] = {"joints": dict(zip(robot.joint_names, start.tolist(), strict=True))}
    return bp.scene_from_dict(content) if folder is None else bp.scene_from_dict(content, folder=folder)


def quaternion(rotation: Matrix) -> list[float]:
    """[w, x, y, z] of a rotation matrix (3, 3), as in a scene file."""
    x, y, z, w = pin.Quaternion(rotation).coeffs().tolist()
    return [w, x, y, z]
