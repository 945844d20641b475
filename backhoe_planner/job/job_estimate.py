"""The estimated cost of a whole job from the machine's present place: cheap models compare patterns without a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from backhoe_planner.job.checked_job import CheckedJob, check_whole_job
from backhoe_planner.job.cycles.patterns import Pattern, patterns_to_compare
from backhoe_planner.job.estimates import chosen_first, estimate_pattern
from backhoe_planner.job.result.job_plan import PatternEstimate
from backhoe_planner.job.schema.job_file import Job
from backhoe_planner.job.worksite.worksite import build_worksite

# for each way to cut, the patterns chosen in most of the jobs in scenes/jobs: a third of the work of all patterns
_FEW = (Pattern("layers", 0.2), Pattern("layers", 0.3), Pattern("face", 0.4))


@dataclass(frozen=True, eq=False)
class JobEstimate:
    """A job with the estimates of some of its patterns.

    Attributes
    ----------
    work: the job, checked.
    estimates: of patterns, each by itself.
    """

    work: CheckedJob
    estimates: tuple[PatternEstimate, ...]

    @property
    def best(self) -> PatternEstimate:
        """The estimate of the pattern that would be chosen among these."""
        return chosen_first(self.estimates, self.work.site.job.objective)[0]


def estimate_job(job: Job) -> JobEstimate:
    """Estimate a job: its cycles, volume, time and work with three patterns, or with the one it prescribes.

    Raises
    ------
    InputError: the job cannot be done as it is written, as for `plan_job`.
    """
    work = check_whole_job(build_worksite(job))
    patterns: Sequence[Pattern] = patterns_to_compare(work.site)
    few = _FEW if len(patterns) > 1 else patterns
    return JobEstimate(work, tuple(estimate_pattern(work, pattern) for pattern in few))
