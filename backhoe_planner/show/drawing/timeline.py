"""A motion as frames for display: poses, tip, and the critical point to every obstacle."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import Problem, Trajectory, leg_parts
from backhoe_planner.site import Proximity

ITSELF = "the machine itself"
_RATE = 30.0  # frames a second: chosen, smooth for the eye
FRAME = 1.0 / _RATE  # s between two frames
_ROUNDING = 1e-9  # m
MOST_FRAMES = 3000  # per page: chosen, 100 s of motion; a longer motion has fewer a second


@dataclass(frozen=True)
class CriticalPoint:
    """The place at which the machine's margin to an obstacle is least.

    Attributes
    ----------
    margin: distance minus the clearance to be kept [m].
    distance: signed distance, negative inside [m].
    link: name of the link.
    point_link, point_obstacle: (3,) the nearest points of link and obstacle [m], world.
    """

    margin: float
    distance: float
    link: str
    point_link: Vector
    point_obstacle: Vector


@dataclass(frozen=True)
class Timeline:
    """Frames of a motion at regular times.

    Attributes
    ----------
    time: (F,) times [s].
    q: (F, n) joint positions [rad or m].
    tip: (F, 3) positions of the tip [m], world.
    poses: (F, joints, 7) position [m] and quaternion (x, y, z, w) of every joint's frame in the
        world; joint 0 is the world.
    obstacles: names in the order of the scene; the machine itself comes last, if it can touch itself.
    nearest: critical point per frame and obstacle; None if the obstacle is far away, or not present in that leg.
    legs: name of the leg of a sequence, per frame; empty if there are no legs.
    """

    time: Vector
    q: Matrix
    tip: Matrix
    poses: NDArray[np.float64]
    obstacles: tuple[str, ...]
    nearest: tuple[tuple[CriticalPoint | None, ...], ...]
    legs: tuple[str, ...] = ()

    def without(self, names: Collection[str]) -> Timeline:
        """The same frames without the margins to these obstacles."""
        kept = [index for index, name in enumerate(self.obstacles) if name not in names]
        return replace(
            self,
            obstacles=tuple(self.obstacles[index] for index in kept),
            nearest=tuple(tuple(row[index] for index in kept) for row in self.nearest),
        )

    def margins(self, obstacle: int) -> Vector:
        """(F,) margins to the obstacle of this index [m]; NaN where it is far away."""
        return np.array([np.nan if row[obstacle] is None else row[obstacle].margin for row in self.nearest])  # type: ignore[union-attr]


def timeline(problem: Problem, trajectory: Trajectory) -> Timeline:
    """Frames of `trajectory`, at most `FRAME` apart unless there would be too many; the last is its end."""
    count = 1 if trajectory.duration == 0.0 else int(np.ceil(trajectory.duration * _RATE)) + 1
    time = trajectory.time[0] + np.linspace(0.0, trajectory.duration, min(count, MOST_FRAMES))
    return frames_at(problem, trajectory, time)


def frames_at(problem: Problem, trajectory: Trajectory, time: Vector) -> Timeline:
    """Frames of `trajectory` at the times (F,) [s]."""
    q = np.column_stack([np.interp(time, trajectory.time, column) for column in trajectory.q.T])
    robot = problem.robot
    kinematics, data = Kinematics(robot), robot.model.createData()
    proximity = Proximity(robot, problem.obstacles)
    names, within = obstacle_names(problem, proximity), sight(problem)

    def link_poses(q: Vector) -> list[Vector]:
        pin.forwardKinematics(robot.model, data, q)
        return [pin.SE3ToXYZQUAT(placement) for placement in data.oMi]

    near, legs = _by_leg(problem, trajectory, names, time=time, q=q, within=within) if trajectory.begins else ((), ())
    return Timeline(
        legs=legs,
        time=time,
        q=q,
        tip=np.array([kinematics.at(row).tip_position for row in q]),
        poses=np.array([link_poses(row) for row in q]),
        obstacles=names,
        nearest=near
        or tuple(
            critical_points(proximity, names, row, time=float(moment), within=within)
            for moment, row in zip(time, q, strict=True)
        ),
    )


def _by_leg(
    problem: Problem, trajectory: Trajectory, names: tuple[str, ...], *, time: Vector, q: Matrix, within: float
) -> tuple[tuple[tuple[CriticalPoint | None, ...], ...], tuple[str, ...]]:
    """For every frame of a sequence, the critical points to what is present in its leg, and the leg's name."""
    parts = leg_parts(problem, trajectory)
    around = [Proximity(part.problem.robot, part.problem.obstacles) for part in parts]
    own = [obstacle_names(part.problem, near) for part, near in zip(parts, around, strict=True)]
    begins = np.array([part.begins for part in parts])
    nearest, legs = [], []
    for moment, row in zip(time.tolist(), q, strict=True):
        k = int(np.searchsorted(begins, moment, side="right")) - 1
        found = critical_points(around[k], own[k], row, time=moment - begins[k], within=within)
        by_name = dict(zip(own[k], found, strict=True))
        nearest.append(tuple(by_name.get(name) for name in names))
        legs.append(parts[k].name)
    return tuple(nearest), tuple(legs)


def sight(problem: Problem) -> float:
    """The distance within which critical points are searched [m]."""
    return max([0.0, *(obstacle.clearance for obstacle in problem.obstacles)]) + 2.0 * problem.scene.influence


def obstacle_names(problem: Problem, proximity: Proximity) -> tuple[str, ...]:
    """The names for which margins are shown: the obstacles, and the machine itself if it can touch itself."""
    itself = (ITSELF,) if any(owner < 0 for owner in proximity.owner) else ()
    return tuple(obstacle.name for obstacle in problem.obstacles) + itself


def critical_points(
    proximity: Proximity, names: tuple[str, ...], q: Vector, *, time: float, within: float
) -> tuple[CriticalPoint | None, ...]:
    """The critical points of the machine at q (n,) to everything in `names`; None if it is far away.

    Parameters
    ----------
    names: the obstacles of `proximity` in its order, then the machine itself if it has such pairs.
    time: time for which the obstacles are placed [s].
    within: distance beyond which they count as far away [m].
    """
    near = proximity.at(q, time=time, within=within, margin=_least_margins(proximity, q, time=time, within=within))
    found: list[CriticalPoint | None] = [None] * len(names)
    for row in np.argsort(near.margin, kind="stable"):
        pair = int(near.pair[row])
        owner = int(proximity.owner[pair])
        if found[owner] is None:  # -1, the machine itself, is the last one
            found[owner] = CriticalPoint(
                margin=float(near.margin[row]),
                distance=float(near.distance[row]),
                link=proximity.pairs[pair].link,
                point_link=np.array(near.point_link[row]),
                point_obstacle=np.array(near.point_obstacle[row]),
            )
    return tuple(found)


def _least_margins(proximity: Proximity, q: Vector, *, time: float, within: float) -> float | Vector:
    """(P,) for each pair an upper bound on the least margin to its obstacle [m]; infinite if none is known.

    Every link is near the ground, and one distance to the ground takes as long as a hundred others. So the link that
    was nearest in the previous posture is measured first.
    """
    if not len(proximity.clusters):
        return np.inf
    margin = proximity.lower_bounds(q, time=time, floor=np.full(len(proximity.pairs), -np.inf))[0] - proximity.clearance
    by_margin = np.argsort(margin, kind="stable")
    _, firsts = np.unique(proximity.owner[by_margin], return_index=True)
    asked = np.full(len(margin), -np.inf)
    asked[by_margin[firsts]] = np.inf
    near = proximity.at(q, time=time, within=within, margin=asked)
    least = np.full(len(proximity.obstacles) + 1, np.inf)  # the last is the machine itself, -1
    np.minimum.at(least, proximity.owner[near.pair], near.margin + _ROUNDING)
    return np.asarray(least[proximity.owner])
