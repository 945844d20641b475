"""Equations (6) to (9) and (13) to (18): the sense in which a link turns."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from backhoe_planner.arrays import Vector
from backhoe_planner.law import (
    LinkChain,
    Magnification,
    link_chain,
    link_jacobian,
    link_velocities,
)
from backhoe_planner.machine import Kinematics, Robot


def flat_chain(*points: tuple[float, float]) -> LinkChain:
    """An arm in the x-y plane, every joint about +z."""
    P = np.array([(x, y, 0.0) for x, y in points])
    n = len(P) - 1
    axes = np.tile([0.0, 0.0, 1.0], (n, 1))
    J_world = np.vstack((np.cross(P[:-1], axes).T, axes.T))
    return LinkChain(points=P, axes=axes, columns=np.cross(axes, P[-1] - P[:-1]), J_world=J_world)


# Boom up: link 1 is upright and 1 m long, the tip is 2 m beside its end. P_e^1 = (2, 0), M = 2.
BOOM_UP = flat_chain((0.0, 0.0), (0.0, 1.0), (2.0, 1.0))
BOOM_DOWN = flat_chain((0.0, 0.0), (0.0, 1.0), (-2.0, 1.0))


def turned(
    chain: LinkChain,
    xdot_e: ArrayLike,
    *,
    D: float = 1.0,
    magnification: Magnification = "printed",
    follow_bend: bool = False,
) -> Vector:
    count = len(chain.points) - 2
    found = link_velocities(
        chain, np.append(xdot_e, 0.0), D=np.full(count, D), magnification=magnification, follow_bend=follow_bend
    )
    np.testing.assert_array_equal(found[:, 2], 0.0)
    return found[:, :2]


@pytest.mark.parametrize(
    ("xdot_e", "turn"),
    [
        ((1.0, 1.0), np.arctan2(1.0, 3.0)),  # 1st quadrant: P_e^k + xdot_e = (3, 1)
        ((1.0, -1.0), np.arctan2(1.0, 3.0)),  # 4th
        ((-1.0, 1.0), -np.pi / 4),  # 2nd: (1, 1)
        ((-1.0, -1.0), -np.pi / 4),  # 3rd
        ((1.0, 0.0), 0.0),  # along P_e^k no turn is predicted
        ((-1.0, 0.0), 0.0),
    ],
)
def test_equation_13_equals_a_hand_calculation(xdot_e: tuple[float, float], turn: float) -> None:
    """Outward the link turns clockwise (its upper end to +x), inward counter-clockwise (Fig. 3)."""
    np.testing.assert_allclose(turned(BOOM_UP, xdot_e), [[turn / 2.0, 0.0]], atol=1e-15)
    scaled = turned(BOOM_UP, xdot_e, magnification="norm_preserving")
    np.testing.assert_allclose(scaled, [[turn * 2.0, 0.0]], atol=1e-15)


def test_the_directional_operator_flips_the_turn() -> None:
    np.testing.assert_array_equal(turned(BOOM_UP, (1.0, 1.0), D=-1.0), -turned(BOOM_UP, (1.0, 1.0)))
    np.testing.assert_array_equal(turned(BOOM_UP, (1.0, 1.0), D=0.0), [[0.0, 0.0]])


def test_outer_links_add_the_velocity_of_the_inner_ones() -> None:
    """xdot_2 = own turn + xdot_1, by hand: P_e^2 = (0, -1), ahead (1, -2), dtheta' = atan(1/2), M = 1/2."""
    chain = flat_chain((0.0, 0.0), (0.0, 1.0), (2.0, 1.0), (2.0, 0.0))
    found = turned(chain, (1.0, -1.0))
    # k = 1: P_e^1 = (2, -1), ahead (3, -2): cross -1, dot 8; M = sqrt(5)
    first = np.array([np.arctan2(1.0, 8.0) / np.sqrt(5.0), 0.0])
    # a x (2, 0) = (0, 2), clockwise
    second = first - np.arctan2(1.0, 2.0) / 0.5 * np.array([0.0, 2.0])
    np.testing.assert_allclose(found, [first, second], atol=1e-14)


def test_equation_16_holds_with_M_and_not_with_its_inverse() -> None:
    """A small step across P_e^1: |xdot_1| is |xdot_e| with M, and |xdot_e| / M^2 as printed."""
    step = 1e-6 * np.array([1e-4, 1.0])
    speed = float(np.linalg.norm(step))
    assert np.linalg.norm(turned(BOOM_UP, step, magnification="norm_preserving")) == pytest.approx(speed, rel=1e-6)
    assert np.linalg.norm(turned(BOOM_UP, step)) == pytest.approx(speed / 4.0, rel=1e-6)


def test_follow_bend_equals_the_printed_law_if_the_arm_bends_clockwise() -> None:
    for xdot_e in ((1.0, 1.0), (-0.3, 0.2)):
        np.testing.assert_array_equal(turned(BOOM_UP, xdot_e, follow_bend=True), turned(BOOM_UP, xdot_e))
        mirrored = (-xdot_e[0], xdot_e[1])
        np.testing.assert_array_equal(turned(BOOM_DOWN, mirrored, follow_bend=True), -turned(BOOM_DOWN, mirrored))


def test_follow_bend_predicts_the_real_turn_of_two_links() -> None:
    """With two links the geometry decides: if the tip moves outward the arm stretches."""
    arm = flat_chain((0.0, 0.0), (0.0, 1.0), (1.0, 1.0))
    outward = np.array([1.0, 0.0, 0.0]) + np.array([0.0, 0.01, 0.0])
    J = np.array(arm.columns[:, :2]).T
    v = np.linalg.solve(J, outward[:2])
    assert v[0] < 0.0  # the real link 1 turns clockwise
    predicted = turned(arm, outward[:2], follow_bend=True)[0]
    assert predicted[0] > 0.0  # and so does the predicted one: its upper end moves to +x


def test_link_jacobians_equal_central_differences(any_robot: Robot) -> None:
    """Columns up to k are the ordinary ones; beyond k they are minus the tip's own, or 0."""
    rng, kinematics, h = np.random.default_rng(4), Kinematics(any_robot), 1e-6
    n = any_robot.n
    for _ in range(5):
        q = any_robot.random_q(rng)
        at = kinematics.at(q)
        chain = link_chain(at)
        differences = np.zeros((n + 1, 3, n))
        for j in range(n):
            ahead, behind = (kinematics.at(q + sign * h * np.eye(n)[j]).points for sign in (1.0, -1.0))
            differences[:, :, j] = (ahead - behind) / (2.0 * h)
        for k in range(1, n):
            printed = link_jacobian(chain, k)
            standard = link_jacobian(chain, k, reference="standard")
            np.testing.assert_allclose(standard, differences[k], atol=1e-8)
            np.testing.assert_allclose(printed[:, :k], differences[k][:, :k], atol=1e-8)
            np.testing.assert_allclose(printed[:, k:], -differences[n][:, k:], atol=1e-8)


def test_rates_are_the_limit_of_small_steps(any_robot: Robot) -> None:
    rng, kinematics, small = np.random.default_rng(6), Kinematics(any_robot), 1e-7
    moved = 0
    for _ in range(50):
        at = kinematics.at(any_robot.random_q(rng))
        xdot_e = at.jacobian[:3] @ rng.normal(size=any_robot.n)
        D = rng.uniform(-1.0, 1.0, any_robot.n - 1)
        plain = link_velocities(link_chain(at), small * xdot_e, D=D, magnification="norm_preserving", follow_bend=True)
        fast = link_velocities(
            link_chain(at), xdot_e, D=D, magnification="norm_preserving", follow_bend=True, as_rates=True
        )
        np.testing.assert_allclose(fast, plain / small, atol=1e-4 * max(1.0, float(np.max(np.abs(fast)))))
        moved += int(np.max(np.abs(fast)) > 1e-3)
    assert moved > 20


def test_a_sideways_tip_velocity_turns_only_the_swing_of_a_backhoe(backhoe: Robot) -> None:
    """The tip moves sideways: only the swing's link turns, about the vertical.

    By hand: P_e^1 across z is (R, 0), ahead (R + dx, dy), so dtheta' = atan(dy / (R + dx)); the link
    from the swing axis to the boom foot is l long, and M = R / l.
    """
    at = Kinematics(backhoe).at(np.array([0.0, 0.5, -1.2, -0.6]))
    chain = link_chain(at)
    R, length = at.points[4, 0] - at.points[1, 0], at.points[1, 0] - at.points[0, 0]
    dx, dy = 0.01, 0.2
    found = link_velocities(chain, np.array([dx, dy, 0.0]), D=np.ones(3), magnification="norm_preserving")
    expected = -np.arctan2(dy, R + dx) * R / length * length
    np.testing.assert_allclose(found[0], [0.0, expected, 0.0], atol=1e-12)
    # across the boom's axis (y) only dx is left, which turns boom and stick in their plane alone
    np.testing.assert_allclose(found[1:, 1], expected, atol=1e-12)
    assert np.all(np.linalg.norm(found[1:, [0, 2]], axis=1) > 1e-4)
    still = link_velocities(chain, np.array([0.0, dy, 0.0]), D=np.ones(3))
    np.testing.assert_allclose(still, 0.0, atol=1e-12)  # neither outward nor inward


def test_rounding_does_not_decide_the_bend(backhoe: Robot) -> None:
    """The backhoe's arm lies in a vertical plane: about the swing's axis it never bends."""
    rng, kinematics = np.random.default_rng(7), Kinematics(backhoe)
    for _ in range(50):
        at = kinematics.at(backhoe.random_q(rng))
        xdot_e = at.jacobian[:3] @ rng.normal(size=4)
        rates = link_velocities(link_chain(at), xdot_e, D=np.ones(3), follow_bend=True, as_rates=True)
        np.testing.assert_array_equal(rates[0], np.zeros(3))
        bent = link_velocities(link_chain(at), 0.1 * xdot_e, D=np.ones(3), follow_bend=True)
        np.testing.assert_array_equal(bent[0], np.zeros(3))


def test_a_sliding_joint_adds_no_turn() -> None:
    chain = flat_chain((0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (2.0, 0.5))
    axes = chain.axes.copy()
    axes[1] = 0.0
    sliding = LinkChain(points=chain.points, axes=axes, columns=chain.columns, J_world=chain.J_world)
    found = link_velocities(sliding, np.array([0.1, 0.2, 0.0]), D=np.ones(2))
    np.testing.assert_array_equal(found[1], found[0])
