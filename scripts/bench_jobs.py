#!/usr/bin/env python
"""How long jobs take with the chosen pattern and with the plain one, both planned in full.

    python scripts/bench_jobs.py
    python scripts/bench_jobs.py scenes/jobs/truck_under_power_line.yaml --attack

`--attack` checks every motion of every cycle against the ground at that time by a dense independent
check (validation/job_check.py), which takes some minutes per job. The exit status is 1 if a job is not
verified or is refuted, else 0.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from validation.job_runs import run_job, table

FOLDER = Path(__file__).resolve().parents[1] / "scenes" / "jobs"
JOBS = [file for file in sorted(FOLDER.glob("*.yaml")) if file.stem != "long_trench"]  # that one needs several places


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", type=Path, default=JOBS, metavar="JOB.yaml")
    parser.add_argument("--effort", default="quick")
    parser.add_argument("--no-plain", action="store_true", help="leave the plain pattern out")
    parser.add_argument("--attack", action="store_true", help="check every motion independently")
    options = parser.parse_args(arguments)
    runs = []
    for file in options.jobs:
        runs.append(run_job(file, effort=options.effort, plain=not options.no_plain, attack=options.attack))
        print(f"{file.stem}: done", file=sys.stderr)
    print(table(runs))
    for run in runs:
        for words in run.refuted or ():
            print(f"{run.name}: {words}")
    return int(any(not run.plan.verified or run.refuted for run in runs))


if __name__ == "__main__":
    sys.exit(main())
