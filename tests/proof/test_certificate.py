"""The certificate of motions whose least distance is known from plane geometry.

The stretched arm of planar4 is a bar from the axis to 4 m, 0.08 m wide. Turned by
joint 1 past a ball at 4.3 m, a corner of its end is nearest.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from machines import TURNING_SLIDE

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import Trajectory, build_problem
from backhoe_planner.proof import Certificate, LimitName, certify, segment_is_clear
from backhoe_planner.site import Obstruction
from validation.signed_distances import box_distance

Data = dict[str, Any]

LINK = np.array([1.0, 0.08, 0.08])
CORNER = float(np.hypot(4.0, 0.04))
STILL = np.zeros(4)

LIFT = """<robot name="lift"><link name="base"/>
  <link name="load"><collision><geometry><sphere radius="0.01"/></geometry></collision><inertial><mass value="20"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="load"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" effort="400" velocity="1"/></joint></robot>"""


def site(obstacles: list[Data], *, q_start: Vector = STILL, **keys: Any) -> bp.Scene:
    """A scene whose goal is the tip of the stretched arm with joint 1 at 1.4 rad."""
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {f"joint{j + 1}": float(q_start[j]) for j in range(4)}},
            "task": {"goal": {"position": [4.0 * np.cos(1.4), 4.0 * np.sin(1.4), 0.0]}},
            "obstacles": obstacles,
            "clearance": 0.0,
        }
        | keys
    )


def ball(angle: float, radius: float = 0.1, at: float = 4.3, **keys: Any) -> Data:
    position = [at * float(np.cos(angle)), at * float(np.sin(angle)), 0.0]
    return {"name": "ball", "shape": "sphere", "radius": radius, "position": position} | keys


def swing(samples: int = 201, *, duration: float = 4.0, angle: float = 1.4) -> Trajectory:
    """Joint 1 from 0 to `angle` from rest to rest, the other joints at 0."""
    part = np.linspace(0.0, 1.0, samples)
    q = np.zeros((samples, 4))
    q[:, 0] = angle * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    return Trajectory.from_steps(part * duration, q)


def straight(q_a: Vector, q_b: Vector, duration: float = 10.0) -> Trajectory:
    return Trajectory.from_steps(np.array([0.0, duration]), np.array([q_a, q_b]))


def to(certificate: Certificate, name: str = "ball") -> Obstruction:
    (found,) = [entry for entry in certificate.clearances if entry.obstacle == name]
    return found


def assert_proven(found: Obstruction, true: float) -> None:
    """Never above the true distance, and below it by 0.1 mm or 2 % of the margin at most."""
    clearance = found.distance - found.margin
    assert found.distance <= true + 1e-9
    assert found.distance >= true - max(1e-4, 0.02 * (true - clearance)) - 1e-9


def link_distances(q: Matrix, centre: Vector) -> Matrix:
    """(T, 4) distances of a point in the plane from the four links, in plane geometry."""
    found = np.empty((len(q), 4))
    root = np.zeros((len(q), 2))
    for link in range(4):
        heading = q[:, : link + 1].sum(axis=1)
        along = np.column_stack((np.cos(heading), np.sin(heading)))
        off = centre[:2] - root
        local = np.column_stack(
            (
                np.einsum("ij,ij->i", off, along) - 0.5,
                along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0],
                np.full(len(q), centre[2]),
            )
        )
        found[:, link] = box_distance(local, LINK)
        root += along
    return found


# --- distances --------------------------------------------------------------------


@pytest.mark.parametrize("samples", [2, 3, 7, 201])
def test_the_least_distance_of_a_swing_past_a_ball_is_proven_from_any_number_of_samples(
    planar4: bp.Robot, samples: int
) -> None:
    found = to(certify(planar4, site([ball(0.63)]), swing(samples)))
    assert_proven(found, 4.3 - CORNER - 0.1)
    assert found.link == "link4"


def test_the_time_of_the_least_clearance_is_reported(planar4: bp.Robot) -> None:
    """At 1.4 rad in 10 s, the left corner passes the ball's angle a little early, the right one late."""
    found = to(certify(planar4, site([ball(0.63)], clearance=0.19), straight(STILL, np.array([1.4, 0.0, 0.0, 0.0]))))
    passes = (0.63 + np.array([-1.0, 1.0]) * np.arctan2(0.04, 4.0)) / 0.14
    assert np.min(np.abs(passes - found.time)) < 0.1


@pytest.mark.parametrize("seed", range(6))
def test_the_least_distance_with_all_joints_moving_equals_dense_sampling(planar4: bp.Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q_a, q_b = rng.uniform(-2.0, 2.0, 4), rng.uniform(-2.0, 2.0, 4)
    radius = float(rng.uniform(0.05, 0.4))
    angle, at = float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.5, 5.0))
    scene = site([ball(angle, radius, at)], q_start=q_a, clearance=0.05)
    part = np.linspace(0.0, 1.0, 20001)[:, None]
    centre = np.array([at * np.cos(angle), at * np.sin(angle), 0.0])
    true = float(np.min(link_distances((1.0 - part) * q_a + part * q_b, centre))) - radius
    found = to(certify(planar4, scene, straight(q_a, q_b)))
    spacing = 5e-4  # m: the most by which a sampled least distance exceeds the true one
    assert found.distance <= true + 1e-9
    assert found.distance >= true - spacing - max(1e-4, 0.02 * (true - 0.05))


def test_a_thin_pole_between_two_samples_is_found(planar4: bp.Robot) -> None:
    """Both samples are metres away from it; the motion between them goes through it."""
    pole = {"name": "pole", "shape": "cylinder", "radius": 0.002, "length": 1.0, "position": [2.0, 2.0, 0.0]}
    certificate = certify(planar4, site([pole]), straight(STILL, np.array([1.4, 0.0, 0.0, 0.0])))
    assert not certificate.verified
    assert not certificate.safe
    assert to(certificate, "pole").distance < 0.0
    assert "pole" in certificate.problems[0]


def test_a_thin_pole_passed_just_outside_its_clearance_is_verified(planar4: bp.Robot) -> None:
    at = CORNER + 0.0052
    pole = {"name": "pole", "shape": "sphere", "radius": 0.002, "position": [at * np.cos(0.7), at * np.sin(0.7), 0.0]}
    certificate = certify(planar4, site([pole], clearance=0.003), swing())
    assert_proven(to(certificate, "pole"), 0.0032)
    assert certificate.verified


def test_exactly_the_clearance_counts_as_kept_and_less_does_not(planar4: bp.Robot) -> None:
    distance = 4.3 - CORNER - 0.1
    kept = certify(planar4, site([ball(0.63)], clearance=distance), swing())
    assert kept.verified
    assert kept.problems == ()
    broken = certify(planar4, site([ball(0.63)], clearance=distance + 3e-4), swing())
    assert not broken.verified
    (problem,) = broken.problems
    assert "link4" in problem
    assert "ball" in problem


def test_the_clearance_of_an_obstacle_overrides_that_of_the_scene(planar4: bp.Robot) -> None:
    certificate = certify(planar4, site([ball(0.63, clearance=0.25)], clearance=0.0), swing())
    assert not certificate.verified
    assert to(certificate).margin == pytest.approx(4.3 - CORNER - 0.1 - 0.25, abs=2e-4)
    assert certificate.min_clearance == to(certificate)


def test_the_tightest_margin_comes_first(planar4: bp.Robot) -> None:
    near = ball(0.3, 0.1, 4.4) | {"name": "near"}
    demanding = ball(1.0, 0.1, 4.6, clearance=0.45) | {"name": "demanding"}
    certificate = certify(planar4, site([near, demanding]), swing())
    margins = [entry.margin for entry in certificate.clearances]
    assert margins == sorted(margins)
    assert certificate.clearances[0].obstacle == "demanding"


def test_an_obstacle_with_links_counts_for_these_links_only(planar4: bp.Robot) -> None:
    inside = ball(0.7, 0.1, 1.5)  # link 2 moves through it
    assert not certify(planar4, site([inside]), swing()).verified
    certificate = certify(planar4, site([inside | {"links": ["link4"]}]), swing())
    assert certificate.verified
    found = to(certificate)
    assert found.link == "link4"
    assert_proven(found, 3.0 - 1.5 - 0.1)


def test_a_moving_obstacle_that_crosses_between_samples_is_found(planar4: bp.Robot) -> None:
    """The arm is at rest; the ball passes its end at 5 s, 0.4 m away, or goes through link 3."""
    passing = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [4.5, -3.0, 0.0], "velocity": [0, 0.6, 0]}
    found = to(certify(planar4, site([passing]), straight(STILL, STILL)))
    assert_proven(found, 0.4)
    # nearest while |y| <= 0.04, and for a while around that within the resolution
    assert found.time == pytest.approx(5.0, abs=0.3)
    hitting = passing | {"position": [2.5, -3.0, 0.0]}
    certificate = certify(planar4, site([hitting]), straight(STILL, STILL))
    assert to(certificate).distance < 0.0
    assert not certificate.safe


def test_an_obstacle_counts_from_its_appearance_on(planar4: bp.Robot) -> None:
    """The arm turns at 0.14 rad/s through 0.2 rad, where a ball appears at 5 s, 0.5 rad behind the arm."""
    late = ball(0.2, at=3.9, appears_at=5.0)
    motion = straight(STILL, np.array([1.4, 0.0, 0.0, 0.0]))
    centre = np.array([3.9 * np.cos(0.2), 3.9 * np.sin(0.2), 0.0])
    true = float(np.min(link_distances(np.array([[0.7, 0.0, 0.0, 0.0]]), centre))) - 0.1
    found = to(certify(planar4, site([late]), motion))
    assert_proven(found, true)
    assert found.time == pytest.approx(5.0)
    assert to(certify(planar4, site([late | {"appears_at": 0.0}]), motion)).distance < 0.0


def test_an_obstacle_moves_from_its_appearance_on(planar4: bp.Robot) -> None:
    """A ball appears 2 m beside the arm at 4 s and moves towards it at 0.25 m/s for 6 s."""
    coming = {
        "name": "ball", "shape": "sphere", "radius": 0.1, "position": [3.5, 2.04, 0.0],
        "appears_at": 4.0, "velocity": [0.0, -0.25, 0.0],
    }  # fmt: skip
    found = to(certify(planar4, site([coming]), straight(STILL, STILL)))
    assert_proven(found, 2.0 - 1.5 - 0.1)
    assert found.time == pytest.approx(10.0)


def test_an_obstacle_that_appears_after_the_end_does_not_count(planar4: bp.Robot) -> None:
    certificate = certify(planar4, site([ball(0.7, at=3.0, appears_at=4.5)]), swing())
    assert certificate.verified
    assert [entry.obstacle for entry in certificate.clearances if entry.obstacle == "ball"] == []


def test_self_collision_is_found(planar4: bp.Robot) -> None:
    folded = np.array([0.0, 2.4, 2.4, 0.0])
    certificate = certify(planar4, site([]), straight(STILL, folded))
    assert certificate.min_clearance is not None
    assert certificate.min_clearance.kind == "machine"
    assert not certificate.safe


# --- limits and task --------------------------------------------------------------


def test_limit_use_of_a_slow_swing_equals_that_of_a_quintic_ramp(planar4: bp.Robot) -> None:
    certificate = certify(planar4, site([]), swing(duration=4.0))
    assert certificate.verified
    # a quintic ramp peaks at 15/8 of the mean rate, and at 10/sqrt(3) of distance / time^2
    assert certificate.velocity.ratio == pytest.approx(1.875 * 1.4 / 4.0 / 1.0, rel=1e-3)
    assert certificate.velocity.joint == "joint1"
    assert certificate.velocity.time == pytest.approx(2.0, abs=0.03)
    assert certificate.acceleration.ratio == pytest.approx(10.0 / np.sqrt(3.0) * 1.4 / 16.0 / 2.0, rel=1e-2)


@pytest.mark.parametrize(
    ("keys", "duration", "kinds"),
    [
        ({}, 2.5, {"velocity"}),
        ({"limits": {"velocity_scale": 0.5}}, 4.0, {"velocity"}),
        ({"limits": {"acceleration": {"joint1": 0.4}}}, 4.0, {"acceleration"}),
        ({"limits": {"acceleration": {"joint2": 0.001}}}, 4.0, set()),
        ({}, 1.0, {"velocity", "acceleration"}),
    ],
)
def test_exceeded_rates_are_reported_by_joint(planar4: bp.Robot, keys: Data, duration: float, kinds: set[str]) -> None:
    certificate = certify(planar4, site([], **keys), swing(duration=duration))
    assert {kind for kind in ("velocity", "acceleration") if not getattr(certificate, kind).kept} == kinds
    assert certificate.safe == certificate.verified == (not kinds)
    for kind in kinds:
        assert any("joint1" in problem and kind in problem for problem in certificate.problems)


def test_every_use_of_a_limit_in_a_certificate_is_named() -> None:
    """Legs, plan files and verdicts know a limit by its name."""
    uses = {field.name for field in fields(Certificate) if "LimitUse" in str(field.type)}
    assert uses == set(get_args(LimitName))


def test_a_position_outside_the_limits_is_reported_with_joint_and_time(backhoe: bp.Robot) -> None:
    low, high = backhoe.limits.lower[2], backhoe.limits.upper[2]
    inside, outside = np.array([0.0, 0.3, high, -1.0]), np.array([0.0, 0.3, high + 0.02, -1.0])
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(backhoe.joint_names, inside.tolist(), strict=True))},
            "task": {"goal": {"position": [3.0, 0.0, 0.0]}},
        }
    )
    kept = certify(backhoe, scene, straight(inside, np.array([0.0, 0.3, low, -1.0]), 60.0))
    assert kept.position.kept
    broken = certify(backhoe, scene, straight(inside, outside, 60.0))
    assert not broken.position.kept
    assert broken.position.joint == "stick"
    assert broken.position.ratio == pytest.approx(1.02)
    assert broken.position.time == 60.0
    assert any("stick" in problem and "position" in problem for problem in broken.problems)


def test_a_motion_must_end_at_the_goal_and_begin_at_the_start(planar4: bp.Robot) -> None:
    short = certify(planar4, site([]), swing(angle=1.3))
    assert short.safe
    assert not short.verified
    missing = 2.0 * 4.0 * np.sin(0.05)
    assert short.tracking.max_error == pytest.approx(missing)
    assert f"{missing:.3f} m" in short.problems[0]
    elsewhere = certify(planar4, site([], q_start=np.array([0.1, 0.0, 0.0, 0.0])), swing())
    assert any("start" in problem for problem in elsewhere.problems)


def test_a_motion_with_another_number_of_joints_is_refused(planar4: bp.Robot) -> None:
    with pytest.raises(bp.InputError):
        certify(planar4, site([]), Trajectory.from_steps(np.arange(2.0), np.zeros((2, 3))))


# --- one segment ------------------------------------------------------------------


def test_segment_is_clear_agrees_with_sampled_distances(planar4: bp.Robot) -> None:
    rng = np.random.default_rng(7)
    spots = rng.uniform(-3.0, 3.0, (5, 2))
    radii = rng.uniform(0.1, 0.4, 5)
    obstacles = [
        {"name": f"ball {k}", "shape": "sphere", "radius": float(radii[k]), "position": [*spots[k].tolist(), 0.0]}
        for k in range(5)
    ]
    proximity = bp.Proximity(planar4, build_problem(planar4, site(obstacles, clearance=0.05)).obstacles)
    clear = blocked = roomy = 0
    part = np.linspace(0.0, 1.0, 60)[:, None]
    for _ in range(250):
        q_a = rng.uniform(-2.5, 2.5, 4)
        q_b = q_a + rng.uniform(-1.0, 1.0, 4) * rng.choice([0.02, 0.1, 0.4])
        q = (1.0 - part) * q_a + part * q_b
        balls = min(float(np.min(link_distances(q, np.array([*spots[k], 0.0])))) - radii[k] - 0.05 for k in range(5))
        itself = min(
            float(np.min((proximity.distances(row) - proximity.clearance)[proximity.owner < 0])) for row in q[::6]
        )
        said = segment_is_clear(proximity, q_a, q_b)
        if min(balls, itself) < 0.0:
            assert not said
            blocked += 1
        else:
            clear += said
        # 2^6 pieces: each bound is exact to 1/64 of the motion, at most 4 joints * 4 m * 0.4 rad / 64 / 2
        if min(balls, itself) > 0.06:
            assert said
            roomy += 1
    assert clear > 50
    assert blocked > 50
    assert roomy > 30


def test_segment_is_clear_checks_between_its_ends(planar4: bp.Robot) -> None:
    pole = {"name": "pole", "shape": "cylinder", "radius": 0.002, "length": 1.0, "position": [2.0, 2.0, 0.0]}
    proximity = bp.Proximity(planar4, build_problem(planar4, site([pole])).obstacles)
    far = np.array([1.4, 0.0, 0.0, 0.0])
    assert not segment_is_clear(proximity, STILL, far)
    assert segment_is_clear(proximity, STILL, np.array([0.7, 0.0, 0.0, 0.0]))


def test_segment_is_clear_respects_motion_and_appearance_of_obstacles(planar4: bp.Robot) -> None:
    crossing = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [2.5, -3.0, 0.0], "velocity": [0, 0.6, 0]}
    proximity = bp.Proximity(planar4, build_problem(planar4, site([crossing])).obstacles)
    assert segment_is_clear(proximity, STILL, STILL, time=0.0, dt=4.0)
    assert not segment_is_clear(proximity, STILL, STILL, time=0.0, dt=10.0)
    assert segment_is_clear(proximity, STILL, STILL, time=6.0, dt=4.0)
    late = bp.Proximity(planar4, build_problem(planar4, site([ball(0.0, at=2.5, appears_at=5.0)])).obstacles)
    assert segment_is_clear(late, STILL, STILL, time=0.0, dt=4.9)
    assert not segment_is_clear(late, STILL, STILL, time=0.0, dt=5.1)


def test_distances_are_proven_also_beyond_the_limit_of_a_slide(tmp_path: Path) -> None:
    """1 m beyond its limit a ball of 0.1 m swings through one of 0.1 m, both 1.5 m from the hinge: 0.2 m deep."""
    path = tmp_path / "slide.urdf"
    path.write_text(TURNING_SLIDE)
    robot, out, angle = bp.load_robot(path), 1.5, 0.4
    post = {
        "name": "ball", "shape": "sphere", "radius": 0.1, "position": [out * np.cos(angle), out * np.sin(angle), 0.0],
    }  # fmt: skip
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"turn": 0.0, "slide": out}},
            "task": {"goal": {"position": [0.3, 0.0, 0.0]}},
            "clearance": 0.0,
            "obstacles": [post],
        }
    )
    motion = straight(np.array([0.0, out]), np.array([0.9, out]))
    ends = [2.0 * out * np.sin(0.5 * turned) - 0.2 for turned in (angle, 0.9 - angle)]
    assert min(ends) > 0.3  # clear at both samples
    certificate = certify(robot, scene, motion)
    assert not certificate.safe
    assert_proven(to(certificate), -0.2)


def test_memory_does_not_grow_with_samples_times_pairs(planar4: bp.Robot) -> None:
    far = [ball(0.01 * k, at=50.0) | {"name": f"ball {k}"} for k in range(150)]
    scene, motion = site(far), swing(samples=1001)
    pairs = len(far) * len([piece for piece in planar4.pieces if piece.joint > 0])
    tracemalloc.start()
    try:
        certify(planar4, scene, motion)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 8 * pairs * len(motion.time)  # bytes of one number each


def test_the_torque_to_hold_a_load_is_compared_with_the_limit_of_its_direction(backhoe: bp.Robot) -> None:
    """At rest, use over limit is torque over torque, both of which the certificate gives."""
    names = backhoe.joint_names
    for q in (np.array([0.0, 0.2, -1.4, -0.9]), np.array([0.3, -0.6, -0.6, -0.4])):
        joints = {"joints": dict(zip(names, q.tolist(), strict=True))}
        scene = bp.scene_from_dict({"version": 1, "start": joints, "task": {"goal": joints}, "payload": 500.0})
        use = certify(backhoe, scene, straight(q, q, 1.0)).effort
        assert use is not None
        assert use.unit == "N m"
        assert use.ratio == pytest.approx(abs(use.needed) / use.available, rel=1e-9)
        assert use.at_rest == pytest.approx(use.ratio, rel=1e-9)


def test_the_speed_of_rods_is_compared_with_the_limit_of_its_direction(backhoe: bp.Robot) -> None:
    """The boom alone at 0.1 rad/s up or down: what is needed is its rate."""
    q, names = np.array([0.0, 0.2, -1.4, -0.9]), backhoe.joint_names
    strong = replace(backhoe, hydraulics=replace(backhoe.hydraulics, pump_flow=1.0, engine_power=1e6))  # type: ignore[type-var]
    for way in (0.1, -0.1):
        start, end = ({"joints": dict(zip(names, (q + k * np.eye(4)[1]).tolist(), strict=True))} for k in (0.0, way))
        scene = bp.scene_from_dict({"version": 1, "start": start, "task": {"goal": end}})
        use = certify(strong, scene, straight(q, q + way * np.eye(4)[1], 1.0)).hydraulics
        assert use is not None
        assert (use.kind, use.joint) == ("rod speed", "boom")
        assert use.needed == pytest.approx(0.1, rel=0.02)  # the lever changes a little on the way


def test_the_force_of_a_slide_is_in_newtons(tmp_path: Path) -> None:
    """A mass of 20 kg on a vertical slide weighs 196.2 N."""
    (tmp_path / "lift.urdf").write_text(LIFT)
    robot = bp.load_robot(tmp_path / "lift.urdf")
    joints = {"joints": {"lift": 0.5}}
    scene = bp.scene_from_dict({"version": 1, "start": joints, "task": {"goal": joints}})
    use = certify(robot, scene, straight(np.array([0.5]), np.array([0.5]), 1.0)).effort
    assert use is not None
    assert use.unit == "N"
    assert use.needed == pytest.approx(20.0 * 9.81)
    assert use.available == 400.0
