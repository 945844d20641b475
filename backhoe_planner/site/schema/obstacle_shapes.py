"""The shapes of obstacles: the keys of each in the scene file, and the convex pieces that contain it.

A new shape is one more class here, with its keys and its `pieces`, and one more name in
`ObstacleSpec`. The schema, messages, distances, proofs and pictures follow from these;
docs/architecture.md says what else names all shapes.
"""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, get_args

import numpy as np
import pinocchio as pin
from pydantic import Field, field_validator, model_validator

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.files.meshes.mesh_axes import Axis, mesh_axes, upright
from backhoe_planner.files.records import Record
from backhoe_planner.machine import (
    Cluster,
    MeshSolid,
    TerrainSolid,
    VoxelSolid,
    hull_if_nearly_convex,
    is_closed,
    load_mesh,
    mesh_cover,
    terrain_columns,
    voxel_boxes,
    voxel_keys,
)
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.schema.names import Name
from backhoe_planner.site.schema.quantities import (
    AnyLength,
    Length,
    MapPoint,
    NonNegative,
    Positive,
    Quaternion,
    RollPitchYaw,
    Vector3,
    direction,
    rotation_matrix,
    unit_quaternion,
)

if TYPE_CHECKING:
    from typing import Self

    import trimesh

_TERRAIN_TOLERANCE = 0.02  # m of roughness that may be filled up; chosen, about what a bucket's teeth leave behind
_TERRAIN_DEPTH = 50.0  # m below the lowest point: no machine digs so deep
_FEW_BOXES = 32  # of a scan, measured one by one; chosen, about where one tree begins to take less time
_FEW_CELLS = 100  # of a terrain, built as columns; chosen
_FEW_TRIANGLES = 2_000  # of a mesh, covered by a few hulls; chosen
_MOST_CELLS = 4_000_000  # of a terrain
MOST_VOXELS = 4_000_000  # of a scan: some 300 MB
_MOST_TRIANGLES = 500_000  # of a mesh: some 300 MB
_MOST_PIECES = 20_000  # of one obstacle that moves; chosen: with the 20 pieces of a machine that is 400,000 pairs
_FLATTEST = 1e-5  # of the radius: no hull can be built of a flatter prism
_UPRIGHT = 0.5  # cosine of the tilt from which an orientation lays a thing on its side; chosen
_ONE_POINT = 1e-9  # m: a shorter axis has no direction


class ObstacleRecord(Record):
    """The keys that every obstacle has."""

    is_land: ClassVar[bool] = False
    """Whether it is the site itself, unbounded or surveyed: nothing carries it, and nobody moves it by hand."""
    points: ClassVar[tuple[str, ...]]
    """The fields that say where it is [m]: with these it moves."""

    name: Name
    """Unique; appears in reports and in the viewer."""
    clearance: NonNegative | None = None
    """Distance to be kept [m]; the scene's clearance by default."""
    links: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """The only links for which it is an obstacle; all of them by default."""
    legs: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """The only legs of the sequence in which it is present, by name; all of them by default."""
    appears_at: NonNegative = 0.0
    """Time at which the obstacle appears; before that it is unknown [s]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Velocity of the obstacle from its appearance on [m/s], world."""

    @abstractmethod
    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """Convex pieces, in world axes at the time of appearance, that contain all of the obstacle.

        Parameters
        ----------
        folder: the folder to which file names in the record are relative.

        Raises
        ------
        InputError: a file is missing, empty or malformed, or needs more than 20,000 pieces.
        """

    def body(self, folder: Path) -> list[shapes.Piece] | Cluster:
        """The pieces, or one cluster if there would be more than a few and the obstacle does not move."""
        return self.pieces(folder)

    def moved(self, shift: Vector) -> Self:
        """The same obstacle, moved by `shift` (3,) [m]."""
        if not shift.any():
            return self
        return self.model_copy(update={key: tuple((getattr(self, key) + shift).tolist()) for key in self.points})


class PlacedRecord(ObstacleRecord):
    """An obstacle with a position and an orientation."""

    points = ("position",)

    position: Vector3 = (0.0, 0.0, 0.0)
    """Position of the shape's centre or, for a file, of its origin [m]."""
    rpy: RollPitchYaw | None = None
    """Roll, pitch, yaw about the fixed axes [rad]."""
    quaternion: Quaternion | None = None
    """[w, x, y, z]."""

    _check_quaternion = field_validator("quaternion")(unit_quaternion)

    @model_validator(mode="after")
    def _one_orientation(self) -> PlacedRecord:
        if self.rpy is not None and self.quaternion is not None:
            raise ValueError("only one of rpy, quaternion may be given")
        return self

    @property
    def placement(self) -> pin.SE3:
        """T_world_shape."""
        rotation = rotation_matrix(self.rpy, self.quaternion)
        return pin.SE3(np.eye(3) if rotation is None else rotation, np.array(self.position))


class Sphere(PlacedRecord):
    """A sphere."""

    shape: Literal["sphere"]
    radius: Length
    """[m]"""

    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """The sphere."""
        return [shapes.sphere(self.radius, self.placement)]


class Box(PlacedRecord):
    """A box."""

    shape: Literal["box"]
    size: tuple[Length, Length, Length]
    """Edge lengths along x, y, z [m]."""

    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """The box."""
        return [shapes.box(np.array(self.size), self.placement)]


class Cylinder(PlacedRecord):
    """A cylinder along its z axis."""

    shape: Literal["cylinder"]
    radius: Length
    """[m]"""
    length: Length
    """[m]; between 1e-5 and 1e5 times the radius."""

    @model_validator(mode="after")
    def _some_body(self) -> Cylinder:
        if not _FLATTEST <= self.length / self.radius <= 1.0 / _FLATTEST:
            raise ValueError(
                f"a cylinder's length is {_FLATTEST:g} to {1.0 / _FLATTEST:g} times its radius, "
                f"here {self.length:g} m and {self.radius:g} m ({self.length / self.radius:.3g} times)"
            )
        return self

    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """The prism around it."""
        return [shapes.cylinder(self.radius, self.length, self.placement)]


class Capsule(ObstacleRecord):
    """All points within `radius` of the segment from `from` to `to`."""

    points = ("start", "end")

    shape: Literal["capsule"]
    start: Vector3 = Field(alias="from")
    """One end of the axis [m]."""
    end: Vector3 = Field(alias="to")
    """The other end [m]."""
    radius: Length
    """[m]"""

    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """The capsule; a sphere if both ends are the same point."""
        start, end = np.array(self.start), np.array(self.end)
        length = float(np.linalg.norm(end - start))
        middle = 0.5 * (start + end)
        if length < _ONE_POINT:
            return [shapes.sphere(self.radius, pin.SE3(np.eye(3), middle))]
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (end - start) / length)
        return [shapes.capsule(self.radius, length, pin.SE3(turn.toRotationMatrix(), middle))]


class HalfSpace(ObstacleRecord):
    """Everything behind a plane: solid where (x - point) . normal < 0."""

    is_land = True
    points = ("point",)

    shape: Literal["halfspace"]
    point: Vector3
    """A point on the plane [m]."""
    normal: tuple[AnyLength, AnyLength, AnyLength]
    """Normal of the plane, away from the solid; any length but 0."""

    _unit = field_validator("normal")(direction)

    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """The half-space."""
        return [shapes.halfspace(np.array(self.point), np.array(self.normal))]


class Mesh(PlacedRecord):
    """A triangle mesh from a file, taken as solid."""

    shape: Literal["mesh"]
    file: str
    """STL, OBJ, PLY, ...; relative to the scene file."""
    scale: Positive | tuple[Positive, Positive, Positive] | None = None
    """Scale from the file's units to metres; by default the unit that a DAE or 3MF states, otherwise 1."""
    up: Axis | None = None
    """The axis of the file's coordinates that is up; by default y for glTF, otherwise z."""
    map_origin: MapPoint = (0.0, 0.0, 0.0)
    """The point of the file's coordinates that is put at `position`, in the file's units; subtracted before scaling."""

    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """Hulls that cover every triangle of the mesh."""
        scale, turn = self.frame(folder)
        cover = mesh_cover(folder / self.file, scale)
        self._check_near(np.vstack(cover.pieces) / scale, folder)
        offset = scale * np.array(self.map_origin)
        return [shapes.convex((points - offset) @ turn.T, self.placement) for points in cover.pieces]

    def body(self, folder: Path) -> list[shapes.Piece] | Cluster:
        """Hulls, or the triangles if the mesh is fine and hollowed and does not move."""
        if any(self.velocity):
            return self.pieces(folder)
        mesh = self.loaded(folder)
        if len(mesh.faces) <= _FEW_TRIANGLES:
            return self.pieces(folder)
        around = hull_if_nearly_convex(mesh)
        if around is not None:
            return [shapes.convex(around.points[around.vertices], self.placement, around=around)]
        return Cluster(MeshSolid(mesh, most=_MOST_TRIANGLES), self.placement)

    def is_open(self, folder: Path) -> bool:
        """Whether the mesh is not closed, so that the space between its triangles may be free.

        Raises
        ------
        InputError: the file cannot be read.
        """
        mesh = self.loaded(folder)
        return not is_closed(mesh) and hull_if_nearly_convex(mesh) is None

    def frame(self, folder: Path) -> tuple[Vector, Matrix]:
        """(3,) the factors along the axes of the file [m], and (3, 3) the rotation that turns it upright after that.

        Raises
        ------
        InputError: the file is missing, or states a unit that is none.
        """
        axes = mesh_axes(folder / self.file)
        scale = axes.unit if self.scale is None else self.scale
        return np.full(3, scale, dtype=float), upright(self.up or axes.up)

    def doubt(self, folder: Path) -> str | None:
        """In words, why another axis of the file may be up, and the key that says so; None if there is no doubt.

        Raises
        ------
        InputError: as `frame`.
        """
        axes = mesh_axes(folder / self.file)
        if self.up is not None:
            return None
        if axes.up != "z" and self.placement.rotation[2, 2] < _UPRIGHT:
            return f"has {axes.up} up and is turned so that z is up, and its rpy or quaternion turns it again: `up: z`"
        return axes.doubt

    def loaded(self, folder: Path) -> trimesh.Trimesh:
        """The mesh [m], upright, with its `map_origin` at the origin.

        Raises
        ------
        InputError: the file cannot be read, or the mesh lies too far away.
        """
        mesh = load_mesh(folder / self.file)
        self._check_near(np.asarray(mesh.vertices), folder)
        scale, turn = self.frame(folder)
        T_mesh_file = np.eye(4)
        T_mesh_file[:3, :3] = turn * scale
        mesh.apply_translation(-np.array(self.map_origin))
        mesh.apply_transform(T_mesh_file)
        return mesh

    def _check_near(self, vertices: Matrix, folder: Path) -> None:
        from backhoe_planner.site.surveys.survey_files import check_near

        scale, turn = self.frame(folder)
        check_near(vertices, folder / self.file, map_origin=self.map_origin, scale=scale, turn=turn, what="vertex")


class HeightMap(PlacedRecord):
    """Ground given by heights on a grid; solid below."""

    is_land = True

    shape: Literal["heightmap"]
    file: str
    """CSV of heights [m] without header; rows along y, columns along x, both ascending; or a GeoTIFF."""
    size: tuple[Length, Length]
    """Distance from the first to the last height along x and y [m], centred on `position`."""

    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """Columns under the ground."""
        return self._columns(self._heights(folder))

    def body(self, folder: Path) -> list[shapes.Piece] | Cluster:
        """Columns, or the ground cell by cell if there are many cells and it does not move."""
        heights = self._heights(folder)
        if (heights.shape[0] - 1) * (heights.shape[1] - 1) <= _FEW_CELLS or any(self.velocity):
            return self._columns(heights)
        return terrain_body(heights, self.size, self.placement)

    def _heights(self, folder: Path) -> Matrix:
        from backhoe_planner.site.surveys.survey_files import read_heights

        return read_heights(folder / self.file, size=self.size)

    def _columns(self, heights: Matrix) -> list[shapes.Piece]:
        columns = terrain_columns(
            heights, self.size, tolerance=_TERRAIN_TOLERANCE, depth=_TERRAIN_DEPTH, most=_MOST_PIECES
        )
        return [shapes.convex(points, self.placement) for points in columns]


class PointCloud(PlacedRecord):
    """Points from a scan; every voxel that contains one is solid."""

    is_land = True

    shape: Literal["pointcloud"]
    file: str
    """PLY, PCD, LAS, LAZ, E57, or CSV or XYZ with x, y, z in the columns that its header names, otherwise in the first
    three."""
    resolution: Length
    """Edge of a voxel [m]."""
    map_origin: MapPoint = (0.0, 0.0, 0.0)
    """The point of the file's coordinates that is put at `position`, such as the machine's place in map coordinates."""

    def pieces(self, folder: Path) -> list[shapes.Piece]:
        """Boxes that fill the voxels that contain a point."""
        return self._boxes(self._points(folder))

    def body(self, folder: Path) -> list[shapes.Piece] | Cluster:
        """A few boxes, or the voxels of a scan that does not move."""
        points = self._points(folder)
        return self._boxes(points) if any(self.velocity) else scan_body(points, self.resolution, self.placement)

    def _points(self, folder: Path) -> Matrix:
        from backhoe_planner.site.surveys.survey_files import read_points

        return read_points(folder / self.file, map_origin=self.map_origin)

    def _boxes(self, points: Matrix) -> list[shapes.Piece]:
        boxes = voxel_boxes(points, self.resolution, most=_MOST_PIECES)
        return [shapes.box(size, self.placement * pin.SE3(np.eye(3), centre)) for centre, size in boxes]


def terrain_body(heights: Matrix, size: tuple[float, float], placement: pin.SE3) -> Cluster:
    """The ground under `heights` (rows, columns) [m] over a rectangle of `size` [m] around `placement`.

    Raises
    ------
    InputError: there are too many cells.
    """
    return Cluster(TerrainSolid(heights, size, depth=_TERRAIN_DEPTH, most=_MOST_CELLS), placement)


def scan_body(points: Matrix, resolution: float, placement: pin.SE3) -> list[shapes.Piece] | Cluster:
    """The voxels with an edge of `resolution` [m] that contain `points` (n, 3) [m]: a few boxes, or a cluster.

    Raises
    ------
    InputError: there are too many voxels.
    """
    keys = voxel_keys(points, resolution)
    if len(keys) <= _FEW_BOXES**2:
        boxes = voxel_boxes(keys.astype(float) + 0.5, 1.0)
        if len(boxes) <= _FEW_BOXES:
            return [
                shapes.box(resolution * size, placement * pin.SE3(np.eye(3), resolution * centre))
                for centre, size in boxes
            ]
    return Cluster(VoxelSolid(keys, resolution, most=MOST_VOXELS), placement)


ObstacleSpec = Annotated[
    Sphere | Box | Cylinder | Capsule | HalfSpace | Mesh | HeightMap | PointCloud, Field(discriminator="shape")
]


def shape_records() -> dict[str, type[ObstacleRecord]]:
    """The record of every shape, by its name in the scene file."""
    records: tuple[type[ObstacleRecord], ...] = get_args(get_args(ObstacleSpec)[0])
    return {get_args(record.model_fields["shape"].annotation)[0]: record for record in records}
