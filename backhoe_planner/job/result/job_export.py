"""All motions of a job in the formats of other tools."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from typing import IO, Any

import numpy as np

from backhoe_planner.arrays import Array
from backhoe_planner.files.output_file import check_ending, check_output, whole_file
from backhoe_planner.job.result.job_plan import JobPlan
from backhoe_planner.planning import TIP_COLUMNS, tip_poses


def export_job(plan: JobPlan, path: str | os.PathLike[str]) -> None:
    """Write every leg of every cycle in the format of the file's ending, whole or not at all.

    ``.csv``: a header, then cycle, leg, time from the beginning of the job [s], payload [kg], position and velocity of
    every joint, and the tip's pose in the world frame, as `export_plan` writes it.
    ``.npz``: arrays cycle (T,), leg (T,), time (T,), payload (T,), q (T, n), v (T, n), joints (n,), tip_position
    (T, 3) [m], tip_quaternion (T, 4), w, x, y, z.

    The last sample of a leg is the first of the next one, at the same time.

    Raises
    ------
    OutputError: the ending is unknown, the file cannot be written, or it belongs to the machine or the job.
    """
    write, mode = FORMATS[check_ending(path, tuple(FORMATS), what="the motions of a job")]
    check_output(path, (*plan.job.files, *plan.robot.files))
    with whole_file(path, mode) as stream:
        write(plan, stream)


def _columns(plan: JobPlan) -> dict[str, Array]:
    cycle, leg, time, payload, q, v = [], [], [], [], [], []
    begun = 0.0
    for one in plan.cycles:
        for part in one.legs:
            motion = part.trajectory
            cycle.append(np.full(len(motion), one.number))
            leg.append(np.full(len(motion), part.name))
            time.append(begun + motion.time)
            payload.append(np.full(len(motion), part.payload))
            q.append(motion.q)
            v.append(motion.v)
            begun += motion.duration
    n = plan.robot.n
    positions = np.concatenate([*q, np.zeros((0, n))])
    place, turn = tip_poses(plan.robot, positions)
    return {
        "cycle": np.concatenate([*cycle, np.zeros(0, dtype=int)]),
        "leg": np.concatenate([*leg, np.zeros(0, dtype="U8")]),
        "time": np.concatenate([*time, np.zeros(0)]),
        "payload": np.concatenate([*payload, np.zeros(0)]),
        "q": positions,
        "v": np.concatenate([*v, np.zeros((0, n))]),
        "tip_position": place,
        "tip_quaternion": turn,
    }


def _write_csv(plan: JobPlan, stream: IO[Any]) -> None:
    columns, names = _columns(plan), plan.robot.joint_names
    writer = csv.writer(stream, lineterminator="\n")
    joints = (*(f"{n}.position" for n in names), *(f"{n}.velocity" for n in names))
    writer.writerow(["cycle", "leg", "time", "payload", *joints, *TIP_COLUMNS])
    for cycle, leg, *numbers in zip(*(columns[name].tolist() for name in columns), strict=True):
        time, payload, *rows = numbers
        writer.writerow([cycle, leg, *(repr(number) for number in (time, payload, *(x for row in rows for x in row)))])


def _write_npz(plan: JobPlan, stream: IO[Any]) -> None:
    np.savez(stream, joints=np.array(plan.robot.joint_names), **_columns(plan))  # type: ignore[arg-type]


FORMATS: dict[str, tuple[Callable[[JobPlan, IO[Any]], None], str]] = {
    ".csv": (_write_csv, "w"),
    ".npz": (_write_npz, "wb"),
}
