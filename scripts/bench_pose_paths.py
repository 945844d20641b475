#!/usr/bin/env python
"""How often, how fast and in how much memory paths of full poses are planned on redundant arms.

The problems are those of validation/pose_paths.py: words, circles, squares, turns on the spot,
ways around cubes and between poles, on arms of seven and eight joints with and without
continuous ones, and paths on which a waypoint is impossible. Of the others that are not verified,
dense samples say whether there is any way (validation/dense_layers.py). Each is planned in a process of
its own, so that its memory is its own; time is of the processor. The results are in
docs/measurements.md.

    python scripts/bench_pose_paths.py [--seeds 0 1] [--csv FILE]
    python scripts/bench_pose_paths.py --machines gen3 --kinds word circle
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import argparse
import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from validation import pose_paths
from validation.tables import markdown, write_csv


def _solve(kind: str, machine: str, seed: int) -> pose_paths.Result:
    with tempfile.TemporaryDirectory() as folder:
        robot = pose_paths.load_arm(machine, Path(folder))
        return pose_paths.solve(pose_paths.draw(kind, robot, machine, seed))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of the problems")
    parser.add_argument("--machines", nargs="+", choices=pose_paths.MACHINES, default=pose_paths.MACHINES)
    kinds = (*pose_paths.KINDS, *pose_paths.IMPOSSIBLE)
    parser.add_argument("--kinds", nargs="+", choices=kinds, default=kinds)
    parser.add_argument("--csv", type=Path, help="write the table here too")
    options = parser.parse_args()
    results = []
    for seed in options.seeds:
        for kind in options.kinds:
            for machine in options.machines:
                # a process for each problem: the greatest memory of a process is never less again
                with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
                    results.append(pool.submit(_solve, kind, machine, seed).result())
                print(markdown([results[-1].row]).splitlines()[-1], flush=True)
    rows = [result.row for result in results]
    print("\n" + markdown(rows))
    print("\n" + markdown(pose_paths.summarise(results)))
    for result in results:
        if result.message and result.verdict != "verified":
            apart = " (there seems to be no way: its configurations do not hang together)"
            print(f"{result.kind}, {result.machine}: {result.message}{apart if result.together is False else ''}")
    if options.csv:
        write_csv(rows, options.csv)


if __name__ == "__main__":
    main()
