"""Where to stand: the answer of `stand` against the place that each job is given.

    python scripts/bench_stand.py                                # the jobs that one place can dig
    python scripts/bench_stand.py scenes/jobs/drain_with_a_fall.yaml --objective time
    python scripts/bench_stand.py scenes/jobs/long_trench.yaml --effort quick

Both are planned in full. A table of the compared places is printed for each job.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import backhoe_planner as bp

JOBS = Path(__file__).resolve().parents[1] / "scenes" / "jobs"
NAMES = ("trench_beside_gas_pipe", "trench_across_water_pipe", "truck_under_power_line", "drain_with_a_fall")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", type=Path, default=[JOBS / f"{name}.yaml" for name in NAMES])
    parser.add_argument("--objective", choices=("time", "work"), help="instead of the one that each job asks for")
    parser.add_argument("--effort", default="quick")
    parser.add_argument("--count", type=int, default=2)
    parser.add_argument("--output", type=Path, help="where the answers go, one file for each job")
    given = parser.parse_args()
    for file in given.jobs:
        job = bp.load_job(file)
        if given.objective is not None:
            job = bp.job_from_dict(job.to_dict() | {"objective": given.objective}, folder=file.parent)
        plan = bp.stand(job, count=given.count, effort=given.effort)
        if given.output is not None:
            plan.save(given.output / f"{file.stem}.json")
        unit, scale = job.cost_unit
        print(f"{file.stem}: {plan.verdict} {plan.reason} {plan.note}")
        print(f"  x [m]   y [m]  heading  map     estimated  planned  [{unit}]  bank [m^3]")
        for one in plan.ranking:
            costs = "  ".join(f"{scale * cost:8.1f}" for cost in (one.rough, one.estimated, one.planned))
            x, y = one.base.position
            verdict = "" if one.plan is None else one.plan.verdict
            mark = "given" if one.given else ""
            print(f"  {x:6.2f} {y:6.2f} {one.base.heading:7.2f}  {costs}  {one.bank:8.3f}  {verdict} {mark} {one.note}")
        for number, place in enumerate(plan.places, start=1):
            x, y = place.base.position
            print(
                f"  place {number}: x {x:.2f}, y {y:.2f} m, heading {place.base.heading:.2f} rad, "
                f"{len(place.plan.cycles)} cycles, {place.plan.bank:.2f} m^3, moved by {place.travel:.1f} m"
            )
        given_plan = None if plan.given is None else plan.given.plan
        if given_plan is not None and given_plan.bank > 0.0:
            before, after = (
                (one.duration - waits) / one.bank
                for one, waits in (
                    (given_plan, given_plan.waits),
                    (plan, sum(place.plan.waits for place in plan.places)),
                )
            )
            print(f"  time: {after:.1f} s/m^3, at the given place {before:.1f}")
        gain = "" if math.isnan(plan.gain) else f", {100.0 * plan.gain:.1f} % less than the given place"
        print(f"  answer: {scale * plan.cost:.1f} {unit}{gain}; {plan.planning_time:.0f} s", flush=True)


if __name__ == "__main__":
    main()
