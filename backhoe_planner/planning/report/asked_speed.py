"""How much of a path a motion follows at the scene's speed, and which limit slows the rest."""

from __future__ import annotations

from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Vector
from backhoe_planner.files.records import Figure, Record
from backhoe_planner.machine import BatchKinematics, Kinematics
from backhoe_planner.motion import Problem, TipPath, Trajectory, limit_usage
from backhoe_planner.planning.report.comparison import part_on_path

KEPT = 0.9  # part of the scene's speed from which it counts as kept; chosen


class Slower(Record):
    """A part of the path on which the tip is slower than the scene's speed."""

    path_from: Figure
    path_to: Figure
    """Where [m]."""
    least: Figure
    """The speed at its slowest place [m/s]."""
    limit: str
    """The limit of the machine that is used most there, by its name in `LimitUsage`."""


class AskedSpeed(Record):
    """How well a motion keeps the speed that the scene gives for its path."""

    asked: Figure
    """The scene's speed [m/s]."""
    kept_percent: Figure
    """Part of the path's length on which the tip has at least 90 % of it [%]."""
    slower: tuple[Slower, ...]
    """The other parts, in the order of the path."""


def measure_speed(problem: Problem, trajectory: Trajectory, *, begun: float) -> AskedSpeed | None:
    """How well a motion along the scene's path keeps its speed; None if the scene gives no speed.

    Parts where the tip is off the path by more than the tolerance, on a detour, do not
    count: the speed does not apply there.

    Parameters
    ----------
    begun: when the tip is first within the tolerance of the path's beginning [s].
    """
    task, path = problem.scene.task.path, problem.path
    if task is None or path is None or task.speed is None:
        return None
    kinematics = Kinematics(problem.robot)
    motion, _ = part_on_path(path, trajectory, begun, kinematics=kinematics)
    if len(motion) < 2:
        return None
    tips = BatchKinematics(problem.robot).tip_positions(motion.q)
    places, near = _places(path.without_angles if path.turns else path, tips, task.tolerance)
    length = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    speed = length / np.diff(motion.time)
    counted = near[1:] & near[:-1]
    whole = float(np.sum(length[counted]))
    if not whole > 0.0:
        return None
    slow = counted & (speed < KEPT * task.speed)
    usage = limit_usage(problem, motion, tip_speed=False)
    slower = []
    for is_slow, rows in groupby(range(len(slow)), key=lambda row: bool(slow[row])):
        if not is_slow:
            continue
        part = list(rows)
        # the limit that is used most on these segments is what slows the tip
        during = (usage.moments.time >= motion.time[part[0]]) & (usage.moments.time <= motion.time[part[-1] + 1])
        most = np.max(usage.ratio[during], axis=0)
        slower.append(
            Slower(
                path_from=float(places[part[0]]),
                path_to=float(places[part[-1] + 1]),
                least=float(np.min(speed[part])),
                limit=usage.names[int(np.argmax(most))],
            )
        )
    kept = float(np.sum(length[counted & ~slow]))
    return AskedSpeed(asked=task.speed, kept_percent=100.0 * kept / whole, slower=tuple(slower))


def _places(path: TipPath, tips: NDArray[np.float64], tolerance: float) -> tuple[Vector, NDArray[np.bool_]]:
    """(T,) arc lengths of the tips (T, 3), never decreasing [m], and (T,) whether each tip is on the path."""
    places, near = np.zeros(len(tips)), np.zeros(len(tips), dtype=bool)
    here = 0.0
    for row, tip in enumerate(tips):
        ahead = 2.0 * float(np.linalg.norm(tip - tips[row - 1])) + 2.0 * tolerance if row else tolerance
        place, off = path.nearest(tip, low=here, high=min(here + ahead, path.length))
        if off > 2.0 * tolerance:  # off the path: the tip may come back anywhere ahead
            place, off = path.nearest(tip, low=here)
        near[row] = off <= tolerance
        here = place if near[row] else here
        places[row] = here
    return places, near
