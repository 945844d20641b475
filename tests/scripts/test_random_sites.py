"""The random sites keep what they promise, and the benchmark tells what it measured."""

from __future__ import annotations

import dataclasses
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

import bench_planning as bench  # type: ignore[import-not-found]
import independent  # type: ignore[import-not-found]
import numpy as np
import pinocchio as pin
import pytest
from random_scenes import (  # type: ignore[import-not-found]
    KINDS,
    MACHINES,
    SPARE,
    TASKS,
    Site,
    SiteKey,
    load_machine,
    random_site,
)

import backhoe_planner as bp
from backhoe_planner.motion import Problem, build_problem

ALL = [(machine, kind, task) for machine in MACHINES for kind in KINDS for task in TASKS]
SETTINGS = bench.Settings(budget=0.5, refute=True)


@cache
def drawn(machine: str, kind: str, task: str, index: int) -> Site:
    return random_site(load_machine(machine), SiteKey(machine, kind, task, index))


def least_margin(problem: Problem, q: np.ndarray) -> float:
    proximity = bp.Proximity(problem.robot, problem.obstacles)
    return float(np.min(proximity.distances(q) - proximity.clearance))


# --- the sites ------------------------------------------------------------------------


@pytest.mark.parametrize(("machine", "kind", "task"), ALL)
def test_a_site_is_what_its_name_says_whatever_was_drawn_before(machine: str, kind: str, task: str) -> None:
    first = drawn(machine, kind, task, 0)
    other = drawn(machine, kind, task, 1)
    again = random_site(load_machine(machine), first.key)
    assert first.scene == again.scene
    assert np.array_equal(first.goal_q, again.goal_q)
    assert first.scene != other.scene
    if (kind, task) == ("open", "goal"):
        assert first.scene != random_site(load_machine(machine), SiteKey(machine, kind, task, 0, seed=1)).scene


@pytest.mark.parametrize(("machine", "kind", "task"), ALL)
def test_start_and_goal_are_free_with_a_centimetre_to_spare(machine: str, kind: str, task: str) -> None:
    for index in range(2):
        site = drawn(machine, kind, task, index)
        problem = build_problem(load_machine(machine), site.scene)
        assert problem.obstacles
        ends = [site.goal_q] if site.start_q is None else [site.goal_q, site.start_q]
        for q in ends:
            assert least_margin(problem, q) >= SPARE
            assert np.all(q >= problem.limits.lower)
            assert np.all(q <= problem.limits.upper)
        if problem.goal is not None:
            at = bp.Kinematics(problem.robot).at(site.goal_q)
            assert max(problem.goal.distances(at)) < 1e-9
            assert problem.start_q is not None
            assert np.array_equal(problem.start_q, site.start_q)


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_of_full_poses_has_a_motion_that_follows_it_free_of_contact(kind: str) -> None:
    robot = load_machine("panda")
    for index in range(2):
        site = drawn("panda", kind, "path", index)
        problem = build_problem(robot, site.scene)
        assert site.scene.task.path is not None
        assert not site.scene.task.path.detour
        assert site.way_known
        assert 200 <= len(site.scene.waypoints()) <= 500
        assert (site.start_q is None) == (index % 2 == 1)
        if site.start_q is not None:
            assert np.array_equal(site.start_q, site.motion[0])
        kinematics, path = bp.Kinematics(robot), problem.path
        assert path is not None
        assert site.motion is not None
        proximity = bp.Proximity(robot, problem.obstacles)
        for station, q in zip(path.stations, site.motion, strict=True):
            position, angle = path.target(float(station)).distances(kinematics.at(q))
            assert position < 1e-9
            assert angle < 1e-6
            assert np.min(proximity.distances(q) - proximity.clearance) >= SPARE
        for (a, b), (s, t) in zip(pairwise(site.motion), pairwise(path.stations), strict=True):
            position, angle = path.target(0.5 * float(s + t)).distances(kinematics.at(0.5 * (a + b)))
            assert position < 0.1 * site.scene.task.path.tolerance
            assert angle < 1e-3


@pytest.mark.parametrize(("machine", "kind"), [(m, k) for m in ("planar4", "backhoe") for k in KINDS])
def test_a_tip_path_has_a_motion_that_the_certificate_accepts_unless_it_is_blocked(machine: str, kind: str) -> None:
    robot = load_machine(machine)
    blocked = 0
    for index in range(3):
        site = drawn(machine, kind, "path", index)
        scene = site.scene.model_copy(update={"start": None})
        assert site.motion is not None
        slowly = bp.Trajectory.from_steps(np.linspace(0.0, 10.0 * len(site.motion), len(site.motion)), site.motion)
        certificate = bp.certify(robot, scene, slowly)
        if site.blocked:
            blocked += 1
            assert scene.task.path is not None
            assert scene.task.path.detour
            assert not site.way_known
            continue
        assert certificate.tracking.done
        assert not certificate.detours
        assert certificate.min_clearance is None or certificate.min_clearance.margin >= SPARE - 1e-3
    assert blocked < 3


def test_nothing_stands_inside_the_machine_and_the_whole_language_is_used() -> None:
    shapes: set[str] = set()
    limited = own = 0
    for kind in KINDS:
        for index in range(4):
            site = drawn("backhoe", kind, "goal", index)
            post = bp.Proximity(load_machine("backhoe"), bp.build_obstacles(site.scene, load_machine("backhoe")))
            for pair, distance in zip(post.pairs, post.distances(np.zeros(4)), strict=True):
                if pair.link == "swing_post" and pair.kind == "obstacle":
                    assert distance > 0.0, (site.key, pair.obstacle)
            shapes |= {obstacle.shape for obstacle in site.scene.obstacles}
            limited += sum(obstacle.links is not None for obstacle in site.scene.obstacles)
            own += sum(obstacle.clearance is not None for obstacle in site.scene.obstacles)
    assert shapes == {"box", "sphere", "capsule", "cylinder", "halfspace"}
    assert limited > 0
    assert own > 0


# --- the independent check ------------------------------------------------------------


def test_the_independent_check_places_the_joints_as_pinocchio_does() -> None:
    robot = load_machine("panda")
    rng = np.random.default_rng(3)
    q = np.array([robot.random_q(rng) for _ in range(4)])
    data = robot.model.createData()
    for row, joints in enumerate(q):
        pin.forwardKinematics(robot.model, data, joints)
        for joint, (rotation, translation) in enumerate(independent._placements(robot, q)):
            np.testing.assert_allclose(rotation[row], data.oMi[joint].rotation, atol=1e-14)
            np.testing.assert_allclose(translation[row], data.oMi[joint].translation, atol=1e-14)


def test_the_independent_check_finds_the_least_distance_that_all_points_give() -> None:
    """Against every point of the cover at every moment, one by one."""
    robot = load_machine("planar4")
    site = drawn("planar4", "cluttered", "goal", 1)
    plan = bp.plan(robot, site.scene, budget=2.0)
    found = {(least.link, least.obstacle): least.distance for least in independent.least_distances(plan, refine=2)}
    covers, _ = independent._bodies(robot)
    q = plan.trajectory.at(independent._finer(plan.trajectory.time, 2))
    placements = independent._placements(robot, q)
    for spec in site.scene.obstacles:
        distance = independent._obstacle(spec, site.scene)
        for cover in covers:
            if cover.joint == 0:
                continue
            points = cover.centre[cover.first < 0]
            rotation, translation = placements[cover.joint]
            placed = points @ np.swapaxes(rotation, 1, 2) + translation[:, None]
            assert found[cover.link, spec.name] == pytest.approx(np.min(distance(placed.reshape(-1, 3))), abs=1e-12)


def test_a_claim_that_is_too_high_is_refuted() -> None:
    site = drawn("planar4", "cluttered", "goal", 1)
    plan = bp.plan(load_machine("planar4"), site.scene, budget=2.0)
    assert plan.verified
    assert independent.refutations(plan) == []
    entries = plan.certificate.clearances
    first = next(entry for entry in entries if entry.kind == "obstacle")
    # what is proven lies within 2 % of the truth, and the points lie 4 cm apart
    raised = dataclasses.replace(first, distance=1.02 * first.distance + 0.03)
    others = tuple(raised if entry is first else entry for entry in entries)
    wrong = dataclasses.replace(plan, certificate=dataclasses.replace(plan.certificate, clearances=others))
    told = independent.refutations(wrong)
    assert told
    assert all(first.obstacle in line for line in told)


# --- the benchmark --------------------------------------------------------------------


@pytest.fixture(scope="module")
def rows() -> list[bench.Row]:
    keys = bench.all_keys(2, machines=["planar4"], kinds=["open", "narrow"], tasks=["goal"], seed=0)
    found, interrupted = bench.run(keys, SETTINGS, jobs=1)
    assert not interrupted
    assert [row.key for row in found] == keys
    return list(found)


def test_the_table_has_a_line_for_every_group_with_its_success(rows: list[bench.Row]) -> None:
    summaries = bench.summarise(rows)
    assert [summary.group for summary in summaries] == [("planar4", "open", "goal"), ("planar4", "narrow", "goal")]
    for summary in summaries:
        mine = [row for row in rows if row.group == summary.group]
        assert summary.sites == 2
        assert summary.verified == sum(row.verified for row in mine)
        assert summary.verified + sum(summary.reasons.values()) == 2
        assert summary.refuted in (0, None)
    lines = bench.table(summaries).splitlines()
    assert len(lines) == 4
    assert lines[2].startswith("planar4 open goal")
    assert f"{50.0 * summaries[0].verified:.1f} %" in lines[2]


def test_a_run_that_is_saved_comes_back_as_it_was(rows: list[bench.Row], tmp_path: Path) -> None:
    bench.save_rows(tmp_path / "run.json", rows, SETTINGS)
    assert bench.load_rows(tmp_path / "run.json") == rows
    assert [file.name for file in tmp_path.iterdir()] == ["run.json"]
    (tmp_path / "other.json").write_text('{"version": 99}')
    with pytest.raises(ValueError, match="not a saved run"):
        bench.load_rows(tmp_path / "other.json")


def test_a_comparison_names_the_sites_that_were_lost_and_the_ratio_of_the_times(rows: list[bench.Row]) -> None:
    done = [dataclasses.replace(row, verdict="verified", reason="", seconds=1.0, reference=0.5) for row in rows[:3:2]]
    missing = dataclasses.replace(done[0], index=7)
    slower = [
        dataclasses.replace(done[0], verdict="failed", reason="blocked"),
        dataclasses.replace(done[1], seconds=6.0, reference=1.0),
    ]
    found = bench.compare([*done, missing], slower)
    assert sum(c.sites for c in found) == 2
    assert [key for c in found for key in c.lost] == [done[0].key]
    assert not [key for c in found for key in c.won]
    # the other site took 2 references before, and takes 6 now
    assert bench.compare(done[1:], slower[1:])[0].time_ratio == pytest.approx(3.0)
    assert str(done[0].key) in bench.comparison_table(found)
    assert [key for c in bench.compare(slower, done) for key in c.won] == [done[0].key]


def test_an_interrupted_run_keeps_what_is_done() -> None:
    keys = bench.all_keys(3, machines=["planar4"], kinds=["open"], tasks=["goal"], seed=0)

    def told(done: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    found, interrupted = bench.run(keys, SETTINGS, jobs=1, told=told)
    assert interrupted
    assert [row.key for row in found] == keys[:1]


def test_an_exception_while_planning_is_a_row_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(bp, "plan", broken)
    row = bench.run_site(SiteKey("planar4", "open", "goal", 0), SETTINGS)
    assert (row.verdict, row.reason) == ("error", "error")
    assert row.message == "ZeroDivisionError: on purpose"
    assert bench.summarise([row])[0].reasons == {"error": 1}


def test_one_site_is_rerun_by_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["--only", "planar4/open/goal/0", "--budget", "2"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("planar4/open/goal/0, seed 0")
    with pytest.raises(SystemExit, match="no such site"):
        bench.main(["--only", "planar4/open/goals/0"])


def test_dask_that_is_not_installed_is_asked_for_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SystemExit, match=r"pip install .dask\[distributed\]"):
        bench.main(["--sites", "1", "--machines", "planar4", "--dask", "local"])
