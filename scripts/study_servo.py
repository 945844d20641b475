#!/usr/bin/env python
"""Whether random wishes drive the servo into an obstacle, and whether it gets out of one.

The backhoe is driven by random wishes among obstacles that stand, appear and move;
distances are measured without coal at every `--check`-th step and at every step whose
own margin is small (validation/servo_drives.py). With `--recoveries`, the machine starts
from rest inside obstacles, inside itself or outside a limit instead
(validation/recoveries.py). The results are in docs/measurements.md. Ctrl-C ends the run and prints
the results so far; the same command resumes it, also after a kill. The exit status is 1 if a step
broke a limit or touched something, 130 after Ctrl-C.

    python scripts/study_servo.py [--steps 200000] [--seed 0] [--check 10] [--save FILE]
    python scripts/study_servo.py --recoveries 20
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from validation.campaigns import kept_campaigns
from validation.recoveries import RecoveryRecord, recover
from validation.servo_drives import DriveRecord, drive


def main() -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", type=int, default=10)
    parser.add_argument("--recoveries", type=int, default=0, help="starts that are violated, instead of the steps")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; all cores by default")
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    how = {"seed": options.seed, "jobs": options.jobs, "folder": kept_campaigns(), "watch": _print_record}
    if options.recoveries:
        found, interrupted = recover(count=options.recoveries, **how)
    else:
        found, interrupted = drive(steps=options.steps, every=options.check, **how)
    print(json.dumps(found, indent=2))
    if options.save:
        options.save.write_text(json.dumps(found, indent=2) + "\n")
    return 130 if interrupted else int(bool(found.get("problems")))


def _print_record(done: int, record: DriveRecord | RecoveryRecord) -> None:
    print(f"{done} {json.dumps(asdict(record))}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
