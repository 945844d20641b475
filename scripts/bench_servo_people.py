#!/usr/bin/env python
"""The time of servo steps among walking people, and contacts with obstacles that stand still.

Backhoe, Panda and UR5 are driven among people who walk through them (see
validation/walking_people.py), each with several clearances. Times are processor times; each
drive is repeated, and the shortest time of each step counts; "once" is the first drive alone.
The exit status is 1 if an obstacle that stands still was touched. The results are in
docs/measurements.md.

    python scripts/bench_servo_people.py [--steps 20000] [--repetitions 3] [--seed 0] [--save FILE.csv]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from validation.tables import markdown, write_csv
from validation.walking_people import as_row, walk_through

MACHINES = {
    "backhoe": (None, [0.0, 0.3, -0.9, -0.5]),
    "panda": ("panda_hand", [0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8]),
    "ur5": ("tool0", [0.0, -1.2, 1.4, -1.8, -1.5, 0.0]),
}
CLEARANCES = (0.05, 0.3, 0.5)


def main() -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=20_000, help="of each machine, shared among the clearances")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path, help="write the table as CSV")
    options = parser.parse_args()
    rows = []
    for name, (tip, q) in MACHINES.items():
        robot = bp.load_robot(f"example:{name}", tip=tip)
        for clearance in CLEARANCES:
            walk = walk_through(
                robot, np.array(q), clearance=clearance, steps=options.steps // len(CLEARANCES),
                seed=options.seed, repetitions=options.repetitions,
            )  # fmt: skip
            rows.append(as_row(name, clearance, walk))
    print(markdown(rows))
    if options.save:
        write_csv(rows, options.save)
    return int(any(float(row["least to what stands [m]"]) < 0.0 for row in rows))


if __name__ == "__main__":
    sys.exit(main())
