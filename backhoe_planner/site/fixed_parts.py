"""Obstacles in the way of the machine's parts that do not move, and of the arm at its start.

The ground that carries the machine touches it but is not in its way. An obstacle that is in its way remains so if
the machine is lifted a little, so an obstacle counts only if a part is too near to it both as the machine stands and
lifted. Thus the scene need not say which obstacles are ground: height maps, scans and half-spaces may be both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import SceneError
from backhoe_planner.machine import Base, Robot
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.obstacles import Obstacle
from backhoe_planner.site.scene_file import Scene

PASSES_UNDER = 0.25  # m: anything lower passes under a machine; chosen, loaders have 0.28 to 0.35 m below the chassis
_OVERLAP = 1e-3  # m: less is touching


@dataclass(frozen=True)
class InTheWay:
    """A part of the machine that is too near to an obstacle.

    Attributes
    ----------
    link: of the machine.
    obstacle: by its name.
    """

    link: str
    obstacle: str


def stands_in(
    robot: Robot, obstacles: Sequence[Obstacle], *, base: Base | None = None, with_clearance: bool = False
) -> InTheWay | None:
    """The first part of a machine that does not move and overlaps an obstacle where the machine stands, or None.

    Obstacles that move or appear later, and those for some links only, are left out; so are zones, which
    only limit how the arm moves.

    Parameters
    ----------
    base: where the machine stands; by default the robot's own base, see `Robot.with_base`.
    with_clearance: whether a part must keep the obstacle's clearance too.
    """
    moved = pin.SE3.Identity() if base is None else base.placement * robot.base.placement.inverse()
    for obstacle in obstacles:
        if obstacle.is_dynamic or obstacle.links is not None or obstacle.zone is not None:
            continue
        margin = obstacle.clearance if with_clearance else -_OVERLAP
        lifts = (0.0, PASSES_UNDER + max(margin, 0.0))
        too_near = [_too_near(robot, obstacle, margin, moved, lift) for lift in lifts]
        if all(too_near):
            return InTheWay(too_near[0], obstacle.name)
    return None


def starts_in(robot: Robot, obstacles: Sequence[Obstacle], q: Vector, *, base: Base) -> InTheWay | None:
    """The first moving part that is within the clearance of an obstacle, with the joints at `q` (n,); None for none.

    Obstacles that move or appear later are left out.

    Parameters
    ----------
    base: where the machine stands.
    """
    moved, gauge = base.placement * robot.base.placement.inverse(), shapes.Gauge()
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    for obstacle in obstacles:
        if obstacle.is_dynamic:
            continue
        there = [(one.shape, _transform(one.placement)) for one in obstacle.pieces]
        for row in robot.pieces_of(obstacle.links):
            part = robot.pieces[row]
            if _is_near(part.piece, moved * data.oMi[part.joint], obstacle, obstacle.clearance, there, gauge):
                return InTheWay(part.link, obstacle.name)
    return None


def check_standing(robot: Robot, scene: Scene, obstacles: Sequence[Obstacle]) -> None:
    """Check that the place that a scene gives its machine does not overlap an obstacle.

    Raises
    ------
    SceneError: names the link and the obstacle.
    """
    if "base" not in scene.model_fields_set:
        return
    found = stands_in(robot, obstacles)
    if found is not None:
        raise SceneError(
            f"puts {found.link} of the machine into {found.obstacle}", file=scene.file, key="base",
            found=f"position {list(scene.base.position)}, heading {scene.base.heading:g}",
            allowed="a place where no part of the machine that does not move overlaps an obstacle",
        )  # fmt: skip


def _too_near(robot: Robot, obstacle: Obstacle, margin: float, moved: pin.SE3, lift: float) -> str:
    """The first link that does not move and is within `margin` [m] of an obstacle; empty if none is.

    Parameters
    ----------
    moved, lift: from where the machine stands to the place to check; how much it is lifted there [m].
    """
    raised, gauge = pin.SE3(np.eye(3), np.array([0.0, 0.0, lift])) * moved, shapes.Gauge()
    there = [(one.shape, _transform(one.placement)) for one in obstacle.pieces]
    for part in robot.pieces:
        if part.joint == 0 and _is_near(part.piece, raised, obstacle, margin, there, gauge):
            return part.link
    return ""


def _is_near(
    piece: shapes.Piece, placement: pin.SE3, obstacle: Obstacle, margin: float, there: Sequence[tuple[Any, Any]],
    gauge: shapes.Gauge,
) -> bool:  # fmt: skip
    """Whether a piece of a body at `placement` is within `margin` [m] of an obstacle, whose own pieces are `there`."""
    at = _transform(placement * piece.placement)
    if any(gauge.measure(piece.shape, at, shape, T)[0] < margin for shape, T in there):
        return True
    return obstacle.cluster is not None and obstacle.cluster.measure(piece, placement, margin) is not None


def _transform(T: pin.SE3) -> Any:
    return shapes.transform(T.rotation, T.translation)
