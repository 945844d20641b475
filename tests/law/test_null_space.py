"""Pseudo-inverses, and the projector, which is never damped."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backhoe_planner.arrays import Matrix
from backhoe_planner.law import projector, pseudo_inverse, resolve
from backhoe_planner.law.null_space import resolve_on_null_line
from backhoe_planner.machine import Kinematics, Robot


def random_jacobian(seed: int, m: int, n: int) -> Matrix:
    return np.random.default_rng(seed).normal(size=(m, n))


def stretched(s: float) -> Matrix:
    """A task Jacobian whose singular values are 1 and s, along known directions."""
    return np.array([[s, 0.0, 0.0], [0.0, 1.0, 0.0]])


@given(seed=st.integers(0, 10_000), m=st.integers(1, 5), extra=st.integers(0, 3))
def test_the_projector_is_symmetric_and_idempotent_and_leaves_the_task_alone(seed: int, m: int, extra: int) -> None:
    J = random_jacobian(seed, m, m + extra)
    if np.linalg.svd(J, compute_uv=False)[-1] < 0.05:
        return
    for N in (resolve(J).projector, projector(J)):
        np.testing.assert_allclose(N, N.T, atol=1e-12)
        np.testing.assert_allclose(N @ N, N, atol=1e-12)
        np.testing.assert_allclose(J @ N, 0.0, atol=1e-12)
        np.testing.assert_allclose(N, np.eye(m + extra) - np.linalg.pinv(J) @ J, atol=1e-11)
        assert np.trace(N) == pytest.approx(extra, abs=1e-9)  # the rank of the null space


@given(seed=st.integers(0, 10_000), m=st.integers(1, 6), n=st.integers(1, 6))
def test_the_pseudo_inverse_equals_numpys(seed: int, m: int, n: int) -> None:
    J = random_jacobian(seed, m, n)
    np.testing.assert_allclose(pseudo_inverse(J), np.linalg.pinv(J), rtol=1e-7, atol=1e-9)


def test_the_pseudo_inverse_of_zero_is_zero() -> None:
    np.testing.assert_array_equal(pseudo_inverse(np.zeros((2, 4))), np.zeros((4, 2)))


def test_rounding_is_not_inverted() -> None:
    """A product that should be 0 is about 1e-16; relative to its factor it counts as 0."""
    J = random_jacobian(3, 2, 4)
    noise = J @ projector(J)
    assert 0.0 < np.max(np.abs(noise)) < 1e-14
    assert np.max(np.abs(np.linalg.pinv(noise))) > 1e12
    np.testing.assert_array_equal(pseudo_inverse(noise, scale=float(np.linalg.norm(J))), np.zeros((4, 2)))


@pytest.mark.parametrize(
    ("s", "gain", "damping"),
    [
        (1.0, 1.0, 0.0),
        (0.1, 10.0, 0.0),  # above the threshold of 0.08 nothing is damped
        (0.08, 12.5, 0.0),
        (0.04, 6.25, np.sqrt(0.0048)),  # 0.08^2 (1 - 0.5^2) = 0.0048; 0.04 / (0.0016 + 0.0048)
        (0.0, 0.0, 0.08),
    ],
)
def test_damping_equals_a_hand_calculation(s: float, gain: float, damping: float) -> None:
    found = resolve(stretched(s))
    assert found.damping == pytest.approx(damping, abs=1e-9)
    assert found.inverse[0, 0] == pytest.approx(gain, abs=1e-6)


def test_the_inverse_is_damped_and_the_projector_is_not() -> None:
    """A projector damped with lambda^2 = 0.0048 leaks 75 % of a row of 0.04 into the task."""
    J = stretched(0.04)
    damped = J.T @ np.linalg.inv(J @ J.T + 0.0048 * np.eye(2))
    leak = J @ (np.eye(3) - damped @ J)
    assert leak[0, 0] / 0.04 == pytest.approx(0.75)  # 0.0048 / (0.0016 + 0.0048)
    found = resolve(J)
    assert found.damping > 0.05
    assert np.max(np.abs(found.inverse - np.linalg.pinv(J))) > 0.1
    np.testing.assert_allclose(J @ found.projector, 0.0, atol=1e-14)
    np.testing.assert_allclose(found.projector, np.diag([0.0, 0.0, 1.0]), atol=1e-14)


def test_the_inverse_is_bounded_and_continuous_through_a_singularity(planar4: Robot) -> None:
    """The arm passes through its stretched configuration; 12.5 is the inverse of the threshold."""
    kinematics = Kinematics(planar4)
    before = None
    smallest = np.inf
    for bend in np.linspace(-0.1, 0.1, 2001):
        J = kinematics.at(np.array([0.4, bend, 0.0, 0.0])).jacobian[:2]
        found = resolve(J)
        assert np.linalg.norm(found.inverse, 2) <= 12.5 + 1e-9
        if before is not None:
            assert np.max(np.abs(found.inverse - before)) < 0.05  # for 1e-4 rad
        before = found.inverse
        smallest = min(smallest, float(np.linalg.norm(J, -2)))
    assert smallest < 1e-6


@pytest.mark.parametrize(
    ("J", "N"),
    [
        ([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]),  # a row that no joint moves
        ([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]),  # the same row twice
        ([[0.0, 0.0, 0.0]], np.eye(3)),
        ([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], np.zeros((2, 2))),  # more rows than joints
    ],
)
def test_rank_deficient_rows_have_an_exact_projector_and_a_finite_inverse(
    J: list[list[float]], N: list[list[float]] | Matrix
) -> None:
    found = resolve(np.array(J))
    np.testing.assert_allclose(found.projector, N, atol=1e-12)
    assert np.all(np.isfinite(found.inverse))
    np.testing.assert_allclose(np.array(J) @ found.projector, 0.0, atol=1e-12)


@pytest.mark.parametrize("n", [4, 6])
def test_a_singular_value_just_below_0_08_is_damped_whatever_the_others_are(n: int) -> None:
    """sigma / (sigma^2 + lambda^2) with lambda = 0.08 sqrt(1 - (0.07 / 0.08)^2), in any orientation."""
    rng = np.random.default_rng(0)
    damping = 0.08 * np.sqrt(1.0 - (0.07 / 0.08) ** 2)
    for others in ((1.0, 1.0), (0.08, 0.09), (0.5, 2.0)):
        U, V = np.linalg.qr(rng.normal(size=(3, 3)))[0], np.linalg.qr(rng.normal(size=(n, 3)))[0]
        sizes = np.array([*others, 0.07])
        J = (U * sizes) @ V.T
        found = resolve(J)
        assert found.damping == pytest.approx(damping, rel=1e-6)
        np.testing.assert_allclose(found.inverse, (V * (sizes / (sizes**2 + damping**2))) @ U.T, atol=1e-6)
        if n == 4:
            assert resolve_on_null_line(J, np.ones(3)) is None


def test_beside_a_singular_value_of_0_a_small_one_is_not_in_the_null_space() -> None:
    """Singular values 1, 0.01 and 0 in five joints: N has rank 3, and moves none of the task."""
    rng = np.random.default_rng(1)
    U, V = np.linalg.qr(rng.normal(size=(3, 3)))[0], np.linalg.qr(rng.normal(size=(5, 3)))[0]
    J = (U * np.array([1.0, 0.01, 0.0])) @ V.T
    N = resolve(J).projector
    np.testing.assert_allclose(J @ N, 0.0, atol=1e-9)
    assert np.trace(N) == pytest.approx(3.0)
