"""Pinocchio's model of the joints that move the tip; all other joints are held still."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import yourdfpy
from lxml import etree

from backhoe_planner.errors import RobotError
from backhoe_planner.machine.description.urdf import Urdf, axis_of, se3


def chain_model(urdf: Urdf, tip: str | None) -> tuple[str, pin.Model]:
    """The link that is the tip, and Pinocchio's model in which only the joints above it move.

    Parameters
    ----------
    urdf: the machine.
    tip: the link; by default ``bucket_tip``, else the only leaf link.

    Raises
    ------
    RobotError: the tip is unknown or ambiguous, no joint moves it, or a joint between the root
        and the tip copies another joint (``<mimic>``) or is copied by one that is not fixed.
    """
    tip = _find_tip(urdf, tip)
    chain = [joint for joint in urdf.chain(tip) if joint.type != "fixed"]
    for joint in chain:
        if joint.mimic is not None:
            raise RobotError(
                f"copies joint {joint.mimic.joint!r}: mimic joints are not supported between the root and the tip",
                file=urdf.path,
                key=f"joint {joint.name!r}",
                found="<mimic>",
            )
    if not chain:
        raise RobotError("no joint moves the tip", file=urdf.path, key="tip", found=tip)
    moving = {joint.name for joint in chain}
    _check_followers(urdf, moving)
    return tip, _model(urdf, moving)


def _find_tip(urdf: Urdf, tip: str | None) -> str:
    links = [link.name for link in urdf.robot.links]
    if tip is None:
        if "bucket_tip" in links:
            return "bucket_tip"
        if len(urdf.leaves) == 1:
            return urdf.leaves[0]
        raise RobotError(
            "the URDF has several ends; say which one is the tip",
            file=urdf.path,
            key="tip",
            allowed=", ".join(urdf.leaves),
            hint="`tip:` in the scene file, --tip for inspect, tip= in the library",
        )
    if tip not in links:
        raise RobotError.unknown_name("the URDF has no such link", tip, names=links, file=urdf.path, key="tip")
    return tip


def _check_followers(urdf: Urdf, moving: set[str]) -> None:
    """Refuse joints beside the chain that copy one in it: held still, their links would be in a wrong place."""
    copies = {joint.name: joint.mimic.joint for joint in urdf.robot.joints if joint.mimic is not None}
    for joint in urdf.robot.joints:
        leader, met = joint.name, set[str]()
        while leader in copies and leader not in met:
            met.add(leader)
            leader = copies[leader]
        if met and leader in moving and joint.type != "fixed":
            raise RobotError(
                f"copies joint {leader!r}, which moves the tip: mimic joints beside the arm are supported "
                "only where the joint that they copy does not move the tip",
                file=urdf.path,
                key=f"joint {joint.name!r}",
                found="<mimic>",
                hint="without the <mimic> and with the type fixed, its link stands still on its parent",
            )


def _model(urdf: Urdf, moving: set[str]) -> pin.Model:
    """Pinocchio's model in which only the joints named in `moving` move.

    The others become fixed joints at 0, or at the limit nearest to it. Pinocchio's own
    `buildReducedModel` is not used: it refuses a machine whose links have the names of its joints.
    """
    root = etree.fromstring(urdf.xml)
    for element in root.findall("link"):
        _remove(element, "visual", "collision")
    for element in root.findall("joint"):
        joint = urdf.joints[element.get("name")]
        if joint.type != "fixed" and joint.name not in moving:
            _hold(element, joint)
            continue
        _remove(element, "dynamics", "safety_controller", "calibration")
        limit = element.find("limit")
        if joint.type == "continuous":
            element.set("type", "revolute")
            if limit is None:
                limit = etree.SubElement(element, "limit")
            limit.set("lower", "-1e6")
            limit.set("upper", "1e6")
        if limit is not None:
            for attribute in ("effort", "velocity"):
                if limit.get(attribute) is None:
                    limit.set(attribute, "0")
    try:
        return pin.buildModelFromXML(etree.tostring(root).decode())
    except ValueError as error:
        raise RobotError(f"Pinocchio cannot build a model of it: {error}", file=urdf.path) from error


def _hold(element: etree._Element, joint: yourdfpy.Joint) -> None:
    """Make the `element` of a `joint` a fixed one, at position 0 or at the limit nearest to it."""
    held = 0.0
    if joint.limit is not None and joint.type != "continuous" and joint.limit.lower is not None:
        held = float(np.clip(0.0, joint.limit.lower, joint.limit.upper))
    element.set("type", "fixed")
    _remove(element, "limit", "mimic", "axis", "dynamics", "safety_controller")
    if held == 0.0:
        return
    way = held * axis_of(joint)
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
