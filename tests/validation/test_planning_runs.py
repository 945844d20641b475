"""The benchmark of the planner prints, saves and compares its measurements."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import bench_planning
import pytest

import backhoe_planner as bp
from validation import planning_runs as runs
from validation.sites import SiteKey

SETTINGS = runs.Settings(effort="quick", refute=True)


@pytest.fixture(scope="module")
def rows() -> list[runs.Row]:
    keys = runs.all_keys(2, machines=["planar4"], kinds=["open", "narrow"], tasks=["goal"], seed=0)
    found, interrupted = runs.run(keys, SETTINGS, jobs=1)
    assert not interrupted
    assert [row.key for row in found] == keys
    return list(found)


def test_the_table_has_a_line_for_every_group_with_its_success(rows: list[runs.Row]) -> None:
    summaries = runs.summarise(rows)
    assert [summary.group for summary in summaries] == [("planar4", "open", "goal"), ("planar4", "narrow", "goal")]
    for summary in summaries:
        mine = [row for row in rows if row.group == summary.group]
        assert len(summary.rows) == 2
        assert summary.verified == [row for row in mine if row.verified]
        assert len(summary.verified) + sum(summary.reasons.values()) == 2
        assert summary.refuted in (0, None)
    lines = runs.table(summaries).splitlines()
    assert len(lines) == 4
    assert lines[2].startswith("| planar4 open goal")
    assert f"{50.0 * len(summaries[0].verified):.1f} %" in lines[2]


def test_a_saved_run_is_loaded_unchanged(rows: list[runs.Row], tmp_path: Path) -> None:
    runs.save_rows(tmp_path / "run.json", rows, SETTINGS)
    assert runs.load_rows(tmp_path / "run.json") == rows
    assert [file.name for file in tmp_path.iterdir()] == ["run.json"]
    (tmp_path / "other.json").write_text('{"version": 99}')
    with pytest.raises(ValueError, match="not a saved run"):
        runs.load_rows(tmp_path / "other.json")


def test_a_comparison_names_lost_sites_and_the_ratio_of_times(rows: list[runs.Row]) -> None:
    done = [dataclasses.replace(row, verdict="verified", reason="", seconds=1.0, reference=0.5) for row in rows[:3:2]]
    missing = dataclasses.replace(done[0], index=7)
    slower = [
        dataclasses.replace(done[0], verdict="failed", reason="blocked"),
        dataclasses.replace(done[1], seconds=6.0, reference=1.0),
    ]
    found = runs.compare([*done, missing], slower)
    assert sum(c.sites for c in found) == 2
    assert [key for c in found for key in c.lost] == [done[0].key]
    assert not [key for c in found for key in c.won]
    # the other site took 2 references before, and takes 6 now
    assert runs.compare(done[1:], slower[1:])[0].time_ratio == pytest.approx(3.0)
    assert str(done[0].key) in runs.comparison_table(found)
    assert [key for c in runs.compare(slower, done) for key in c.won] == [done[0].key]


def test_an_interrupted_run_keeps_its_finished_rows() -> None:
    keys = runs.all_keys(3, machines=["planar4"], kinds=["open"], tasks=["goal"], seed=0)

    def watch(done: int, _: object) -> None:
        if done == 1:
            raise KeyboardInterrupt

    found, interrupted = runs.run(keys, SETTINGS, jobs=1, watch=watch)
    assert interrupted
    assert [row.key for row in found] == keys[:1]


def test_an_exception_in_planning_gives_an_error_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(bp, "plan", broken)
    row = runs.run_site(SiteKey("planar4", "open", "goal", 0), SETTINGS)
    assert (row.verdict, row.reason) == ("error", "error")
    assert row.message == "ZeroDivisionError: on purpose"
    assert runs.summarise([row])[0].reasons == {"error": 1}


def test_one_site_is_rerun_by_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench_planning.main(["--only", "planar4/open/goal/0", "--effort", "quick"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("planar4/open/goal/0, seed 0")
    with pytest.raises(SystemExit, match="no such site"):
        bench_planning.main(["--only", "planar4/open/goals/0"])
