"""Planning rows by processes of this computer."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from functools import lru_cache, partial
from pathlib import Path

from backhoe_planner.studies.results.outcome import Outcome, crashed
from backhoe_planner.studies.rows.drawing import StudyRow
from backhoe_planner.studies.work.bundle import Bundle
from backhoe_planner.studies.work.process_pool import Died, call_in_processes
from backhoe_planner.studies.work.row_planning import RowPlanner


def plan_locally(
    bundle: Bundle, rows: Sequence[StudyRow], folder: Path, *, processes: int
) -> Generator[Outcome, None, None]:
    """The outcomes of all rows, as they are finished; if the generator is closed, the processes end.

    Parameters
    ----------
    folder: for the files of the bundle and of the rows being planned; to be removed afterwards.
    processes: how many.

    Raises
    ------
    OutputError, StudyError: see `call_in_processes`.
    """
    root = folder / "files"
    bundle.unpack(root)
    results = call_in_processes(partial(_plan_row, str(root)), rows, folder / "rows", processes=processes)
    try:
        for index, outcome in results:
            yield crashed(rows[index].number) if isinstance(outcome, Died) else outcome
    finally:
        results.close()


@lru_cache(maxsize=1)
def _planner(root: str) -> RowPlanner:
    return RowPlanner(Path(root))


def _plan_row(root: str, row: StudyRow) -> Outcome:
    return _planner(root).plan(row)
