"""Quadratic programs: by hand, and the residual of a solution."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import PATIENCE

from backhoe_planner.law import (
    MOST_ITERATIONS,
    MOST_SOFT_ROWS,
    PRICE,
    UNBOUNDED,
    Kind,
    NearRows,
    QuadraticProgram,
    Rows,
    StackedRows,
    solve_in_unit_metric,
    solve_program,
    solve_with_binding_rows,
    solve_with_near_rows,
    unit_metric,
)
from backhoe_planner.law.qp import solve_from

WIDE = np.full(2, 10.0)


def nearest(wish: list[float], *rows: Rows, high: float = 10.0) -> np.ndarray:
    """The point of the plane nearest to `wish`."""
    found = solve_program(QuadraticProgram(np.eye(2), -np.array(wish), -WIDE, np.full(2, high), rows))
    assert found is not None
    assert found.residual < 1e-7
    return found.x


def half_plane(kind: Kind) -> Rows:
    """x + y <= 1"""
    return Rows("test", np.array([[1.0, 1.0]]), np.array([1.0]), kind)


def test_solutions_with_hard_and_equality_rows_equal_hand_calculations() -> None:
    np.testing.assert_allclose(nearest([3.0, 2.0]), [3.0, 2.0], atol=1e-9)
    np.testing.assert_allclose(nearest([3.0, 2.0], high=1.5), [1.5, 1.5], atol=1e-9)
    np.testing.assert_allclose(nearest([3.0, 2.0], half_plane(Kind.HARD)), [1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(nearest([-1.0, 0.0], half_plane(Kind.HARD)), [-1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(nearest([-1.0, 0.0], half_plane(Kind.EQUAL)), [0.0, 1.0], atol=1e-9)


def test_a_soft_row_is_missed_by_its_force_over_its_price() -> None:
    """From (3, 2) its force is 2, and g H^-1 g^T is 2. If x, y >= 2, it is missed by 3: a force of 3 / 2."""
    soft = half_plane(Kind.SOFT)
    stuck = solve_program(QuadraticProgram(np.eye(2), np.zeros(2), np.full(2, 2.0), WIDE, (soft,)))
    assert stuck is not None
    np.testing.assert_allclose(stuck.x, [2.0, 2.0], atol=1e-9)
    assert stuck.multipliers[2] == pytest.approx(1.5 * PRICE, rel=1e-6)
    assert nearest([3.0, 2.0], soft).sum() - 1.0 == pytest.approx(4.0 / PRICE, rel=1e-3)


def test_solutions_with_soft_rows_alone_equal_hand_calculations() -> None:
    """As above: from (3, 2) to the edge and beyond it by 4 / PRICE; if x, y >= 2, the corner."""
    soft, eye = half_plane(Kind.SOFT), np.eye(2)
    found = solve_with_binding_rows(QuadraticProgram(eye, -np.array([3.0, 2.0]), -WIDE, WIDE, (soft,)))
    assert found is not None
    np.testing.assert_allclose(found.x, [1.0 + 2.0 / PRICE, 2.0 / PRICE], atol=1e-9)
    stuck = solve_with_binding_rows(QuadraticProgram(eye, np.zeros(2), np.full(2, 2.0), WIDE, (soft,)))
    assert stuck is not None
    np.testing.assert_allclose(stuck.x, [2.0, 2.0], atol=1e-9)


@given(seed=st.integers(0, 10_000))
def test_with_soft_rows_alone_no_point_near_the_solution_costs_less(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, count = 4, 8
    A, G, h = rng.normal(size=(n, n)), rng.normal(size=(count, n)), rng.normal(0.3, 0.5, count)
    H, f, low, high = A @ A.T + 0.1 * np.eye(n), rng.normal(size=n), -rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n)
    found = solve_with_binding_rows(QuadraticProgram(H, f, low, high, (Rows("test", G, h),)))
    assert found is not None
    size = np.einsum("kn,nk->k", G, np.linalg.solve(H, G.T))

    def cost(x: np.ndarray) -> float:
        missed = np.maximum(G @ x - h, 0.0)
        return float(0.5 * x @ H @ x + f @ x + 0.5 * PRICE * (missed**2 / size).sum())

    assert np.all(found.x >= low - 1e-6)
    assert np.all(found.x <= high + 1e-6)
    x = np.clip(found.x, low, high)
    for scale in (1e-1, 1e-2, 1e-3):
        beside = np.clip(x + scale * rng.normal(size=(20, n)), low, high)
        assert min(map(cost, beside)) >= cost(x) - 1e-6 * max(abs(cost(x)), 1.0)


def test_an_infeasible_program_has_no_solution() -> None:
    hard = half_plane(Kind.HARD)
    assert solve_program(QuadraticProgram(np.eye(2), np.zeros(2), np.full(2, 2.0), WIDE, (hard,))) is None


def test_rows_report_whether_they_are_kept() -> None:
    rows = half_plane(Kind.HARD)
    assert rows.are_kept_by(np.array([0.5, 0.5]))
    assert not rows.are_kept_by(np.array([0.5, 0.6]))
    assert rows.are_kept_by(np.array([0.5, 0.6]), 0.11)


@given(seed=st.integers(0, 10_000))
def test_the_residual_of_a_solution_shows_whether_it_is_right(seed: int) -> None:
    """Programs around a feasible point; a point off the solution by 1e-3 is none."""
    rng = np.random.default_rng(seed)
    n = 4
    known, A = rng.uniform(-1.0, 1.0, n), rng.normal(size=(n, n))
    rows = []
    for kind, count in ((Kind.HARD, 3), (Kind.EQUAL, 1), (Kind.SOFT, 4)):
        G = rng.normal(size=(count, n))
        h = G @ known + (0.0 if kind is Kind.EQUAL else rng.uniform(0.0, 0.5, count))
        rows.append(Rows(kind.name.lower(), G, h, kind))
    low, high = known - rng.uniform(0.0, 1.0, n), known + rng.uniform(0.0, 1.0, n)
    found = solve_program(QuadraticProgram(A.T @ A + 0.1 * np.eye(n), rng.normal(size=n), low, high, tuple(rows)))
    assert found is not None
    assert found.residual < 1e-5
    assert found._replace(x=found.x + 1e-3).residual > 1e-5


@pytest.mark.parametrize("seed", range(5))
def test_the_binding_rows_of_many_give_the_solution_with_all(seed: int) -> None:
    """Tangents of a ball of radius 1 and a wish outside: all rows can be kept, and few bind."""
    rng = np.random.default_rng(seed)
    G = rng.normal(size=(400, 3))
    rows = Rows("ball", G / np.linalg.norm(G, axis=1)[:, None], np.ones(400))
    program = QuadraticProgram(np.eye(3), -rng.uniform(1.0, 2.0, 3), np.full(3, -5.0), np.full(3, 5.0), (rows,))
    all_of_them, found = solve_program(program), solve_with_binding_rows(program)
    assert all_of_them is not None
    assert found is not None
    np.testing.assert_allclose(found.x, all_of_them.x, atol=1e-6)
    assert found.rows <= MOST_SOFT_ROWS


def test_few_of_many_contradictory_rows_are_used() -> None:
    """From two sides at once: x <= -1 and x >= 1, 200 rows each, a little turned. The middle misses both alike."""
    turned = np.linspace(-0.3, 0.3, 200)
    right = np.column_stack((np.cos(turned), np.sin(turned)))
    rows = Rows("both sides", np.vstack((right, -right)), np.full(400, -1.0))
    program = QuadraticProgram(np.eye(2), np.zeros(2), np.full(2, -5.0), np.full(2, 5.0), (rows,))
    found = solve_with_binding_rows(program)
    assert found is not None
    np.testing.assert_allclose(found.x, 0.0, atol=1e-3)
    assert found.rows <= MOST_SOFT_ROWS
    assert found.iterations <= found.problems * MOST_ITERATIONS


@pytest.mark.parametrize("seed", range(3))
def test_the_units_of_rows_do_not_change_which_of_many_bind(seed: int) -> None:
    """A row times a number demands the same, and so does its price: it is measured by how far x has to move."""
    rng = np.random.default_rng(seed)
    G = rng.normal(size=(300, 4))
    G /= np.linalg.norm(G, axis=1, keepdims=True)
    h, factor = rng.uniform(-0.5, 0.5, 300), np.exp(rng.uniform(-4.0, 4.0, 300))
    plain, scaled = (
        solve_with_binding_rows(
            QuadraticProgram(
                np.eye(4), np.zeros(4), np.full(4, -3.0), np.full(4, 3.0), (Rows("all", by[:, None] * G, by * h),)
            )
        )
        for by in (np.ones(300), factor)
    )
    assert plain is not None
    assert scaled is not None
    np.testing.assert_array_equal(scaled.kept, plain.kept)
    np.testing.assert_allclose(scaled.x, plain.x, atol=1e-6)


def test_a_solver_that_needs_too_many_iterations_has_no_solution() -> None:
    rows = Rows("below", np.eye(4), np.full(4, -1.0))
    program = QuadraticProgram(np.eye(4), np.zeros(4), np.full(4, -5.0), np.full(4, 5.0), (rows,))
    assert solve_program(program) is not None
    assert solve_program(program, most_iterations=1) is None


_OVERRUN = """
import numpy as np
from backhoe_planner.law import Kind, QuadraticProgram, Rows, solve_program

G = np.array([[0.9168, 0.602], [-0.9169, -0.6017], [-0.9169, -0.6021]])
hard = Rows("hard", G, np.array([0.0002, -0.5885, 0.8605]), Kind.HARD)
soft = Rows("soft", np.array([[-0.9168, -0.6021], [-0.9169, -0.6018]]), np.array([-0.6203, 0.3517]))
program = QuadraticProgram(np.eye(2), np.array([0.1, -0.1]), np.array([-0.3, -0.7]), np.full(2, 0.9), (hard, soft))
assert not any([solve_program(program) for _ in range(2000)])
"""


def test_contradictory_hard_and_soft_rows_do_not_corrupt_memory() -> None:
    """The first two hard rows limit nearly the same to at most 0.0002 and to at least 0.5885.

    There daqp 0.11.0 writes beyond its memory (seen with valgrind in `daqp_update_LDL_add`, and glibc's "free():
    invalid next size"), which would end the process.
    """
    done = subprocess.run(
        [sys.executable, "-c", _OVERRUN], stderr=subprocess.PIPE, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("hard", "equal", "soft"), [(0, 0, 3), (1, 0, 1), (5, 0, 1), (3, 2, 4), (4, 1, 0)])
def test_the_solvers_working_set_has_room_for_all_conditions(hard: int, equal: int, soft: int) -> None:
    """daqp has room for n + 1 and the soft rows; a set with hard rows alone never has more than n + 1."""
    n = 4
    kinds = ((Kind.HARD, hard), (Kind.EQUAL, equal), (Kind.SOFT, soft))
    rows = StackedRows.of(tuple(Rows("test", np.ones((count, n)), np.ones(count), kind) for kind, count in kinds), n)
    assert (rows.total, rows.soft) == (hard + equal + soft, soft)
    assert len(rows.senses) == n + len(rows.G) == n + len(rows.high) == n + len(rows.low)
    room = n + 1 + np.count_nonzero(rows.senses == Kind.SOFT)
    assert room >= (n + rows.total if soft else n + 1)
    assert not rows.G[rows.total :].any()
    assert len(rows.G) == rows.total + (max(0, hard + equal - 1) if soft else 0)


def test_an_answer_outside_the_bounds_is_no_solution() -> None:
    """For a hard row x >= 0.774 with x <= 0.3, daqp 0.11.0 answers x = 1.38 and misses a soft row."""
    G = np.array([[-0.2942, -0.9358], [-0.1639, -0.9549], [-0.9877, 0.0003]])
    hard = Rows("hard", G, np.array([0.0104, 0.4949, -0.7645]), Kind.HARD)
    soft = Rows("soft", np.array([[0.0008, -0.5714], [0.997, -0.0007]]), np.array([-0.6548, -0.305]))
    low, high = np.array([-0.6, -0.1]), np.array([0.3, 0.0])
    assert solve_program(QuadraticProgram(np.eye(2), np.array([-0.2, -0.6]), low, high, (hard, soft))) is None


@pytest.mark.parametrize("seed", range(6))
def test_the_near_rows_of_many_hard_ones_give_the_solution_with_all(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tangents of a ball within a box, some far outside; the last variable lets all be missed at a high cost."""
    rng, n, solved = np.random.default_rng(seed), 5, []
    G = rng.normal(size=(300, n))
    G = np.column_stack((G / np.linalg.norm(G, axis=1)[:, None], np.full(300, -1.0)))
    rows = (
        Rows("ball", G, rng.uniform(0.3, 5.0, 300), Kind.HARD),
        Rows("plane", np.ones((1, n + 1)), np.zeros(1), Kind.EQUAL),
    )
    f = np.append(-rng.uniform(1.0, 2.0, n) * rng.choice([-1.0, 1.0], n), 10.0)
    low, high = np.append(np.full(n, -1.0), 0.0), np.append(np.full(n, 1.0), UNBOUNDED)
    program = QuadraticProgram(np.eye(n + 1), f, low, high, rows)
    all_of_them = solve_program(program)
    assert all_of_them is not None

    def note(program: QuadraticProgram, **options: Any) -> Any:
        solved.append(sum(len(row.h) for row in program.rows))
        return solve_program(program, **options)

    monkeypatch.setattr("backhoe_planner.law.binding_rows.solve_program", note)
    found = solve_with_near_rows(program, most_iterations=1000)
    assert found is not None
    np.testing.assert_allclose(found, all_of_them.x, atol=1e-6)
    assert max(solved) < 100


@pytest.mark.parametrize("seed", range(4))
def test_many_coupled_variables_have_the_same_solution_in_the_metric_of_their_cost(seed: int) -> None:
    """60 coupled variables, and 70 that stand alone, each at least a row of the others, as for the kinks of a cost."""
    rng, coupled, alone = np.random.default_rng(seed), 60, 70
    n = coupled + alone
    B, H = rng.normal(size=(coupled, coupled)), np.diag(rng.uniform(0.5, 20.0, n))
    H[:coupled, :coupled] += B @ B.T / coupled
    G = np.hstack((rng.normal(size=(alone, coupled)), -np.eye(alone)))
    rows = (
        Rows("kinks", G, rng.normal(size=alone), Kind.HARD),
        Rows("others", np.hstack((rng.normal(size=(9, coupled)), np.zeros((9, alone)))), np.full(9, 0.1), Kind.HARD),
        Rows("goal", np.hstack((rng.normal(size=(3, coupled)), np.zeros((3, alone)))), np.full(3, 0.1), Kind.EQUAL),
    )
    low, high = (
        np.append(np.full(coupled, -0.2), np.zeros(alone)),
        np.append(np.full(coupled, 0.2), [UNBOUNDED] * alone),
    )
    program = QuadraticProgram(H, rng.normal(size=n), low, high, rows)
    plain, found = solve_program(program), solve_in_unit_metric(program, coupled, most_iterations=1000)
    assert plain is not None
    assert found is not None
    assert plain.residual < 1e-6
    np.testing.assert_allclose(found, plain.x, atol=1e-8)
    assert np.isclose(np.abs(found[:coupled]), 0.2).sum() > 3  # some bounds bind, and some kinks are crossed
    assert (found[coupled:] > 1e-3).sum() > 3
    assert solve_in_unit_metric(program, coupled, most_iterations=3) is None
    again, elsewhere = (
        solve_in_unit_metric(program, coupled, most_iterations=most, start=start)
        for most, start in ((3, plain.x), (1000, rng.normal(size=n)))
    )
    assert again is not None
    assert elsewhere is not None
    np.testing.assert_allclose(again, plain.x, atol=1e-8)
    np.testing.assert_allclose(elsewhere, plain.x, atol=1e-8)
    near = NearRows(program).solve(program._replace(rows=()), most_iterations=1000, coupled=coupled)
    assert near is not None
    np.testing.assert_allclose(near, plain.x, atol=1e-6)
    both = Rows("both sides", np.vstack((G[:1], -G[:1])), np.array([-9.0, -9.0]), Kind.HARD)
    assert solve_in_unit_metric(program._replace(rows=(both,)), coupled, most_iterations=1000) is None


@pytest.mark.parametrize(("alone", "is_used"), [(100, True), (149, True), (200, False)])
def test_a_start_at_which_very_many_conditions_bind_is_not_used(
    monkeypatch: pytest.MonkeyPatch, alone: int, is_used: bool
) -> None:
    """x^2/2 + x of many variables from 0 to 1 is least at their lower bounds, and a coupled one is at its upper one."""
    n = 1 + alone
    low, high = np.append(-1.0, np.zeros(alone)), np.ones(n)
    program = QuadraticProgram(np.eye(n), np.append(-3.0, np.ones(alone)), low, high, ())
    least = np.append(1.0, np.zeros(alone))
    used: list[bool] = []

    def note(start: Any, *about: Any, **how: Any) -> Any:
        used.append(start is not None)
        return solve_from(start, *about, **how)

    monkeypatch.setattr(unit_metric, "solve_from", note)
    for start in (least, None):
        found = solve_in_unit_metric(program, 1, most_iterations=1000, start=start)
        assert found is not None
        np.testing.assert_allclose(found, least, atol=1e-9)
    assert used == [is_used, False]


@pytest.mark.parametrize("H", [np.diag([1.0, -1.0, 1.0]), np.diag([1.0, 1.0, 0.0])], ids=["coupled", "alone"])
def test_a_cost_that_is_not_definite_has_no_unit_metric(H: np.ndarray) -> None:
    program = QuadraticProgram(H, np.zeros(3), np.full(3, -1.0), np.full(3, 1.0), ())
    assert solve_in_unit_metric(program, 2, most_iterations=100) is None


def test_programs_that_share_rows_are_solved_with_their_own_variables_and_rows() -> None:
    """The second program has 5 more variables, each at least a row of the first 20; both as with all rows at once."""
    rng = np.random.default_rng(2)
    ball = Rows("ball", rng.normal(size=(200, 20)), rng.uniform(0.1, 3.0, 200), Kind.HARD)
    plane = Rows("plane", np.ones((1, 20)), np.zeros(1), Kind.EQUAL)
    low, high = np.full(20, -1.0), np.full(20, 1.0)
    first = QuadraticProgram(np.eye(20), rng.normal(size=20), low, high, (ball, plane))
    shared = NearRows(first)
    wide = tuple(row._replace(G=np.hstack((row.G, np.zeros((len(row.h), 5))))) for row in first.rows)
    own = Rows("own", np.hstack((rng.normal(size=(5, 20)), -np.eye(5))), np.full(5, -0.1), Kind.HARD)
    more = (np.append(first.low, np.zeros(5)), np.append(first.high, [UNBOUNDED] * 5))
    second = QuadraticProgram(np.eye(25), np.append(3.0 * first.f, np.zeros(5)), *more, (own,))
    for program, whole in ((first._replace(rows=()), first), (second, second._replace(rows=(*wide, own)))):
        expected, found = solve_program(whole), shared.solve(program, most_iterations=1000)
        assert expected is not None
        assert found is not None
        assert expected.residual < 1e-6
        np.testing.assert_allclose(found, expected.x, atol=1e-6)


def test_a_program_is_solved_in_few_steps_from_its_solution_and_from_elsewhere_too() -> None:
    rng, n = np.random.default_rng(5), 30
    rows = Rows("some", rng.normal(size=(40, n)), rng.uniform(0.0, 1.0, 40), Kind.HARD)
    program = QuadraticProgram(np.eye(n), 3.0 * rng.normal(size=n), np.full(n, -0.5), np.full(n, 0.5), (rows,))
    plain = solve_program(program)
    assert plain is not None
    assert np.count_nonzero(plain.multipliers) > 15
    assert solve_program(program, most_iterations=3) is None
    for most, start in ((3, plain.x), (1000, rng.normal(size=n)), (1000, -plain.x)):
        found = solve_program(program, most_iterations=most, start=start)
        assert found is not None
        assert found.residual < 1e-8
        np.testing.assert_allclose(found.x, plain.x, atol=1e-8)


def test_contradictory_near_rows_have_no_solution() -> None:
    rows = Rows("both sides", np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([-0.5, -0.5]), Kind.HARD)
    program = QuadraticProgram(np.eye(2), np.zeros(2), np.full(2, -5.0), np.full(2, 5.0), (rows,))
    assert solve_with_near_rows(program, most_iterations=100) is None
