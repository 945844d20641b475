#!/usr/bin/env python
"""How many reachable targets the inverse kinematics solves, machine by machine.

A target is the tip's pose at a seeded random configuration within the limits, so that it
is known to be reachable. Solved means 1e-6 m and, where an angle is asked, 1e-6 rad.
No page quotes the results; tests/machine/test_inverse_kinematics.py holds a part of them.

    python scripts/study_inverse_kinematics.py [--targets 1000] [--seed 1]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import backhoe_planner as bp

CASES = (
    ("example:planar4", None, "position"),
    ("example:backhoe", None, "position"),
    ("example:backhoe", None, "position and pitch"),
    ("example:ur5", "tool0", "position"),
    ("example:ur5", "tool0", "full pose"),
    ("example:panda", "panda_hand_tcp", "position"),
    ("example:panda", "panda_hand_tcp", "full pose"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"{'machine':<18}{'target':<20}{'solved':>8}{'starts':>8}{'median ms':>11}")
    for source, tip, kind in CASES:
        robot = bp.load_robot(source, tip=tip)
        kinematics, rng = bp.Kinematics(robot), np.random.default_rng(arguments.seed)
        solved, starts, times = 0, 0, []
        for index in range(arguments.targets):
            at = kinematics.at(robot.random_q(rng))
            target = bp.TipTarget(
                position=at.tip_position.copy(),
                pitch=(at.pitch, at.pitch) if kind == "position and pitch" else None,
                rotation=at.tip_rotation.copy() if kind == "full pose" else None,
            )
            begun = time.perf_counter()
            found = bp.solve_inverse_kinematics(robot, target, rng=np.random.default_rng([arguments.seed, index]))
            times.append(1e3 * (time.perf_counter() - begun))
            within = np.all(found.q >= robot.limits.lower) and np.all(found.q <= robot.limits.upper)
            solved += bool(found.position_error <= 1e-6 and found.angle_error <= 1e-6 and within)
            starts += found.attempts
        print(
            f"{source:<18}{kind:<20}{solved / arguments.targets:>8.1%}{starts / arguments.targets:>8.2f}"
            f"{np.median(times):>11.2f}"
        )


if __name__ == "__main__":
    main()
