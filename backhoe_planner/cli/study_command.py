"""`study`: plan one scene or job many times, with progress, a summary and a page."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer

import backhoe_planner as bp
from backhoe_planner import show, studies
from backhoe_planner.cli.terminal import ERR, FAILED, INTERRUPTED, OUT, VERIFIED

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY", help="A study file (YAML).", show_default=False)]


def study(
    file: StudyFile,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FOLDER", help="Folder for the tables, the page and plans.")
    ] = Path("results"),
    jobs: Annotated[int, typer.Option(help="Processes that plan; -1 is one for each core.")] = -1,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Plan on the Dask cluster of this scheduler instead.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where the page goes; by default into the folder.")
    ] = None,
    anew: Annotated[bool, typer.Option("--anew", help="Begin anew where the folder holds results.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> int:
    """Plan a scene or a job many times, with different parameters.

    If the folder holds the same study, interrupted or killed, it continues from there.
    """
    loaded = bp.load_study(file)
    if html is not None:
        show.check_page(html, (file,))
    with _progress(shown=ERR.is_terminal and not as_json) as watch:
        found = studies.run_study(loaded, output, scheduler=scheduler, jobs=jobs, anew=anew, watch=watch)
    page = html if html is not None else output / studies.PAGE
    show.write_study_page(found, page)
    summary = studies.summarise_study(found)
    if as_json:
        _print_json(found, summary, page)
    else:
        _print_summary(found, summary, page)
    if found.interrupted:
        return INTERRUPTED
    return VERIFIED if any(one.verdict == "verified" for one in found.outcomes.values()) else FAILED


@contextlib.contextmanager
def _progress(*, shown: bool) -> Iterator[Callable[[bp.StudyStep], None]]:
    """Report progress of a study: a bar with rate and remaining time on a terminal, otherwise that it continues."""
    if not shown:
        yield _tell_of_earlier_rows
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(), TextColumn("elapsed,"), TimeRemainingColumn(), TextColumn("left"),
    )  # fmt: skip
    with Progress(*columns, console=ERR.console, transient=True) as progress:
        task = progress.add_task("planning", total=None, rate="")
        begun: list[int] = []

        def watch(step: bp.StudyStep) -> None:
            if step.laid_out is not None:
                progress.update(task, description="laying out rows", total=step.rows, completed=step.laid_out)
                return
            if not begun:
                begun.append(step.done)
                _tell_of_earlier_rows(step)
                progress.reset(task, description="planning", total=step.rows, completed=step.done)
                return
            elapsed = progress.tasks[0].elapsed or 0.0
            rate = f"{(step.done - begun[0]) / elapsed:.1f} a second" if elapsed > 0.0 else ""
            progress.update(task, completed=step.done, rate=rate)

        yield watch


def _tell_of_earlier_rows(step: bp.StudyStep) -> None:
    if step.row is None and step.done:
        ERR.print(f"goes on after {step.done} of {step.rows} rows that are done (--anew begins anew)")
    if step.row is None and step.left_out:
        ERR.print(f"warning: {_left_out(step.left_out)}")


def _left_out(rows: int) -> str:
    return f"{rows} rows of an earlier run are left out of the tables, as count is smaller now; the journal keeps them"


def _print_summary(found: studies.StudyResult, summary: studies.Summary, page: Path) -> None:
    total, done = len(found.rows), len(found.outcomes)
    OUT.print(f"rows          {done}" + ("" if done == total else f" of {total}; the same command goes on"))
    if found.left_out:
        OUT.print(f"left out      {found.left_out} rows of an earlier run with a larger count; the journal keeps them")
    for ending, count in summary.counts.items():
        OUT.print(f"  {ending:<28}{count:6d}  {100.0 * count / done:5.1f} %")
        if ending in summary.messages:
            row, message = summary.messages[ending]
            OUT.print(f"    row {row}: {message}")
    best = found.template.best
    if summary.best is not None:
        which = "least" if best.least is not None else "greatest"
        figure = found.template.best_metric.describe(summary.best_value)
        OUT.print(f"best          row {summary.best.number}: {best.metric} {figure}, the {which}")
        if summary.doubt:
            OUT.print(f"  {summary.doubt}")
        headings = {name: found.template.heading(name) for name in summary.best.values}
        width = max(map(len, headings.values()), default=0)
        for name, value in summary.best.values.items():
            shown = f"{value:.6g}" if isinstance(value, float) else value
            OUT.print(f"  {headings[name]:<{max(width, 26)}}  {shown}")
    OUT.print(f"table         {found.folder / studies.TABLE}")
    OUT.print(f"page          {page}")


def _print_json(found: studies.StudyResult, summary: studies.Summary, page: Path) -> None:
    best = summary.best
    content = {
        "rows": len(found.rows),
        "done": len(found.outcomes),
        "left_out": found.left_out,
        "interrupted": found.interrupted,
        "counts": dict(summary.counts),
        "messages": {ending: {"row": row, "message": said} for ending, (row, said) in summary.messages.items()},
        "best": None
        if best is None
        else {
            "row": best.number, "metric": found.template.best.metric, "value": summary.best_value,
            "unit": found.template.best_metric.unit,
            "parameters": dict(best.values),
        },
        "table": str(found.folder / studies.TABLE),
        "page": str(page),
    }  # fmt: skip
    sys.stdout.write(json.dumps(content, allow_nan=False, indent=2) + "\n")
