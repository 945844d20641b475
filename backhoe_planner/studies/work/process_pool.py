"""One call for many items, in several processes of this computer, with the results as they are finished.

The processes are joblib's (loky), each with one thread. If one dies, all that were working are lost with it. Their
items are known from files that the processes write at the start of an item and remove at its end. Each of these items
is tried again by a process of its own; if that dies too, this is the item's result.
"""

from __future__ import annotations

import os
import signal
import threading
import time as clock
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from backhoe_planner.blas import ONE_THREAD
from backhoe_planner.errors import InputError, OutputError, StudyError

_AHEAD = 3  # items waiting or in work for each process: enough that none is idle; chosen
_MOST_IN_VAIN = 3  # pools in a row in which no process begins an item; chosen
_LOOKS_EVERY = 1.0  # s between checks that the main process still exists; chosen

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Died:
    """Instead of a result: the process died twice at this item."""


def process_count(jobs: int) -> int:
    """How many processes `jobs` stands for: -1 is one for each core.

    Raises
    ------
    InputError: it is neither -1 nor 1 or more.
    """
    if jobs == -1:
        from joblib import cpu_count

        return int(cpu_count())
    if not isinstance(jobs, int) or isinstance(jobs, bool) or jobs < 1:
        raise InputError("is not a number of processes", key="jobs", found=jobs, allowed="1 or more; -1: all cores")
    return jobs


def call_in_processes(
    call: Callable[[T], R], items: Sequence[T], folder: Path, *, processes: int
) -> Generator[tuple[int, R | Died], None, None]:
    """The results as they are finished, each with its item's index; if the generator is closed, the processes end.

    Parameters
    ----------
    call: a function that the processes can import.
    folder: for the files that mark the items in work.
    processes: how many.

    Raises
    ------
    OutputError: files cannot be written there.
    StudyError: no process gets as far as beginning an item.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=folder) from error
    left, in_vain = deque(range(len(items))), 0
    while left:
        lost: list[int] = []
        before = len(left)
        yield from _until_one_dies(call, items, folder, left, lost, processes)
        suspects = [index for index in lost if (folder / str(index)).exists()]
        in_vain = in_vain + 1 if not suspects and len(left) + len(lost) == before else 0
        if in_vain == _MOST_IN_VAIN:
            raise StudyError(
                "the planning processes end before they start any work", hint="check that there is enough memory"
            )
        for index in suspects:
            alone, again = deque([index]), list[int]()
            yield from _until_one_dies(call, items, folder, alone, again, 1)
            if again:
                yield index, Died()
        left.extendleft(reversed([index for index in lost if index not in suspects]))
        for mark in folder.iterdir():
            mark.unlink()


def _until_one_dies(
    call: Callable[[T], R], items: Sequence[T], folder: Path, left: deque[int], lost: list[int], processes: int
) -> Generator[tuple[int, R], None, None]:
    """Call for items from the left of `left`; if a process dies, items handed out but not done go to `lost`."""
    from joblib.externals.loky import ProcessPoolExecutor
    from joblib.externals.loky.process_executor import BrokenProcessPool

    pool = ProcessPoolExecutor(
        max_workers=processes, env=dict(ONE_THREAD), initializer=_begin_process, initargs=(os.getpid(),)
    )
    at_work: dict[Future[Any], int] = {}
    broken = False
    try:
        while (left and not broken) or at_work:
            while left and not broken and len(at_work) < _AHEAD * processes:
                index = left.popleft()
                try:
                    at_work[pool.submit(_call_one, call, str(folder / str(index)), items[index])] = index
                except BrokenProcessPool:
                    broken = True
                    left.appendleft(index)
            done = wait(at_work, return_when=FIRST_COMPLETED).done
            for future in sorted(done, key=at_work.__getitem__):
                index = at_work.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    broken = True
                    lost.append(index)
                else:
                    yield index, result
        lost.sort()
    finally:
        pool.shutdown(wait=True, kill_workers=True)


def _begin_process(parent: int) -> None:
    """Initialise a process: it leaves Ctrl-C to the main process, and ends if that no longer exists."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            clock.sleep(_LOOKS_EVERY)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _call_one(call: Callable[[T], R], mark: str, item: T) -> R:
    try:
        Path(mark).touch()
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=mark) from None
    result = call(item)
    Path(mark).unlink(missing_ok=True)
    return result
