#!/usr/bin/env python
"""Success, time and memory of planning paths of full poses on redundant arms.

The problems are those of validation/pose_paths.py: words, circles, squares, turns on the spot,
paths around cubes and between poles, on arms of seven and eight joints with and without
continuous joints, and paths with an impossible waypoint. For the others that are not verified,
dense samples tell whether a solution exists (validation/dense_layers.py). Each is planned in its
own process, so that memory is measured per problem; times are processor times. The results are
in docs/measurements.md.

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
                # a process for each problem: the peak memory of a process never falls
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
