"""The estimated cost of a whole job from the machine's present place: cheap models compare patterns without a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from backhoe_planner.arrays import Matrix
from backhoe_planner.job.checked_job import check_whole_job
from backhoe_planner.job.cycles.patterns import Pattern, patterns_to_compare
from backhoe_planner.job.estimates import compared_patterns
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.result.job_plan import PatternEstimate
from backhoe_planner.job.schema.job_file import Job
from backhoe_planner.job.worksite.worksite import build_worksite

# for each way to cut, the patterns chosen in most of the jobs in scenes/jobs: a third of the work of all patterns
_FEW = (Pattern("layers", 0.2), Pattern("layers", 0.3), Pattern("face", 0.4))


@dataclass(frozen=True, eq=False)
class JobEstimate:
    """The estimate of a job.

    Attributes
    ----------
    compared: the patterns that were compared, the best first.
    design, allowed: (rows, columns) heights of the design and of what may and can be dug [m], see `JobPlan`.
    """

    compared: tuple[PatternEstimate, ...]
    design: Matrix
    allowed: Matrix

    @property
    def best(self) -> PatternEstimate:
        """The pattern that would be planned."""
        return self.compared[0]


def estimate_job(job: Job, *, terrain: Terrain | None = None, few: bool = False) -> JobEstimate:
    """Estimate a job: its cycles, volume, time and work.

    Parameters
    ----------
    terrain: the ground as it is now; by default that of the job.
    few: if the job leaves the choice open, compare only three patterns, for a third of the work.

    Raises
    ------
    InputError: the job cannot be done as it is written, as for `plan_job`.
    """
    work = check_whole_job(build_worksite(job, terrain=terrain))
    patterns: Sequence[Pattern] = patterns_to_compare(work.site)
    if few and len(patterns) > 1:
        patterns = _FEW
    return JobEstimate(compared_patterns(work, patterns), work.design, work.allowed)
