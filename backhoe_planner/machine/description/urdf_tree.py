"""Links and joints of a URDF, with the files of its meshes by name; no mesh is loaded.

The records have the fields of those in `yourdfpy`, which loads trimesh and its dependencies before it
reads anything. The other elements and attributes of a URDF are not kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from lxml import etree

from backhoe_planner.arrays import Matrix, Vector

_Read = TypeVar("_Read")


@dataclass(frozen=True, eq=False)
class Box:
    """A box: `size` (3,) [m]."""

    size: Vector


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z: `radius` and `length` [m]."""

    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    """A sphere of a `radius` [m]."""

    radius: float


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh file as the URDF names it, and its `scale`, one number or (3,); None if it is not given."""

    filename: str
    scale: float | Vector | None


@dataclass(frozen=True)
class Geometry:
    """Exactly one of four shapes."""

    box: Box | None = None
    cylinder: Cylinder | None = None
    sphere: Sphere | None = None
    mesh: Mesh | None = None


@dataclass(frozen=True, eq=False)
class Color:
    """`rgba` (4,) in 0..1."""

    rgba: Vector


@dataclass(frozen=True)
class Material:
    """A colour by name."""

    name: str | None
    color: Color | None


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape of a link to draw or to keep clear; `origin` is its T_link_shape (4, 4)."""

    geometry: Geometry
    origin: Matrix | None = None
    material: Material | None = None


@dataclass(frozen=True)
class Link:
    """A link and its shapes."""

    name: str
    visuals: list[Shape] = field(default_factory=list)
    collisions: list[Shape] = field(default_factory=list)


@dataclass(frozen=True)
class Limit:
    """The limits of a joint [rad, rad/s, N m; or m, m/s, N]; None if not given."""

    effort: float | None
    velocity: float | None
    lower: float | None
    upper: float | None


@dataclass(frozen=True)
class Mimic:
    """A copied position: `multiplier` times the position of `joint`, plus `offset` [rad or m]."""

    joint: str | None
    multiplier: float
    offset: float


@dataclass(frozen=True)
class SafetyController:
    """Limits of a joint that its controller keeps [rad or m]; None if not given."""

    soft_lower_limit: float | None
    soft_upper_limit: float | None


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between links `parent` and `child`; `origin` is T_parent_joint (4, 4), `axis` (3,) as given."""

    name: str
    type: str | None
    parent: str
    child: str
    origin: Matrix | None
    axis: Vector
    limit: Any  # a Limit or None
    mimic: Any  # a Mimic or None
    safety_controller: Any  # a SafetyController or None


@dataclass(frozen=True)
class Tree:
    """Links, joints and named colours of a machine, in the order of the URDF."""

    name: str
    links: list[Link]
    joints: list[Joint]
    materials: list[Material]


def names_a_mesh(root: etree._Element) -> bool:
    """Whether a shape of the URDF with this `root` is a mesh."""
    return next(root.iter("mesh"), None) is not None


def read_tree(root: etree._Element) -> Tree:
    """Links and joints below the `root` of a URDF.

    Raises
    ------
    ValueError: a number cannot be read.
    """
    return Tree(
        name=root.get("name"),
        links=[_link(element) for element in root.findall("link")],
        joints=[_joint(element) for element in root.findall("joint")],
        materials=[_material(element) for element in root.findall("material")],
    )


def _link(element: etree._Element) -> Link:
    visuals, collisions = ([_shape(shape) for shape in element.findall(kind)] for kind in ("visual", "collision"))
    return Link(element.get("name"), visuals, collisions)


def _shape(element: etree._Element) -> Shape:
    return Shape(
        _geometry(element.find("geometry")[0]),
        _where_given(_origin, element.find("origin")),
        _where_given(_material, element.find("material")),
    )


def _geometry(element: etree._Element) -> Geometry:
    if element.tag == "mesh":
        return Geometry(mesh=Mesh(element.get("filename"), _where_given(_scale, element.get("scale"))))
    if element.tag == "box":
        return Geometry(box=Box(_numbers(element.get("size"))))
    radius = float(element.get("radius"))
    if element.tag == "cylinder":
        return Geometry(cylinder=Cylinder(radius, float(element.get("length"))))
    return Geometry(sphere=Sphere(radius))


def _scale(text: str) -> float | Vector:
    numbers = _numbers(text)
    return float(numbers[0]) if len(numbers) == 1 else numbers


def _material(element: etree._Element) -> Material:
    return Material(element.get("name"), _where_given(_color, element.find("color")))


def _color(element: etree._Element) -> Color:
    return Color(_numbers(element.get("rgba", "1 1 1 1")))


def _joint(element: etree._Element) -> Joint:
    axis = element.find("axis")
    return Joint(
        name=element.get("name"),
        type=element.get("type"),
        parent=element.find("parent").get("link"),
        child=element.find("child").get("link"),
        origin=_where_given(_origin, element.find("origin")),
        axis=_numbers("1 0 0" if axis is None else axis.get("xyz", "1 0 0")),
        limit=_where_given(_limit, element.find("limit")),
        mimic=_where_given(_mimic, element.find("mimic")),
        safety_controller=_where_given(_safety_controller, element.find("safety_controller")),
    )


def _limit(element: etree._Element) -> Limit:
    return Limit(*(_where_given(float, element.get(name)) for name in ("effort", "velocity", "lower", "upper")))


def _mimic(element: etree._Element) -> Mimic:
    return Mimic(element.get("joint"), float(element.get("multiplier", 1.0)), float(element.get("offset", 0.0)))


def _safety_controller(element: etree._Element) -> SafetyController:
    limits = (element.get(name) for name in ("soft_lower_limit", "soft_upper_limit"))
    return SafetyController(*(_where_given(float, limit) for limit in limits))


def _origin(element: etree._Element) -> Matrix:
    found = np.eye(4)
    found[:3, :3] = pin.rpy.rpyToMatrix(_numbers(element.get("rpy", "0 0 0")))
    found[:3, 3] = _numbers(element.get("xyz", "0 0 0"))
    return found


def _numbers(text: str) -> Vector:
    return np.array([float(word) for word in text.split()])


def _where_given(read: Callable[[etree._Element], _Read], element: etree._Element | None) -> _Read | None:
    return None if element is None else read(element)
