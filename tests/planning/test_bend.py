"""How the cost of a curve in its own time changes with the curve, and what a descent learns of that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Dynamics
from backhoe_planner.motion import (
    OBJECTIVES,
    Problem,
    build_problem,
    drive_of,
    limit_usage,
    time_evenly,
)
from backhoe_planner.planning.descent.bend import Bend
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.kinks import Kinks
from backhoe_planner.planning.descent.linear_model import LinearModel
from backhoe_planner.planning.descent.margins import Margins
from backhoe_planner.planning.descent.own_time import FINE_PLACES, OwnTime

PIECES, DURATION = 8, 3.0


def problem_of(robot: bp.Robot, objective: str) -> Problem:
    goal = {"joints": dict(zip(robot.joint_names, robot.middle.tolist(), strict=True))}
    start = {"joints": dict(zip(robot.joint_names, robot.middle.tolist(), strict=True))}
    problem = build_problem(robot, bp.scene_from_dict({"version": 1, "start": start, "task": {"goal": goal}}))
    return replace(problem, objective=OBJECTIVES[objective])


def bent_curve(robot: bp.Robot) -> JointCurve:
    rng = np.random.default_rng(4)
    wide = 0.25 * (robot.limits.upper - robot.limits.lower)
    straight = JointCurve.straight(robot.middle - wide, robot.middle + wide, PIECES)
    control = straight.control.copy()
    control[1:-1] += 0.1 * rng.uniform(-wide, wide, (PIECES - 1, robot.n))
    return JointCurve(control)


def differences(cost: Callable[[JointCurve, float], float], curve: JointCurve, nudge: float) -> Vector:
    """Central differences of a cost with respect to the inner control points and the duration."""
    found = []
    for place in np.ndindex(PIECES - 1, curve.control.shape[1]):
        moved = np.zeros_like(curve.control)
        moved[1:-1][place] = nudge
        sides = (cost(curve.moved_to(curve.control + sign * moved), DURATION) for sign in (1.0, -1.0))
        found.append(next(sides) - next(sides))
    found.append(cost(curve, DURATION + nudge) - cost(curve, DURATION - nudge))
    return np.array(found) / (2.0 * nudge)


UNEVEN = (0.0, 0.05, 0.15, 0.3, 0.5, 0.6, 0.8, 0.95, 1.0)


@pytest.mark.parametrize(("objective", "width"), [("work", 1e-9), ("work", 20.0), ("kinetic", 1.0), ("effort", 1.0)])
@pytest.mark.parametrize(("knots", "places"), [((), 4), (UNEVEN, 4), (UNEVEN, FINE_PLACES)])
def test_the_slope_of_a_cost_equals_central_differences(
    planar4: bp.Robot, objective: str, width: float, knots: tuple[float, ...], places: int
) -> None:
    problem, curve = problem_of(planar4, objective), JointCurve(bent_curve(planar4).control, knots)
    own = OwnTime(problem, drive_of(problem), places)
    slope = own.slope(curve, DURATION, slice(1, -1), width=width).slope
    expected = differences(lambda *at: own.cost(*at, width=width), curve, 1e-5)
    np.testing.assert_allclose(slope, expected, rtol=1e-3, atol=1e-3 * np.max(np.abs(expected)))


def test_more_places_give_a_more_exact_cost(planar4: bp.Robot) -> None:
    """Against a sum over 400 places of each piece; the power of every joint changes its sign on the way."""
    problem, curve = problem_of(planar4, "work"), JointCurve(bent_curve(planar4).control)
    exact = OwnTime(problem, drive_of(problem), 400).cost(curve, DURATION, width=1e-9)
    few, more = (
        abs(OwnTime(problem, drive_of(problem), places).cost(curve, DURATION, width=1e-9) - exact)
        for places in (2, FINE_PLACES)
    )
    assert more < 0.5 * few
    assert more < 0.01 * exact


def test_the_slope_of_kinks_changes_as_that_of_their_rounded_sum() -> None:
    """Along one step, against differences of sum share phi(value + G x), with phi written out here."""
    rng = np.random.default_rng(3)
    kinks = Kinks(rng.normal(size=(40, 5)), rng.normal(size=40), rng.uniform(0.1, 1.0, 40), 0.5)

    def cost(x: Vector) -> float:
        y = kinks.value + kinks.G @ x
        return float(np.sum(kinks.share * np.where(y < 0.0, 0.0, np.where(y < 0.5, y * y, y - 0.25))))

    def slope(x: Vector) -> Vector:
        return np.array([(cost(x + 1e-6 * one) - cost(x - 1e-6 * one)) / 2e-6 for one in np.eye(5)])

    step = 0.3 * rng.normal(size=5)
    np.testing.assert_allclose(kinks.turned(step), slope(step) - slope(np.zeros(5)), atol=1e-6)


def change_of_cost(bend: Bend, x: Vector) -> tuple[float, Vector]:
    """How the cost changes with a step x (m,): by its slope, smooth curvature and every kink; and the derivative."""
    kinks, w = bend.kinks, bend.kinks.width
    before, y = np.maximum(kinks.value, 0.0), np.maximum(kinks.value + kinks.G @ x, 0.0)
    of_kinks = [kinks.share @ np.where(part < w, part * part / (2.0 * w), part - 0.5 * w) for part in (before, y)]
    slope = bend.slope - kinks.G.T @ (kinks.share * np.clip(kinks.value / w, 0.0, 1.0))
    curved = bend.smooth_curvature @ x
    cost = float(slope @ x + 0.5 * x @ curved + of_kinks[1] - of_kinks[0])
    return cost, slope + curved + kinks.G.T @ (kinks.share * np.minimum(y / w, 1.0))


@pytest.mark.parametrize(("value", "expected"), [(-0.2, -0.05), (0.2, 0.05), (-8.0, -1.0)])
def test_a_step_goes_up_to_a_kink_and_not_through_it(planar4: bp.Robot, value: float, expected: float) -> None:
    """One control point would go to -1 rad, the edge of the box; a part that costs above 0 rises by 4 per rad.

    value - 4 x is 0 at value / 4: from below x goes down to there, or to the edge; from above it goes up to there.
    """
    problem = problem_of(planar4, "work")
    curve = JointCurve.straight(planar4.middle, planar4.middle, PIECES)
    model = LinearModel(problem, curve, 1.0, end_moves=False, box=np.full(planar4.n, 1.0))
    m = planar4.n * (PIECES - 1) + 1
    slope, G = np.zeros(m), np.zeros((1, m))
    slope[0], G[0, 0] = 1e-2, -4.0
    kinks = Kinks(G, np.array([value]), np.array([1.0]), 1e-3)
    if value > 0.0:  # above the width: its slope is part of the whole
        slope[0] -= 4.0
    bend = Bend(slope, 1e-6 * np.eye(m), np.zeros((m, m)), kinks)
    x = model.best_step(1.0, bend=bend, most_iterations=1000)
    assert x is not None
    control, _ = model.step(x)
    assert control[1, 0] - planar4.middle[0] == pytest.approx(expected, abs=2e-3)


def test_kinks_that_a_step_does_not_cross_need_no_variable(planar4: bp.Robot) -> None:
    """The best step gains 0.95 of what the least of the cost with every kink gains, although some kinks are crossed."""
    problem, rng = problem_of(planar4, "work"), np.random.default_rng(6)
    curve = JointCurve.straight(planar4.middle, planar4.middle, PIECES)
    m = planar4.n * (PIECES - 1) + 1
    crossed = []
    for _ in range(10):
        model = LinearModel(problem, curve, 1.0, end_moves=False, box=np.full(planar4.n, 0.3))
        value = np.append(rng.normal(size=40), rng.uniform(0.0, 0.1, 20))
        kinks = Kinks(0.2 * rng.normal(size=(60, m)), value, rng.uniform(0.1, 1.0, 60), 0.1)
        root = rng.normal(size=(m, m))
        slope = kinks.share * kinks.rising @ kinks.G + 0.1 * rng.normal(size=m)
        bend = Bend(slope, root @ root.T / m, np.zeros((m, m)), kinks)
        bounds = model.program(1.0, may_be_late=True)
        found = model.best_step(1.0, bend=bend, most_iterations=1000)
        assert found is not None
        best = minimize(
            partial(change_of_cost, bend), np.zeros(m), jac=True, method="L-BFGS-B",
            bounds=list(zip(bounds.low[:m], bounds.high[:m], strict=True)), options={"maxiter": 2000},
        )  # fmt: skip
        cost, _ = change_of_cost(bend, found[:m])
        assert best.fun < 0.0
        assert best.fun - 1e-6 <= cost <= 0.95 * best.fun
        crossed.append(np.sum((value < 0.0) != (value + kinks.G @ found[:m] < 0.0)))
    assert min(crossed) > 0


def test_a_step_lowers_the_cost_even_if_it_crosses_more_kinks_than_have_variables(planar4: bp.Robot) -> None:
    """Steep kinks and hardly any curvature: each solution goes far, through kinks that have no variable."""
    problem, rng = problem_of(planar4, "work"), np.random.default_rng(1)
    curve, width = JointCurve.straight(planar4.middle, planar4.middle, PIECES), 0.01
    m = planar4.n * (PIECES - 1) + 1
    for _ in range(40):
        model = LinearModel(problem, curve, 1.0, end_moves=False, box=np.full(planar4.n, 0.3))
        kinks = Kinks(8.0 * rng.normal(size=(60, m)), rng.normal(size=60), np.ones(60), width)
        straight = 30.0 * rng.normal(size=m)
        bend = Bend(straight + kinks.share * kinks.rising @ kinks.G, 1e-4 * np.eye(m), np.zeros((m, m)), kinks)
        x = model.best_step(1.0, bend=bend, most_iterations=1000)
        assert x is not None
        before, after = (np.maximum(y, 0.0) for y in (kinks.value, kinks.value + kinks.G @ x[:m]))
        of_kinks = [np.sum(np.where(y < width, y * y / (2.0 * width), y - 0.5 * width)) for y in (before, after)]
        assert straight @ x[:m] + of_kinks[1] - of_kinks[0] < 0.0


def test_a_step_is_found_although_each_of_three_solutions_crosses_a_steep_kink_of_which_it_does_not_know(
    planar4: bp.Robot,
) -> None:
    """Four joints of a control point would each go to -1 rad, the edge of the box, which lowers the cost by 1 each.

    The first three would cost 100 per rad, each only if those before it stay: so each solution stops one of them, and
    even a fiftieth of it costs more than no step. Only the fourth solution knows of all three, and moves the last.
    """
    problem = problem_of(planar4, "work")
    curve = JointCurve.straight(planar4.middle, planar4.middle, PIECES)
    model = LinearModel(problem, curve, 1.0, end_moves=False, box=np.full(planar4.n, 1.0))
    m = planar4.n * (PIECES - 1) + 1
    slope, G = np.zeros(m), np.zeros((3, m))
    slope[:4] = 1.0
    G[:, :3] = -100.0 * np.eye(3) + 200.0 * np.tri(3, k=-1)
    bend = Bend(slope, 1e-6 * np.eye(m), np.zeros((m, m)), Kinks(G, np.full(3, -1e-3), np.ones(3), 1e-3))
    x = model.best_step(1.0, bend=bend, most_iterations=1000)
    assert x is not None
    np.testing.assert_allclose(x[:4], [0.0, 0.0, 0.0, -1.0], atol=1e-3)


def test_the_work_of_a_lift_is_its_gain_in_potential_energy(planar4: bp.Robot) -> None:
    """Infinitely slow; one joint moves alone, against its weight for half of the way."""
    problem = problem_of(planar4, "work")
    low, high = planar4.middle.copy(), planar4.middle.copy()
    high[0] += 0.5
    gained = abs(Dynamics(planar4).potential_energy(high) - Dynamics(planar4).potential_energy(low))
    own = OwnTime(problem, drive_of(problem))
    for curve in (
        JointCurve.straight(low, high, 12),
        JointCurve(JointCurve.straight(low, high, PIECES).control, UNEVEN),
    ):
        assert own.cost(curve, 1e4, width=1e-9) == pytest.approx(gained, rel=1e-3, abs=1e-3)


def test_lowering_costs_no_work_but_its_gross_work_is_the_potential_energy_lost(backhoe: bp.Robot) -> None:
    """Infinitely slow; the boom sinks alone with its weight."""
    problem = problem_of(backhoe, "work")
    low, high = backhoe.middle.copy(), backhoe.middle.copy()
    high[1] += 0.5
    lost = Dynamics(backhoe).potential_energy(high) - Dynamics(backhoe).potential_energy(low)
    down = JointCurve.straight(high, low, 12)
    assert lost > 1e3
    own = OwnTime(problem, drive_of(problem))
    assert own.cost(down, 1e4, width=1e-9) == pytest.approx(0.0, abs=1.0)
    assert own.gross(down, 1e4) == pytest.approx(lost, rel=1e-3)


def test_a_curve_within_its_rates_where_steps_check_them_keeps_its_duration(planar4: bp.Robot) -> None:
    """Rates are within their limits at the places at which a step keeps them, not everywhere between."""
    problem, curve = problem_of(planar4, "work"), bent_curve(planar4)
    s = np.linspace(0.0, 1.0, 3 * PIECES + 1)
    T = float(np.max(np.abs(curve(s, 1)) / problem.limits.velocity))
    over = np.max(np.abs(curve(np.linspace(0.0, 1.0, 100 * PIECES), 1)) / problem.limits.velocity) / T
    limits = replace(problem.limits, acceleration=np.full(planar4.n, np.inf), effort=np.full(planar4.n, np.inf))
    free = replace(problem, limits=limits)
    assert over > 1.001  # between them it is faster
    assert OwnTime(free, drive_of(free)).least_duration(curve, T) == pytest.approx(T)


def test_a_late_motion_is_shortened_no_more_than_necessary(planar4: bp.Robot) -> None:
    """Duration is so expensive here that a step would give up all else to be early."""
    problem, curve = problem_of(planar4, "work"), bent_curve(planar4)
    model = LinearModel(problem, curve, DURATION, end_moves=False, box=np.full(planar4.n, 0.1))
    late = Bend(np.append(np.zeros(28), 1e3), np.eye(29), np.zeros((29, 29)), Kinks.none(29))
    step = model.best_step(1.0, bend=late, longest=2.9, most_iterations=100)
    assert step is not None
    assert step[28] == pytest.approx(-0.1)


def test_a_linear_clearance_gives_the_same_row_before_and_after_a_step(planar4: bp.Robot) -> None:
    """A margin that is linear in the joints is the same half-space wherever it is linearised."""
    problem, curve = problem_of(planar4, "work"), bent_curve(planar4)
    gradient, step = np.array([[1.0, -0.5, 0.2, 0.0]]), 0.1 * np.random.default_rng(2).normal(size=28)
    model = LinearModel(problem, curve, DURATION, end_moves=False, box=np.full(planar4.n, 0.2))
    moved = curve.control.copy()
    moved[1:-1] += step.reshape(-1, 4)
    margins = [
        Margins(np.array([9]), margin, margin, gradient)
        for at in (curve, curve.moved_to(moved))
        for margin in [0.05 + gradient @ (at.weights(25) @ at.control)[9]]
    ]
    model.keep_clear(margins[0], 25)
    model.keep_clear(margins[1], 25, after=step)
    here, there = model.program(1.0).rows
    np.testing.assert_allclose(there.G, here.G)
    np.testing.assert_allclose(there.h, here.h)


def test_no_limit_is_exceeded_in_the_least_duration(backhoe: bp.Robot) -> None:
    problem, curve = problem_of(backhoe, "work"), bent_curve(backhoe)
    T = OwnTime(problem, drive_of(problem)).least_duration(curve, 1.0)
    motion, faster = (time_evenly(curve, duration) for duration in (T, 0.97 * T))
    assert np.max(limit_usage(problem, motion).ratio) < 1.05
    assert np.max(limit_usage(problem, faster).ratio) > 1.0
    assert time_evenly(curve, 0.97 * T, problem.limits, drive=drive_of(problem)).duration > 0.97 * T


def test_a_motion_too_fast_for_a_moment_is_slowed_only_there(planar4: bp.Robot) -> None:
    """The rate 30 d u^2 (1 - u)^2 / T is 1.875 d / T in the middle; 1 % less is exceeded for 7 % of the time."""
    T = 10.0
    rate = 1.875 / (1.01 * T)
    limits = replace(problem_of(planar4, "work").limits, velocity=np.full(4, rate))

    def turn(u: Vector, derivative: int) -> Matrix:
        assert derivative == 0
        return np.outer(u**3 * (10.0 - 15.0 * u + 6.0 * u**2), np.ones(4))

    motion = time_evenly(turn, T, limits)
    assert T < motion.duration < 1.002 * T
    assert np.max(np.abs(motion.segment_velocities())) <= rate * (1.0 + 1e-6)
    np.testing.assert_allclose(motion.q[[0, -1], 0], [0.0, 1.0])


def test_a_step_teaches_the_curvature_of_a_quadratic_cost_along_it() -> None:
    rng = np.random.default_rng(0)
    root, other = rng.normal(size=(2, 11, 11))
    rest, known = root @ root.T + np.eye(11), other @ other.T  # cost = x.(rest + known).x / 2 + f.x
    bend = Bend.smooth(rng.normal(size=11), known, Kinks.none(11), 6, np.array([1.0, 0.5]), 0.25, 2.0)
    for _ in range(3):
        step = rng.normal(size=11)
        bend = bend.after(step, bend.slope + (rest + known) @ step, known, Kinks.none(11))
        if step @ rest @ step >= 0.2 * step @ bend.curvature @ step:
            np.testing.assert_allclose(bend.curvature @ step, rest @ step, rtol=1e-8, atol=1e-8)
        assert np.linalg.eigvalsh(bend.curvature).min() > 0.0


def test_the_learnt_curvature_stays_positive_on_a_concave_cost() -> None:
    rng = np.random.default_rng(1)
    nothing = np.zeros((11, 11))
    bend = Bend.smooth(rng.normal(size=11), nothing, Kinks.none(11), 6, np.array([1.0, 0.5]), 0.25, 2.0)
    for _ in range(20):
        step = rng.normal(size=11)
        bend = bend.after(step, bend.slope - 3.0 * step, nothing, Kinks.none(11))
    assert np.linalg.eigvalsh(bend.curvature).min() > 0.0


def test_a_step_that_shows_no_curvature_reduces_it_in_all_directions() -> None:
    """By hand: the slope is constant along a step, so all is scaled by 0.6, and a fifth of that is left along it."""
    bend = Bend(np.array([1.0, 2.0]), np.eye(2), np.zeros((2, 2)), Kinks.none(2))
    after = bend.after(np.array([1.0, 0.0]), bend.slope, bend.known, bend.kinks)
    np.testing.assert_allclose(after.curvature, [[0.2 * 0.6, 0.0], [0.0, 0.6]], atol=1e-12)


def test_a_step_that_confirms_the_curvature_leaves_it_unchanged() -> None:
    curvature = np.array([[2.0, 0.5], [0.5, 1.0]])
    bend = Bend(np.array([1.0, 2.0]), curvature, np.zeros((2, 2)), Kinks.none(2))
    step = np.array([0.3, -0.1])
    after = bend.after(step, bend.slope + curvature @ step, bend.known, bend.kinks)
    np.testing.assert_allclose(after.curvature, curvature, atol=1e-12)
