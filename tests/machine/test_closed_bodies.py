"""The inside of meshes, for balls and boxes where it is known by hand."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from backhoe_planner.machine import Cluster, MeshSolid
from backhoe_planner.machine.clusters import mesh_solid
from backhoe_planner.machine.shape import shapes
from backhoe_planner.machine.shape.convex import is_closed

HERE = pin.SE3.Identity()


def ball(radius: float, x: float = 0.0, *, inwards: bool = False) -> trimesh.Trimesh:
    found = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    found.apply_translation([x, 0.0, 0.0])
    if inwards:
        found.invert()
    return found


def block(x: float, y: float) -> trimesh.Trimesh:
    found = trimesh.creation.box((1.0, 1.0, 1.0))
    found.apply_translation([x, y, 0.0])
    return found


def mixed_up(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    faces = np.array(mesh.faces)
    some = np.random.default_rng(0).random(len(faces)) < 0.4
    faces[some] = faces[some][:, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def two_sided(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, np.vstack((mesh.faces, mesh.faces[:, ::-1])), process=False)


SHEET = trimesh.Trimesh([[-5, -5, -3], [5, -5, -3], [0, 5, -3]], [[0, 1, 2]])
ONE, TWO, HOLED = ball(1.0), [ball(1.0), ball(1.0, 0.8)], trimesh.Trimesh(ball(1.0).vertices, ball(1.0).faces[1:])
EDGE = trimesh.util.concatenate([block(0.0, 0.0), block(1.0, 1.0)])
EDGE.merge_vertices()
MIRRORED = block(0.0, 0.0)
MIRRORED.apply_transform(np.diag([-1.0, 1.0, 1.0, 1.0]))  # its side faces have the same diagonals
MIRRORED.apply_translation([1.0, 0.0, 0.0])
FACE = trimesh.util.concatenate([block(0.0, 0.0), MIRRORED])
FACE.merge_vertices()
MESHES = {  # mesh, x of points inside, x of points outside
    "a ball": (ONE, [0.0, 0.8], [1.3]),
    "inside out": (ball(1.0, inwards=True), [0.0, 0.8], [1.3]),
    "faces at random": (mixed_up(ONE), [0.0, 0.8], [1.3]),
    "two-sided": (two_sided(ONE), [0.0, 0.8], [1.3]),
    "one that is open": (HOLED, [], [0.0, 1.3]),
    "overlapping": (trimesh.util.concatenate(TWO), [-0.5, 0.4, 1.4], [2.0]),
    "overlapping, one inside out": (
        trimesh.util.concatenate([ball(1.2), ball(1.0, 1.0, inwards=True)]), [-0.5, 0.6, 1.6], [2.3],
    ),
    "one within another": (trimesh.util.concatenate([ball(1.0), ball(0.5)]), [0.0, 0.8], [1.3]),
    "a shell": (trimesh.util.concatenate([ball(1.0), ball(0.5, inwards=True)]), [0.75], [0.0, 1.3]),
    "a shell inside out": (trimesh.util.concatenate([ball(1.0, inwards=True), ball(0.5)]), [0.75], [0.0, 1.3]),
    "with an open sheet": (trimesh.util.concatenate([ONE, SHEET]), [0.0, 0.8], [1.3]),
    "two that share an edge": (EDGE, [0.1, -0.3], [1.3]),
    "two that share a face": (FACE, [0.1, 0.9], [1.7]),
    "two that share a face, with an open sheet": (trimesh.util.concatenate([FACE, SHEET]), [0.1, 0.9], [1.7]),
}  # fmt: skip


@pytest.mark.parametrize("name", MESHES)
def test_points_inside_a_mesh_are_distinguished_from_those_outside(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """On a grid half as fine as usual, which is filled in an eighth of the time."""
    monkeypatch.setattr(mesh_solid, "_SIDE_CELLS", 48)
    mesh, inside, outside = MESHES[name]
    cluster = Cluster(MeshSolid(mesh, most=10**5), HERE)
    grid = cluster.grid(np.zeros(3), 2.5)
    for x in (*inside, *outside):
        place = pin.SE3(np.eye(3), np.array([x, 0.01, 0.02]))
        found = cluster.measure(shapes.sphere(0.05, HERE), place)
        assert found is not None
        assert (found.distance < 0.0) == (x in inside)
        assert (cluster.inside_of(shapes.sphere(0.05, HERE), place) is not None) == (x in inside)
        bound = float(grid.lower(place.translation[:, None])[0])
        assert bound <= max(found.distance + 0.05, 0.0)


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_is_closed_unless_a_part_of_it_is_open(name: str) -> None:
    assert is_closed(MESHES[name][0]) == (name != "one that is open" and "sheet" not in name)
    assert not is_closed(two_sided(SHEET))
    assert not is_closed(trimesh.util.concatenate([FACE, two_sided(SHEET)]))


@pytest.mark.long
def test_a_coarse_body_with_a_fine_detail_is_solid_just_below_its_surface() -> None:
    ground = trimesh.creation.box((200.0, 200.0, 60.0))  # its top is at height 0
    ground.apply_translation([0.0, 0.0, -30.0])
    detail = ball(0.2)
    detail.apply_translation([0.0, 0.0, 5.0])
    cluster = Cluster(MeshSolid(trimesh.util.concatenate([ground, detail]), most=10**5), HERE)
    for radius in (1.0, 6.0):
        grid = cluster.grid(np.array([0.0, 0.0, -1.0]), radius)
        below = np.column_stack((np.full((8, 2), 0.1), -np.linspace(0.05, 1.9, 8)))
        assert not grid.lower(below.T).any()
