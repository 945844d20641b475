"""Solids as sets of convex pieces that contain every point of the solid.

Distances between convex pieces are exact and cheap. A plain convex hull would close a
bucket's cavity, and a plain convex decomposition may cut off a corner. So `convex_cover`
takes a decomposition (by V-HACD) and grows its pieces until every triangle of the mesh lies
inside one of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.found_file import is_file
from backhoe_planner.files.meshes.mesh_parts import check_all_read
from backhoe_planner.files.meshes.obj_lines import obj_lines, plain_obj
from backhoe_planner.files.meshes.ply_faces import ply_of_triangles
from backhoe_planner.files.meshes.whole_mesh import check_whole
from backhoe_planner.files.numbers import FURTHEST
from backhoe_planner.machine.shape.closed_bodies import find_closed, open_edges
from backhoe_planner.machine.shape.shapes import flatness, hull, is_flat

if TYPE_CHECKING:
    import trimesh
    from scipy.spatial import ConvexHull

Cells = NDArray[np.int64]
Block = tuple[int, int, int, int]
"""A block of a height map: first and last row, first and last column."""

_FORMATS = (".stl", ".obj", ".ply", ".off", ".dae", ".glb", ".gltf", ".3mf")
"""Suffixes of mesh files whose vertices can be checked as they are in the file: trimesh drops triangles at NaN."""

SPLIT_FORMATS = (".gltf",)
"""Those whose mesh may be in other files."""

_RESOLUTION = 60_000  # voxels into which V-HACD divides a mesh: for a cube, 2.5 % of its edge
_CORNERS = 48  # of one piece at most; chosen: the time to measure a distance grows with them
_EXCESS = 1.08  # greatest volume of a hull over that of its mesh; chosen
_HOLLOWS = (1, 2, 4, 8, 16)  # grid steps to either side at which a point is compared; chosen: wider hollows are rare
_SAME_VOLUME = 1.001  # volume of a hull over the mesh's up to which they are the same; STL rounds a mesh by far less
_SAME_PLACE = 8  # decimals in which vertices at the same place agree; as in trimesh, which merges vertices, too


def load_mesh(path: Path) -> trimesh.Trimesh:
    """One triangle mesh from a file (STL, OBJ, PLY, DAE, ...), with all its parts placed as in the file.

    Coordinates are as they stand in the file: `mesh_axes` has its unit and upward axis.

    Raises
    ------
    InputError: the file is missing, empty, of another format, or not a mesh; a coordinate is not finite; a part of it
        would be left out.
    """
    import trimesh

    if not is_file(path):
        raise InputError("no such mesh file", file=path)
    if path.stat().st_size == 0:
        raise InputError("the mesh file is empty", file=path)
    if path.suffix.lower() not in _FORMATS:
        found = repr(path.suffix) if path.suffix else "no suffix"
        raise InputError("is not a mesh that can be read", file=path, found=found, allowed=", ".join(_FORMATS))
    try:
        check_whole(path)
        check_all_read(path)
        with np.errstate(all="ignore"):  # the coordinates are checked below
            scene = _scene(path)
            parts = [part for part in scene.geometry.values() if isinstance(part, trimesh.Trimesh)]
            for part in parts:
                _check_part(part, path)
            if path.suffix.lower() == ".dae":
                _check_collada(path)
            for part in parts:
                part.process()
                part.faces = _welded(part)  # closed bodies stay separate from others that they touch
            mesh = scene.to_mesh()
            if len(scene.graph.nodes_geometry) > 1:
                mesh.faces = _welded(mesh)
    except InputError:
        raise
    except Exception as error:  # trimesh lets through any exception of its format readers
        raise InputError(f"is not a mesh that can be read: {error}", file=path) from error
    if len(mesh.faces) == 0:
        raise InputError("holds no triangles", file=path)
    _check_finite(np.asarray(mesh.vertices, dtype=float).ravel(), path)
    return mesh


def _scene(path: Path) -> trimesh.Scene:
    """The parts of a mesh file, as they are in the file."""
    import trimesh

    kind = path.suffix[1:].lower()
    source = plain_obj(path) if kind == "obj" else ply_of_triangles(path)
    if source is None:
        return trimesh.load_scene(path, process=False)
    beside = trimesh.resolvers.FilePathResolver(str(path))  # for materials
    return trimesh.load_scene(source, file_type=kind, resolver=beside, process=False)


def _welded(mesh: trimesh.Trimesh) -> Cells:
    """Faces (m, 3) of a mesh, with vertices of open edges merged if they are at the same place.

    A file repeats a vertex for each normal, each texture coordinate and each material, so that a closed surface
    is torn there.
    """
    faces = np.asarray(mesh.faces, dtype=np.int64)
    torn = np.unique(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)[open_edges(faces)])
    if not len(torn):
        return faces
    places = np.round(np.asarray(mesh.vertices, dtype=float)[torn], _SAME_PLACE)
    _, first, place = np.unique(places, axis=0, return_index=True, return_inverse=True)
    one_of = np.arange(len(mesh.vertices))
    one_of[torn] = torn[first[place.reshape(-1)]]
    return one_of[faces]


def is_closed(mesh: trimesh.Trimesh) -> bool:
    """Whether the surface of a mesh is closed everywhere; see `find_closed`."""
    return find_closed(np.asarray(mesh.faces, dtype=np.intp))[1]


def _check_part(part: trimesh.Trimesh, path: Path) -> None:
    coordinates = np.asarray(part.vertices, dtype=float).ravel()
    if path.suffix.lower() == ".obj" and not np.isfinite(coordinates).all():  # the OBJ reader renumbers vertices
        vertices = [words[1:4] for _, words in obj_lines(path) if words[0] == b"v"]
        _check_finite(np.array(vertices, dtype=float).ravel(), path)
    _check_finite(coordinates, path)
    if len(part.faces) and int(np.min(part.faces)) < 0:
        found = f"{int(np.min(part.faces))}"
        raise InputError("a face has a vertex that is not there", file=path, found=found, allowed="numbers from 0")


def _check_finite(coordinates: Vector, path: Path) -> None:
    """Raise an InputError that names the first of a file's `coordinates` (3 n,) that is not finite, if there is one."""
    wrong = np.flatnonzero(~np.isfinite(coordinates))
    if len(wrong):
        vertex, coordinate = divmod(int(wrong[0]), 3)
        raise InputError(
            "a coordinate is not finite",
            file=path,
            key=f"vertex {vertex + 1}, coordinate {coordinate + 1}",
            found=f"{coordinates[wrong[0]]:g}",
            allowed="a finite number",
        )


def _check_collada(path: Path) -> None:
    """Check the positions in a COLLADA file: pycollada reads NaN as 0, and trimesh drops triangles at infinity."""
    root = etree.parse(path, etree.XMLParser(resolve_entities=False, huge_tree=True)).getroot()
    inputs = (element for element in root.iter("{*}input") if element.get("semantic") == "POSITION")
    positions = {str(element.get("source", "")).removeprefix("#") for element in inputs}
    for source in root.iter("{*}source"):
        array = source.find("{*}float_array")
        if source.get("id") in positions and array is not None:
            _check_finite(np.array((array.text or "").split(), dtype=float), path)


def convex_cover(
    mesh: trimesh.Trimesh, *, pieces: int = 16, excess: float = _EXCESS
) -> list[tuple[Matrix, Matrix | None]]:
    """Convex pieces whose union contains every triangle of `mesh`.

    Parameters
    ----------
    mesh: any triangle mesh, closed or not [m].
    pieces: the greatest number of pieces in the decomposition.
    excess: a mesh whose convex hull has at most `excess` times its volume becomes one piece, its hull.

    Returns
    -------
    For each piece its corners (k, 3), and those triangles (m, 3, 3) of the mesh that it was grown over, in the frame
    of the mesh [m]. Every triangle belongs to one piece. The triangles are None if the piece is the mesh. A flat mesh
    becomes one piece that is a little thicker.

    Raises
    ------
    InputError: the mesh extends further than 1e7 m from its origin.
    """
    vertices = np.asarray(mesh.vertices, dtype=float)
    faces = np.asarray(mesh.faces)
    points, around, volume = _extent(mesh)
    if is_flat(points) or around.volume <= excess * volume:
        is_mesh = mesh.is_watertight and around.volume <= _SAME_VOLUME * volume
        return [(around.points[around.vertices], None if is_mesh else vertices[faces])]
    from vhacdx import compute_vhacd

    padded = np.column_stack((np.full(len(faces), 3), faces)).ravel().astype(np.uint32)
    parts = compute_vhacd(
        vertices, padded, maxConvexHulls=pieces, resolution=_RESOLUTION, asyncACD=False, maxNumVerticesPerCH=_CORNERS
    )
    hulls = [hull(np.asarray(points, dtype=float)) for points, _ in parts] or [around]
    return _grown_over_triangles(hulls, vertices[faces])


def hull_if_nearly_convex(mesh: trimesh.Trimesh) -> ConvexHull | None:
    """The convex hull of a mesh that is flat, or for which `convex_cover` takes the hull alone; otherwise None.

    Raises
    ------
    InputError: see `convex_cover`.
    """
    points, around, volume = _extent(mesh)
    return around if is_flat(points) or around.volume <= _EXCESS * volume else None


def _extent(mesh: trimesh.Trimesh) -> tuple[Matrix, ConvexHull, float]:
    """(k, 3) vertices used by triangles [m], their hull, and the volume that the triangles enclose [m^3]."""
    points = np.asarray(mesh.vertices, dtype=float)[np.unique(mesh.faces)]
    furthest = float(np.max(np.abs(points)))
    if furthest > FURTHEST:
        raise InputError(
            "the mesh is too large",
            found=f"a vertex {furthest:.4g} m from the origin",
            allowed=f"up to {FURTHEST:.0e} m",
            hint="its scale takes the units of the file to metres",
        )
    with np.errstate(all="ignore"):  # trimesh divides by the volume for the centre of mass, even if it is 0
        return points, hull(points), abs(float(mesh.volume))


def _grown_over_triangles(hulls: list[ConvexHull], triangles: Matrix) -> list[tuple[Matrix, Matrix | None]]:
    """Corners (k, 3) of each hull, grown over those `triangles` (m, 3, 3) that stick out of it least; and these."""
    outside = np.stack(
        [np.max(triangles @ part.equations[:, :3].T + part.equations[:, 3], axis=(1, 2)) for part in hulls]
    )
    owner = np.argmin(outside, axis=0)
    grown: list[tuple[Matrix, Matrix | None]] = []
    for index, part in enumerate(hulls):
        missing = triangles[(owner == index) & (outside[index] > 0.0)].reshape(-1, 3)
        larger = hull(np.vstack((part.points[part.vertices], missing)))
        grown.append((larger.points[larger.vertices], triangles[owner == index]))
    return grown


def voxel_boxes(points: Matrix, resolution: float, *, most: int | None = None) -> list[tuple[Matrix, Matrix]]:
    """Boxes that together are exactly the voxels that contain a point.

    Neighbouring voxels are merged into larger boxes, first along x, then y, then z.

    Parameters
    ----------
    points: (n, 3) [m].
    resolution: edge of a voxel [m].
    most: the greatest number of boxes; any number by default.

    Returns
    -------
    (centre (3,), size (3,)) of each box [m].

    Raises
    ------
    InputError: there are more than `most`.
    """
    corner = np.unique(np.floor(points / resolution).astype(np.int64), axis=0)
    extent = np.ones_like(corner)
    for axis in range(3):
        corner, extent = _merged_along(corner, extent, axis)
    if most is not None and len(corner) > most:
        raise too_fine(f"{len(corner)} convex pieces", most)
    return list(zip(resolution * (corner + 0.5 * extent), resolution * extent, strict=True))


def too_fine(found: str, most: int, *, hint: str = "use a coarser resolution") -> InputError:
    """The error for a solid of more parts than can be planned with, such as `found` "7000 voxels" of at `most` 5000."""
    return InputError("is too fine to plan with", found=found, allowed=f"up to {most}", hint=hint)


def _merged_along(corner: Cells, extent: Cells, axis: int) -> tuple[Cells, Cells]:
    """Boxes of cells (N, 3), after joining adjacent ones of equal cross-section along an axis."""
    across = np.column_stack([values[:, i] for values in (corner, extent) for i in range(3) if i != axis])
    order = np.lexsort((corner[:, axis], *across.T))
    corner, extent, across = corner[order], extent[order], across[order]
    ends = corner[:-1, axis] + extent[:-1, axis]
    continues = (across[1:] == across[:-1]).all(axis=1) & (corner[1:, axis] == ends)
    first = np.flatnonzero(np.concatenate(([True], ~continues)))
    merged = extent[first]
    merged[:, axis] = np.add.reduceat(extent[:, axis], first)
    return corner[first], merged


def terrain_columns(
    heights: Matrix, size: tuple[float, float], *, tolerance: float, depth: float, most: int | None = None
) -> list[Matrix]:
    """Corners (k, 3) of convex columns that together fill the ground under a height map [m].

    A block of cells becomes one column if the hull of its surface points rises at most
    `tolerance` above the surface at every grid point.

    Parameters
    ----------
    heights: (rows, columns) [m]; rows run along y, columns along x, both ascending,
        and the map is centred on the origin.
    size: extent in x and y [m].
    tolerance: the greatest depth of a hollow that may be filled up [m].
    depth: how far below the lowest point the columns reach [m].
    most: the greatest number of columns; any number by default.

    Raises
    ------
    InputError: more than `most` columns are needed. On ground with hollows everywhere this is
        found before any hull is built.
    """
    rows, columns = heights.shape
    x = np.linspace(-size[0] / 2.0, size[0] / 2.0, columns)
    y = np.linspace(-size[1] / 2.0, size[1] / 2.0, rows)
    floor = float(heights.min()) - depth
    found: list[Matrix] = []
    extent = float(max(*size, np.ptp(heights)))
    stack = _split_hollow_blocks(heights, tolerance + 2.0 * flatness(2.0 * extent), most)[::-1]
    while stack:
        block = r0, r1, c0, c1 = stack.pop()
        xs, ys = np.meshgrid(x[c0 : c1 + 1], y[r0 : r1 + 1])
        top = np.column_stack((xs.ravel(), ys.ravel(), heights[r0 : r1 + 1, c0 : c1 + 1].ravel()))
        if not _is_cell(block) and _rise_of_hull(top) > tolerance:
            stack += _halves(block)
            continue
        if most is not None and len(found) == most:
            raise too_fine(f"more than {most} convex pieces", most)
        base = top.copy()
        base[:, 2] = floor
        around = hull(np.vstack((top, base)))
        found.append(around.points[around.vertices])
    return found


def _split_hollow_blocks(heights: Matrix, tolerance: float, most: int | None) -> list[Block]:
    """The blocks that remain after halving all blocks in which a grid point is low between two others.

    A hull rises above the middle of three points in a row by at least as much as this point is below
    the line between the others, so that no halved block could have been one column.
    """
    rows, columns = heights.shape
    lows = [(step, *_low_points(heights, tolerance, step)) for step in _HOLLOWS if 2 * step < max(rows, columns)]
    found: list[Block] = []
    stack: list[Block] = [(0, rows - 1, 0, columns - 1)]
    while stack:
        block = r0, r1, c0, c1 = stack.pop()
        if not _is_cell(block) and any(
            _any_in(along_x, r0, r1, c0 + step, c1 - step) or _any_in(along_y, r0 + step, r1 - step, c0, c1)
            for step, along_x, along_y in lows
        ):
            stack += _halves(block)
            continue
        found.append(block)
        if most is not None and len(found) > most:
            raise too_fine(f"more than {most} convex pieces", most)
    return found


def _low_points(heights: Matrix, tolerance: float, step: int) -> tuple[Cells, Cells]:
    """How many points are more than `tolerance` below the mean of those `step` to both sides, along x and along y.

    Each result is (rows + 1, columns + 1): the counts over all rows and columns before.
    """
    low = np.zeros((2, *heights.shape), dtype=bool)
    low[0, :, step:-step] = (
        0.5 * (heights[:, : -2 * step] + heights[:, 2 * step :]) - heights[:, step:-step] > tolerance
    )
    low[1, step:-step] = 0.5 * (heights[: -2 * step] + heights[2 * step :]) - heights[step:-step] > tolerance
    sums = np.zeros((2, heights.shape[0] + 1, heights.shape[1] + 1), dtype=np.int64)
    sums[:, 1:, 1:] = low.cumsum(axis=1).cumsum(axis=2)
    return sums[0], sums[1]


def _any_in(sums: Cells, r0: int, r1: int, c0: int, c1: int) -> bool:
    """Whether any point is counted in rows r0 to r1 and columns c0 to c1, all included."""
    if r1 < r0 or c1 < c0:
        return False
    return bool(sums[r1 + 1, c1 + 1] - sums[r0, c1 + 1] - sums[r1 + 1, c0] + sums[r0, c0])


def _is_cell(block: Block) -> bool:
    """Whether a block is a single cell."""
    r0, r1, c0, c1 = block
    return r1 - r0 <= 1 and c1 - c0 <= 1


def _halves(block: Block) -> list[Block]:
    """Both halves of a block, cut across its longer side."""
    r0, r1, c0, c1 = block
    row, column = (r0 + r1) // 2, (c0 + c1) // 2
    by_rows = r1 - r0 >= c1 - c0
    return [(r0, row, c0, c1), (row, r1, c0, c1)] if by_rows else [(r0, r1, c0, column), (r0, r1, column, c1)]


def _rise_of_hull(top: Matrix) -> float:
    """How far the upper convex hull of surface points rises above any of them [m]."""
    if is_flat(top):
        return 0.0
    equations = hull(top).equations
    upper = equations[equations[:, 2] > 1e-9]
    ceiling = np.min(-(top[:, :2] @ upper[:, :2].T + upper[:, 3]) / upper[:, 2], axis=1)
    return float(np.max(ceiling - top[:, 2]))
