"""A URDF as written: its links with their shapes, its joints, and their placements.

It is read from the XML alone, so that the planner's reading of the file can be checked against it.
Joints that are not driven are at 0, at the limit nearest to it, or where a joint that they mimic
puts them. Held joints are fixed at their held values.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np
import trimesh

from backhoe_planner.arrays import Array, Matrix, Vector

Placements = tuple[Array, Matrix]
"""Rotations (T, 3, 3) and translations (T, 3) of a frame at T moments."""


@dataclass(frozen=True, eq=False)
class RawShape:
    """One collision shape of a link.

    Attributes
    ----------
    kind: ``box``, ``cylinder``, ``sphere`` or ``mesh``.
    size: edges (3,) of a box; radius and length of a cylinder; radius of a sphere [m].
    rotation, translation: of the shape in the frame of its link.
    vertices, faces: of a mesh, with its scale [m].
    """

    kind: str
    size: tuple[float, ...]
    rotation: Matrix
    translation: Vector
    vertices: Matrix = field(default_factory=lambda: np.zeros((0, 3)))
    faces: Array = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class RawJoint:
    """One joint; missing limits are None, and `rest` is its value while it is not driven."""

    name: str
    kind: str
    parent: str
    child: str
    rotation: Matrix
    translation: Vector
    axis: Vector
    lower: float | None
    upper: float | None
    rest: float

    def fixed(self) -> RawJoint:
        """A fixed joint with the child at the place that it has at rest."""
        turn, slide = self.motion(np.array([self.rest]))
        rotation, translation = self.rotation @ turn[0], self.translation + self.rotation @ slide[0]
        return replace(self, kind="fixed", rotation=rotation, translation=translation)

    def motion(self, value: Vector) -> Placements:
        """The motion of its child at (T,) values [rad or m], in its own frame."""
        if self.kind == "prismatic":
            return np.broadcast_to(np.eye(3), (len(value), 3, 3)), value[:, None] * self.axis
        x, y, z = self.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + np.sin(value)[:, None, None] * cross + (1.0 - np.cos(value))[:, None, None] * (cross @ cross)
        return turn, np.zeros((len(value), 3))


@dataclass(frozen=True, eq=False)
class RawMachine:
    """The links with their shapes, and the joints with parents first.

    `masses` has the mass [kg] of each link that has one, and (3,) its centre in the frame of the link [m]; `inertias`
    the moments of inertia (3, 3) of these links about that centre, along the axes of the frame [kg m^2]. `limits` has
    the numbers of the ``<limit>`` of each joint that has one.
    """

    root: str
    shapes: dict[str, tuple[RawShape, ...]]
    joints: tuple[RawJoint, ...]
    masses: dict[str, tuple[float, Vector]]
    inertias: dict[str, Matrix]
    limits: dict[str, dict[str, float]]

    @cached_property
    def joint_above(self) -> dict[str, RawJoint]:
        """The joint above each link except the root."""
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def _below_root(self) -> dict[str, list[str]]:
        """For each link, the links from the root to it, including itself."""
        found = {self.root: [self.root]}
        for joint in self.joints:
            found[joint.child] = [*found[joint.parent], joint.child]
        return found

    def chain(self, tip: str) -> tuple[RawJoint, ...]:
        """The joints that move link `tip`, from the root outward."""
        found, link = [], tip
        while link in self.joint_above:
            joint = self.joint_above[link]
            if joint.kind != "fixed":
                found.append(joint)
            link = joint.parent
        return tuple(reversed(found))

    def bodies(self, driven: Sequence[str]) -> dict[str, str]:
        """For each link, the last of the `driven` joints that moves it; "" if none does."""
        found = {self.root: ""}
        for joint in self.joints:
            found[joint.child] = joint.name if joint.name in driven else found[joint.parent]
        return found

    def placements(self, q: Mapping[str, Vector], count: int, *links: str) -> dict[str, Placements]:
        """Links in the frame of the root, with driven joints at (`count`,) values each; all links if none is named."""
        needed = {name for link in links for name in self._below_root[link]}
        still = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
        found: dict[str, Placements] = {self.root: still}
        for joint in self.joints:
            if needed and joint.child not in needed:
                continue
            R_parent, p_parent = found[joint.parent]
            R, p = R_parent @ joint.rotation, R_parent @ joint.translation + p_parent
            if joint.kind != "fixed":
                turn, slide = joint.motion(q.get(joint.name, np.full(count, joint.rest)))
                R, p = R @ turn, p + np.einsum("tij,tj->ti", R, slide)
            found[joint.child] = R, p
        return found


def read_raw_urdf(
    file: Path,
    *,
    find_mesh: Callable[[str], Path | None] | None = None,
    hold: Mapping[str, float] = MappingProxyType({}),
) -> RawMachine:
    """Read a URDF with the shapes of its links.

    Parameters
    ----------
    find_mesh: from the name of a mesh to its file; next to the URDF by default.
    hold: held joints and their values [rad or m].
    """
    robot = ET.parse(file).getroot()
    shapes: dict[str, tuple[RawShape, ...]] = {}
    masses: dict[str, tuple[float, Vector]] = {}
    inertias: dict[str, Matrix] = {}
    for link in robot.findall("link"):
        name, inertial = link.attrib["name"], link.find("inertial")
        shapes[name] = tuple(_shape(one, file, find_mesh) for one in link.findall("collision"))
        if inertial is not None:
            turn, centre = _origin(inertial)
            masses[name] = float(_child(inertial, "mass").attrib["value"]), centre
            inertias[name] = turn @ _inertia(inertial) @ turn.T
    elements = {element.attrib["name"]: element for element in robot.findall("joint")}
    limits = {
        name: {key: float(word) for key, word in limit.attrib.items()}
        for name, element in elements.items() if (limit := element.find("limit")) is not None
    }  # fmt: skip
    joints = [_joint(element, *_rest(elements, name, hold)) for name, element in elements.items()]
    children = {joint.child for joint in joints}
    root = next(name for name in shapes if name not in children)
    ordered: list[RawJoint] = []
    reached = [root]
    for name in reached:
        below = [joint for joint in joints if joint.parent == name]
        ordered += below
        reached += [joint.child for joint in below]
    return RawMachine(root, shapes, tuple(ordered), masses, inertias, limits)


def _rest(elements: Mapping[str, ET.Element], name: str, hold: Mapping[str, float]) -> tuple[float, bool]:
    """The value of a joint at rest, and whether it is held there or mimics a held joint."""
    element = elements[name]
    mimic = element.find("mimic")
    if name in hold:
        return hold[name], True
    if mimic is not None:
        there, held = _rest(elements, mimic.attrib["joint"], hold)
        return float(mimic.get("multiplier", 1.0)) * there + float(mimic.get("offset", 0.0)), held
    lower, upper = _bounds(element)
    if lower is None or upper is None or element.attrib["type"] == "continuous":
        return 0.0, False
    return min(max(0.0, lower), upper), False


def _bounds(element: ET.Element) -> tuple[float | None, float | None]:
    """The limits of a joint's position; None if there are none."""
    limit = element.find("limit")
    lower, upper = (None if limit is None or key not in limit.attrib else float(limit.attrib[key]) for key in _BOUNDS)
    return lower, upper


def _joint(element: ET.Element, rest: float, held: bool) -> RawJoint:
    rotation, translation = _origin(element)
    ends = [_child(element, key).attrib["link"] for key in ("parent", "child")]
    axis = np.array([1.0, 0.0, 0.0]) if element.find("axis") is None else _numbers(_child(element, "axis"), "xyz")
    axis = axis / np.linalg.norm(axis)
    name, kind = element.attrib["name"], element.attrib["type"]
    joint = RawJoint(name, kind, ends[0], ends[1], rotation, translation, axis, *_bounds(element), rest)
    return joint.fixed() if held and kind != "fixed" else joint


_BOUNDS = ("lower", "upper")


def _shape(element: ET.Element, file: Path, find_mesh: Callable[[str], Path | None] | None) -> RawShape:
    rotation, translation = _origin(element)
    geometry = _child(element, "geometry")[0]
    if geometry.tag == "box":
        return RawShape("box", tuple(_numbers(geometry, "size").tolist()), rotation, translation)
    if geometry.tag == "sphere":
        return RawShape("sphere", (float(geometry.attrib["radius"]),), rotation, translation)
    if geometry.tag == "cylinder":
        size = float(geometry.attrib["radius"]), float(geometry.attrib["length"])
        return RawShape("cylinder", size, rotation, translation)
    name = geometry.attrib["filename"]
    path = file.parent / name if find_mesh is None else find_mesh(name)
    assert path is not None, name
    mesh = read_mesh(path)
    scale = _numbers(geometry, "scale") if "scale" in geometry.attrib else np.ones(3)
    return RawShape("mesh", (), rotation, translation, np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces))


def read_mesh(path: Path) -> trimesh.Trimesh:
    """The triangles of a file, in its own units."""
    return trimesh.load(path, force="mesh")


def _child(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    assert found is not None, tag
    return found


def _inertia(inertial: ET.Element) -> Matrix:
    """(3, 3) the moments of inertia of a link, along its inertial axes [kg m^2]; zeros if none are given."""
    given = inertial.find("inertia")
    if given is None:
        return np.zeros((3, 3))
    return np.array([[float(given.attrib["i" + min(a + b, b + a)]) for b in "xyz"] for a in "xyz"])


def _numbers(element: ET.Element, key: str) -> Vector:
    return np.array([float(word) for word in element.attrib[key].split()])


def _origin(element: ET.Element) -> tuple[Matrix, Vector]:
    origin = element.find("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    given = {key: _numbers(origin, key) for key in ("xyz", "rpy") if key in origin.attrib}
    return rotation_of(given.get("rpy", np.zeros(3))), given.get("xyz", np.zeros(3))


def rotation_of(rpy: Vector) -> Matrix:
    """(3, 3) the rotation by roll, pitch, yaw about the fixed axes x, y, z [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
