"""The duration of plans followed live without new obstacles, compared with their planned duration.

Random verified plans of three machines (`validation.placements`) are streamed through a servo from
their start. The planner knew all obstacles. Each drive may end one step after the step in which the
plan ends, in which the machine comes to rest. If a plan leads close past an obstacle or to a joint
limit, the servo may slow the machine down: it keeps room to brake all joints in proportion with 80 % of
their acceleration, and a plan does not. Such drives are counted separately.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import count as numbers
from pathlib import Path
from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.live import Status
from validation.campaigns import Campaign
from validation.obstacles import MACHINES
from validation.placements import Followed, Immediate, random_plan

_STEPS = (0.001, 0.004)  # s, of the servo
_HOLDING = (Status.SLIDING, Status.NEAR_LIMIT, Status.EVADING)
_LATEST = 10.0  # s after the planned end at which a drive ends


@dataclass(frozen=True)
class UndisturbedDrive:
    """One drive.

    Attributes
    ----------
    site: name of the site.
    dt: step of the servo [s].
    duration: as planned [s].
    steps_late: steps after the one in which the plan ends.
    deviation: greatest, of any joint [rad or m].
    arrived: at the end of the plan.
    held_back: steps in which the servo slowed the machine down, at a limit, an obstacle or a zone.
    """

    site: str
    dt: float
    duration: float
    steps_late: int
    deviation: float
    arrived: bool
    held_back: int


def follow_undisturbed(
    *, count: int, seed: int, jobs: int, folder: Path | None, watch: Callable[[int, UndisturbedDrive], object]
) -> Followed[UndisturbedDrive]:
    """Follow `count` plans of every machine; see `Campaign`."""
    drives: list[UndisturbedDrive] = []
    call = partial(follow_on_site, seed=seed)
    with Campaign(call, list[UndisturbedDrive], jobs=jobs, folder=folder) as campaign:
        for machine in MACHINES:
            cases = ((machine, number) for number in numbers(1))
            drives += campaign.first(cases, count * len(_STEPS), most=len(_STEPS), watch=watch)
    return Followed(drives, _figures(drives), campaign.interrupted)


def follow_on_site(case: tuple[str, int], *, seed: int) -> list[UndisturbedDrive]:
    """The drives along the plan of a machine's site, by its number, one per `dt`; none if the plan is not verified."""
    machine, number = case
    site, plan = random_plan(machine, number, seed=seed)
    return [_drive(plan, str(site), dt) for dt in _STEPS] if plan.verified else []


def _figures(drives: list[UndisturbedDrive]) -> dict[str, Any]:
    free, held = [drive for drive in drives if not drive.held_back], [drive for drive in drives if drive.held_back]
    return {
        "followed": len(drives),
        "not arrived": sum(not drive.arrived for drive in drives),
        "never held back": len(free),
        "of these more than one step late": sum(drive.steps_late > 1 for drive in free),
        "their greatest deviation [rad or m]": max((drive.deviation for drive in free), default=0.0),
        "held back": len(held),
        "of those more than one step late": sum(drive.steps_late > 1 for drive in held),
        "the latest of those [s]": max((drive.steps_late * drive.dt for drive in held), default=0.0),
    }


def _drive(plan: bp.Plan, site: str, dt: float) -> UndisturbedDrive:
    servo = bp.Servo(plan.robot, plan.scene, dt, q=plan.trajectory.q[0])
    follower = bp.PlanFollower(servo, plan, executor=Immediate())
    duration = plan.trajectory.duration
    steps, deviation, held_back = 0, 0.0, 0
    while not follower.done and steps * dt < duration + _LATEST:
        followed = follower.step()
        steps += 1
        state = followed.state
        deviation = max(deviation, followed.deviation)
        held_back += state.status in _HOLDING or state.pace < 1.0
    late = steps - math.ceil(duration / dt - 1e-6)
    return UndisturbedDrive(site, dt, duration, late, float(np.round(deviation, 6)), follower.done, held_back)
