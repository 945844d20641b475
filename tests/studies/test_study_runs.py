"""A study that is interrupted, killed, refused or sent to a cluster ends with the table of an undisturbed run."""

from __future__ import annotations

import errno
import fcntl
import html
import json
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from dying_rows import dies_at_one

import backhoe_planner as bp
from backhoe_planner.cli import main
from backhoe_planner.show import write_study_page
from backhoe_planner.studies import StudyResult, StudyStep, run_study, study_from_dict, study_run, summarise_study
from backhoe_planner.studies.results.journal import Journal
from backhoe_planner.studies.results.outcome import Outcome
from backhoe_planner.studies.rows.drawing import StudyRow
from backhoe_planner.studies.rows.template import build_template
from backhoe_planner.studies.work import local_rows
from backhoe_planner.studies.work.bundle import build_bundle
from backhoe_planner.studies.work.row_planning import RowPlanner

pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
pytest.importorskip("pandas", reason="pandas is not installed")

ROOT = Path(bp.__file__).resolve().parents[1]
GOAL = {"joints": {"joint1": 1.5, "joint2": 1.8, "joint3": 1.7, "joint4": 1.1}}  # half a second away: quick to plan
MESH = """solid rock
facet normal 0 0 -1\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nvertex 1 0 0\nendloop\nendfacet
facet normal 0 -1 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0 1\nendloop\nendfacet
facet normal -1 0 0\nouter loop\nvertex 0 0 0\nvertex 0 0 1\nvertex 0 1 0\nendloop\nendfacet
facet normal 1 1 1\nouter loop\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 0 1\nendloop\nendfacet
endsolid rock
"""


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study file with its machine beside it and a scene with a mesh; one value is no valid scene, one collides."""
    folder = tmp_path_factory.mktemp("given")
    shutil.copy(ROOT / "models" / "planar4.urdf", folder / "arm.urdf")
    (folder / "site").mkdir()
    (folder / "site" / "rock.stl").write_text(MESH)
    rock = {"name": "rock", "shape": "mesh", "file": "rock.stl", "position": [5.0, 5.0, 0.0]}
    start = {"joints": {"joint1": 1.42, "joint2": 1.86, "joint3": 1.71, "joint4": 1.16}}
    scene = {"version": 1, "start": start, "task": {"goal": GOAL}, "obstacles": [rock]}
    (folder / "site" / "scene.yaml").write_text(json.dumps(scene))
    study = {
        "version": 1, "name": "past a rock", "machine": "arm.urdf", "scene": "site/scene.yaml",
        "parameters": {
            "clearance": [0.1, -0.2, 0.3], "limits.velocity_scale": {"uniform": [0.5, 1.0]},
            "obstacles.rock.position": [[5.0, 5.0, 0.0], [-0.3, -0.3, 0.0]],
        },
        "metrics": ["duration", "cost.value", "certificate.min_clearance.margin", "findings.obstruction.obstacle"],
        "keep_plans": "all",
    }  # fmt: skip
    file = folder / "study.yaml"
    file.write_text(json.dumps(study))
    return file


@pytest.fixture(scope="module")
def whole(given: Path, tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    """The result of an undisturbed run."""
    return run_study(bp.load_study(given), tmp_path_factory.mktemp("whole") / "new" / "results", jobs=1)


@pytest.fixture
def copied(whole: StudyResult, tmp_path: Path) -> Path:
    """A copy of its folder."""
    return Path(shutil.copytree(whole.folder, tmp_path / "copied"))


def table_of(folder: Path) -> bytes:
    return (folder / "table.parquet").read_bytes()


def cut(folder: Path, lines: int, torn: int = 0) -> bytes:
    """Leave the journal of a killed run: some lines and a part of the next; no tables."""
    journal = folder / "journal.jsonl"
    kept = journal.read_bytes().splitlines(keepends=True)
    (folder / "table.parquet").unlink()
    journal.write_bytes(b"".join(kept[:lines]) + kept[lines][:torn])
    return b"".join(kept[:lines])


def planned_as(whole: StudyResult, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Take rows from an undisturbed run instead of processes; returns the list that collects their numbers."""
    asked: list[int] = []

    def plan(_: Any, rows: list[StudyRow], *__: Any, **___: Any) -> Iterator[Outcome]:
        for row in rows:
            asked.append(row.number)
            yield whole.outcomes[row.number]

    monkeypatch.setattr(study_run, "plan_locally", plan)
    return asked


# --- results of a run -------------------------------------------------------------------


def test_every_row_has_its_verdict_reason_and_figures(whole: StudyResult) -> None:
    frame = pq.read_table(whole.folder / "table.parquet").to_pandas()
    assert frame["row"].tolist() == list(range(6))
    assert frame["clearance"].tolist() == [0.1, 0.1, -0.2, -0.2, 0.3, 0.3]
    assert frame["verdict"].tolist() == ["verified", "failed", "invalid", "invalid", "verified", "failed"]
    assert frame["reason"].tolist()[1:3] == ["start_in_collision", "invalid"]
    assert frame["message"][2].startswith("clearance: input should be greater than or equal to 0")
    assert frame["duration"].isna().tolist() == [False, True, True, True, False, True], "of what is verified alone"
    assert frame["findings.obstruction.obstacle"][1] == "rock"
    assert set(frame["effort"]) == {"quick"}
    assert json.loads(frame["versions"][0])["backhoe_planner"] == bp.__version__
    timings = pq.read_table(whole.folder / "timings.parquet").to_pandas()
    assert (timings["processor"] > 0.0).all()
    assert not set(timings.columns) & set(frame.columns) - {"row"}
    assert not (whole.folder / ".work").exists()


def test_a_row_equals_the_plan_of_the_library(whole: StudyResult, given: Path) -> None:
    content = whole.template.filled(whole.rows[4].values)[0]
    robot = bp.load_robot(given.parent / "arm.urdf")
    plan = bp.plan(robot, bp.scene_from_dict(content, folder=given.parent / "site"), effort="quick")
    assert whole.outcomes[4].metrics["duration"] == plan.metrics.duration
    kept = bp.load_plan(whole.folder / "plans" / "000004.json")
    assert kept.verified
    assert kept.robot.urdf.path.samefile(given.parent / "arm.urdf")
    assert kept.scene.folder.samefile(given.parent / "site")


def test_a_worker_needs_only_the_bundle_of_files(whole: StudyResult, given: Path, tmp_path: Path) -> None:
    """A machine with a mesh in a package, and a scene with a mesh beside it."""
    here, there = tmp_path / "here", tmp_path / "there"
    shutil.copytree(given.parent, here / "arms")
    (here / "arms" / "meshes").mkdir()
    (here / "arms" / "meshes" / "post.stl").write_text(MESH)
    mesh = '<geometry><mesh filename="package://arms/meshes/post.stl" scale="0.01 0.01 0.01"/></geometry></visual>'
    urdf = here / "arms" / "arm.urdf"
    assert urdf.read_text().count('<link name="base">') == 1
    urdf.write_text(urdf.read_text().replace('<link name="base">', f'<link name="base"><visual>{mesh}'))
    bundle = build_bundle(*build_template(bp.load_study(here / "arms" / "study.yaml")))
    assert {Path(name).name for name in bundle.files} == {"arm.urdf", "post.stl", "rock.stl"}
    shutil.rmtree(here)
    bundle.unpack(there)
    found = RowPlanner(there).plan(whole.rows[0])
    assert (found.verdict, found.metrics) == ("verified", whole.outcomes[0].metrics)
    (there / urdf.relative_to("/")).unlink()
    lost = RowPlanner(there).plan(whole.rows[0])
    assert (lost.verdict, lost.message.partition(";")[0]) == ("invalid", "arm.urdf: no such URDF file")


def test_the_summary_and_the_page_show_the_best_row(whole: StudyResult, tmp_path: Path) -> None:
    summary = summarise_study(whole)
    assert summary.counts == {"failed: start_in_collision": 2, "invalid": 2, "verified": 2}
    assert summary.messages == {"invalid": (2, whole.outcomes[2].message)}
    durations = {row: whole.outcomes[row].metrics["duration"] for row in (0, 4)}
    assert summary.best is not None
    assert summary.best.number == min(durations, key=durations.__getitem__)
    assert [(one.label, one.verified, one.rows) for one in summary.shares["clearance"]] == [
        ("-0.2", 0, 2), ("0.1", 1, 2), ("0.3", 1, 2),
    ]  # fmt: skip
    page = tmp_path / "page.html"
    write_study_page(whole, page)
    text = page.read_text()
    assert "past a rock" in text
    assert "<script" not in text
    assert f"row 2: {html.escape(whole.outcomes[2].message)}" in text
    assert f"Row {summary.best.number} has the least cost.value" in text
    # the objective to a goal is the time
    assert f"<b>{whole.outcomes[summary.best.number].metrics['cost.value']:#.4g} s</b>" in text
    assert "median cost.value [s]" in text
    field = whole.table.schema.field
    assert field("duration").metadata == {b"unit": b"s"}
    assert field("clearance").metadata == {b"unit": b"m"}
    assert field("verdict").metadata is None


@pytest.mark.parametrize(
    ("other", "said"),
    [(1.019, "1 other is within 2 %, by which plans with other seeds may differ"), (1.05, "")],
)
def test_rows_within_2_percent_of_the_best_are_counted(whole: StudyResult, other: float, said: str) -> None:
    metric = whole.template.best.metric
    outcomes = dict(whole.outcomes)
    for number, value in ((0, 1.0), (4, other)):
        outcomes[number] = replace(outcomes[number], metrics={**outcomes[number].metrics, metric: value})
    assert summarise_study(replace(whole, outcomes=outcomes)).doubt == said


# --- interrupted, killed, refused -------------------------------------------------------


def test_only_missing_and_torn_rows_of_the_journal_are_planned_again(
    whole: StudyResult, copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = planned_as(whole, monkeypatch)
    kept = cut(copied, lines=4, torn=60)
    done = {json.loads(line[17:])["row"] for line in kept.splitlines()[1:]}
    again = run_study(whole.study, copied)
    assert asked == sorted(set(range(6)) - done)
    assert again.earlier == 3
    assert table_of(copied) == table_of(whole.folder)
    assert (copied / "journal.jsonl").read_bytes().startswith(kept)
    assert run_study(whole.study, copied).earlier == 6
    assert len(asked) == 3


def test_a_row_with_a_damaged_line_is_planned_again(
    whole: StudyResult, copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = planned_as(whole, monkeypatch)
    journal = copied / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b'"row":2,', b'"row":7,'))
    run_study(whole.study, copied)
    assert asked == [2]
    assert table_of(copied) == table_of(whole.folder)


def test_an_interrupt_leaves_the_table_of_the_finished_rows(
    whole: StudyResult, copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned_as(whole, monkeypatch)
    cut(copied, lines=1)

    def watch(step: StudyStep) -> None:
        if step.done == 2:
            raise KeyboardInterrupt

    found = run_study(whole.study, copied, watch=watch)
    assert found.interrupted
    assert pq.read_table(copied / "table.parquet")["row"].to_pylist() == [0, 1]
    with pytest.raises(KeyboardInterrupt):
        bp.study(whole.study, folder=copied, watch=lambda step: (_ for _ in ()).throw(KeyboardInterrupt))
    assert run_study(whole.study, copied).earlier >= 2
    assert table_of(copied) == table_of(whole.folder)


@pytest.mark.parametrize("at", ["journal", "table"])
def test_a_full_disk_ends_with_a_message_and_loses_no_finished_row(
    whole: StudyResult, copied: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    asked = planned_as(whole, monkeypatch)
    cut(copied, lines=1)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with monkeypatch.context() as patch:
        if at == "journal":

            class Full:
                """A file on a disk with room for three more writes, of which the last is torn."""

                def __init__(self, stream: Any) -> None:
                    self._stream, self._left = stream, 3

                def __getattr__(self, name: str) -> Any:
                    return getattr(self._stream, name)

                def write(self, content: bytes) -> int:
                    self._left -= 1
                    if self._left < 0:
                        raise full
                    return int(self._stream.write(content[:40] if self._left == 0 else content))

            made = Journal.__init__

            def with_full_disk(self: Any, *arguments: Any, **keywords: Any) -> None:
                made(self, *arguments, **keywords)
                self._stream = Full(self._stream)

            patch.setattr(Journal, "__init__", with_full_disk)
        else:

            def write(*_: Any, **__: Any) -> None:
                raise full

            patch.setattr(pq, "write_table", write)
        with pytest.raises(bp.OutputError, match="No space left on device"):
            run_study(whole.study, copied)
    done = 2 if at == "journal" else 6
    asked.clear()
    assert run_study(whole.study, copied).earlier == done
    assert asked == list(range(done, 6))
    assert table_of(copied) == table_of(whole.folder)


def test_a_folder_belongs_to_one_study_and_one_run_at_a_time(
    whole: StudyResult, copied: Path, given: Path, tmp_path: Path
) -> None:
    content = whole.study.to_dict()
    before = {file.name: file.read_bytes() for file in copied.glob("*.*")}
    for keys, said in (
        ({"metrics": ["duration"]}, "another metrics"),
        ({"keep_plans": "none"}, "another keep_plans"),
        ({"seed": 1}, "another study seed"),
        ({"parameters": content["parameters"] | {"clearance": [0.1, -0.2, 0.4]}}, "another study parameters clearance"),
    ):
        with pytest.raises(bp.StudyError, match=f"{copied}: holds the results of another study; found {said};"):
            run_study(study_from_dict(content | keys, folder=given.parent), copied)
    elsewhere = Path(shutil.copytree(given.parent, tmp_path / "elsewhere"))
    assert run_study(bp.load_study(elsewhere / "study.yaml"), copied).earlier == 6, "where the study lies is all one"
    (elsewhere / "site" / "rock.stl").write_text(MESH.replace("vertex 1 0 0", "vertex 2 0 0"))
    with pytest.raises(bp.StudyError, match=r"found another files rock\.stl;"):
        run_study(bp.load_study(elsewhere / "study.yaml"), copied)
    with (copied / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(bp.StudyError, match="another run writes its results here"):
            run_study(whole.study, copied)
    assert {name: (copied / name).read_bytes() for name in before} == before
    (copied / "journal.jsonl").unlink()
    with pytest.raises(bp.OutputError, match=r"holds a table\.parquet but no journal"):
        run_study(whole.study, copied)
    with pytest.raises(bp.OutputError, match="is a file"):
        run_study(whole.study, given)


def test_with_anew_all_rows_are_planned_again(
    whole: StudyResult, copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = planned_as(whole, monkeypatch)
    run_study(whole.study, copied, anew=True)
    assert asked == list(range(6))
    assert table_of(copied) == table_of(whole.folder)


def test_rows_left_out_by_a_smaller_count_are_reported_and_return_with_a_larger_one(
    whole: StudyResult, given: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    planned_as(whole, monkeypatch)
    content = whole.study.to_dict() | {"combine": "random"}

    def run(count: int) -> tuple[StudyResult, list[StudyStep]]:
        steps: list[StudyStep] = []
        study = study_from_dict(content | {"count": count}, folder=given.parent)
        return run_study(study, tmp_path / "r", watch=steps.append), steps

    assert run(6)[0].left_out == 0
    found, steps = run(2)
    assert (found.earlier, found.left_out, steps[0].left_out) == (2, 4, 4)
    assert pq.read_table(tmp_path / "r" / "table.parquet").num_rows == 2
    file = given.parent / "fewer.yaml"
    file.write_text(json.dumps(content | {"count": 2}))
    monkeypatch.setattr(sys, "argv", ["backhoe-planner", "study", str(file), "-o", str(tmp_path / "r")])
    with pytest.raises(SystemExit, match="0"):
        main()
    said = capsys.readouterr()
    assert "warning: 4 rows of an earlier run are left out of the tables" in said.err
    assert "left out      4 rows" in said.out
    found, steps = run(6)
    assert (found.earlier, found.left_out, steps[0].left_out) == (6, 0, 0)
    assert pq.read_table(tmp_path / "r" / "table.parquet").num_rows == 6


def test_the_number_of_rows_laid_out_is_reported_meanwhile(
    whole: StudyResult, copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned_as(whole, monkeypatch)
    monkeypatch.setattr(study_run, "_TOLD_EVERY", 4)
    steps: list[StudyStep] = []
    run_study(whole.study, copied, watch=steps.append)
    assert [(step.done, step.rows, step.laid_out) for step in steps] == [(0, 6, 4), (6, 6, None)]


# --- processes that die -----------------------------------------------------------------


@pytest.mark.long
def test_a_row_that_kills_its_process_twice_is_crashed_and_the_others_are_planned(
    whole: StudyResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local_rows, "_plan_row", dies_at_one)
    bundle = build_bundle(*build_template(whole.study))
    rows = whole.rows[1:3]
    found = list(local_rows.plan_locally(bundle, rows, tmp_path, processes=1))
    assert sorted((one.row, one.verdict) for one in found) == [(1, "crashed"), (2, "verified")]


@pytest.mark.long
def test_a_cluster_run_survives_a_dead_worker_and_resumes_from_the_local_journal(
    whole: StudyResult, copied: Path
) -> None:
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    cut(copied, lines=3, torn=9)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        killed: list[int] = []

        def watch(step: StudyStep) -> None:
            if step.row is not None and not killed:
                (nanny,) = cluster.workers.values()
                killed.append(nanny.pid)
                os.kill(nanny.pid, signal.SIGKILL)

        again = run_study(whole.study, copied, scheduler=cluster.scheduler_address, watch=watch)
    assert killed
    assert again.earlier == 2
    assert table_of(copied) == table_of(whole.folder)
    assert bp.load_plan(copied / "plans" / "000004.json").verified


# --- the command and the library --------------------------------------------------------


def test_the_command_prints_a_summary_and_one_message_for_an_error(
    whole: StudyResult, copied: Path, given: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    planned_as(whole, monkeypatch)

    def run(*arguments: Any) -> tuple[Any, str, str]:
        monkeypatch.setattr(sys, "argv", ["backhoe-planner", "study", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        return ended.value.code, said.out, said.err

    status, out, err = run(given, "-o", copied)
    assert (status, "goes on after 6 of 6 rows" in err) == (0, True)
    for line in (
        "rows          6",
        "  failed: start_in_collision       2   33.3 %",
        " s, the least",
        "table         ",
        "    row 2: ",
    ):
        assert line in out
    assert (copied / "study.html").stat().st_size > 3000
    status, out, _ = run(given, "-o", copied, "--anew", "--json")
    found = json.loads(out)
    assert (status, found["rows"], found["done"], found["counts"]["invalid"]) == (0, 6, 6, 2)
    monkeypatch.setattr("backhoe_planner.studies.work.cluster._CONNECTED_WITHIN", 0.2)
    for arguments, said in (
        ((given, "-o", copied, "--anew", "--scheduler", "tcp://127.0.0.1:9"), "the scheduler cannot be reached"),
        ((given, "-o", copied, "--anew", "--scheduler", "here"), "is no address of a scheduler"),
        ((given, "-o", copied, "--anew", "--scheduler", "http://127.0.0.1:80"), "unknown address scheme"),
        ((given, "-o", given), "is a file"),
        ((given, "-o", copied, "--html", "page.txt"), "a page cannot be written in this format"),
        ((given, "-o", copied, "--jobs", "0"), "is not a number of processes"),
    ):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert err.startswith("error: ")
        assert said in err


def test_the_library_returns_a_data_frame(
    whole: StudyResult, given: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned_as(whole, monkeypatch)
    frame = bp.study(given)
    assert frame.shape[0] == 6
    assert frame.groupby("verdict").size().to_dict() == {"failed": 2, "invalid": 2, "verified": 2}
    scene = given.parent / "site" / "scene.yaml"
    robot = bp.load_robot(given.parent / "arm.urdf")
    made = bp.study(robot, scene, parameters={"clearance": [0.1, 0.2]}, folder=tmp_path / "r", metrics=["duration"])
    assert made["clearance"].tolist() == [0.1, 0.2]
    assert made.attrs["units"] == {"clearance": "m", "duration": "s", "cost.value": "s"}
    job = bp.load_job("scenes/jobs/drain_with_a_fall.yaml")
    dug = bp.study(job, parameters={"bucket.fill": [0.8, 0.9]}, metrics=["bank"])
    assert dug["bucket.fill"].tolist() == [0.8, 0.9]
    assert (tmp_path / "r" / "table.parquet").is_file()


def test_a_missing_package_is_an_error_that_says_what_to_install(
    whole: StudyResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "pyarrow" else object())
    with pytest.raises(bp.InputError, match=r"studies need pyarrow \(pip install \"backhoe_planner\[studies\]\"\)"):
        bp.study(whole.study)


def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def plan(bundle: Any, rows: list[StudyRow], *_: Any, **__: Any) -> Iterator[Outcome]:
        bundle.unpack(tmp_path)
        yield from map(RowPlanner(tmp_path).plan, rows)

    monkeypatch.setattr(study_run, "plan_locally", plan)
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((ROOT / "docs" / "studies.ipynb").read_text())
    assert notebook["nbformat"] == 4
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    names: dict[str, Any] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], "is kept without outputs"
            code = compile("".join(cell["source"]), f"cell {cell['id']}", "exec")
            if "long" in cell["metadata"].get("tags", ()):  # takes minutes: only the names of its calls are checked
                assert {"load_job", "stand"} <= set(code.co_names) & set(dir(bp))
            else:
                exec(code, names)
    assert len(names["frame"]) == 16
    assert set(names["frame"]["verdict"]) == {"verified"}
