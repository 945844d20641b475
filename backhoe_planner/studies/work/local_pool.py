"""Rows planned by processes of this computer, one for each core.

The processes are joblib's (loky). Where one dies, all that were at work are lost with it: which rows these were is
known from files that they write at the start of a row and remove at its end. Each of these rows is planned again by
a process of its own; where that dies too, the row has crashed.
"""

from __future__ import annotations

import os
import signal
import threading
import time as clock
from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from functools import lru_cache
from pathlib import Path
from typing import Any

from backhoe_planner.errors import OutputError, StudyError
from backhoe_planner.studies.results.outcome import Outcome, crashed
from backhoe_planner.studies.rows.drawing import StudyRow
from backhoe_planner.studies.work.bundle import Bundle
from backhoe_planner.studies.work.row_planning import RowPlanner

_AHEAD = 3  # rows for each process that wait or are planned: enough that none is idle; chosen
_MOST_IN_VAIN = 3  # pools in a row of which no process plans anything; chosen
_LOOKS_EVERY = 1.0  # s, at whether the main process is still there; chosen
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def plan_locally(
    bundle: Bundle, rows: Sequence[StudyRow], folder: Path, *, processes: int
) -> Generator[Outcome, None, None]:
    """The outcomes of all rows, as they come; where it is closed, the processes end.

    Parameters
    ----------
    folder: for the files of the bundle and of the rows at work; to be removed afterwards.
    processes: how many.

    Raises
    ------
    OutputError: files cannot be written there.
    StudyError: no process comes as far as a row.
    """
    root, marks = folder / "files", folder / "rows"
    try:
        root.mkdir(parents=True, exist_ok=True)
        marks.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=folder) from error
    bundle.unpack(root)
    left, in_vain = deque(rows), 0
    while left:
        lost: list[StudyRow] = []
        before = len(left)
        yield from _until_one_dies(root, marks, left, lost, processes)
        suspects = [row for row in lost if (marks / str(row.number)).exists()]
        in_vain = in_vain + 1 if not suspects and len(left) + len(lost) == before else 0
        if in_vain == _MOST_IN_VAIN:
            raise StudyError("the processes that plan rows end before they begin one", hint="is there memory for them?")
        for row in suspects:
            alone, again = deque([row]), list[StudyRow]()
            yield from _until_one_dies(root, marks, alone, again, 1)
            if again:
                yield crashed(row.number)
        left.extendleft(reversed([row for row in lost if row not in suspects]))
        for mark in marks.iterdir():
            mark.unlink()


def _until_one_dies(
    root: Path, marks: Path, left: deque[StudyRow], lost: list[StudyRow], processes: int
) -> Generator[Outcome, None, None]:
    """Plan rows from the left of `left`; where a process dies, what was handed out and not done goes to `lost`."""
    from joblib.externals.loky import ProcessPoolExecutor
    from joblib.externals.loky.process_executor import BrokenProcessPool

    pool = ProcessPoolExecutor(
        max_workers=processes, env=_ONE_THREAD, initializer=_begin_process, initargs=(os.getpid(),)
    )
    at_work: dict[Future[Any], StudyRow] = {}
    broken = False
    try:
        while (left and not broken) or at_work:
            while left and not broken and len(at_work) < _AHEAD * processes:
                row = left.popleft()
                try:
                    at_work[pool.submit(_plan_row, str(root), str(marks), row)] = row
                except BrokenProcessPool:
                    broken = True
                    left.appendleft(row)
            done = wait(at_work, return_when=FIRST_COMPLETED).done
            for future in sorted(done, key=lambda one: at_work[one].number):
                row = at_work.pop(future)
                try:
                    outcome = future.result()
                except BrokenProcessPool:
                    broken = True
                    lost.append(row)
                else:
                    yield outcome
        lost.sort(key=lambda row: row.number)
    finally:
        pool.shutdown(wait=True, kill_workers=True)


def _begin_process(parent: int) -> None:
    """What a process does first: Ctrl-C is the main process's, and without that it ends."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            clock.sleep(_LOOKS_EVERY)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@lru_cache(maxsize=1)
def _planner(root: str) -> RowPlanner:
    return RowPlanner(Path(root))


def _plan_row(root: str, marks: str, row: StudyRow) -> Outcome:
    mark = Path(marks) / str(row.number)
    try:
        mark.touch()
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=mark) from None
    outcome = _planner(root).plan(row)
    mark.unlink()
    return outcome
