"""The certificate of a whole task: of one motion, or of a sequence, joined from those of its legs.

Every leg is proven by itself, with its own load, limits, obstacles and conditions, between the samples at
which it begins and ends. The sample at which two legs meet belongs to both.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, TypeVar, get_args

from backhoe_planner.errors import check_kind
from backhoe_planner.machine import Robot
from backhoe_planner.motion import LegPart, Problem, Tracking, Trajectory, build_problem, leg_parts
from backhoe_planner.proof.certificate import Certificate, LegCertificate, certify_motion
from backhoe_planner.proof.keeping import KeepUse
from backhoe_planner.proof.limits import LimitName, LimitUse
from backhoe_planner.site import Obstruction, Scene

_Use = TypeVar("_Use", LimitUse, KeepUse)


def certify(robot: Robot, scene: Scene, trajectory: Trajectory) -> Certificate:
    """Prove what holds over a whole motion.

    Parameters
    ----------
    robot, scene: the machine and its task; they need not have been checked against each other.
    trajectory: the motion; for a sequence, `Trajectory.begins` tells where its legs begin.

    Raises
    ------
    SceneError, RobotError: the scene does not fit the machine.
    InputError: the trajectory has another number of joints, or its legs do not fit the sequence.
    """
    check_kind(trajectory, Trajectory, key="trajectory")
    return certify_problem(build_problem(robot, scene), trajectory)


def certify_problem(problem: Problem, trajectory: Trajectory) -> Certificate:
    """Prove what holds over a whole motion, for a problem that is already built; see `certify`."""
    parts = leg_parts(problem, trajectory)
    if not problem.legs:
        return certify_motion(problem, trajectory)
    return join_certificates(
        [_certified(part) for part in parts], missing=[leg.name for leg in problem.legs[len(parts) :]]
    )


def _certified(part: LegPart) -> LegCertificate:
    return LegCertificate(part.name, part.first, part.last, part.begins, certify_motion(part.problem, part.motion))


def join_certificates(legs: Iterable[LegCertificate], *, missing: Iterable[str]) -> Certificate:
    """The certificate of a sequence: the tightest figures over its legs.

    Parameters
    ----------
    legs: the certificates of the legs in their order; at least one.
    missing: names of the legs that the motion does not begin.
    """
    legs, missing = tuple(legs), tuple(missing)
    clearances: dict[tuple[str, str], Obstruction] = {}
    for leg in legs:
        for found in leg.certificate.clearances:
            key = (found.kind, found.obstacle)
            if key not in clearances or found.margin < clearances[key].margin:
                clearances[key] = replace(found, time=found.time + leg.begins)
    problems = [f"leg {leg.name!r}: {problem}" for leg in legs for problem in leg.certificate.problems]
    problems += [f"the leg {name!r} is not begun" for name in missing]
    uses: dict[str, Any] = {name: _most(legs, name) for name in get_args(LimitName)}
    return Certificate(
        tuple(sorted(clearances.values(), key=lambda found: found.margin)),
        **uses,
        tracking=_whole_tracking(legs, missing),
        problems=tuple(problems),
        keep=tuple(
            replace(_later(use, leg), words=f"leg {leg.name!r}: {use.words}")
            for leg in legs
            for use in leg.certificate.keep
        ),
        legs=legs,
    )


def _later(found: _Use, leg: LegCertificate) -> _Use:
    """`found` with the name of its leg, and its time on the clock of the whole motion."""
    return replace(found, time=found.time + leg.begins, leg=leg.name)


def _most(legs: tuple[LegCertificate, ...], limit: LimitName) -> LimitUse | None:
    """The greatest use of a limit over all legs; None if no leg has it."""
    uses = [_later(use, leg) for leg in legs if (use := leg.certificate.uses.get(limit)) is not None]
    return max(uses, key=lambda use: use.ratio, default=None)


def _whole_tracking(legs: tuple[LegCertificate, ...], missing: tuple[str, ...]) -> Tracking:
    """How well the tip keeps to its task over all legs: errors are the greatest, lengths add up."""
    found = [leg.certificate.tracking for leg in legs]
    fastest = max(range(len(legs)), key=lambda index: found[index].max_speed)
    followed = sum(one.followed for one in found)
    mean = sum(one.mean_error * one.followed for one in found) / followed if followed else found[-1].mean_error
    return Tracking(
        done=all(one.done for one in found) and not missing,
        shortfall="; ".join(
            [f"leg {leg.name!r}: {one.shortfall}" for leg, one in zip(legs, found, strict=True) if not one.done]
            + [f"the leg {name!r} is not begun" for name in missing]
        ),
        max_error=max(one.max_error for one in found),
        mean_error=mean,
        max_angle_error=max(one.max_angle_error for one in found),
        path_length=sum(one.path_length for one in found),
        followed=followed,
        approach_time=next((leg.begins + one.approach_time for leg, one in zip(legs, found, strict=True)), 0.0),
        detours=tuple(
            replace(detour, time_from=detour.time_from + leg.begins, time_to=detour.time_to + leg.begins)
            for leg, one in zip(legs, found, strict=True)
            for detour in one.detours
        ),
        max_speed=found[fastest].max_speed,
        max_speed_time=found[fastest].max_speed_time + legs[fastest].begins,
    )
