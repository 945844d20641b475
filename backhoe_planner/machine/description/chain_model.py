"""Pinocchio's model of the joints that move the tip; all other joints are held still."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from lxml import etree

from backhoe_planner.errors import InputError, RobotError
from backhoe_planner.machine.description.base import Base
from backhoe_planner.machine.description.held_joints import HeldJoint, held_joints
from backhoe_planner.machine.description.urdf import Urdf, axis_of, se3
from backhoe_planner.machine.description.urdf_tree import Joint


@dataclass(frozen=True, eq=False)
class ChainModel:
    """Pinocchio's model of the joints that move the tip.

    Attributes
    ----------
    tip: the link that is moved.
    model: of the joints that move (nq = nv = n).
    held: the joints that stand still.
    """

    tip: str
    model: pin.Model
    held: tuple[HeldJoint, ...]


def chain_model(urdf: Urdf, tip: str | None, hold: Mapping[str, float], base: Base) -> ChainModel:
    """Pinocchio's model in which only those joints between the root and the tip move that are not held.

    Parameters
    ----------
    urdf: the machine.
    tip: the link; by default ``bucket_tip``, otherwise the only leaf link that a joint moves.
    hold: joints by name, and the positions at which they are held [rad or m].
    base: placement of the root link.

    Raises
    ------
    RobotError: the tip is unknown or ambiguous, or no joint moves it; or see `held_joints`.
    InputError: no joint is left that moves the tip; or see `held_joints`.
    """
    tip = _find_tip(urdf, tip)
    moving = [joint.name for joint in urdf.chain(tip) if joint.type != "fixed"]
    if not moving:
        raise RobotError("no joint moves the tip", file=urdf.named, key="tip", found=tip)
    held = held_joints(urdf, tip, hold)
    if {joint.name for joint in held}.issuperset(moving):
        raise InputError(
            f"leaves no joint that moves the tip, {tip}", key="hold", found=", ".join(hold),
            allowed=f"at most {len(moving) - 1} of {', '.join(moving)}",
        )  # fmt: skip
    model = _model(urdf, {joint.name: joint.position for joint in held})
    if not base.is_origin:
        _place(model, base.placement)
    return ChainModel(tip, model, held)


def _find_tip(urdf: Urdf, tip: str | None) -> str:
    links = [link.name for link in urdf.robot.links]
    if tip is None:
        if "bucket_tip" in links:
            return "bucket_tip"
        ends = [leaf for leaf in urdf.leaves if any(joint.type != "fixed" for joint in urdf.chain(leaf))] or urdf.leaves
        if len(ends) == 1:
            return ends[0]
        raise RobotError(
            "the URDF has several ends; say which one is the tip",
            file=urdf.named,
            key="tip",
            allowed=", ".join(ends),
            hint="`tip:` in the scene file, --tip for inspect, tip= in the library",
        )
    if tip not in links:
        raise RobotError.unknown_name("the URDF has no such link", tip, names=links, file=urdf.named, key="tip")
    return tip


def _model(urdf: Urdf, held: Mapping[str, float]) -> pin.Model:
    """Pinocchio's model in which the joints named in `held` are fixed at their positions [rad or m].

    Pinocchio's own `buildReducedModel` is not used: it refuses a machine whose links have the
    names of its joints.
    """
    root = etree.fromstring(urdf.xml)
    for element in root.findall("link"):
        _remove(element, "visual", "collision")
    for element in root.findall("joint"):
        joint = urdf.joints[element.get("name")]
        if joint.name in held:
            _hold(element, joint, held[joint.name])
            continue
        _remove(element, "dynamics", "safety_controller", "calibration")
        limit = element.find("limit")
        if joint.type == "continuous":
            element.set("type", "revolute")
            if limit is None:
                limit = etree.SubElement(element, "limit", effort="0", velocity="0")
            limit.set("lower", "-1e6")
            limit.set("upper", "1e6")
    try:
        return pin.buildModelFromXML(etree.tostring(root).decode())
    except ValueError as error:
        raise RobotError(f"Pinocchio cannot build a model of it: {error}", file=urdf.named) from error


def _place(model: pin.Model, T_world_root: pin.SE3) -> None:
    """Move a model whose root link's frame is the world's to another placement."""
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = T_world_root * model.jointPlacements[joint]
    for index in range(1, model.nframes):  # the first is the world itself
        if model.frames[index].parentJoint == 0:
            model.frames[index].placement = T_world_root * model.frames[index].placement


def _hold(element: etree._Element, joint: Joint, position: float) -> None:
    """Turn the `element` of a `joint` into a fixed joint at its `position` [rad or m]."""
    element.set("type", "fixed")
    _remove(element, "limit", "mimic", "axis", "dynamics", "safety_controller")
    if position == 0.0:
        return
    way = position * axis_of(joint)
    moved = pin.SE3(np.eye(3), way) if joint.type == "prismatic" else pin.SE3(pin.exp3(way), np.zeros(3))
    placement = se3(joint.origin) * moved
    origin = element.find("origin")
    if origin is None:
        origin = etree.SubElement(element, "origin")
    origin.set("xyz", " ".join(repr(float(x)) for x in placement.translation))
    origin.set("rpy", " ".join(repr(float(x)) for x in pin.rpy.matrixToRpy(placement.rotation)))


def _remove(element: etree._Element, *tags: str) -> None:
    """Remove the children of an element that have one of the tags."""
    for child in [child for child in element if child.tag in tags]:
        element.remove(child)
