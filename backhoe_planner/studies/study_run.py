"""Running a study: all rows are drawn, those that are not done are planned, and the tables are written."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from backhoe_planner.errors import OutputError, check_callable, check_flag, check_kind, check_path
from backhoe_planner.files.extras import need_package
from backhoe_planner.files.output_file import whole_file
from backhoe_planner.files.provenance import relative_path
from backhoe_planner.studies.results.journal import Journal
from backhoe_planner.studies.results.outcome import Outcome
from backhoe_planner.studies.results.results_folder import PLANS, TABLE, TIMINGS, ResultsFolder
from backhoe_planner.studies.results.summary import Summary, summarise
from backhoe_planner.studies.results.table import build_table, build_timings, write_table
from backhoe_planner.studies.rows.drawing import StudyRow, draw_rows
from backhoe_planner.studies.rows.template import Template, build_template, digest_of, machine_source
from backhoe_planner.studies.schema.study_file import Study
from backhoe_planner.studies.work.bundle import build_bundle, check_meshes_travel
from backhoe_planner.studies.work.cluster import plan_on_cluster
from backhoe_planner.studies.work.local_rows import plan_locally
from backhoe_planner.studies.work.process_pool import process_count

_TOLD_EVERY = 10_000  # rows drawn between two reports: about half a second; chosen


@dataclass(frozen=True)
class StudyStep:
    """A progress report of a running study.

    Attributes
    ----------
    done: number of rows that are done, including those of earlier runs.
    rows: number of all rows.
    row: the values of the row that was finished last; None at the beginning.
    verdict: of that row.
    laid_out: number of rows drawn so far, before any is planned; None after that.
    left_out: rows of earlier runs that the study no longer has, because its `count` is smaller now.
    """

    done: int
    rows: int
    row: Mapping[str, Any] | None = None
    verdict: str = ""
    laid_out: int | None = None
    left_out: int = 0


@dataclass(frozen=True, eq=False)
class StudyResult:
    """The result of a study.

    Attributes
    ----------
    study: as it was given.
    template: the part that all rows share.
    rows: all of them.
    outcomes: results of the rows that are done, by row number.
    folder: that contains its tables.
    earlier: how many rows were done by earlier runs.
    left_out: how many rows of earlier runs are not in the tables, as `count` is smaller now; the journal keeps them.
    interrupted: whether it was ended by Ctrl-C.
    """

    study: Study
    template: Template
    rows: Sequence[StudyRow]
    outcomes: Mapping[int, Outcome]
    folder: Path
    earlier: int
    left_out: int
    interrupted: bool

    @cached_property
    def table(self) -> Any:
        """A `pyarrow.Table` with one row for each plan that is done."""
        return build_table(self.template, self.rows, self.outcomes)

    def write(self) -> None:
        """Write the tables into the folder."""
        write_table(self.table, self.folder / TABLE)
        write_table(build_timings(self.outcomes), self.folder / TIMINGS)


def run_study(
    study: Study,
    folder: str | Path,
    *,
    scheduler: str | None = None,
    jobs: int = -1,
    anew: bool = False,
    watch: Callable[[StudyStep], object] | None = None,
) -> StudyResult:
    """Run a study, or resume it.

    Parameters
    ----------
    folder: for its results: ``journal.jsonl``, ``table.parquet``, ``timings.parquet``, ``plans/``. Rows that are in
        its journal are not planned again.
    scheduler: address of a Dask cluster that plans the rows; by default processes of this computer do.
    jobs: how many processes; -1 for one on each core.
    anew: whether to delete the results of a study that are in the folder.
    watch: called with a `StudyStep` at the beginning, after every row, and while many rows are drawn.

    Returns
    -------
    The result, also after Ctrl-C: then with the rows that are done.

    Raises
    ------
    StudyError: the study cannot be run, see `build_template`; the folder is of another study, or used by another run;
        the cluster cannot be reached.
    OutputError: results cannot be written; the journal keeps its content.
    InputError: an argument is not allowed, or a package is missing.
    """
    check_kind(study, Study, key="study")
    folder = check_path(folder, key="folder")
    if scheduler is not None:
        check_kind(scheduler, str, key="scheduler")
        need_package("distributed", extra="dask", what="studies on a cluster")
    for package in ("joblib", "pyarrow", "pandas"):
        need_package(package, extra="studies", what="studies")
    processes = process_count(jobs)
    anew = check_flag(anew, key="anew")
    watch = check_callable(watch, key="watch")
    template, inputs = build_template(study)
    told = watch or (lambda _: None)
    shared = digest_of(template, inputs)
    if scheduler is not None:
        check_meshes_travel(inputs.robots)
    rows, identity = _lay_out(study, json.dumps(shared, sort_keys=True), told)
    with (
        ResultsFolder(folder, anew=anew) as results,
        Journal(results.journal, _header(study, shared), kind="study", free="`count` and `name`") as journal,
    ):
        outcomes = dict(_done(identity, journal))
        earlier = len(outcomes)
        todo = [row for row in rows if row.number not in outcomes]
        left_out = len(journal.done.keys() - identity.values())
        told(StudyStep(earlier, len(rows), left_out=left_out))
        interrupted = False
        if todo:
            bundle = build_bundle(template, inputs)
            planned: Generator[Outcome, None, None]
            if scheduler is not None:
                planned = plan_on_cluster(bundle, todo, scheduler)
            else:
                planned = plan_locally(bundle, todo, results.scratch, processes=min(processes, len(todo)))
            try:
                for outcome in planned:
                    if outcome.plan is not None:
                        _write_plan(
                            outcome, rows[outcome.row].values.get("machine", template.machine), template, results
                        )
                    journal.add(identity[outcome.row], outcome.to_dict())
                    outcomes[outcome.row] = outcome.without_plan()
                    told(StudyStep(len(outcomes), len(rows), rows[outcome.row].values, outcome.verdict))
            except KeyboardInterrupt:
                interrupted = True
            finally:
                planned.close()
        found = StudyResult(study, template, rows, outcomes, folder, earlier, left_out, interrupted)
        found.write()
    return found


def summarise_study(result: StudyResult) -> Summary:
    """The summary of the rows that are done."""
    return summarise(result.rows, result.outcomes, result.template.best)


def _lay_out(study: Study, shared: str, told: Callable[[StudyStep], object]) -> tuple[list[StudyRow], dict[int, str]]:
    """All rows, and the identity of each by its number; calls `told` with the progress."""
    rows: list[StudyRow] = []
    identity: dict[int, str] = {}
    for row in draw_rows(study):
        rows.append(row)
        identity[row.number] = row.identity(shared)
        if len(rows) % _TOLD_EVERY == 0:
            told(StudyStep(0, study.rows, laid_out=len(rows)))
    return rows, identity


def _done(identity: Mapping[int, str], journal: Journal) -> Iterator[tuple[int, Outcome]]:
    """The numbers and outcomes of the rows that are in a journal."""
    for number, key in identity.items():
        with contextlib.suppress(KeyError, TypeError, ValueError):  # not in the journal, or not a row's record
            yield number, Outcome.from_dict(journal.done[key])


def _header(study: Study, shared: Mapping[str, Any]) -> dict[str, Any]:
    """All that determines the rows except their number; two studies with the same header can share a folder."""
    free = ("name", "count", "scene", "job", "metrics", "keep_plans")  # the last four are in `shared`
    content = {key: value for key, value in study.to_dict().items() if key not in free}
    return {"study": content, **shared}


def _write_plan(outcome: Outcome, machine: str, template: Template, results: ResultsFolder) -> None:
    """Write the file of a plan of a `machine`, with paths relative to the folder of plans."""
    file = results.plan_file(outcome.row)
    content = json.loads(outcome.plan or "")
    folder = results.path / PLANS

    def seen(path: str) -> str:
        return relative_path(Path(path), folder)

    def seen_machine(name: str) -> str:
        source = machine_source(name, template.machine_folder)
        return source if source.startswith("example:") else seen(source)

    if template.kind == "job":
        content["machine"] = seen_machine(content["job"].get("machine", "example:backhoe"))
        content["folder"], content["site_folder"] = seen(template.folder), seen(template.site_folder)
    else:
        content["robot"]["urdf"] = seen_machine(machine)
        content["scene_folder"] = seen(template.folder)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=folder) from error
    with whole_file(file) as stream:
        stream.write(json.dumps(content, allow_nan=False) + "\n")
