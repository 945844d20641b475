"""`inspect` and `schema`: what a machine is and can do, and what a file may contain."""

from __future__ import annotations

import json
import math
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

import backhoe_planner as bp
from backhoe_planner import machine, show, site
from backhoe_planner.cli.terminal import DEGREES, OUT, VERIFIED, Urdf, print_warnings, table_of

_SCHEMAS: dict[str, Callable[[], dict[str, Any]]] = {
    "scene": lambda: bp.scene_schema(),  # each loads its part of the package only when called
    "job": lambda: bp.job_schema(),
    "study": lambda: bp.study_schema(),
}
_ASSUMED = " (assumed)"
_WHOLE = 100.0  # N or N m from which efforts are shown without decimals: less would have fewer than three digits


def inspect(
    urdf: Urdf,
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCENE]", help="A scene file, for its tip, held joints, limits and obstacles.", show_default=False
        ),
    ] = None,
    tip: Annotated[
        str | None, typer.Option(metavar="LINK", help="The link that is moved; by default the scene's.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the working envelope.")] = None,
) -> int:
    """Show what a machine is and can do.

    Prints joints, limits, held joints, links, which links may touch, Denavit-Hartenberg table, envelope and
    cylinders; with a scene, also where its obstacles and zones are.
    """
    if plot is not None:
        show.check_figure(plot)
    loaded = None if scene is None else bp.load_scene(scene)
    robot, limits = _machine(urdf, loaded, tip)
    print_warnings(site.input_warnings(robot, loaded, with_task=False))
    _print_joints(robot, limits, loaded)
    _print_held(robot)
    OUT.print(f"\nlinks         {', '.join(robot.all_link_names)}")
    _print_meshes(robot)
    _print_self_collision(robot)
    _print_dh_table(robot.at_origin)
    _print_envelope(robot)
    _print_hydraulics(robot)
    if loaded is not None:
        _print_site(loaded, robot)
    if plot is not None:
        show.plot_envelope(robot.at_origin, plot)
        OUT.print(f"\nwrote {plot}")
    return VERIFIED


def schema(
    kind: Annotated[str, typer.Argument(metavar="KIND", help="Of which file: scene, job or study.")] = "scene",
) -> int:
    """Print the JSON Schema of a scene, job or study file."""
    if kind not in _SCHEMAS:
        raise bp.InputError.unknown_name("there is no schema of such a file", kind, names=_SCHEMAS)
    sys.stdout.write(json.dumps(_SCHEMAS[kind](), indent=2) + "\n")
    return VERIFIED


def _machine(urdf: str, scene: bp.Scene | None, tip: str | None) -> tuple[bp.Robot, bp.JointLimits]:
    """The machine and its limits, within the scene if there is one."""
    if scene is None:
        robot = bp.load_robot(urdf, tip=tip)
        return robot, robot.limits
    if None not in (tip, scene.tip) and tip != scene.tip:
        raise bp.InputError("is not the scene's tip", key="--tip", found=tip, allowed=scene.tip)
    robot = site.machine_on_site(site.load_machine(urdf, scene, tip=tip), scene)
    return robot, site.scaled_limits(robot, scene)


def _print_site(scene: bp.Scene, robot: bp.Robot) -> None:
    """Print where every obstacle and zone is, what it asks for, and how many parts it has."""
    obstacles, sectors = site.build_obstacles(scene, robot), site.swing_sectors(robot, scene).values()
    if not obstacles and not sectors:
        OUT.print("\nsite          no obstacles")
        return
    print_warnings(site.obstacle_warnings(robot, obstacles))
    OUT.print(f"\nsite          a clearance of {scene.clearance:.4g} m, where no other is given")
    table = table_of("obstacle", "shape", "x [m]", "y [m]", "z [m]", "parts")
    for obstacle in obstacles:
        low, high = obstacle.bounds
        spans = [_span(float(a), float(b)) for a, b in zip(low, high, strict=True)]
        shape = obstacle.spec.shape if obstacle.zone is None else f"zone, {obstacle.zone.kind}"
        table.add_row(obstacle.name, shape, *spans, _parts_of(obstacle))
    if obstacles:
        OUT.print(table)
    for obstacle in obstacles:
        if words := _about(obstacle, scene):
            OUT.print(f"  {obstacle.name} {words}")
    error = 0.0 if robot.tube is None else float(robot.tube.joints[0])
    ends = site.range_sources(robot, scene, 0) if sectors else ()
    for zone in sectors:
        off = zone.stop + error
        low, high = DEGREES * (zone.start + off), DEGREES * (zone.end - off)
        words = f"keeps {robot.joint_names[0]} within {low:.1f} to {high:.1f} deg"
        taken = f" ({DEGREES * error:.2g} deg less for the tracking error)" if error else ""
        levels = _levels(zone, DEGREES, "deg")
        idle = "" if zone.name in ends else "; its range is narrower anyway"
        OUT.print(f"  {zone.name} (zone, {zone.kind}) {words}{taken}{idle}; {levels}")


def _about(obstacle: bp.Obstacle, scene: bp.Scene) -> str:
    """What the table does not show of an obstacle: when it appears, where it moves, for which links, its distances.

    Empty for one that stands still from the beginning, with the scene's clearance from all links.
    """
    velocity = obstacle.velocity.tolist()
    parts = [f"appears at {obstacle.appears_at:g} s"] * (obstacle.appears_at > 0.0)
    if obstacle.moves:
        along = ", ".join(_fixed(part, 2) for part in velocity)
        parts.append(f"moves at {math.hypot(*velocity):.2f} m/s, by ({along}) m every second")
    found = [" and ".join(parts)] if parts else []
    if obstacle.zone is not None:
        found.append(_levels(obstacle.zone, 1.0, "m"))
    elif obstacle.clearance != scene.clearance:
        found.append(f"has a clearance of {obstacle.clearance:.4g} m")
    if obstacle.links is not None:
        found.append(f"is only for {', '.join(obstacle.links)}")
    if obstacle.zone is None and obstacle.spec.legs is not None:
        found.append(f"is only there in leg {', '.join(obstacle.spec.legs)}")
    return "; ".join(found)


def _levels(zone: site.ZoneSpec, scale: float, unit: str) -> str:
    """The distances at which a zone warns, slows down and stops, in words; the last alone if all are equal."""
    distances = {"stops": zone.stop, "slows down": zone.slow_distance, "warns": zone.warn_distance}
    shown = [does for does, distance in distances.items() if does == "stops" or distance > zone.stop]
    return ", ".join(f"{does} at {scale * distances[does]:.4g} {unit}" for does in reversed(shown))


def _span(low: float, high: float) -> str:
    if math.isfinite(low) and math.isfinite(high):
        return f"{_fixed(low, 2)}..{_fixed(high, 2)}"
    return (
        f"up to {_fixed(high, 2)}"
        if math.isfinite(high)
        else f"from {_fixed(low, 2)}"
        if math.isfinite(low)
        else "no end"
    )


def _parts_of(obstacle: bp.Obstacle) -> str:
    if obstacle.cluster is None:
        return f"{len(obstacle.pieces)} piece{'s' * (len(obstacle.pieces) != 1)}"
    words = {"pointcloud": "voxels", "heightmap": "cells", "mesh": "triangles"}
    return f"{len(obstacle.cluster):,} {words.get(obstacle.spec.shape, 'cells')}"


def _print_held(robot: bp.Robot) -> None:
    """Print the joints that stand still, at which position, and why."""
    words = {"held": "held by the scene", "beside": "does not move the tip"}
    rows, at_zero = [], []
    for joint in robot.held:
        if joint.why != "held" and joint.position == 0.0:
            at_zero.append(joint.name)
            continue
        slides = robot.urdf.joints[joint.name].type == "prismatic"
        at = f"{joint.position:.4g} m" if slides else f"{DEGREES * joint.position:.1f} deg ({joint.position:.4g} rad)"
        rows.append((joint.name, at, words.get(joint.why, f"copies {joint.copies}")))
    if robot.held:
        OUT.print("\njoints that stand still")
    widths = [max((len(row[column]) for row in rows), default=0) for column in (0, 1)]
    for name, at, why in rows:
        OUT.print(f"  {name:<{widths[0]}}  {at:<{widths[1]}}  {why}")
    if at_zero:
        OUT.print(f"  at 0, since they do not move the tip: {', '.join(at_zero)}")


def _print_joints(robot: bp.Robot, limits: bp.JointLimits, scene: bp.Scene | None) -> None:
    """Print what moves the tip, and the limits; those that neither URDF nor scene gives are marked."""
    OUT.print(f"{robot.name}: {robot.n} joints move {robot.tip}; {len(robot.pieces)} collision pieces")
    if not robot.base.is_origin:
        (x, y), turned = robot.base.position, DEGREES * robot.base.heading
        OUT.print(f"stands at x {x:.4g} m, y {y:.4g} m, turned by {turned:.1f} deg")
    OUT.print()
    given = (set(), set()) if scene is None else (set(scene.limits.velocity), set(scene.limits.acceleration))
    rates, accelerations = set(robot.without_velocity) - given[0], set(robot.without_acceleration) - given[1]
    table = table_of("joint", "lower", "upper", "rate", "acceleration", "effort")
    for j, name in enumerate(robot.joint_names):
        slides = bool(robot.prismatic[j])
        unit, scale = ("m", 1.0) if slides else ("deg", DEGREES)
        speed = "m" if slides else "rad"
        table.add_row(
            name,
            _or_none(scale * limits.lower[j], ".1f", unit),
            _or_none(scale * limits.upper[j], ".1f", unit),
            f"{limits.velocity[j]:.3g} {speed}/s{_ASSUMED * (name in rates)}",
            f"{limits.acceleration[j]:.3g} {speed}/s2{_ASSUMED * (name in accelerations)}",
            _or_none(limits.effort[j], ",.0f" if limits.effort[j] >= _WHOLE else ".3g", "N" if slides else "N m"),
        )
    OUT.print(table)
    if accelerations:
        after = machine.FULL_RATE_AFTER
        OUT.print(f"an assumed acceleration gives the full rate after {after:g} s; URDF or scene can give another")


def _or_none(limit: float, digits: str, unit: str) -> str:
    return f"{limit:{digits}} {unit}" if math.isfinite(limit) else "none"


def _print_meshes(robot: bp.Robot) -> None:
    """Print how many pieces were made of meshes, and how many came from the cache folder."""
    of_meshes = [solid.cached for solid in robot.solids if solid.cached is not None]
    if of_meshes:
        OUT.print(
            f"\nmeshes        {len(of_meshes)} convex pieces, {sum(of_meshes)} of them from {machine.cache_folder()}"
        )


def _print_self_collision(robot: bp.Robot) -> None:
    pairs, pieces = machine.self_pairs(robot), machine.self_pieces(robot)
    kept = {(pieces[outer].link, pieces[inner].link) for outer, inner in pairs.kept}
    touching = {(pair.link, pair.other) for pair in pairs.left_out if pair.touch}
    reasons: defaultdict[str, list[tuple[str, str]]] = defaultdict(list)
    for pair in pairs.left_out:
        if pair.touch or (pair.link, pair.other) not in touching:
            some = " (in part)" if (pair.link, pair.other) in kept else ""
            reasons[pair.why].append((pair.link, pair.other + some))
    OUT.print(f"\nself-collision: {len(kept)} pairs of links must not touch{'; left out are' * bool(reasons)}")
    for why, links in reasons.items():
        by_link: defaultdict[str, list[str]] = defaultdict(list)
        by_other: defaultdict[str, list[str]] = defaultdict(list)
        for link, other in links:
            by_link[link].append(other)
            by_other[other].append(link)
        lines = [f"{link} and {', '.join(others)}" for link, others in by_link.items()]
        if len(by_other) < len(lines):
            lines = [f"{', '.join(outer)} and {other}" for other, outer in by_other.items()]
        for line in lines:
            OUT.print(f"  {line}: {why}")


def _print_dh_table(robot: bp.Robot) -> None:
    table = table_of("joint", "theta [deg]", "d [m]", "a [m]", "alpha [deg]")
    for row in machine.dh_table(robot).rows:
        theta, d = _fixed(DEGREES * row.theta, 2), _fixed(row.d, 4)
        table.add_row(
            row.joint,
            theta if row.prismatic else f"q + {theta}",
            f"q + {d}" if row.prismatic else d,
            _fixed(row.a, 4),
            _fixed(DEGREES * row.alpha, 2),
        )
    OUT.print("\nDenavit-Hartenberg (classic)")
    OUT.print(table)


def _fixed(value: float, places: int) -> str:
    """A number with so many decimals; what rounds to 0 has no sign."""
    return f"{round(value, places) + 0.0:.{places}f}"


def _print_envelope(robot: bp.Robot) -> None:
    envelope = machine.working_envelope(robot)
    if envelope is None:
        return
    rows = [
        ("digging depth", envelope.digging_depth, "m"),
        ("reach at ground level", envelope.reach_at_ground, "m from the swing axis"),
        ("largest reach", envelope.largest_reach, "m"),
        ("loading height", envelope.loading_height, "m, bucket tipped to -80 deg"),
        ("loading reach", envelope.loading_reach, "m"),
        ("greatest height of the teeth", envelope.largest_height, "m"),
        ("bucket rotation", DEGREES * envelope.bucket_rotation, "deg"),
        ("swing arc", None if envelope.swing_arc is None else DEGREES * envelope.swing_arc, "deg"),
    ]
    OUT.print("\nworking envelope")
    for name, value, unit in rows:
        if value is not None:
            OUT.print(f"  {name:<30}{value:.2f} {unit}")


def _print_hydraulics(robot: bp.Robot) -> None:
    hydraulics = robot.hydraulics
    if hydraulics is None:
        return
    table = table_of("cylinder", "joint", "length [m]", "joint range [deg]", "push [kN]", "pull [kN]")
    forces = hydraulics.force_limits
    for i, cylinder in enumerate(hydraulics.cylinders):
        lower, upper = hydraulics.joint_ranges[i]
        table.add_row(
            cylinder.name,
            cylinder.joint,
            f"{cylinder.closed:.3f} to {cylinder.open:.3f}",
            f"{DEGREES * lower:.1f} to {DEGREES * upper:.1f}",
            f"{1e-3 * forces.positive[i]:.1f}",
            f"{1e-3 * forces.negative[i]:.1f}",
        )
    OUT.print("\nhydraulics")
    OUT.print(table)
    OUT.print(
        f"  pump {6e4 * hydraulics.pump_flow:.0f} l/min at {1e-5 * hydraulics.pressure:.0f} bar, "
        f"{1e-3 * hydraulics.power_limit:.1f} kW from the engine"
    )
    digging = machine.digging_forces(robot)
    if digging is not None:
        OUT.print(
            f"  digging force at the teeth  bucket {1e-3 * digging.bucket:.1f} kN, stick {1e-3 * digging.stick:.1f} kN"
        )
