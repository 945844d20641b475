"""Reading a URDF: it is found, parsed, and checked before Pinocchio sees it.

`read_urdf` is the only way to make a `Urdf`. In a `Urdf` every link and joint has a name, all numbers are
finite, all joints are of types that this package plans with, and all meshes exist on disk.
"""

from __future__ import annotations

import graphlib
import hashlib
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import RobotError
from backhoe_planner.files.file_kinds import refuse_other_kind
from backhoe_planner.files.found_file import is_file, is_folder
from backhoe_planner.files.provenance import relative_path
from backhoe_planner.machine.description.urdf_tree import Joint, Tree, names_a_mesh, read_tree
from backhoe_planner.machine.description.yourdfpy_check import check_by_yourdfpy

_MOVING = ("revolute", "continuous", "prismatic")
_REFUSED = {
    "floating": "a floating joint has no limits to plan within",
    "planar": "a planar joint has no limits to plan within",
    "spherical": "a spherical joint is not described by one angle",
}

# robots of example-robot-data whose file has another name
_EXAMPLE_ALIASES = {
    "panda": "panda_description/urdf/panda.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
}

# other words for which a shipped model is suggested
_ALSO_CALLED = {"excavator": "backhoe", "backhoe loader": "backhoe", "digger": "backhoe", "bagger": "backhoe"}


@dataclass(frozen=True)
class Urdf:
    """A URDF that was read and checked.

    Attributes
    ----------
    source: as the user gave it, a path or ``example:NAME``.
    path: the file itself.
    xml: its text without comments; a velocity or effort that is missing in a `<limit>` is 0.
    sha256: of the file's bytes.
    robot: links and joints.
    acceleration: `<limit acceleration>` by joint name [rad/s^2 or m/s^2], where given.
    """

    source: str
    path: Path
    xml: bytes
    sha256: str
    robot: Tree
    acceleration: dict[str, float]

    @property
    def named(self) -> Path:
        """The file in messages: as the user named it, ``example:NAME`` too."""
        return Path(self.source)

    def source_from(self, folder: Path | None) -> str:
        """How a file in `folder` names it: ``example:NAME`` for a shipped model, otherwise the path from there."""
        if self.source.startswith("example:"):
            return self.source
        path = self.path.resolve()
        is_shipped = path.parent == shipped_folder("models").resolve()
        return f"example:{path.stem}" if is_shipped else relative_path(path, folder)

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """Every joint by its name."""
        return {joint.name: joint for joint in self.robot.joints}

    @cached_property
    def joint_of_child(self) -> dict[str, Joint]:
        """The joint above each link, by the link's name; the root has none."""
        return {joint.child: joint for joint in self.robot.joints}

    @cached_property
    def root(self) -> str:
        """The link that has no joint above it."""
        return next(str(link.name) for link in self.robot.links if link.name not in self.joint_of_child)

    @cached_property
    def leaves(self) -> tuple[str, ...]:
        """Links that carry no other link."""
        parents = {joint.parent for joint in self.robot.joints}
        return tuple(str(link.name) for link in self.robot.links if link.name not in parents)

    def chain(self, tip: str) -> tuple[Joint, ...]:
        """The joints from the root to link `tip`, fixed ones included."""
        joints = []
        link = tip
        while link in self.joint_of_child:
            joint = self.joint_of_child[link]
            joints.append(joint)
            link = joint.parent
        return tuple(reversed(joints))

    @property
    def files(self) -> tuple[Path, ...]:
        """The URDF and the meshes that it names."""
        shapes = [shape for link in self.robot.links for shape in (*link.collisions, *link.visuals)]
        meshes = [shape.geometry.mesh for shape in shapes if shape.geometry is not None]
        found = {self.mesh_path(mesh.filename) for mesh in meshes if mesh is not None}
        return (self.path, *sorted(path for path in found if path is not None))

    def mesh_path(self, uri: str) -> Path | None:
        """The file of a mesh that the URDF names by `uri`; None if there is no such file."""
        return next(filter(is_file, _mesh_candidates(uri, self.path)), None)


def axis_of(joint: Joint) -> Vector:
    """(3,) unit axis of a joint in its own frame; x if the URDF gives none."""
    axis = np.array([1.0, 0.0, 0.0]) if joint.axis is None else np.asarray(joint.axis, dtype=float)
    return np.asarray(axis / np.linalg.norm(axis))


def se3(origin: Matrix | None) -> pin.SE3:
    """The transform of a URDF `origin` (4, 4) for Pinocchio; the identity for None."""
    if origin is None:
        return pin.SE3.Identity()
    matrix = np.asarray(origin, dtype=float)
    return pin.SE3(matrix[:3, :3], matrix[:3, 3])


def shipped_folder(folder: str) -> Path:
    """The `folder` that comes with the package, ``models`` or ``scenes``.

    In a wheel it is inside the package, in a clone beside it.
    """
    package = Path(__file__).resolve().parents[2]
    inside = package / folder
    return inside if inside.is_dir() else package.parent / folder


def shipped_file(file: Path, folder: str) -> Path:
    """`file`, or the file of that name which is shipped in `folder` if `file` does not exist.

    A shipped file is meant by its name alone, or by its name after the folder or a parent of the folder, such as
    ``scenes/jobs/drain.yaml``.
    """
    inner, *outer = Path(folder).parts
    own = shipped_folder(inner).joinpath(*outer, file.name)
    named = file.parent in (Path(folder), *Path(folder).parents)
    return own if named and is_file(own) and not (is_file(file) or is_folder(file)) else file


def example_names() -> list[str]:
    """The names that may follow ``example:``, sorted."""
    found = {path.stem for path in shipped_folder("models").glob("*.urdf")}
    root = _example_root()
    if root is not None:
        found |= {path.stem for path in root.glob("*/*/*.urdf")}
        found |= {name for name, rel in _EXAMPLE_ALIASES.items() if (root / rel).is_file()}
    return sorted(found)


def read_urdf(source: str | os.PathLike[str]) -> Urdf:
    """Read and check a URDF.

    Parameters
    ----------
    source: a path, or ``example:NAME`` for a robot of example-robot-data or for one of
        the models that come with this package, such as ``example:backhoe``.

    Raises
    ------
    RobotError: the file is missing, is not XML, or is not a tree of links and joints; a joint
        has a type that is not supported or has no limits; a number is not finite; a mesh
        does not exist. The message names the file and the element.
    """
    path, named = _locate(os.fspath(source)), Path(source)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RobotError(f"cannot be read: {error.strerror}", file=path) from error
    root = _parse_xml(data, named)
    _check_numbers(root, named)
    _check_complete(root, named)
    _fill_limits(root)
    tree = _read_tree(root, named)
    _check_tree(tree, named)
    for joint in tree.joints:
        _check_joint(joint, named)
    urdf = Urdf(
        source=os.fspath(source),
        path=path,
        xml=etree.tostring(root),
        sha256=hashlib.sha256(data).hexdigest(),
        robot=tree,
        acceleration=_acceleration_limits(root),
    )
    _check_meshes(urdf)
    return urdf


# --- finding the file ---------------------------------------------------------


def _locate(source: str) -> Path:
    if source.startswith("example:"):
        return _locate_example(source.removeprefix("example:"))
    path = Path(source)
    if is_file(path):
        return path
    if is_folder(path):
        raise RobotError("is a folder, not a URDF file", file=path)
    own = shipped_folder("models") / path.name
    if path.parent in (Path("models"), Path()) and is_file(own):
        return own
    raise RobotError(
        "no such URDF file",
        file=path,
        allowed="a path to a URDF, or example:NAME",
        hint="example:backhoe is the backhoe that comes with the package",
    )


def _locate_example(name: str) -> Path:
    own = shipped_folder("models") / f"{name}.urdf"
    if is_file(own):
        return own
    root = _example_root()
    if root is None:
        raise RobotError(
            "example-robot-data is not installed", key=f"example:{name}", hint="pip install example-robot-data"
        )
    candidates = [root / _EXAMPLE_ALIASES[name]] if name in _EXAMPLE_ALIASES else []
    candidates += sorted(root.glob(f"*/*/{name}.urdf"))
    for candidate in candidates:
        if is_file(candidate):
            return candidate
    problem, key = "no such example robot", f"example:{name}"
    raise RobotError.unknown_name(problem, name, names=example_names(), key=key, other_words=_ALSO_CALLED)


def _example_root() -> Path | None:
    """The folder `share/example-robot-data/robots` of the prefix in which the package is installed."""
    prefixes = [Path(sys.prefix)]
    prefixes += [Path(entry) / "cmeel.prefix" for entry in sys.path if entry]
    for prefix in prefixes:
        robots = prefix / "share" / "example-robot-data" / "robots"
        if robots.is_dir():
            return robots
    return None


def _mesh_candidates(uri: str, urdf: Path) -> Iterator[Path]:
    """The paths at which a mesh file may be, the most likely first."""
    if uri.startswith("package://"):
        package, _, rest = uri.removeprefix("package://").partition("/")
        root = _example_root()
        if root is not None and package == "example-robot-data":
            yield root.parent / rest
        for folder in urdf.resolve().parents:
            if folder.name == package:
                yield folder / rest
            yield folder / package / rest
        for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
            if entry:
                yield Path(entry) / package / rest
    elif uri.startswith("file://"):
        yield Path(uri.removeprefix("file://"))
    else:
        yield urdf.parent / uri


# --- checking it --------------------------------------------------------------


def _parse_xml(data: bytes, path: Path) -> etree._Element:
    if not data.strip():
        raise RobotError("the file is empty", file=path, allowed="a URDF")
    parser = etree.XMLParser(remove_comments=True, remove_pis=True, resolve_entities=False)
    try:
        root = etree.fromstring(data, parser=parser)
    except etree.XMLSyntaxError as error:
        refuse_other_kind(data.decode(errors="replace"), "urdf", file=path, error=RobotError)
        raise RobotError(f"is not well-formed XML: {error.msg}", file=path) from error
    dtd = root.getroottree().docinfo.internalDTD
    if dtd is not None and any(True for _ in dtd.iterentities()):
        raise RobotError("has entities of its own", file=path, allowed="a URDF in which they are written out")
    if root.tag != "robot":
        raise RobotError("the outermost element is not a robot", file=path, found=f"<{root.tag}>", allowed="<robot>")
    if not root.get("name"):
        raise RobotError("the robot has no name", file=path, key="robot @name")
    return root


def _element_key(element: etree._Element) -> str:
    """The place of an element, by the names of the link or joint around it."""
    parts = [
        f"{node.tag} {node.get('name')!r}" if node.get("name") else str(node.tag)
        for node in (element, *element.iterancestors())
        if node.tag != "robot"
    ]
    return " > ".join(reversed(parts))


def _check_numbers(root: etree._Element, path: Path) -> None:
    for element in (part for top in root if top.tag in ("link", "joint") for part in top.iter(etree.Element)):
        for attribute, text in element.items():
            if attribute not in _NUMERIC or (attribute == "value" and element.tag != "mass"):
                continue
            try:
                numbers = [float(word) for word in str(text).split()]
            except ValueError:
                raise _wrong(element, attribute, path, "is not a number") from None
            if not numbers or not all(map(math.isfinite, numbers)):
                raise _wrong(element, attribute, path, "is not a finite number")
            wanted = _COUNTS.get(str(attribute), (1,))
            if len(numbers) not in wanted:
                allowed = " or ".join(map(str, wanted))
                raise _wrong(element, attribute, path, f"has {len(numbers)} numbers", allowed=allowed)
            if attribute in ("radius", "length", "size", "acceleration") and min(numbers) <= 0.0:
                raise _wrong(element, attribute, path, "must be greater than 0")
            if attribute == "scale" and 0.0 in numbers:
                raise _wrong(element, attribute, path, "must not be 0")
            if (attribute in ("effort", "velocity") or element.tag == "mass") and min(numbers) < 0.0:
                raise _wrong(element, attribute, path, "is negative")
            most = _MOST.get(str(attribute), _LARGEST)
            if max(map(abs, numbers)) > most:
                hint = "a joint that turns for ever is continuous" if attribute in ("lower", "upper") else None
                allowed = f"up to {most:g}"
                raise _wrong(element, attribute, path, "is too large", allowed=allowed, hint=hint)
            if 0.0 < numbers[0] < (least := _LEAST.get(str(attribute), 0.0)):
                unknown = "" if attribute == "acceleration" else ", or 0 where nothing is known"
                allowed = f"at least {least:g}{unknown}"
                raise _wrong(element, attribute, path, "is too small", allowed=allowed)


def _wrong(element: etree._Element, attribute: str, path: Path, text: str, **more: str | None) -> RobotError:
    """What is wrong with the value of an attribute."""
    key = f"{_element_key(element)} @{attribute}"
    return RobotError(text, file=path, key=key, found=repr(element.get(attribute)), **more)


_NUMERIC = {
    "xyz", "rpy", "size", "radius", "length", "scale", "value", "lower", "upper", "velocity", "effort",
    "acceleration", "ixx", "ixy", "ixz", "iyy", "iyz", "izz", "damping", "friction", "multiplier", "offset",
}  # fmt: skip
_COUNTS = {"xyz": (3,), "rpy": (3,), "size": (3,), "scale": (1, 3)}  # of numbers; one in any other attribute
# m, rad, or a scale factor: as far as anything in a scene; ranges of 1e16 are used for joints that turn for ever
_MOST = dict.fromkeys(("xyz", "rpy", "size", "radius", "length", "scale"), 1e5) | {"lower": 1e30, "upper": 1e30}
_LARGEST = 1e12  # in any other unit: products of a few such numbers are finite; chosen
# rad/s or m/s, and per second: a motion of 1 rad then takes hours; N m or N; chosen
_LEAST = {"velocity": 1e-4, "acceleration": 1e-4, "effort": 1e-6}
_GEOMETRY = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length"), "mesh": ("filename",)}
# elements that a joint, a shape or an inertia of a link may have only once
_ONCE = ("origin", "geometry", "mass", "inertia", "parent", "child", "axis", "limit", "mimic")
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def _check_complete(root: etree._Element, path: Path) -> None:
    """Check that shapes and inertias have all their parts, and only once; yourdfpy drops others silently."""
    for element in (*root.iterfind("joint"), *root.iterfind("link/*")):
        tags = [child.tag for child in element]
        twice = next((tag for tag in _ONCE if tags.count(tag) > 1), None) if len(set(tags)) < len(tags) else None
        if twice is not None:
            raise RobotError(f"has more than one <{twice}>", file=path, key=_element_key(element))
    for link in root.findall("link"):
        for shape in (*link.findall("collision"), *link.findall("visual")):
            geometry = shape.find("geometry")
            kinds = [] if geometry is None else [child for child in geometry if isinstance(child.tag, str)]
            if len(kinds) != 1 or kinds[0].tag not in _GEOMETRY:
                raise RobotError(
                    "needs one shape in its <geometry>",
                    file=path,
                    key=_element_key(shape),
                    found=", ".join(f"<{kind.tag}>" for kind in kinds) or "none",
                    allowed=", ".join(_GEOMETRY),
                )
            _need(kinds[0], _GEOMETRY[kinds[0].tag], path)
        for inertial in link.findall("inertial"):
            for tag, attributes in (("mass", ("value",)), ("inertia", _INERTIA)):
                element = inertial.find(tag)
                if element is None:
                    raise RobotError(f"has no <{tag}>", file=path, key=_element_key(inertial))
                _need(element, attributes, path)


def _need(element: etree._Element, attributes: tuple[str, ...], path: Path) -> None:
    for attribute in attributes:
        if not element.get(attribute):
            raise RobotError(f"has no {attribute}", file=path, key=_element_key(element))


def _fill_limits(root: etree._Element) -> None:
    """Write 0, which means unknown, for a velocity or effort that a limit does not give; readers need them."""
    for limit in root.findall("joint/limit"):
        for attribute in ("velocity", "effort"):
            if limit.get(attribute) is None:
                limit.set(attribute, "0")


def _read_tree(root: etree._Element, path: Path) -> Tree:
    """Links and joints; yourdfpy checks those of a machine with meshes."""
    for element in root:
        if element.tag not in ("link", "joint"):
            continue
        if not element.get("name"):
            raise RobotError(f"a <{element.tag}> has no name", file=path)
        if element.tag == "joint":
            for child in ("parent", "child"):
                node = element.find(child)
                if node is None or not node.get("link"):
                    raise RobotError(f"has no <{child} link=...>", file=path, key=_element_key(element))
    try:
        if names_a_mesh(root):
            check_by_yourdfpy(root)
        return read_tree(root)
    except ValueError as error:
        raise RobotError(f"cannot be read: {error}", file=path) from error


def _check_tree(robot: Tree, path: Path) -> None:
    links = [link.name for link in robot.links]
    if not links:
        raise RobotError("has no link", file=path)
    for kind, names in (("link", links), ("joint", [joint.name for joint in robot.joints])):
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise RobotError(f"two {kind}s have the same name", file=path, found=", ".join(sorted(twice)))
    children: dict[str, str] = {}
    for joint in robot.joints:
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                key = f"joint {joint.name!r}"
                raise RobotError.unknown_name(f"{end} link does not exist", link, names=links, file=path, key=key)
        if joint.child in children:
            raise RobotError(
                f"link {joint.child!r} hangs on two joints: {children[joint.child]!r} and {joint.name!r}", file=path
            )
        children[joint.child] = joint.name
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        found = f"roots: {', '.join(roots) or 'none (a loop)'}"
        raise RobotError("the links do not form one tree", file=path, found=found)
    try:
        graphlib.TopologicalSorter({joint.child: [joint.parent] for joint in robot.joints}).prepare()
    except graphlib.CycleError as error:
        loop = ", ".join(sorted(set(error.args[1])))
        raise RobotError("joints form a loop", file=path, found=loop) from error


def _check_joint(joint: Joint, path: Path) -> None:
    key = f"joint {joint.name!r}"
    if joint.type not in (*_MOVING, "fixed"):
        problem = _REFUSED.get(str(joint.type), "unknown joint type")
        raise RobotError(problem, file=path, key=key, found=joint.type, allowed="fixed, " + ", ".join(_MOVING))
    if joint.type == "fixed":
        return
    if joint.axis is not None and float(np.linalg.norm(joint.axis)) < 1e-9:
        raise RobotError("the axis has no direction", file=path, key=key, found="0 0 0")
    limit = joint.limit
    if joint.type in ("revolute", "prismatic"):
        if limit is None:
            raise RobotError("has no <limit>", file=path, key=key, allowed="lower, upper, velocity, effort")
        if limit.lower is None or limit.upper is None:
            raise RobotError("the <limit> has no lower and upper", file=path, key=key)
        if limit.lower >= limit.upper:
            found = f"lower {limit.lower}, upper {limit.upper}"
            raise RobotError("lower limit is not below upper", file=path, key=key, found=found)


def _acceleration_limits(root: etree._Element) -> dict[str, float]:
    limits = root.findall("joint/limit[@acceleration]")
    return {limit.getparent().get("name"): float(limit.get("acceleration")) for limit in limits}


def _check_meshes(urdf: Urdf) -> None:
    for link in urdf.robot.links:
        for kind, shapes in (("collision", link.collisions), ("visual", link.visuals)):
            for shape in shapes:
                mesh = None if shape.geometry is None else shape.geometry.mesh
                if mesh is None or urdf.mesh_path(mesh.filename) is not None:
                    continue
                hint = "mesh paths are relative to the URDF"
                if mesh.filename.startswith("package://"):
                    hint = "the package's folder must be above the URDF or in ROS_PACKAGE_PATH"
                key = f"link {link.name!r} > {kind}"
                raise RobotError("mesh file not found", file=urdf.named, key=key, found=mesh.filename, hint=hint)
