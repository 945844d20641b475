"""Processor time of whole processes: the command line from start to end.

Python's byte code is written first, as in an installed package; the least of several runs counts.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from backhoe_planner.machine import shipped_folder
from validation.bench_figures import Figure

LIBRARIES = ("-c", "import numpy, pinocchio, coal")
SIMPLEST = """version: 1
start: {joints: {swing: 0.0, boom: 0.4, stick: -1.6, bucket: -0.9}}
task: {goal: {joints: {swing: 0.8, boom: 0.5, stick: -1.4, bucket: -0.7}}}
"""
_NOISE = 0.25  # of a ratio; two runs of the same code on a shared machine


def processor_time(arguments: Sequence[str], environment: Mapping[str, str]) -> float:
    """The processor time of a Python process and its child processes [s].

    Raises
    ------
    RuntimeError: it fails; the message has its output.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=dict(environment))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)} ended with {done.returncode}: {done.stderr.strip()[-500:]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def startup_figures(*, runs: int, arms: Sequence[tuple[str, str]]) -> list[Figure]:
    """`--help`, a plan of the simplest scene and `inspect` of machines, compared with loading the libraries alone.

    Parameters
    ----------
    runs: of each; the least counts.
    arms: names and tips of example robots to inspect, from a cache folder that is filled before.
    """
    with tempfile.TemporaryDirectory() as folder:
        scene, plan = Path(folder, "scene.yaml"), Path(folder, "plan.json")
        scene.write_text(SIMPLEST)
        backhoe, program = str(shipped_folder("models") / "backhoe.urdf"), ("-m", "backhoe_planner")
        commands = {
            "libraries": LIBRARIES,
            "--help": (*program, "--help"),
            "plan of the simplest scene": (*program, "plan", backhoe, str(scene), "-o", str(plan)),
            "inspect backhoe": (*program, "inspect", backhoe),
        }
        for name, tip in arms:
            commands[f"inspect {name}"] = (*program, "inspect", f"example:{name}", "--tip", tip)
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(Path(folder, "bytecode")), "OMP_NUM_THREADS": "1",
                       "XDG_CACHE_HOME": str(Path(folder, "cache"))}  # fmt: skip
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for command in commands.values():
            processor_time(command, environment)
        least = {
            name: min(processor_time(command, environment) for _ in range(runs)) for name, command in commands.items()
        }
    alone = least.pop("libraries")
    return [
        Figure(name=f"start-up: {name}", value=value, unit="s", noise=_NOISE, reference=alone)
        for name, value in least.items()
    ]
