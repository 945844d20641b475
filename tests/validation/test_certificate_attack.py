"""The attack on the certificate: its own distances are right, and a certificate that claims too much is refuted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import strategies

import backhoe_planner as bp
from backhoe_planner.site.schema import obstacle_shapes
from validation.certificate_attack import Comparison, attack_seeds, compare, summarise
from validation.convex_gaps import Part, ball, block, drum, gap, rod
from validation.dense_sweep import link_bodies
from validation.link_pairs import find_pairs, touch_share
from validation.random_attacks import SHAPES, TURNS, Attack, Attacked, random_attack, random_attacked
from validation.random_machines import write_random_machine
from validation.raw_obstacles import RawObstacle, read_obstacle
from validation.raw_urdf import read_raw_urdf, rotation_of
from validation.signed_distances import SignedDistance, box_distance, capsule_distance, cylinder_distance

FIRSTS = (45,)  # first seeds of machines that are quick to compare
SEEDS = [seed for first in FIRSTS for seed in range(first, first + TURNS)]


def draw_attacks(
    firsts: Sequence[int], tmp_path_factory: pytest.TempPathFactory
) -> list[tuple[Attack, bp.Certificate]]:
    found = []
    for first in firsts:
        folder = tmp_path_factory.mktemp("machine")
        machine = random_attacked(first, folder)
        for seed in range(first, first + TURNS):
            attack = random_attack(seed, machine, folder)
            found.append((attack, bp.certify(machine.robot, attack.scene, attack.trajectory)))
    return found


@pytest.fixture(scope="module")
def attacks(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Attack, bp.Certificate]]:
    return draw_attacks(FIRSTS, tmp_path_factory)


@pytest.fixture(scope="module")
def compared(attacks: list[tuple[Attack, bp.Certificate]]) -> list[Comparison]:
    return [compare(attack, certificate) for attack, certificate in attacks]


def test_every_shape_is_drawn_attacked_and_measured() -> None:
    """A shape that only the planner knows would be neither in random scenes nor in the independent check."""
    records = obstacle_shapes.shape_records()
    assert set(SHAPES) == set(records)
    assert set(strategies.SHAPES) == set(records)
    required = {
        name: {field.alias or key for key, field in record.model_fields.items() if field.is_required()}
        for name, record in records.items()
    }
    assert {name: {"name", "shape", *keys} for name, keys in strategies.SHAPES.items()} == required


def test_no_certificate_claims_more_than_was_measured(compared: list[Comparison]) -> None:
    assert [r for one in compared for r in one.refutations] == []
    summary = summarise(compared)
    assert summary.comparisons == len(SEEDS)
    assert summary.safe > 0
    assert summary.claims > 10
    # a proven distance is at most 2 % of the margin below the measured one
    assert summary.below[0] < 0.03


def raised(certificate: bp.Certificate, by: float) -> bp.Certificate:
    """The same certificate with every distance larger [m]."""
    entries = tuple(replace(e, distance=e.distance + by, margin=e.margin + by) for e in certificate.clearances)
    return replace(certificate, clearances=entries)


@pytest.mark.long
def test_a_certificate_that_claims_5_mm_more_is_refuted(tmp_path_factory: pytest.TempPathFactory) -> None:
    told = [compare(attack, raised(honest, 0.005)) for attack, honest in draw_attacks((15, 25), tmp_path_factory)]
    causes = [r.cause for one in told for r in one.refutations]
    assert len([cause for cause in causes if cause.startswith("nearer to a ")]) > 5


def test_a_run_over_seeds_equals_single_comparisons(compared: list[Comparison]) -> None:
    (alone,), _ = attack_seeds([SEEDS[1]])
    assert not alone.error
    assert replace(alone, seconds=0.0) == compared[1]


def attack_of(seed: int, folder: Path) -> Attack:
    return random_attack(seed, random_attacked(seed, folder), folder)


def test_the_same_seed_gives_the_same_machine_site_and_motion(tmp_path: Path) -> None:
    drawn = []
    for name in ("one", "other"):
        (folder := tmp_path / name).mkdir()
        drawn.append(attack_of(3, folder))
    one, other = drawn
    assert one.machine.robot.urdf.sha256 == other.machine.robot.urdf.sha256
    assert one.scene.to_dict() == other.scene.to_dict()
    np.testing.assert_array_equal(one.trajectory.q, other.trajectory.q)


@pytest.mark.parametrize("seed", range(4))
def test_links_are_placed_as_by_pinocchio(seed: int, tmp_path: Path) -> None:
    file = write_random_machine(np.random.default_rng(seed), tmp_path)
    robot = bp.load_robot(file, tip="tip")
    q = robot.random_q(np.random.default_rng(seed))
    placed = read_raw_urdf(file).placements(dict(zip(robot.joint_names, q[:, None], strict=True)), 1)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    for link, (rotation, translation) in placed.items():
        expected = data.oMf[robot.model.getFrameId(link, pin.FrameType.BODY)]
        np.testing.assert_allclose(rotation[0], expected.rotation, atol=1e-13)
        np.testing.assert_allclose(translation[0], expected.translation, atol=1e-13)


def test_a_gap_to_a_point_is_its_signed_distance() -> None:
    """Outside, by the distance functions of the independent check."""
    rng = np.random.default_rng(0)
    still, origin = np.eye(3), np.zeros(3)
    size, start, end = np.array([0.4, 0.7, 0.2]), np.array([0.1, -0.2, 0.0]), np.array([0.5, 0.3, -0.4])
    solids: dict[str, tuple[Part, SignedDistance]] = {
        "box": (block(size, still, origin), lambda p: box_distance(p, size)),
        "cylinder": (drum(0.3, 0.5, still, origin), lambda p: cylinder_distance(p, 0.3, 0.5)),
        "capsule": (rod(start, end, 0.15), lambda p: capsule_distance(p, start, end, 0.15)),
    }
    for part, distance in solids.values():
        for point in rng.normal(0.0, 0.6, (40, 3)):
            expected = float(distance(point[None])[0])
            found = gap(ball(point, 0.0), part, still, origin)
            assert found == pytest.approx(expected, abs=1e-7) if expected > 0.0 else found <= 0.0


def test_the_gap_between_a_turned_and_a_level_cube_is_from_corner_to_face() -> None:
    """A unit cube on its corner above another: its lowest corner is half a diagonal below its middle."""
    turned = rotation_of(np.array([np.pi / 4.0, np.arctan(1.0 / np.sqrt(2.0)), 0.0]))
    cube = block(np.ones(3), np.eye(3), np.zeros(3))
    lowest = float(np.min((cube.corners @ turned.T)[:, 2]))
    assert gap(cube, cube, turned, np.array([0.0, 0.0, 2.0])) == pytest.approx(2.0 + lowest - 0.5, abs=1e-9)
    assert gap(cube, cube, turned, np.array([0.0, 0.0, 0.4 - lowest])) <= 0.0


def test_a_height_map_cell_is_solid_only_below_both_splits(tmp_path: Path) -> None:
    (tmp_path / "ground.csv").write_text("0,0\n0,1\n")
    record = {"name": "ground", "shape": "heightmap", "file": "ground.csv", "size": [1.0, 1.0], "position": [0, 0, 2]}
    ground = read_obstacle(record, folder=tmp_path, clearance=0.1)
    assert ground.body is not None
    # halfway along the diagonal from the raised corner: 0.5 high if the ridge is along that diagonal
    heights = {0.5: False, 0.3: True}
    for height, inside in heights.items():
        probe = ball(np.array([0.0, 0.0, 2.0 + height + 1e-3]), 0.0)
        least = min(gap(probe, part, np.eye(3), np.zeros(3)) for part in ground.body.parts)
        assert (least <= 0.0) == inside


def test_the_distance_of_a_tilted_cylinder_to_a_plane_is_that_of_its_rim() -> None:
    plane = RawObstacle("wall", "halfspace", 0.0, None, 0.0, np.zeros(3), None, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    tilt = 0.3
    rotation = rotation_of(np.array([tilt, 0.0, 0.0]))
    height = plane.below_plane(drum(0.2, 0.6, np.eye(3), np.zeros(3)), rotation[None], np.array([[0.0, 0.0, 1.0]]))
    assert height[0] == pytest.approx(1.0 - 0.3 * np.cos(tilt) - 0.2 * np.sin(tilt), abs=1e-12)


ELBOW = """<robot name="elbow">
  <link name="base"><collision><geometry><sphere radius="0.2"/></geometry></collision></link>
  <link name="upper"><collision><origin xyz="0.5 0 0"/><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
  <link name="lower"><collision><origin xyz="0.5 0 0"/><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
  <link name="tip"><collision><origin xyz="0 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="1 0 0"/><parent link="upper"/><child link="lower"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
  <joint name="hand" type="fixed"><origin xyz="1 0 0"/><parent link="lower"/><child link="tip"/></joint>
</robot>"""


def test_only_links_that_touch_at_every_joint_angle_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "elbow.urdf").write_text(ELBOW)
    machine = read_raw_urdf(tmp_path / "elbow.urdf")
    pairs = find_pairs(machine, link_bodies(machine), "tip")
    assert pairs.touching == {("upper", "base"), ("lower", "upper")}
    assert set(pairs.counted) == {("lower", "base"), ("tip", "base"), ("tip", "upper")}
    assert pairs.adjacent & set(pairs.counted) == {("tip", "upper")}


SWING = """<robot name="swing">
  <link name="base"><collision><origin xyz="0 0 -0.2"/><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <link name="arm"><collision><origin xyz="0.5 0 0"/><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
  <link name="cab"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <link name="tip"/>
  <joint name="swing" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="2" effort="1e6"/></joint>
  <joint name="cab_fixed" type="fixed"><origin xyz="0 0.7 0"/><parent link="base"/><child link="cab"/></joint>
  <joint name="hand" type="fixed"><origin xyz="1 0 0"/><parent link="arm"/><child link="tip"/></joint>
</robot>"""


def test_an_arm_through_the_cab_refutes_a_certificate_that_calls_it_safe(tmp_path: Path) -> None:
    (tmp_path / "swing.urdf").write_text(SWING)
    raw = read_raw_urdf(tmp_path / "swing.urdf")
    bodies = link_bodies(raw)
    robot = bp.load_robot(tmp_path / "swing.urdf", tip="tip")
    machine = Attacked(robot, raw, bodies, find_pairs(raw, bodies, "tip"))
    task = {"goal": {"position": [0, 1, 0]}}
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": {"swing": 0.0}}, "task": task})
    motion = bp.Trajectory.from_steps(np.array([0.0, 100.0]), np.array([[0.0], [2.0]]))
    attack = Attack(0, machine, scene, (), motion)
    honest = bp.certify(robot, scene, motion)
    # a certificate without any pair
    blind = replace(honest, clearances=())
    assert blind.safe
    (refutation,) = compare(attack, blind).refutations
    assert "arm touches cab" in refutation.what
    assert "called safe" in refutation.what
    assert bool(compare(attack, honest).refutations) == honest.safe


def sliding_bar(folder: Path, length: float) -> Attacked:
    """A bar on a slide along x from 0 to 1 m, and a block of the base at x = 0: they touch up to length / 2."""
    (folder / "slide.urdf").write_text(f"""<robot name="slide">
  <link name="base"/><link name="tip"/><link name="carriage"/>
  <link name="bar"><collision><geometry><box size="{length} 0.1 0.1"/></geometry></collision></link>
  <link name="block"><collision><origin xyz="-0.1 0 0"/><geometry><box size="0.2 0.2 0.2"/></geometry>
    </collision></link>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1" velocity="2" effort="1e6"/></joint>
  <joint name="bar_fixed" type="fixed"><parent link="carriage"/><child link="bar"/></joint>
  <joint name="block_fixed" type="fixed"><parent link="base"/><child link="block"/></joint>
  <joint name="hand" type="fixed"><origin xyz="1 0 0"/><parent link="carriage"/><child link="tip"/></joint>
</robot>""")
    raw = read_raw_urdf(folder / "slide.urdf")
    bodies = link_bodies(raw)
    return Attacked(bp.load_robot(folder / "slide.urdf", tip="tip"), raw, bodies, find_pairs(raw, bodies, "tip"))


@pytest.mark.parametrize(("length", "share"), [(1.89, 95), (0.81, 41)])
def test_the_share_of_a_range_in_which_links_touch_equals_the_hand_calculation(
    length: float, share: int, tmp_path: Path
) -> None:
    """By hand, at 101 places 10 mm apart, the first at 0."""
    machine = sliding_bar(tmp_path, length)
    assert touch_share(machine.raw, machine.bodies, "tip", ("bar", "block")) == pytest.approx(share / 101, abs=1e-12)


def test_links_that_touch_over_most_of_the_range_are_counted_separately(tmp_path: Path) -> None:
    machine = sliding_bar(tmp_path, 1.89)
    task = {"goal": {"position": [1.8, 0, 0]}}
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": {"slide": 0.5}}, "task": task})
    motion = bp.Trajectory.from_steps(np.array([0.0, 10.0]), np.array([[0.5], [0.8]]))
    certificate = bp.certify(machine.robot, scene, motion)
    assert certificate.safe
    found = compare(Attack(0, machine, scene, (), motion), certificate)
    assert found.refutations == ()
    assert found.by_construction == 1
    assert summarise([found, found]).by_construction == 2
