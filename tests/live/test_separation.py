"""What the separation of a machine knows of its own pieces, and the gaps along the normals of its planes."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner import Robot, build_obstacles
from backhoe_planner.arrays import Vector
from backhoe_planner.live import Placements, Separation, renew_plane
from backhoe_planner.live.planes.plane_gaps import world_normal  # opens the wall: only the servo's report needs it
from backhoe_planner.machine import travel_bounds
from backhoe_planner.site import with_carried

ROD = {"name": "rod", "shape": "capsule", "from": [0, 0, 0], "to": [0, 1.2, 0], "radius": 0.05}


def content(robot: Robot, q: np.ndarray) -> dict[str, object]:
    start = {"joints": dict(zip(robot.joint_names, q.tolist(), strict=True))}
    return {"version": 1, "start": start, "task": {"goal": {"position": [4.0, 2.0, 0.5]}}}


def test_no_corner_moves_further_than_the_travel_of_its_piece(any_robot: Robot) -> None:
    """Corners and joints against the pieces' own hulls; the bound is not far too large."""
    own, rng = Separation(any_robot).own, np.random.default_rng(21)
    at, most = Placements(any_robot, 2), 0.0
    for _ in range(40):
        q = any_robot.random_q(rng)
        delta = 0.2 * rng.normal(size=any_robot.n)
        at.place(0, q)
        at.place(1, q + delta)
        for row in any_robot.pieces_of(None):
            piece = own.pieces[row]
            assert {*map(tuple, own.corners[row, :, :3])} == {*map(tuple, piece.piece.hull)}
            here, there = (at.T[sample, piece.joint] @ own.columns[row] for sample in range(2))
            moved = np.linalg.norm((there - here)[:3], axis=0).max()
            bound = np.abs(delta) @ own.travel[own.class_of_piece[row]]
            assert moved <= bound + 1e-12
            most = max(most, moved / bound)
    assert most > 0.5


def test_joints_that_move_both_pieces_of_a_pair_alike_do_not_count_for_it(any_robot: Robot) -> None:
    """The others count as for the outer piece alone."""
    separation = Separation(any_robot)
    own = separation.own
    alone = travel_bounds(any_robot, pieces=own.pieces)
    assert len(separation) > 0
    for outer, inner, row in zip(separation.piece, separation.other_piece, separation.classes, strict=True):
        moves_both = any_robot.support[own.joint[inner]] > 0.0
        np.testing.assert_array_equal(own.travel[row], np.where(moves_both, 0.0, alone[outer]))


def test_the_pieces_of_loads_come_after_those_of_the_machine(backhoe: Robot) -> None:
    q = np.array([0.0, 0.3, -0.9, -0.5])
    legs = [{"name": name, "goal": {"joints": {"swing": 0.1}}, "carries": {**ROD, "name": name}} for name in ("a", "b")]
    scene = bp.scene_from_dict({**content(backhoe, q), "task": {"sequence": legs}})
    own = Separation(backhoe, laden=[with_carried(backhoe, scene, leg) for leg in range(2)]).own
    loads = [(piece.link, load) for piece, load in zip(own.pieces, own.load.tolist(), strict=True) if load >= 0]
    assert loads == [("a", 0), ("b", 1)]
    assert own.radius[-2:] == pytest.approx(0.05)
    assert own.load[:-2].tolist() == [-1] * (len(own.pieces) - 2)


def test_the_gap_along_the_normal_of_a_plane_is_the_distance(backhoe: Robot) -> None:
    """d = min n . z over what must not be touched, minus max n . x over the link; straight down at level ground."""
    q = np.array([0.3, 0.3, -0.9, -0.5])
    ground = {"name": "ground", "shape": "halfspace", "point": [0, 0, -4.0], "normal": [0, 0, 1]}
    scene = bp.scene_from_dict({**content(backhoe, q), "obstacles": [ground]})
    separation, at = Separation(backhoe), Placements(backhoe, 1)
    separation.add({0: build_obstacles(scene, backhoe)[0]})
    separation.place_at(0, np.zeros(3))
    at.place(0, q)

    def along(normal: Vector, row: int) -> Vector:
        own = separation.own.pieces[row]
        return np.asarray((own.piece.hull @ at.R[0, own.joint].T + at.t[0, own.joint]) @ normal)

    grounds = 0
    for pair in range(len(separation)):
        distance = renew_plane(separation, pair, at, 0)
        normal = world_normal(separation, pair, at)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        other, furthest = int(separation.other_piece[pair]), float(along(normal, int(separation.piece[pair])).max())
        if other < 0:
            np.testing.assert_allclose(normal, [0.0, 0.0, -1.0], atol=1e-9)
            assert 4.0 - furthest == pytest.approx(distance, abs=1e-6)
            grounds += 1
        else:
            assert float(along(normal, other).min()) - furthest == pytest.approx(distance, abs=1e-6)
    assert 0 < grounds < len(separation)
