"""Random machines, written as URDF text with their meshes: odd axes, offsets, branches, fixed extras.

They are valid but not sensible on purpose: one to seven joints, links of several shapes, a cab
fixed to the base, tools fixed to the last link, brackets and arms that do not move.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from backhoe_planner.arrays import Matrix, Vector
from validation.raw_urdf import rotation_of

_KINDS = ("revolute", "continuous", "prismatic")
_RATE = 2.0  # rad/s or m/s of every joint


def write_random_machine(rng: np.random.Generator, folder: Path) -> Path:
    """Write a machine into a folder and return the file of its URDF. Its tip is the link ``tip``."""
    draft = _Draft(rng, folder)
    joints = int(rng.integers(1, 8))
    draft.link("base", draft.base_shapes())
    parent, ahead = "base", rng.normal([0.0, 0.0, 0.3], 0.2)
    for number in range(1, joints + 1):
        name = f"link{number}"
        kind = str(rng.choice(_KINDS, p=[0.6, 0.2, 0.2]))
        reach = rng.normal(0.0, 0.12, 3)
        reach[int(rng.integers(3))] += float(rng.choice([-1.0, 1.0])) * rng.uniform(0.25, 1.0)
        draft.link(name, draft.link_shapes(reach) if rng.random() > 0.07 else [])
        draft.joint(f"joint{number}", kind, parent, name, ahead)
        draft.extras(name, reach)
        parent, ahead = name, reach
    draft.link("tip", [])
    draft.joint("to_tip", "fixed", parent, "tip", ahead)
    if rng.random() < 0.6:
        draft.hang("cab", "base", draft.beside(0.9))
    if rng.random() < 0.6:
        draft.hang("tool", parent, ahead * rng.uniform(0.2, 1.1))
        if rng.random() < 0.5:
            draft.hang("tooth", "tool", draft.beside(0.3))
    return draft.write()


@dataclass
class _Draft:
    """The elements of a URDF while they are drawn."""

    rng: np.random.Generator
    folder: Path
    elements: list[str] = field(default_factory=list)
    meshes: int = 0

    def link(self, name: str, shapes: list[str]) -> None:
        """A link with its collision shapes."""
        inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        inner = "".join(f"<collision>{shape}</collision>" for shape in shapes)
        self.elements.append(f'<link name="{name}"><inertial><mass value="1"/>{inertia}</inertial>{inner}</link>')

    def joint(self, name: str, kind: str, parent: str, child: str, place: Vector) -> None:
        """A joint at `place` (3,) in its parent, with random orientation."""
        rng = self.rng
        axis = np.zeros(3)
        axis[int(rng.integers(3))] = rng.choice([-1.0, 2.0])
        if rng.random() < 0.5:
            axis[:] = rng.normal(size=3)
        turn = np.asarray(np.pi / 2.0 * rng.integers(-1, 3, 3), dtype=np.float64)
        if rng.random() < 0.4:
            turn = rng.uniform(-np.pi, np.pi, 3)
        limit = f'velocity="{_RATE}" effort="1e9"'
        if kind in ("revolute", "prismatic"):
            low, high = (-2.8, 2.8) if kind == "revolute" else (-0.5, 0.6)
            low, high = low * rng.uniform(0.0, 1.0), high * rng.uniform(0.1, 1.0)
            shift = float(rng.choice([0.0, 0.0, 1.0])) * (high - low) * rng.uniform(-0.7, 0.7)
            limit += f' lower="{low + shift:.6f}" upper="{high + shift:.6f}"'
        inner = "" if kind == "fixed" else f'<axis xyz="{_text(axis)}"/><limit {limit}/>'
        self.elements.append(
            f'<joint name="{name}" type="{kind}">{_origin(place, turn)}'
            f'<parent link="{parent}"/><child link="{child}"/>{inner}</joint>'
        )

    def extras(self, name: str, reach: Vector) -> None:
        """A bracket fixed to a link, or an arm outside the chain that does not move."""
        rng = self.rng
        if rng.random() < 0.2:
            self.hang(f"{name}_bracket", name, reach * rng.uniform(0.0, 1.0) + rng.normal(0.0, 0.1, 3))
        if rng.random() < 0.1:
            kind = str(rng.choice(_KINDS))
            self.link(f"{name}_branch", self.link_shapes(rng.normal(0.0, 0.2, 3)))
            self.joint(f"{name}_beside", kind, name, f"{name}_branch", reach * rng.uniform(0.0, 1.0))

    def hang(self, name: str, parent: str, place: Vector) -> None:
        """A link of one or two shapes, fixed to another."""
        self.link(name, [self.lump() for _ in range(int(self.rng.integers(1, 3)))])
        self.joint(f"{name}_fixed", "fixed", parent, name, place)

    def beside(self, far: float) -> Vector:
        """(3,) a place at up to about `far`."""
        direction = self.rng.normal(size=3)
        return np.asarray(direction / np.linalg.norm(direction) * far * self.rng.uniform(0.4, 1.0))

    def base_shapes(self) -> list[str]:
        """A block or a drum below the first joint, or nothing."""
        size = self.rng.uniform(0.1, 0.4, 3)
        return [self.shape(size, np.array([0.0, 0.0, -0.1]), np.zeros(3))] if self.rng.random() < 0.8 else []

    def link_shapes(self, reach: Vector) -> list[str]:
        """A beam from the joint to the next one, and up to two lumps on it."""
        rng = self.rng
        length = float(np.linalg.norm(reach))
        wide = rng.uniform(0.03, 0.15, 2)
        overlap = rng.uniform(-0.3, 0.1) if rng.random() < 0.25 else 0.05
        size = np.array([wide[0], wide[1], max(length + overlap, 0.05)])
        beam = self.shape(size, 0.5 * reach, _along(reach, float(rng.uniform(-3.0, 3.0))))
        return [beam, *(self.lump(reach * rng.uniform(0.0, 1.0)) for _ in range(int(rng.integers(0, 3))))]

    def lump(self, place: Vector | None = None) -> str:
        """A random shape with random orientation at a place."""
        rng = self.rng
        middle = (np.zeros(3) if place is None else place) + rng.normal(0.0, 0.05, 3)
        return self.shape(rng.uniform(0.04, 0.35, 3), middle, rng.uniform(-np.pi, np.pi, 3))

    def shape(self, size: Vector, place: Vector, rpy: Vector) -> str:
        """A box, cylinder, sphere or mesh of about a size (3,), as the content of a collision element."""
        kind = int(self.rng.choice(4, p=[0.35, 0.3, 0.1, 0.25]))
        if kind == 0:
            inner = f'<box size="{_text(size)}"/>'
        elif kind == 1:
            inner = f'<cylinder radius="{0.5 * size[0]:.6f}" length="{size[2]:.6f}"/>'
        elif kind == 2:
            inner = f'<sphere radius="{0.5 * min(size[2], 0.3):.6f}"/>'
        else:
            inner = self._mesh(size)
        return f"{_origin(place, rpy)}<geometry>{inner}</geometry>"

    def _mesh(self, size: Vector) -> str:
        rng = self.rng
        unit = random_mesh(rng)
        scale = np.ones(3) * rng.choice([1.0, 0.001, 2.0])
        if rng.random() < 0.6:
            scale = scale * rng.uniform(0.5, 2.0, 3)
        if rng.random() < 0.15:
            scale[int(rng.integers(3))] *= -1.0
        unit.vertices = unit.vertices * size / np.abs(scale)
        self.meshes += 1
        name = f"part{self.meshes}.{rng.choice(['stl', 'obj'])}"
        unit.export(self.folder / name)
        return f'<mesh filename="{name}" scale="{_text(scale)}"/>'

    def write(self) -> Path:
        """Write the URDF and return its file."""
        file = self.folder / "machine.urdf"
        file.write_text('<robot name="random">\n' + "\n".join(self.elements) + "\n</robot>\n")
        return file


def random_mesh(rng: np.random.Generator, *, hollow: float = 0.4) -> trimesh.Trimesh:
    """A mesh of few triangles in the unit cube: a boulder, prism or tilted plate; or hollow, a channel or an L."""
    solid = (1.0 - hollow) / 3.0
    kind = int(rng.choice(5, p=[solid, solid, 0.5 * hollow, 0.5 * hollow, solid]))
    if kind == 0:
        hull = trimesh.convex.convex_hull(rng.uniform(-0.5, 0.5, (10, 3)))
        return trimesh.Trimesh(np.array(hull.vertices), np.array(hull.faces))
    if kind == 1:
        return trimesh.creation.cylinder(0.5, 1.0, sections=int(rng.integers(3, 8)))
    if kind == 2:
        return _blocks([[1.0, 1.0, 0.2], [0.2, 1.0, 1.0], [0.2, 1.0, 1.0]], [[0, 0, -0.4], [-0.4, 0, 0], [0.4, 0, 0]])
    if kind == 3:
        return _blocks([[1.0, 0.3, 0.3], [0.3, 0.3, 1.0]], [[0, 0, -0.35], [-0.35, 0, 0]])
    corners = np.array([[-0.5, -0.5, -0.2], [0.5, -0.5, 0.1], [0.5, 0.5, 0.2], [-0.5, 0.5, -0.1]])
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])


def _blocks(sizes: list[list[float]], places: list[list[float]]) -> trimesh.Trimesh:
    boxes = [trimesh.creation.box(extents=size) for size in sizes]
    for box, place in zip(boxes, places, strict=True):
        box.apply_translation(place)
    return trimesh.util.concatenate(boxes)


def _along(direction: Vector, roll: float) -> Vector:
    """(3,) roll, pitch, yaw of a frame whose z axis has a direction, turned about it by `roll` [rad]."""
    x, y, z = direction / np.linalg.norm(direction)
    tilted: Matrix = rotation_of(np.array([0.0, np.arccos(z), np.arctan2(y, x)])) @ rotation_of(np.array([0, 0, roll]))
    return np.array(
        [
            np.arctan2(tilted[2, 1], tilted[2, 2]),
            -np.arcsin(np.clip(tilted[2, 0], -1.0, 1.0)),
            np.arctan2(tilted[1, 0], tilted[0, 0]),
        ]
    )


def _origin(place: Vector, rpy: Vector) -> str:
    return f'<origin xyz="{_text(place)}" rpy="{_text(rpy)}"/>'


def _text(values: Vector) -> str:
    return " ".join(f"{float(value):.8g}" for value in values)
