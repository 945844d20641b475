"""Self-collision pairs of the machine."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pinocchio as pin

from backhoe_planner.machine import Robot, geometry_model, load_robot, self_pairs, self_pieces


def links_of(robot: Robot) -> Counter[tuple[str, str]]:
    return Counter((self_pieces(robot)[a].link, self_pieces(robot)[b].link) for b, a in self_pairs(robot).kept)


def test_the_planar_arm_has_all_pairs_but_neighbours(planar4: Robot) -> None:
    assert links_of(planar4) == Counter(
        [
            ("base", "link2"),
            ("base", "link3"),
            ("base", "link4"),
            ("link1", "link3"),
            ("link1", "link4"),
            ("link2", "link4"),
        ]
    )


def test_the_backhoe_pairs_every_piece_of_the_boom_with_every_piece_of_the_chassis(backhoe: Robot) -> None:
    """The chassis has 3 boxes, the boom 2, the stick 2, the bucket 7."""
    pairs = links_of(backhoe)
    assert pairs["chassis", "boom"] == 3 * 2
    assert pairs["chassis", "stick"] == 3 * 2
    assert pairs["chassis", "bucket"] == 3 * 7
    assert pairs["cab", "bucket"] == 1 * 7


def test_neighbours_and_pieces_of_one_body_are_not_paired(backhoe: Robot) -> None:
    pairs = links_of(backhoe)
    for neighbours in (("chassis", "swing_post"), ("swing_post", "boom"), ("boom", "stick"), ("stick", "bucket")):
        assert pairs[neighbours] == 0
    assert not any(first == second for first, second in pairs)
    assert ("chassis", "cab") not in pairs


def test_pieces_that_touch_in_every_configuration_are_not_paired(tmp_path: Path) -> None:
    """Three hinges 1 cm apart carry balls of radius 0.5 m: 0-2 and 1-3 always overlap, the far end does not."""
    ball = '<collision><geometry><sphere radius="0.5"/></geometry></collision>'
    links = "".join(f'<link name="l{k}">{ball}</link>' for k in range(4))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="{x} 0 0"/>'
        '<axis xyz="0 0 1"/><limit lower="-0.1" upper="0.1" effort="1" velocity="1"/></joint>'
        for k, x in enumerate((0.01, 0.01, 3.0))
    )
    path = tmp_path / "balls.urdf"
    path.write_text(f'<robot name="balls">{links}{joints}</robot>')
    assert links_of(load_robot(path)) == Counter([("l0", "l3"), ("l1", "l3")])


def test_pairs_are_reproducible() -> None:
    first, second = (self_pairs(load_robot("example:backhoe")) for _ in range(2))
    assert first == second


def test_the_geometry_model_has_the_pieces_in_order_and_no_pairs(backhoe: Robot) -> None:
    model = geometry_model(backhoe)
    assert [geometry.name for geometry in model.geometryObjects] == [piece.name for piece in backhoe.pieces]
    assert [geometry.parentJoint for geometry in model.geometryObjects] == [piece.joint for piece in backhoe.pieces]
    assert len(model.collisionPairs) == 0
    model.addCollisionPair(pin.CollisionPair(0, 1))
    assert len(geometry_model(backhoe).collisionPairs) == 0
