"""The facts about a plan that the page lists."""

from __future__ import annotations

import numpy as np

from backhoe_planner.digits import left_text, margin_text
from backhoe_planner.live import is_recording, unrecorded_changes
from backhoe_planner.motion import OBJECTIVES
from backhoe_planner.planning import (
    Plan,
    PlannedLeg,
    Reaction,
    angle_error,
    describe_excess,
    describe_least_cost,
    describe_quantity,
    describe_saving,
    goal_tolerance,
    has_tip_error,
)
from backhoe_planner.proof import KeepUse


def plan_facts(plan: Plan) -> list[tuple[str, str, str]]:
    """The facts about a plan that the page lists: name, value and remark of each."""
    certificate, metrics = plan.certificate, plan.metrics
    facts = []
    for name, tightest in (
        ("Tightest margin", certificate.obstacle_clearance),
        ("Margin to itself", certificate.self_clearance),
    ):
        if tightest is not None:
            required = tightest.distance - tightest.margin
            leg = certificate.leg_of(tightest)
            remark = f"{tightest.link} to {tightest.obstacle} at {tightest.time:.1f} s{f', leg {leg}' * bool(leg)}; "
            remark += f"{_metres(tightest.distance)} m apart" + (f", {required:.2f} m required" * (required > 1e-9))
            facts.append((name, f"{_metres(tightest.margin)} m", remark))
    least = "least over the whole motion, proven; " if plan.has_motion else ""
    facts += [(f"Kept: {use.name}", f"{_left(use)} left", f"{least}{use.words}") for use in certificate.keep]
    if not plan.has_motion:
        seen = "at the start" if plan.problem.start_q is not None else "that came nearest"
        facts.append(("Motion", "none", f"the picture shows the posture {seen}"))
        facts.append(("Planned in", f"{metrics.planning_time:.2f} s", plan.settings))
        return facts
    if certificate.goal is not None and len(plan.problem.goals) > 1:
        facts.append(("Goal reached", f"{certificate.goal} of {len(plan.problem.goals)}", ""))
    tracking = certificate.tracking
    if plan.failure and plan.problem.path is not None:
        got = f"{tracking.followed:.2f} m of {tracking.path_length:.2f} m"
        facts.append(("Followed", got, "of the path, before the motion ends"))
    elif plan.failure and plan.problem.goals and not is_recording(plan):
        ends, remark = f"{_length(tracking.max_error)} off", "before the goal; the picture shows it"
        if certificate.goal is not None:
            ends, remark = "at the goal", ""
        facts.append(("Motion ends", ends, remark))
    mean = "" if plan.scene.task.path is None else f"mean {_length(tracking.mean_error)}"
    if not is_recording(plan) and not (plan.failure and plan.problem.goals) and has_tip_error(plan):
        turned = angle_error(plan)
        angle = "" if turned is None else f", {np.degrees(turned):.2f}\N{DEGREE SIGN}"
        tolerance = goal_tolerance(plan)
        remark = mean if tolerance is None else f"the goal allows {_length(tolerance)}"
        facts.append(("Tip error", f"{_length(tracking.max_error)}{angle}", remark))
    if certificate.detours:
        longest = max(detour.max_deviation for detour in certificate.detours)
        facts.append(("Detours", f"{len(certificate.detours)}", f"up to {_length(longest)} off the path"))
    facts += [_leg_fact(leg) for leg in plan.legs]
    facts += [_reaction_fact(reaction) for reaction in plan.findings.reactions]
    if plan.findings.waits > 0.0:
        facts.append(("Waits", f"{plan.findings.waits:.2f} s", "until moving obstacles have passed"))
    facts.append(("Duration", f"{plan.trajectory.duration:.2f} s", _about_duration(plan)))
    facts += _costs(plan)
    if is_recording(plan):
        facts.append(("Recording", "driven by hand", "; ".join(unrecorded_changes(plan))))
    else:
        words = "; ".join(filter(None, (plan.settings, plan.advice)))
        facts.append(("Planned in", f"{metrics.planning_time:.2f} s", words))
    return facts


def _leg_fact(leg: PlannedLeg) -> tuple[str, str, str]:
    """Duration, cost, what its search found, and tightest margin of one leg of a sequence."""
    words = [word for word in (leg.cost, leg.saving, leg.allowed_time) if word]
    tightest = leg.certificate.obstacle_clearance or leg.certificate.self_clearance
    if tightest is not None:
        words.append(f"{_metres(tightest.margin)} m left between {tightest.link} and {tightest.name}")
    words += [] if leg.problem.robot.carried is None else [f"carries {leg.problem.robot.carried[0]}"]
    words += [] if leg.certificate.verified else ["not verified"]
    return f"Leg: {leg.name}", f"{leg.metrics.duration:.2f} s", "; ".join(words)


def _reaction_fact(reaction: Reaction) -> tuple[str, str, str]:
    """How the motion goes on when an obstacle appears in its way."""
    return f"Reaction: {reaction.obstacle}", f"{reaction.appears_at:.2f} s", f"appears; {reaction.reply}"


def _about_duration(plan: Plan) -> str:
    """Whether the duration is the objective, which duration was allowed, and the excess over the least possible."""
    words = ["the objective"] if plan.minimised == "time" else []
    words += [plan.allowed_time] if plan.allowed_time else []
    if plan.bound is not None:
        longer = f": {plan.excess}" if plan.excess else ""
        words.append(f"no motion can take less than {plan.bound.duration:.2f} s{longer}")
    return "; ".join(words)


def _costs(plan: Plan) -> list[tuple[str, str, str]]:
    """The work, and the objective if it is something else, with the proven lower bound."""
    facts, metrics, minimised = [], plan.metrics, plan.minimised
    work, cost, compared = metrics.energy.get("work"), metrics.cost, metrics.objective
    least = None
    if cost is not None and minimised and plan.bound is not None:
        least = plan.bound.least_energy(minimised)
    needed = ""
    if cost is not None and least is not None:
        needed = describe_least_cost(minimised, least, cost.unit)
        needed += f": this one takes {describe_excess(cost.value, least)}"
    objective = [word for word in ("the objective", plan.saving, needed) if word]
    if work is not None:
        facts.append(("Work", describe_quantity(work, "J"), "; ".join(objective if minimised == "work" else [])))
    if "hydraulic" in metrics.energy:
        words = ["what the pump gives", *(objective if minimised == "hydraulic" else [])]
        facts.append(("Hydraulic", describe_quantity(metrics.energy["hydraulic"], "J"), "; ".join(words)))
    if cost is not None and minimised not in ("", "time", "work", "hydraulic"):
        remark = "; ".join(filter(None, (plan.saving, needed)))
        facts.append(("Objective", f"{minimised} {describe_quantity(cost.value, cost.unit)}", remark))
    if compared is not None:
        unit = OBJECTIVES[compared.name].unit
        law = ""
        if compared.law is not None and compared.saving_percent is not None:
            saving = describe_saving(compared.saving_percent)
            law = f"; the local law {describe_quantity(compared.law, unit)}, this one takes {saving}"
        value = f"{compared.name} {describe_quantity(compared.value, unit)}"
        facts.append(("Objective", value, f"along the path{law}"))
    return facts


def _left(use: KeepUse) -> str:
    """The remaining margin of a condition, with its unit."""
    if use.unit == "rad":
        return f"{_minus(left_text(float(np.degrees(use.left)), '.2f'))}°"
    return f"{_minus(left_text(use.left, '.3f'))} m"


def _metres(value: float) -> str:
    return _minus(margin_text(value, ".3f"))


def _minus(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}")


def _length(value: float) -> str:
    return f"{1000.0 * value:.1f} mm" if value < 0.1 else f"{value:.2f} m"
