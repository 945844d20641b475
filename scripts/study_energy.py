#!/usr/bin/env python
"""How much work the global optimum saves against local laws, on seeded straight paths of a backhoe.

What is compared is said in validation/energy_savings.py, the results are in
docs/measurements.md.

    python scripts/study_energy.py                 # the table of savings
    python scripts/study_energy.py --convergence   # the same costs on three grids
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import argparse

import backhoe_planner as bp
from validation.energy_savings import Result, convergence_table, draw_cases, measure_case, savings_table
from validation.tables import markdown


def study(robot: bp.Robot, *, paths: int, seed: int) -> None:
    """Print the table of savings, and every case in which the optimum is worse than a law."""
    results: list[Result] = []
    for drawn, case in enumerate(draw_cases(robot, seed), start=1):
        result = measure_case(robot, case)
        if result is not None:
            results.append(result)
            if result.worse:
                print(f"case {drawn - 1} is worse than a law that keeps its limits: {result}")
        if len(results) >= paths:
            break
    left_out = drawn - len(results)
    print(f"{len(results)} straight paths of {drawn} drawn ({left_out} cannot be followed from their posture)\n")
    print(markdown(savings_table(results)))
    breaks, stuck = (sum(getattr(r, name) for r in results) for name in ("pseudo_inverse_breaks", "law_stuck"))
    print(f"\nthe pseudo-inverse breaks a joint limit on {breaks} paths, the completed law gets stuck on {stuck}")
    print(f"optima with a free start that are not verified: {sum(result.free is None for result in results)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--paths", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--convergence", action="store_true")
    options = parser.parse_args()
    robot = bp.load_robot("example:backhoe")
    if options.convergence:
        print(f"{options.paths} straight paths, start left free; work, quasi-static\n")
        print(markdown(convergence_table(robot, paths=options.paths, seed=options.seed)))
    else:
        study(robot, paths=options.paths, seed=options.seed)


if __name__ == "__main__":
    main()
