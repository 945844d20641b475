"""A machine and its site as a MuJoCo model, from the texts of the URDF and of the scene file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from validation.convex_gaps import is_hollow
from validation.link_pairs import Pairs
from validation.raw_obstacles import Record, read_cloud, turn_of
from validation.raw_urdf import RawMachine, RawShape, read_mesh

DEEP = 1e-4  # m of penetration from which two geoms count as touching
_GROUND = 3.0  # m below the lowest height of a height map
SITE = "site/"


def site_body(name: str) -> str:
    """The name of the MuJoCo body of an obstacle."""
    return SITE + name


@dataclass
class ModelDraft:
    """The specification of a model as it grows.

    Attributes
    ----------
    hollow: names of the geoms whose mesh is smaller than the hull that MuJoCo takes.
    """

    machine: RawMachine
    joints: Sequence[str]
    spec: Any = field(default_factory=mujoco.MjSpec)
    hollow: list[str] = field(default_factory=list)
    geoms: int = 0

    def __post_init__(self) -> None:
        self.spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
        # a machine's base must not be welded to the world, or its links would never be checked against it
        bodies = {self.machine.root: self.spec.worldbody.add_body(name=self.machine.root, mocap=True)}
        for joint in self.machine.joints:
            rotation, translation = joint.rotation, joint.translation
            driven = joint.name in self.joints
            if joint.kind != "fixed" and not driven:
                turn, slide = joint.motion(np.array([joint.rest]))
                rotation, translation = rotation @ turn[0], translation + rotation @ slide[0]
            body = bodies[joint.parent].add_body(name=joint.child, pos=translation, quat=_quaternion(rotation))
            bodies[joint.child] = body
            if driven:
                slides = joint.kind == "prismatic"
                kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
                body.add_joint(name=joint.name, type=kind, axis=joint.axis)
                body.explicitinertial, body.mass, body.inertia = True, 1.0, np.ones(3)
        for link, shapes in self.machine.shapes.items():
            for shape in shapes:
                self._link_geom(bodies[link], shape)

    def exclude(self, pairs: Pairs) -> None:
        """Exclude the links that touch by construction, at all positions of the joints between them."""
        for one, other in pairs.touching | pairs.touching_afar:
            self.spec.add_exclude(bodyname1=one, bodyname2=other)

    def obstacle(self, record: Record, folder: Path) -> None:
        """Add an obstacle as a body that can be moved."""
        body = self.spec.worldbody.add_body(name=site_body(record["name"]), mocap=True)
        shape, kinds = record["shape"], mujoco.mjtGeom
        place = {"pos": np.array(record.get("position", (0.0, 0.0, 0.0))), "quat": _quaternion(turn_of(record))}
        if shape == "sphere":
            self._geom(body, kinds.mjGEOM_SPHERE, [record["radius"], 0, 0], **place)
        elif shape == "box":
            self._geom(body, kinds.mjGEOM_BOX, 0.5 * np.array(record["size"]), **place)
        elif shape == "cylinder":
            self._geom(body, kinds.mjGEOM_CYLINDER, [record["radius"], 0.5 * record["length"], 0], **place)
        elif shape == "capsule":
            ends = np.array([record["from"], record["to"]], dtype=float)
            if np.linalg.norm(ends[1] - ends[0]) < 1e-9:
                self._geom(body, kinds.mjGEOM_SPHERE, [record["radius"], 0, 0], pos=ends[0])
            else:
                self._geom(body, kinds.mjGEOM_CAPSULE, [record["radius"], 0, 0], fromto=ends.ravel())
        elif shape == "halfspace":
            turn = _quaternion(_upright(np.array(record["normal"], dtype=float)))
            self._geom(body, kinds.mjGEOM_PLANE, [0, 0, 1], pos=np.array(record["point"]), quat=turn)
        elif shape == "mesh":
            mesh = read_mesh(folder / record["file"])
            vertices = np.asarray(mesh.vertices) * np.array(record.get("scale", 1.0))
            self._mesh(body, vertices, np.asarray(mesh.faces), **place)
        elif shape == "heightmap":
            self._ground(body, record, folder, place)
        elif shape == "pointcloud":
            edge = float(record["resolution"])
            turn_back, shift = turn_of(record), np.array(place["pos"])
            for corner in np.unique(np.floor(read_cloud(folder / record["file"]) / edge), axis=0):
                middle = turn_back @ ((corner + 0.5) * edge) + shift
                self._geom(body, kinds.mjGEOM_BOX, np.full(3, 0.5 * edge), pos=middle, quat=place["quat"])
        else:
            raise NotImplementedError(shape)

    def _link_geom(self, body: Any, shape: RawShape) -> None:
        place = {"pos": shape.translation, "quat": _quaternion(shape.rotation)}
        kinds = mujoco.mjtGeom
        if shape.kind == "mesh":
            self._mesh(body, shape.vertices, shape.faces, **place)
        elif shape.kind == "box":
            self._geom(body, kinds.mjGEOM_BOX, 0.5 * np.array(shape.size), **place)
        elif shape.kind == "cylinder":
            self._geom(body, kinds.mjGEOM_CYLINDER, [shape.size[0], 0.5 * shape.size[1], 0.0], **place)
        else:
            self._geom(body, kinds.mjGEOM_SPHERE, [shape.size[0], 0.0, 0.0], **place)

    def _geom(self, body: Any, kind: Any, size: Any, **place: Any) -> str:
        self.geoms += 1
        name = f"geom {self.geoms}"
        # the machine is checked against itself and the site, the site not against itself
        of_site = body.name.startswith(SITE)
        affinity = {"contype": 2, "conaffinity": 0} if of_site else {"contype": 1, "conaffinity": 3}
        body.add_geom(name=name, type=kind, size=np.array(size, dtype=float), mass=1.0, **affinity, **place)
        return name

    def _mesh(self, body: Any, vertices: Matrix, faces: Matrix, **place: Any) -> None:
        if closes := is_hollow(vertices, faces):
            vertices, faces = _thick(vertices, faces)
        name = f"mesh {self.geoms}"
        self.spec.add_mesh(
            name=name,
            uservert=np.ravel(vertices),
            userface=np.ravel(faces).astype(np.int32),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        geom = self._geom(body, mujoco.mjtGeom.mjGEOM_MESH, [0, 0, 0], meshname=name, **place)
        if closes:
            self.hollow.append(geom)

    def _ground(self, body: Any, record: Record, folder: Path, place: dict[str, Any]) -> None:
        heights = np.loadtxt(folder / record["file"], delimiter=",", ndmin=2)
        low, rise = float(heights.min()), max(float(np.ptp(heights)), 1e-6)
        name = f"ground {self.geoms}"
        size = [0.5 * record["size"][0], 0.5 * record["size"][1], rise, _GROUND]
        rows, columns = heights.shape
        scaled = ((heights - low) / rise).astype(np.float32).ravel()
        self.spec.add_hfield(name=name, size=size, nrow=rows, ncol=columns, userdata=scaled)
        above = turn_of(record) @ np.array([0.0, 0.0, low])
        self._geom(
            body, mujoco.mjtGeom.mjGEOM_HFIELD, [0, 0, 0], hfieldname=name, pos=place["pos"] + above, quat=place["quat"]
        )


def _thick(vertices: Matrix, faces: Matrix) -> tuple[Matrix, Matrix]:
    """The same mesh; a flat one as two copies on its sides, since MuJoCo has no flat meshes."""
    across = np.linalg.svd(vertices - vertices.mean(axis=0))[2][2]
    if float(np.ptp(vertices @ across)) > DEEP:
        return vertices, faces
    step = 0.45 * DEEP * across
    return np.vstack((vertices + step, vertices - step)), np.vstack((faces, faces[:, ::-1] + len(vertices)))


def _quaternion(rotation: Matrix) -> Vector:
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, np.ravel(rotation))
    return found


def _upright(normal: Vector) -> Matrix:
    """(3, 3) a rotation whose z axis is along `normal` (3,)."""
    found = np.zeros(4)
    mujoco.mju_quatZ2Vec(found, normal / np.linalg.norm(normal))
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, found)
    return flat.reshape(3, 3)
