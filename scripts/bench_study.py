#!/usr/bin/env python
"""Whether a killed study ends with the table of an undisturbed run, and the overhead of a study.

`kills`: the study is killed with -9, with all of its processes, at random moments and restarted; its table is compared
byte by byte with that of an undisturbed run, as is that of a Dask cluster of two workers, one of which is killed.
`throughput`: rows per second with one process and with two, in turn, and the processor time beside the plans, without
the start of the processes. The exit status is 1 if a table differs.

    python scripts/bench_study.py kills [--rows 2000] [--kills 5] [--seed 0]
    python scripts/bench_study.py throughput [--rows 600] [--turns 3]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from statistics import median

from validation import study_runs


def _kills(folder: Path, rows: int, kills: int, seed: int) -> int:
    study = study_runs.write_study(folder, rows)
    whole = study_runs.run_to_its_end(study, folder / "whole")
    print(f"undisturbed: {whole.rows} rows in {whole.whole:.0f} s", flush=True)
    done = study_runs.kill_often(study, folder / "killed", kills=kills, rows=rows, seed=seed)
    last = study_runs.run_to_its_end(study, folder / "killed")
    print(f"killed after {done} rows, then {last.rows} to the end", flush=True)
    wrong = 0
    planned = study_runs.journal_rows(folder / "killed")
    for name, count in (("killed", planned), ("cluster", rows)):
        if name == "cluster":
            at = study_runs.run_on_cluster(study, folder / "cluster", kill_at=rows // 3)
            print(f"cluster of two workers, one killed after {at} rows", flush=True)
        same = study_runs.same_table(folder / "whole", folder / name)
        print(
            f"  {name}: the table is {'the same' if same else 'ANOTHER'}; {count} rows planned for {rows}", flush=True
        )
        wrong += not same or count != rows
    return int(wrong > 0)


def _throughput(folder: Path, rows: int, turns: int) -> int:
    few, many = study_runs.write_study(folder, 2), study_runs.write_study(folder, rows)
    rates: dict[int, list[float]] = {1: [], 2: []}
    beside = []
    for turn in range(turns):
        for processes in (1, 2):
            start = study_runs.run_to_its_end(few, folder / f"few{turn}{processes}", "--jobs", str(processes))
            run = study_runs.run_to_its_end(many, folder / f"many{turn}{processes}", "--jobs", str(processes))
            rates[processes].append((run.rows - 1) / run.wall)
            planning = run.planning - start.planning
            beside.append((run.processor - start.processor) / planning - 1.0)
            print(
                f"{processes} processes: {rates[processes][-1]:.1f} rows a second; {run.planning:.1f} s of planning, "
                f"{100.0 * beside[-1]:.1f} % beside it, {start.processor:.1f} s to begin", flush=True,
            )  # fmt: skip
    ratio = median(rates[2]) / median(rates[1])
    print(f"two processes plan {ratio:.2f} times what one plans; {100.0 * median(beside):.1f} % beside the plans")
    return 0


def main() -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("kills", "throughput"))
    parser.add_argument("--rows", type=int)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench_study-") as scratch:
        if options.what == "kills":
            return _kills(Path(scratch), options.rows or 2000, options.kills, options.seed)
        return _throughput(Path(scratch), options.rows or 600, options.turns)


if __name__ == "__main__":
    sys.exit(main())
