#!/usr/bin/env python
"""How often a plan that is followed live still arrives when a random obstacle appears on it.

Counted is how each drive ends; contacts by distances without coal, at every `--check`-th
step and at every step whose own margin is small; limits at every step (see
validation/placements.py). The results are in docs/measurements.md. The exit status is 1
where a limit was broken or something was touched.

    python scripts/study_following.py [--placements 120] [--seed 0] [--check 10] [--save FILE]
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path

from validation.placements import place_obstacles


def main() -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--placements", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", type=int, default=10)
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    drives, figures = place_obstacles(
        count=options.placements, seed=options.seed, every=options.check, progress=partial(print, flush=True)
    )
    if options.save:
        content = {**figures, "placements": [asdict(drive) for drive in drives]}
        options.save.write_text(json.dumps(content, indent=2) + "\n")
    print(json.dumps(figures, indent=2))
    return int(bool(figures["problems"]))


if __name__ == "__main__":
    sys.exit(main())
