#!/usr/bin/env python
"""Whether MuJoCo sees a contact on a motion that its certificate calls safe.

Verified plans of the repository's scenes and of seeded random sites (validation/sites.py) are
replayed at ten moments per sample in a MuJoCo model of the URDF and the scene
(validation/mujoco_replay.py); so are unplanned motions of random machines that their certificate
calls safe (validation/random_attacks.py), and drives of the servo.

    python scripts/replay_in_mujoco.py --count 300
    python scripts/replay_in_mujoco.py --count 0 --attacks 500
    python scripts/replay_in_mujoco.py --count 0 --episodes 5

Contacts of links with one joint between them that do not touch by construction are counted
separately. Ctrl-C ends the run and prints the results so far. The exit status is 1 if anything
else touches, 130 after Ctrl-C.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path

import backhoe_planner as bp
from validation.habitats import load_machine
from validation.mujoco_replay import Replay, replay, replay_drives
from validation.obstacles import MACHINES
from validation.planning_runs import all_keys
from validation.random_attacks import TURNS, random_attack, random_attacked
from validation.sites import KINDS, TASKS, random_site

_SCENES = Path(__file__).resolve().parents[1] / "scenes"
_MACHINES = {"paper_planar": "planar4"}  # all other scenes are for the backhoe
_LONGEST = 60.0  # s for one plan


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=60, help="random sites, beside the scenes of the repository")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--attacks", type=int, default=0, help="unplanned motions of random machines")
    parser.add_argument("--episodes", type=int, default=0, help="drives of the servo, of 4000 steps each")
    options = parser.parse_args(arguments)
    motions = [_scenes(), _sites(options.count, options.seed), _attacks(options.attacks, options.seed)]
    drives = replay_drives(bp.load_robot("example:backhoe"), episodes=options.episodes, seed=options.seed)
    counts: Counter[str] = Counter()
    interrupted = False
    try:
        for name, replayed in chain(*motions, drives):
            counts["motions"] += 1
            counts["moments"] += replayed.moments
            counts["hulls alone"] += len(replayed.skipped)
            for contact in replayed.contacts:
                counts["adjacent" if contact.adjacent else "contacts"] += 1
                what = "adjacent links: " if contact.adjacent else ""
                depth = f"{contact.depth:.5f} m in {contact.other} at {contact.time:.3f} s"
                print(f"{name}: {what}{contact.link} is {depth}", flush=True)
    except KeyboardInterrupt:
        interrupted = True
    print(
        f"{counts['motions']} motions at {counts['moments']} moments: {counts['contacts']} contacts, "
        f"{counts['adjacent']} more of links that one joint joins; "
        f"{counts['hulls alone']} skipped that lie in the hull of a mesh alone"
    )
    return 130 if interrupted else int(counts["contacts"] > 0)


def _scenes() -> Iterator[tuple[str, Replay]]:
    for file in sorted(_SCENES.glob("*.yaml")):
        robot = bp.load_robot(f"example:{_MACHINES.get(file.stem, 'backhoe')}")
        yield from _verified(file.stem, robot, bp.load_scene(file))


def _sites(count: int, seed: int) -> Iterator[tuple[str, Replay]]:
    keys = all_keys(count, machines=MACHINES, kinds=KINDS, tasks=TASKS, seed=seed)
    for key in islice(keys, count):
        robot = load_machine(key.machine)
        yield from _verified(str(key), robot, random_site(robot, key).scene)


def _verified(name: str, robot: bp.Robot, scene: bp.Scene) -> Iterator[tuple[str, Replay]]:
    plan = bp.plan(robot, scene, budget=_LONGEST)
    if not plan.verified:
        return
    if not plan.legs:
        yield name, replay(plan.robot, plan.scene, plan.trajectory)
    for leg in plan.legs:
        yield f"{name}, {leg.name}", replay(plan.robot, leg.problem.scene, leg.trajectory)


def _attacks(count: int, seed: int) -> Iterator[tuple[str, Replay]]:
    for first in range(seed, seed + count, TURNS):
        with tempfile.TemporaryDirectory() as folder:
            machine = random_attacked(first, Path(folder))
            for number in range(first, first + TURNS):
                attack = random_attack(number, machine, Path(folder))
                if bp.certify(machine.robot, attack.scene, attack.trajectory).safe:
                    yield f"attack {number}", replay(machine.robot, attack.scene, attack.trajectory, refine=20)


if __name__ == "__main__":
    sys.exit(main())
