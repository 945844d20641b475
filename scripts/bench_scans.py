#!/usr/bin/env python
"""The cost of a survey: a scan of a million points, a terrain of a million cells, a mesh of 100,000 triangles.

In one run, the same yard is loaded, planned in and driven in without them, with each of them and
with all. It is also driven in with primitives in the scan's place, which shows the cost of nearness
by itself. Times are processor times; the ratios count. All variants take turns at each goal and at
the steps. Every verified plan is checked against the raw points. A goal that is not reached is not
counted if no configuration with the tip there keeps its clearance from the raw points. The results
are in docs/measurements.md.

    python scripts/bench_scans.py [--goals 12] [--steps 4000] [--seed 1] [--points 1000000] [--cells 1000]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from validation.scans import KINDS, SCAN, SOLIDS, drive_in_turn, goals, measure, plan_in_turn, write_survey


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", type=int, default=12, help="that are reached without surveys")
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--cells", type=int, default=1000)
    parser.add_argument("--triangles", type=int, default=100_000)
    options = parser.parse_args()
    robot = bp.load_robot("example:backhoe")
    with tempfile.TemporaryDirectory() as folder:
        rng = np.random.default_rng(options.seed)
        survey = write_survey(
            Path(folder), rng, points=options.points, cells=options.cells, triangles=options.triangles
        )
        sets: list[tuple[str, ...]] = [(), *((kind,) for kind in KINDS), KINDS]
        goal = next(goals(robot, np.random.default_rng(options.seed)))
        costs = [measure(robot, survey, kinds, goal=goal) for kinds in [(), *sets]][1:]  # the first run warms up
        *taken, solid = drive_in_turn(
            robot, survey, [*sets, (SOLIDS,)], goal=goal, steps=options.steps, seed=options.seed
        )
        plans = plan_in_turn(robot, survey, sets, count=options.goals, seed=options.seed)
    plain = costs[0]
    ratios = plans.seconds / plans.seconds[:, :1]
    sums = plans.seconds.sum(axis=0) / plans.seconds[:, 0].sum()
    head = (
        "with", "intake s", "plans: median", "sum", "most", "verified", "duration", "step mean us", "p99", "worst",
        "memory MB", "page MB", "gap m",
    )  # fmt: skip
    print("".join(f"{name:>15}" for name in head))
    for number, (kinds, cost, times) in enumerate(zip(sets, costs, taken, strict=True)):
        steps = f"{times.mean():.0f} ({times.mean() / taken[0].mean():.2f})"
        lasts, free = plans.durations[:, number], ~plans.blocked[:, number]
        row = (
            "+".join(kinds) if len(kinds) < 2 else "all", f"{cost.intake:.2f}",
            f"{np.median(ratios[:, number]):.2f} times", f"{sums[number]:.2f}", f"{ratios[:, number].max():.2f}",
            f"{np.isfinite(lasts[free]).sum()} of {free.sum()}",
            f"{np.nanmedian(lasts / plans.durations[:, 0]):.3f}", steps,
            f"{np.percentile(times, 99):.0f}", f"{times.max():.0f}",
            f"{cost.memory - plain.memory:+.0f}", f"{cost.page:.1f}",
            f"{plans.least_gap[number]:.3f}",
        )  # fmt: skip
        print("".join(f"{value:>15}" for value in row))
    by_scan = taken[sets.index((SCAN,))].mean() / solid.mean()
    print(
        f"with primitives in place of the scan a step takes {solid.mean():.0f} us "
        f"({solid.mean() / taken[0].mean():.2f}), 99th percentile {np.percentile(solid, 99):.0f}: "
        f"beside the scan {by_scan:.2f} times that"
    )
    print(f"plans without surveys take {', '.join(f'{taken:.2f}' for taken in plans.seconds[:, 0])} s")


if __name__ == "__main__":
    main()
