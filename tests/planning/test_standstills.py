"""Joints of a curve stand still where that lowers hydraulic energy, which jumps as a rod begins to move."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from one_joint_search import ended_search

import backhoe_planner as bp
from backhoe_planner.motion import build_problem, drive_of
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.kinks import LEAST_WIDTH
from backhoe_planner.planning.descent.own_time import OwnTime
from backhoe_planner.planning.refining import refining
from backhoe_planner.planning.refining.refining import Refining
from backhoe_planner.planning.refining.standstills import with_standstills
from backhoe_planner.planning.search.effort import Brake, OutOfTime
from validation.sites import SiteKey, random_site

START = np.array([-0.5, 0.3, -1.4, -0.8])
SWING = np.array([1.0, 0.0, 0.0, 0.0])
DURATION = 8.0  # s


@pytest.fixture(scope="module")
def own_time(backhoe: bp.Robot) -> OwnTime:
    joints = {"joints": dict(zip(backhoe.joint_names, START.tolist(), strict=True))}
    content = {"version": 1, "start": joints, "task": {"goal": joints}, "objective": "hydraulic"}
    problem = build_problem(backhoe, bp.scene_from_dict(content))
    return OwnTime(problem, drive_of(problem)).looked_at(fine=True)


def cost(own_time: OwnTime, curve: JointCurve) -> float:
    return own_time.cost(curve, DURATION, width=LEAST_WIDTH)


def refusing(asked: list[JointCurve]) -> Callable[[JointCurve, float], bool]:
    """Allows no curve, and appends those that it is asked about to `asked`."""

    def is_allowed(curve: JointCurve, _: float) -> bool:
        asked.append(curve)
        return False

    return is_allowed


@pytest.fixture(scope="module")
def swing() -> JointCurve:
    """Only the swing turns."""
    return JointCurve.straight(START, START + SWING, 12)


def test_a_boom_that_creeps_up_while_the_machine_swings_stands_still(own_time: OwnTime, swing: JointCurve) -> None:
    """By 0.1 mrad, for which the pump needs the boom's pressure for all the oil of the swing."""
    control = swing.control.copy()
    control[4:8, 1] += 1e-4
    creeping = swing.moved_to(control)
    assert cost(own_time, creeping) > 2.0 * cost(own_time, swing)
    found = with_standstills(own_time, creeping, DURATION, lambda *_: True, brake=Brake())
    np.testing.assert_array_equal(found.control, swing.control)


def test_a_curve_stays_as_it_is_if_no_other_is_allowed(own_time: OwnTime, swing: JointCurve) -> None:
    control = swing.control.copy()
    control[4:8, 1] += 1e-4
    creeping, asked = swing.moved_to(control), list[JointCurve]()
    found = with_standstills(own_time, creeping, DURATION, refusing(asked), brake=Brake())
    assert found is creeping
    assert asked
    assert all(cost(own_time, curve) < cost(own_time, creeping) for curve in asked)


@pytest.mark.parametrize("seed", range(4))
def test_standstills_leave_the_ends_and_cost_less(own_time: OwnTime, swing: JointCurve, seed: int) -> None:
    """Of curves on which all joints move to and fro by some hundredths of a radian."""
    control = swing.control.copy()
    control[1:-1] += 0.02 * np.random.default_rng(seed).normal(size=control[1:-1].shape)
    curve = swing.moved_to(control)
    found = with_standstills(own_time, curve, DURATION, lambda *_: True, brake=Brake())
    np.testing.assert_array_equal(found.control[[0, -1]], control[[0, -1]])
    assert cost(own_time, found) < 0.9 * cost(own_time, curve)
    stays = np.diff(found.control, axis=0) == 0.0
    assert stays.any()
    assert not (np.diff(control, axis=0) == 0.0).any()


def test_a_budget_ends_the_comparison_of_standstills_too(own_time: OwnTime, swing: JointCurve) -> None:
    """Also of those of a curve to which no standstill is put in."""
    with pytest.raises(OutOfTime):
        with_standstills(own_time, swing, DURATION, lambda *_: False, brake=Brake(0.0))


@pytest.mark.parametrize("seed", range(3))
def test_standstills_are_compared_by_the_costs_of_the_curves_with_them(
    own_time: OwnTime, swing: JointCurve, seed: int
) -> None:
    """The first that is tried is the one whose whole curve costs least at as few places."""
    control = swing.control.copy()
    control[1:-1] += 0.02 * np.random.default_rng(10 + seed).normal(size=control[1:-1].shape)
    curve, tried = swing.moved_to(control), list[JointCurve]()
    with_standstills(own_time, curve, DURATION, refusing(tried), brake=Brake())
    others = []
    for joint, first, last in itertools.product(range(4), range(13), range(13)):
        for at in (first, last) if first < last else ():
            still = control.copy()
            still[first : last + 1, joint] = control[at, joint]
            if (still[[0, -1]] == control[[0, -1]]).all():
                others.append(swing.moved_to(still))
    costs = own_time.costs(others, np.full(len(others), DURATION), width=LEAST_WIDTH, places=2)
    np.testing.assert_array_equal(tried[0].control, others[int(np.argmin(costs))].control)


def test_a_plan_for_hydraulic_energy_lets_joints_stand_still(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On this site by a tenth of the energy and more, within the allowed time, and proven."""
    costs: list[tuple[float, float]] = []

    def count(self: Refining) -> None:
        before = self._best().cost
        plain(self)
        costs.append((before, self._best().cost))

    plain = Refining._let_stand_still
    monkeypatch.setattr(Refining, "_let_stand_still", count)
    site = random_site(backhoe, SiteKey("backhoe", "cluttered", "goal", 0, 543001))
    plan = bp.plan(backhoe, site.scene.model_copy(update={"objective": "hydraulic"}), seed=0)
    assert plan.verified, plan.message
    assert plan.findings.allowed_time is not None
    assert plan.trajectory.duration <= plan.findings.allowed_time
    assert min(after for _, after in costs) < 0.9 * min(before for before, _ in costs)
    assert plan.metrics.energy["hydraulic"] == pytest.approx(min(after for _, after in costs), rel=1e-6)


def test_a_cost_that_does_not_jump_gets_no_standstills(planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refining, "with_standstills", lambda *_: pytest.fail("a joint is let stand still"))
    _, _, search = ended_search(planar4)
    assert search.best is not None
    search._refining.run()
