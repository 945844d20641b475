"""The estimated cost of a whole job from the machine's present place: cheap models compare patterns without a plan."""

from __future__ import annotations

from collections.abc import Sequence

from backhoe_planner.job.checked_job import check_whole_job
from backhoe_planner.job.cycles.patterns import Pattern, patterns_to_compare
from backhoe_planner.job.estimates import compared_patterns
from backhoe_planner.job.result.job_plan import PatternEstimate
from backhoe_planner.job.schema.job_file import Job
from backhoe_planner.job.worksite.worksite import build_worksite

# for each way to cut, the patterns chosen in most of the jobs in scenes/jobs: a third of the work of all patterns
_FEW = (Pattern("layers", 0.2), Pattern("layers", 0.3), Pattern("face", 0.4))


def estimate_job(job: Job) -> PatternEstimate:
    """Estimate a job: its cycles, volume, time and work with the best of three patterns, or with the one it prescribes.

    Raises
    ------
    InputError: the job cannot be done as it is written, as for `plan_job`.
    """
    work = check_whole_job(build_worksite(job))
    patterns: Sequence[Pattern] = patterns_to_compare(work.site)
    return compared_patterns(work, _FEW if len(patterns) > 1 else patterns)[0]
