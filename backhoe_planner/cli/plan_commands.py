"""`plan`, `view`, `check`, `plot` and `export`: make a plan, and use its file."""

from __future__ import annotations

import contextlib
import functools
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import backhoe_planner as bp
from backhoe_planner import job, live, motion, planning, show, site
from backhoe_planner.cli.job_command import check_job, draw_job_page, read_job_plan
from backhoe_planner.cli.plan_summary import print_certificate, print_plan, print_recording
from backhoe_planner.cli.terminal import ERR, FAILED, OUT, VERIFIED, PlanFile, PlanUrdf, SceneFile, Urdf, print_warnings
from backhoe_planner.files.output_file import check_apart, check_output, check_record

if TYPE_CHECKING:
    from rich.status import Status

    from backhoe_planner.cli.terminal import PlainStatus


def plan(
    urdf: Urdf,
    scene: SceneFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Plan file to write.")] = Path(
        "plan.json"
    ),
    method: Annotated[
        str,
        typer.Option(
            help="auto searches for the best motion, and follows the local law if it finds none; optimal searches "
            "only; reactive is the completed law alone, paper the law as printed."
        ),
    ] = "auto",
    seed: Annotated[int, typer.Option(help="Of every random choice: another one may find another motion.")] = 0,
    effort: Annotated[
        str,
        typer.Option(
            help="quick, normal or thorough: how much is searched, in counted work. quick tells soon whether there is "
            "a motion; normal finds better ones; thorough is for motions that are used often, as it takes several "
            "times as long."
        ),
    ] = "normal",
    budget: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="Seconds of computing time after which a search is stopped: 60, of thorough 600. "
            "--effort is what bounds it.",
        ),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show the steps in the browser, then play the plan.")] = False,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write a page that plays the plan offline.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON (all of the plan file but the samples).")
    ] = False,
) -> int:
    """Plan the task of a scene, and write the plan."""
    check_apart([output, html])
    loaded = bp.load_scene(scene)
    robot = site.load_machine(urdf, loaded)
    inputs = (*robot.files, *loaded.files)
    check_record(output, inputs)
    if html is not None:
        show.check_page(html, inputs)
    print_warnings(site.input_warnings(robot, loaded))
    compute = functools.partial(bp.plan, robot, loaded, method=method, seed=seed, effort=effort, budget=budget)
    with show.Viewer() if view else contextlib.nullcontext() as viewer:
        if viewer is not None:
            print_warnings(viewer.show_problem(motion.build_problem(robot, loaded)))
            _wait_for_browser(viewer)
            found = compute(watch=lambda step: viewer.show_step(step.q, step.time))
        else:
            with ERR.status("planning ...", quiet=as_json) as status:
                shown = status if ERR.is_terminal else None  # the lines of a log do without the best so far
                found = compute(watch=None if shown is None else lambda step: _show_best(shown, step))
        found.save(output)
        print_warnings(site.obstacle_warnings(robot, found.problem.obstacles))
        if html is not None:  # before anything is printed: the reader of the output may stop early
            try:
                print_warnings(show.write_page(found, html))
            except bp.OutputError:  # such as a full disk: the plan itself was found and written
                print_plan(found, output, as_json)
                raise
        print_plan(found, output, as_json)
        if html is not None and not as_json:
            _print_page(html)
        if viewer is not None:
            print_warnings(viewer.play(found))
            _play_until_interrupted(viewer)
    return VERIFIED if found.verified else FAILED


def _show_best(status: Status | PlainStatus, step: planning.PlannerStep) -> None:
    """Show the cost of the best motion to a goal so far."""
    if step.best is not None and step.time == 0.0:
        status.update(f"planning ... the best so far: {step.best:,.4g} {step.unit}")


def view(
    plan_file: PlanFile,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write one page that works offline instead.")
    ] = None,
    urdf: PlanUrdf = None,
) -> int:
    """Play a plan in the browser, or write its page, or a job's."""
    if html is not None:
        check_output(html, [plan_file])
    if job.is_job_plan(plan_file):
        if html is None:
            raise _refused(plan_file, "is played from a page", hint="view PLAN --html PAGE writes one")
        draw_job_page(read_job_plan(plan_file, urdf), html)
        _print_page(html)
        return VERIFIED
    loaded = bp.load_plan(plan_file, urdf=urdf)
    if html is not None:
        print_warnings(show.write_page(loaded, html))
    print_recording(loaded)
    if html is not None:
        _print_page(html)
        return VERIFIED
    with show.Viewer() as viewer:
        print_warnings(viewer.play(loaded))
        _wait_for_browser(viewer)
        _play_until_interrupted(viewer)
    return VERIFIED


def check(plan_file: PlanFile, urdf: PlanUrdf = None) -> int:
    """Compute the certificate of a plan, or of a job, anew."""
    begun = clock.monotonic()
    if job.is_job_plan(plan_file):
        return check_job(plan_file, urdf)
    loaded = bp.load_plan(plan_file, urdf=urdf)
    print_warnings(site.input_warnings(loaded.robot, loaded.scene, is_planned=True))
    print_warnings(site.obstacle_warnings(loaded.robot, loaded.problem.obstacles))
    if loaded.verified:  # if the motion itself was changed, the failed certificate says enough
        print_warnings(planning.plan_differences(plan_file, loaded))
    print_warnings(planning.plan_contradictions(plan_file, loaded))
    print_certificate(loaded)
    _print_unchecked(loaded)
    OUT.print(f"{'checked in':<13}{clock.monotonic() - begun:.2f} s")
    return VERIFIED if loaded.verified else FAILED


def _print_unchecked(plan: bp.Plan) -> None:
    """Print which words of a plan file its motion does not show; nothing for a motion driven by hand."""
    if not live.is_recording(plan):
        reason = ", reason" if plan.failure and not plan.verified else ""
        words = f"method, seed, effort, findings{reason} and message are the file's own words, which no motion shows"
        OUT.print(f"{'not checked':<13}{words}")


def plot(
    plan_file: PlanFile,
    file: Annotated[Path, typer.Argument(metavar="FILE", help=".png, .svg or .pdf", show_default=False)],
    urdf: PlanUrdf = None,
) -> int:
    """Plot a plan over time: joints, margins, limits, power."""
    if job.is_job_plan(plan_file):
        hint = "export PLAN FILE.csv writes its motions, view PLAN --html PAGE a page"
        raise _refused(plan_file, "is not plotted", hint=hint)
    return _write(show.plot_plan, plan_file, urdf, file)


def export(
    plan_file: PlanFile,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help=".csv, .npz, or .yaml (ROS 2 JointTrajectory)", show_default=False)
    ],
    urdf: PlanUrdf = None,
) -> int:
    """Write a plan's motion, or all cycles of a job, for other tools."""
    if job.is_job_plan(plan_file):
        check_output(file, [plan_file])
        job.export_job(read_job_plan(plan_file, urdf), file)
        OUT.print(f"wrote {file}")
        return VERIFIED
    return _write(planning.export_plan, plan_file, urdf, file)


def _refused(plan_file: Path, problem: str, *, hint: str) -> bp.PlanFileError:
    return bp.PlanFileError(f"the plan of a job {problem}", file=plan_file, hint=hint)


def _write(write: Callable[[bp.Plan, Path], object], plan_file: Path, urdf: str | None, file: Path) -> int:
    """Write a plan to `file` with the function `write`."""
    check_output(file, [plan_file])
    write(bp.load_plan(plan_file, urdf=urdf), file)
    OUT.print(f"wrote {file}")
    return VERIFIED


def _wait_for_browser(viewer: show.Viewer) -> None:
    ERR.print(f"open {viewer.url} in a browser (Ctrl-C ends)")
    viewer.wait_for_browser()


def _play_until_interrupted(viewer: show.Viewer) -> None:
    ERR.print("playing; the panel in the page sets speed and position; Ctrl-C ends")
    with contextlib.suppress(KeyboardInterrupt):
        while viewer.alive():
            clock.sleep(0.2)


def _print_page(html: Path) -> None:
    OUT.print(f"page          {html}")
