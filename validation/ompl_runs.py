"""The planner and OMPL's own on the same sites: who finds a path, its duration, and which paths are alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from validation.campaigns import call_for_all
from validation.goal_runs import Best, Settings, digest_of, name_of, with_objective
from validation.habitats import load_machine
from validation.ompl_planners import PLANNERS, can_be_moved, pose_challenge, same_end, solve
from validation.sites import Site, SiteKey
from validation.tables import Row as TableRow
from validation.tables import markdown, percent

OWN = "as ours"  # the seconds that our plan took
_SHORTER = 0.97  # part of our duration, below which another motion counts as shorter


@dataclass(frozen=True)
class Run:
    """The result of one planner on one site in its time.

    Attributes
    ----------
    planner: of OMPL, or ``ours``.
    allowed: its processor time in seconds, or `OWN`.
    seconds: the same as a number; for ours the time that it took [s].
    duration: of the motion [s]; None if none was found or the certificate does not hold.
    ours: duration of our motion [s]; None if there is none.
    end: whether it ends in the same configuration as ours.
    moved: whether the path can be deformed straight into ours; then both are of one homotopy class.
    """

    name: str
    digest: str
    planner: str
    allowed: str
    seconds: float
    duration: float | None
    ours: float | None
    end: bool = True
    moved: bool = True


def compare_on_site(
    key: SiteKey, settings: Settings, seconds: Sequence[float], draw: Callable[[bp.Robot, SiteKey], Site]
) -> list[Run]:
    """Plan one site with every planner, in the time that our plan took and in each of `seconds`."""
    robot = load_machine(key.machine)
    scene = with_objective(draw(robot, key).scene, "time")
    name, digest, seed = name_of(key, "time"), digest_of(scene), settings.planning_seeds[0]
    begun = time.process_time()
    plan = bp.plan(robot, scene, seed=seed, effort=settings.effort)
    took = time.process_time() - begun
    ours = float(plan.metrics.duration) if plan.verified else None
    runs = [Run(name, digest, "ours", OWN, took, ours, ours)]
    challenge = pose_challenge(robot, scene, seed=seed)
    if challenge is None:
        return runs
    check = challenge.check()
    for allowed, limit in ((OWN, took), *((f"{each:g} s", each) for each in seconds)):
        for planner in PLANNERS:
            found = solve(challenge, planner, limit, seed=seed)
            if found is None or not bp.certify(robot, scene, found.motion).verified:
                runs.append(Run(name, digest, planner, allowed, limit, None, ours))
                continue
            way: Matrix = plan.trajectory.q
            end = plan.verified and same_end(check.rate, found.way.q, way)
            moved = end and can_be_moved(check, found.way.q, way)
            runs.append(Run(name, digest, planner, allowed, limit, float(found.motion.duration), ours, end, moved))
    return runs


def compare(
    keys: Sequence[SiteKey],
    settings: Settings,
    seconds: Sequence[float],
    *,
    draw: Callable[[bp.Robot, SiteKey], Site],
    jobs: int,
    folder: Path | None = None,
    watch: Callable[[int, object], object] = lambda done, result: None,
) -> tuple[list[Run], bool]:
    """The runs on all sites, and whether the campaign was interrupted; see `call_for_all`."""
    call = partial(compare_on_site, settings=settings, seconds=seconds, draw=draw)
    found, interrupted = call_for_all(call, keys, result=list[Run], jobs=jobs, folder=folder, watch=watch)
    return [run for runs in found for run in runs], interrupted


def add_to_best(best: Best, runs: Sequence[Run]) -> None:
    """Add the motions of all planners to the best known."""
    for run in runs:
        if run.duration is not None:
            best.add(run.name, run.digest, run.duration, f"{run.planner}, {run.seconds:.2g} s")


def table(runs: Sequence[Run], best: Best) -> str:
    """A line for every planner and time, as text."""
    kinds = dict.fromkeys((run.planner, run.allowed) for run in runs)
    return markdown(
        [_figures(kind, [run for run in runs if (run.planner, run.allowed) == kind], best) for kind in kinds]
    )


def _figures(kind: tuple[str, str], runs: Sequence[Run], best: Best) -> TableRow:
    ratios = [run.duration / best.costs[run.name, run.digest] for run in runs if run.duration is not None]
    both = [run for run in runs if run.duration is not None and run.ours is not None]
    beside = [(run, run.duration / run.ours) for run in both if run.duration is not None and run.ours]
    return {
        "planner": kind[0],
        "time": kind[1],
        "sites": len(runs),
        "found": f"{percent(run.duration is not None for run in runs):.0f} %",
        "/ best: median": float(np.median(ratios)) if ratios else np.nan,
        "p90": float(np.quantile(ratios, 0.9)) if ratios else np.nan,
        "/ ours: median": float(np.median([ratio for _, ratio in beside])) if beside else np.nan,
        "shorter than ours": sum(ratio < _SHORTER for _, ratio in beside),
        "of these to another posture": sum(ratio < _SHORTER and not run.end for run, ratio in beside),
        "by another way": sum(ratio < _SHORTER and run.end and not run.moved for run, ratio in beside),
    }
