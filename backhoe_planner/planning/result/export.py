"""A plan's motion in the formats of other tools."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from typing import IO, Any

import numpy as np
import pinocchio as pin
import yaml

from backhoe_planner.arrays import Matrix
from backhoe_planner.files.output_file import check_ending, check_output, whole_file
from backhoe_planner.machine import BatchKinematics, Hydraulics, Robot
from backhoe_planner.motion import Trajectory
from backhoe_planner.planning.result.plan import Plan

TIP_COLUMNS = [f"tip.{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
"""The columns of the tip's pose in a table: position [m] and quaternion."""


def export_plan(plan: Plan, path: str | os.PathLike[str]) -> None:
    """Write the motion in the format of the file's ending, whole or not at all.

    ``.csv``: a header, then time [s], position and velocity of every joint; with a
    hydraulic description of the machine also length [m], speed [m/s] and flow [m^3/s] of
    every cylinder; the tip's pose, ``tip.x``, ``tip.y``, ``tip.z`` [m] and the quaternion ``tip.qw``, ``tip.qx``,
    ``tip.qy``, ``tip.qz``, in the world frame; for a sequence the name of the leg in the last column.
    ``.npz``: arrays time (T,), q (T, n), v (T, n), joints (n,), tip_position (T, 3) [m] and tip_quaternion (T, 4),
    w, x, y, z, in the world frame; with a hydraulic description also lengths, rod_speeds and flows (T, m),
    cylinders (m,);
    for a sequence also legs (L,), their names, leg_begins (L,), the first sample of each, and
    leg_carries (L,), the name of what each carries, or an empty string.
    ``.yaml``: a ROS 2 trajectory_msgs/JointTrajectory message, of the joints alone.

    Raises
    ------
    OutputError: unknown ending, or the file cannot be written, or is one of the machine's or the scene's.
    """
    write, mode = FORMATS[check_ending(path, tuple(FORMATS), what="a motion")]
    check_output(path, plan.input_files)
    with whole_file(path, mode) as stream:
        write(plan, stream)


def tip_poses(robot: Robot, q: Matrix) -> tuple[Matrix, Matrix]:
    """(T, 3) positions [m] of the tip at the joints `q` (T, n), and (T, 4) its quaternions w, x, y, z; world frame.

    Of the two quaternions of an orientation, it is the one nearer to that of the sample before.
    """
    at = BatchKinematics(robot).at(q)
    found: list[list[float]] = []
    for rotation in at.tip_rotation:
        x, y, z, w = pin.Quaternion(np.asarray(rotation)).coeffs().tolist()
        turned = [w, x, y, z]
        before = found[-1] if found else [1.0, 0.0, 0.0, 0.0]
        sign = -1.0 if sum(a * b for a, b in zip(turned, before, strict=True)) < 0.0 else 1.0
        found.append([sign * part for part in turned])
    return np.ascontiguousarray(at.tip_position), np.array(found).reshape(-1, 4)


def _write_csv(plan: Plan, stream: IO[Any]) -> None:
    motion, names = plan.trajectory, plan.robot.joint_names
    header = ["time", *(f"{name}.position" for name in names), *(f"{name}.velocity" for name in names)]
    columns = [motion.time[:, None], motion.q, motion.v]
    hydraulics = plan.robot.hydraulics
    if hydraulics is not None:
        for quantity, values in zip(("length", "speed", "flow"), _cylinders(hydraulics, motion).values(), strict=True):
            header += [f"{name}.{quantity}" for name in hydraulics.cylinder_names]
            columns.append(values)
    header += TIP_COLUMNS
    columns += tip_poses(plan.robot, motion.q)
    legs = _legs(plan)
    header += ["leg"] if legs else []
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    for index, row in enumerate(np.hstack(columns).tolist()):
        writer.writerow([*(repr(number) for number in row), *([] if not legs else [legs[index]])])


def _legs(plan: Plan) -> list[str]:
    """The leg of every sample; where two legs meet, the later one. Empty if there are no legs."""
    return [leg.name for leg in plan.legs for _ in range(leg.first, leg.last)] + [leg.name for leg in plan.legs[-1:]]


def _write_npz(plan: Plan, stream: IO[Any]) -> None:
    motion, hydraulics = plan.trajectory, plan.robot.hydraulics
    arrays = {"time": motion.time, "q": motion.q, "v": motion.v, "joints": np.array(plan.robot.joint_names)}
    arrays |= zip(("tip_position", "tip_quaternion"), tip_poses(plan.robot, motion.q), strict=True)
    if hydraulics is not None:
        arrays |= _cylinders(hydraulics, motion) | {"cylinders": np.array(hydraulics.cylinder_names)}
    if plan.legs:
        loads = [leg.problem.robot.carried for leg in plan.legs]
        arrays |= {"legs": np.array([leg.name for leg in plan.legs]), "leg_begins": np.array(motion.begins)}
        arrays |= {"leg_carries": np.array(["" if load is None else load[0] for load in loads])}
    np.savez(stream, **arrays)  # type: ignore[arg-type]


def _cylinders(hydraulics: Hydraulics, motion: Trajectory) -> dict[str, Matrix]:
    """Lengths [m], speeds [m/s] and flows [m^3/s] of the cylinders, (T, m) each."""
    return {
        "lengths": hydraulics.lengths(motion.q),
        "rod_speeds": hydraulics.rod_speeds(motion.q, motion.v),
        "flows": hydraulics.flows(motion.q, motion.v),
    }


def _write_ros(plan: Plan, stream: IO[Any]) -> None:
    motion = plan.trajectory
    points = []
    rows = zip(motion.time.tolist(), motion.q.tolist(), motion.v.tolist(), motion.accelerations().tolist(), strict=True)
    for time, q, v, a in rows:
        nanoseconds = round(time * 1e9)
        points.append(
            {
                "positions": q,
                "velocities": v,
                "accelerations": a,
                "effort": [],
                "time_from_start": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
            }
        )
    message = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": plan.robot.urdf.root},
        "joint_names": list(plan.robot.joint_names),
        "points": points,
    }
    yaml.safe_dump(message, stream, sort_keys=False, default_flow_style=None, width=200)


FORMATS: dict[str, tuple[Callable[[Plan, IO[Any]], None], str]] = {
    ".csv": (_write_csv, "w"),
    ".npz": (_write_npz, "wb"),
    ".yaml": (_write_ros, "w"),
}
