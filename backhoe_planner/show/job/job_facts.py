"""The figures of a job that the page lists."""

from __future__ import annotations

from typing import Any

import numpy as np

from backhoe_planner.digits import margin_text
from backhoe_planner.job import JobPlan, job_figures


def job_facts(plan: JobPlan) -> list[tuple[str, str, str]]:
    """Name, value and remark of each figure."""
    facts = []
    rows = [
        (row.margin, row.name, row.link)
        for cycle in plan.cycles
        for leg in cycle.legs
        for row in leg.certificate.clearances
    ]
    if rows:
        margin, name, link = min(rows)
        facts.append(("Tightest margin", f"{_signed(margin)} m", f"{link} to {name}; proven over all motions"))
    waits = f"and {plan.waits:.0f} s for trucks" if plan.waits else ""
    cycles = len(plan.cycles)
    digging = plan.duration - plan.waits
    mean = f"{digging / cycles:.1f} s a cycle" if cycles else ""
    facts.append(("Duration", _clock(plan.duration), "; ".join(filter(None, (mean, waits)))))
    facts.append(("Cycles", f"{cycles}", f"bucket of {plan.capacity:.2f} m³ heaped"))
    facts.append(("Dug", f"{plan.bank:.2f} m³", f"in the ground; {plan.loose:.2f} m³ loose"))
    if cycles:
        facts.append(("Production", f"{plan.production:.1f} m³/h", "in the ground"))
        facts.append(("Work", f"{plan.work / 1e3:.0f} kJ", f"of the joints; {plan.work / cycles / 1e3:.1f} kJ a cycle"))
        used = job_figures(plan).kwh_per_m3
        facts.append(("Energy", f"{used:.3f} kWh/m³", _whence(plan)))
    facts.append(
        (
            "Design",
            f"{_centimetres(plan.over)} above",
            f"at most, wherever it may be dug; {_centimetres(plan.under)} below",
        )
    )
    if np.isfinite(plan.planning_time):
        facts.append(("Planned in", f"{plan.planning_time:.1f} s", f"effort {plan.effort}, seed {plan.seed}"))
    return facts


def _whence(plan: JobPlan) -> str:
    if plan.robot.hydraulics is None:
        return "in the ground, at the joints"
    return f"of soil in the ground, from the pump; in all about {plan.fuel:.2f} l of diesel"


def cycle_rows(plan: JobPlan) -> list[dict[str, Any]]:
    """The values of every cycle for the page's table."""
    return [
        {
            "number": cycle.number,
            "duration": cycle.duration,
            "work": cycle.work,
            "bank": cycle.bank,
            "filled": cycle.filled,
            "depth": cycle.depth,
            "step": cycle.step,
            "truck": cycle.truck,
            "verified": cycle.verified,
        }
        for cycle in plan.cycles
    ]


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def _centimetres(value: float) -> str:
    return f"{100.0 * value:.1f} cm"


def _signed(margin: float) -> str:
    return margin_text(margin, ".3f").replace("-", "\N{MINUS SIGN}")
