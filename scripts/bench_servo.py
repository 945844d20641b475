#!/usr/bin/env python
"""The time of one servo step on the backhoe with 20 obstacles, 5 of them moving.

Processor time counts, which other processes do not lengthen; clock time is given too. In turn
with the steps, the Pinocchio and coal calls alone are timed on the same configurations (see
validation/step_times.py). The histogram is saved as JSON; memory is read before and after. The
results are in docs/measurements.md.

    python scripts/bench_servo.py [--steps 100000] [--obstacles 20] [--moving 5] [--save out/servo_step.json]
"""

from __future__ import annotations

import argparse
import json
import resource
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from validation.step_times import ServoDrive, collecting_only_new, obstacle_course, percentiles, time_in_turn


def resident() -> float:
    """Present memory of this process [MB]."""
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--obstacles", type=int, default=20)
    parser.add_argument("--moving", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path, default=Path("out/servo_step.json"))
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    robot = bp.load_robot("example:backhoe")
    problem = obstacle_course(robot, options.obstacles, rng)
    servo = bp.Servo(robot, problem.scene)
    drive = ServoDrive(servo, options.moving, rng)
    drive.take(2000)  # warm up
    with collecting_only_new():
        before = resident()
        timed = time_in_turn(problem, drive, options.steps)
        after = resident()
    processor, clock = timed.steps.whole, timed.steps.times["clock"]
    edges = np.concatenate((np.arange(0.0, 1000.0, 10.0), [np.inf]))
    result = {
        "steps": options.steps,
        "obstacles": options.obstacles,
        "moving": options.moving,
        "step, processor [us]": {**percentiles(processor), "max": float(processor.max())},
        "step, clock [us]": {**percentiles(clock), "max": float(clock.max())},
        "Pinocchio and coal alone, all pairs [us]": percentiles(timed.calls),
        "ratio of medians": timed.ratio,
        "memory before [MB]": before,
        "memory after [MB]": after,
    }
    histogram = {"edges [us]": edges[:-1].tolist(), "counts": np.histogram(processor, edges)[0].tolist()}
    options.save.parent.mkdir(parents=True, exist_ok=True)
    options.save.write_text(json.dumps({**result, "histogram": histogram}, indent=2) + "\n")
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
