"""A stand-in for planning that kills its process at some rows."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from backhoe_planner.studies.results.outcome import Outcome
from backhoe_planner.studies.rows.drawing import StudyRow


def dies_at_one(root: str, row: StudyRow) -> Outcome:
    """Kill the process at row 1 each time; every other row is verified."""
    assert Path(root).is_dir()
    if row.number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return Outcome(row.number, "verified")
