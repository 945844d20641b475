"""Links beside scans and meshes: verdicts on many at once compared with measuring each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from backhoe_planner import Robot
from backhoe_planner.machine import BatchKinematics, Cluster, LinkPiece, MeshSolid, Reading, VoxelSolid, voxel_keys
from backhoe_planner.native import find_compiled
from backhoe_planner.site.pairs.beside_solids import BesideSolids
from backhoe_planner.site.pairs.link_balls import LinkBalls
from backhoe_planner.site.pairs.link_corners import KEPT, NEARER, UNKNOWN

needs_native = pytest.mark.skipif(find_compiled() is None, reason="the compiled functions are not installed")


def tub() -> trimesh.Trimesh:
    """A closed mesh of a tub 4 m long, open at the top, of 2,304 triangles."""
    outer = np.array([(x, y, z) for z in (0.0, 1.5) for x, y in ((-2, -1.1), (2, -1.1), (2, 1.1), (-2, 1.1))])
    inner = outer * (0.95, 0.9, 1.0) + np.array([[0.0, 0.0, 0.15]] * 4 + [[0.0, 0.0, 0.0]] * 4)
    sides = [(a, (a + 1) % 4, (a + 1) % 4 + 4, a + 4) for a in range(4)]
    quads = [(3, 2, 1, 0), *sides, (8, 9, 10, 11), *(tuple(8 + k for k in side[::-1]) for side in sides)]
    quads += [(a + 4, (a + 1) % 4 + 4, (a + 1) % 4 + 12, a + 12) for a in range(4)]
    faces = [part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))]
    mesh = trimesh.Trimesh(np.vstack((outer, inner)), faces, process=False)
    for _ in range(3):
        mesh = mesh.subdivide()
    return mesh


def heap() -> trimesh.Trimesh:
    """The surface of a heap, which is open below."""
    x = np.linspace(-1.6, 1.6, 33)
    X, Y = np.meshgrid(x, x)
    vertices = np.column_stack((X.ravel(), Y.ravel(), 1.4 * np.exp(-(X**2 + Y**2)).ravel()))
    a, b, c, d = (np.arange(33 * 33).reshape(33, 33)[rows, columns].ravel() for rows in _ENDS for columns in _ENDS)
    return trimesh.Trimesh(vertices, np.vstack((np.column_stack((a, b, d)), np.column_stack((a, d, c)))), process=False)


_ENDS = slice(None, -1), slice(1, None)


def scan() -> VoxelSolid:
    points = trimesh.sample.sample_surface(heap(), 20_000, seed=3)[0]
    return VoxelSolid(voxel_keys(points, 0.05), 0.05, most=10**6)


SOLIDS: dict[str, Callable[[], MeshSolid | VoxelSolid]] = {
    "closed": lambda: MeshSolid(tub(), most=10**6),
    "open": lambda: MeshSolid(heap(), most=10**6),
    "scan": scan,
}


@needs_native
@pytest.mark.parametrize("solid", SOLIDS)
def test_verdicts_on_many_links_equal_the_distance_of_each(backhoe: Robot, solid: str) -> None:
    rng = np.random.default_rng(21)
    pieces = [own for own in backhoe.pieces if own.joint]
    balls = LinkBalls(pieces, most=(4, 24))
    beside, around = BesideSolids(pieces, balls), SOLIDS[solid]()
    kinematics, data = BatchKinematics(backhoe), backhoe.model.createData()
    verdicts, inside, bounded, read = [], 0, 0, 0
    for _ in range(6):
        turned = pin.rpy.rpyToMatrix(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0))
        cluster = Cluster(around, pin.SE3(turned, np.array([rng.uniform(2.0, 5.0), rng.uniform(-1.0, 1.0), 0.0])))
        q = np.array([backhoe.random_q(rng) for _ in range(20)])
        rows, which = (part.ravel() for part in np.indices((len(q), len(pieces))))
        least = rng.uniform(0.02, 0.4, len(rows))
        bounds = cluster.grid(np.zeros(3), 9.0)
        asked = cluster, balls.poses_of(kinematics.at(q)), rows, which, least, bounds
        verdict, lower, reading = beside.keep(*asked), beside.lower(*asked), beside.measure(*asked[:-1])
        given_up: set[int] = set()
        for k, (row, number) in enumerate(zip(rows.tolist(), which.tolist(), strict=True)):
            pin.forwardKinematics(backhoe.model, data, q[row])
            found = cluster.measure(pieces[number].piece, data.oMi[pieces[number].joint], float(least[k]))
            one = reading[k]
            if one == "far":
                assert found is None
            elif isinstance(one, Reading):
                assert found is not None
                assert one.distance == pytest.approx(found.distance, abs=1e-9)
                np.testing.assert_allclose(one.other_point - one.point, one.distance * one.normal, atol=1e-8)
                read += 1
            if lower[k] > 0.0 and found is not None:
                assert lower[k] <= found.distance
            bounded += lower[k] >= least[k]
            if row in given_up:
                assert verdict[k] == UNKNOWN
                continue
            verdicts.append(int(verdict[k]))
            if verdict[k] == KEPT:
                assert found is None or found.distance >= least[k] - 1e-9
            elif verdict[k] == NEARER:
                assert found is not None
                inside += found.distance < -0.05
                given_up.add(row)
    assert bounded > 100
    assert read > 20
    assert verdicts.count(KEPT) > 100
    assert verdicts.count(NEARER) > 20
    assert verdicts.count(UNKNOWN) < 5
    assert inside > 5


@needs_native
def test_a_link_inside_a_closed_mesh_that_touches_no_triangle_is_nearer_and_one_inside_an_open_mesh_is_not(
    backhoe: Robot,
) -> None:
    """Cubes of 20 m around the machine: the walls are 10 m away."""
    pieces: list[LinkPiece] = [own for own in backhoe.pieces if own.joint]
    balls = LinkBalls(pieces, most=(4, 24))
    beside, q = BesideSolids(pieces, balls), np.zeros((1, backhoe.n))
    cube = trimesh.creation.box((20.0, 20.0, 20.0)).subdivide().subdivide().subdivide().subdivide()
    lid_off = trimesh.Trimesh(cube.vertices, cube.faces[cube.triangles_center[:, 2] < 9.9], process=False)
    for mesh, expected in ((cube, NEARER), (lid_off, KEPT)):
        cluster = Cluster(MeshSolid(mesh, most=10**6), pin.SE3.Identity())
        asked = np.zeros(1, dtype=np.intp), np.zeros(1, dtype=np.intp), np.array([0.1])
        poses = balls.poses_of(BatchKinematics(backhoe).at(q))
        assert beside.keep(cluster, poses, *asked, cluster.grid(np.zeros(3), 9.0)).tolist() == [expected]
