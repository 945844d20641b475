"""The machine: a Pinocchio model of the joints that move the tip, and its shape.

`load_robot` is the only door. The model holds one number per joint: continuous
joints are angles without limits, joints that do not move the tip are held still.
Nothing in here changes after loading, and nobody else's model is written on.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
import yourdfpy
from lxml import etree
from numpy.typing import NDArray

from backhoe_planner.errors import InputError, RobotError
from backhoe_planner.machine.description.hydraulics_file import description_beside, read_hydraulics
from backhoe_planner.machine.description.urdf import Urdf, axis_of, read_urdf
from backhoe_planner.machine.hydraulics.hydraulics import Hydraulics
from backhoe_planner.machine.shape import shapes
from backhoe_planner.machine.shape.convex import convex_cover, load_mesh

__all__ = ["JointLimits", "LinkPiece", "Robot", "Visual", "load_robot"]

Vector = NDArray[np.float64]

_DEFAULT_VELOCITY = 1.0  # rad/s or m/s, where the URDF gives none
_FULL_RATE_AFTER = 0.5  # s: acceleration where neither URDF nor scene gives one
# A link's mesh is taken as its convex hull unless the hull would close a cavity.
_LINK_HULL_EXCESS = 2.0
_PIECES_PER_LINK_MESH = 8


@dataclass(frozen=True)
class JointLimits:
    """Limits of every joint, arrays (n,), read-only.

    Attributes
    ----------
    lower, upper: position [rad or m]; infinite for a continuous joint.
    velocity: [rad/s or m/s], symmetric.
    acceleration: [rad/s^2 or m/s^2], symmetric.
    effort: [N m or N], symmetric; infinite where the URDF gives none.
    """

    lower: Vector
    upper: Vector
    velocity: Vector
    acceleration: Vector
    effort: Vector

    def __post_init__(self) -> None:
        for array in (self.lower, self.upper, self.velocity, self.acceleration, self.effort):
            array.setflags(write=False)


@dataclass(frozen=True)
class LinkPiece:
    """A convex collision piece of a link.

    Attributes
    ----------
    name: unique, ``link/0``, ``link/1``, ...
    link: the URDF link to which it belongs.
    joint: index of the Pinocchio joint that carries it; 0 stands still.
    piece: the shape, placed in the frame of that joint.
    """

    name: str
    link: str
    joint: int
    piece: shapes.Piece


@dataclass(frozen=True)
class Visual:
    """Something to draw.

    Attributes
    ----------
    link, joint: as in `LinkPiece`.
    placement: T_joint_visual.
    kind: ``box``, ``cylinder``, ``sphere`` or ``mesh``.
    size: box edges (3,); cylinder (radius, length); sphere (radius,); mesh scale (3,).
    mesh: the file of a mesh.
    rgba: (4,) in 0..1, or None where the URDF gives no colour.
    """

    link: str
    joint: int
    placement: pin.SE3
    kind: str
    size: tuple[float, ...]
    mesh: Path | None
    rgba: tuple[float, ...] | None


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A machine whose tip is to be moved.

    Attributes
    ----------
    name: the URDF's name.
    urdf: the checked URDF from which it was built.
    tip: the link that is moved.
    tip_frame: its frame index in `model`.
    joint_names: the n joints from the machine outward.
    limits: of these joints.
    model: Pinocchio's model of them (nq = nv = n). Not to be written on.
    pieces: the collision shape of every link.
    visuals: what to draw.
    hydraulics: cylinders and pump, where the machine has a description of them.
    """

    name: str
    urdf: Urdf
    tip: str
    tip_frame: int
    joint_names: tuple[str, ...]
    limits: JointLimits
    model: pin.Model
    pieces: tuple[LinkPiece, ...]
    visuals: tuple[Visual, ...]
    hydraulics: Hydraulics | None = None

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, tip={self.tip!r}, joints={self.joint_names})"

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Links with a collision shape, in the order of the URDF."""
        return tuple(dict.fromkeys(piece.link for piece in self.pieces))

    @cached_property
    def all_link_names(self) -> tuple[str, ...]:
        """Every link of the URDF."""
        return tuple(link.name for link in self.urdf.robot.links)

    @cached_property
    def prismatic(self) -> NDArray[np.bool_]:
        """(n,) which joints slide."""
        return np.array([self.urdf.joints[name].type == "prismatic" for name in self.joint_names])

    @cached_property
    def joint_axes(self) -> Vector:
        """(n, 3) unit axis of each joint in its own frame."""
        return np.array([axis_of(self.urdf.joints[name]) for name in self.joint_names])

    @cached_property
    def support(self) -> NDArray[np.float64]:
        """(n + 1, n) 1 where a joint (column) moves the body of Pinocchio's joint (row); row 0 stands still."""
        mask = np.zeros((self.n + 1, self.n))
        for joint in range(1, self.n + 1):  # Pinocchio numbers joints from the root outward
            mask[joint] = mask[int(self.model.parents[joint])]
            mask[joint, joint - 1] = 1.0
        return mask

    @cached_property
    def middle(self) -> Vector:
        """(n,) the middle of each joint's range, 0 where there is no range [rad or m]."""
        finite = np.isfinite(self.limits.lower) & np.isfinite(self.limits.upper)
        centre = np.zeros(self.n)
        centre[finite] = 0.5 * (self.limits.lower[finite] + self.limits.upper[finite])
        return centre

    @cached_property
    def has_pitch(self) -> bool:
        """Whether the last joint's axis stays horizontal, so that pitch is defined."""
        data = self.model.createData()
        rng = np.random.default_rng(0)
        for _ in range(8):
            q = self.random_q(rng)
            pin.computeJointJacobians(self.model, data, q)
            axis = data.J.reshape(6, self.n)[3:, -1]  # of one joint alone it is 1-D
            if np.linalg.norm(axis) < 0.5 or abs(axis[2]) > 1e-9:
                return False
        return True

    @cached_property
    def pitch_sense(self) -> float:
        """1 where turning the last joint forward lifts the tip, -1 where it lowers it.

        Forward is where the tip lies when the arm reaches out furthest, over 64 seeded
        postures; the axis of the last joint may point to either side of the arm.
        """
        data = self.model.createData()
        rng = np.random.default_rng(0)
        furthest, sense = 0.0, 1.0
        for _ in range(64):
            pin.computeJointJacobians(self.model, data, self.random_q(rng))
            tip = pin.updateFramePlacement(self.model, data, self.tip_frame).translation
            out = tip - data.oMi[1].translation
            axis = data.J.reshape(6, self.n)[3:, -1]
            reach = float(out[1] * axis[0] - out[0] * axis[1])
            if abs(reach) > furthest:
                furthest, sense = abs(reach), float(np.sign(reach))
        return sense

    def random_q(self, rng: np.random.Generator) -> Vector:
        """(n,) uniform within the limits; a turn either way for continuous joints."""
        lower = np.where(np.isfinite(self.limits.lower), self.limits.lower, -np.pi)
        upper = np.where(np.isfinite(self.limits.upper), self.limits.upper, np.pi)
        return np.asarray(rng.uniform(lower, upper))

    def with_tip(self, tip: str | None) -> Robot:
        """The same machine moved at another tip; itself if `tip` is None or the same."""
        if tip is None or tip == self.tip:
            return self
        return _build(self.urdf, tip, None if self.hydraulics is None else self.hydraulics.file)

    def check_q(self, q: object, *, what: str = "q") -> Vector:
        """(n,) a finite copy of `q`.

        Raises
        ------
        InputError: the length is wrong or a number is not finite.
        """
        try:
            values = np.array(q, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError("is not a list of numbers", key=what, found=q) from error
        if values.shape != (self.n,):
            raise InputError(
                "has the wrong number of joints",
                key=what,
                found=f"shape {values.shape}",
                allowed=f"({self.n},): {', '.join(self.joint_names)}",
            )
        if not np.all(np.isfinite(values)):
            bad = ", ".join(
                name for name, value in zip(self.joint_names, values, strict=True) if not np.isfinite(value)
            )
            raise InputError("is not finite", key=f"{what} ({bad})", found=values.tolist())
        return values


def load_robot(
    source: str | os.PathLike[str], *, tip: str | None = None, hydraulics: str | os.PathLike[str] | None = None
) -> Robot:
    """Load a machine from a URDF, and its hydraulic description where it has one.

    Parameters
    ----------
    source: a path, or ``example:NAME``.
    tip: the link to be moved; by default ``bucket_tip``, else the only leaf link.
    hydraulics: the description of cylinders and pump; by default ``NAME.hydraulics.yaml``
        beside ``NAME.urdf``, if there is such a file.

    Raises
    ------
    RobotError: see `read_urdf` and `read_hydraulics`; also an unknown or ambiguous tip, a tip that no joint
        moves, a mimic joint between the root and the tip, and one that copies a joint between them.

    Examples
    --------
    >>> robot = load_robot("example:backhoe")
    >>> robot.joint_names
    ('swing', 'boom', 'stick', 'bucket')
    """
    urdf = read_urdf(source)
    if hydraulics is not None:
        return _build(urdf, tip, Path(hydraulics))
    beside = description_beside(urdf.path)
    return _build(urdf, tip, beside if beside.is_file() else None)


def _build(urdf: Urdf, tip: str | None, hydraulics: Path | None) -> Robot:
    tip = _checked_tip(urdf, tip)
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
    _check_followers(urdf, {joint.name for joint in chain})
    model = _chain_model(urdf, {joint.name for joint in chain})
    joint_names = tuple(str(name) for name in model.names[1:])
    return Robot(
        name=str(urdf.robot.name),
        urdf=urdf,
        tip=tip,
        tip_frame=int(model.getFrameId(tip, pin.FrameType.BODY)),
        joint_names=joint_names,
        limits=_limits(urdf, model),
        model=model,
        pieces=_link_pieces(urdf, model),
        visuals=_visuals(urdf, model),
        hydraulics=None if hydraulics is None else read_hydraulics(hydraulics, urdf, joint_names),
    )


def _check_followers(urdf: Urdf, moving: set[str]) -> None:
    """That no joint beside the chain copies one that moves: held still, its link would not be where it is."""
    copies = {joint.name: joint.mimic.joint for joint in urdf.robot.joints if joint.mimic is not None}
    for joint in urdf.robot.joints:
        leader, met = joint.name, set[str]()
        while leader in copies and leader not in met:
            met.add(leader)
            leader = copies[leader]
        if met and leader in moving and joint.type != "fixed":
            raise RobotError(
                f"copies joint {leader!r}, which moves the tip: mimic joints beside the arm are supported "
                "only where what they copy stands still",
                file=urdf.path,
                key=f"joint {joint.name!r}",
                found="<mimic>",
                hint="without the <mimic> and with the type fixed, its link stands still on its parent",
            )


def _checked_tip(urdf: Urdf, tip: str | None) -> str:
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


def _chain_model(urdf: Urdf, moving: set[str]) -> pin.Model:
    """Pinocchio's model in which only the joints named in `moving` move.

    The others are made fixed where they are held: at 0, or the limit nearest to it. Pinocchio's own
    `buildReducedModel` refuses a machine whose links are named as its joints.
    """
    root = etree.fromstring(urdf.xml)
    for element in root.findall("link"):
        for unread in (*element.findall("visual"), *element.findall("collision")):
            element.remove(unread)
    for element in root.findall("joint"):
        joint = urdf.joints[element.get("name")]
        if joint.type != "fixed" and joint.name not in moving:
            _hold(element, joint)
            continue
        for unread in ("dynamics", "safety_controller", "calibration"):
            for node in element.findall(unread):
                element.remove(node)
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
    """Make a joint's element fixed at 0, or at the limit nearest to 0."""
    held = 0.0
    if joint.limit is not None and joint.type != "continuous" and joint.limit.lower is not None:
        held = float(np.clip(0.0, joint.limit.lower, joint.limit.upper))
    element.set("type", "fixed")
    for unwanted in ("limit", "mimic", "axis", "dynamics", "safety_controller"):
        for node in element.findall(unwanted):
            element.remove(node)
    if held == 0.0:
        return
    way = held * axis_of(joint)
    moved = pin.SE3(np.eye(3), way) if joint.type == "prismatic" else pin.SE3(pin.exp3(way), np.zeros(3))
    placement = _se3(joint.origin) * moved
    origin = element.find("origin")
    if origin is None:
        origin = etree.SubElement(element, "origin")
    origin.set("xyz", " ".join(repr(float(x)) for x in placement.translation))
    origin.set("rpy", " ".join(repr(float(x)) for x in pin.rpy.matrixToRpy(placement.rotation)))


def _limits(urdf: Urdf, model: pin.Model) -> JointLimits:
    lower, upper, velocity, acceleration, effort = [], [], [], [], []
    for name in model.names[1:]:
        joint = urdf.joints[name]
        limit = joint.limit
        free = joint.type == "continuous"
        lower.append(-np.inf if free else float(limit.lower))
        upper.append(np.inf if free else float(limit.upper))
        rate = float(limit.velocity) if limit is not None and limit.velocity else _DEFAULT_VELOCITY
        velocity.append(rate)
        acceleration.append(urdf.acceleration.get(name, rate / _FULL_RATE_AFTER))
        effort.append(float(limit.effort) if limit is not None and limit.effort else np.inf)
    return JointLimits(*(np.array(values) for values in (lower, upper, velocity, acceleration, effort)))


def _se3(origin: Vector | None) -> pin.SE3:
    if origin is None:
        return pin.SE3.Identity()
    matrix = np.asarray(origin, dtype=float)
    return pin.SE3(matrix[:3, :3], matrix[:3, 3])


def _body(model: pin.Model, link: str) -> tuple[int, pin.SE3]:
    """Joint that carries a link, and T_joint_link."""
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    return int(frame.parentJoint), frame.placement


def _mesh_scale(mesh: yourdfpy.Mesh) -> Vector:
    scale = 1.0 if mesh.scale is None else mesh.scale
    return np.broadcast_to(np.asarray(scale, dtype=float), (3,)).copy()


def _link_pieces(urdf: Urdf, model: pin.Model) -> tuple[LinkPiece, ...]:
    found = []
    for link in urdf.robot.links:
        if not link.collisions:
            continue
        joint, T_joint_link = _body(model, link.name)
        pieces: list[shapes.Piece] = []
        for collision in link.collisions:
            try:
                pieces += _pieces_of(urdf, collision.geometry, T_joint_link * _se3(collision.origin))
            except InputError as error:
                raise RobotError(str(error), file=urdf.path, key=f"link {link.name!r} > collision") from error
        for index, piece in enumerate(pieces):
            found.append(LinkPiece(name=f"{link.name}/{index}", link=link.name, joint=joint, piece=piece))
    return tuple(found)


def _pieces_of(urdf: Urdf, geometry: yourdfpy.Geometry, placement: pin.SE3) -> list[shapes.Piece]:
    if geometry.box is not None:
        return [shapes.box(geometry.box.size, placement)]
    if geometry.sphere is not None:
        return [shapes.sphere(geometry.sphere.radius, placement)]
    if geometry.cylinder is not None:
        return [shapes.cylinder(geometry.cylinder.radius, geometry.cylinder.length, placement)]
    path = urdf.mesh_path(geometry.mesh.filename)
    if path is None:
        raise InputError("mesh file not found", found=geometry.mesh.filename)
    mesh = load_mesh(path)
    mesh.apply_scale(_mesh_scale(geometry.mesh))
    cover = convex_cover(mesh, pieces=_PIECES_PER_LINK_MESH, excess=_LINK_HULL_EXCESS)
    return [shapes.convex(points, placement) for points in cover]


def _visuals(urdf: Urdf, model: pin.Model) -> tuple[Visual, ...]:
    colours = {
        material.name: tuple(float(c) for c in material.color.rgba)
        for material in urdf.robot.materials
        if material.color is not None
    }
    found = []
    for link in urdf.robot.links:
        if not link.visuals:
            continue
        joint, T_joint_link = _body(model, link.name)
        for visual in link.visuals:
            geometry = visual.geometry
            rgba = None
            if visual.material is not None:
                own = visual.material.color
                rgba = tuple(float(c) for c in own.rgba) if own is not None else colours.get(visual.material.name)
            mesh = None
            if geometry.box is not None:
                kind, size = "box", tuple(float(edge) for edge in geometry.box.size)
            elif geometry.cylinder is not None:
                kind, size = "cylinder", (float(geometry.cylinder.radius), float(geometry.cylinder.length))
            elif geometry.sphere is not None:
                kind, size = "sphere", (float(geometry.sphere.radius),)
            else:
                kind, size = "mesh", tuple(float(s) for s in _mesh_scale(geometry.mesh))
                mesh = urdf.mesh_path(geometry.mesh.filename)
            found.append(
                Visual(
                    link=link.name,
                    joint=joint,
                    placement=T_joint_link * _se3(visual.origin),
                    kind=kind,
                    size=size,
                    mesh=mesh,
                    rgba=rgba,
                )
            )
    return tuple(found)
