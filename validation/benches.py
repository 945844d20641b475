"""Every benchmark as one function that returns its figures, at a short and a long setting.

A new benchmark is one function here, and one entry in `BENCHES`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from backhoe_planner.motion import OBJECTIVES
from validation import goal_runs, planning_runs, pose_paths
from validation.bench_figures import Figure
from validation.certificate_attack import attack_seeds, summarise
from validation.sites import KINDS
from validation.startup_times import startup_figures
from validation.step_times import LawDrive, ServoDrive, obstacle_course, time_in_turn
from validation.walking_people import walk_through

_TIME_NOISE = 0.2  # of the ratio of a time to its reference, measured together on a shared machine
_TAIL_NOISE = 0.4  # the same of a 99th percentile
_COST_NOISE = 0.02  # of the costs of motions: other rounding, another order of the search
_REFERENCE_CALLS = 300
_PEOPLE_START = np.array([0.0, 0.3, -0.9, -0.5])  # of the backhoe, stretched out low


def _startup(long: bool) -> list[Figure]:
    return startup_figures(runs=10 if long else 5, arms=[("panda", "panda_hand_tcp"), ("ur5", "tool0")][: 1 + long])


def _planning(long: bool) -> list[Figure]:
    keys = planning_runs.all_keys(
        6 if long else 1, machines=["backhoe", "panda"], kinds=KINDS, tasks=["goal", "path"], seed=3
    )
    rows, interrupted = planning_runs.run(keys, planning_runs.Settings(refute=long), jobs=1)
    _check_complete(interrupted)
    figures = []
    for machine in ("backhoe", "panda"):
        for task in ("goal", "path"):
            some = [row for row in rows if (row.machine, row.task) == (machine, task)]
            name = f"planning: {machine}, {task}s"
            figures += [_share(f"{name}, verified", [row.verdict == "verified" for row in some])]
            timed = [(row.seconds, row.reference) for row in some if row.reference]
            if timed:
                figures.append(_mean_time(f"{name}, time", [a for a, _ in timed], [b for _, b in timed]))
    return [*figures, _count("planning: refuted or errors", sum(row.is_wrong for row in rows))]


def _goals(long: bool) -> list[Figure]:
    machines = ["backhoe", "panda", "telescope"] if long else ["backhoe", "panda"]
    keys = planning_runs.all_keys(4 if long else 1, machines=machines, kinds=KINDS, tasks=["goal"], seed=31)
    figures = []
    for objective in ("time", "work"):
        rows, interrupted = goal_runs.run(keys, goal_runs.Settings(objective=objective), jobs=1)
        _check_complete(interrupted)
        figures += [
            _share(f"goals: least {objective}, verified", [row.verified for row in rows]),
            _count(f"goals: least {objective}, below a bound", len(goal_runs.violations(rows, goal_runs.Best()))),
        ]
        above = [row.cost / row.bound for row in rows if row.cost is not None and row.bound]
        costs = [row.cost for row in rows if row.cost is not None]
        for name, unit, values in (("over the bound", "", above), ("cost", OBJECTIVES[objective].unit, costs)):
            if values:
                figures.append(
                    Figure(
                        name=f"goals: least {objective}, {name}", value=_geometric_mean(values), unit=unit,
                        noise=_COST_NOISE,
                    )
                )  # fmt: skip
    return figures


def _poses(long: bool) -> list[Figure]:
    machines = pose_paths.MACHINES if long else tuple(pose_paths.MACHINES)[:1]
    kinds = tuple(pose_paths.KINDS) if long else tuple(pose_paths.KINDS)[:3]
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for machine in machines:
            robot = pose_paths.load_arm(machine, Path(folder))
            results += [pose_paths.solve(pose_paths.draw(kind, robot, machine, 0)) for kind in kinds]
    seconds = [result.seconds for result in results]
    return [
        _share("poses: verified", [result.verdict == "verified" for result in results]),
        _mean_time("poses: time", seconds, [_reference()] * len(seconds)),
        Figure(
            name="poses: duration of the motions", value=_geometric_mean([result.duration for result in results]),
            unit="s", noise=_COST_NOISE,
        ),
    ]  # fmt: skip


def _step(long: bool) -> list[Figure]:
    rng = np.random.default_rng(0)
    problem = obstacle_course(bp.load_robot("example:backhoe"), 10, rng)
    drive = LawDrive(problem, rng)
    drive.take(100)  # warm up
    timed = time_in_turn(problem, drive, 20_000 if long else 3000)
    alone = float(np.median(timed.calls))
    return [_median_time(f"step: {name}", times, alone) for name, times in timed.steps.times.items()]


def _servo(long: bool) -> list[Figure]:
    rng = np.random.default_rng(0)
    robot = bp.load_robot("example:backhoe")
    problem = obstacle_course(robot, 20, rng)
    drive = ServoDrive(bp.Servo(robot, problem.scene), 5, rng)
    drive.take(500)  # warm up
    timed = time_in_turn(problem, drive, 20_000 if long else 4000)
    alone, processor = float(np.median(timed.calls)), timed.steps.whole
    return [
        _median_time("servo: a step", processor, alone),
        Figure(
            name="servo: a step, 99th percentile", value=float(np.percentile(processor, 99)), unit="us",
            noise=_TAIL_NOISE, reference=alone,
        ),
    ]  # fmt: skip


def _servo_people(long: bool) -> list[Figure]:
    robot = bp.load_robot("example:backhoe")
    walk = walk_through(
        robot, _PEOPLE_START, clearance=0.3, steps=6000 if long else 1500, seed=0, repetitions=3 if long else 2
    )
    alone = 1e3 * _reference() / _REFERENCE_CALLS  # ms of one call
    return [
        _median_time("servo among people: a step", walk.times, alone, unit="ms"),
        _count("servo among people: touches what stands", int(walk.least < 0.0)),
        Figure(name="servo among people: most rows", value=float(walk.work[:, 0].max()), unit="", noise=0.1),
    ]


def _attack(long: bool) -> list[Figure]:
    summary = summarise(attack_seeds(range(200 if long else 20))[0])
    return [
        _count("attack: refuted", summary.refuted),
        _count("attack: errors", summary.errors),
        Figure(name="attack: proven lies below", value=summary.below[0], unit="", noise=_COST_NOISE),
        Figure(
            name="attack: called safe", value=summary.safe / summary.comparisons, unit="", better="more",
            noise=_COST_NOISE,
        ),
        _mean_time("attack: a comparison", [summary.seconds / summary.comparisons], [_reference()]),
    ]  # fmt: skip


BENCHES: dict[str, Callable[[bool], Sequence[Figure]]] = {
    "startup": _startup,
    "planning": _planning,
    "goals": _goals,
    "poses": _poses,
    "step": _step,
    "servo": _servo,
    "people": _servo_people,
    "attack": _attack,
}
"""By name, the function that returns the figures of a benchmark at its long or short setting."""


def _reference() -> float:
    """The least of three processor times of 300 calls of `Proximity.distances` among ten obstacles [s]."""
    from time import process_time

    rng = np.random.default_rng(0)
    robot = bp.load_robot("example:backhoe")
    proximity = bp.Proximity(robot, obstacle_course(robot, 10, rng).obstacles)
    postures = [robot.random_q(rng) for _ in range(_REFERENCE_CALLS)]
    found = []
    for _ in range(3):
        begun = process_time()
        for q in postures:
            proximity.distances(q)
        found.append(process_time() - begun)
    return min(found)


def _check_complete(interrupted: bool) -> None:
    if interrupted:
        raise KeyboardInterrupt


def _share(name: str, holds: Sequence[bool]) -> Figure:
    return Figure(name=name, value=sum(holds) / len(holds), unit="", better="more", noise=0.0)


def _count(name: str, count: int) -> Figure:
    """A count of events that should not happen."""
    return Figure(name=name, value=float(count), unit="", noise=0.0)


def _mean_time(name: str, seconds: Sequence[float], references: Sequence[float]) -> Figure:
    """Geometric means, so that slow sites do not dominate."""
    value, reference = _geometric_mean(seconds), _geometric_mean(references)
    return Figure(name=name, value=value, unit="s", noise=_TIME_NOISE, reference=reference)


def _median_time(name: str, times: Sequence[float] | np.ndarray, alone: float, unit: str = "us") -> Figure:
    return Figure(name=name, value=float(np.median(times)), unit=unit, noise=_TIME_NOISE, reference=alone)


def _geometric_mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))
