"""Pairs whose convex pieces overlap though their meshes do not: smaller pieces never give too large distances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from backhoe_planner.machine import Robot, load_robot, self_pairs, self_pieces
from backhoe_planner.machine.pairs_cache import key_of, read_pairs
from backhoe_planner.site import Proximity

SIDES = 24
HOLE, RIM = 0.15, 0.3  # m, radii of the corners of the ring


def cross_slide(folder: Path, edge: float, more: str = "") -> Robot:
    """A cube that two slides move by 0.2 m either way in the plane of a ring, whose hull closes the hole."""
    trimesh.creation.annulus(HOLE, RIM, 0.1, sections=SIDES).export(folder / "ring.stl")
    slides = "".join(
        f'<joint name="{axis}" type="prismatic"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{along}"/><limit lower="-0.2" upper="0.2" effort="1" velocity="1"/></joint>'
        for axis, parent, child, along in (("x", "ring", "between", "1 0 0"), ("y", "between", "cube", "0 1 0"))
    )
    cube = f'<collision><geometry><box size="{edge} {edge} {edge}"/></geometry></collision>'
    path = folder / "machine.urdf"
    path.write_text(
        '<robot name="cross_slide"><link name="ring"><collision><geometry><mesh filename="ring.stl"/></geometry>'
        f'</collision></link><link name="between"/><link name="cube">{cube}{more}</link>{slides}</robot>'
    )
    return load_robot(path, tip="cube")


def in_the_hole(corners: np.ndarray) -> bool:
    """Whether all `corners` (k, 2) are inside the polygon of the hole, whose first corner is on the x axis."""
    middle = 2.0 * np.pi / SIDES * (np.arange(SIDES) + 0.5)
    normals = np.column_stack((np.cos(middle), np.sin(middle)))
    return bool(np.max(corners @ normals.T) < HOLE * np.cos(np.pi / SIDES))


def test_a_part_that_may_be_inside_the_material_keeps_the_hull(tmp_path: Path) -> None:
    """At 0.2 m a cube of 20 mm is completely in the ring's material, where it touches no triangle.

    A second box of its link, far above the ring, is not connected to it and gives no information about it.
    """
    above = '<collision><origin xyz="0 0 2"/><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    robot = cross_slide(tmp_path, 0.02, above)
    assert self_pairs(robot).finer == ()
    assert Proximity(robot).distances(np.array([0.2, 0.0])).min() < 0.0


@pytest.fixture(scope="module")
def with_mast(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """A cube of 100 mm with a mast that rises out of the ring's hull."""
    mast = '<collision><origin xyz="0 0 0.2"/><geometry><box size="0.02 0.02 0.5"/></geometry></collision>'
    return cross_slide(tmp_path_factory.mktemp("mast"), 0.1, mast)


def test_smaller_pieces_free_a_cube_in_the_hole_and_never_one_that_touches(with_mast: Robot) -> None:
    """The cube is free where its four corners are inside the hole; smaller pieces miss this only close to the rim."""
    robot = with_mast
    assert self_pairs(robot).finer
    proximity = Proximity(robot)
    corners = 0.05 * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
    rng = np.random.default_rng(4)
    free = seen = 0
    for q in rng.uniform(-0.2, 0.2, (300, 2)):
        apart = proximity.distances(q).min() > 0.0
        is_free = in_the_hole(corners + q)
        assert is_free or not apart
        free, seen = free + is_free, seen + apart
    assert free > 20
    assert seen > 0.9 * free


def test_the_distance_by_smaller_pieces_never_exceeds_the_true_one(with_mast: Robot) -> None:
    """In the middle: from a corner 70.7 mm along the diagonal to the side of the hole at 150 mm times cos(7.5 deg)."""
    least = Proximity(with_mast).distances(np.zeros(2)).min()
    # the diagonal at 45 deg passes through a corner of the hole, 7.5 deg from the normals of both its sides
    corner = 0.05 * np.array([1.0, 1.0])
    normal = np.array([np.cos(np.radians(37.5)), np.sin(np.radians(37.5))])
    exact = HOLE * np.cos(np.pi / SIDES) - corner @ normal
    assert 0.0 < least <= exact + 1e-9


def test_the_gradient_of_smaller_pieces_agrees_with_central_differences(with_mast: Robot) -> None:
    proximity, q, step = Proximity(with_mast), np.array([0.021, -0.013]), 1e-6
    near = proximity.at(q, within=0.2)
    for column in range(2):
        move = step * np.eye(2)[column]
        ahead, behind = (proximity.distances(q + sign * move)[near.pair] for sign in (1.0, -1.0))
        np.testing.assert_allclose(near.gradient[:, column], (ahead - behind) / (2.0 * step), atol=1e-5)


def test_smaller_pieces_contain_all_triangles_and_lie_inside_their_parents(with_mast: Robot) -> None:
    """The parts of the ring in divided pairs include every corner; none leaves the hull by more than rounding."""
    pairs, pieces = self_pairs(with_mast), self_pieces(with_mast)
    assert pieces[: len(with_mast.pieces)] == with_mast.pieces
    (ring,) = {index for pair in pairs.divided for index in pair if with_mast.pieces[index].link == "ring"}
    parts = [piece.piece.hull for piece in pieces[len(with_mast.pieces) :] if piece.link == "ring"]
    angle = 2.0 * np.pi / SIDES * np.arange(SIDES)
    for radius in (HOLE, RIM):
        for x, y in radius * np.column_stack((np.cos(angle), np.sin(angle))):
            assert min(np.linalg.norm(part - [x, y, 0.05], axis=1).min() for part in parts) < 1e-4
    around = with_mast.pieces[ring].piece.hull
    assert np.abs(np.vstack(parts)).max(axis=0) == pytest.approx(np.abs(around).max(axis=0), abs=1e-4)


def test_pairs_with_smaller_pieces_are_read_unchanged_from_the_cache(with_mast: Robot) -> None:
    assert read_pairs(key_of(with_mast)) == self_pairs(with_mast)


def test_links_that_overlap_over_the_whole_range_of_their_joint_are_not_paired(tmp_path: Path) -> None:
    """A bar 0.5 to 1 m from the axis in a bed of two halves overlaps one or the other over the whole turn.

    With a single half it does not over half of the turn, and the pair counts.
    """

    def machine(*halves: float) -> Robot:
        bed = "".join(
            f'<collision><origin xyz="{x} 0 0"/><geometry><box size="2 4 0.2"/></geometry></collision>' for x in halves
        )
        hub = '<collision><geometry><cylinder radius="0.05" length="0.1"/></geometry></collision>'
        bar = '<collision><origin xyz="0.75 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></collision>'
        path = tmp_path / "machine.urdf"
        path.write_text(
            f'<robot name="m"><link name="bed">{bed}{hub}</link><link name="bar">{hub}{bar}</link>'
            '<joint name="turn" type="continuous"><parent link="bed"/><child link="bar"/><axis xyz="0 0 1"/></joint>'
            "</robot>"
        )
        return load_robot(path, tip="bar")

    both = self_pairs(machine(1.0, -1.0))
    assert not both.kept
    assert "overlap over the whole range of turn" in {one.why for one in both.left_out}
    assert self_pairs(machine(1.0)).kept
