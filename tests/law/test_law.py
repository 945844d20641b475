"""Equations (3) to (5), (10) to (12), against hand calculations and the literature."""

from __future__ import annotations

import numpy as np
import pytest

from backhoe_planner.arrays import Vector
from backhoe_planner.law import (
    Reference,
    general_solution,
    joint_velocity,
    link_chain,
    link_jacobian,
    null_space_term,
    projector,
)
from backhoe_planner.machine import Kinematics, Robot

# Two joints, one task row: both joints add up in it.
J_E = np.array([[1.0, 1.0]])
XDOT_E = np.array([2.0])
J_O = np.array([[1.0, 0.0]])
XDOT_O = np.array([3.0])


def well_conditioned(robot: Robot, count: int) -> list[Vector]:
    """Seeded configurations away from singularities of the tip's position."""
    rng, kinematics = np.random.default_rng(1), Kinematics(robot)
    found: list[Vector] = []
    while len(found) < count:
        q = robot.random_q(rng)
        s = np.linalg.svd(kinematics.at(q).jacobian[:3], compute_uv=False)
        if s[s > 1e-9].min() > 0.1:
            found.append(q)
    return found


def test_the_law_for_two_joints_equals_a_hand_calculation() -> None:
    """J_e^+ = (1/2, 1/2), N = ((1, -1), (-1, 1)) / 2, J_o N = (1, -1) / 2, H_o = (1, -1) (3 - 1)."""
    np.testing.assert_allclose(projector(J_E), [[0.5, -0.5], [-0.5, 0.5]], atol=1e-15)
    np.testing.assert_allclose(null_space_term(J_E, XDOT_E, J_O, XDOT_O), [2.0, -2.0], atol=1e-14)
    np.testing.assert_allclose(joint_velocity(J_E, XDOT_E, [(1.0, J_O, XDOT_O)]), [3.0, -1.0], atol=1e-14)
    gained = joint_velocity(J_E, XDOT_E, [(0.2, J_O, XDOT_O)], s_e=0.2)
    np.testing.assert_allclose(gained, [0.2 + 0.4, 0.2 - 0.4], atol=1e-14)


def test_equation_3_projects_any_z() -> None:
    """N subtracts the mean of z = (5, 1): (2, -2)."""
    np.testing.assert_allclose(general_solution(J_E, XDOT_E, np.array([5.0, 1.0])), [3.0, -1.0], atol=1e-14)


def test_without_null_space_terms_the_velocity_is_the_least_norm_solution(planar4: Robot) -> None:
    xdot = np.array([0.3, -0.2])
    for q in well_conditioned(planar4, 20):
        J = Kinematics(planar4).at(q).jacobian[:2]
        v = joint_velocity(J, xdot, [])
        np.testing.assert_allclose(v, np.linalg.lstsq(J, xdot, rcond=None)[0], atol=1e-10)


def test_equation_5_equals_that_of_maciejewski_and_klein(planar4: Robot) -> None:
    """With every gain 1: J_e^+ x_e + (J_o N)^+ (x_o - J_o J_e^+ x_e), their equation, which has no N in front."""
    rng = np.random.default_rng(2)
    for q in well_conditioned(planar4, 50):
        J_e = Kinematics(planar4).at(q).jacobian[:2]
        J_o, xdot_e, xdot_o = rng.normal(size=(1, 4)), rng.normal(size=2), rng.normal(size=1)
        inverse = np.linalg.pinv(J_e)
        theirs = inverse @ xdot_e + np.linalg.pinv(J_o @ (np.eye(4) - inverse @ J_e)) @ (
            xdot_o - J_o @ inverse @ xdot_e
        )
        ours = joint_velocity(J_e, xdot_e, [(1.0, J_o, xdot_o)])
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
        np.testing.assert_allclose(J_e @ ours, xdot_e, atol=1e-10)
        np.testing.assert_allclose(J_o @ ours, xdot_o, atol=1e-8)


@pytest.mark.parametrize("reference", ["tip_referenced", "standard"])
def test_no_null_space_term_moves_the_tip(any_robot: Robot, reference: Reference) -> None:
    rng, kinematics = np.random.default_rng(3), Kinematics(any_robot)
    for q in well_conditioned(any_robot, 20):
        at = kinematics.at(q)
        J_e = at.jacobian[:3]
        xdot_e = J_e @ rng.normal(size=any_robot.n)
        chain = link_chain(at)
        jacobians = [link_jacobian(chain, k, reference=reference) for k in range(1, any_robot.n)]
        jacobians.append(rng.normal(size=(3, any_robot.n)))
        for J in jacobians:
            H = null_space_term(J_e, xdot_e, J, rng.normal(size=3))
            assert np.max(np.abs(J_e @ H)) < 1e-10 * max(1.0, float(np.max(np.abs(H))))
        terms = [(0.01, J, rng.normal(size=3)) for J in jacobians[:2]]
        v = joint_velocity(J_e, xdot_e, terms, s_e=0.2)
        np.testing.assert_allclose(J_e @ v, 0.2 * xdot_e, atol=1e-8)


def test_a_point_that_the_null_space_cannot_move_has_no_term(planar4: Robot) -> None:
    """The tip itself as critical point: J_o N is 0 up to rounding, and so is its pseudo-inverse."""
    xdot = np.array([0.1, 0.2])
    for q in well_conditioned(planar4, 20):
        J_e = Kinematics(planar4).at(q).jacobian[:2]
        np.testing.assert_array_equal(null_space_term(J_e, xdot, J_e, np.array([1.0, -1.0])), np.zeros(4))


def test_the_term_of_a_point_near_the_tip_is_unbounded(planar4: Robot) -> None:
    """A tenth of the distance to the tip, ten times the rate."""
    at = Kinematics(planar4).at(np.array([0.3, 0.9, -1.1, 0.6]))
    J_e = at.jacobian[:2]
    line = at.points[4] - at.points[3]
    rates = []
    for short in (1e-2, 1e-3, 1e-4):
        point = at.points[4] - short * line
        J_o = (at.J_world[:3] + np.cross(at.J_world[3:].T, point).T)[:2]
        H = null_space_term(J_e, np.zeros(2), J_o, np.array([0.0, 1.0]))
        rates.append(float(np.max(np.abs(H))))
    assert rates[1] / rates[0] == pytest.approx(10.0, rel=0.1)
    assert rates[2] / rates[1] == pytest.approx(10.0, rel=0.01)
