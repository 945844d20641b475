"""Joints that stand still: those that a scene holds, those that copy them, and all that do not move the tip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from backhoe_planner.errors import InputError, RobotError
from backhoe_planner.machine.description.urdf import Urdf
from backhoe_planner.machine.description.urdf_tree import Joint

_SAME = 1e-9  # rad, m: positions that differ by less are equal but for rounding


@dataclass(frozen=True)
class HeldJoint:
    """A joint that stands still, and its links with it.

    Attributes
    ----------
    name: the joint.
    position: its position [rad or m].
    why: ``held`` if the scene holds it, ``copies`` if it copies another joint that stands still, or
        ``beside`` if it is not between the root and the tip: its position is then 0, or the limit nearest to 0.
    copies: the joint that it copies (``<mimic>``), or None.
    """

    name: str
    position: float
    why: Literal["held", "copies", "beside"]
    copies: str | None = None


def held_joints(urdf: Urdf, tip: str, hold: Mapping[str, float]) -> tuple[HeldJoint, ...]:
    """Every joint that stands still while `tip` is moved, in the order of the URDF.

    Parameters
    ----------
    hold: joints of any part of the machine by name, and the positions at which they are held [rad or m].

    Raises
    ------
    InputError: there is no such joint, it is fixed, or the position is outside of its limits or
        not that of the joint that it copies. The key is that of a scene.
    RobotError: a joint copies one that moves, or a joint between the root and the tip copies one that is not held.
    """
    for name, position in hold.items():
        _check_held(urdf, name, position)
    standing = _Standing(urdf, tip, hold)
    return tuple(
        standing.joint(joint.name)
        for joint in urdf.robot.joints
        if joint.type != "fixed" and joint.name not in standing.moving
    )


def _check_held(urdf: Urdf, name: str, position: float) -> None:
    joint = urdf.joints.get(name)
    names = [other.name for other in urdf.robot.joints if other.type != "fixed"]
    if joint is None:
        raise InputError.unknown_name("the machine has no such joint", name, names=names, key="hold")
    if joint.type == "fixed":
        raise InputError("is fixed in the URDF", key="hold", found=name, allowed=", ".join(names))
    if joint.type != "continuous" and not joint.limit.lower <= position <= joint.limit.upper:
        raise InputError(
            "is outside of the joint's limits",
            key=f"hold.{name}",
            found=position,
            allowed=f"{joint.limit.lower:g} to {joint.limit.upper:g} {'m' if joint.type == 'prismatic' else 'rad'}",
        )


class _Standing:
    """The positions of the joints that stand still.

    Attributes
    ----------
    moving: the joints that move the tip.
    """

    def __init__(self, urdf: Urdf, tip: str, hold: Mapping[str, float]) -> None:
        self._urdf, self._hold = urdf, hold
        chain = [joint for joint in urdf.chain(tip) if joint.type != "fixed" and joint.name not in hold]
        self.moving = {joint.name for joint in chain if self._leader(joint) not in hold}
        for joint in chain:
            if joint.mimic is not None and self._leader(joint) is None:
                raise RobotError(
                    f"copies joint {joint.mimic.joint!r}, which copies it in turn or does not exist",
                    file=urdf.named, key=f"joint {joint.name!r}", found="<mimic>",
                )  # fmt: skip
            if joint.mimic is not None and joint.name in self.moving:
                raise RobotError(
                    f"copies joint {joint.mimic.joint!r}: mimic joints are not supported between the root and the tip",
                    file=urdf.named,
                    key=f"joint {joint.name!r}",
                    found="<mimic>",
                    hint=f"unless what they copy is held: `hold: {{{self._leader(joint)}: ...}}` in the scene",
                )

    def joint(self, name: str) -> HeldJoint:
        """The record of one of the joints that stand still."""
        joint = self._urdf.joints[name]
        leader = self._leader(joint)
        if leader is None:
            if name in self._hold:
                return HeldJoint(name, float(self._hold[name]), "held")
            return HeldJoint(name, _nearest_zero(joint), "beside")
        if leader in self.moving:
            raise RobotError(
                f"copies joint {leader!r}, which moves the tip: mimic joints beside the arm are supported "
                "only where the joint that they copy does not move the tip",
                file=self._urdf.named,
                key=f"joint {name!r}",
                found="<mimic>",
                hint="without the <mimic> and with the type fixed, its link stands still on its parent",
            )
        position = self._copied(joint)
        if name in self._hold and abs(self._hold[name] - position) > _SAME:
            raise InputError(
                f"copies joint {joint.mimic.joint!r}, so its position cannot be chosen",
                key=f"hold.{name}",
                found=self._hold[name],
                allowed=f"{position:g}, or another position of {leader!r}",
            )
        return HeldJoint(name, position, "copies", str(joint.mimic.joint))

    def _copied(self, joint: Joint) -> float:
        """The position of a joint that copies another one [rad or m]."""
        mimic = joint.mimic
        leader = self._urdf.joints[mimic.joint]
        if leader.type == "fixed":
            there = 0.0
        else:
            there = self._copied(leader) if self._leader(leader) is not None else self.joint(leader.name).position
        multiplier = 1.0 if mimic.multiplier is None else float(mimic.multiplier)
        return multiplier * there + (0.0 if mimic.offset is None else float(mimic.offset))

    def _leader(self, joint: Joint) -> str | None:
        """The joint at the end of a chain of copies; None if a joint copies none, or only itself."""
        met = {joint.name}
        leader = joint
        while leader.mimic is not None:
            if leader.mimic.joint not in self._urdf.joints or leader.mimic.joint in met:
                return None
            leader = self._urdf.joints[leader.mimic.joint]
            met.add(leader.name)
        return None if leader is joint else str(leader.name)


def _nearest_zero(joint: Joint) -> float:
    """0, or the limit of a joint that is nearest to 0 [rad or m]."""
    if joint.limit is None or joint.type == "continuous" or joint.limit.lower is None:
        return 0.0
    return float(np.clip(0.0, joint.limit.lower, joint.limit.upper))
