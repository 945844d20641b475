"""`job`: plan a whole job, cycle after cycle, with progress and a table."""

from __future__ import annotations

import contextlib
import json
import sys
import time as clock
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

import backhoe_planner as bp
from backhoe_planner import job as jobs
from backhoe_planner import show, site
from backhoe_planner.cli.terminal import ERR, FAILED, INTERRUPTED, OUT, VERIFIED, print_verdict, print_warnings
from backhoe_planner.digits import margin_text
from backhoe_planner.files.output_file import check_apart, check_record

_WHOLE = 0.999  # part of a column of the ground that is within the design: all of it, apart from rounding
JobFile = Annotated[Path, typer.Argument(metavar="JOB", help="A job file (YAML).", show_default=False)]


def job(
    file: JobFile,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Plan of the job to write, after every cycle.")
    ] = Path("job.json"),
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write a page that plays the job offline.")
    ] = None,
    effort: Annotated[
        str | None,
        typer.Option(
            help="quick (so by default), normal or thorough: bounds the search of every motion, in counted work."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of every random choice.")] = 0,
    from_terrain: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Go on from this ground, as it was surveyed: CSV, GeoTIFF or point cloud."),
    ] = None,
    anew: Annotated[bool, typer.Option("--anew", help="Begin anew where the output holds a part of this job.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON (all of the plan's file but the motions).")
    ] = False,
) -> int:
    """Plan a job: all cycles from the first cut to the last.

    If the output holds the same job, ended early, planning continues from there. `backhoe-planner stand JOB` finds
    the best place for the machine, and the places from which it digs a job that is longer than its reach.
    """
    effort = jobs.DEFAULT_EFFORT if effort is None else effort
    check_apart([output, html])
    loaded = bp.load_job(file)
    inputs = (*loaded.files, *(() if from_terrain is None else (from_terrain,)))
    check_record(output, inputs)
    if html is not None:
        show.check_page(html, inputs)
    print_job_warnings(loaded)
    terrain = None
    if from_terrain is not None:
        survey = jobs.read_ground(loaded, from_terrain)
        terrain = survey.terrain
        if survey.unknown.any():
            part = 100.0 * float(survey.unknown.mean())
            print_warnings(
                [f"{from_terrain} does not cover {part:.0f} % of the ground: there it is taken as the job has it"]
            )
        if survey.remark:
            print_warnings([f"{from_terrain}: {survey.remark}"])
    resume = None if anew else _begun(loaded, output, (effort, seed), terrain)
    if resume is not None:
        ERR.print(f"goes on after cycle {len(resume.cycles)}, as {output} has it (--anew begins anew)")
    kept: list[int] = []  # cycles that the output holds
    with (
        _telling_where_it_is(kept, output),
        ERR.status("choosing the pattern of cuts ...", quiet=as_json) as status,
    ):

        def told(step: jobs.JobStep) -> None:
            step.plan.save(output)
            kept.append(len(step.plan.cycles))
            if status is not None:
                status.update(f"cycle {len(step.plan.cycles) + 1} of about {max(step.expected, 1)} ...")
            if not as_json:
                _print_cycle(step)

        found = bp.plan_job(loaded, effort=effort, seed=seed, terrain=terrain, resume=resume, watch=told)
    found.save(output)
    if html is not None:
        draw_job_page(found, html)
    print_job(found, output, as_json)
    if html is not None and not as_json:
        OUT.print(f"page          {html}")
    return VERIFIED if found.verified else FAILED


@contextlib.contextmanager
def _telling_where_it_is(kept: list[int], output: Path) -> Iterator[None]:
    """If the user interrupts the planning, report what is done and where it is."""
    try:
        yield
    except KeyboardInterrupt:
        if kept:
            many = f"{kept[-1]} cycle{'' if kept[-1] == 1 else 's'}"
            ERR.print(f"interrupted after {many}, kept in {output}; the same command goes on there")
        else:
            ERR.print("interrupted before the first cycle; nothing was written")
        sys.exit(INTERRUPTED)


def _begun(loaded: jobs.Job, output: Path, search: tuple[str, int], terrain: jobs.Terrain | None) -> bp.JobPlan | None:
    """The part of the same job that the output holds, if planning was interrupted.

    Raises
    ------
    InputError: it was begun by another command, or is damaged, so that planning would begin anew over it.
    """
    if not output.is_file() or not jobs.is_job_plan(output):
        return None
    record = jobs.read_job_plan_file(output)
    if record.reason != "interrupted":
        return None
    found = bp.load_job_plan(output)
    if not jobs.same_job(found, loaded):
        ERR.print(f"begins anew: {output} holds a part of another job")
        return None
    anew = "--anew begins anew over it"
    if found.reason != "interrupted":
        raise bp.PlanFileError(f"cannot be continued: {found.note}", file=output, hint=anew)
    if (found.effort, found.seed) != search:
        raise bp.InputError(
            "holds a part of this job that was planned with other settings", file=output,
            found=f"--effort {found.effort} --seed {found.seed}",
            hint=f"give these to go on with it; {anew}",
        )  # fmt: skip
    if found.surveyed if terrain is None else not jobs.same_ground(found.start, terrain):
        began, so = ("of a survey", "give that with") if found.surveyed else ("of the job", "leave out")
        raise bp.InputError(
            "holds a part of this job that began on another ground", file=output, found=f"that {began}",
            hint=f"{so} --from-terrain to go on with it; {anew}",
        )  # fmt: skip
    return found


def _print_cycle(step: jobs.JobStep) -> None:
    cycles = step.plan.cycles
    if not cycles:
        print_patterns(step.plan)
        OUT.print("cycle  of  bank [m^3]  full [%]  time [s]  work [kJ]  dumped at x, y [m]  part")
        return
    one = cycles[-1]
    truck = f", truck {one.truck}" if one.truck else ""
    OUT.print(
        f"{one.number:5d} {max(step.expected, one.number):3d}  {one.bank:10.3f}  {100.0 * one.filled:8.0f}  "
        f"{one.duration:8.1f}  {one.work / 1e3:9.1f}  {one.place[0]:8.2f}, {one.place[1]:8.2f}  {one.step}{truck}"
    )


def print_patterns(plan: bp.JobPlan) -> None:
    """Print which patterns of cuts were compared; nothing if the pattern was prescribed."""
    if len(plan.compared) < 2:
        return
    unit, scale = plan.job.cost_unit
    OUT.print(f"{'compared, by estimates':<38}  cycles  bank [m^3]  time [s]  work [kJ]  {unit:>8}  remark")
    chosen = next(one for one in plan.compared if one.chosen)
    for one in plan.compared:
        mark = ", ".join(["chosen"] * one.chosen + ["leaves some"] * (not one.finished))
        if one.finished and not one.chosen and abs(one.cost / chosen.cost - 1.0) <= jobs.CLOSE:
            more = 100.0 * (one.cost / chosen.cost - 1.0)
            mark = f"{abs(more):.1f} % {'more' if more > 0.0 else 'less'}: too close to tell"
        OUT.print(
            f"{one.name:<38}  {one.cycles:6d}  {one.bank:10.2f}  {one.duration:8.0f}  {one.work / 1e3:9.0f}  "
            f"{scale * one.cost:8.1f}  {mark}".rstrip()
        )


def print_job(plan: bp.JobPlan, output: Path, as_json: bool) -> None:
    """Print the result of a job as a table, or as JSON.

    Parameters
    ----------
    plan: of the job.
    output: the file to which it was written.
    as_json: whether to print JSON.
    """
    if as_json:
        content = jobs.job_plan_to_dict(plan)
        content["file"] = str(output)
        sys.stdout.write(json.dumps(content, allow_nan=False, indent=2) + "\n")
        return
    print_figures(plan)
    OUT.print(f"planned in    {plan.planning_time:.1f} s (effort {plan.effort}, seed {plan.seed})")
    OUT.print(f"plan          {output}")


def print_figures(plan: bp.JobPlan) -> None:
    """Print verdict and figures of a job."""
    print_verdict("" if plan.verified else f"failed: {plan.reason}")
    if plan.note:
        OUT.print(f"  {plan.note}")
    if plan.surveyed:
        OUT.print("ground        before the first cycle as surveyed, not that of the job")
    count, figures = len(plan.cycles), jobs.job_figures(plan)
    OUT.print(f"cycles        {count}")
    if count:
        OUT.print(f"soil          {figures.bank:.3f} m^3 bank, {figures.loose:.3f} m^3 loose")
        waits = f", of it {figures.waits:.0f} s until trucks are exchanged" if figures.waits else ""
        OUT.print(f"duration      {figures.duration:.1f} s ({figures.seconds_per_cycle:.1f} s a cycle){waits}")
        OUT.print(f"production    {figures.production:.1f} m^3/h (bank)")
        OUT.print(f"work          {figures.work / 1e3:.0f} kJ ({figures.joules_per_cycle / 1e3:.1f} kJ a cycle)")
        _print_energy(plan, figures)
        _print_clearance(plan)
    left, below = 100.0 * figures.left, 100.0 * figures.below
    most = f"at most {left:.1f} cm left above what may be dug, {below:.1f} cm dug below it"
    stays = sum(one.volume for one in plan.undug)
    part = f", of which {stays:.3f} m^3 ({100.0 * stays / figures.design:.1f} %) stays" if stays else ""
    OUT.print(f"design        {figures.design:.3f} m^3{part}; {most}")
    deep = (plan.start.surface - plan.design)[plan.share > _WHOLE]
    if plan.job.dig.trench is not None and deep.size and float(deep.max() - deep.min()) > plan.job.dig.tolerance:
        between = f"{float(deep.min()):.2f} to {float(deep.max()):.2f} m below the ground"
        OUT.print(f"depth         {between}; the {plan.job.dig.trench.depth:g} m of the job count at `from`")
    for one in plan.undug:
        OUT.print(f"undug         {one.words}")


def _print_clearance(plan: bp.JobPlan) -> None:
    """Print the tightest spot of all motions, and in which it is; nothing if nothing can be touched."""
    spots = [
        (spot, cycle.number, leg.name)
        for cycle in plan.cycles
        for leg in cycle.legs
        if (spot := leg.certificate.min_clearance) is not None
    ]
    if spots:
        tightest, number, leg_name = min(spots, key=lambda one: one[0].margin)
        OUT.print(
            f"clearance     {tightest.distance:.3f} m at least between {tightest.link} and {tightest.name} "
            f"(margin {margin_text(tightest.margin)} m, in cycle {number}, {leg_name})"
        )


def print_job_warnings(loaded: bp.Job) -> None:
    """Print what is assumed of a job's machine and site, before planning starts."""
    scene = loaded.site_scene
    robot = site.load_machine(loaded.machine_source, scene)
    print_warnings(site.input_warnings(robot, scene, with_task=False))
    print_warnings(site.obstacle_warnings(robot, site.build_obstacles(scene, robot)))
    print_warnings(jobs.ground_warnings(loaded))


def read_job_plan(file: Path, urdf: str | None) -> bp.JobPlan:
    """The plan of a job; the error stream shows meanwhile what takes so long."""
    with ERR.status("digging the ground anew, for what stands at every moment ..."):
        return bp.load_job_plan(file, urdf=urdf)


def draw_job_page(plan: bp.JobPlan, html: Path) -> None:
    """Write the page of a job, and print its warnings; the error stream shows meanwhile what takes so long."""
    with ERR.status("drawing the page ..."):
        warnings = show.write_job_page(plan, html)
    print_warnings(warnings)


def check_job(file: Path, urdf: str | None) -> int:
    """Prove the plan of a job again, and print the result."""
    begun = clock.monotonic()
    found = read_job_plan(file, urdf)
    print_warnings(site.input_warnings(found.robot, found.job.site_scene, with_task=False, is_planned=True))
    if found.refutes_failure:
        words = f"the file says {found.failure}, but every cycle holds and the design is met wherever it may be dug"
        print_warnings([f"reason: {words}"])
    print_figures(found)
    OUT.print(f"{'not checked':<14}reason and message of a failure are the file's own words: motions do not show them")
    OUT.print(f"{'checked in':<14}{clock.monotonic() - begun:.1f} s")
    return VERIFIED if found.verified else FAILED


def _print_energy(plan: bp.JobPlan, figures: jobs.JobFigures) -> None:
    if plan.robot.hydraulics is None:
        OUT.print(f"energy        {figures.kwh_per_m3:.3f} kWh/m^3 (bank), at the joints")
        return
    OUT.print(
        f"energy        {figures.kwh_per_m3:.3f} kWh/m^3 (bank) from the pump; about {figures.litres:.2f} l of diesel "
        f"in all, at {jobs.LITRES_PER_KWH:g} l for a kWh of the engine"
    )
    pump, engine = 100.0 * figures.pump, 100.0 * figures.engine
    OUT.print(f"utilisation   pump {pump:.0f} % of its flow, engine {engine:.0f} % of its power, on average")
