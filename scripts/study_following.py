#!/usr/bin/env python
"""Following plans live: past random obstacles, up to obstacles that go away again, and undisturbed.

`placements` counts how drives end when a random obstacle appears on the plan and stays. Contacts
are found by distances without coal, at every `--check`-th step and at every step whose own margin
is small; limits are checked at every step (validation/placements.py). `removals` counts the drives
that do not arrive although the obstacle before their end is gone (validation/removals.py).
`undisturbed` counts the steps by which plans of three machines take longer than planned
(validation/undisturbed.py). `balls` counts what is touched and what is not kept by three machines with
something to keep among balls that fly past and into them (validation/moving_balls.py). The results are
in docs/measurements.md. Ctrl-C ends the run and prints the results so far; the same command resumes it,
also after a kill. The exit status is 1 if a limit was broken, something that stands still was touched, or
an undisturbed drive did not arrive, 130 after Ctrl-C.

    python scripts/study_following.py [placements|removals|undisturbed|balls] [--count 120] [--seed 0]
        [--check 10] [--save FILE]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from validation.campaigns import kept_campaigns
from validation.moving_balls import follow_among_balls
from validation.placements import Followed, place_obstacles
from validation.removals import take_obstacles_away
from validation.undisturbed import follow_undisturbed


def main() -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "study", nargs="?", choices=("placements", "removals", "undisturbed", "balls"), default="placements"
    )
    parser.add_argument("--count", type=int, default=120, help="drives; of `undisturbed` plans of each machine")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=-1, help="processes; all cores by default")
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    studies: dict[str, Callable[..., Followed[Any]]] = {
        "placements": partial(place_obstacles, every=options.check),
        "removals": take_obstacles_away,
        "undisturbed": follow_undisturbed,
        "balls": follow_among_balls,
    }
    found = studies[options.study](
        count=options.count, seed=options.seed, jobs=options.jobs, folder=kept_campaigns(), watch=_print_drive
    )
    if options.save:
        content = {**found.figures, options.study: [asdict(drive) for drive in found.drives]}
        options.save.write_text(json.dumps(content, indent=2) + "\n")
    print(json.dumps(found.figures, indent=2))
    wrong = any(found.figures.get(key) for key in ("problems", "stuck", "not arrived"))
    return 130 if found.interrupted else int(wrong)


def _print_drive(number: int, drive: Any) -> None:
    shown = {key: value for key, value in asdict(drive).items() if key not in ("searches", "seconds")}
    print(f"{number} {json.dumps(shown)}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
