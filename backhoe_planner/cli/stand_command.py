"""`stand`: find where a machine should stand for a job, with progress and a table."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

import backhoe_planner as bp
from backhoe_planner import show, standing
from backhoe_planner.cli.job_command import JobFile, print_job_warnings
from backhoe_planner.cli.terminal import DEGREES, ERR, FAILED, OUT, VERIFIED, print_verdict
from backhoe_planner.files.output_file import check_apart

_LITTLE = 0.02  # part of the cost by which estimates and searches differ anyway; chosen


def stand(
    file: JobFile,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Answer to write; beside it, for each place, its job, its plan and the ground it begins on.",
        ),
    ] = Path("stand.json"),
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write the map as a page.")] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write the map as a picture: .png, .svg or .pdf.")
    ] = None,
    effort: Annotated[
        str, typer.Option(help="quick, normal or thorough: how many places are estimated, and the effort of all plans.")
    ] = "quick",
    count: Annotated[
        int, typer.Option(metavar="N", help="How many places are planned in full beside the given one.")
    ] = 2,
    seed: Annotated[int, typer.Option(help="Of every random choice.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the answer as JSON (without the map).")] = False,
) -> int:
    """Find where to stand for a job: the best place, or several.

    The result is the place, or the fewest places in order, from which the job takes the least time or work.
    """
    check_apart([output, html, plot])
    loaded = bp.load_job(file)
    standing.check_stand_outputs(output, loaded)
    if html is not None:
        show.check_page(html, loaded.files)
    if plot is not None:
        show.check_figure(plot, loaded.files)
    print_job_warnings(loaded)
    with _progress(as_json) as told:
        found = bp.stand(loaded, count=count, effort=effort, seed=seed, watch=told)
    found.save(output)
    if html is not None:
        show.write_stand_page(found, html)
    if plot is not None:
        show.plot_stand(found, plot)
    if as_json:
        content = standing.stand_to_dict(found)
        del content["map"]
        sys.stdout.write(json.dumps(content | {"file": str(output)}, allow_nan=False, indent=2) + "\n")
    else:
        print_stand(found, output)
        for name, written in (("page", html), ("map", plot)):
            if written is not None:
                OUT.print(f"{name:<14}{written}")
    return VERIFIED if found.verified else FAILED


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[bp.StandStep], None]]:
    """Show a progress bar, or in a log a line now and then."""
    if not quiet and not ERR.is_terminal:
        with ERR.status("looking for places ...") as status:
            assert status is not None
            yield lambda step: status.update(f"{step.what}: {step.done} of {step.total} ...")
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    with Progress(*columns, TimeElapsedColumn(), console=ERR.console, transient=True, disable=quiet) as bar:
        task = bar.add_task("", total=1)
        yield lambda step: bar.update(task, description=step.what, completed=step.done, total=step.total)


def print_stand(plan: bp.StandPlan, output: Path) -> None:
    """Print the answer and the places that were compared.

    Parameters
    ----------
    output: the file to which it was written.
    """
    print_verdict("" if plan.verified else f"failed: {plan.reason}")
    if plan.note:
        OUT.print(f"  {plan.note}")
    unit, scale = plan.job.cost_unit
    _print_ranking(plan, unit, scale)
    if plan.places:
        OUT.print(f"place   x [m]   y [m]  heading [deg]  cycles  bank [m^3]  time [s]  {unit:>7}  section, travel")
    for number, place in enumerate(plan.places, start=1):
        (x, y), own = place.base.position, place.plan
        part = "all of it"
        if place.section is not None:
            (x0, y0), (x1, y1) = place.section
            part = f"from {x0:.2f}, {y0:.2f} to {x1:.2f}, {y1:.2f} m"
            part += f", {place.travel:.2f} m from the last place" if number > 1 else ""
        OUT.print(
            f"{number:5d}  {x:6.2f}  {y:6.2f}  {DEGREES * place.base.heading:13.0f}  {len(own.cycles):6d}  "
            f"{own.bank:10.2f}  {own.duration:8.0f}  {scale * own.cost:7.1f}  {part}"
        )
    if plan.places:
        OUT.print(f"soil          {plan.bank:.2f} m^3 bank")
        moved = f", without the machine's own travel of {plan.travel:.1f} m" if plan.travel else ""
        OUT.print(f"cost          {scale * plan.cost:.1f} {unit}{moved}")
    if plan.stays:
        OUT.print("gain          none: the answer is the given place")
    elif math.isfinite(plan.gain):
        little = ", which is hardly worth a move" if 0.0 < plan.gain < _LITTLE else ""
        OUT.print(f"gain          {100.0 * plan.gain:.1f} % less than from the given place{little}")
    for number, place in enumerate(plan.places, start=1):
        for one in place.plan.undug:
            OUT.print(f"undug         from place {number}: {one.words}")
    OUT.print(f"planned in    {plan.planning_time:.0f} s")
    OUT.print(f"answer        {output}")


def _print_ranking(plan: bp.StandPlan, unit: str, scale: float) -> None:
    if not plan.ranking:
        return
    OUT.print(f"compared [{unit}]")
    OUT.print(" x [m]   y [m]  heading [deg]   rough  estimated  planned  bank [m^3]  remark")
    chosen = [place.base for place in plan.places]
    for one in plan.ranking:
        x, y = one.base.position
        rough, estimated, planned = (
            f"{scale * cost:.1f}" if math.isfinite(cost) else "-" for cost in (one.rough, one.estimated, one.planned)
        )
        bank = f"{one.bank:.2f}" if math.isfinite(one.bank) else "-"
        # soil that stays undug at a chosen place is printed below
        marks = ["chosen"] if one.base in chosen else [one.note] * bool(one.note)
        marks += ["given"] * one.given
        OUT.print(
            f"{x:6.2f}  {y:6.2f}  {DEGREES * one.base.heading:13.0f}  {rough:>6}  {estimated:>9}  {planned:>7}  "
            f"{bank:>10}  {'; '.join(marks)}".rstrip()
        )
