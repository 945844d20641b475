#!/usr/bin/env python
"""The times of one reactive step and one servo step on the backhoe among obstacles.

The machine drives its tip from one random goal to the next among seeded obstacles that stand
still; where no step is clear, its motion ends and it begins again at the start. The parts of a
reactive step, the whole of it and the servo's step are timed. After every hundred steps the
Pinocchio and coal calls alone, and Pink if installed, are timed on the same configurations (see
validation/step_times.py), so that other load on the computer slows all of them. Each ratio is
given with the range of the middle half of the blocks. With several runs the same steps are
repeated and the least time of each counts, so that other load matters little. The results are
in docs/measurements.md.

    python scripts/bench_step.py [--steps 5000] [--obstacles 10] [--runs 1] [--save FILE] [--against FILE]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from backhoe_planner.motion import Problem
from validation.step_times import (
    Drive,
    LawDrive,
    ServoDrive,
    TimesInTurn,
    collecting_only_new,
    least_of,
    obstacle_course,
    percentiles,
    time_in_turn,
)
from validation.tables import Row, markdown

_WARM_UP = 300  # steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--obstacles", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runs", type=int, default=1, help="of the same steps, of which the least times count")
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    parser.add_argument("--against", type=Path, help="figures saved before, to compare with")
    options = parser.parse_args()
    robot = bp.load_robot("example:backhoe")
    runs = [time_drives(robot, options.obstacles, options.seed, options.steps) for _ in range(options.runs)]
    problem, law, _ = runs[0]
    timed = {name: least_of([found[name] for _, _, found in runs]) for name in runs[0][2]}
    reactive = timed["reactive step"]
    results = {name: percentiles(times) for name, times in reactive.steps.times.items()}
    results["Pinocchio and coal alone"] = percentiles(reactive.calls)
    if len(reactive.pink):
        results["Pink with barrier"] = percentiles(reactive.pink)
    results["servo step"] = percentiles(timed["servo step"].steps.whole)
    before = json.loads(options.against.read_text()) if options.against else {}
    pairs = len(bp.Proximity(robot, problem.obstacles).pairs)
    print(f"{options.obstacles} obstacles, {pairs} pairs, {options.steps} steps")
    print(f"{reactive.steps.rows:.1f} rows in a reactive step; the motion ended {law.ended} times\n")
    columns = [dict(figures) for figures in results.values()]
    if before:
        columns = [
            {**figures, "median before": before.get(name, {}).get("median", np.nan)}
            for name, figures in zip(results, columns, strict=True)
        ]
    rows: list[Row] = [{"[us]": name, **figures} for name, figures in zip(results, columns, strict=True)]
    print(markdown(rows))
    print()
    for name, one in timed.items():
        tail = np.percentile(one.steps.whole, 99) / np.median(one.steps.whole)
        print(f"{name}: {one.spread()} times the library calls alone; p99 {tail:.1f} times its median")
    if len(reactive.pink):
        print(f"Pink takes {np.median(reactive.pink) / np.median(reactive.steps.whole):.1f} times a reactive step")
    else:
        print("Pink is not installed: no comparison with it")
    if options.save:
        options.save.write_text(json.dumps(results, indent=2) + "\n")


def time_drives(
    robot: bp.Robot, obstacles: int, seed: int, steps: int
) -> tuple[Problem, LawDrive, dict[str, TimesInTurn]]:
    """Return the obstacle course of a seed, the drive of the law, and the times of both kinds of steps by name."""
    rng = np.random.default_rng(seed)
    problem = obstacle_course(robot, obstacles, rng)
    law = LawDrive(problem, rng)
    drives: dict[str, Drive] = {
        "reactive step": law,
        "servo step": ServoDrive(bp.Servo(robot, problem.scene), 0, rng),
    }
    timed: dict[str, TimesInTurn] = {}
    for name, drive in drives.items():
        drive.take(_WARM_UP)
        with collecting_only_new():
            timed[name] = time_in_turn(problem, drive, steps, pink=name == "reactive step")
    return problem, law, timed


if __name__ == "__main__":
    main()
