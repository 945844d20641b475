"""Random sequences, planned leg by leg and with the next leg in mind.

A random sequence has the obstacles and the start of a random site (`validation.sites`), and six legs with
one or several alternative goals each, such as places to dump at: the tips of random clear configurations,
each with any pitch or with a range of pitch.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from backhoe_planner.planning import EFFORTS, EffortName, Leg, plan_legs
from validation.campaigns import call_for_all
from validation.habitats import load_machine
from validation.sites import SPARE, SiteKey, random_site

MACHINE = "backhoe"
LEGS = 6
_KINDS = ("open", "cluttered")
_HALF_RANGE = 0.5  # rad to each side of a configuration's pitch, if a goal has a pitch range
_LOWEST = -1.0  # m: least height of the goals; deeper ones are mostly in the ground
_TRIES = 2000


@dataclass(frozen=True)
class Row:
    """One random sequence.

    Attributes
    ----------
    index: of the sequence.
    objective: of all its legs.
    alone, ahead: its cost leg by leg, and with the next leg in mind [unit]; None if not verified.
    alone_seconds, ahead_seconds: processor time of planning [s].
    tried: number of planned alternatives with other ends.
    alone_duration, ahead_duration: of the motions [s]; 0 if not verified.
    """

    index: int
    objective: str
    alone: float | None
    ahead: float | None
    alone_seconds: float
    ahead_seconds: float
    tried: int
    alone_duration: float = 0.0
    ahead_duration: float = 0.0

    @property
    def saved(self) -> float | None:
        """The saved part of the cost; None if one of the two is not verified."""
        return None if self.alone is None or self.ahead is None else 1.0 - self.ahead / self.alone

    @property
    def is_worse(self) -> bool:
        """Whether planning with the next leg in mind made it worse."""
        return self.alone is not None and (self.ahead is None or self.ahead > self.alone * (1.0 + 1e-9))


def random_sequence(robot: bp.Robot, index: int, *, seed: int, objective: str, places: int) -> bp.Scene:
    """A random scene with a sequence of goals, `places` per leg; `robot` is `load_machine(MACHINE)`."""
    site = random_site(robot, SiteKey(MACHINE, _KINDS[index % len(_KINDS)], "goal", index, seed))
    content = site.scene.to_dict()
    rng = np.random.default_rng([seed, index, 4])
    proximity = bp.Proximity(robot, bp.build_obstacles(site.scene, robot))
    kinematics = bp.Kinematics(robot)
    goals: list[dict[str, object]] = []
    for _ in range(_TRIES):
        q = robot.random_q(rng)
        tightest = proximity.tightest(q)
        at = kinematics.at(q)
        if at.tip_position[2] < _LOWEST or (tightest is not None and tightest.margin < SPARE):
            continue
        goal: dict[str, object] = {"position": at.tip_position.tolist()}
        if rng.random() < 0.5:
            goal["pitch"] = [at.pitch - _HALF_RANGE, at.pitch + _HALF_RANGE]
        goals.append(goal)
        if len(goals) == LEGS * places:
            break
    legs = [{"name": f"leg {k + 1}", "goal": goals[k * places : (k + 1) * places]} for k in range(LEGS)]
    content |= {"task": {"sequence": legs}, "objective": objective}
    return bp.scene_from_dict(content, folder=site.scene.folder)


def run_sequence(index: int, *, seed: int, objective: str, places: int, effort: EffortName) -> Row:
    """Plan one random sequence both ways."""
    robot = load_machine(MACHINE)
    problem = bp.build_problem(robot, random_sequence(robot, index, seed=seed, objective=objective, places=places))
    costs, seconds, durations, tried = [], [], [], 0
    for ahead in (False, True):
        begun = time.process_time()
        found = plan_legs([Leg(leg) for leg in problem.legs], effort=EFFORTS[effort], ahead=ahead)
        seconds.append(time.process_time() - begun)
        verified = found.certificate.verified
        costs.append(found.cost if verified else None)
        durations.append(found.trajectory.duration if verified else 0.0)
        tried = found.tried
    return Row(index, objective, costs[0], costs[1], seconds[0], seconds[1], tried, durations[0], durations[1])


def run_all(
    count: int,
    *,
    seed: int,
    objective: str,
    places: int,
    effort: EffortName,
    jobs: int = -1,
    folder: Path | None = None,
) -> tuple[list[Row], bool]:
    """`count` random sequences planned both ways, and whether the run was interrupted; see `call_for_all`."""
    call = partial(run_sequence, seed=seed, objective=objective, places=places, effort=effort)
    return call_for_all(call, range(count), result=Row, jobs=jobs, folder=folder)


def describe(rows: Sequence[Row]) -> str:
    """The results of the rows in a few lines."""
    saved = np.array([row.saved for row in rows if row.saved is not None])
    lines = [
        f"{len(rows)} sequences, objective {rows[0].objective}: verified leg by leg "
        f"{sum(row.alone is not None for row in rows)}, with the next leg in mind "
        f"{sum(row.ahead is not None for row in rows)}"
    ]
    if len(saved):
        quarters = np.percentile(100.0 * saved, [0, 10, 25, 50, 75, 90, 100])
        lines.append(
            "saved [%], least, 10th, 25th, median, 75th, 90th, most: " + ", ".join(f"{q:.1f}" for q in quarters)
        )
    times = [(row.alone_seconds, row.ahead_seconds) for row in rows]
    alone, ahead = np.median(times, axis=0)
    lines.append(f"planning, median: {alone:.2f} s leg by leg, {ahead:.2f} s with the next leg in mind")
    return "\n".join(lines)
