"""Known distances along a curve are not measured again, and results are the same."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Indices, Matrix
from backhoe_planner.motion import build_problem
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.kept_margins import KeptMargins
from backhoe_planner.planning.descent.looks import Looks
from backhoe_planner.planning.descent.margins import Margins, find_margins
from backhoe_planner.planning.descent.seen_distances import SeenDistances
from backhoe_planner.site import ClearanceScreen
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site


def test_a_known_distance_is_reduced_by_the_motion_since() -> None:
    """Joint 1 moved by 0.1 rad, joint 2 by -0.2: the first distance loses 2 x 0.1, the second 0.1 + 0.2."""
    seen = SeenDistances()
    travel = np.array([[2.0, 0.0], [1.0, 1.0]])
    seen.keep(np.array([7]), np.array([[0.0, 0.0]]), np.array([[1.0, 0.5]]))
    found = seen.bounds(np.array([3, 7]), np.array([[5.0, 5.0], [0.1, -0.2]]), travel)
    np.testing.assert_allclose(found, [[-np.inf, -np.inf], [0.8, 0.2]])
    seen.keep(np.array([90, 7]), np.array([[0.0, 1.0], [0.1, -0.2]]), np.array([[3.0, 4.0], [0.7, 0.6]]))
    found = seen.bounds(np.array([7, 90]), np.array([[0.1, -0.1], [0.5, 1.0]]), travel)
    np.testing.assert_allclose(found, [[0.7, 0.5], [2.0, 3.5]])


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize(
    ("machine", "kind"),
    [("backhoe", "narrow"), ("panda", "narrow"), ("telescope", "narrow"), ("backhoe", "scan"), ("panda", "terrain")],
)
def test_margins_are_the_same_without_known_distances(
    machine: str, kind: str, together: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A curve changes as in a descent, and some of its places are checked in some rounds only.

    Against measurements of one configuration after the other; `together` means all in one compiled call.
    """
    robot = load_machine(machine)
    problem = build_problem(robot, random_site(robot, SiteKey(machine, kind, "goal", 0, 5)).scene)
    start, limits = problem.start_q, robot.limits
    assert start is not None
    rng = np.random.default_rng(2)
    end = np.clip(start + rng.uniform(-0.6, 0.6, robot.n), limits.lower, limits.upper)
    curve, seen, measured = JointCurve.straight(start, end, 8), SeenDistances(), np.zeros(2)
    with_it, without = (bp.Proximity(robot, problem.obstacles) for _ in range(2))
    monkeypatch.setattr(without, "near_in_each_unchecked", lambda *_: None)
    if not together:
        monkeypatch.setattr(with_it, "near_in_each_unchecked", lambda *_: None)
    keep = problem.keep
    kept = None if keep is None else KeptMargins(keep, spare=0.003, allowed=0.0015)
    for size in (0.1, 0.05, 0.02, 0.01, 0.01, 0.005):
        step = rng.normal(0.0, size, curve.control.shape)
        curve = curve.moved_to(np.clip(curve.control + step, limits.lower, limits.upper))
        places = np.flatnonzero(rng.uniform(size=49) < 0.8)
        q = curve.at(np.linspace(0.0, 1.0, 49)[places])
        before = np.array([with_it.measured, without.measured])
        reach = rng.choice([0.08, 0.08, 0.4], len(places))
        found, plain = (
            find_margins(
                proximity, kept, q, spare=0.003, reach=reach, time=0.0, places=places, seen=own
            )
            for proximity, own in ((with_it, seen), (without, None))
        )  # fmt: skip
        assert found.least == pytest.approx(plain.least, abs=1e-9)  # coal starts from its last result
        np.testing.assert_array_equal(found.place, plain.place)
        np.testing.assert_allclose(found.margin, plain.margin, atol=1e-9)
        np.testing.assert_allclose(found.gradient, plain.gradient, atol=1e-6)
        measured += np.array([with_it.measured, without.measured]) - before
    if kind == "narrow":
        assert measured[0] < 0.97 * measured[1]  # bounds by balls leave little else to save


def test_collisions_between_checked_places_are_noticed_the_same_without_known_distances(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As if every place between were screened; known distances leave fewer than half of them to the screen."""
    robot = load_machine("backhoe")
    problem = build_problem(robot, random_site(robot, SiteKey("backhoe", "narrow", "goal", 1, 5)).scene)
    start, limits = problem.start_q, robot.limits
    assert start is not None
    proximity = bp.Proximity(robot, problem.obstacles)
    screen = ClearanceScreen(proximity, spare=0.0015)
    screened: list[int] = []
    first = screen.first_not_kept_unchecked

    def counting(q: Matrix) -> int:
        screened.append(len(q))
        return first(q)

    monkeypatch.setattr(screen, "first_not_kept_unchecked", counting)
    noticed, asked = [], []
    for known in (True, False):
        looks = Looks(proximity, screen, problem.keep, steps=8, spare=0.003, time=0.0)
        if not known:
            monkeypatch.setattr(looks, "_not_known_clear", lambda curve, between, before, q: between)
        screened.clear()
        rng, found = np.random.default_rng(4), list[tuple[float, list[int]]]()
        for _ in range(6):
            end = np.clip(start + rng.uniform(-0.9, 0.9, robot.n), limits.lower, limits.upper)
            margins = looks.find_margins(JointCurve.straight(start, end, 8))
            found.append((round(margins.least, 8), margins.place.tolist()))
        noticed.append((found, looks.known))
        asked.append(sum(screened))
    assert noticed[0] == noticed[1]
    assert noticed[0][1][0] > 9
    assert asked[0] < 0.5 * asked[1]


def test_a_curve_is_seen_anew_only_where_that_is_new(monkeypatch: pytest.MonkeyPatch) -> None:
    """After other curves have added places and larger reaches, as if all of it were looked at again."""
    robot = load_machine("backhoe")
    problem = build_problem(robot, random_site(robot, SiteKey("backhoe", "narrow", "goal", 1, 5)).scene)
    start, limits = problem.start_q, robot.limits
    assert start is not None
    proximity = bp.Proximity(robot, problem.obstacles)
    looks = Looks(proximity, ClearanceScreen(proximity, spare=0.0015), None, steps=8, spare=0.003, time=0.0)
    asked: list[int] = []
    margins_at = looks._margins_at

    def counting(q: Matrix, places: Indices) -> Margins:
        asked.append(len(q))
        return margins_at(q, places)

    monkeypatch.setattr(looks, "_margins_at", counting)
    rng, again, all_anew, changed = np.random.default_rng(4), 0, 0, 0
    curve = JointCurve.straight(start, np.clip(start + 0.4, limits.lower, limits.upper), 8)
    seen = looks.find_margins(curve)
    for _ in range(6):
        end = np.clip(start + rng.uniform(-1.5, 1.5, robot.n), limits.lower, limits.upper)
        known = looks.known
        looks.widen(looks.find_margins(JointCurve.straight(start, end, 8)))
        changed += looks.known != known
        asked.clear()
        seen = looks.find_margins(curve, before=seen)
        again += sum(asked)
        asked.clear()
        plain = looks.find_margins(curve)
        all_anew += sum(asked)
        found = seen.in_order()
        np.testing.assert_array_equal(found.place, plain.place)
        np.testing.assert_allclose(found.margin, plain.margin, atol=1e-9)
        np.testing.assert_allclose(found.gradient, plain.gradient, atol=1e-6)
        assert seen.least == pytest.approx(plain.least, abs=1e-9)
    assert changed > 1
    assert 0 < again < 0.6 * all_anew
