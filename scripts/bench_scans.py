#!/usr/bin/env python
"""What a survey costs: a scan of a million points, a terrain of a million cells, a mesh of 100,000 triangles.

The same yard is taken in, planned in and driven in without them, with each of them and with
all, in one run; times are those on the processor, and what counts are the ratios. Every
verified plan is checked against the raw points. The results are in docs/measurements.md.

    python scripts/bench_scans.py [--goals 6] [--steps 4000] [--seed 1] [--points 1000000] [--cells 1000]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from validation.scans import KINDS, measure, write_survey


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", type=int, default=6)
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
        costs = [
            measure(robot, survey, kinds, count=options.goals, steps=options.steps, seed=options.seed)
            for kinds in [(), *sets]  # the first run warms up
        ][1:]
    plain = costs[0]
    head = ("with", "intake s", "plans", "verified", "step mean us", "p99", "worst", "memory MB", "page MB", "gap m")
    print("".join(f"{name:>15}" for name in head))
    for kinds, cost in zip(sets, costs, strict=True):
        kept = np.isfinite(cost.durations) & np.isfinite(plain.durations)
        ratio = float(cost.plans[kept].sum() / plain.plans[kept].sum())
        steps = f"{cost.steps.mean():.0f} ({cost.steps.mean() / plain.steps.mean():.2f})"
        row = (
            "+".join(kinds) if len(kinds) < 2 else "all", f"{cost.intake:.2f}", f"{ratio:.2f} times",
            f"{np.isfinite(cost.durations).sum()} of {len(cost.durations)}", steps,
            f"{np.percentile(cost.steps, 99):.0f}", f"{cost.steps.max():.0f}",
            f"{cost.memory - plain.memory:+.0f}", f"{cost.page:.1f}",
            f"{cost.least_gap:.3f}",
        )  # fmt: skip
        print("".join(f"{value:>15}" for value in row))


if __name__ == "__main__":
    main()
