"""The corners of the intersection of two pieces, compared with hand calculations."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.arrays import Matrix
from backhoe_planner.machine.shape import shapes
from backhoe_planner.machine.shape.overlap import Faces, faces_of, overlap_corners

CUBE = faces_of(shapes.box(np.ones(3), pin.SE3.Identity()))
STILL = np.eye(3)


def about_z(angle: float) -> Matrix:
    return np.asarray(pin.utils.rotate("z", angle))


def test_two_shifted_cubes_intersect_in_a_box() -> None:
    found = overlap_corners(CUBE, CUBE, STILL, np.array([0.6, 0.3, -0.2]))
    expected = {(x, y, z) for x in (0.1, 0.5) for y in (-0.2, 0.5) for z in (-0.5, 0.3)}
    assert {tuple(corner) for corner in np.round(found, 9).tolist()} >= expected
    np.testing.assert_allclose(found.min(axis=0), [0.1, -0.2, -0.5], atol=1e-12)
    np.testing.assert_allclose(found.max(axis=0), [0.5, 0.5, 0.3], atol=1e-12)


def test_a_cube_and_one_turned_by_45_degrees_intersect_in_an_octagon() -> None:
    """Its corners: where |x| = 1/2 meets |x| + |y| = 1 / sqrt(2)."""
    found = overlap_corners(CUBE, CUBE, about_z(np.pi / 4.0), np.zeros(3))
    away = np.linalg.norm(found[:, :2], axis=1)
    assert away.max() == pytest.approx(np.hypot(0.5, np.sqrt(0.5) - 0.5), abs=1e-12)


def test_two_crossing_beams_intersect_in_a_cube_without_their_own_corners() -> None:
    """Each 2 m long and 0.1 m thick, at right angles: a cube of 0.1 m where they cross."""
    beam = faces_of(shapes.box(np.array([2.0, 0.1, 0.1]), pin.SE3.Identity()))
    found = overlap_corners(beam, beam, about_z(np.pi / 2.0), np.array([0.7, 0.0, 0.0]))
    np.testing.assert_allclose(found.min(axis=0), [0.65, -0.05, -0.05], atol=1e-12)
    np.testing.assert_allclose(found.max(axis=0), [0.75, 0.05, 0.05], atol=1e-12)


def test_separate_cubes_have_no_intersection() -> None:
    assert overlap_corners(CUBE, CUBE, STILL, np.array([1.01, 0.0, 0.0])).shape == (0, 3)
    # apart, though their bounding boxes along the first cube's axes overlap
    assert overlap_corners(CUBE, CUBE, about_z(np.pi / 4.0), np.array([0.9, 0.9, 0.0])).shape == (0, 3)


def test_the_intersection_with_a_small_cube_inside_is_that_cube() -> None:
    small = faces_of(shapes.box(np.full(3, 0.2), pin.SE3(STILL, np.array([0.1, 0.0, 0.0]))))
    for found in (overlap_corners(CUBE, small, STILL, np.zeros(3)), overlap_corners(small, CUBE, STILL, np.zeros(3))):
        np.testing.assert_allclose(found.min(axis=0), [0.0, -0.1, -0.1], atol=1e-12)
        np.testing.assert_allclose(found.max(axis=0), [0.2, 0.1, 0.1], atol=1e-12)


def test_a_ball_is_represented_by_points_on_its_surface() -> None:
    ball = faces_of(shapes.sphere(0.3, pin.SE3(STILL, np.array([0.5, 0.0, 0.0]))))
    found = overlap_corners(CUBE, ball, STILL, np.zeros(3))
    np.testing.assert_allclose(found.min(axis=0), [0.2, -0.3, -0.3], atol=0.04 * 0.3)
    assert found[:, 0].max() == pytest.approx(0.5, abs=1e-12)
    assert np.linalg.norm(found - [0.5, 0.0, 0.0], axis=1).max() == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_intersections_of_random_hulls_agree_with_points_that_lie_in_both(seed: int) -> None:
    """No point in both is further out than the corners in any direction, and each corner lies in both."""
    rng = np.random.default_rng(seed)
    first, second = (faces_of(shapes.convex(rng.normal(size=(12, 3)), pin.SE3.Identity())) for _ in range(2))
    place = pin.SE3(about_z(rng.uniform(0.0, 6.0)), rng.normal(0.0, 0.5, 3))
    found = overlap_corners(first, second, place.rotation, place.translation)
    points = rng.uniform(-2.0, 2.0, (20_000, 3))
    own = (points - place.translation) @ place.rotation
    both = points[heights(first, points).max(axis=1) < 0.0]
    own = own[heights(first, points).max(axis=1) < 0.0]
    both = both[heights(second, own).max(axis=1) < 0.0]
    assert len(both) > 50
    ways = rng.normal(size=(30, 3))
    assert np.all((both @ ways.T).max(axis=0) <= (found @ ways.T).max(axis=0))
    assert heights(first, found).max() < 1e-8
    assert heights(second, (found - place.translation) @ place.rotation).max() < 1e-8


def heights(solid: Faces, points: Matrix) -> Matrix:
    """(N, F) heights of points above the faces, positive outside."""
    return np.asarray(points @ solid.planes[:, :3].T + solid.planes[:, 3])
