#!/usr/bin/env python
"""Every benchmark in one run: which figures got slower or worse since a saved run.

The figures come from validation/benches.py: start-up, plans of random sites, motions to a goal over
their bound, paths of full poses, steps of the law and of the servo, the servo among people, and the
attack on the certificate. Times are processor times, compared as multiples of reference calls of
the same run. `scripts/bench` is the same with one thread.

    scripts/bench --save run.json
    scripts/bench --against validation/bench/0.1.0.json
    scripts/bench --only startup servo
    scripts/bench --long --save run.json

The exit status is 1 if a figure is worse beyond its noise or gone, else 0.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import argparse
import resource
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import backhoe_planner as bp
from backhoe_planner.files.output_file import check_writable
from validation import bench_figures as figures
from validation.benches import BENCHES


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--long", action="store_true", help="more of everything: about ten times as long")
    parser.add_argument("--only", nargs="+", choices=BENCHES, default=list(BENCHES), help="some of them")
    parser.add_argument("--save", type=Path, metavar="FILE.json")
    parser.add_argument("--against", type=Path, metavar="FILE.json", help="a run that was saved")
    options = parser.parse_args(arguments)
    setting: Literal["short", "long"] = "long" if options.long else "short"
    try:
        if options.save:
            check_writable(options.save)
        before = figures.load(options.against) if options.against else None
        if before is not None and before.setting != setting:
            parser.error(f"--against: {options.against} is of the setting {before.setting}, this run is {setting}")
    except bp.InputError as error:
        parser.error(str(error))
    found: list[figures.Figure] = []
    for name in options.only:
        begun = _seconds()
        found += BENCHES[name](options.long)
        print(f"{name}: {_seconds() - begun:.0f} s", file=sys.stderr, flush=True)
    run = figures.made_here(setting, _seconds(), found)
    if options.save:
        figures.save(run, options.save)
    print(f"{run.processor}, {', '.join(f'{name} {number}' for name, number in run.versions.items())}")
    print(f"setting {setting}, {run.seconds:.0f} s of the processor\n\n{figures.figures_table(run)}")
    if before is None:
        return 0
    if set(options.only) != set(BENCHES):  # figures that were not measured are not gone
        names = {figure.name for figure in found}
        kept = tuple(figure for figure in before.figures if figure.name in names)
        before = before.model_copy(update={"figures": kept})
    changes = figures.compare(before, run)
    print(f"\nagainst {options.against}" + "".join(f"\n  {line}" for line in figures.differences(before, run)))
    print(f"\n{figures.changes_table(changes)}")
    return int(any(change.verdict in ("worse", "gone") for change in changes))


def _seconds() -> float:
    """Processor time of this process and its child processes [s]."""
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


if __name__ == "__main__":
    sys.exit(main())
