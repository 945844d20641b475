"""One cut: its volume by hand, the limits of the cylinders, and the reasons for having no cut."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Array
from backhoe_planner.job import BladeSweep, Bucket, Cut, Digger, NoCut, Profile, Terrain, find_cut, swept
from backhoe_planner.motion import Drive, build_problem, limit_usage
from backhoe_planner.site import Soil

LEVEL = Profile.level(0.0, 1.0, 6.2)


@pytest.fixture(scope="module")
def digger(backhoe: bp.Robot) -> Digger:
    return Digger(backhoe, Soil())


def cut(digger: Digger, profile: Profile = LEVEL, **asked: Any) -> Cut:
    found = find_cut(digger, profile, **({"swing": 0.0, "start": 4.5, "end": 1.8, "depth": 0.15} | asked))
    assert isinstance(found, Cut), found
    return found


def floor(height: float) -> tuple[Array, Array]:
    return np.array([0.0, 10.0]), np.full(2, height)


# --- the bucket -------------------------------------------------------------------------------


def test_the_capacity_is_the_struck_volume_and_a_heap_of_one_to_one(digger: Digger) -> None:
    """By hand, from the plates of the URDF: a polygon of four corners, and the hipped roof of SAE J296 on it."""
    inner = [(0.933, -0.019), (0.523, 0.35), (0.168, 0.35), (0.079, 0.014)]  # inner faces of floor, back and top
    area = 0.5 * abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(inner, inner[1:] + inner[:1], strict=True)))
    roof = 0.55**2 * 0.855 / 4.0 - 0.55**3 / 12.0
    assert digger.bucket.capacity == pytest.approx(0.55 * area + roof, rel=0.02)
    assert digger.bucket.width == pytest.approx(0.61, abs=1e-9)
    assert digger.bucket.mouth == pytest.approx(0.855, abs=0.01)
    # buckets of this width hold 0.2 m^3 according to the maker's sheets
    assert 0.15 < digger.bucket.capacity < 0.22


def test_a_given_capacity_and_width_are_used(backhoe: bp.Robot) -> None:
    bucket = Bucket.of(backhoe, width=0.76, capacity=0.3)
    assert (bucket.width, bucket.capacity) == (0.76, 0.3)


def test_digging_with_a_machine_without_a_pitch_is_an_error(planar4: bp.Robot) -> None:
    with pytest.raises(bp.InputError, match="upright plane"):
        Digger(planar4, Soil())


# --- the volume -------------------------------------------------------------------------------


def test_the_volume_of_a_cut_with_level_floor_by_hand(digger: Digger) -> None:
    """1 m long and 0.2 m deep, less the ramps at both ends and two rounded corners of radius R = 0.1 m.

    A ramp at an angle a leaves d^2 / (2 tan a), a corner that turns by a leaves R^2 (tan(a/2) - a/2).
    """
    found = cut(digger, start=4.2, end=3.2, depth=0.5, floor=floor(-0.2), entry=1.4, leave=1.05)
    area = 0.2 * 1.0
    for turn in (1.4, 1.05):
        area -= 0.2**2 / (2.0 * math.tan(turn)) + 0.1**2 * (math.tan(0.5 * turn) - 0.5 * turn)
    assert found.bank_volume == pytest.approx(0.61 * area, rel=0.01)
    assert found.loose_volume == pytest.approx(1.25 * 0.61 * area, rel=0.01)
    assert found.fill == pytest.approx(1.25 * 0.61 * area / digger.bucket.capacity, rel=0.01)
    assert found.greatest_depth == pytest.approx(0.2, rel=0.01)
    assert found.held[-1] == pytest.approx(1700.0 * found.bank_volume, rel=1e-9)


@pytest.mark.parametrize("depth", [0.1, 0.15, 0.3])
def test_a_cut_ends_when_the_bucket_is_full(digger: Digger, depth: float) -> None:
    found = cut(digger, depth=depth)
    assert found.is_full
    assert found.loose_volume <= digger.bucket.capacity
    assert found.greatest_depth == pytest.approx(depth, rel=0.01)


def test_an_operators_first_cut_fills_30_to_50_percent_of_the_bucket(digger: Digger) -> None:
    """75 to 100 mm deep over 1.2 m as in the operator's manual; the share is of bank soil."""
    found = cut(digger, start=4.2, end=3.0, depth=0.0875)
    assert found.greatest_depth == pytest.approx(0.0875, rel=0.01)
    assert 0.3 < found.bank_volume / digger.bucket.capacity < 0.5


def test_loose_soil_does_not_swell_again(digger: Digger) -> None:
    r = LEVEL.r
    heaped = Profile(r, np.full((len(r), 1), -0.5), np.full((len(r), 1), 0.5))
    found = cut(digger, heaped, depth=0.2)
    assert found.bank_volume == 0.0
    assert found.loose_volume == pytest.approx(digger.bucket.capacity, rel=0.01)
    assert found.held[-1] == pytest.approx(1700.0 / 1.25 * found.loose_volume, rel=1e-9)


def test_the_edge_stays_above_the_floor_and_within_the_depth_of_cut(digger: Digger) -> None:
    """On rough ground, over a pipe whose clearance extends into the trench."""
    rng = np.random.default_rng(5)
    r = np.arange(1.5, 5.5, 0.025)
    rough = np.convolve(rng.normal(size=len(r) + 8), np.ones(9) / 9.0, mode="valid")[:, None] * 0.05
    ground = Profile(r, rough, np.zeros_like(rough))
    bed = (np.array([0.0, 3.4, 3.401, 3.7, 3.701, 9.0]), np.array([-0.3, -0.3, -0.05, -0.05, -0.3, -0.3]))
    found = cut(digger, ground, start=4.4, depth=0.25, floor=bed)
    below = found.z < ground.height(found.r) - 0.02
    assert np.count_nonzero(below) > 20
    assert np.all(found.z[below] >= np.interp(found.r[below], *bed) - 0.005)
    assert np.all(found.depth <= 0.25 + 0.15)  # the edge follows the mean over 0.3 m, or the ground where that is lower
    motion = digger.motion(found)
    r_at, z_at, _ = digger.plane.place(motion.q)
    dug = z_at < ground.height(r_at) - 0.02
    assert np.all(z_at[dug] >= np.interp(r_at[dug], *bed) - 0.01)


@pytest.mark.parametrize("swing", [0.0, 0.35])
def test_the_volume_of_a_cut_equals_that_of_its_sweep(digger: Digger, swing: float) -> None:
    """Three cuts one below the other at the end of a trench; the sweep of the edge and of the teeth of the motion."""
    terrain = Terrain.level(0.0, (1.0, -2.0), (6.0, 4.0))
    for layer in (-0.2, -0.4, -0.6):
        ground = Profile.of_terrain(terrain, digger.plane, swing, width=digger.bucket.width)
        bed = (np.array([0.0, 2.0, 2.001, 4.8, 4.801, 9.0]), np.array([0.0, 0.0, layer, layer, 0.0, 0.0]))
        found = cut(digger, ground, swing=swing, start=4.8, depth=0.3, floor=bed)
        assert found.is_full
        teeth = digger.plane.kinematics.at(digger.motion(found).q).tip_position
        sweep = swept(terrain, BladeSweep(found.position, found.across, found.bucket.width))
        again = swept(terrain, BladeSweep(teeth, found.across, found.bucket.width))
        assert sweep.bank[-1] == pytest.approx(found.bank_volume, rel=0.01)
        assert again.bank[-1] == pytest.approx(found.bank_volume, rel=0.01)
        terrain = sweep.terrain


# --- the forces -------------------------------------------------------------------------------


def test_no_cylinder_exceeds_85_percent_of_its_force_at_relief_pressure(digger: Digger) -> None:
    """Computed from the cylinders' forces and the relief pressure, not from the ratio that the search used."""
    hydraulics = digger.robot.hydraulics
    assert hydraulics is not None
    for cohesion in (5e3, 60e3, 200e3):
        hard = Digger(digger.robot, Soil(cohesion=cohesion))
        found = cut(hard, depth=0.3)
        force = hydraulics.cylinder_forces(found.q, found.torque)
        limits = hydraulics.force_limits
        assert np.all(force <= 0.85 * limits.positive * (1 + 1e-9))
        assert np.all(-force <= 0.85 * limits.negative * (1 + 1e-9))


@pytest.mark.long
def test_depth_and_cohesion_raise_the_forces_and_make_cuts_shallower(digger: Digger) -> None:
    stiff = Digger(digger.robot, Soil(cohesion=50e3))
    uses = [cut(stiff, depth=depth, end=3.2).holding.ratio for depth in (0.04, 0.08, 0.12, 0.16)]
    assert np.all(np.diff(uses) > 0.0)
    depths = [
        cut(Digger(digger.robot, Soil(cohesion=cohesion)), depth=0.5).greatest_depth
        for cohesion in (60e3, 90e3, 130e3, 190e3)
    ]
    assert np.all(np.diff(depths) < 0.0)


def test_the_plate_keeps_its_angle_to_the_path(digger: Digger) -> None:
    """In the ground the plate is 6 to 90 degrees above the path, except at rounded corners."""
    some: list[dict[str, Any]] = [{"depth": 0.15}, {"depth": 0.3, "start": 5.0}, {"depth": 0.2, "entry": 0.8}]
    for asked in some:
        found = cut(digger, **asked)
        entry, drag, curl, _ = found.begin
        plate = found.pitch + math.pi - digger.bucket.lip
        assert np.all(plate[drag + 4 : curl] > 0.1 - 0.05)
        assert np.all(plate[drag + 4 : curl] < 0.5 * math.pi + 0.05)
        rising = np.arctan2(np.diff(found.z), -np.diff(found.r))
        middle = 0.5 * (plate[1:] + plate[:-1])
        assert np.all((middle + rising)[entry:drag] > 0.0)
        assert found.pitch[-1] == pytest.approx(digger.bucket.level_pitch, abs=0.2)  # 11 degrees


def test_a_cut_in_rock_fails_naming_the_cylinder_and_its_excess(digger: Digger) -> None:
    found = find_cut(Digger(digger.robot, Soil(cohesion=5e6)), LEVEL, swing=0.0, start=4.5, end=2.0, depth=0.15)
    assert isinstance(found, NoCut)
    assert found.kind == "cylinder"
    assert found.holding is not None
    assert found.holding.ratio > 2.0
    assert digger.robot.hydraulics is not None
    names = digger.robot.hydraulics.cylinder_names
    assert all(part in names for part in found.holding.cylinder.split(" and "))
    assert found.holding.cylinder in found.reason
    assert "cannot be cut at any depth" in found.reason


def test_the_certificate_confirms_the_forces_along_the_motion(digger: Digger) -> None:
    """With the ground of the cut, its motion keeps the limits that a certificate reports."""
    hard = Digger(digger.robot, Soil(cohesion=60e3))
    found = cut(hard, depth=0.3)
    motion = hard.motion(found)
    content = {
        "version": 1,
        "task": {"goal": {"joints": dict(zip(hard.robot.joint_names, found.q[-1].tolist(), strict=True))}},
        "start": {"joints": dict(zip(hard.robot.joint_names, found.q[0].tolist(), strict=True))},
        "soil": {"cohesion": 60e3},
    }
    problem = replace(build_problem(hard.robot, bp.scene_from_dict(content)), ground=found.ground)
    usage = limit_usage(problem, motion)
    assert float(np.max(usage.greatest)) < 1.01
    torque = usage.ratio[:, [kind == "torque" for kind, _ in usage.limits]]
    assert float(np.max(torque)) == pytest.approx(found.holding.ratio, abs=0.12)
    assert float(np.max(torque)) > 0.5
    np.testing.assert_allclose(motion.q[[0, -1]], found.q[[0, -1]], atol=1e-9)


def test_after_the_cut_the_load_acts_as_a_payload_at_its_centre(digger: Digger) -> None:
    """The torques for the full bucket at the end of the cut are those of the drive with that payload."""
    found = cut(digger)
    still = np.zeros_like(found.q[-1:])
    carries = Drive(digger.robot, payload=float(found.held[-1]), payload_at=found.bucket.payload_at)
    np.testing.assert_allclose(found.torque[-1:], carries.rigid_torques(found.q[-1:], still, still), rtol=1e-9)


# --- back, reach, nothing ---------------------------------------------------------------------


def test_the_back_of_the_bucket_stays_clear_of_ground_and_fresh_cut(digger: Digger) -> None:
    """Along the motion, corners of the collision shape away from the teeth are compared with the line of the cut."""
    found = cut(digger, depth=0.3)
    assert found.back >= 0.0
    motion = digger.motion(found)
    r, z, pitch = digger.plane.place(motion.q)
    order = np.argsort(-found.r, kind="stable")
    cut_r, cut_z = found.r[order][::-1], found.z[order][::-1]
    for x, y in digger.bucket.back:
        at_r, at_z = r + x * np.cos(pitch) - y * np.sin(pitch), z + x * np.sin(pitch) + y * np.cos(pitch)
        behind = (at_r > r) & (at_r < found.r[0]) & (at_r > found.r[-1])
        assert np.all(at_z[behind] > np.interp(at_r[behind], cut_r, np.minimum(cut_z, 0.0)) + 0.01)
        ahead = ~behind & (at_r < r - 0.15)  # nearer to the teeth soil enters the bucket
        assert np.all(at_z[ahead] > 0.0)


def test_being_out_of_reach_and_having_nothing_to_dig_are_reported(digger: Digger) -> None:
    far = find_cut(digger, LEVEL, swing=0.0, start=5.9, end=3.0, depth=0.15)
    assert isinstance(far, NoCut)
    assert far.kind == "reach"
    done = find_cut(digger, LEVEL, swing=0.0, start=4.5, end=3.0, depth=0.15, floor=floor(-0.005))
    assert isinstance(done, NoCut)
    assert done.kind == "nothing"
    turned = find_cut(digger, LEVEL, swing=1.6, start=4.5, end=3.0, depth=0.15)
    assert isinstance(turned, NoCut)
    assert turned.kind == "reach"


def test_wrong_arguments_of_a_cut_are_named(digger: Digger) -> None:
    good: dict[str, Any] = {"swing": 0.0, "start": 4.5, "end": 3.0, "depth": 0.15}
    for bad in ({"start": 2.0}, {"end": 0.0}, {"depth": 0.0}, {"depth": math.nan}, {"swing": "left"}, {"volume": -1.0}):
        with pytest.raises(bp.InputError, match=next(iter(bad)) if "start" not in bad else "end"):
            find_cut(digger, LEVEL, **(good | bad))


# --- the plane --------------------------------------------------------------------------------


def test_the_closed_form_joints_of_the_arms_plane_invert_its_kinematics(digger: Digger) -> None:
    rng = np.random.default_rng(7)
    q = np.array([digger.robot.random_q(rng) for _ in range(200)])
    r, z, pitch = digger.plane.place(q)
    found = np.vstack(
        [
            digger.plane.joints(float(own[0]), *(np.array([v]) for v in at))
            for own, *at in zip(q, r, z, pitch, strict=True)
        ]
    )
    np.testing.assert_allclose(found, q, atol=1e-8)
    at = digger.plane.kinematics.at(q[:1])
    np.testing.assert_allclose(digger.plane.world(float(q[0, 0]), r[:1], z[:1]), at.tip_position, atol=1e-12)


def test_numerical_search_finds_the_closed_form_joints(digger: Digger, backhoe: bp.Robot) -> None:
    """Other arms need the search; here it runs on the same arm for comparison."""
    other = Digger(backhoe, Soil())
    other.plane._hinges = None
    assert not other.plane.closed
    r, z = np.linspace(4.5, 3.0, 12), np.full(12, -0.4)
    pitch = np.linspace(-1.2, -1.8, 12)
    np.testing.assert_allclose(other.plane.joints(0.2, r, z, pitch), digger.plane.joints(0.2, r, z, pitch), atol=1e-6)
    same, searched = cut(digger, depth=0.3), cut(other, depth=0.3)
    np.testing.assert_allclose(searched.q, same.q, atol=1e-6)
