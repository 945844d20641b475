"""The certificate: a proof about a whole continuous motion.

It rests only on the URDF, the scene and the samples, not on how the motion was found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from backhoe_planner.digits import beside_bounds, length_text, margin_text
from backhoe_planner.errors import check_kind
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import (
    Detour,
    Problem,
    SpotTurn,
    Tracking,
    Trajectory,
    WaypointStep,
    track_goals,
    track_path,
)
from backhoe_planner.proof.clearances import KEPT_WITHIN, find_clearances
from backhoe_planner.proof.keeping import KeepUse, keep_uses
from backhoe_planner.proof.limits import (
    LimitName,
    LimitUse,
    MachineLimit,
    duration_use,
    machine_uses,
    position_use,
    tip_speed_use,
)
from backhoe_planner.site import Obstruction, Proximity, obstacles_in_reach

_STARTS_AT = 1e-5  # m and rad: the rounding of inverse kinematics is below this
_STARTS_AT_JOINTS = 1e-9  # rad or m: the rounding in a plan file is below this
_WAITS_WITHIN = 1e-9  # part of the time to wait: rounding of a sum of times
_SAME_VELOCITY = 1e-6  # relative, and rad/s or m/s: velocities that differ by less are the same


@dataclass(frozen=True)
class Certificate:
    """What was proven of a motion.

    Attributes
    ----------
    clearances: for every obstacle that comes near, and for the machine itself, the tightest
        spot of the whole motion, with the proven lower bound of its distance and its time;
        tightest margin first.
    position, velocity, acceleration: use of the joint limits.
    effort: use of the joints' torques; None for a machine whose torques are not limited.
    hydraulics: use of rod speeds, pump flow and engine power; None for a machine without
        a hydraulic description.
    tracking: how the tip keeps to its task.
    tip_speed: use of the required speed; None if no speed is required.
    duration: use of `max_duration` by the motion to a goal; None if the scene gives none.
    keep: the least margin of every condition to be kept along the motion; empty if there is none.
    problems: everything that is wrong, in words; empty if verified.
    legs: for a sequence, the certificate of each leg that the motion begins; all else is the tightest over the legs.
    """

    clearances: tuple[Obstruction, ...]
    position: LimitUse
    velocity: LimitUse
    acceleration: LimitUse
    effort: LimitUse | None
    hydraulics: LimitUse | None
    tracking: Tracking
    tip_speed: LimitUse | None
    problems: tuple[str, ...]
    keep: tuple[KeepUse, ...] = ()
    legs: tuple[LegCertificate, ...] = ()
    duration: LimitUse | None = None

    def __repr__(self) -> str:
        """One line: whether it is verified, what is nearest, and the first problem."""
        near = self.min_clearance
        words = ["verified" if self.verified else f"not verified: {self.problems[0]}"]
        if len(self.problems) > 1:
            words.append(f"and {len(self.problems) - 1} more")
        if near is not None:
            words.append(f"margin {margin_text(near.margin)} m between {near.link} and {near.name}")
        return f"<Certificate {', '.join(words)}>"

    @property
    def min_clearance(self) -> Obstruction | None:
        """The tightest spot, by margin; None if nothing can be touched."""
        return self.clearances[0] if self.clearances else None

    def leg_of(self, spot: Obstruction) -> str:
        """Name of the leg in which one of `clearances` is; empty without a sequence."""
        check_kind(spot, Obstruction, key="spot")
        legs = (
            leg.name
            for leg in self.legs
            if any(replace(near, time=near.time + leg.begins) == spot for near in leg.certificate.clearances)
        )
        return next(legs, "")

    @property
    def obstacle_clearance(self) -> Obstruction | None:
        """The tightest spot to an obstacle, by margin; None if none comes near."""
        return next((near for near in self.clearances if near.kind == "obstacle"), None)

    @property
    def self_clearance(self) -> Obstruction | None:
        """The tightest spot of the machine to itself; None if it cannot touch itself.

        Links side by side keep the same gap all the time, so this says little about a motion unless it is negative.
        """
        return next((near for near in self.clearances if near.kind == "machine"), None)

    @property
    def verified(self) -> bool:
        """Whether every clearance and limit holds and the task is done."""
        return not self.problems

    @property
    def safe(self) -> bool:
        """Whether every clearance and limit holds, whether or not the task is done."""
        return not self.too_near and self.limits_kept

    @property
    def too_near(self) -> tuple[Obstruction, ...]:
        """The clearances that are not kept; tightest margin first."""
        return tuple(near for near in self.clearances if near.margin < -KEPT_WITHIN)

    @property
    def uses(self) -> dict[LimitName, LimitUse]:
        """The use of every limit that there is, by the name of its field: those of the machine, then of the task."""
        return {name: use for name in get_args(LimitName) if (use := getattr(self, name)) is not None}

    @property
    def limits_kept(self) -> bool:
        """Whether every limit of the machine holds."""
        return all(use.kept for name, use in self.uses.items() if name in get_args(MachineLimit))

    @property
    def detours(self) -> tuple[Detour, ...]:
        """The parts of the motion that leave the specified path."""
        return self.tracking.detours

    @property
    def goal(self) -> int | None:
        """Number of the goal that is reached, from 1, in the order of the scene; None if none is."""
        return self.tracking.goal or None if self.tracking.done else None


@dataclass(frozen=True)
class LegCertificate:
    """What was proven of one leg of a sequence.

    Attributes
    ----------
    name: of the leg.
    first, last: its first and last sample in the whole motion; the last is the first of the next leg.
    begins: the time at which it begins [s].
    certificate: of its part of the motion; its times count from `begins`, but for those in sentences, which count from
        the beginning of the sequence.
    """

    name: str
    first: int
    last: int
    begins: float
    certificate: Certificate


def certify_motion(problem: Problem, trajectory: Trajectory) -> Certificate:
    """Prove what holds over a motion, or over the part of one that belongs to a leg."""
    problem.robot.check_q(trajectory.q[0], what="trajectory.q")
    around = obstacles_in_reach(problem.robot, problem.obstacles)
    clearances = find_clearances(Proximity(problem.robot, around), trajectory)
    position = position_use(problem, trajectory)
    velocity, acceleration, effort, hydraulics = machine_uses(problem, trajectory)
    kinematics = Kinematics(problem.robot)
    path, task = problem.path, problem.scene.task.path
    if path is not None and task is not None:
        tracking = track_path(
            path, task.tolerance, trajectory, kinematics, angle_tolerance=task.rotation_tolerance,
            joint_steps=problem.joint_steps, may_turn=task.turn_on_the_spot,
        )  # fmt: skip
    else:
        tracking = track_goals(problem.goals, trajectory, kinematics)
    tip_speed, duration = tip_speed_use(problem, trajectory, tracking), duration_use(problem, trajectory)
    keep = keep_uses(problem, trajectory)
    tightest = clearances[0] if clearances else None
    problems = []
    if tightest is not None and tightest.margin < -KEPT_WITHIN:
        problems.append(
            f"{tightest.link} comes to {tightest.distance:.3f} m of {tightest.name} "
            f"at {problem.begins + tightest.time:.2f} s, {length_text(-tightest.margin)} closer than allowed"
        )
    problems += [_described(use, problem) for use in (position, velocity, acceleration) if not use.kept]
    problems += _task_problems(problem, trajectory, tracking, kinematics)
    problems += [use.words for use in keep if not use.kept]
    others = (use for use in (effort, hydraulics, tip_speed, duration) if use is not None and not use.kept)
    problems += [_described(use, problem) for use in others]
    return Certificate(
        clearances, position=position, velocity=velocity, acceleration=acceleration, effort=effort,
        hydraulics=hydraulics, tracking=tracking, tip_speed=tip_speed, problems=tuple(problems), keep=keep,
        duration=duration,
    )  # fmt: skip


def _described(use: LimitUse, problem: Problem) -> str:
    """The sentence about a limit that does not hold, on the clock of the sequence if the problem is one of its legs."""
    return replace(use, time=use.time + problem.begins).describe()


def describe_step(problem: Problem, step: WaypointStep) -> str:
    """How far a joint moves from one waypoint of the problem's path to another, in words."""
    assert problem.path is not None
    name, unit = problem.robot.joint_names[step.joint], problem.robot.joint_units[step.joint]
    places = f"from waypoint {problem.path.number(step.before)} to {problem.path.number(step.after)}"
    size, allowed = beside_bounds(step.size, step.allowed, places=".4g", bounds_as=".4g")
    return f"{name} moves by {size} {unit} {places}; max_joint_step allows {allowed} {unit}"


def _describe_turn(problem: Problem, turn: SpotTurn) -> str:
    """How far a joint turns on the spot, in words."""
    assert problem.path is not None
    name, unit = problem.robot.joint_names[turn.joint], problem.robot.joint_units[turn.joint]
    place = f"at {problem.path.describe(turn.station)} of {problem.path.describe_end()}"
    return f"{name} moves by {turn.size:.4g} {unit} while the tip stands {place}; turn_on_the_spot is false"


def _task_problems(problem: Problem, trajectory: Trajectory, tracking: Tracking, kinematics: Kinematics) -> list[str]:
    """The problems of the motion's start, its velocities, and its task, in words."""
    found, q = [], trajectory.q[0]
    if problem.start_target is not None and max(problem.start_target.distances(kinematics.at(q))) > _STARTS_AT:
        found.append("the motion does not begin at the start of the scene")
    if not np.allclose(trajectory.v, trajectory.own_velocities(), rtol=_SAME_VELOCITY, atol=_SAME_VELOCITY):
        found.append("the velocities at the samples are not those of the motion")
    if problem.start_q is not None and np.max(np.abs(q - problem.start_q)) > _STARTS_AT_JOINTS:
        found.append("the motion does not begin at the start of the scene")
    if problem.wait is not None:
        if trajectory.duration < problem.wait * (1.0 - _WAITS_WITHIN):
            waited, asked = beside_bounds(trajectory.duration, problem.wait, places=".3g", bounds_as=".3g")
            found.append(f"the machine waits {waited} s instead of {asked} s")
        if np.max(np.abs(trajectory.q - q)) > _STARTS_AT_JOINTS:
            found.append("the machine moves while it is to wait")
    path = problem.scene.task.path
    if not tracking.done:
        found.append(tracking.shortfall)
    elif tracking.detours and path is not None and not path.detour:
        longest = max(tracking.detours, key=lambda detour: detour.length)
        found.append(f"the tip leaves the path {longest.place}, {longest.size}, and detours are not allowed")
    step = tracking.joint_step
    if step is not None and not step.kept:
        found.append(describe_step(problem, step))
    if tracking.spot_turn is not None:
        found.append(_describe_turn(problem, tracking.spot_turn))
    return found
