"""The cylinders, pump and engine of a machine, from the hydraulic description as written.

The pins are placed in space by the links of the raw URDF, so that the length of a cylinder is a distance of two points,
and the link of a rocker closes where two circles meet. The lever of a cylinder is the slope of its length, and its
speed a difference of lengths. Neither linkages, moment arms nor limits of the package take part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from backhoe_planner.arrays import Array, Matrix, Vector
from validation.raw_urdf import RawJoint, RawMachine

_STEP = 1e-5  # rad of central differences: a lever is right to 1e-9 m


@dataclass(frozen=True)
class RawCylinder:
    """One cylinder as described, and the joint that it moves.

    Attributes
    ----------
    areas: of the piston and of the piston less the rod, on which the oil pushes and pulls [m^2].
    valve: the greatest flow through its valve [m^3/s].
    pins: (3,) each, on the link above the joint and on the link below it, in their frames [m].
    rocker: the pivot, the cylinder's pin and the link's pin (3, 3) in the frame of the link above, drawn with the joint
        at `drawn_at` [rad]; None if the cylinder is straight across the joint.
    """

    joint: RawJoint
    areas: tuple[float, float]
    valve: float
    pins: tuple[Vector, Vector]
    rocker: Matrix | None
    drawn_at: float

    def lengths(self, angle: Vector) -> Vector:
        """(T,) distances of the pins [m] at (T,) angles of the joint [rad]."""
        base, moved = self.pins[0], self._below(angle)
        if self.rocker is None:
            return np.asarray(np.linalg.norm(moved - base, axis=1))
        pivot, rod, _ = self.rocker
        sine, cosine = self._turned(moved)
        axis = self.joint.rotation @ self.joint.axis
        arm = rod - pivot
        along = (arm @ axis) * axis
        across = arm - along
        turned = cosine[:, None] * across + sine[:, None] * np.cross(axis, across)
        return np.asarray(np.linalg.norm(pivot + along + turned - base, axis=1))

    def _below(self, angle: Vector) -> Matrix:
        """(T, 3) the pin on the link below, in the frame of the link above."""
        turn, _ = self.joint.motion(angle)
        return np.asarray((turn @ self.pins[1]) @ self.joint.rotation.T + self.joint.translation)

    def _turned(self, moved: Matrix) -> tuple[Vector, Vector]:
        """(T,) sine and cosine of the angle by which the rocker is turned from where it is drawn.

        Its link's pin is where a circle about the pivot meets one about the moved pin (T, 3): on the same side of the
        line between the two centres as it is drawn.
        """
        assert self.rocker is not None
        pivot, _, pin = self.rocker
        axis = self.joint.rotation @ self.joint.axis
        u = np.cross(axis, [0.31, 0.52, 0.79])
        u /= np.linalg.norm(u)
        plane = np.array([u, np.cross(axis, u)])
        drawn, centre = plane @ (pin - pivot), plane @ (self._below(np.array([self.drawn_at]))[0] - pivot)
        radius, link = np.linalg.norm(drawn), np.linalg.norm(drawn - centre)
        side = np.sign(centre[0] * drawn[1] - centre[1] * drawn[0]) or 1.0
        x, y = plane @ (moved - pivot).T
        apart = np.hypot(x, y)
        forward = (radius**2 - link**2 + apart**2) / (2.0 * apart)
        beside = side * np.sqrt(radius**2 - forward**2)
        now = (forward * x - beside * y) / apart, (forward * y + beside * x) / apart
        cosine = (drawn[0] * now[0] + drawn[1] * now[1]) / radius**2
        sine = (drawn[0] * now[1] - drawn[1] * now[0]) / radius**2
        return np.asarray(sine), np.asarray(cosine)


@dataclass(frozen=True)
class RawDrive:
    """The m cylinders that move `joint_names`, and what they share.

    Attributes
    ----------
    pump: its greatest flow [m^3/s]; relief: the pressure at which relief valves open [Pa].
    power: what the engine gives to the oil [W].
    """

    joint_names: tuple[str, ...]
    cylinders: tuple[RawCylinder, ...]
    pump: float
    relief: float
    power: float

    @cached_property
    def joint_of(self) -> list[int]:
        """m, the index of the joint that each cylinder moves."""
        return [self.joint_names.index(one.joint.name) for one in self.cylinders]

    @property
    def driven(self) -> list[int]:
        """The joints that a cylinder moves."""
        return sorted(set(self.joint_of))

    def lengths(self, q: Matrix) -> Matrix:
        """(T, m) at q (T, n) [m]."""
        columns = [one.lengths(q[:, joint]) for one, joint in zip(self.cylinders, self.joint_of, strict=True)]
        return np.stack(columns, axis=1)

    def levers(self, q: Matrix) -> Matrix:
        """(T, m) slope of each length by its own joint [m/rad], at q (T, n)."""
        return np.asarray((self.lengths(q + _STEP) - self.lengths(q - _STEP)) / (2.0 * _STEP))

    def greatest_torques(self, q: Matrix, torque: Matrix) -> Matrix:
        """(T, n) the torques that the cylinders give in the direction of `torque` (T, n) [N m], at q (T, n).

        They are infinite for a joint without a cylinder.
        """
        found, levers = np.full(q.shape, np.inf), self.levers(q)
        found[:, self.driven] = 0.0
        for column, (one, joint) in enumerate(zip(self.cylinders, self.joint_of, strict=True)):
            push, pull = one.areas
            area = np.where(levers[:, column] * torque[:, joint] > 0.0, push, pull)
            found[:, joint] += self.relief * area * np.abs(levers[:, column])
        return found

    def flows(self, speed: Matrix) -> Matrix:
        """(T, m) oil that each cylinder takes [m^3/s] at the speeds (T, m) of the rods, growing lengths positive."""
        areas = np.array([one.areas for one in self.cylinders]).T
        return np.asarray(np.abs(speed) * np.where(speed > 0.0, *areas[:, None, :]))

    def rod_use(self, flows: Matrix) -> Matrix:
        """(T, n) the part of what valves and pump allow a joint alone that it moves with, 0 without cylinders."""
        found = np.zeros((len(flows), len(self.joint_names)))
        for joint in self.driven:
            own = [column for column, moved in enumerate(self.joint_of) if moved == joint]
            valves = [flows[:, column] / self.cylinders[column].valve for column in own]
            found[:, joint] = np.max([*valves, np.sum(flows[:, own], axis=1) / self.pump], axis=0)
        return found

    def work_rates(self, v: Matrix, torque: Matrix) -> Vector:
        """(T,) power that the oil gives [W]: cylinders of a joint share its torque, and no load gives anything back."""
        return np.asarray(np.sum(np.maximum(torque * v, 0.0)[:, self.driven], axis=1))

    def pump_rates(self, q: Matrix, v: Matrix, torque: Matrix) -> Vector:
        """(T,) power of a load-sensing pump [W]: the highest pressure that a moving load needs, times all flow.

        The forces of the cylinders of a joint are those of least squares that give its torque.
        """
        levers, highest = self.levers(q), np.zeros(len(q))
        speed = levers * v[:, self.joint_of]
        for joint in self.driven:
            own = [column for column, moved in enumerate(self.joint_of) if moved == joint]
            share = levers[:, own] / np.sum(np.square(levers[:, own]), axis=1)[:, None]
            force = share * torque[:, joint, None]
            areas = np.array([self.cylinders[column].areas for column in own]).T
            pressure = np.abs(force) / np.where(force > 0.0, *areas[:, None, :])
            highest = np.maximum(highest, np.max(np.where(force * speed[:, own] > 0.0, pressure, 0.0), axis=1))
        return np.asarray(highest * np.sum(self.flows(speed), axis=1))


def read_raw_drive(file: Path, machine: RawMachine, joint_names: Sequence[str]) -> RawDrive:
    """Read a hydraulic description; cylinders of joints other than `joint_names` are left out."""
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    joints = {joint.name: joint for joint in machine.joints}
    pump, engine = content["pump"], content["engine"]
    cylinders = tuple(
        _cylinder(one, joints[one["joint"]], float(pump["flow"]))
        for one in content["cylinders"] if one["joint"] in joint_names
    )  # fmt: skip
    power = float(engine["power"]) * float(engine.get("efficiency", 1.0))
    return RawDrive(tuple(joint_names), cylinders, float(pump["flow"]), float(pump["pressure"]), power)


def _cylinder(given: dict[str, Any], joint: RawJoint, pump: float) -> RawCylinder:
    bore, rod = float(given["bore"]), float(given["rod"])
    pins: Array = np.array([given["parent"], given["child"]], dtype=float)
    rocker = given.get("rocker")
    drawn = None if rocker is None else np.array([rocker[key] for key in ("pivot", "cylinder", "link")], dtype=float)
    return RawCylinder(
        joint=joint,
        areas=(0.25 * np.pi * bore**2, 0.25 * np.pi * (bore + rod) * (bore - rod)),
        valve=min(float(given.get("flow", pump)), pump),
        pins=(pins[0], pins[1]),
        rocker=drawn,
        drawn_at=0.0 if rocker is None else float(rocker.get("drawn_at", 0.0)),
    )
