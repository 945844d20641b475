"""Jobs that machine, ground or trucks do not allow: refused before planning, or ended with a reason."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_jobs import TINY, small_job, tiny_plan

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.job import Cut, Digger, Profile, Terrain, build_worksite, find_cut, job_from_dict, plan_job
from backhoe_planner.job.checked_job import check_whole_job
from backhoe_planner.job.cycles import cycle_planning, dumping
from backhoe_planner.job.cycles.cycle_planning import CyclePlanner, Failed
from backhoe_planner.job.cycles.dump_checks import check_dump
from backhoe_planner.job.cycles.dumping import NoDump, dump_of, ground_obstacles
from backhoe_planner.job.cycles.patterns import NextCut, Pattern, next_cut
from backhoe_planner.job.estimates import choose, in_full
from backhoe_planner.job.planner import _Refusals
from backhoe_planner.job.result.job_plan import PatternEstimate
from backhoe_planner.job.undug import find_undug
from backhoe_planner.job.worksite.lanes import allowed_heights, lanes_of
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.proof import Certificate, certify_problem
from backhoe_planner.show.job.truck_load import load_body
from backhoe_planner.site import Proximity, Soil

_TRUCK: dict[str, Any] = {"bed": {"position": [1.8, 2.9, 0.9], "size": [3.6, 1.9, 0.5]}}
_WIDE = {"low": [0.5, -4.5], "high": [6.0, 4.5]}


def trench(**keys: Any) -> dict[str, Any]:
    return {"trench": {"from": [4.4, 0.0], "to": [3.2, 0.0], "width": 0.6, "depth": 0.3} | keys}


@pytest.mark.parametrize(
    ("keys", "key", "said"),
    [
        ({"ground": {"cell": 0.5}}, "ground.cell", "too coarse"),
        ({"dig": trench(depth=4.0)}, "dig.trench.depth", "deeper than the machine digs"),
        # at least 0.3 m deep over half of 1.2 m x 0.6 m: 0.11 m^3 in place, 0.13 m^3 loose, for a truck of 0.12
        (
            {"dump": {"truck": {**_TRUCK, "capacity": 0.12}}, "bucket": {"capacity": 0.1}, "ground": _WIDE},
            "dump.truck.count", "take less than what is to be dug",
        ),
    ],
)  # fmt: skip
def test_jobs_that_cannot_succeed_are_refused_before_planning(keys: dict[str, Any], key: str, said: str) -> None:
    with pytest.raises(bp.SceneError, match=said) as refused:
        plan_job(small_job(**keys), effort="quick")
    assert refused.value.key == key


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (
            {"dig": trench(depth=0.05)},
            r"dig\.trench: is at most 0\.05 m deep, which is within the tolerance of 0\.05 m",
        ),
        ({"soil": {"repose": 1.55}}, r"soil\.repose: .*less than or equal to 1\.5 rad; found 1\.55"),
        ({"bucket": {"capacity": 1e-4}}, r"bucket\.capacity: .*greater than or equal to 0\.002 m\^3; found 0\.0001"),
        ({"dig": trench(depth="0,6")}, r"dig\.trench\.depth: a number takes a decimal point.*allowed: 0\.6"),
    ],
)
def test_impossible_values_in_a_job_are_refused_naming_the_key(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(bp.SceneError, match=said):
        small_job(**keys)


def test_a_trench_below_a_cable_is_refused_with_the_advice_to_move_the_cable() -> None:
    """It hangs 0.3 m above the whole trench, so that no place of the machine on its line helps."""
    cable = {"name": "cable", "shape": "capsule", "from": [3.0, 0.0, 0.3], "to": [4.6, 0.0, 0.3], "radius": 0.03}
    said = r"cannot be dug anywhere; found protected: cable \(the teeth must not touch cable: move it"
    with pytest.raises(bp.SceneError, match=said):
        plan_job(small_job(site={"obstacles": [cable]}, dig=trench(depth=0.5)))


def test_a_design_surface_out_of_reach_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "surface.csv"
    np.savetxt(file, np.full((7, 11), -0.3), delimiter=",")
    dig = {"surface": {"file": str(file), "low": [5.9, -0.3], "cell": 0.1}}
    with pytest.raises(bp.SceneError, match="cannot be dug anywhere") as refused:
        plan_job(small_job(dig=dig, ground={}), effort="quick")
    assert refused.value.key == "dig.surface"


@pytest.mark.parametrize(("objective", "shown", "unit"), [("time", 60.0, "s/m^3"), ("work", 12.0, "kJ/m^3")])
def test_the_cost_of_a_job_is_that_of_its_objective(objective: str, shown: float, unit: str) -> None:
    """30 s and 6 kJ for half a cubic metre."""
    job = small_job(objective=objective)
    name, scale = job.cost_unit
    assert name == unit
    assert scale * job.objective_of(30.0, 6e3) / 0.5 == pytest.approx(shown)


def test_a_pattern_that_digs_much_less_than_another_is_not_chosen() -> None:
    def estimate(name: str, bank: float, cost: float) -> PatternEstimate:
        return PatternEstimate(name, 3, bank, 1.0, 1.0, cost, True)

    found = in_full([estimate("all", 0.50, 107.0), estimate("nearly all", 0.48, 110.0), estimate("part", 0.30, 84.0)])
    assert [one.finished for one in found] == [True, True, False]
    assert choose(found, "time") == 0


def test_of_patterns_too_close_to_tell_the_one_with_the_better_other_figure_is_chosen() -> None:
    """Costs of 100, 101 and 103 J/m^3: the second is within 2 % of the first and takes less time, the third is not."""

    def estimate(name: str, work: float, duration: float) -> PatternEstimate:
        return PatternEstimate(name, 3, 1.0, duration, work, work, True)

    found = [estimate("least", 100.0, 60.0), estimate("close", 101.0, 50.0), estimate("far", 103.0, 40.0)]
    assert choose(found, "work") == 1
    assert choose(found[:1] + found[2:], "work") == 0


def test_a_pattern_is_estimated_as_it_is_planned() -> None:
    """The bound on the error is what docs/jobs.md says of faces; motions are planned, so that work and time differ."""
    plan = tiny_plan()
    [estimate] = plan.compared
    assert estimate.cycles == len(plan.cycles)
    assert estimate.bank == pytest.approx(plan.bank, rel=0.02)
    assert estimate.duration == pytest.approx(plan.duration, rel=0.15)
    assert estimate.work == pytest.approx(plan.work, rel=0.2)


@pytest.mark.parametrize(
    ("position", "said"), [([3.8, 0.9, 0.9], "stands on what is dug"), ([0.9, 0.9, 0.6], "stands in the machine")]
)
def test_a_truck_on_the_trench_or_in_the_machine_is_refused(position: list[float], said: str) -> None:
    bed = _TRUCK["bed"] | {"position": position}
    with pytest.raises(bp.SceneError, match=said) as refused:
        plan_job(small_job(dump={"truck": {"bed": bed, "capacity": 1.5}}, ground=_WIDE), effort="quick")
    assert refused.value.key == "dump.truck.bed.position"


def test_a_heap_outside_the_ground_of_the_job_is_refused_naming_the_key() -> None:
    site = build_worksite(small_job(ground={"low": [0.5, -2.0], "high": [6.0, 1.5]}))
    with pytest.raises(bp.SceneError, match="beyond the ground") as refused:
        check_dump(site, site.design_heights())
    assert refused.value.key == "dump.heap.at"


def test_an_unreachable_heap_is_reported_with_the_range_in_which_the_bucket_empties() -> None:
    site = build_worksite(
        small_job(dump={"heap": {"at": [0.6, -1.0]}}, ground={"low": [-1.5, -4.5], "high": [6.0, 1.5]})
    )
    dump = dump_of(site)
    found = dump.options(
        dump.first(site.ground, ground_obstacles(site, site.ground)), 0.1, np.array([0, 0.9, -1.6, -1.8])
    )
    assert isinstance(found, NoDump)
    assert found.reason == "unreachable"
    reach = re.search(r"it can be emptied ([\d.]+) to ([\d.]+) m from the swing axis", found.words)
    assert reach is not None
    least, most = (float(part) for part in reach.groups())
    assert np.hypot(0.6, 1.0) < least < 3.0 < most  # a bucket is emptied at 3 m, as in the job itself


def test_a_job_without_a_swing_motion_to_the_dump_ends_as_blocked(monkeypatch: pytest.MonkeyPatch) -> None:
    words = "no way past the wall"
    monkeypatch.setattr(CyclePlanner, "plan", lambda *_: Failed("swing", words))
    found = plan_job(small_job(), effort="quick")
    assert (found.verdict, found.reason, found.note) == ("failed", "blocked", f"swing of cycle 1: {words}")


def test_a_job_whose_cuts_break_a_rule_ends_as_not_done_since_nothing_is_in_the_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    words = "the underside of the plate rubs"
    monkeypatch.setattr(CyclePlanner, "plan", lambda *_: Failed("rules", words))
    found = plan_job(small_job(), effort="quick")
    assert (found.verdict, found.reason) == ("failed", "not_done")
    assert found.note.endswith(words)


@pytest.mark.long
def test_a_job_whose_cuts_along_a_wall_alone_fail_ends_as_not_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan = CyclePlanner.plan

    def without_walls(planner: CyclePlanner, number: int, at: Any, state: Any, chosen: NextCut) -> Any:
        if chosen.step == "walls":
            return Failed("cut", "the plate rubs")
        return plan(planner, number, at, state, chosen)

    monkeypatch.setattr(CyclePlanner, "plan", without_walls)
    found = plan_job(small_job(dig=trench(**{"from": [4.4, 0.0], "to": [3.7, 0.0], "width": 0.8})), effort="quick")
    assert found.cycles
    assert found.reason == "not_done"
    assert re.fullmatch(r"the design is missed by [\d.]+ cm, and no cut .*: the plate rubs", found.note)


@pytest.mark.long
def test_a_cut_that_exceeds_a_limit_is_planned_slower_or_shallower(monkeypatch: pytest.MonkeyPatch) -> None:
    site = build_worksite(small_job())
    lanes = lanes_of(site)
    chosen = next_cut(site, lanes, Pattern("layers", 0.3), site.ground)
    assert isinstance(chosen, NextCut)
    planner = CyclePlanner(site, dump_of(site), effort="quick", seed=0)
    state = planner.first(site.ground)
    runs: list[tuple[float, float]] = []

    def certify(problem: Problem, motion: Trajectory) -> Certificate:
        lowest = float(site.plane.kinematics.at(motion.q).tip_position[:, 2].min())
        runs.append((motion.duration, lowest))
        found = certify_problem(problem, motion)
        fits = motion.duration > 1.2 * runs[0][0] if slower else lowest > 0.8 * runs[0][1]
        too_much = replace(found.velocity, ratio=1.08)
        return found if fits else replace(found, velocity=too_much, problems=("108 % of a cylinder",))

    monkeypatch.setattr(cycle_planning, "certify_problem", certify)
    for slower in (True, False):
        runs.clear()
        made = planner.plan(1, None, state, chosen)
        assert not isinstance(made, Failed)
        assert made[0].verified
        assert len(runs) == (2 if slower else 3)
        assert runs[1][0] > 1.2 * runs[0][0]
        assert runs[1][1] == pytest.approx(runs[0][1], abs=1e-3)
    assert runs[2][1] == pytest.approx(0.7 * runs[0][1], abs=0.02)


def test_a_cut_that_breaks_a_rule_is_planned_shallower(monkeypatch: pytest.MonkeyPatch) -> None:
    """Near the inner end of a trench the plate rubs on deep cuts only; there, 0.26 m^3 stayed in a trench of 3 m."""
    site = build_worksite(small_job())
    chosen = next_cut(site, lanes_of(site), Pattern("layers", 0.3), site.ground)
    assert isinstance(chosen, NextCut)
    planner = CyclePlanner(site, dump_of(site), effort="quick", seed=0)
    lowest: list[float] = []

    def rules(digger: Digger, _: Profile, q: Matrix, *, swing: float) -> list[str]:
        lowest.append(float(digger.plane.place(q)[1].min()))
        return [] if lowest[-1] > 0.8 * lowest[0] else ["the plate rubs"]

    monkeypatch.setattr(cycle_planning, "broken_rules", rules)
    made = planner.plan(1, None, planner.first(site.ground), chosen)
    assert not isinstance(made, Failed)
    assert made[0].verified
    assert lowest[1:] == pytest.approx([0.7 * lowest[0]], abs=0.02)


@pytest.fixture(scope="module")
def steps() -> list[bp.JobPlan]:
    """The plans before the first cycle, after it, and at the end: the truck holds a single bucketful."""
    found: list[bp.JobPlan] = []
    job = small_job(dump={"truck": {**_TRUCK, "capacity": 0.21}}, ground=_WIDE)
    found.append(plan_job(job, effort="quick", watch=lambda step: found.append(step.plan)))
    return found


@pytest.mark.long
def test_a_job_ends_as_full_when_no_truck_has_room(steps: list[bp.JobPlan]) -> None:
    assert (steps[-1].reason, len(steps[-1].cycles)) == ("full", 1)
    left = [one for one in steps[-1].undug if one.reason == "left"]
    assert left
    assert all("no soil could be dumped any more" in one.words and not one.by for one in left)


def test_a_job_that_digs_nothing_of_its_design_is_not_verified(steps: list[bp.JobPlan]) -> None:
    before = steps[0]
    may = np.where(np.isfinite(before.design), before.start.surface, np.nan)
    nothing = replace(before, allowed=may, failure="")
    assert nothing.is_met
    assert not nothing.verified
    assert nothing.reason == "not_done"
    asked_for_nothing = replace(nothing, design=may)
    assert asked_for_nothing.verified


def test_a_cycle_contains_the_load_of_the_truck_after_it(steps: list[bp.JobPlan]) -> None:
    (cycle,) = steps[-1].cycles
    assert cycle.truck_load is not None
    assert cycle.truck_load.loose_volume == pytest.approx(cycle.held, rel=1e-9)
    assert cycle.place[2] == pytest.approx(0.9 + cycle.truck_load.loose.max(), abs=0.02)  # the floor is at 0.9 m
    body = load_body(cycle.truck_load)
    assert body.is_watertight
    assert body.volume == pytest.approx(cycle.held, rel=0.1)  # drawn through every third column


def test_a_start_outside_joint_limits_is_refused_before_planning() -> None:
    job = small_job(start={"swing": 0.0, "boom": 40.0, "stick": -1.6, "bucket": -1.8})
    with pytest.raises(bp.SceneError, match=r"start\.boom: .*found 40; .*40 degrees are 0\.698"):
        plan_job(job)


@pytest.mark.long
def test_soil_too_hard_for_a_cut_of_3_cm_ends_as_too_hard() -> None:
    """With 80 times the cohesion of common earth, 3 cm resist like 2.4 m of it."""
    plan = plan_job(small_job(soil={"cohesion": 400e3}), effort="quick")
    assert plan.reason == "too_hard"
    assert "cannot be cut at any depth" in plan.note
    assert plan.undug[0].reason == "too_hard"


def test_a_trench_askew_to_the_arm_is_not_reported_as_having_steep_ends() -> None:
    site = build_worksite(small_job(dig=trench(**{"from": [4.4, -0.4], "to": [2.8, 0.4], "width": 0.8})))
    lanes, design = lanes_of(site), site.design_heights()
    undug = find_undug(site, lanes, (design, *allowed_heights(site, lanes, design)), site.ground)
    askew = [one for one in undug if "the arm is askew to the trench" in one.words]
    assert askew
    assert not any("the ends are too steep" in one.words for one in undug)


@pytest.mark.long
def test_a_wide_trench_in_line_with_the_arm_is_not_reported_as_askew() -> None:
    """Its lanes fan out along the walls, the near ones by more than a tenth."""
    site = build_worksite(small_job(dig=trench(**{"from": [4.4, 0.0], "to": [2.2, 0.0], "width": 1.5})))
    lanes, design = lanes_of(site), site.design_heights()
    assert max(abs(lane.swing) for lane in lanes) > 0.11
    undug = find_undug(site, lanes, (design, *allowed_heights(site, lanes, design)), site.ground)
    assert not any("askew" in one.words for one in undug)


@pytest.mark.parametrize(
    ("at", "said"),
    [
        ([1, 2, 3], "dump.heap.at: has 3 entries, allowed: at most 2"),
        ([[1, 2], [1, 2, 3]], "dump.heap.at[1]: has 3 entries, allowed: at most 2"),
        ([1], "dump.heap.at: has 1 entries, allowed: 2 numbers; found [1]"),
        ([], "dump.heap.at: has 0 entries, allowed: 2 numbers; found []"),
        ([1, math.nan], "dump.heap.at[1]: input should be a finite number, in m; found nan"),
        (5, "dump.heap.at: is not a list; found 5; allowed: a list of 2 numbers"),
        ("here", "dump.heap.at: is not a list; found 'here'; allowed: a list of 2 numbers"),
    ],
)
def test_a_place_of_a_heap_that_is_none_is_one_line(at: object, said: str) -> None:
    with pytest.raises(bp.SceneError) as refused:
        small_job(dump={"heap": {"at": at}})
    assert str(refused.value).startswith(said)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", ["layers", "face"])
def test_cuts_of_a_millimetre_cannot_be_meant(kind: str) -> None:
    with pytest.raises(bp.SceneError, match=rf"pattern.{kind}: .* equal to 0.02 m; found 0.001"):
        small_job(pattern={kind: 0.001})


@pytest.mark.parametrize("pattern", ["layer", {"layer": 0.2}, 3, ["face"], None])
def test_an_invalid_pattern_is_one_line_with_the_allowed_ones(pattern: object) -> None:
    with pytest.raises(bp.InputError) as refused:
        small_job(pattern=pattern)
    assert "pattern: is no pattern; found" in str(refused.value)
    assert "allowed: auto, plain, {layers: DEPTH}, {face: DEPTH}" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_job_whose_cuts_all_exceed_the_limits_ends_as_too_hard(monkeypatch: pytest.MonkeyPatch) -> None:
    words = "stick has too little torque"
    monkeypatch.setattr(CyclePlanner, "plan", lambda *_: Failed("limits", words))
    found = plan_job(small_job(), effort="quick")
    assert (found.verdict, found.reason, found.note) == ("failed", "too_hard", words)


def test_the_ground_of_a_csv_keeps_its_corner_cell_and_heights(tmp_path: Path) -> None:
    heights = np.zeros((41, 61))
    heights[:, 30:] = -0.1
    np.savetxt(tmp_path / "ground.csv", heights, delimiter=",")
    where = {"file": str(tmp_path / "ground.csv"), "low": [0.5, -2.0], "cell": 0.1}
    ground = build_worksite(small_job(ground=where, dump={"heap": {"at": [2.5, -1.5]}})).ground
    assert ground.shape == (41, 61)
    np.testing.assert_allclose((*ground.low, ground.cell), (0.5, -2.0, 0.1))
    np.testing.assert_array_equal(ground.surface, heights)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"low": [0.0, 0.0]}, "low is given without high"),
        ({"high": [0.0, 0.0]}, "high is given without low"),
        ({"file": "ground.csv", "high": [0.0, 0.0]}, "high is given without low"),
    ],
)
def test_a_single_corner_of_the_ground_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(bp.InputError, match=said):
        small_job(ground=keys)


def test_missing_values_of_a_design_surface_are_left_out_of_the_design(tmp_path: Path) -> None:
    heights = [["-9999", "-9999", "-9999"], ["-9999", "-0,2", "-0,2"], ["-9999", "-0,2", "-0,2"]]
    (tmp_path / "pad.csv").write_text("\n".join(";".join(row) for row in heights), encoding="utf-8")
    surface = {"file": str(tmp_path / "pad.csv"), "low": [3.0, -0.3], "cell": 0.3}
    design = build_worksite(small_job(dig={"surface": surface})).design_heights()
    np.testing.assert_allclose(np.nanmin(design), -0.2)
    np.testing.assert_allclose(np.nanmax(design), -0.2)


@pytest.mark.long
def test_the_bucket_is_emptied_from_higher_up_if_the_heap_is_in_its_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """The heap is said to be 0.3 m lower than it is, so that the lowest open bucket comes too near to it."""

    def lower(terrain: Terrain, place: Vector) -> float:
        return height(terrain, place) - 0.3

    height = dumping._height
    monkeypatch.setattr(dumping, "_height", lower)
    plan = plan_job(small_job())
    assert plan.verified


def test_a_swing_post_may_be_nearer_to_the_ground_than_the_clearance_but_must_not_touch_it() -> None:
    """The post ends 0.16 m above z = 0. A clearance of 0.2 m from the ground holds for boom, stick and bucket alone."""
    site = build_worksite(job_from_dict(TINY | {"site": {"clearance": 0.2}}))
    work = check_whole_job(site)
    assert np.isfinite(work.allowed).any()
    grounds = ground_obstacles(site, site.ground)
    assert [(one.clearance, one.links) for one in grounds] == [
        (0.2, ("boom", "stick", "bucket")),
        (0.0, ("swing_post",)),
    ]
    proximity = Proximity(site.robot, grounds[1:])
    distances = proximity.distances(np.array([1.0, 0.9, -1.6, -1.8]))
    (to_ground,) = (d for d, pair in zip(distances, proximity.pairs, strict=True) if pair.kind == "obstacle")
    assert to_ground == pytest.approx(0.16, abs=1e-4)
    high = job_from_dict(TINY | {"ground": TINY["ground"] | {"level": 0.3}})
    with pytest.raises(bp.SceneError, match=r"ground\.level: puts the ground into swing_post .* 0\.14 m inside it"):
        check_whole_job(build_worksite(high))


@pytest.mark.parametrize(("cohesion", "is_hard"), [(100e3, True), (5e3, False)])
def test_soil_that_is_only_scraped_is_too_hard_where_nothing_more_comes(
    backhoe: bp.Robot, cohesion: float, is_hard: bool
) -> None:
    """A cut whose depth the cylinders limit names them; one of 5 cm in soft soil does not."""
    digger = Digger(backhoe, Soil(cohesion=cohesion, friction=0.7))
    cut = find_cut(digger, Profile.level(0.0, 0.0, 8.0), swing=0.0, start=4.2, end=3.0, depth=0.6 if is_hard else 0.05)
    assert isinstance(cut, Cut)
    refusals = _Refusals()
    refusals.add_empty(NextCut(None, cut, "layer 1"), 0, 6)  # type: ignore[arg-type]
    assert refusals.note == "the cut at cycle 6 takes nothing any more"
    if is_hard:
        deep = f"{100.0 * cut.greatest_depth:.0f} cm"
        assert refusals.too_hard.startswith(f"this soil cannot be cut deeper than {deep} there: {cut.holding.cylinder}")
    else:
        assert not refusals.too_hard


def test_a_start_in_an_obstacle_is_refused_before_patterns_are_compared(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The estimates take half a minute, the start some milliseconds."""

    def never(*_: object) -> PatternEstimate:
        raise AssertionError("a pattern was estimated")

    monkeypatch.setattr("backhoe_planner.job.estimates.estimate_pattern", never)
    start = {"swing": 1.2, "boom": 0.9, "stick": -1.6, "bucket": -1.8}
    teeth = Kinematics(backhoe).at(np.array(list(start.values()))).tip_position
    ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": teeth.tolist()}
    with pytest.raises(bp.SceneError, match=r"start: stands in ball or too near to it; found at the start bucket is"):
        plan_job(small_job(site={"obstacles": [ball]}, start=start, pattern="auto"))


@pytest.mark.parametrize(("level", "said"), [(200.0, "200.00 m above"), (-30.0, "30.00 m below")])
def test_ground_at_another_height_than_the_machine_is_named(level: float, said: str) -> None:
    """Before, the advice was to stand nearer to the trench or farther from it."""
    site = build_worksite(small_job(ground={"level": level}))
    with pytest.raises(bp.SceneError, match=f"the ground there is {said} the machine.*: see ground.level"):
        check_whole_job(site)
