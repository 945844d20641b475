"""Hulls with a corner that has very many neighbours, which coal counts in one byte."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from scipy.spatial import ConvexHull

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import build_obstacle, obstacle_from_dict

RADIUS, HEIGHT = 1.0, 2.0  # m
EXCESS = 1e-3  # of the distance from the centre
ROUNDING = 1e-8
SIDES = [100, 254, 255, 300, 600, 2000]


def ring(sides: int, z: float) -> Matrix:
    angle = 2.0 * np.pi * np.arange(sides) / sides
    return np.column_stack((RADIUS * np.cos(angle), RADIUS * np.sin(angle), np.full(sides, z)))


def cone(sides: int) -> Matrix:
    return np.vstack((ring(sides, 0.0), [[0.0, 0.0, HEIGHT]]))


def cylinder(sides: int) -> Matrix:
    return np.vstack((ring(sides, 0.0), ring(sides, HEIGHT)))


def bumped_plate(sides: int) -> Matrix:
    """A plate of 20 x 20 m and 1 mm with a flat spike on it."""
    return np.vstack((10.0 * ring(sides, 0.0), 10.0 * ring(sides, 0.0) - [0.0, 0.0, 1e-3], [[3.0, 1.0, 0.05]]))


SHAPES = {"cone": cone, "cylinder": cylinder, "bumped plate": bumped_plate}
PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0), np.array([4.0, -2.0, 1.0]))


@cache
def piece_of(shape: str, sides: int) -> shapes.Piece:
    return shapes.convex(SHAPES[shape](sides), PLACEMENT)


def distance_to(piece: shapes.Piece, point: Vector) -> float:
    """The distance to `point` (3,) in the frame of the solid [m]."""
    ball = shapes.sphere(1e-3, pin.SE3.Identity())
    found, *_ = shapes.Gauge().measure(
        piece.shape,
        shapes.transform(piece.placement.rotation, piece.placement.translation),
        ball.shape,
        shapes.transform(np.eye(3), PLACEMENT.act(point)),
    )
    return found + 1e-3


@pytest.mark.parametrize("sides", SIDES[:-1])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_piece_contains_the_solid_and_is_at_most_a_thousandth_larger(shape: str, sides: int) -> None:
    corners, piece = SHAPES[shape](sides), piece_of(shape, sides)
    local = (piece.hull - PLACEMENT.translation) @ PLACEMENT.rotation
    around, own = ConvexHull(local).equations, ConvexHull(corners).equations
    assert np.max(corners @ around[:, :3].T + around[:, 3]) <= ROUNDING
    centre = trimesh.convex.convex_hull(corners).center_mass
    room = -(own[:, :3] @ centre + own[:, 3])
    assert np.max((local - centre) @ own[:, :3].T / room) <= 1.0 + EXCESS + ROUNDING


@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("away", [-0.02, 0.0, 0.001, 0.3])
def test_the_distance_to_a_cone_is_exact_or_a_little_less(sides: int, away: float) -> None:
    piece = piece_of("cone", sides)
    # each face leans by the angle whose tangent is the ring's inner radius over the height
    inner = RADIUS * np.cos(np.pi / sides)
    for face in (0, sides // 3, sides - 1):
        angle = 2.0 * np.pi * (face + 0.5) / sides
        normal = np.array([np.cos(angle) * HEIGHT, np.sin(angle) * HEIGHT, inner]) / np.hypot(HEIGHT, inner)
        middle = np.array([0.5 * inner * np.cos(angle), 0.5 * inner * np.sin(angle), 0.5 * HEIGHT])
        found = distance_to(piece, middle + away * normal)
        assert away - EXCESS * HEIGHT <= found <= away + ROUNDING
    if away >= 0.0:
        assert distance_to(piece, np.array([0.0, 0.0, HEIGHT + away])) == pytest.approx(away, abs=ROUNDING)
    assert distance_to(piece, np.array([0.1, 0.2, -away])) == pytest.approx(away, abs=EXCESS * HEIGHT)


@pytest.mark.parametrize("sides", SIDES)
def test_the_distance_to_a_cylinder_is_exact_or_a_little_less(sides: int) -> None:
    piece = piece_of("cylinder", sides)
    inner = RADIUS * np.cos(np.pi / sides)
    for away in (-0.05, 0.002, 0.7):
        for side in (0, sides // 4):
            angle = 2.0 * np.pi * (side + 0.5) / sides
            point = np.array([(inner + away) * np.cos(angle), (inner + away) * np.sin(angle), 1.1])
            assert away - EXCESS * HEIGHT <= distance_to(piece, point) <= away + ROUNDING
        found = distance_to(piece, np.array([0.2, -0.3, HEIGHT + away]))
        assert away - EXCESS * HEIGHT <= found <= away + ROUNDING


def test_a_hull_whose_neighbours_coal_can_count_is_unchanged() -> None:
    corners = cone(254)
    np.testing.assert_array_equal(
        np.unique(shapes.convex(corners, pin.SE3.Identity()).hull, axis=0), np.unique(corners, axis=0)
    )


@pytest.mark.parametrize("sides", [300, 2000])
def test_a_scene_may_contain_a_mesh_with_very_many_neighbours(sides: int, tmp_path: Path) -> None:
    trimesh.creation.cone(RADIUS, HEIGHT, sections=sides).export(tmp_path / "cone.stl")
    spec = obstacle_from_dict({"name": "heap", "shape": "mesh", "file": "cone.stl", "position": [5.0, 0.0, 0.0]})
    (piece,) = build_obstacle(spec, folder=tmp_path, clearance=0.0).pieces
    assert distance_to(piece, PLACEMENT.actInv(np.array([5.0, 0.0, HEIGHT + 0.4]))) == pytest.approx(0.4, abs=1e-6)
