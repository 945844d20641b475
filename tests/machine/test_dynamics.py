"""Torque, power and energy of a motion: a pendulum by hand, balances of energy, and Pinocchio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from machines import LENGTH, MASS, PENDULUM

import backhoe_planner as bp
from backhoe_planner.arrays import Array
from backhoe_planner.machine import GRAVITY, Dynamics, Kinematics, motion_energy
from backhoe_planner.machine.dynamics.chain_dynamics import Chain, chain_energies, chain_torque_slopes, chain_torques
from backhoe_planner.native import plain_versions
from backhoe_planner.site import Soil, SoilReaction

RAM = {
    "version": 1,
    "pump": {"flow": 1e-3, "pressure": 4e7},
    "engine": {"power": 2e4},
    "cylinders": [
        {"name": "ram", "joint": "hinge", "bore": 0.1, "rod": 0.06, "closed": 0.26, "open": 0.68,
         "parent": [0.0, 0.0, 1.7], "child": [0.4, 0.0, 0.0]},
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> bp.Robot:
    folder: Path = tmp_path_factory.mktemp("pendulum")
    (folder / "pendulum.urdf").write_text(PENDULUM, encoding="utf-8")
    (folder / "pendulum.hydraulics.yaml").write_text(yaml.safe_dump(RAM), encoding="utf-8")
    return bp.load_robot(folder / "pendulum.urdf", tip="end")


def smooth(start: Array, end: Array, duration: float, count: int = 2001) -> tuple[Array, Array, Array, Array]:
    """Time, q, v, a from rest to rest, exact derivatives."""
    time = np.linspace(0.0, duration, count)
    s = time / duration
    move = (np.asarray(end) - start)[None, :]
    q = start + (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None] * move
    v = (30.0 * s**2 * (1.0 - s) ** 2 / duration)[:, None] * move
    a = (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration**2)[:, None] * move
    return time, q, v, a


def wave(robot: bp.Robot, count: int = 4001) -> tuple[Array, Array, Array, Array]:
    """All joints swinging at their own frequencies, exact derivatives."""
    time = np.linspace(0.0, 3.0, count)
    middle = robot.middle
    size = 0.3 * np.minimum(robot.limits.upper - middle, 2.0)
    w = np.arange(1.0, robot.n + 1.0)
    angle = time[:, None] * w
    return time, middle + size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)


def test_lifting_a_pendulum_costs_m_g_h(pendulum: bp.Robot) -> None:
    time, q, v, a = smooth(np.array([-0.7]), np.array([0.8]), 60.0)
    energy = motion_energy(pendulum, time, q=q, v=v, a=a)
    height = LENGTH * (np.sin(0.8) - np.sin(-0.7))
    assert energy.work[-1] == pytest.approx(MASS * GRAVITY * height, rel=1e-3)
    assert energy.potential[-1] == pytest.approx(MASS * GRAVITY * height, rel=1e-9)
    # one cylinder: the pump needs no more pressure than the load
    assert energy.hydraulic is not None
    assert energy.hydraulic[-1] == pytest.approx(energy.work[-1], rel=1e-6)


def test_lifting_a_pendulum_with_a_payload_costs_its_weight_too(pendulum: bp.Robot) -> None:
    time, q, v, a = smooth(np.array([-0.7]), np.array([0.8]), 60.0)
    height = LENGTH * (np.sin(0.8) - np.sin(-0.7))
    work = motion_energy(pendulum, time, q=q, v=v, a=a, payload=200.0).work[-1]
    assert work == pytest.approx((MASS + 200.0) * GRAVITY * height, rel=1e-3)


def test_lowering_a_pendulum_takes_no_energy_and_returns_none(pendulum: bp.Robot) -> None:
    time, q, v, a = smooth(np.array([0.8]), np.array([-0.7]), 60.0)
    energy = motion_energy(pendulum, time, q=q, v=v, a=a)
    height = LENGTH * (np.sin(0.8) - np.sin(-0.7))
    assert energy.work[-1] == 0.0
    assert energy.hydraulic is not None
    assert energy.hydraulic[-1] == 0.0
    assert np.trapezoid(energy.joint_power[:, 0], time) == pytest.approx(-MASS * GRAVITY * height, rel=1e-3)


def test_the_torque_of_a_level_pendulum_with_a_force_at_the_tip_by_hand(pendulum: bp.Robot) -> None:
    """At rest and level, a push up of 1 kN at 2 m takes 2 kN m off the 5886 N m of the weight."""
    level = np.zeros(1)
    torque = Dynamics(pendulum).torques(level, level, level, tip_force=np.array([500.0, 300.0, 1000.0]))
    assert torque == pytest.approx([MASS * GRAVITY * LENGTH - 2000.0])


@pytest.mark.parametrize("payload", [0.0, 250.0])
@pytest.mark.parametrize("name", ["backhoe", "planar4", "panda"])
def test_power_integrates_to_the_change_of_energy(name: str, payload: float, request: pytest.FixtureRequest) -> None:
    robot: bp.Robot = request.getfixturevalue(name)
    time, q, v, a = wave(robot)
    energy = motion_energy(robot, time, q=q, v=v, a=a, payload=payload)
    given = np.trapezoid(np.sum(energy.joint_power, axis=1), time)
    gained = energy.kinetic[-1] - energy.kinetic[0] + energy.potential[-1]
    assert given == pytest.approx(gained, rel=1e-5, abs=1e-5 * energy.work[-1])
    assert np.all(np.diff(energy.work) >= 0.0)
    assert energy.work[-1] >= given
    assert (energy.hydraulic is None) == (name != "backhoe")


def digging(backhoe: bp.Robot) -> tuple[tuple[Array, Array, Array, Array], Array, Array]:
    """A drag of the bucket below the ground: its motion, the soil's force, and the tip's velocity."""
    motion = smooth(np.array([0.2, -0.5, -0.8, -0.2]), np.array([0.2, -0.35, -1.7, -0.6]), 6.0)
    _, q, v, _ = motion
    kinematics = Kinematics(backhoe)
    tip = np.array([kinematics.at(own).jacobian[:3] @ rate for own, rate in zip(q, v, strict=True)])
    return motion, SoilReaction(backhoe, Soil()).force(q, v), tip


def test_digging_takes_additionally_the_work_done_on_the_soil(backhoe: bp.Robot) -> None:
    (time, q, v, a), force, tip = digging(backhoe)
    free = motion_energy(backhoe, time, q=q, v=v, a=a)
    held = motion_energy(backhoe, time, q=q, v=v, a=a, tip_force=force)
    taken = -np.trapezoid(np.sum(force * tip, axis=1), time)
    more = np.trapezoid(np.sum(held.joint_power - free.joint_power, axis=1), time)
    assert taken > 1e4
    assert more == pytest.approx(taken, rel=1e-9)
    assert held.work[-1] > free.work[-1]


def test_a_load_sensing_pump_delivers_at_least_the_work(backhoe: bp.Robot) -> None:
    (time, q, v, a), force, _ = digging(backhoe)
    energy = motion_energy(backhoe, time, q=q, v=v, a=a, payload=200.0, tip_force=force)
    assert energy.hydraulic_power is not None
    assert energy.hydraulic is not None
    assert np.all(energy.hydraulic_power >= energy.power * (1.0 - 1e-9) - 1e-9)
    assert energy.hydraulic[-1] > 1.05 * energy.work[-1]  # three functions at once, at one pressure


def test_torques_with_a_force_at_the_tip_equal_pinocchios(any_robot: bp.Robot) -> None:
    model = any_robot.model
    data = model.createData()
    rng = np.random.default_rng(31)
    frame = model.frames[any_robot.tip_frame]
    for _ in range(20):
        q, (v, a), force = any_robot.random_q(rng), rng.normal(size=(2, any_robot.n)), 1e3 * rng.normal(size=3)
        pin.framesForwardKinematics(model, data, q)
        at_tip = pin.SE3(data.oMi[frame.parentJoint].rotation, data.oMf[any_robot.tip_frame].translation)
        # the same force, in the axes of the joint that carries the tip, then moved to its origin
        local = at_tip.rotation.T @ force
        arm = data.oMi[frame.parentJoint].actInv(at_tip.translation)
        outside = pin.StdVec_Force()
        for joint in range(model.njoints):
            outside.append(pin.Force(local, np.cross(arm, local)) if joint == frame.parentJoint else pin.Force.Zero())
        expected = pin.rnea(model, data, q, v, a, outside)
        found = Dynamics(any_robot).torques(q, v, a, tip_force=force)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-8)


def test_torques_along_a_motion_equal_those_of_each_sample(panda: bp.Robot) -> None:
    rng = np.random.default_rng(3)
    q, v, a = rng.normal(size=(3, 20, panda.n))
    dynamics = Dynamics(panda, payload=2.0)
    each = [dynamics.torques(*moment) for moment in zip(q, v, a, strict=True)]
    np.testing.assert_allclose(dynamics.torques_along(q, v, a), each, rtol=1e-11, atol=1e-11)
    assert dynamics.torques_along(q[:0], v[:0], a[:0]).shape == (0, panda.n)


@pytest.mark.parametrize("payload", [0.0, 40.0])
def test_the_derivatives_of_torques_agree_with_central_differences(any_robot: bp.Robot, payload: float) -> None:
    rng = np.random.default_rng(4)
    q = np.array([any_robot.random_q(rng) for _ in range(3)])
    dynamics = Dynamics(any_robot, payload=payload)
    at = [q, rng.normal(size=q.shape), rng.normal(size=q.shape)]
    torque, slopes = dynamics.torque_slopes(*at)
    np.testing.assert_allclose(torque, dynamics.torques_along(*at), rtol=1e-12, atol=1e-9)
    n, nudge = any_robot.n, 1e-5
    for column in range(3 * n):
        ends = []
        for sign in (1.0, -1.0):
            moved = [each.copy() for each in at]
            moved[column // n][:, column % n] += sign * nudge
            ends.append(dynamics.torques_along(*moved))
        expected = (ends[0] - ends[1]) / (2.0 * nudge)
        np.testing.assert_allclose(slopes[:, :, column], expected, atol=1e-6 * (1.0 + float(np.max(np.abs(slopes)))))


@pytest.mark.parametrize("payload", [0.0, 40.0])
def test_torques_slopes_and_energies_of_a_chain_equal_pinocchios(any_robot: bp.Robot, payload: float) -> None:
    """Of both versions, the plain one and the one that runs."""
    rng, dynamics = np.random.default_rng(8), Dynamics(any_robot, payload=payload)
    q, v, a = rng.normal(size=(3, 6, any_robot.n))
    model = dynamics._model
    data, chain = model.createData(), Chain.of(any_robot, model)
    torques = [pin.rnea(model, data, *moment).copy() for moment in zip(q, v, a, strict=True)]
    slopes = []
    for moment in zip(q, v, a, strict=True):
        of_q, of_v, M = pin.computeRNEADerivatives(model, data, *moment)
        M = np.reshape(M, (any_robot.n, any_robot.n))
        slopes.append(np.hstack((np.reshape(of_q, M.shape), np.reshape(of_v, M.shape), np.triu(M) + np.triu(M, 1).T)))
    kinetic = [pin.computeKineticEnergy(model, data, *moment) for moment in zip(q, v, strict=True)]
    lifted = np.array([pin.computePotentialEnergy(model, data, row) for row in q])
    near = 1e-10 * float(np.abs(slopes).max())
    plain = plain_versions()
    for of_torques, of_slopes, of_energies in (
        (chain_torques, chain_torque_slopes, chain_energies),
        (plain["chain_torques"], plain["chain_torque_slopes"], plain["chain_energies"]),
    ):
        each, (with_slopes, found) = of_torques(q, v, a, *chain), of_slopes(q, v, a, *chain)
        moving, potential = of_energies(q, v, *chain)
        np.testing.assert_allclose(each, torques, rtol=1e-10, atol=near)
        np.testing.assert_allclose(with_slopes, torques, rtol=1e-10, atol=near)
        np.testing.assert_allclose(found, slopes, rtol=1e-10, atol=near)
        np.testing.assert_allclose(moving, kinetic, rtol=1e-10, atol=near)
        np.testing.assert_allclose(potential - potential[0], lifted - lifted[0], rtol=1e-10, atol=near)


def test_the_torques_of_a_slide_and_a_hinge_by_hand() -> None:
    """A slide along x carries a hinge about z at its end, with 2 kg at 3 m from it; gravity is along -y.

    With the hinge at 0 the mass lies on the x axis: turning at 5 rad/s needs a pull of 2 * 3 * 25 N, a slide at 7 m/s^2
    14 N the other way, an angular acceleration of 4 rad/s^2 of the mass and of 0.5 kg m^2 (18 + 0.5) * 4 N m, and the
    weight of 2 * 10 N at 3 m 60 N m.
    """
    still, z, y = np.eye(3), np.array([0.0, 0.0, 1.0]), np.array([0.0, 10.0, 0.0])
    skew = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    own = [
        np.column_stack((still, K, K @ K, axis, np.zeros(3))).T.ravel()
        for K, axis in ((0.0 * skew, still[0]), (skew, z))
    ]
    bodies = np.zeros((2, 10))
    bodies[1] = 2.0, 3.0, 0.0, 0.0, 0.1, 0.0, 0.2, 0.0, 0.0, 0.5
    chain = np.array(own).T.copy(), np.array([1.0, 0.0]), bodies, -y
    q, v, a = (np.array([row]) for row in ([0.3, 0.0], [1.0, 5.0], [7.0, 4.0]))
    np.testing.assert_allclose(chain_torques(q, v, a, *chain), [[14.0 - 150.0, 74.0 + 60.0]], atol=1e-12)
    torque, slopes = chain_torque_slopes(q, v, a, *chain)
    np.testing.assert_allclose(torque, [[-136.0, 134.0]], atol=1e-12)
    # by the slide's position: nothing. By the hinge's: the x force is -6 (25 cos + 4 sin), the moment 60 cos - 42 sin
    np.testing.assert_allclose(slopes[0, :, :2], [[0.0, -24.0], [0.0, -42.0]], atol=1e-12)
    np.testing.assert_allclose(slopes[0, :, 2:4], [[0.0, -2.0 * 6.0 * 5.0], [0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(slopes[0, :, 4:], [[2.0, 0.0], [0.0, 18.5]], atol=1e-12)
    kinetic, potential = chain_energies(q, v, *chain)
    assert kinetic == pytest.approx([0.5 * 2.0 * (1.0 + 15.0**2) + 0.5 * 0.5 * 25.0])
    assert potential == pytest.approx([0.0], abs=1e-12)
