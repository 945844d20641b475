"""Sequences: legs planned together as one motion, with a certificate for the whole and for each leg."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backhoe_planner import (
    InputError,
    Plan,
    PlannerStep,
    Robot,
    SceneError,
    Trajectory,
    build_problem,
    certify,
    load_plan,
    plan,
    scene_from_dict,
)
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import overlap
from backhoe_planner.planning import EFFORTS, Leg, plan_legs
from backhoe_planner.planning.search.effort import Brake, Work
from backhoe_planner.planning.sequence.plan_task import plan_problem

START = {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}}
POST = {"name": "post", "shape": "cylinder", "radius": 0.1, "length": 3.0, "position": [2.5, 3.0, 1.5]}
FOLDED = {"joint1": 0.0, "joint2": 0.8, "joint3": 0.8, "joint4": 0.8}  # of planar4
CUT = ([2.5, 2.0, 1.0], [2.2, 1.8, 1.0])  # with a pitch, so that no joint is free
LEGS: list[dict[str, Any]] = [
    {"name": "reach", "goal": {"position": [4.0, 0.0, 0.8]}},
    {"name": "swing", "goal": {"position": [2.5, 2.5, 1.2]}, "payload": 250.0, "speed": 1.0, "keep": {"above": 0.5}},
    {"name": "rest", "wait": 0.7},
    {"name": "cut", "path": {"waypoints": [{"position": at, "pitch": -1.2} for at in CUT]}},
]


def scene_of(*legs: dict[str, Any], **keys: Any) -> Any:
    return scene_from_dict({"version": 1, "start": START, "task": {"sequence": list(legs)}} | keys)


@pytest.fixture(scope="module")
def done(backhoe: Robot) -> Plan:
    return plan(backhoe, scene_of(*LEGS), effort="quick")


def test_legs_are_one_motion_and_each_keeps_its_own_conditions(done: Plan) -> None:
    assert done.verified, done.message
    assert [leg.name for leg in done.legs] == ["reach", "swing", "rest", "cut"]
    assert [leg.first for leg in done.legs[1:]] == [leg.last for leg in done.legs[:-1]]
    assert (done.legs[0].first, done.legs[-1].last) == (0, len(done.trajectory) - 1)
    reach, swing, rest, cut = done.legs
    tips = done.tip_path()
    for leg, goal in ((reach, [4.0, 0.0, 0.8]), (swing, [2.5, 2.5, 1.2]), (rest, [2.5, 2.5, 1.2])):
        assert np.linalg.norm(tips[leg.last] - goal) <= 1e-3
    assert np.linalg.norm(tips[cut.last] - [2.2, 1.8, 1.0]) <= 5e-3
    assert rest.trajectory.duration == pytest.approx(0.7, abs=1e-9)
    steps = np.linalg.norm(np.diff(tips[swing.first : swing.last + 1], axis=0), axis=1)
    assert np.max(steps / np.diff(done.trajectory.time[swing.first : swing.last + 1])) <= 1.03


def test_costs_of_a_sequence_add_up_and_its_margins_are_those_of_the_tightest_leg(done: Plan) -> None:
    assert done.metrics.duration == pytest.approx(sum(leg.metrics.duration for leg in done.legs))
    work = [leg.metrics.energy["work"] for leg in done.legs]
    assert done.metrics.energy["work"] == pytest.approx(sum(work))
    assert done.energy().work[-1] == pytest.approx(sum(work))
    assert len(done.energy().work) == len(done.trajectory)
    tightest = min(leg.certificate.min_clearance.margin for leg in done.legs if leg.certificate.min_clearance)
    assert done.certificate.min_clearance is not None
    assert done.certificate.min_clearance.margin == tightest
    ratios = [leg.certificate.hydraulics.ratio for leg in done.legs if leg.certificate.hydraulics]
    assert done.certificate.hydraulics is not None
    assert done.certificate.hydraulics.ratio == max(ratios)
    (kept,) = done.certificate.keep
    assert kept.words.startswith("leg 'swing': ")
    assert f" at {kept.time:.2f} s, allowed " in kept.words  # on the clock of the whole motion, as in the table
    assert done.legs[1].begins <= kept.time <= done.legs[2].begins


def test_a_sequence_read_from_its_file_is_proven_anew(done: Plan, tmp_path: Path) -> None:
    done.save(tmp_path / "plan.json")
    again = load_plan(tmp_path / "plan.json")
    assert again.verified
    assert [(leg.name, leg.first, leg.last) for leg in again.legs] == [(o.name, o.first, o.last) for o in done.legs]
    assert again.certificate.clearances == done.certificate.clearances


def test_a_broken_condition_is_reported_with_its_leg(backhoe: Robot, done: Plan) -> None:
    post = POST | {"position": done.tip_path()[done.legs[1].last - 5].tolist()}
    there = scene_of(*LEGS, obstacles=[post | {"legs": ["swing"]}])
    found = certify(backhoe, there, done.trajectory)
    assert not found.verified
    assert all(problem.startswith("leg 'swing': ") for problem in found.problems)
    assert found.min_clearance is not None
    assert f" of post at {found.min_clearance.time:.2f} s, " in found.problems[0]
    assert found.min_clearance.time > done.legs[1].begins
    elsewhere = [post | {"legs": ["reach"], "position": [0.0, 0.0, 30.0]}]
    assert certify(backhoe, scene_of(*LEGS, obstacles=elsewhere), done.trajectory).verified


def test_limits_that_are_broken_in_a_leg_are_told_with_the_time_of_the_whole_motion(backhoe: Robot, done: Plan) -> None:
    """Driven at three times the speed, the legs exceed their limits of velocity."""
    given = done.trajectory
    fast = Trajectory.from_steps(given.time / 3.0, given.q, begins=given.begins)
    found = certify(backhoe, scene_of(*LEGS), fast)
    legs = [leg for leg in found.legs if leg.begins > 0.0 and not leg.certificate.velocity.kept]
    assert legs
    for leg in legs:
        use = leg.certificate.velocity
        words = f"leg {leg.name!r}: {use.joint} exceeds its velocity limit at {leg.begins + use.time:.2f} s "
        assert any(problem.startswith(words) for problem in found.problems)


def test_a_short_wait_and_a_missing_leg_are_refuted(backhoe: Robot, done: Plan) -> None:
    longer = [*LEGS[:2], LEGS[2] | {"wait": 0.8}, LEGS[3]]
    found = certify(backhoe, scene_of(*longer), done.trajectory)
    assert any("the machine waits 0.7 s instead of 0.8 s" in problem for problem in found.problems)
    cut_off = done.trajectory.begins[:2]
    part = Trajectory.from_steps(
        done.trajectory.time[: done.legs[1].last + 1], done.trajectory.q[: done.legs[1].last + 1], begins=cut_off
    )
    found = certify(backhoe, scene_of(*LEGS), part)
    assert found.problems == ("the leg 'rest' is not begun", "the leg 'cut' is not begun")


def test_a_sequence_may_begin_with_a_wait(backhoe: Robot) -> None:
    found = plan(backhoe, scene_of({"name": "warm up", "wait": 0.5}, LEGS[0]), effort="quick")
    assert found.verified, found.message
    assert found.legs[0].trajectory.duration == pytest.approx(0.5, abs=1e-9)


def test_the_first_leg_that_moves_is_planned_again_after_a_wait(backhoe: Robot) -> None:
    either = {"name": "either", "goal": [NEAR, FAR]}
    right = {"name": "right", "goal": {"position": [1.0, -3.6, 1.2]}}
    found = plan(backhoe, scene_of({"name": "warm up", "wait": 0.5}, either, right), effort="quick")
    assert found.verified, found.message
    assert found.legs[1].certificate.goal == 2


def test_a_motion_longer_than_any_number_of_a_scene_may_be_is_written_and_read(backhoe: Robot, tmp_path: Path) -> None:
    waits = [{"name": name, "wait": 9e4} for name in ("night", "day")]
    plan(backhoe, scene_of(*waits, LEGS[0]), effort="quick").save(tmp_path / "p.json")
    found = load_plan(tmp_path / "p.json")
    assert found.verified, found.message
    assert found.legs[1].trajectory.duration == pytest.approx(9e4)
    assert found.trajectory.duration > 1.8e5


def test_motions_with_legs_and_scenes_with_a_sequence_go_together_only(backhoe: Robot, done: Plan) -> None:
    with pytest.raises(InputError, match=r"trajectory\.begins"):
        certify(backhoe, scene_of(*LEGS), replace(done.trajectory, begins=()))
    one = scene_from_dict({"version": 1, "start": START, "task": {"goal": LEGS[0]["goal"]}})
    with pytest.raises(InputError, match="the scene has no sequence"):
        certify(backhoe, one, done.trajectory)


def test_a_goal_out_of_reach_is_told_before_any_leg_is_planned(backhoe: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine reaches about 6 m from its swing axis; the leg with a second goal in reach is no obstacle."""

    def not_to_be_called(*_: object, **__: object) -> None:
        raise AssertionError("a leg was planned")

    monkeypatch.setattr("backhoe_planner.planning.sequence.leg_planning.plan_motion", not_to_be_called)
    beyond = {"position": [30.0, 0.0, 0.0]}
    either, far = {"name": "either", "goal": [beyond, NEAR]}, {"name": "far", "goal": [beyond]}
    found = plan(backhoe, scene_of(LEGS[0], either, far), effort="quick")
    assert (found.verdict, found.reason, len(found.legs)) == ("failed", "unreachable", 1)
    assert np.ptp(found.trajectory.q, axis=0).max() == 0.0
    words = f"leg {LEGS[0]['name']!r}: not begun, because leg 'far' cannot be done: the goal (30.00, 0.00, 0.00) is out"
    assert found.message.startswith(words)
    with pytest.raises(AssertionError, match="a leg was planned"):
        plan(backhoe, scene_of(LEGS[0], either), effort="quick")


def test_a_failure_names_the_leg(backhoe: Robot) -> None:
    far = {"name": "too far", "goal": {"position": [14.0, 0.0, 0.5]}}
    found = plan(backhoe, scene_of(LEGS[0], far, LEGS[2]), effort="quick")
    assert (found.verdict, found.reason) == ("failed", "unreachable")
    assert "leg 'too far' cannot be done: the goal (14.00, 0.00, 0.50) is out of reach" in found.message
    assert "the leg 'rest' is not begun" in found.certificate.problems


def test_a_failure_also_names_a_later_leg_whose_end_is_impossible(backhoe: Robot) -> None:
    """A mast is in the bucket at the end of the last leg, which may be the one with the mistake."""
    far = {"name": "too far", "goal": {"position": [14.0, 0.0, 0.5]}}
    joints = {"swing": -1.2, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    x, y, z = Kinematics(backhoe).at(np.array(list(joints.values()))).tip_position.tolist()
    mast = {"name": "mast", "shape": "sphere", "radius": 0.3, "position": [x, y, z]}
    back, home = {"name": "back", "goal": {"joints": joints}}, {"name": "home", "goal": {"joints": START["joints"]}}
    found = plan(backhoe, scene_of(far, home, back, obstacles=[mast]), effort="quick")
    assert found.reason == "unreachable"
    assert "; leg 'back' cannot be done either: at the goal bucket is 0.3" in found.message
    assert "inside mast" in found.message
    assert "home" not in found.message


def test_a_failure_gives_times_from_the_beginning_of_the_sequence(backhoe: Robot) -> None:
    """A dome appears around the machine at 2 s, 1 s after the second leg has begun."""
    dome = {"name": "dome", "shape": "sphere", "radius": 9.0, "position": [0.0, 0.0, 0.0], "appears_at": 2.0}
    found = plan(backhoe, scene_of({"name": "rest", "wait": 1.0}, LEGS[0], obstacles=[dome]), effort="quick")
    assert found.reason == "blocked"
    name = LEGS[0]["name"]
    assert found.message.startswith(f"leg {name!r}: dome appears at 2.0")


@pytest.mark.parametrize(
    ("ball", "how"), [({"appears_at": 1.0}, "appears at 1.00 s"), ({"velocity": [0.0, 0.01, 0.0]}, "moves"), ({}, "")]
)
def test_a_wait_that_fails_says_that_it_does_not_give_way(backhoe: Robot, ball: dict[str, object], how: str) -> None:
    """A ball comes to the bucket of a machine that waits, or stands there from the beginning, where nothing is said."""
    tip = Kinematics(backhoe).at(np.array(list(START["joints"].values()))).tip_position.tolist()
    there = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": tip} | ball
    found = plan(backhoe, scene_of({"name": "rest", "wait": 2.0}, LEGS[0], obstacles=[there]), effort="quick")
    assert found.reason == "blocked"
    assert ("a wait does not give way to ball, which " + how in found.message) == bool(how)
    assert "leg 'rest': bucket comes to " in found.message


def test_every_clearance_of_a_sequence_is_in_one_of_its_legs(done: Plan) -> None:
    for near in done.certificate.clearances:
        (leg,) = [leg for leg in done.certificate.legs if leg.name == done.certificate.leg_of(near)]
        own = [one for one in leg.certificate.clearances if (one.kind, one.obstacle) == (near.kind, near.obstacle)]
        assert own[0].margin == near.margin
        assert leg.begins <= near.time <= done.trajectory.time[leg.last]
    assert done.legs[0].certificate.leg_of(done.legs[0].certificate.clearances[0]) == "", "no sequence"


def test_a_carried_load_counts_as_a_link_of_the_machine(backhoe: Robot) -> None:
    pipe = {"name": "pipe", "shape": "capsule", "from": [0.0, 0.0, 0.0], "to": [0.0, 0.0, 1.0], "radius": 0.1}
    problem = build_problem(backhoe, scene_of(LEGS[0], LEGS[1] | {"carries": pipe}))
    bare, loaded = (leg.robot for leg in problem.legs)
    assert set(loaded.link_names) - set(bare.link_names) == {"pipe"}
    assert loaded.pieces_of(("bucket",)) == (*bare.pieces_of(("bucket",)), len(bare.pieces))
    assert loaded.pieces_of(("boom",)) == bare.pieces_of(("boom",))


@pytest.mark.long
def test_a_given_motion_is_a_leg_after_an_approach_to_its_beginning(backhoe: Robot, done: Plan) -> None:
    problem = build_problem(backhoe, scene_of(LEGS[0], {"name": "cut", "wait": 1.0}))
    q = done.trajectory.q[done.legs[0].last] + np.array([0.05, 0.02, 0.0, 0.0])
    ready = Trajectory.from_steps(np.linspace(0.0, 2.0, 101), q + np.linspace(0.0, 0.1, 101)[:, None] ** 2)
    cut = replace(problem.legs[1], wait=None)
    found = plan_legs([Leg(problem.legs[0]), Leg(cut, ready)], effort=EFFORTS["quick"])
    assert found.failed is None, found.certificate.problems
    last = found.trajectory.part(found.trajectory.begins[1], len(found.trajectory) - 1)
    assert np.allclose(last.q[-101:], ready.q, atol=1e-9)
    assert last.duration > ready.duration
    with pytest.raises(InputError, match="is the name of two legs"):
        plan_legs([Leg(problem.legs[0]), Leg(problem.legs[0])])


def test_legs_blend_within_their_tolerances(backhoe: Robot) -> None:
    up = {"name": "up", "goal": {"position": [4.0, 0.0, 1.2]}}
    round_ = {"name": "round", "goal": {"position": [2.6, 2.6, 1.2]}, "payload": 200.0}

    def of(tolerance: float) -> Plan:
        goal = up["goal"] | {"tolerance": tolerance}  # type: ignore[operator]
        return plan(backhoe, scene_of(up | {"goal": goal}, round_), effort="quick")

    stops, goes_on = of(0.001), of(0.25)
    assert stops.verified, stops.message
    assert goes_on.verified, goes_on.message
    at = stops.legs[0].last
    assert np.max(np.abs(stops.trajectory.segment_velocities()[at - 1 : at + 1])) < 0.05
    at = goes_on.legs[0].last
    assert np.max(np.abs(goes_on.trajectory.segment_velocities()[at - 1 : at + 1])) > 0.1
    assert goes_on.metrics.duration < stops.metrics.duration - 0.1
    assert 1e-3 < np.linalg.norm(goes_on.tip_path()[at] - [4.0, 0.0, 1.2]) <= 0.25
    assert certify(backhoe, goes_on.scene, goes_on.trajectory).verified
    strict = scene_of(up | {"goal": up["goal"] | {"tolerance": 0.001}}, round_)  # type: ignore[operator]
    assert not certify(backhoe, strict, goes_on.trajectory).verified


def test_overlapping_motions_add_up() -> None:
    ramp = np.linspace(0.0, 1.0, 51)
    smooth = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    first = Trajectory.from_steps(ramp, np.outer(smooth, [1.0, 0.0]))
    second = Trajectory.from_steps(ramp, np.array([1.0, 0.0]) + np.outer(smooth, [0.0, 2.0]))
    joined, shared = overlap(first, second, 0.4)
    assert joined.duration == pytest.approx(1.6)
    assert np.allclose(joined.q[[0, -1]], [[0.0, 0.0], [1.0, 2.0]])
    middle = joined.at(0.8)  # 0.2 s before the first ends, after 0.2 s of the second
    part = 0.2**3 * (10.0 - 15.0 * 0.2 + 6.0 * 0.2**2)
    assert np.allclose(middle, [1.0 - part, 2.0 * part], atol=1e-4)
    assert joined.time[shared][[0, -1]] == pytest.approx([0.6, 1.0])


NEAR, FAR = {"position": [4.0, 0.8, 0.2]}, {"position": [3.6, -1.6, 1.0]}  # from the start of the first leg


def cost(found: Any) -> float:
    assert found.failed is None, found.certificate.problems
    return float(found.cost)


@pytest.mark.long
def test_a_leg_ends_at_the_goal_nearer_to_the_next_leg(backhoe: Robot) -> None:
    either = {"name": "either", "goal": [NEAR, FAR]}
    right = {"name": "right", "goal": {"position": [1.0, -3.6, 1.2]}}
    legs = [Leg(leg) for leg in build_problem(backhoe, scene_of(either, right)).legs]
    alone = plan_legs(legs, effort=EFFORTS["quick"], ahead=False)
    ahead = plan_legs(legs, effort=EFFORTS["quick"])
    assert alone.done[0].certificate.goal == 1
    assert ahead.done[0].certificate.goal == 2
    assert cost(ahead) < 0.95 * cost(alone)


@pytest.mark.long
def test_a_sequence_reports_if_time_ran_out(backhoe: Robot) -> None:
    """The legs are planned one by one, and then no time is left for other ends."""

    class UsedUp(Brake):
        def is_used_up(self) -> bool:
            return True

        def check(self) -> None:
            return None

    problem = build_problem(backhoe, scene_of(*LEGS[:2]))
    for brake, said in ((UsedUp(5.0), "time ran out after 5 s"), (Brake(), "")):
        plan = plan_problem(problem, "auto", seed=0, effort="quick", brake=brake)
        assert plan.verified
        assert plan.note.startswith(said)
        assert bool(plan.note) == bool(said)


def test_a_sequence_is_complete_in_the_work_of_the_quick_effort_whatever_the_effort(backhoe: Robot) -> None:
    """Time runs out soon after as much counted work as the quick effort needs."""

    class Counted(Brake):
        most = np.inf

        def is_used_up(self) -> bool:
            return self.done > self.most

    legs = [Leg(leg) for leg in build_problem(backhoe, scene_of(*LEGS[:2])).legs]
    quick = Counted()
    cost(plan_legs(legs, effort=EFFORTS["quick"], brake=quick, ahead=False))
    assert quick.done > 0.0
    short = Counted()
    short.most = quick.done + 0.02
    cost(plan_legs(legs, effort=EFFORTS["normal"], brake=short))


def test_counted_work_is_added_up_for_all_searches_of_a_brake() -> None:
    """2,000 motions, 50 sweeps and 70 rounds count as 1 s, 1 s and 2 s, 1,000 steps of the law as 1 s."""
    brake = Brake()
    first, second = Work(EFFORTS["normal"], brake), Work(EFFORTS["quick"], brake)
    first.motions -= 2_000
    first.add_rounds("way_rounds")
    assert (first.descent_rounds, first.way_rounds, first.done) == (160, 0, 1.0)
    first.descent_rounds -= 70
    second.sweeps -= 50
    assert (first.done, second.done, brake.done) == pytest.approx((3.0, 1.0, 4.0))
    first.law_steps -= 500
    first.leave_law_steps(4_000)  # of the 11,500 that are left
    first.law_steps -= 1_000
    assert (first.law_steps, first.done) == pytest.approx((3_000, 4.5))
    first.leave_law_steps(5_000)  # there are fewer
    assert (first.law_steps, first.done) == pytest.approx((3_000, 4.5))


@pytest.mark.long
def test_other_ends_are_tried_if_a_later_leg_fails(backhoe: Robot) -> None:
    either = {"name": "either", "goal": [NEAR, FAR]}
    level = {"name": "high", "goal": {"position": [4.0, 1.0, 1.4]}, "keep": {"above": 0.6}}
    legs = [Leg(leg) for leg in build_problem(backhoe, scene_of(either, level)).legs]
    alone = plan_legs(legs, effort=EFFORTS["quick"], ahead=False)
    assert alone.failed is not None
    assert (alone.failed.problem.name, alone.failed.outcome.reason) == ("high", "start_breaks_keep")
    ahead = plan_legs(legs, effort=EFFORTS["quick"])
    assert ahead.certificate.verified, ahead.certificate.problems
    assert ahead.done[0].certificate.goal == 2


def test_a_wait_at_the_beginning_needs_a_start_given_by_joints(backhoe: Robot) -> None:
    legs = [{"name": "pause", "wait": 0.5}, {"name": "on", "goal": {"position": [4.0, 1.0, 0.5]}}]
    start: dict[str, object] = {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}}
    content: dict[str, object] = {"version": 1, "task": {"sequence": legs}}
    made = plan(backhoe, scene_from_dict(content | {"start": start}), effort="quick")
    assert made.verified
    begins = made.trajectory.time[list(made.trajectory.begins)]
    assert begins.tolist() == pytest.approx([0.0, 0.5])
    still = made.trajectory.time <= 0.5
    assert np.ptp(made.trajectory.q[still], axis=0).max() == 0.0
    start = {"tip": {"position": [4.0, 0.0, 0.5]}}
    with pytest.raises(SceneError, match=r"task\.sequence\[0\] \(pause\)\.wait|needs the joints at its start"):
        plan(backhoe, scene_from_dict(content | {"start": start}), effort="quick")


def test_a_watcher_gets_the_best_cost_with_the_unit_of_each_leg(planar4: Robot) -> None:
    """The scene gives no objective: each leg has its own."""
    legs = [
        {"name": "out", "goal": {"joints": FOLDED | {"joint1": 0.6}}, "objective": "velocity_norm"},
        {"name": "back", "goal": {"joints": FOLDED}},
    ]
    scene = scene_from_dict({"version": 1, "start": {"joints": FOLDED}, "task": {"sequence": legs}})
    seen: list[PlannerStep] = []
    assert plan(planar4, scene, effort="quick", watch=seen.append).verified
    assert {step.unit for step in seen if step.best is not None} == {"rad^2/s", "s"}
    assert all(step.unit == "" for step in seen if step.best is None)


@pytest.mark.parametrize("first", [0.5, 5.0])
def test_an_obstacle_that_moves_through_the_machine_in_a_later_leg_refutes_the_plan(
    planar4: Robot, first: float
) -> None:
    """A ball of 0.3 m comes down from y = 10 m at 1 m/s on a link 8 cm wide that stands still: it touches at 9.66 s."""
    fallen = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [2.5, 10.0, 0.0], "velocity": [0, -1, 0]}
    joints = dict.fromkeys(planar4.joint_names, 0.0)
    legs = [{"name": "wait", "wait": first}, {"name": "longer", "wait": 12.0 - first}]
    legs.append({"name": "end", "goal": {"joints": joints}})
    keys: dict[str, Any] = {"start": {"joints": joints}, "obstacles": [fallen], "clearance": 0.0}
    found = plan(planar4, scene_of(*legs, **keys), effort="quick")
    assert not found.verified
    tightest = found.certificate.min_clearance
    assert tightest is not None
    assert tightest.margin == pytest.approx(-0.34, abs=0.01)
    assert tightest.time >= 9.66


def test_a_leg_that_fails_does_not_spoil_the_leg_before(backhoe: Robot) -> None:
    """The swing is too weak for the second leg: the first one, which only lifts the boom, is proven all the same."""
    at = START["joints"] | {"boom": 0.8}
    legs: list[dict[str, Any]] = [
        {"name": "lift", "goal": {"joints": at}},
        {"name": "swing", "goal": {"joints": at | {"swing": 0.8}}},
        {"name": "far", "goal": {"joints": at | {"stick": -0.2}}, "payload": 9000.0},
    ]
    found = plan(backhoe, scene_of(*legs, limits={"effort": {"swing": 20.0}}), method="reactive", effort="quick")
    assert [leg.certificate.verified for leg in found.legs] == [True, False]
    assert found.message.startswith("leg 'swing': leg 'far' cannot be done either: stick cannot hold the load at the ")
    assert "lift" not in found.message
