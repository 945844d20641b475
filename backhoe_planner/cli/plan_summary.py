"""The printed summary of a plan, and its certificate."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import backhoe_planner as bp
from backhoe_planner import live, machine, motion, planning, proof, site
from backhoe_planner.cli.terminal import DEGREES, OUT, print_verdict, table_of
from backhoe_planner.digits import left_text, margin_text

_SAME_PLACE = 0.005  # m of path between the ends of a detour, below which it comes back at the same place
_SAME_POSTURE = 0.1  # rad or m between the joints at the ends of a detour, at most; chosen
_MOST_PARTS = 3  # parts of a path that are listed one by one: chosen to fit into a line or two


def print_plan(found: bp.Plan, output: Path, as_json: bool) -> None:
    """Print the result of planning as a summary, or as JSON.

    Parameters
    ----------
    found: the plan.
    output: the file to which it was written.
    as_json: whether to print JSON.
    """
    if as_json:
        content = planning.plan_to_dict(found)
        content["trajectory"] = {"samples": len(found.trajectory), "file": str(output)}
        sys.stdout.write(json.dumps(content, allow_nan=False, indent=2) + "\n")
        return
    print_verdict("" if found.verified else f"failed: {found.reason}")
    if found.message:
        OUT.print(f"  {found.message}")
    metrics = found.metrics
    moves = found.has_motion
    # if there is no motion and the start is not given by joints, the plan only has the posture that came nearest
    if moves or found.problem.start_q is not None:
        _print_clearances(found.certificate, moves=moves)
    _print_tracking_error(found)
    if moves:  # a machine already at its goal has a motion of 0 s
        _print_motion(found)
    _print_legs(found, with_search=True)
    OUT.print(f"planned in    {metrics.planning_time:.2f} s ({found.settings})")
    if found.advice:
        OUT.print(f"              {found.advice}")
    OUT.print(f"plan          {output}")


def _print_clearances(certificate: bp.Certificate, *, moves: bool) -> None:
    """Print the tightest spots to an obstacle and of the machine to itself; `moves` says whether there is a motion."""
    label = "clearance"
    for tightest in filter(None, (certificate.obstacle_clearance, certificate.self_clearance)):
        least, when = "where it starts,", "without a motion"
        if moves:
            least, when = "at least", f"at {tightest.time:.2f} s{_of_leg(certificate.leg_of(tightest))}"
        OUT.print(
            f"{label:<13} {tightest.distance:.3f} m {least} between {tightest.link} "
            f"and {tightest.name} (margin {margin_text(tightest.margin)} m, {when})"
        )
        label = ""


def _print_legs(found: bp.Plan, *, with_search: bool) -> None:
    """Print a line for each leg of a sequence: duration, cost, tightest margin; nothing if there are no legs.

    With the search, a second line says how long the leg was allowed to take, and what it saves.
    """
    width = max((len(leg.name) for leg in found.legs), default=0)
    for leg in found.legs:
        tightest = leg.certificate.obstacle_clearance or leg.certificate.self_clearance
        near = ""
        if tightest is not None:
            near = f", margin {margin_text(tightest.margin)} m ({tightest.link}, {tightest.name})"
        cost = f", {leg.cost}" if leg.cost else ""
        wrong = "" if leg.certificate.verified else ", not verified"
        tracking = leg.certificate.tracking
        error = f", tip error {1e3 * tracking.max_error:.2f} mm" if tracking.done else ""
        load = leg.problem.robot.carried
        carried = "" if load is None else f", carries {load[0]}"
        OUT.print(
            f"leg           {leg.name:<{width}}  {leg.metrics.duration:6.2f} s{cost}{near}{error}{carried}{wrong}"
        )
        searched = "; ".join(filter(None, (leg.allowed_time, leg.saving)))
        if searched and with_search:
            OUT.print(f"{'':<14}{'':<{width}}  {searched}")


def _of_leg(name: str) -> str:
    """The leg to which a row belongs, for the end of its words; empty without a sequence."""
    return f", leg {name}" if name else ""


def _print_tracking_error(found: bp.Plan) -> None:
    """Print the tip's tracking error, and how much of the clearance it uses; nothing if the machine is exact."""
    tightest, tube = found.certificate.min_clearance, found.problem.robot.tube
    if tube is not None:
        taken = 0.0 if tightest is None else tightest.tracking
        OUT.print(
            f"tracking      the tip may be off by {machine.tip_tracking_error(found.problem.robot):.3f} m; "
            f"of the clearance that takes {taken:.3f} m"
        )


def _print_goal(found: bp.Plan) -> None:
    """Print which of several goals is reached; nothing if there is only one, a path, or no motion."""
    goals, number = found.problem.goals, found.certificate.goal
    if found.has_motion and len(goals) > 1 and number is not None:
        OUT.print(f"goal          {number} of {len(goals)} is reached")


def _print_keep(found: bp.Plan) -> None:
    """Print the margin left of every condition to be kept; nothing if there is none."""
    for use in found.certificate.keep:
        turns = use.unit == "rad"
        figures = f"{left_text(DEGREES * use.left, '+.2f')} deg" if turns else f"{left_text(use.left)} m"
        OUT.print(f"keep          {use.name}: {figures} left at least (at {use.time:.2f} s{_of_leg(use.leg)})")


def _print_reactions(found: bp.Plan) -> None:
    """Print how the motion reacts to every obstacle that appears in its way; nothing if none does."""
    for reaction in found.findings.reactions:
        OUT.print(f"reaction      {reaction.words}")


def _print_motion(found: bp.Plan) -> None:
    metrics, tracking = found.metrics, found.certificate.tracking
    _print_goal(found)
    _print_keep(found)
    if planning.has_tip_error(found):
        OUT.print(f"tip error     {1e3 * tracking.max_error:.2f} mm{_angle_error(found)} at most{_tolerated(found)}")
    _print_reactions(found)
    for detour in metrics.detours:
        where = f"leaves the path at {detour.path_from:.2f} m, back {_back_at(found.trajectory, detour)}"
        OUT.print(f"detour        {where}: {detour.length:.2f} m long, {detour.size}{_around(detour)}")
    if found.findings.waits > 0.0:
        OUT.print(f"waits         {found.findings.waits:.2f} s until moving obstacles have passed")
    visits = site.worst_first(bp.zone_log(found.robot, found.scene, found.trajectory))
    if visits:
        more = f" (and {len(visits) - 1} more)" if len(visits) > 1 else ""
        OUT.print(f"zones         {visits[0]}{more}")
    count = len(found.trajectory)
    samples = "the machine already stands there" if count == 1 else f"{count} samples"
    allowed = f", {found.allowed_time}" if found.allowed_time else ""
    OUT.print(f"duration      {metrics.duration:.2f} s ({samples}){_minimised(found, 'time')}{allowed}")
    _print_bound(found)
    work = f"{planning.describe_quantity(metrics.energy['work'], 'J')} ({_loads(found)})"
    OUT.print(f"work          {work}{_minimised(found, 'work')}")
    if "hydraulic" in metrics.energy:
        pump = f"{planning.describe_quantity(metrics.energy['hydraulic'], 'J')} (what the pump gives)"
        OUT.print(f"hydraulic     {pump}{_minimised(found, 'hydraulic')}")
    _print_cost(found)
    if found.saving:
        OUT.print(f"saving        {found.saving}")
    _print_comparison(metrics.objective)
    _print_asked_speed(metrics.asked_speed)


def print_certificate(plan: bp.Plan) -> None:
    """Print what is proven about a plan, row by row."""
    certificate, moves = plan.certificate, plan.has_motion
    print_verdict("" if certificate.verified else f"not verified: {plan.reason}")
    if not certificate.verified:
        if plan.failure and plan.note:
            OUT.print(f"  {plan.note}")
        if plan.failure and not moves:
            OUT.print("  there is no motion: what follows is of one configuration, at rest")
        for problem in certificate.problems if moves or not plan.failure else ():
            if not plan.failure or problem not in plan.note:  # what the planner said need not be said again
                OUT.print(f"  {problem}")
    if not live.is_recording(plan):
        OUT.print(f"{'planned with':<13}{plan.settings}")
    _print_clearance_table(certificate)
    for name in get_args(proof.MachineLimit):
        use = certificate.uses.get(name)
        if use is not None:
            kind = "torque" if name == "effort" else name
            where = " ".join(part for part in (use.kind, use.joint) if part and part != kind)
            limit = "the way from the middle of its range to an end" if name == "position" else "its limit"
            most = f"{100.0 * use.most:.0f}"  # 100 where only rounding may exceed it
            kept = f"; up to {most} % is kept" if use.ratio > 1.0 and most != "100" else ""
            when = f"{use.time:.2f} s{_of_leg(use.leg)}"
            OUT.print(f"{kind:<13}{use.percent:>5} % of {limit} at most ({where}, {when}{kept})")
    _print_legs(plan, with_search=False)
    _print_reactions(plan)
    print_recording(plan)
    if not live.is_recording(plan):
        _print_tracking_error(plan)
        _print_goal(plan)
        _print_keep(plan)
        if moves and planning.has_tip_error(plan):
            error = f"{1e3 * certificate.tracking.max_error:.3f} mm{_angle_error(plan)}"
            OUT.print(f"{'tip error':<13}{error} at most{_tolerated(plan)}")
        _print_left_out(certificate.tracking)
    speed = certificate.tip_speed
    if speed is not None:
        OUT.print(
            f"{'tip speed':<13}{speed.percent:>5} % of the asked {speed.available:g} m/s at most "
            f"({speed.time:.2f} s{_of_leg(speed.leg)})"
        )
    if certificate.duration is not None:
        use = certificate.duration
        OUT.print(f"{'duration':<13}{use.percent:>5} % of max_duration ({use.available:g} s{_of_leg(use.leg)})")
    _print_zone_table(site.worst_first(bp.zone_log(plan.robot, plan.scene, plan.trajectory)))


def _print_clearance_table(certificate: bp.Certificate) -> None:
    """Print the tightest spot to each obstacle, those to the machine itself last; for a sequence with the leg."""
    table = table_of("obstacle", "link", "distance [m]", "margin [m]", "at [s]", *["leg"] * bool(certificate.legs))
    for row in sorted(certificate.clearances, key=lambda near: near.kind == "machine"):
        cells = (row.name, row.link, f">= {row.distance:.4f}", margin_text(row.margin, "+.4f"), f"{row.time:.2f}")
        table.add_row(*cells, *[certificate.leg_of(row)] * bool(certificate.legs))
    if certificate.clearances:
        OUT.print(table)


def _print_left_out(tracking: bp.Tracking) -> None:
    """Print how much of a path detours leave out; nothing if there are none."""
    if tracking.detours:
        OUT.print(
            f"{'left out':<13}{tracking.left_out:.2f} m of {tracking.path_length:.2f} m of the path, in "
            f"{len(tracking.detours)} detour{'s' * (len(tracking.detours) > 1)}; it is not proven that the path is "
            "blocked there"
        )


def print_recording(plan: bp.Plan) -> None:
    """Print that a plan was driven by hand, and what it leaves out; nothing for any other plan."""
    if live.is_recording(plan):
        OUT.print(f"recording     driven by hand, {plan.trajectory.duration:.2f} s")
    for note in live.unrecorded_changes(plan):
        OUT.print(f"left out      {note}")


def _back_at(along: bp.Trajectory, detour: bp.Detour) -> str:
    """Where a detour of a motion comes back to the path, in words, and whether the joints stand otherwise there."""
    if detour.path_to - detour.path_from >= _SAME_PLACE:
        return f"at {detour.path_to:.2f} m"
    before, after = (along.at(at).tolist() for at in (detour.time_from, detour.time_to))
    turned = bool(max(abs(b - a) for a, b in zip(before, after, strict=True)) > _SAME_POSTURE)
    return "at the same place" + " in another posture" * turned


def _around(detour: bp.Detour) -> str:
    """What a detour goes around, in words; empty if that is not known."""
    found = detour.obstruction
    return "" if found is None else f", {'for' if found.kind == 'joint' else 'around'} {found.name}"


def _loads(found: bp.Plan) -> str:
    scenes = [found.scene, *(leg.problem.scene for leg in found.legs)]
    present = {
        "payload": any(scene.payload > 0.0 for scene in scenes),
        "soil": any(scene.soil is not None for scene in scenes),
    }
    *first, last = ["gravity", "inertia", *(load for load, acts in present.items() if acts)]
    return f"{', '.join(first)} and {last}"


def _print_bound(found: bp.Plan) -> None:
    """Print the lower bounds for any motion to the goal, and how far above them the plan is; nothing for a path."""
    bound, cost = found.bound, found.metrics.cost
    if bound is not None:
        longer = f" ({found.excess})" if found.excess else ""
        OUT.print(f"bound         no motion can take less than {bound.duration:.2f} s{longer}")
        least = None if cost is None else bound.least_energy(cost.objective)
        if cost is not None and least is None and cost.objective != "time":
            OUT.print(f"              no lower bound above 0 is known for {cost.objective}")
        if cost is not None and least is not None:
            words = planning.describe_least_cost(cost.objective, least, cost.unit)
            OUT.print(f"              {words} (this one takes {planning.describe_excess(cost.value, least)})")


def _minimised(found: bp.Plan, name: str) -> str:
    """End of the line of a figure of the whole motion, if that figure is the objective."""
    return ", the objective" if found.minimised == name else ""


def _print_cost(found: bp.Plan) -> None:
    """Print the objective of the whole motion; nothing if its line is there already, or there is none."""
    cost = found.metrics.cost
    if cost is not None and found.minimised not in ("", "time", "work", "hydraulic"):
        OUT.print(f"objective     {cost.objective} {planning.describe_quantity(cost.value, cost.unit)}")


def _print_comparison(compared: planning.LawComparison | None) -> None:
    """Print the objective along the path, and its value for the local law."""
    if compared is None:
        return
    unit = motion.OBJECTIVES[compared.name].unit
    line = f"{compared.name} {planning.describe_quantity(compared.value, unit)} along the path"
    if compared.law is not None:
        line += f"; the local law {planning.describe_quantity(compared.law, unit)}"
        if compared.saving_percent is not None:
            line += f" (this one takes {planning.describe_saving(compared.saving_percent)})"
        if compared.law_breaks is not None:
            line += f", and it breaks {compared.law_breaks}"
    elif compared.law_breaks is not None:
        line += f"; the local law cannot follow the path: {compared.law_breaks}"
    OUT.print(f"objective     {line}")
    if compared.whole > compared.value * (1.0 + 1e-3):
        line = f"{planning.describe_quantity(compared.whole, unit)} with the approach to it"
        if compared.law_whole is not None and compared.saving_percent_whole is not None:
            line += f"; the local law after the same approach {planning.describe_quantity(compared.law_whole, unit)}"
            line += f" (this one takes {planning.describe_saving(compared.saving_percent_whole)})"
        OUT.print(f"              {line}")


def _print_asked_speed(kept: planning.AskedSpeed | None) -> None:
    """Print on how much of the path the requested speed is kept, and which limit prevents it elsewhere."""
    if kept is None:
        return
    parts = []
    for part in kept.slower[:_MOST_PARTS]:
        ends = list(dict.fromkeys(f"{end:.2f}" for end in (part.path_from, part.path_to)))  # a turn on the spot has one
        parts.append(f"{'from' if len(ends) > 1 else 'at'} {' to '.join(ends)} m ({part.limit})")
    more = f" and {len(kept.slower) - _MOST_PARTS} more" if len(kept.slower) > _MOST_PARTS else ""
    slower = f"; slower {', '.join(parts)}{more}" if parts else ""
    OUT.print(f"asked speed   {kept.asked:g} m/s kept on {kept.kept_percent:.0f} % of the path{slower}")


def _print_zone_table(visits: Sequence[bp.Transgression]) -> None:
    if not visits:
        return
    OUT.print("zones visited")
    table = table_of("zone", "distance", "link", "beyond it", "at [s]", "from [s]", "to [s]")
    for visit in visits:
        moments = (f"{moment:.2f}" for moment in (visit.time, visit.begin, visit.end))
        table.add_row(visit.zone, visit.level, visit.link, f"{visit.depth:.3f} {visit.unit}", *moments)
    OUT.print(table)


def _angle_error(found: bp.Plan) -> str:
    """How far the tip is turned from the required orientation, in words; empty if no angle is required."""
    error = planning.angle_error(found)
    return "" if error is None else f", {DEGREES * error:.2f} deg"


def _tolerated(found: bp.Plan) -> str:
    """The tolerance of the goal that is reached, in words; empty if it has none."""
    tolerance = planning.goal_tolerance(found)
    return "" if tolerance is None else f", the goal allows {1e3 * tolerance:g} mm"
