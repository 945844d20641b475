"""Studies that are killed, sent to a cluster or timed: whether their table equals that of an undisturbed run, and the
overhead of a study.

The plans are quick ones for the planar arm with random goals and clearances.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time as clock
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from backhoe_planner.files.output_file import whole_file

_ROOT = Path(__file__).resolve().parents[1]
_ENDS = 900.0  # s after which a run counts as stuck


@dataclass(frozen=True)
class Timed:
    """The times of one run.

    Attributes
    ----------
    rows: number of planned rows.
    wall: [s], from the first row done to the last.
    whole: [s], including the start of its processes.
    processor: of all of its processes [s].
    planning: of its plans [s].
    """

    rows: int
    wall: float
    whole: float
    processor: float
    planning: float


def write_study(folder: Path, rows: int) -> Path:
    """Write a study of `rows` rows as a file in a folder."""
    content: dict[str, Any] = {
        "version": 1,
        "name": f"{rows} quick plans of the planar arm",
        "machine": "example:planar4",
        "scene": str(_ROOT / "scenes" / "paper_planar.yaml"),
        "parameters": {
            "task.goal.position.0": {"uniform": [0.2, 0.7]},
            "task.goal.position.1": {"uniform": [-2.4, -2.0]},
            "clearance": {"choice": [0.1, 0.2, 0.3]},
            "obstacles.point.position.0": {"uniform": [0.4, 1.0]},
        },
        "combine": "random",
        "count": rows,
    }
    file = folder / f"study_{rows}.yaml"
    with whole_file(file) as stream:
        stream.write(json.dumps(content))
    return file


def begin(study: Path, output: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start the command in its own process group."""
    command = [sys.executable, "-m", "backhoe_planner", "study", str(study), "-o", str(output), *options]
    environment = os.environ | {"PYTHONPATH": str(_ROOT)}
    return subprocess.Popen(command, start_new_session=True, env=environment, stdout=subprocess.DEVNULL)


def run_to_its_end(study: Path, output: Path, *options: str) -> Timed:
    """Run a study undisturbed and return its times."""
    import pyarrow.parquet as pq

    before = journal_rows(output)
    begun, process = clock.monotonic(), begin(study, output, *options)
    first = None
    while first is None and process.poll() is None:
        clock.sleep(0.02)
        first = clock.monotonic() if journal_rows(output) > before else None
    _, status, usage = os.wait4(process.pid, 0) if process.returncode is None else (0, process.returncode, None)
    ended = clock.monotonic()
    if status != 0 or usage is None:
        raise RuntimeError(f"{study} ended with status {status}")
    planning = sum(pq.read_table(output / "timings.parquet")["processor"].to_pylist())
    return Timed(
        journal_rows(output) - before,
        ended - (first or ended),
        ended - begun,
        usage.ru_utime + usage.ru_stime,
        planning,
    )


def kill_often(study: Path, output: Path, *, kills: int, rows: int, seed: int) -> list[int]:
    """Start a study repeatedly and kill it by -9 with all its processes; return the rows done each time.

    Parameters
    ----------
    rows: of the study; each run is killed at a random moment after a random number of rows, the first at its start.
    """
    rng, done = random.Random(seed), []
    for target in [0, *sorted(rng.randrange(1, rows) for _ in range(kills - 1))]:
        process = begin(study, output)
        begun = clock.monotonic()
        while process.poll() is None and journal_rows(output) < target and clock.monotonic() - begun < _ENDS:
            clock.sleep(0.01)
        clock.sleep(rng.uniform(0.0, 0.3))
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(_ENDS)
        done.append(journal_rows(output))
    return done


def run_on_cluster(study: Path, output: Path, *, kill_at: int) -> int:
    """Run a study on a Dask cluster of two workers, kill one by -9 after some rows, and return the row count then."""
    import distributed

    from backhoe_planner.studies import StudyStep, load_study, run_study

    killed: list[int] = []
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:

        def watch(step: StudyStep) -> None:
            if step.done >= kill_at and not killed:
                worker = next(iter(cluster.workers.values()))
                os.kill(worker.pid, signal.SIGKILL)
                killed.append(step.done)

        run_study(load_study(study), output, scheduler=cluster.scheduler_address, watch=watch)
    return killed[0] if killed else -1


def journal_rows(folder: Path) -> int:
    """The number of rows in the journal of a folder."""
    file = folder / "journal.jsonl"
    return max(0, file.read_bytes().count(b"\n") - 1) if file.exists() else 0


def same_table(one: Path, other: Path) -> bool:
    """Whether the tables of two folders are equal, byte by byte."""
    return (one / "table.parquet").read_bytes() == (other / "table.parquet").read_bytes()
