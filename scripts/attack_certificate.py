#!/usr/bin/env python
"""Whether a certificate ever claims more than is true, on random machines, sites and motions.

For every seed, a machine is written as a URDF, a site as a scene, and an unplanned motion; the
claims of `bp.certify` are compared with the least distances of the shapes as written in the
files, without coal and without the planner's own shapes (validation/certificate_attack.py).
Five seeds share a machine. Links whose shapes as written touch in nearly all configurations
overlap by construction; they are counted separately.

    python scripts/attack_certificate.py --count 5000
    python scripts/attack_certificate.py --only 17

Ctrl-C ends the run and prints the results so far; the same command resumes it, also after a kill
(validation/campaigns.py). The exit status is 1 if a certificate was refuted or an exception was
raised, 130 after Ctrl-C.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import argparse
import sys

from validation.campaigns import kept_campaigns
from validation.certificate_attack import Comparison, Summary, attack_seeds, summarise
from validation.link_pairs import BY_CONSTRUCTION


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500, help="comparisons")
    parser.add_argument("--seed", type=int, default=0, help="of the first; the others follow it")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", type=int, metavar="SEED", help="this comparison alone")
    options = parser.parse_args(arguments)
    if options.count < 1 or options.jobs == 0 or min(options.seed, options.only or 0) < 0:
        parser.error("--count must be greater than 0, --jobs not 0, seeds not negative")
    seeds = range(options.seed, options.seed + options.count) if options.only is None else [options.only]
    compared, interrupted = attack_seeds(
        seeds, jobs=options.jobs, folder=kept_campaigns() if options.only is None else None, watch=_print_findings
    )
    if compared:
        print(describe(summary := summarise(compared)))
        return 130 if interrupted else int(bool(summary.refuted or summary.errors))
    return 130


def _print_findings(_: int, compared: list[Comparison]) -> None:
    for comparison in compared:
        if comparison.error:
            print(f"{comparison.seed}: {comparison.error}", flush=True)
        for refutation in comparison.refutations:
            print(f"{refutation.seed}: {refutation.cause}: {refutation.what}", flush=True)


def describe(summary: Summary) -> str:
    """Return the figures in words."""
    lines = [
        f"{summary.comparisons} comparisons, {summary.safe} of them called safe, {summary.errors} errors, "
        f"{summary.seconds / summary.comparisons:.2f} s of the processor each",
        f"{summary.refuted} refuted" + (", by cause:" if summary.causes else ""),
        *(f"  {count:6d}  {cause}" for cause, count in summary.causes.items()),
        f"{summary.claims} distances that keep their clearance: what is proven lies {summary.below[0]:.2%} (median) "
        f"and {summary.below[1]:.2%} (90th percentile) below the dense distance",
        f"{summary.by_construction} times two links that are not compared touched in a motion called safe, as they do "
        f"over at least {BY_CONSTRUCTION:.0%} of their joint's range, or in as many random postures: by construction",
        f"{summary.left_out} times two links were not compared that touch in every posture "
        "though several joints lie between them",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
