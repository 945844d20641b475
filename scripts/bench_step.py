#!/usr/bin/env python
"""How long one reactive step takes on the backhoe with ten obstacles.

The machine drives its tip from one random goal to the next among seeded obstacles.
Timed are the parts of a step and the whole; in the same run the Pinocchio and coal calls
alone, and Pink where it is installed (see validation/step_times.py). The results are in
docs/measurements.md.

    python scripts/bench_step.py [--steps 5000] [--obstacles 10] [--save FILE] [--against FILE]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from validation.step_times import obstacle_course, percentiles, time_law, time_libraries, time_pink
from validation.tables import markdown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--obstacles", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    parser.add_argument("--against", type=Path, help="figures saved before, to compare with")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    problem = obstacle_course(bp.load_robot("example:backhoe"), options.obstacles, rng)
    time_law(problem, 200, np.random.default_rng(1))  # warm up
    timed = time_law(problem, options.steps, rng)
    results = {name: percentiles(times) for name, times in timed.times.items()}
    alone = results["Pinocchio and coal alone"] = percentiles(time_libraries(problem, timed.configurations))
    pink = time_pink(problem, timed.configurations[:1000], max(1, round(timed.rows)))
    if pink is not None:
        results["Pink with barrier"] = percentiles(pink)
    before = json.loads(options.against.read_text()) if options.against else {}
    pairs = len(bp.Proximity(problem.robot, problem.obstacles).pairs)
    print(f"{options.obstacles} obstacles, {pairs} pairs, {timed.rows:.1f} rows per step, {options.steps} steps\n")
    then = {name: {"median before": before.get(name, {}).get("median", np.nan)} if before else {} for name in results}
    print(markdown([{"[us]": name, **figures, **then[name]} for name, figures in results.items()]))
    if pink is None:
        print("Pink is not installed: no comparison with it")
    print(f"a whole step costs {results['whole step']['median'] / alone['median']:.2f} times the library calls alone")
    if options.save:
        options.save.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
