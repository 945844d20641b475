#!/usr/bin/env python
"""The saving by choosing the end of a leg with the next legs in mind, over random sequences.

Each sequence has six legs (see validation/sequences.py) and is planned twice: leg by leg, and with
each end chosen for the legs after it too. Costs are those of the objective, with a stop between
legs both times.

    python scripts/bench_sequences.py --count 50 --objective time
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one sequence per core; before numpy is imported

import argparse
import itertools
import sys
from collections.abc import Sequence

from backhoe_planner.planning import EFFORTS
from validation.campaigns import kept_campaigns
from validation.sequences import describe, run_all


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=50, help="how many sequences")
    parser.add_argument("--objective", nargs="+", default=["time", "work"])
    parser.add_argument("--places", type=int, nargs="+", default=[3, 1], help="goals a leg, any of which will do")
    parser.add_argument("--effort", choices=list(EFFORTS), default="normal")
    parser.add_argument("--seed", type=int, default=0, help="of the sequences")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; all cores by default")
    options = parser.parse_args(arguments)
    if min(options.count, *options.places) < 1 or options.seed < 0 or options.jobs == 0:
        parser.error("--count, --places and --jobs must be greater than 0, --seed not negative")
    worse = False
    for places, objective in itertools.product(options.places, options.objective):
        rows, interrupted = run_all(
            options.count, seed=options.seed, objective=objective, places=places, effort=options.effort,
            jobs=options.jobs, folder=kept_campaigns(),
        )  # fmt: skip
        if interrupted:
            return 130
        print(f"{places} goals a leg, {describe(rows)}", flush=True)
        worse |= any(row.is_worse for row in rows)
    return int(worse)


if __name__ == "__main__":
    sys.exit(main())
