#!/usr/bin/env python
"""How often each law arrives, touches and jumps in seeded random planar scenes.

Every scene has 1 to 6 obstacles (balls, blocks, capsules) in the plane of the paper's
arm, a free start, and a goal that some free configuration reaches. The laws and the
definition of touching are those of validation/law_runs.py. The results are in
docs/measurements.md. The exit status is 1 if a verified plan was refuted.

    python scripts/study_laws.py [--scenes 500] [--seed 5] [--save FILE.csv]
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path

from validation.campaigns import call_for_all, count_on_terminal, kept_campaigns
from validation.law_runs import Run, run_scene, share_table
from validation.tables import markdown, write_csv


def main() -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=500)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=-1, help="processes; all cores by default")
    parser.add_argument("--save", type=Path, help="write every motion's figures as CSV")
    options = parser.parse_args()
    found, interrupted = call_for_all(
        partial(run_scene, seed=options.seed), range(options.scenes), result=list[Run], jobs=options.jobs,
        folder=kept_campaigns(), watch=count_on_terminal(options.scenes),
    )  # fmt: skip
    runs = [run for of_scene in found for run in of_scene]
    if interrupted:
        print(f"interrupted: {len(found)} scenes are done")
    if not runs:
        return 130
    print(f"{len(found)} scenes, seed {options.seed}\n\n{markdown(share_table(runs))}\n")
    refuted = [run for run in runs if run.refuted]
    print(f"verified plans refuted by the independent check: {len(refuted)}")
    for run in refuted:
        print(f"  scene {run.scene}: {run.refuted}")
    if options.save:
        write_csv([asdict(run) for run in runs], options.save)
    return 130 if interrupted else int(bool(refuted))


if __name__ == "__main__":
    sys.exit(main())
