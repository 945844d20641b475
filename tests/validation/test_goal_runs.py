"""Motions to a goal are compared with the best known cost, which is kept from run to run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import bench_goals
import numpy as np
import pytest

import backhoe_planner as bp
from validation import goal_runs as runs
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site

ROW = runs.Row(
    machine="backhoe", kind="open", index=3, seed=0, planning_seed=0, objective="time", digest="abc", way_known=True,
    verdict="verified", reason="", message="", seconds=0.5, cost=4.4, duration=4.4, bound=4.0,
)  # fmt: skip


def test_the_least_cost_of_a_site_is_kept_from_run_to_run(tmp_path: Path) -> None:
    best = runs.Best()
    best.add_rows([ROW, dataclasses.replace(ROW, planning_seed=7, cost=4.1)], "thorough")
    best.add_rows([dataclasses.replace(ROW, cost=4.2)], "normal")
    best.add_rows([dataclasses.replace(ROW, verdict="failed", cost=None)], "normal")
    best.save(tmp_path / "best.json")
    again = runs.Best.load(tmp_path / "best.json")
    assert again == best
    assert again.of(ROW) == 4.1
    assert again.found_by[ROW.name, "abc"] == "thorough, seed 7"
    # nothing is known of a site with another digest
    assert np.isnan(again.of(dataclasses.replace(ROW, digest="abd")))
    assert runs.Best.load(tmp_path / "none.json") == runs.Best()
    (tmp_path / "other.json").write_text('{"version": 99}')
    with pytest.raises(ValueError, match="not a file of the best known"):
        runs.Best.load(tmp_path / "other.json")


def test_a_site_with_a_motion_below_its_bound_is_named() -> None:
    other = dataclasses.replace(ROW, index=4)
    best = runs.Best()
    best.add_rows([ROW, other], "normal")
    assert not runs.violations([ROW, other], best)
    best.add(ROW.name, ROW.digest, 3.9, "another planner")
    assert runs.violations([ROW, other], best) == [ROW.name]


def test_the_figures_of_a_group_are_those_of_its_rows() -> None:
    best = runs.Best()
    best.add(ROW.name, ROW.digest, 4.0, "known")
    rows = [ROW, dataclasses.replace(ROW, planning_seed=1, cost=5.0), dataclasses.replace(ROW, verdict="failed")]
    rows[2] = dataclasses.replace(rows[2], cost=None, bound=None)
    assert runs.spreads(rows) == [pytest.approx(5.0 / 4.4)]
    heads, _, line = (
        [cell.strip() for cell in text.strip("|").split("|")] for text in runs.table(rows, best).splitlines()
    )
    found = dict(zip(heads, line, strict=True))
    assert found["group"] == "backhoe open"
    assert found["verified"] == "66.7 %"
    assert found["within 1.03"] == "0 %"
    assert found["within 1.1"] == "33 %"
    assert found["within 1.3"] == "67 %"
    assert found["/ best: median, p90, max"].endswith(", 1.25")
    assert found["below bound"] == "0"


def test_the_digest_of_a_scene_does_not_depend_on_the_objective() -> None:
    robot = load_machine("planar4")
    scenes = [random_site(robot, SiteKey("planar4", "open", "goal", index)).scene for index in range(2)]
    assert runs.digest_of(runs.with_objective(scenes[0], "kinetic")) == runs.digest_of(scenes[0])
    assert runs.digest_of(scenes[0]) != runs.digest_of(scenes[1])


def test_a_run_plans_every_site_with_every_seed_and_remembers_the_best(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = tmp_path / "best.json"
    options = ["--sites", "1", "--machines", "planar4", "--kinds", "open", "--effort", "quick", "--jobs", "1"]
    assert bench_goals.main([*options, "--planning-seeds", "0", "1", "--best", str(known)]) == 0
    assert capsys.readouterr().out.startswith("2 plans, effort quick, objective time, planning seeds 0, 1")
    (cost,) = runs.Best.load(known).costs.values()
    site = random_site(load_machine("planar4"), SiteKey("planar4", "open", "goal", 0))
    scene = runs.with_objective(site.scene, "time")
    plans = [bp.plan(load_machine("planar4"), scene, seed=seed, effort="quick") for seed in (0, 1)]
    assert cost == min(plan.trajectory.duration for plan in plans)


def test_an_exception_in_planning_gives_an_error_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(bp, "plan", broken)
    (row,) = runs.run_site(SiteKey("planar4", "open", "goal", 0), runs.Settings())
    assert (row.verdict, row.reason, row.cost) == ("error", "error", None)
    assert row.message == "ZeroDivisionError: on purpose"


def test_the_work_that_lifts_all_moving_parts_by_1_mm_counts_as_little(backhoe: bp.Robot) -> None:
    mass = sum(inertia.mass for inertia in backhoe.model.inertias.tolist()[1:])
    middle = {"joints": dict(zip(backhoe.joint_names, backhoe.middle.tolist(), strict=True))}
    content = {"version": 1, "payload": 2.0, "start": middle, "task": {"goal": middle}}
    scene = bp.scene_from_dict(content)
    assert runs.little_cost(backhoe, scene, "work") == pytest.approx((mass + 2.0) * 9.81e-3)
    assert runs.little_cost(backhoe, scene, "time") == 0.0
    best, row = runs.Best(), dataclasses.replace(ROW, objective="work", cost=4.4, bound=None, little=4.2)
    best.add(row.name, row.digest, 0.1, "known")
    assert "| 0 % | 0 % | 0 % | 0, 100, 100 % |" in " ".join(runs.table([row], best).split())
    assert "little" not in runs.table([dataclasses.replace(row, little=0.0)], best)
