"""How much a plan saves: its objective beside that of the local law, on the same path and timing.

The law is led along the same path from the same start, and is then taken to be where the
plan is at every moment, so that the two motions differ in how the redundancy is used and
in nothing else. Where the law gets stuck at a joint limit, the plain pseudo-inverse is
taken, v = J^+ xdot, which knows no limits and goes on through them: what it would cost is
told beside the limit that it breaks.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine.kinematics import Kinematics
from backhoe_planner.machine.target import movable_rows
from backhoe_planner.planning.bucket_path import BucketPath
from backhoe_planner.planning.certificate import Certificate
from backhoe_planner.planning.descent import monotone_curve
from backhoe_planner.planning.local_resolution import Resolution, has_open_range, resolve_along, sample_stations
from backhoe_planner.planning.objectives import Objective, trajectory_costs
from backhoe_planner.planning.problem import Problem
from backhoe_planner.planning.trajectory import Trajectory
from backhoe_planner.site.proximity import Proximity

__all__ = ["Comparison", "compare_with_law", "law_motion", "least_norm_resolution", "part_on_path", "stations_of"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_EXACT = 1e-9
_CORRECTIONS = 12
_STANDING = 1e-6  # m: a leg on which only the bucket turns
_BREAKS = 1e-6  # rad or m


@dataclass(frozen=True, eq=False)
class Comparison:
    """A plan beside the local law.

    Attributes
    ----------
    name: of the objective.
    value: of the plan's motion, from where it begins to follow the path.
    motion: that part of it; begun: when it begins in the plan [s].
    law: of the law's motion with the same timing; None where it does not get along the path.
    law_motion: that motion, or None.
    law_breaks: the joint whose limit the law breaks, or what it would come too near to;
        None where it keeps everything.
    """

    name: str
    value: float
    motion: Trajectory
    begun: float
    law: float | None
    law_motion: Trajectory | None
    law_breaks: str | None

    @property
    def saving_percent(self) -> float | None:
        """Of what the law needs; None where there is nothing to compare with."""
        if self.law is None or not self.law > 0.0:
            return None
        return 100.0 * (1.0 - self.value / self.law)

    def metrics(self) -> dict[str, Any]:
        """For the plan file."""
        return {
            "name": self.name,
            "value": self.value,
            "law": self.law,
            "saving_percent": self.saving_percent,
            "law_breaks": self.law_breaks,
        }


def compare_with_law(problem: Problem, trajectory: Trajectory, certificate: Certificate) -> Comparison | None:
    """A motion along the scene's path beside the law's; None where it does not follow a path."""
    path = problem.path
    if path is None or len(trajectory) < 3 or not certificate.tracking.done:
        return None
    motion, begun = part_on_path(trajectory, certificate.tracking.approach_time)
    if len(motion) < 3:
        return None
    name = Objective(problem).name
    value = trajectory_costs(problem, motion)[name]
    if certificate.detours:
        return Comparison(name, value, motion, begun, None, None, "clearance: the path itself is blocked")
    if np.any(np.linalg.norm(np.diff(path.points, axis=0), axis=1) < _STANDING):
        return Comparison(name, value, motion, begun, None, None, None)  # no place to compare by
    kinematics = Kinematics(problem.robot)
    proximity = Proximity(problem.robot, problem.obstacles)
    law = resolve_along(problem, path, 0.0, motion.q[0], proximity=proximity, kinematics=kinematics, time=begun)
    breaks = None
    if law.blocker is not None:
        kind, what = law.blocker
        if kind != "joint":
            return Comparison(name, value, motion, begun, None, None, f"clearance: {what} (at {kind})")
        found = least_norm_resolution(problem, path, motion.q[0], kinematics=kinematics)
        breaks = f"limit of joint {what}"
        if found is None:
            return Comparison(name, value, motion, begun, None, None, breaks)
        law = found
    moved = law_motion(path, law, motion, kinematics=kinematics)
    return Comparison(name, value, motion, begun, trajectory_costs(problem, moved)[name], moved, breaks)


def part_on_path(trajectory: Trajectory, begun: float) -> tuple[Trajectory, float]:
    """What follows the path, with time from 0, and when it begins [s]."""
    first = int(np.searchsorted(trajectory.time, begun - 1e-9))
    time = trajectory.time[first:] - trajectory.time[first]
    return Trajectory.from_steps(time, trajectory.q[first:]), float(trajectory.time[first])


def law_motion(path: BucketPath, law: Resolution, motion: Trajectory, *, kinematics: Kinematics) -> Trajectory:
    """What the law found, with the tip at every moment where it is in `motion`."""
    stations = stations_of(path, motion, kinematics=kinematics)
    marks = np.searchsorted(law.stations, path.stations - 1e-9)
    q = np.empty_like(motion.q)
    for first, last in pairwise(marks.tolist()):
        if last <= first:
            continue
        low, high = law.stations[first], law.stations[last]
        rows = (stations >= low - 1e-9) & (stations <= high + 1e-9)
        leg = slice(first, last + 1)
        q[rows] = monotone_curve(law.stations[leg], law.q[leg], np.clip(stations[rows], low, high))
    return Trajectory.from_steps(motion.time, q)


def stations_of(path: BucketPath, motion: Trajectory, *, kinematics: Kinematics) -> Vector:
    """(T,) arc lengths at which the tip is, for a motion that follows the whole path [m]."""
    tips = np.array([kinematics.at(q).tip_position for q in motion.q])
    gone = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1))))
    return np.asarray(gone * (path.length / max(float(gone[-1]), 1e-12)))


def least_norm_resolution(
    problem: Problem, path: BucketPath, q: Vector, *, kinematics: Kinematics
) -> Resolution | None:
    """Along the whole path by the pseudo-inverse alone, which breaks limits and touches what stands there.

    Parameters
    ----------
    q: (n,) joints with the tip on the beginning of the path.

    Returns
    -------
    With the first joint that breaks a limit as its blocker; None where the arm is
    stretched out before the end.
    """
    stations = sample_stations(path, 0.0)
    found = [np.array(q, dtype=float)]
    broken: tuple[str, str] | None = None
    limits = problem.limits
    for s in stations[1:].tolist():
        target, joints = path.target(s), found[-1]
        for _ in range(_CORRECTIONS):
            at = kinematics.at(joints)
            J, error = target.jacobian(at), target.error(at)
            rows = movable_rows(J)
            if has_open_range(target) and target.pitch_excess(at.pitch) == 0.0:
                rows &= np.array([True, True, True, False])
            if float(np.max(np.abs(error[rows]), initial=0.0)) < _EXACT:
                break
            joints = joints + np.linalg.lstsq(J[rows], error[rows], rcond=None)[0]
            if np.max(np.abs(joints - found[-1])) > 1.0:
                return None
        else:
            return None
        found.append(joints)
        over = np.maximum(limits.lower - joints, joints - limits.upper)
        if broken is None and float(np.max(over)) > _BREAKS:
            broken = ("joint", problem.robot.joint_names[int(np.argmax(over))])
    return Resolution(stations, np.array(found), broken)
