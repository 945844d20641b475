#!/usr/bin/env python
"""How much work the global optimum saves against local laws, on seeded straight paths of a backhoe.

The comparison is described in validation/energy_savings.py; the results are in
docs/measurements.md.

    python scripts/study_energy.py                 # the table of savings
    python scripts/study_energy.py --convergence   # the same costs on three grids

Ctrl-C ends the run and prints the results so far; the same command resumes it, also after a kill.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import argparse
import sys

from validation.campaigns import kept_campaigns
from validation.energy_savings import Result, convergence_table, measure_grids, measure_paths, savings_table
from validation.tables import markdown


def _print_worse(_: int, result: Result) -> None:
    if result.worse:
        print(f"case {result.number} is worse than a law that keeps its limits: {result}", flush=True)


def _print_savings(results: list[Result]) -> None:
    drawn = results[-1].number + 1
    left_out = drawn - len(results)
    print(f"{len(results)} straight paths of {drawn} drawn ({left_out} cannot be followed from their posture)\n")
    print(markdown(savings_table(results)))
    breaks, stuck = (sum(getattr(r, name) for r in results) for name in ("pseudo_inverse_breaks", "law_stuck"))
    print(f"\nthe pseudo-inverse breaks a joint limit on {breaks} paths, the completed law gets stuck on {stuck}")
    print(f"optima with a free start that are not verified: {sum(result.free is None for result in results)}")


def main() -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--paths", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--convergence", action="store_true")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; all cores by default")
    options = parser.parse_args()
    how = {"paths": options.paths, "seed": options.seed, "jobs": options.jobs, "folder": kept_campaigns()}
    if options.convergence:
        costs, interrupted = measure_grids(**how)
        if costs:
            print(f"{len(costs)} straight paths, start left free; work, quasi-static\n")
            print(markdown(convergence_table(costs)))
    else:
        results, interrupted = measure_paths(**how, watch=_print_worse)
        if results:
            _print_savings(results)
    return 130 if interrupted else 0


if __name__ == "__main__":
    sys.exit(main())
