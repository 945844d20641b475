"""The command line: `backhoe-planner COMMAND ...`.

Exit status: 0 verified (or done), 1 no verified plan, 2 bad input, 130 interrupted.
What a command computes is one call of the library; here it is only asked for and told.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import sys
import time as clock
import webbrowser
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

import backhoe_planner as bp
from backhoe_planner.files.output_file import check_writable
from backhoe_planner.planning import DEFAULT_BUDGET

if TYPE_CHECKING:
    from backhoe_planner.motion import Detour
    from backhoe_planner.planning import AskedSpeed, LawComparison, Plan

__all__ = ["app", "main"]

VERIFIED, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
_DEGREES = 180.0 / math.pi
_MOST_PARTS = 3  # of a path that are told one by one

app = typer.Typer(
    help="Proven motions for a backhoe, or any redundant arm, along a path among obstacles.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_out = Console(highlight=False, markup=False, soft_wrap=True)
_err = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)

Urdf = Annotated[str, typer.Argument(metavar="URDF", help="A URDF file, or example:NAME.", show_default=False)]
SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="A scene file (YAML).", show_default=False)]
PlanFile = Annotated[Path, typer.Argument(metavar="PLAN", help="A plan file (JSON).", show_default=False)]
PlanUrdf = Annotated[
    str | None, typer.Option("--urdf", metavar="URDF", help="Where the URDF lies now, if not where the plan says.")
]


def main() -> NoReturn:
    """Entry point of `backhoe-planner`."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a name may not fit the terminal's alphabet
    try:
        status = app(standalone_mode=False)
    except bp.InputError as error:
        _err.print(Text("error: ", style="bold red") + Text(str(error)))
        sys.exit(BAD_INPUT)
    except (KeyboardInterrupt, typer.Abort):
        _err.print("interrupted")
        sys.exit(INTERRUPTED)
    except typer.Exit as done:
        sys.exit(done.exit_code)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(FAILED)
    except Exception as error:
        if not _is_usage_error(error):
            raise
        _err.print(Text("error: ", style="bold red") + Text(error.format_message()))  # type: ignore[attr-defined]
        sys.exit(BAD_INPUT)
    if status == INTERRUPTED:  # typer turns Ctrl-C into a return value
        _err.print("interrupted")
    sys.exit(status if isinstance(status, int) else VERIFIED)


def _is_usage_error(error: Exception) -> bool:
    """Whether it is click's own complaint about the command line."""
    return hasattr(error, "format_message") and hasattr(error, "exit_code")


@app.command()
def plan(
    urdf: Urdf,
    scene: SceneFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Plan file to write.")] = Path(
        "plan.json"
    ),
    method: Annotated[str, typer.Option(help="auto, reactive, optimal or paper.")] = "auto",
    seed: Annotated[int, typer.Option(help="Of every random choice.")] = 0,
    effort: Annotated[str, typer.Option(help="quick, normal or thorough: how much is searched.")] = "normal",
    budget: Annotated[
        float, typer.Option(metavar="S", help="Time after which whatever still runs is ended [s].")
    ] = DEFAULT_BUDGET,
    view: Annotated[bool, typer.Option("--view", help="Show the steps in the browser, then play the plan.")] = False,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write a page that plays the plan offline.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON (all of the plan file but the trajectory).")
    ] = False,
) -> int:
    """Plan the task of a scene, and write the plan."""
    for target in (output, html):
        if target is not None and target.exists() and any(_same_file(target, given) for given in (Path(urdf), scene)):
            raise bp.OutputError("is an input of this command", file=target)
    check_writable(output)
    if html is not None:
        check_writable(html)
    loaded = bp.load_scene(scene)
    robot = bp.load_robot(urdf, tip=loaded.tip)
    if view:
        found = _plan_in_viewer(robot, loaded, method, seed, effort, budget, output, as_json)
    else:
        with _working(not as_json):
            found = bp.plan(robot, loaded, method=method, seed=seed, effort=effort, budget=budget)
        found.save(output)
        _tell(found, output, as_json)
    if html is not None:
        _write_html(found, html, tell=not as_json)
    return VERIFIED if found.verified else FAILED


@app.command(name="view")
def view_plan(
    plan_file: PlanFile,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write one page that works offline instead.")
    ] = None,
    urdf: PlanUrdf = None,
) -> int:
    """Play a plan in the browser, or write it as one page."""
    if html is not None:
        check_writable(html)
    loaded = bp.load_plan(plan_file, urdf=urdf)
    _tell_driven(loaded)
    if html is not None:
        _write_html(loaded, html)
        return VERIFIED
    from backhoe_planner.show import Viewer

    with Viewer() as viewer:
        _play(viewer, loaded)
    return VERIFIED


@app.command()
def check(plan_file: PlanFile, urdf: PlanUrdf = None) -> int:
    """Compute the certificate of a plan anew."""
    begun = clock.monotonic()
    loaded = bp.load_plan(plan_file, urdf=urdf)
    certificate = loaded.certificate
    if certificate.verified:
        _out.print(Text("verified", style="bold green"))
    else:
        _out.print(Text("not verified", style="bold red"))
        for problem in certificate.problems:
            _out.print(f"  {problem}")
    table = Table("obstacle", "link", "distance [m]", "margin [m]", "at [s]", box=None, pad_edge=False)
    for row in certificate.clearances:
        table.add_row(row.name, row.link, f">= {row.distance:.4f}", f"{row.margin:+.4f}", f"{row.time:.2f}")
    if certificate.clearances:
        _out.print(table)
    for kind in ("position", "velocity", "acceleration"):
        use = getattr(certificate, kind)
        _out.print(f"{kind:<13}{100.0 * use.ratio:5.1f} % of its limit at most ({use.joint}, {use.time:.2f} s)")
    for kind, load in (("torque", certificate.effort), ("hydraulics", certificate.hydraulics)):
        if load is not None:
            where = " ".join(part for part in (load.kind, load.joint) if part and part != kind)
            _out.print(f"{kind:<13}{100.0 * load.ratio:5.1f} % of its limit at most ({where}, {load.time:.2f} s)")
    if not _tell_driven(loaded):
        _out.print(f"{'tip error':<13}{1e3 * certificate.tracking.max_error:.3f} mm at most")
    speed = certificate.tip_speed
    if speed is not None:
        _out.print(
            f"{'tip speed':<13}{100.0 * speed.ratio:5.1f} % of the asked {speed.available:g} m/s at most "
            f"({speed.time:.2f} s)"
        )
    _tell_all_zones(loaded)
    _out.print(f"{'checked in':<13}{clock.monotonic() - begun:.2f} s")
    return VERIFIED if certificate.verified else FAILED


@app.command()
def inspect(
    urdf: Urdf,
    tip: Annotated[str | None, typer.Option(metavar="LINK", help="The link that is moved.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the working envelope.")] = None,
) -> int:
    """Show joints, limits, frames, Denavit-Hartenberg table, working envelope and cylinders."""
    if plot is not None:
        check_writable(plot)
    robot = bp.load_robot(urdf, tip=tip)
    _tell_joints(robot)
    _tell_dh(robot)
    _tell_envelope(robot)
    _tell_hydraulics(robot)
    if plot is not None:
        from backhoe_planner.show import plot_envelope

        plot_envelope(robot, plot)
        _out.print(f"\nwrote {plot}")
    return VERIFIED


@app.command(name="plot")
def plot_command(
    plan_file: PlanFile,
    file: Annotated[Path, typer.Argument(metavar="FILE", help=".png, .svg or .pdf", show_default=False)],
    urdf: PlanUrdf = None,
) -> int:
    """Plot joints, rates, clearances, power and energy of a plan over time."""
    from backhoe_planner.show import plot_plan

    check_writable(file)
    plot_plan(bp.load_plan(plan_file, urdf=urdf), file)
    _out.print(f"wrote {file}")
    return VERIFIED


@app.command()
def export(
    plan_file: PlanFile,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help=".csv, .npz, or .yaml (ROS 2 JointTrajectory)", show_default=False)
    ],
    urdf: PlanUrdf = None,
) -> int:
    """Write a plan's motion for other tools."""
    from backhoe_planner.planning import export_plan

    check_writable(file)
    export_plan(bp.load_plan(plan_file, urdf=urdf), file)
    _out.print(f"wrote {file}")
    return VERIFIED


@app.command()
def teleop(
    urdf: Urdf,
    scene: SceneFile,
    host: Annotated[
        str, typer.Option(metavar="H", help="Address to listen on; by default only this computer can connect.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(metavar="N", min=0, max=65535, help="By default the first free one from 7000 on.")
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Plan file to which a recording is written.")
    ] = Path("teleop.json"),
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open the page.")] = False,
) -> int:
    """Drive the machine live from a page in the browser; the scene's task is not used."""
    check_writable(output)
    loaded = bp.load_scene(scene)
    robot = bp.load_robot(urdf, tip=loaded.tip)
    from backhoe_planner.show import TeleopStation

    with TeleopStation(robot, loaded, host=host, port=port, output=output) as station:
        _warn(station.warnings)
        _err.print(f"open {station.url} in a browser to drive (Ctrl-C ends)")
        if not no_browser:
            webbrowser.open(station.url)
        while station.running:
            clock.sleep(0.1)
        if station.failure:
            _err.print(Text("error: ", style="bold red") + Text(station.failure))
    return FAILED


@app.command()
def schema() -> int:
    """Print the scene file's JSON Schema."""
    sys.stdout.write(json.dumps(bp.scene_schema(), indent=2) + "\n")
    return VERIFIED


def _same_file(a: Path, b: Path) -> bool:
    return b.exists() and a.samefile(b)


# --- planning and viewing ---------------------------------------------------------


@contextlib.contextmanager
def _working(shown: bool) -> Iterator[None]:
    if shown and _err.is_terminal:
        with _err.status("planning ..."):
            yield
    else:
        yield


def _plan_in_viewer(
    robot: bp.Robot, scene: bp.Scene, method: str, seed: int, effort: str, budget: float, output: Path, as_json: bool
) -> Plan:
    from backhoe_planner.motion import build_problem
    from backhoe_planner.show import Viewer

    with Viewer() as viewer:
        _warn(viewer.show_problem(build_problem(robot, scene)))
        _announce(viewer)
        found = bp.plan(
            robot, scene, method=method, seed=seed, effort=effort, budget=budget,
            watch=lambda step: viewer.show_step(step.q, step.time),
        )  # fmt: skip
        found.save(output)
        _tell(found, output, as_json)
        _play(viewer, found, announced=True)
    return found


def _announce(viewer: Any) -> None:
    _err.print(f"open {viewer.url} in a browser (Ctrl-C ends)")
    viewer.wait_for_browser()


def _play(viewer: Any, found: Plan, *, announced: bool = False) -> None:
    """Show a plan until Ctrl-C."""
    _warn(viewer.play(found))
    if not announced:
        _announce(viewer)
    _err.print("playing; the panel in the page has speed and position; Ctrl-C ends")
    with contextlib.suppress(KeyboardInterrupt):
        while viewer.alive():
            clock.sleep(0.2)


def _write_html(found: Plan, html: Path, *, tell: bool = True) -> None:
    from backhoe_planner.show import write_page

    _warn(write_page(found, html))
    if tell:
        _out.print(f"page          {html}")


def _warn(warnings: Iterable[str]) -> None:
    for warning in dict.fromkeys(warnings):
        _err.print(f"warning: {warning}")


# --- telling ----------------------------------------------------------------------


def _tell(found: Plan, output: Path, as_json: bool) -> None:
    if as_json:
        from backhoe_planner.planning import plan_to_dict

        content = plan_to_dict(found)
        content["trajectory"] = {"samples": len(found.trajectory), "file": str(output)}
        sys.stdout.write(json.dumps(content, allow_nan=False, indent=2) + "\n")
        return
    _out.print(_verdict(found))
    if found.message:
        _out.print(f"  {found.message}")
    certificate = found.certificate
    tightest = certificate.min_clearance
    if tightest is not None:
        _out.print(
            f"clearance     {tightest.distance:.3f} m at least between {tightest.link} "
            f"and {tightest.name} (margin {tightest.margin:+.3f} m, at {tightest.time:.2f} s)"
        )
    tracking = certificate.tracking
    if len(found.trajectory) < 2:
        _out.print(f"planned in    {found.metrics.planning_time:.2f} s")
        _out.print(f"plan          {output}")
        return
    angle = f", {_DEGREES * tracking.max_angle_error:.2f} deg" if _asks_angle(found) else ""
    _out.print(f"tip error     {1e3 * tracking.max_error:.2f} mm{angle} at most")
    for detour in found.metrics.detours:
        _out.print(
            f"detour        leaves the path at {detour.path_from:.2f} m, back at {detour.path_to:.2f} m: "
            f"{detour.length:.2f} m long, up to {detour.max_deviation:.3f} m off{_around(detour)}"
        )
    if found.findings.waits > 0.0:
        _out.print(f"waits         {found.findings.waits:.2f} s for what moves to pass")
    for reaction in found.findings.reactions:
        stopped = f", stopped at {reaction.stopped_at:.2f} s" if reaction.stopped_at is not None else ""
        _out.print(
            f"reaction      {reaction.obstacle} appears at {reaction.appears_at:.2f} s: "
            f"{reaction.way or 'no way to stop in time'}{stopped}"
        )
    _tell_zones(found)
    metrics = found.metrics
    _out.print(f"duration      {metrics.duration:.2f} s ({len(found.trajectory)} samples)")
    _out.print(f"work          {_quantity(metrics.energy['work'], 'J')} ({_loads(found)})")
    _tell_saving(metrics.objective)
    _tell_speed(metrics.asked_speed)
    _out.print(f"planned in    {metrics.planning_time:.2f} s")
    _out.print(f"plan          {output}")


def _around(detour: Detour) -> str:
    """What a detour goes round, where the planner says so."""
    found = detour.obstruction
    if found is None:
        return ""
    return f", for {found.name}" if found.kind == "joint" else f", around {found.name}"


def _loads(found: Plan) -> str:
    loads = ["gravity", "inertia"]
    loads += ["payload"] if found.scene.payload > 0.0 else []
    loads += ["soil"] if found.scene.soil is not None else []
    return f"{', '.join(loads[:-1])} and {loads[-1]}"


def _tell_saving(compared: LawComparison | None) -> None:
    """The objective along the path, and what the local law needs."""
    if compared is None:
        return
    from backhoe_planner.motion import OBJECTIVES

    unit = OBJECTIVES[compared.name].unit
    line = f"{compared.name} {_quantity(compared.value, unit)} along the path"
    if compared.law is not None:
        line += f"; the local law {_quantity(compared.law, unit)}"
        if compared.saving_percent is not None:
            line += f" (saves {compared.saving_percent:.0f} %)"
        if compared.law_breaks is not None:
            line += f", and it breaks {compared.law_breaks}"
    elif compared.law_breaks is not None:
        line += f"; the local law does not get along it: {compared.law_breaks}"
    _out.print(f"objective     {line}")
    if compared.whole > compared.value * (1.0 + 1e-3):
        line = f"{_quantity(compared.whole, unit)} with the approach to it"
        if compared.law_whole is not None and compared.saving_percent_whole is not None:
            line += f"; the local law after the same approach {_quantity(compared.law_whole, unit)}"
            line += f" (saves {compared.saving_percent_whole:.0f} %)"
        _out.print(f"              {line}")


def _tell_speed(kept: AskedSpeed | None) -> None:
    """On how much of the path the asked speed is kept, and which limit is in the way elsewhere."""
    if kept is None:
        return
    line = f"{kept.asked:g} m/s kept on {kept.kept_percent:.0f} % of the path"
    if kept.slower:
        parts = [f"{part.path_from:.2f} to {part.path_to:.2f} m ({part.limit})" for part in kept.slower[:_MOST_PARTS]]
        more = f" and {len(kept.slower) - _MOST_PARTS} more" if len(kept.slower) > _MOST_PARTS else ""
        line += f"; slower from {', '.join(parts)}{more}"
    _out.print(f"asked speed   {line}")


def _quantity(value: float, unit: str) -> str:
    """A number of four digits with its unit: 11.39 kJ, 1357 (kN m)^2 s."""
    if unit == "N^2 m^2 s" and abs(value) >= 1e4:
        value, unit = 1e-6 * value, "(kN m)^2 s"
    elif unit.startswith("J"):
        for prefix, factor in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
            if abs(value) >= factor:
                return f"{value / factor:.4g} {prefix}{unit}"
    return f"{value:.4g} {unit}" if abs(value) < 1e4 else f"{value:,.0f} {unit}"


def _tell_all_zones(found: Plan) -> None:
    """A table of every visit to a zone, if there is any, the innermost distances first."""
    from backhoe_planner.site import worst_first

    visits = worst_first(bp.zone_log(found.robot, found.scene, found.trajectory))
    if not visits:
        return
    _out.print("zones that were come too near to")
    table = Table("zone", "distance", "link", "beyond it", "at [s]", "from [s]", "to [s]", box=None, pad_edge=False)
    for visit in visits:
        unit = "rad" if visit.kind == "swing_sector" else "m"
        moments = (f"{moment:.2f}" for moment in (visit.time, visit.begin, visit.end))
        table.add_row(visit.zone, visit.level, visit.link, f"{visit.depth:.3f} {unit}", *moments)
    _out.print(table)


def _tell_zones(found: Plan) -> None:
    """One line about the zones that were come too near to, if any."""
    from backhoe_planner.site import worst_first

    visits = worst_first(bp.zone_log(found.robot, found.scene, found.trajectory))
    if visits:
        more = f" (and {len(visits) - 1} more)" if len(visits) > 1 else ""
        _out.print(f"{'zones':<13} {visits[0]}{more}")


def _tell_driven(found: Plan) -> bool:
    """Of a plan that was driven by hand say so, and what it leaves out; whether it is one."""
    from backhoe_planner.live import is_recording, unrecorded_changes

    if not is_recording(found):
        return False
    _out.print(f"{'recording':<13} driven by hand, {found.trajectory.duration:.2f} s")
    for note in unrecorded_changes(found):
        _out.print(f"{'left out':<13} {note}")
    return True


def _asks_angle(found: Plan) -> bool:
    task = found.scene.task
    poses = [task.goal] if task.goal is not None else found.scene.waypoints()
    return any(pose.pitch is not None or pose.rotation is not None for pose in poses if pose is not None)


def _verdict(found: Plan) -> Text:
    if found.verified:
        return Text("verified", style="bold green")
    return Text(f"failed: {found.reason}", style="bold red")


def _tell_joints(robot: bp.Robot) -> None:
    limits = robot.limits
    _out.print(f"{robot.name}: {robot.n} joints move {robot.tip}; {len(robot.pieces)} collision pieces\n")
    table = Table("joint", "lower", "upper", "rate", "acceleration", "effort", box=None, pad_edge=False)
    for j, name in enumerate(robot.joint_names):
        slides = bool(robot.prismatic[j])
        unit, scale = ("m", 1.0) if slides else ("deg", _DEGREES)
        table.add_row(
            name,
            f"{scale * limits.lower[j]:.1f} {unit}",
            f"{scale * limits.upper[j]:.1f} {unit}",
            f"{limits.velocity[j]:.3g} {'m' if slides else 'rad'}/s",
            f"{limits.acceleration[j]:.3g} {'m' if slides else 'rad'}/s2",
            f"{limits.effort[j]:,.0f} {'N' if slides else 'N m'}",
        )
    _out.print(table)
    _out.print(f"\nlinks         {', '.join(robot.all_link_names)}")


def _tell_dh(robot: bp.Robot) -> None:
    from backhoe_planner.machine import dh_table

    table = Table("joint", "theta [deg]", "d [m]", "a [m]", "alpha [deg]", box=None, pad_edge=False)
    for row in dh_table(robot).rows:
        theta, d = f"{_DEGREES * row.theta:.2f}", f"{row.d + 0.0:.4f}"
        table.add_row(
            row.joint,
            theta if row.prismatic else f"q + {theta}",
            f"q + {d}" if row.prismatic else d,
            f"{row.a + 0.0:.4f}",
            f"{_DEGREES * row.alpha:.2f}",
        )
    _out.print("\nDenavit-Hartenberg (classic)")
    _out.print(table)


def _tell_envelope(robot: bp.Robot) -> None:
    from backhoe_planner.machine import working_envelope

    envelope = working_envelope(robot)
    if envelope is None:
        return
    rows = [
        ("digging depth", envelope.digging_depth, "m"),
        ("reach at ground level", envelope.reach_at_ground, "m from the swing axis"),
        ("largest reach", envelope.largest_reach, "m"),
        ("loading height", envelope.loading_height, "m, bucket tipped to -80 deg"),
        ("loading reach", envelope.loading_reach, "m"),
        ("greatest height of the teeth", envelope.largest_height, "m"),
        ("bucket rotation", _DEGREES * envelope.bucket_rotation, "deg"),
        ("swing arc", None if envelope.swing_arc is None else _DEGREES * envelope.swing_arc, "deg"),
    ]
    _out.print("\nworking envelope")
    for name, value, unit in rows:
        if value is not None:
            _out.print(f"  {name:<28}{value:.2f} {unit}")


def _tell_hydraulics(robot: bp.Robot) -> None:
    from backhoe_planner.machine import digging_forces

    hydraulics = robot.hydraulics
    if hydraulics is None:
        return
    table = Table(
        "cylinder", "joint", "length [m]", "joint range [deg]", "push [kN]", "pull [kN]", box=None, pad_edge=False
    )
    forces = hydraulics.force_limits
    for i, cylinder in enumerate(hydraulics.cylinders):
        lower, upper = hydraulics.joint_ranges[i]
        table.add_row(
            cylinder.name,
            cylinder.joint,
            f"{cylinder.closed:.3f} to {cylinder.open:.3f}",
            f"{_DEGREES * lower:.1f} to {_DEGREES * upper:.1f}",
            f"{1e-3 * forces.positive[i]:.1f}",
            f"{1e-3 * forces.negative[i]:.1f}",
        )
    _out.print("\nhydraulics")
    _out.print(table)
    _out.print(
        f"  pump {6e4 * hydraulics.pump_flow:.0f} l/min at {1e-5 * hydraulics.pressure:.0f} bar, "
        f"{1e-3 * hydraulics.power_limit:.1f} kW from the engine"
    )
    digging = digging_forces(robot)
    if digging is not None:
        _out.print(
            f"  digging force at the teeth  bucket {1e-3 * digging.bucket:.1f} kN, stick {1e-3 * digging.stick:.1f} kN"
        )
