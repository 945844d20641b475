"""A motion as frames to be shown: poses, tip, and the nearest spot to every obstacle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.site import Proximity

ITSELF = "the machine itself"
_MOST_FRAMES = 3000


@dataclass(frozen=True)
class Nearest:
    """The tightest spot between the machine and one obstacle.

    Attributes
    ----------
    margin: distance minus the clearance to be kept [m].
    distance: signed [m].
    link: name of the link.
    point_link, point_obstacle: (3,) its two ends [m], world.
    """

    margin: float
    distance: float
    link: str
    point_link: Vector
    point_obstacle: Vector


@dataclass(frozen=True)
class Timeline:
    """Frames of a motion at even times.

    Attributes
    ----------
    time: (F,) [s].
    q: (F, n) joint positions [rad or m].
    tip: (F, 3) [m], world.
    poses: (F, joints, 7) position [m] and quaternion (x, y, z, w) of every joint's
        frame, the resting one first.
    obstacles: names, in the order of the scene; last, where it applies, the machine.
    nearest: per frame and obstacle the tightest spot, None where it is far.
    """

    time: Vector
    q: Matrix
    tip: Matrix
    poses: NDArray[np.float64]
    obstacles: tuple[str, ...]
    nearest: tuple[tuple[Nearest | None, ...], ...]

    def margins(self, obstacle: int) -> Vector:
        """(F,) margin to one obstacle [m]; NaN where it is far."""
        return np.array([np.nan if row[obstacle] is None else row[obstacle].margin for row in self.nearest])  # type: ignore[union-attr]


def timeline(problem: Problem, trajectory: Trajectory, *, rate: float = 30.0) -> Timeline:
    """Frames of `trajectory`, `rate` a second, the last sample included."""
    count = 1 if trajectory.duration == 0.0 else int(np.ceil(trajectory.duration * rate)) + 1
    time = trajectory.time[0] + np.linspace(0.0, trajectory.duration, min(count, _MOST_FRAMES))
    q = np.column_stack([np.interp(time, trajectory.time, column) for column in trajectory.q.T])
    robot = problem.robot
    kinematics, data = Kinematics(robot), robot.model.createData()
    proximity = Proximity(robot, problem.obstacles)
    names = obstacle_names(problem, proximity)
    within = sight(problem)
    return Timeline(
        time=time,
        q=q,
        tip=np.array([kinematics.at(row).tip_position for row in q]),
        poses=np.array([link_poses(robot, data, row) for row in q]),
        obstacles=names,
        nearest=tuple(
            nearest_spots(proximity, names, row, time=float(moment), within=within)
            for moment, row in zip(time, q, strict=True)
        ),
    )


def sight(problem: Problem) -> float:
    """How far spots are looked for [m]."""
    return max([0.0, *(obstacle.clearance for obstacle in problem.obstacles)]) + 2.0 * problem.scene.influence


def obstacle_names(problem: Problem, proximity: Proximity) -> tuple[str, ...]:
    """What margins are shown for."""
    itself = (ITSELF,) if any(owner < 0 for owner in proximity.owner) else ()
    return tuple(obstacle.name for obstacle in problem.obstacles) + itself


def link_poses(robot: Robot, data: pin.Data, q: Vector) -> Matrix:
    """(joints, 7) position and quaternion (x, y, z, w) of every joint's frame."""
    pin.forwardKinematics(robot.model, data, q)
    return np.array([pin.SE3ToXYZQUAT(placement) for placement in data.oMi])


def nearest_spots(
    proximity: Proximity, names: tuple[str, ...], q: Vector, *, time: float, within: float
) -> tuple[Nearest | None, ...]:
    """The tightest spot to everything in `names`, None where nothing is within `within` [m]."""
    near = proximity.at(q, time=time, within=within)
    found: list[Nearest | None] = [None] * len(names)
    for row in np.argsort(near.margin, kind="stable"):
        pair = int(near.pair[row])
        owner = int(proximity.owner[pair])
        if found[owner] is None:  # -1, the machine itself, is the last one
            found[owner] = Nearest(
                margin=float(near.margin[row]),
                distance=float(near.distance[row]),
                link=proximity.pairs[pair].link,
                point_link=np.array(near.point_link[row]),
                point_obstacle=np.array(near.point_obstacle[row]),
            )
    return tuple(found)
