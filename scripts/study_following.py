#!/usr/bin/env python
"""How plans are followed live: past random obstacles, up to obstacles that go again, and with nothing in the way.

`placements` counts how each drive ends past a random obstacle that appears on its plan and stays;
contacts by distances without coal, at every `--check`-th step and at every step whose own margin
is small; limits at every step (validation/placements.py). `removals` counts the drives that do
not arrive although the obstacle before their end is gone (validation/removals.py). `undisturbed`
counts the steps by which plans of three machines take longer than planned
(validation/undisturbed.py). The results are in docs/measurements.md. The exit status is 1 where a
limit was broken, something was touched, or a drive with nothing in its way did not arrive.

    python scripts/study_following.py [placements|removals|undisturbed] [--count 120] [--seed 0]
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

from validation.placements import place_obstacles
from validation.removals import take_obstacles_away
from validation.undisturbed import follow_undisturbed


def main() -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", nargs="?", choices=("placements", "removals", "undisturbed"), default="placements")
    parser.add_argument("--count", type=int, default=120, help="drives; of `undisturbed` plans of each machine")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", type=int, default=10)
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    studies: dict[str, Callable[..., tuple[list[Any], dict[str, Any]]]] = {
        "placements": partial(place_obstacles, every=options.check),
        "removals": take_obstacles_away,
        "undisturbed": follow_undisturbed,
    }
    drives, figures = studies[options.study](
        count=options.count, seed=options.seed, progress=partial(print, flush=True)
    )
    if options.save:
        content = {**figures, options.study: [asdict(drive) for drive in drives]}
        options.save.write_text(json.dumps(content, indent=2) + "\n")
    print(json.dumps(figures, indent=2))
    return int(any(figures.get(key) for key in ("problems", "stuck", "not arrived")))


if __name__ == "__main__":
    sys.exit(main())
