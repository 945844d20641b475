"""Jobs planned in full with the chosen and with the plain pattern, and checked cycle by cycle."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import backhoe_planner as bp
from validation.job_check import job_refutations
from validation.tables import markdown


@dataclass(frozen=True)
class JobRun:
    """The results of one job.

    Attributes
    ----------
    name: of the job's file.
    plan: with the job's own pattern.
    plain: with level layers of 0.15 m; None if not planned.
    seconds: processor time of `plan` [s].
    refuted: what contradicts `plan` in an independent check; None if not checked.
    """

    name: str
    plan: bp.JobPlan
    plain: bp.JobPlan | None
    seconds: float
    refuted: list[str] | None


def run_job(file: Path, *, effort: str, plain: bool, attack: bool) -> JobRun:
    """Plan a job with its own and with the plain pattern; check every cycle of the first plan."""
    job = bp.load_job(file)
    begun = time.process_time()
    plan = bp.plan_job(job, effort=effort)
    seconds = time.process_time() - begun
    other = bp.plan_job(job.model_copy(update={"pattern": "plain"}), effort=effort) if plain else None
    return JobRun(file.stem, plan, other, seconds, job_refutations(plan) if attack else None)


def table(runs: Sequence[JobRun]) -> str:
    """A line for every job, as text."""
    return markdown(
        [
            {
                "job": run.name,
                "verdict": run.plan.verdict,
                "cycles": len(run.plan.cycles),
                "s a cycle": (run.plan.duration - run.plan.waits) / max(len(run.plan.cycles), 1),
                "bank m^3/h": run.plan.production,
                "left, dug below [cm]": f"{100.0 * run.plan.over:.1f}, {100.0 * run.plan.under:.1f}",
                "s/m^3": run.plan.cost,
                "plain": "" if run.plain is None else f"{run.plain.cost:.1f} ({run.plain.verdict})",
                "refuted": "" if run.refuted is None else len(run.refuted),
                "planned in [s]": run.seconds,
            }
            for run in runs
        ]
    )
