"""The fundamental earthmoving equation: by hand, by brute force, and on the machine."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Array
from backhoe_planner.machine import Kinematics
from backhoe_planner.site import (
    LIP,
    GroundContact,
    LevelGround,
    Soil,
    SoilReaction,
    blade_force,
    bucket_width,
    failure_angle,
    soil_force,
)

SOILS = {
    "the default": Soil(),
    "dry sand": Soil(density=1500.0, cohesion=0.0, friction=0.6),
    "clay": Soil(density=1900.0, cohesion=30e3, friction=0.2, adhesion=10e3, tool_friction=0.1),
    "loaded ground": Soil(density=1700.0, cohesion=2e3, friction=0.5, surcharge=10e3),
    "no friction": Soil(density=1800.0, cohesion=20e3, friction=1e-3, adhesion=5e3, tool_friction=0.0),
    "very steep friction": Soil(density=1700.0, cohesion=1e3, friction=1.5),
}


def terms(soil: Soil, depth: float, rake: float, beta: Array, width: float) -> Array:
    """F term by term as in the textbook."""
    phi = soil.friction
    delta = 2.0 / 3.0 * phi if soil.tool_friction is None else soil.tool_friction

    def cot(angle: Any) -> Any:
        return 1.0 / np.tan(angle)

    D = np.cos(rake + delta) + np.sin(rake + delta) * cot(beta + phi)
    n_gamma = (cot(rake) + cot(beta)) / (2.0 * D)
    n_c = (1.0 + cot(beta) * cot(beta + phi)) / D
    n_a = (1.0 - cot(rake) * cot(beta + phi)) / D
    force = (
        soil.density * 9.81 * depth**2 * n_gamma
        + soil.cohesion * depth * n_c
        + soil.surcharge * depth * 2.0 * n_gamma
        + soil.adhesion * depth * n_a
    )
    return np.asarray(np.where(D > 0.0, width * force, np.inf))


@pytest.mark.parametrize("soil", SOILS.values(), ids=SOILS.keys())
@pytest.mark.parametrize("depth", [0.01, pytest.param(0.2, marks=pytest.mark.long), 1.0])
def test_the_failure_angle_equals_that_of_brute_force(soil: Soil, depth: float) -> None:
    for rake in np.radians([15.0, 30.0, 45.0, 60.0]):
        delta = 2.0 / 3.0 * soil.friction if soil.tool_friction is None else soil.tool_friction
        widest = math.pi - rake - delta - soil.friction
        if rake > 0.9 * (math.pi - delta - soil.friction):
            continue  # no wedge can slide up so steep a blade
        beta = np.linspace(0.0, widest, 40_001)[1:-1]
        force = terms(soil, depth, rake, beta, 0.6)
        best = int(np.argmin(force))
        found = float(blade_force(np.array(depth), np.array(rake), soil, width=0.6))
        assert found == pytest.approx(force[best], rel=1e-6)
        assert found <= force[best] * (1.0 + 1e-12)
        assert float(failure_angle(np.array(depth), np.array(rake), soil)) == pytest.approx(beta[best], abs=1e-3)


def test_an_upright_smooth_blade_meets_rankines_passive_pressure() -> None:
    """alpha 90 deg, delta 0: F = w (gamma d^2 Kp / 2 + 2 c d sqrt Kp + q d Kp), beta = 45 deg - phi / 2."""
    phi, depth, width = 0.6, 0.4, 0.7
    soil = Soil(density=1600.0, cohesion=4e3, friction=phi, tool_friction=0.0, surcharge=3e3)
    Kp = math.tan(math.pi / 4.0 + phi / 2.0) ** 2
    expected = width * (0.5 * 1600.0 * 9.81 * depth**2 * Kp + 2.0 * 4e3 * depth * math.sqrt(Kp) + 3e3 * depth * Kp)
    upright = np.array(math.pi / 2.0)
    assert blade_force(np.array(depth), upright, soil, width=width) == pytest.approx(expected, rel=1e-12)
    assert failure_angle(np.array(depth), upright, soil) == pytest.approx(math.pi / 4.0 - phi / 2.0, abs=1e-12)


def test_the_force_grows_with_depth_cohesion_density_load_and_width() -> None:
    depth = np.linspace(0.0, 2.0, 201)
    rake = np.radians(50.0)
    plain = {"density": 1700.0, "cohesion": 5e3, "friction": 0.55}

    def force(width: float = 0.6, **keys: float) -> Array:
        return blade_force(depth, rake, Soil(**(plain | keys)), width=width)

    usual = force()
    assert usual[0] == 0.0
    assert np.all(np.diff(usual) > 0.0)
    for more in ({"density": 1900.0}, {"cohesion": 9e3}, {"friction": 0.65}, {"surcharge": 1e3}, {"adhesion": 2e3}):
        assert np.all(force(**more)[1:] > usual[1:]), more
    np.testing.assert_allclose(force(1.2), 2.0 * usual, rtol=1e-12)


def test_above_the_ground_there_is_no_force() -> None:
    np.testing.assert_array_equal(blade_force(np.array([-1.0, -1e-9, 0.0]), np.array(0.9), Soil(), width=0.6), 0.0)


def wedge(soil: Soil, depth: float, rake: float, slope: float, load: float) -> float:
    """F per width [N/m] from the equilibrium of the wedge on its two planes, for the plane with the least force.

    The wedge is drawn in the world, the ground rising by `slope`; the forces of blade and failure plane,
    of unknown size, balance its weight and load, cohesion and adhesion.
    """
    phi, delta = soil.friction, 2.0 / 3.0 * soil.friction

    def along(angle: Array) -> Array:
        return np.stack((np.cos(angle), np.sin(angle)), axis=-1)

    beta = np.linspace(0.05, np.pi - rake - delta - phi - 0.02, 200_001)
    blade, plane = depth / math.sin(rake), depth / np.sin(beta)  # lengths
    top = depth * (1.0 / math.tan(rake) + 1.0 / np.tan(beta))
    weight = 0.5 * soil.density * 9.81 * depth * top + (soil.surcharge + load) * top
    fixed = np.stack((np.zeros_like(beta), -weight), axis=-1)
    # the wedge slides up along the plane, so that cohesion pulls it back; adhesion pulls it down along the blade
    fixed -= (soil.cohesion * plane)[:, None] * along(beta + slope)
    up_blade = along(np.full_like(beta, np.pi - rake + slope))
    fixed -= soil.adhesion * blade * up_blade
    push = along(np.full_like(beta, 0.5 * np.pi - rake - delta + slope))
    reaction = along(beta + slope + 0.5 * np.pi + phi)
    F = -(fixed[:, 0] * reaction[:, 1] - fixed[:, 1] * reaction[:, 0]) / (
        push[:, 0] * reaction[:, 1] - push[:, 1] * reaction[:, 0]
    )
    return float(np.min(np.where(F > 0.0, F, np.inf)))


@pytest.mark.parametrize("name", ["the default", "dry sand", "loaded ground"])
@pytest.mark.parametrize("slope", [-0.3, 0.0, 0.3])
def test_on_a_slope_the_wedge_is_in_equilibrium(name: str, slope: float) -> None:
    soil = SOILS[name]
    for rake, load in ((0.6, 0.0), (0.9, 4e3)):
        expected = wedge(soil, 0.2, rake, slope, load)
        found = blade_force(np.array(0.2), np.array(rake), soil, width=0.6, slope=slope, surcharge=load)
        assert float(found) == pytest.approx(0.6 * expected, rel=1e-6)


def test_the_force_grows_with_the_slope_while_beta_plus_phi_plus_slope_is_below_90_deg() -> None:
    """dF/d sigma has the sign of cot(beta + phi) - tan sigma, since beta makes F least."""
    slope, rake, soil = np.linspace(-0.49, 0.5, 201), np.array(0.8), Soil()
    force = blade_force(np.array(0.2), rake, soil, width=0.6, slope=slope)
    room = 0.5 * math.pi - failure_angle(np.array(0.2), rake, soil, slope=slope) - soil.friction - slope
    grows = np.diff(force) > 0.0
    assert np.all(grows[room[1:] > 0.0])
    assert not np.any(grows[room[:-1] < 0.0])
    assert 20 < np.count_nonzero(grows) < 200


# --- the force on the teeth ----------------------------------------------------------------

OUT = np.array([1.0, 0.0, 0.0])
PITCH = -1.2  # the cutting plate then has a rake of 69.1 deg, its face towards the machine


def vectors(*parts: Any) -> Array:
    """(..., 3) from their components."""
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def push(soil: Soil, velocity: Any, *, depth: Any = 0.3, pitch: Any = PITCH, forward: Array = OUT) -> Array:
    position = vectors(4.0, 0.0, soil.surface - depth)
    return soil_force(position, np.array(velocity), pitch=np.array(pitch), forward=forward, soil=soil, width=0.6)


def test_the_force_on_a_level_cut_by_hand() -> None:
    soil = Soil(density=1700.0, cohesion=5e3, friction=0.55, tool_friction=0.35, adhesion=1e3)
    rake = math.pi - (LIP - PITCH)
    beta = np.linspace(0.05, 1.2, 1_000_001)
    F = float(np.min(terms(soil, 0.3, rake, beta, 0.6)))
    stuck = 1e3 * 0.6 * 0.3
    expected = [F * math.sin(rake + 0.35) + stuck / math.tan(rake), 0.0, -F * math.cos(rake + 0.35) + stuck]
    np.testing.assert_allclose(push(soil, [-5.0, 0.0, 0.0]), expected, rtol=1e-5, atol=1e-9)
    # draft of some 10 kN at 30 cm in loam: a machine that digs with 40 to 65 kN can do it
    assert 5e3 < expected[0] < 3e4


def test_the_force_turns_with_the_machine() -> None:
    turned = np.array([math.cos(0.7), math.sin(0.7), 0.0])
    straight = push(Soil(), [-0.5, 0.0, 0.0])
    again = push(Soil(), -0.5 * turned, forward=turned)
    np.testing.assert_allclose(again, straight[0] * turned + [0.0, 0.0, straight[2]], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("velocity", [[0, 0, 0.5], [0, 0, -0.5], [0, 0.5, 0], [0, 0, 0]])
def test_there_is_no_force_at_rest_or_for_motion_across_or_vertical(velocity: list[float]) -> None:
    np.testing.assert_array_equal(push(Soil(adhesion=1e3), velocity), 0.0)


@pytest.mark.parametrize(
    ("pitch", "rake"), [(PITCH, math.pi - LIP + PITCH), (-2.0, math.pi - LIP - 2.0), (1.2, 0.5 * math.pi)]
)
def test_a_bucket_moving_back_first_is_resisted_as_the_mirrored_plate_face_first(pitch: float, rake: float) -> None:
    """The face points inward below LIP and outward above it: the motion is away from the side it faces."""
    soil = Soil(density=1700.0, cohesion=5e3, friction=0.55, tool_friction=0.35)
    F = float(np.min(terms(soil, 0.3, rake, np.linspace(0.05, 1.2, 1_000_001), 0.6)))
    ahead = 1.0 if pitch < LIP else -1.0
    expected = [-ahead * F * math.sin(rake + 0.35), 0.0, -F * math.cos(rake + 0.35)]
    np.testing.assert_allclose(push(soil, [5.0 * ahead, 0.0, 0.0], pitch=pitch), expected, rtol=3e-3, atol=1e-9)


def test_a_blade_moving_within_its_plane_meets_no_resistance() -> None:
    np.testing.assert_allclose(push(Soil(), [-5.0, 0.0, 0.0], pitch=LIP - math.pi), 0.0, atol=1e-6)
    # turned out of its plane to either side, it does
    for turned in (-0.2, 0.2):
        assert push(Soil(), [-5.0, 0.0, 0.0], pitch=LIP - math.pi + turned)[0] > 100.0


def test_teeth_above_a_lowered_ground_surface_meet_no_force() -> None:
    np.testing.assert_array_equal(push(Soil(surface=-0.4), [-0.5, 0.0, 0.0], depth=-1e-6), 0.0)
    assert push(Soil(surface=-0.4), [-0.5, 0.0, 0.0], depth=0.1)[0] > 100.0


def drawn(count: int) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(21)
    position = rng.uniform([-6.0, -6.0, -3.0], [6.0, 6.0, 0.5], (count, 3))
    velocity = rng.normal(size=(count, 3)) * rng.choice([0.001, 0.1, 1.0], (count, 1))
    heading = rng.uniform(-math.pi, math.pi, count)
    forward = np.column_stack((np.cos(heading), np.sin(heading), np.zeros(count)))
    return position, velocity, rng.uniform(-math.pi, math.pi, count), forward


@pytest.mark.parametrize("soil", SOILS.values(), ids=SOILS.keys())
def test_the_soil_never_drives_the_motion(soil: Soil) -> None:
    position, velocity, pitch, forward = drawn(5000)
    force = soil_force(position, velocity, pitch=pitch, forward=forward, soil=soil, width=0.6)
    power = np.sum(force * velocity, axis=1)
    assert np.all(np.isfinite(force))
    scale = np.linalg.norm(force, axis=1) * np.linalg.norm(velocity, axis=1)
    assert np.all(power <= 1e-9 * np.maximum(scale, 1.0))
    assert np.count_nonzero(power < 0.0) > 500
    one = soil_force(position[7], velocity[7], pitch=pitch[7], forward=forward[7], soil=soil, width=0.6)
    np.testing.assert_allclose(one, force[7], rtol=1e-12, atol=1e-9)


def test_the_force_is_continuous_in_direction_depth_and_pitch() -> None:
    soil = Soil(adhesion=2e3)
    largest = np.linalg.norm(push(soil, [-1.0, 0.0, 0.0]))
    paths = [
        push(soil, vectors(np.linspace(-0.2, 0.2, 8001), 0.0, -0.1)),
        push(soil, vectors(-0.3, 0.0, np.linspace(-2.0, 2.0, 8001))),
        push(soil, [-0.3, 0.0, -0.1], depth=np.linspace(-0.1, 0.3, 8001)),
        push(soil, [-0.3, 0.0, 0.0], pitch=np.linspace(-math.pi, math.pi, 16001)),
        push(soil, [0.3, 0.0, 0.1], pitch=np.linspace(-math.pi, math.pi, 16001)),
    ]
    for path in paths:
        assert path.shape[0] > 8000
        assert np.max(np.linalg.norm(np.diff(path, axis=0), axis=1)) < 0.05 * largest


def test_with_negligible_weight_the_force_turns_with_the_slope() -> None:
    """Without weight no direction is vertical: ground, blade and force turn together."""
    soil, slope, depth = Soil(density=100.0, cohesion=1e8, adhesion=1e3), 0.25, 0.3
    level = push(soil, [-5.0, 0.0, 0.0], depth=depth)
    contact = GroundContact(np.array(depth / math.cos(slope)), np.array([-math.tan(slope), 0.0]))
    speed = 5.0 * np.array([-math.cos(slope), 0.0, math.sin(slope)])
    tilted = soil_force(
        np.zeros(3), speed, pitch=np.array(PITCH - slope), forward=OUT, soil=soil, width=0.6, contact=contact
    )
    turned = np.array([
        level[0] * math.cos(slope) + level[2] * math.sin(slope), 0.0,
        -level[0] * math.sin(slope) + level[2] * math.cos(slope),
    ])  # fmt: skip
    np.testing.assert_allclose(tilted, turned, rtol=1e-5, atol=1e-6 * float(np.linalg.norm(level)))


# --- on the machine ------------------------------------------------------------------------


def test_the_soil_width_is_that_of_the_bucket(backhoe: bp.Robot) -> None:
    assert bucket_width(backhoe) == pytest.approx(0.61, abs=1e-9)


def test_a_bucket_without_a_shape_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "bare.urdf").write_text(
        """<robot name="bare"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>
        <child link="b"/><axis xyz="0 -1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>""",
        encoding="utf-8",
    )
    robot = bp.load_robot(tmp_path / "bare.urdf", tip="b")
    with pytest.raises(bp.InputError, match=r"soil\.width: .* no collision shape"):
        bucket_width(robot)


def test_soil_for_an_arm_without_a_pitch_is_an_error(planar4: bp.Robot) -> None:
    with pytest.raises(bp.InputError, match="soil: "):
        SoilReaction(planar4, Soil())


def test_the_power_of_the_joint_torques_equals_that_of_the_force(backhoe: bp.Robot) -> None:
    rng = np.random.default_rng(22)
    reaction = SoilReaction(backhoe, Soil(surface=1.0))
    q = np.array([backhoe.random_q(rng) for _ in range(200)])
    v = rng.normal(size=q.shape)
    force, torque = reaction.force(q, v), reaction.torques(q, v)
    kinematics = Kinematics(backhoe)
    tip = np.array([kinematics.at(own).jacobian[:3] @ rate for own, rate in zip(q, v, strict=True)])
    given, taken = np.sum(torque * v, axis=1), np.sum(force * tip, axis=1)
    np.testing.assert_allclose(given, taken, rtol=1e-9, atol=1e-6)
    assert np.all(given <= 1e-6)
    assert np.count_nonzero(given < -100.0) > 20
    np.testing.assert_array_equal(reaction.force(q[3], v[3]), force[3])


def test_dragging_the_bucket_in_and_pushing_it_out_are_resisted(backhoe: bp.Robot) -> None:
    q = np.array([0.6, -0.4, -1.0, 0.2])
    at = Kinematics(backhoe).at(q)
    assert at.tip_position[2] < -0.6
    assert at.pitch == pytest.approx(-1.2)
    inward = -np.array([math.cos(0.6), math.sin(0.6), 0.0])
    wanted = np.append(0.3 * inward, 0.0)
    v = np.linalg.pinv(np.vstack((at.jacobian[:3], at.pitch_row))) @ wanted
    reaction = SoilReaction(backhoe, Soil())
    force = reaction.force(q, v)
    assert force @ inward < -1e4
    np.testing.assert_allclose(np.cross(force - [0.0, 0.0, force[2]], inward), 0.0, atol=1e-6)
    assert reaction.force(q, -v) @ -inward == pytest.approx(force @ inward, rel=0.01)


class Slanted:
    """Ground that falls away from the machine, with a load in the bucket."""

    def __init__(self, held: float, held_at: Array | None) -> None:
        self.held, self.held_at = held, held_at

    def depth(self, r: Any) -> Any:
        return 0.1 + 0.2 * (4.0 - r)

    def contact(self, tip_position: Array) -> GroundContact:
        depth = self.depth(tip_position[..., 0]) + 0.0 * tip_position[..., 2]
        return GroundContact(depth=depth, held=np.full(np.shape(depth), self.held))


def test_level_ground_as_an_object_gives_the_same_torques(backhoe: bp.Robot) -> None:
    rng = np.random.default_rng(23)
    q = np.array([backhoe.random_q(rng) for _ in range(50)])
    v = rng.normal(size=q.shape)
    by_soil = SoilReaction(backhoe, Soil(surface=0.7)).torques(q, v)
    np.testing.assert_array_equal(SoilReaction(backhoe, Soil(), LevelGround(0.7)).torques(q, v), by_soil)


def test_the_load_in_the_bucket_weighs_at_its_centre(backhoe: bp.Robot) -> None:
    """The torque is the gradient of the potential energy of a mass at that point of the bucket, by differences."""
    rng = np.random.default_rng(24)
    q = backhoe.random_q(rng)
    at = np.array([0.45, 0.0, 0.16])

    def torque(mass: float, held_at: Array | None) -> Array:
        return SoilReaction(backhoe, Soil(), Slanted(mass, held_at)).torques(q, np.zeros(4))

    def height(q: Array, held_at: Array) -> float:
        kinematics = Kinematics(backhoe).at(q)
        return float(kinematics.points[-2][2] + kinematics.tip_rotation[2] @ held_at)

    for held_at, point in ((at, at), (None, np.array([0.95, 0.0, 0.0]))):
        slope = [(height(q + e, point) - height(q - e, point)) / 2e-6 for e in 1e-6 * np.eye(4)]
        found = torque(300.0, held_at) - torque(0.0, held_at)
        np.testing.assert_allclose(found, -300.0 * 9.81 * np.array(slope), atol=1e-4)


def test_the_work_of_a_straight_cut_is_the_integral_of_the_draft(backhoe: bp.Robot) -> None:
    """Along a level line of 1 m through ground of growing depth, at one pitch: sum of tau dq against quadrature."""
    from scipy.integrate import quad

    from backhoe_planner.machine import TargetBatch, TipTarget, solve_batch

    soil, ground = Soil(cohesion=8e3, surcharge=1e3), Slanted(0.0, None)
    r = np.linspace(4.0, 3.0, 401)
    targets = TargetBatch.of([TipTarget(np.array([x, 0.0, -0.4]), pitch=(PITCH, PITCH)) for x in r])
    reaction = SoilReaction(backhoe, soil, ground)
    q, reached = solve_batch(reaction._kinematics, targets, np.tile([0.0, -0.3, -1.3, 0.4], (401, 1)), tolerance=1e-11)
    assert reached.all()
    torque = reaction.torques(q, np.gradient(q, r, axis=0) * -1.0)
    work = float(np.sum(0.5 * (torque[1:] + torque[:-1]) * np.diff(q, axis=0)))
    rake, delta = math.pi - (LIP - PITCH), 2.0 / 3.0 * soil.friction

    def draft(x: float) -> float:
        F = blade_force(np.array(ground.depth(x)), np.array(rake), soil, width=0.61)
        return float(F) * math.sin(rake + delta)

    expected = quad(draft, 3.0, 4.0, epsabs=1e-9)[0]
    assert -work == pytest.approx(expected, rel=1e-4)  # creeping soil is 5e-5 short of its full force at 1 m/s


def test_a_friction_angle_of_a_right_angle_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    for friction in ("1.5707963267948966", "90"):
        file.write_text(
            "version: 1\nstart: {joints: {}}\ntask: {goal: {position: [1, 2, 3]}}\n"
            f"soil: {{friction: {friction}}}\n",
            encoding="utf-8",
        )
        with pytest.raises(bp.SceneError) as caught:
            bp.load_scene(file)
        message = str(caught.value)
        for part in (str(file), "soil.friction (line 4)", "less than 1.57", f"found {friction}"):
            assert part in message
