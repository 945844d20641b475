#!/usr/bin/env python
"""How long one step of the servo takes on the backhoe with 20 obstacles, 5 of them moving.

The wish changes every 300 steps between tip and joint velocities; the movers go to and
fro. In the same run, on the same configurations, the Pinocchio and coal calls alone over
all pairs. The histogram is saved as PNG and JSON; memory is read before and after.
What counts is the time on the processor, which the waiting for other processes of the
machine does not lengthen; the time on the clock stands beside it. The
results are in docs/measurements.md.

    python scripts/bench_servo.py [--steps 100000] [--obstacles 20] [--moving 5] [--save out/servo_step]
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
from bench_step import libraries_alone, random_site, summary

import backhoe_planner as bp

mpl.use("Agg")
import matplotlib.pyplot as plt


def resident() -> float:
    """Memory of this process now [MB]."""
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def measure(
    servo: bp.Servo, steps: int, moving: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Times of the steps on the clock and on the processor [us], and every 20th configuration."""
    times, processor = np.empty(steps), np.empty(steps)
    passed = []
    wish: dict[str, np.ndarray] = {}
    movers = servo.obstacles[:moving]
    for count in range(steps):
        if count % 300 == 0:
            if rng.integers(3):
                tip = rng.normal(size=3)
                wish = {"tip_velocity": tip * rng.uniform(0.2, 1.0) / np.linalg.norm(tip)}
            else:
                wish = {"joint_velocity": rng.uniform(-1.0, 1.0, servo.robot.n) * servo.limits.velocity}
        if count % 4000 == 0:
            for name in movers:
                way = servo.shift_of(name)
                direction = rng.normal(size=3) if not way.any() else -way
                servo.set_velocity(name, 0.05 * direction / np.linalg.norm(direction))
        begun, begun_on_processor = time.perf_counter(), time.thread_time()
        state = servo.step(**wish)
        processor[count] = 1e6 * (time.thread_time() - begun_on_processor)
        times[count] = 1e6 * (time.perf_counter() - begun)
        if count % 20 == 0:
            passed.append(state.q)
    return times, processor, passed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--obstacles", type=int, default=20)
    parser.add_argument("--moving", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--save", type=Path, default=Path("out/servo_step"), help="without ending: .png and .json are written"
    )
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    robot = bp.load_robot("example:backhoe")
    problem = random_site(robot, arguments.obstacles, rng)
    servo = bp.Servo(robot, problem.scene)
    measure(servo, 2000, arguments.moving, np.random.default_rng(1))  # warm up
    gc.collect()
    gc.freeze()
    before = resident()
    times, processor, passed = measure(servo, arguments.steps, arguments.moving, rng)
    after = resident()
    alone = libraries_alone(problem, passed[:2000])
    result = {
        "steps": arguments.steps,
        "obstacles": arguments.obstacles,
        "moving": arguments.moving,
        "step, processor [us]": {**summary(processor.tolist()), "max": float(processor.max())},
        "step, clock [us]": {**summary(times.tolist()), "max": float(times.max())},
        "Pinocchio and coal alone, all pairs [us]": summary(alone),
        "ratio of medians": float(np.median(processor) / np.median(alone)),
        "memory before [MB]": before,
        "memory after [MB]": after,
    }
    arguments.save.parent.mkdir(parents=True, exist_ok=True)
    edges = np.concatenate((np.arange(0.0, 1000.0, 10.0), [np.inf]))
    counts, _ = np.histogram(processor, edges)
    histogram = {"edges [us]": edges[:-1].tolist(), "counts": counts.tolist()}
    arguments.save.with_suffix(".json").write_text(json.dumps({**result, "histogram": histogram}, indent=2) + "\n")
    figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
    axis.hist(np.minimum(processor, 1000.0), bins=100, range=(0.0, 1000.0), color="tab:blue")
    for part, style in ((50, "-"), (99, "--")):
        value = float(np.percentile(processor, part))
        axis.axvline(value, color="k", linestyle=style, label=f"{part} %: {value:.0f} us")
    axis.set_yscale("log")
    axis.set_xlabel("one step on the processor [us]; 1000 and more in the last bar")
    axis.set_ylabel("steps")
    axis.legend()
    figure.savefig(arguments.save.with_suffix(".png"), dpi=120)
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
