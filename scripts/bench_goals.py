#!/usr/bin/env python
"""How good motions to a goal are, compared with the best known for the same site and a proven bound.

For each group of random sites (validation/sites.py), or of problems at a table, a shelf and a cage
(validation/tabletop.py), all of which have a known solution: the part that was verified, cost over
the best known, processor time, cost over the bound that the plan proves, and the spread of the
results of several planning seeds. For work and hydraulic energy, "beside little" gives the same shares
with every cost raised at least to that of lifting all moving parts by a millimetre. `below bound` must
be 0. The best known costs are kept in a file; runs with other seeds and more effort improve them.

    python scripts/bench_goals.py --sites 10 --best best.json
    python scripts/bench_goals.py --sites 10 --best best.json --effort thorough --planning-seeds 1 2 3
    python scripts/bench_goals.py --sites 10 --best best.json --objective work
    python scripts/bench_goals.py --sites 67 --problems tabletop
    python scripts/bench_goals.py --sites 2 --best best.json --ompl 1 5
    python scripts/bench_goals.py --sites 10 --problems tabletop --effort quick --roboplan

`--ompl` plans every site also with OMPL's own planners (validation/ompl_planners.py), each in the
processor time that our plan took and in the given seconds. `--roboplan` plans tabletop problems
also with RoboPlan (`pip install roboplan`; validation/roboplan_runs.py).

Ctrl-C ends the run and prints the results so far; the same command resumes it, also after a kill.
The exit status is 1 if an exception was raised or a motion is below a bound, 130 after Ctrl-C,
else 0.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one site per core; before numpy is imported

import argparse
import importlib.util
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import backhoe_planner as bp
from backhoe_planner.files.output_file import check_writable
from backhoe_planner.motion import OBJECTIVES
from backhoe_planner.planning import EFFORTS
from validation import goal_runs as runs
from validation import ompl_runs, roboplan_runs, tabletop
from validation.campaigns import count_on_terminal, kept_campaigns
from validation.obstacles import MACHINES
from validation.planning_runs import all_keys
from validation.sites import KINDS, random_site


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, default=10, help="in each group")
    parser.add_argument("--problems", choices=("sites", "tabletop"), default="sites")
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=MACHINES, help="of random sites")
    parser.add_argument("--kinds", nargs="+", choices=(*KINDS, *tabletop.KINDS), help="all of them by default")
    parser.add_argument("--by-joints", action="store_true", help="goals of tabletop problems by joints, not by pose")
    parser.add_argument("--seed", type=int, default=0, help="of the sites")
    parser.add_argument("--planning-seeds", nargs="+", type=int, default=[0], metavar="SEED")
    parser.add_argument("--effort", choices=list(EFFORTS), default="normal")
    parser.add_argument("--objective", choices=list(OBJECTIVES), default="time")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; all cores by default")
    parser.add_argument("--best", type=Path, metavar="FILE.json", help="the best known; it is read and made better")
    parser.add_argument("--save", type=Path, metavar="FILE.json", help="every row of this run")
    parser.add_argument("--ompl", nargs="*", type=float, metavar="SECONDS", help="OMPL's planners on the same sites")
    parser.add_argument("--roboplan", action="store_true", help="RoboPlan on the same tabletop problems")
    options = parser.parse_args(arguments)
    if options.sites < 1 or options.seed < 0 or options.jobs == 0 or min(options.planning_seeds) < 0:
        parser.error("--sites and --jobs must be greater than 0, --seed and --planning-seeds not negative")
    best = runs.Best()
    try:
        for path in (options.best, options.save):
            if path:
                check_writable(path)
        best = runs.Best.load(options.best) if options.best else best
    except (bp.OutputError, OSError, ValueError, KeyError, TypeError) as error:
        parser.error(str(error))
    kinds, machines, draw = KINDS, options.machines, random_site
    if options.problems == "tabletop":
        kinds, machines = tabletop.KINDS, [tabletop.MACHINE]
        draw = partial(tabletop.tabletop_problem, by_joints=options.by_joints)
    chosen = options.kinds or kinds
    if not set(chosen) <= set(kinds):
        parser.error(f"--kinds of --problems {options.problems} are {', '.join(kinds)}")
    keys = all_keys(options.sites, machines=machines, kinds=chosen, tasks=["goal"], seed=options.seed)
    settings = runs.Settings(options.effort, options.objective, tuple(options.planning_seeds))
    how = {"draw": draw, "jobs": options.jobs, "folder": kept_campaigns(), "watch": count_on_terminal(len(keys))}

    if options.roboplan:
        if options.problems != "tabletop" or importlib.util.find_spec("roboplan") is None:
            parser.error("--roboplan needs --problems tabletop, and the package: pip install roboplan")
        beside, interrupted = roboplan_runs.compare(keys, settings, **how)
        if beside:
            print(roboplan_runs.table(beside))
        return 130 if interrupted else 0
    if options.ompl is not None:
        found, interrupted = ompl_runs.compare(keys, settings, options.ompl, **how)
        ompl_runs.add_to_best(best, found)
        if options.best:
            best.save(options.best)
        if found:
            print(ompl_runs.table(found, best))
        return 130 if interrupted else 0
    rows, interrupted = runs.run(keys, settings, **how)
    if interrupted:
        print(f"interrupted: {len(rows)} plans are done")
    if not rows:
        return 130
    best.add_rows(rows, settings.effort)
    if options.best:
        best.save(options.best)
    if options.save:
        runs.save_rows(options.save, rows, settings)
    below = _report(rows, best, settings)
    return 130 if interrupted else int(below or any(row.verdict == "error" for row in rows))


def _report(rows: Sequence[runs.Row], best: runs.Best, settings: runs.Settings) -> bool:
    """Print the figures; return whether a motion is below a bound."""
    seeds = ", ".join(map(str, settings.planning_seeds))
    print(f"{len(rows)} plans, effort {settings.effort}, objective {settings.objective}, planning seeds {seeds}\n")
    print(runs.table(rows, best))
    if failed := runs.failures(rows):
        print(f"\nnot verified:\n{failed}")
    below = runs.violations(rows, best)
    for name in below:
        print(f"\nbelow its bound: {name}")
    return bool(below)


if __name__ == "__main__":
    sys.exit(main())
