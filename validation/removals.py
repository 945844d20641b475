"""An obstacle put before the end of a plan while a servo follows it, and then removed.

Random verified plans of the backhoe (`validation.placements`) are streamed through a servo. A
ball, a box or a post appears that is up to `_DEEPEST` too close to the end of the plan, so that
the machine stops just before it. At once, or after longer than the patience of the follower, the
obstacle is removed. Nothing is in the way then, so each drive must arrive; `_PATIENCE` is longer
than the longest break of the follower.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import count as numbers
from pathlib import Path
from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.site import build_obstacles
from validation.campaigns import Campaign
from validation.obstacles import Record, appearing_obstacle
from validation.placements import Followed, Immediate, places_on_machine, random_plan, scene_content
from validation.servo_drives import stopping_line

_DT = 0.004  # s
_PER_PLAN = 6  # removals on every plan
_DEEPEST = 0.05  # m by which the obstacle's clearance is violated at the end of the plan
_LEAD = (0.3, 1.5)  # s before the end of the plan at which the obstacle appears
_STAYS = (0.0, 5.0)  # s after the planned end at which the obstacle is removed: before and after a search
_PATIENCE = 30.0  # s from the removal, in addition to the rest of the plan
_SPARE = 0.02  # m beyond the machine's clearance from the new obstacle while it brakes
_FARTHEST = 1.5  # m that the obstacle is moved at most until it is close enough
_TRIES = 20


@dataclass(frozen=True)
class Removal:
    """The result of one drive.

    Attributes
    ----------
    site, turn, obstacle: the plan and the obstacle.
    stayed: time of the removal after the planned end [s].
    before: status of the follower then.
    off, left: distance of the machine from the end of the plan [rad or m], and of its clock [s].
    arrived: at the end of the plan.
    status, reason: of the follower at the end.
    took: time from the removal [s].
    """

    site: str
    turn: int
    obstacle: str
    stayed: float
    before: str
    off: float
    left: float
    arrived: bool
    status: str
    reason: str
    took: float


def take_obstacles_away(
    *, count: int, seed: int, jobs: int, folder: Path | None, watch: Callable[[int, Removal], object]
) -> Followed[Removal]:
    """Put obstacles before the ends of plans and remove them; see `Campaign`."""
    call = partial(remove_on_site, seed=seed)
    with Campaign(call, list[Removal], jobs=jobs, folder=folder) as campaign:
        drives = campaign.first(numbers(1), count, most=_PER_PLAN, watch=watch)
    return Followed(drives, _figures(drives), campaign.interrupted)


def remove_on_site(number: int, *, seed: int) -> list[Removal]:
    """The drives to the end of the plan of a site, by its number; none if the plan is not verified."""
    site, plan = random_plan("backhoe", number, seed=seed)
    if not plan.verified:
        return []
    turns = range(_PER_PLAN)
    drives = (_drive(plan, np.random.default_rng([seed, number, turn, 1]), str(site), turn) for turn in turns)
    return [drive for drive in drives if drive is not None]


def _drive(plan: bp.Plan, rng: np.random.Generator, site: str, turn: int) -> Removal | None:
    """One drive; None if no obstacle fits near the end, or if the machine arrives in spite of it."""
    servo = bp.Servo(plan.robot, plan.scene, _DT, q=plan.trajectory.q[0])
    follower = bp.PlanFollower(servo, plan, executor=Immediate())
    appears, stays = plan.trajectory.duration - float(rng.uniform(*_LEAD)), float(rng.uniform(*_STAYS))
    while follower.step().plan_time < appears:
        pass
    new = _before_the_end(plan, rng, servo)
    if new is None:
        return None
    servo.add(new)
    for _ in range(int((plan.trajectory.duration - appears + stays) / _DT)):
        followed = follower.step()
    if followed.done:
        return None
    before, off = followed.status.value, float(np.abs(plan.trajectory.q[-1] - servo.q).max())
    left = plan.trajectory.duration - followed.plan_time
    servo.remove(new["name"])
    removed = servo.time
    while not followed.done and servo.time < removed + left + _PATIENCE:
        followed = follower.step()
    return Removal(
        site=site,
        turn=turn,
        obstacle=new["shape"],
        stayed=stays,
        before=before,
        off=off,
        left=left,
        arrived=followed.done,
        status=followed.status.value,
        reason=followed.reason,
        took=servo.time - removed,
    )


def _before_the_end(plan: bp.Plan, rng: np.random.Generator, servo: bp.Servo) -> Record | None:
    """A new obstacle a little too close to the end of the plan, clear of the machine's braking path."""
    motion, clearance = plan.trajectory, plan.scene.clearance
    line = stopping_line(servo)[::3]
    for _ in range(_TRIES):
        wanted = clearance - float(rng.uniform(0.0, _DEEPEST))
        here, end = places_on_machine(plan.robot, np.array([servo.q, motion.q[-1]]), rng)
        way = (end - here) / max(float(np.linalg.norm(end - here)), 1e-9)
        new = {"name": "new", **appearing_obstacle(end, rng)}
        place, near, far = np.array(new["position"]), 0.0, _FARTHEST
        while far - near > 1e-4:
            middle = 0.5 * (near + far)
            new["position"] = (place + middle * way).tolist()
            if _alone(plan, new).distances(motion.q[-1]).min() < wanted:
                near = middle
            else:
                far = middle
        found = new | {"position": (place + far * way).tolist()}
        alone = _alone(plan, found)
        if alone.distances(motion.q[-1]).min() < clearance - 1e-4 and all(
            alone.distances(q).min() > clearance + _SPARE for q in line
        ):
            return found
    return None


def _alone(plan: bp.Plan, new: Record) -> bp.Proximity:
    """Distances to a single obstacle."""
    scene = bp.scene_from_dict(scene_content(plan.scene) | {"obstacles": [new], "zones": []})
    return bp.Proximity(plan.robot, build_obstacles(scene, plan.robot), self_collision=False)


def _figures(drives: list[Removal]) -> dict[str, Any]:
    later = [drive.took - drive.left for drive in drives if drive.arrived]
    return {
        "taken away": len(drives),
        "stuck": sum(not drive.arrived for drive in drives),
        "endings": dict(Counter(f"{drive.before}, then {drive.status}" for drive in drives)),
        "later than the rest of the plan [s], median, p90, longest": (
            [float(np.quantile(later, part)) for part in (0.5, 0.9, 1.0)] if later else []
        ),
    }
