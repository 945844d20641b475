"""The nearest joint step on a path: by hand, and its conditions on random problems."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from backhoe_planner.arrays import Vector
from backhoe_planner.law import Kind, Rows, step_on_path

WIDE = np.full(2, 10.0)
SUM = np.array([[1.0, 1.0]])


def hard(G: Vector, h: Vector) -> tuple[Rows, ...]:
    return (Rows("test", G, h, Kind.HARD),)


def along_the_line(wish: list[float], *, high: Vector = WIDE, rows: tuple[Rows, ...] = ()) -> Vector:
    """The step nearest to `wish` with dq_1 + dq_2 = 1."""
    found = step_on_path(np.array(wish), SUM, error=np.ones(1), low=-WIDE, high=high, rows=rows)
    assert found is not None
    return found


def test_the_nearest_step_on_a_path_equals_a_hand_calculation() -> None:
    """The point of dq_1 + dq_2 = 1 nearest to the origin, then to (1, 0.5)."""
    np.testing.assert_allclose(along_the_line([0.0, 0.0]), [0.5, 0.5], atol=1e-9)
    np.testing.assert_allclose(along_the_line([1.0, 0.5]), [0.75, 0.25], atol=1e-9)


def test_a_bound_moves_the_step_along_the_path() -> None:
    np.testing.assert_allclose(along_the_line([0.0, 0.0], high=np.array([0.2, 10.0])), [0.2, 0.8], atol=1e-9)


def test_a_row_moves_the_step_along_the_path() -> None:
    """dq_1 - dq_2 >= 0.4"""
    found = along_the_line([0.0, 0.0], rows=hard(np.array([[-1.0, 1.0]]), np.array([-0.4])))
    np.testing.assert_allclose(found, [0.7, 0.3], atol=1e-9)


def test_an_impossible_step_is_none() -> None:
    narrow = np.full(2, 0.4)
    assert step_on_path(np.zeros(2), SUM, error=np.ones(1), low=-narrow, high=narrow) is None
    away = hard(np.array([[1.0, 1.0]]), np.array([0.5]))  # dq_1 + dq_2 <= 0.5
    assert step_on_path(np.zeros(2), SUM, error=np.ones(1), low=-WIDE, high=WIDE, rows=away) is None


@given(seed=st.integers(0, 10_000))
def test_a_step_keeps_every_condition_and_is_at_least_as_near_as_a_known_one(seed: int) -> None:
    """Problems made around a known step."""
    rng = np.random.default_rng(seed)
    n, m, k = 4, 2, int(rng.integers(0, 4))
    known = rng.uniform(-1.0, 1.0, n)
    J, rows, wish = rng.normal(size=(m, n)), rng.normal(size=(k, n)), rng.normal(size=n)
    low, high = known - rng.uniform(0.05, 1.0, n), known + rng.uniform(0.05, 1.0, n)
    lower = rows @ known - rng.uniform(0.05, 1.0, k)
    found = step_on_path(wish, J, error=J @ known, low=low, high=high, rows=hard(-rows, -lower))
    assert found is not None
    np.testing.assert_allclose(J @ found, J @ known, atol=1e-6)
    assert np.all(found >= low - 1e-6)
    assert np.all(found <= high + 1e-6)
    assert np.all(rows @ found >= lower - 1e-6)
    assert np.linalg.norm(found - wish) <= np.linalg.norm(known - wish) + 1e-6
