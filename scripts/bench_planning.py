#!/usr/bin/env python
"""How often, how fast and how well `bp.plan` solves seeded random sites.

For each group of sites (machine, kind, task; see validation/sites.py): the part that was
verified, of all and of those with a known solution; the reasons of the others; processor time
of planning, also as a multiple of a reference (1000 calls of `Proximity.distances` on the same
site); the motion's duration, for a goal also over its lower bound (median and 90th percentile);
the length of the tip's path; and the least margin of any verified plan. The results are in
docs/measurements.md.

    python scripts/bench_planning.py --sites 50 --save run.json
    python scripts/bench_planning.py --sites 50 --compare run.json
    python scripts/bench_planning.py --only backhoe/narrow/goal/7
    python scripts/bench_planning.py --sites 300 --refute

`--refute` checks every verified plan by validation/independent_check.py. Ctrl-C ends the run and
prints the results so far; the same command resumes it, also after a kill
(validation/campaigns.py). The exit status is 1 if a verified plan was refuted or an exception
was raised, 130 after Ctrl-C, else 0.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one site per core; before numpy is imported

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import backhoe_planner as bp
from backhoe_planner.files.output_file import check_writable
from backhoe_planner.planning import EFFORTS
from validation import planning_runs as runs
from validation.campaigns import count_on_terminal, kept_campaigns
from validation.obstacles import MACHINES
from validation.sites import KINDS, SURVEYED, TASKS, SiteKey

_KINDS = (*KINDS, *SURVEYED)


def _only(key: SiteKey, settings: runs.Settings) -> int:
    """Plan one site and print its row."""
    row = runs.run_site(key, settings)
    print(f"{key}, seed {key.seed}: {json.dumps(asdict(row), indent=2)}")
    return int(row.is_wrong)


def _key(name: str, seed: int) -> SiteKey:
    parts = name.split("/")
    if len(parts) == 4 and parts[0] in MACHINES and parts[1] in _KINDS and parts[2] in TASKS and parts[3].isdecimal():
        return SiteKey(parts[0], parts[1], parts[2], int(parts[3]), seed)
    allowed = "/".join("{" + ",".join(words) + "}" for words in (MACHINES, _KINDS, TASKS))
    raise SystemExit(f"--only: no such site {name!r}; allowed are {allowed}/INDEX")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, default=50, help="in each group")
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=MACHINES)
    parser.add_argument("--kinds", nargs="+", choices=_KINDS, default=KINDS, help="by default without surveys")
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS)
    parser.add_argument("--method", default="auto")
    parser.add_argument("--effort", choices=list(EFFORTS), default="normal", help="for each site")
    parser.add_argument("--seed", type=int, default=0, help="of the sites")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; all cores by default")
    parser.add_argument("--save", type=Path, metavar="FILE.json")
    parser.add_argument("--compare", type=Path, metavar="FILE.json", help="a run that was saved")
    parser.add_argument("--refute", action="store_true", help="hold verified plans against the independent check")
    parser.add_argument("--only", metavar="MACHINE/KIND/TASK/INDEX", help="plan this site alone")
    options = parser.parse_args(arguments)
    settings = runs.Settings(options.method, options.effort, options.refute)
    if options.only:
        return _only(_key(options.only, options.seed), settings)
    if options.sites < 1 or options.seed < 0 or options.jobs == 0:
        parser.error("--sites and --jobs must be greater than 0, --seed not negative")
    if options.save:
        try:
            check_writable(options.save)
        except bp.OutputError as error:
            parser.error(f"--save: {error}")
    before: list[runs.Row] = []
    if options.compare:
        try:
            before = runs.load_rows(options.compare)
        except (OSError, ValueError, TypeError) as error:
            parser.error(f"--compare: {error}")
    keys = runs.all_keys(
        options.sites, machines=options.machines, kinds=options.kinds, tasks=options.tasks, seed=options.seed
    )
    begun = time.perf_counter()
    rows, interrupted = runs.run(
        keys, settings, jobs=options.jobs, folder=kept_campaigns(), watch=count_on_terminal(len(keys))
    )
    if interrupted:
        print(f"interrupted: {len(rows)} sites are done")
    if rows:
        seconds = time.perf_counter() - begun
        print(f"{len(rows)} sites, method {settings.method}, effort {settings.effort}, {seconds:.0f} s in all\n")
        _report(rows, before)
        if options.save:
            runs.save_rows(options.save, rows, settings)
    return 130 if interrupted else int(any(row.is_wrong for row in rows))


def _report(rows: Sequence[runs.Row], before: Sequence[runs.Row]) -> None:
    print(runs.table(runs.summarise(rows)))
    if failed := runs.failures(rows):
        print(f"\n{failed}")
    for row in rows:
        if row.is_wrong:
            print(f"\n{row.key}: " + ("refuted: " + "; ".join(row.refuted) if row.refuted else row.message))
    if before:
        print(f"\n{runs.comparison_table(runs.compare(before, rows))}")


if __name__ == "__main__":
    sys.exit(main())
