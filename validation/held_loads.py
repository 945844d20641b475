"""Whether a machine holds itself and its payload where a motion begins and ends at rest, by virtual work.

The torque that holds a joint is the slope of the potential energy, and the force of a cylinder acts on its joint over
the slope of its length. Masses, centres, placements and pins are those of the files as written. Neither inverse
dynamics nor moment arms of the package take part.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import Robot
from backhoe_planner.motion import Problem, Trajectory, leg_parts
from validation.raw_drive import RawDrive, read_raw_drive
from validation.raw_urdf import RawMachine, read_raw_urdf

GRAVITY = 9.81  # m/s^2
_STEP = 1e-5  # rad or m, of central differences: 1e-10 of a torque, and 1e-6 N m of rounding
_AT_REST = 1e-9  # rad/s or m/s
_SLACK = 0.0101  # part of a torque: the certificate accepts 1 %


def unheld_loads(problem: Problem, motion: Trajectory) -> list[str]:
    """Describe the joints that cannot hold the machine and its payload where it rests at an end of a leg.

    A motion without legs is one leg. Soil does not act on a tip at rest.
    """
    robot = problem.robot
    machine = read_raw_urdf(robot.urdf.path, find_mesh=robot.urdf.mesh_path, hold=robot.hold)
    drive, found = drive_of(robot, machine), []
    for part in leg_parts(problem, motion):
        scene, moved = part.problem.scene, part.motion
        for row in (0, -1):
            if np.max(np.abs(moved.v[row])) > _AT_REST:
                continue
            q, where = moved.q[row], f"at {part.begins + moved.time[row]:.3f} s"
            offset = np.zeros(3) if scene.payload_at is None else np.array(scene.payload_at)
            torque = holding_torques(machine, robot, q, payload=scene.payload, payload_at=offset)
            limit = greatest_torques(drive, q[None, :], torque[None, :], part.problem.limits.effort)[0]
            for joint in np.flatnonzero(np.abs(torque) > (1.0 + _SLACK) * limit).tolist():
                name, needed = robot.joint_names[joint], f"{abs(torque[joint]):.6g} of {limit[joint]:.6g}"
                found.append(f"{name} needs {needed} N m or N to hold its load {where}")
    return list(dict.fromkeys(found))


def holding_torques(machine: RawMachine, robot: Robot, q: Vector, *, payload: float, payload_at: Vector) -> Vector:
    """(n,) the torques that hold machine and payload still at q (n,) [N m or N]: slopes of the potential energy.

    Parameters
    ----------
    payload: mass at the tip [kg]; payload_at: (3,) its place in the tip's axes [m].
    """
    loads = [(link, *mass) for link, mass in machine.masses.items()] + [(robot.tip, payload, payload_at)]

    def energy(q: Matrix) -> Vector:
        joints = dict(zip(robot.joint_names, q.T, strict=True))
        placed = machine.placements(joints, len(q))
        height = [mass * ((placed[link][0] @ centre)[:, 2] + placed[link][1][:, 2]) for link, mass, centre in loads]
        return np.asarray(GRAVITY * np.sum(height, axis=0))

    return _slopes(energy, q)


def drive_of(robot: Robot, machine: RawMachine) -> RawDrive | None:
    """The cylinders of a robot, whose links are those of `machine`; None without a hydraulic description."""
    described = robot.hydraulics
    return None if described is None else read_raw_drive(described.file, machine, robot.joint_names)


def greatest_torques(drive: RawDrive | None, q: Matrix, torque: Matrix, effort: Vector) -> Matrix:
    """(T, n) the greatest torque of each joint in the direction of `torque` (T, n), at q (T, n) [N m or N].

    Parameters
    ----------
    effort: (n,) the joints' own [N m or N].
    """
    own = np.broadcast_to(effort, q.shape)
    return own if drive is None else np.minimum(own, drive.greatest_torques(q, torque))


def _slopes(value: Callable[[Matrix], Array], q: Vector) -> Array:
    """(n, ...) the slopes of `value` (K, ...) of configurations (K, n), at q (n,)."""
    step = _STEP * np.eye(len(q))
    return np.asarray((value(q + step) - value(q - step)) / (2.0 * _STEP))
