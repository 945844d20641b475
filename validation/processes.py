"""One function called for many items, in several processes; Ctrl-C keeps what is done."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from typing import TypeVar

from joblib import Parallel, delayed

T = TypeVar("T")
R = TypeVar("R")


def call_for_all(
    call: Callable[[T], R],
    items: Sequence[T],
    *,
    jobs: int = -1,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[list[R], bool]:
    """The results in the order of the items, and whether it was interrupted before the last.

    Parameters
    ----------
    jobs: processes; -1 for one on each core, 1 for this process alone.
    progress: is called with the number of items done.
    """
    found: list[tuple[int, R]] = []
    results = _results(call, items, jobs)
    interrupted = False
    try:
        for result in results:
            found.append(result)
            progress(len(found))
    except KeyboardInterrupt:
        interrupted = len(found) < len(items)
    finally:
        results.close()
    return [result for _, result in sorted(found, key=lambda one: one[0])], interrupted


def _call_one(call: Callable[[T], R], number: int, item: T) -> tuple[int, R]:
    if multiprocessing.parent_process() is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles Ctrl-C
    return number, call(item)


def _results(call: Callable[[T], R], items: Sequence[T], jobs: int) -> Generator[tuple[int, R], None, None]:
    if jobs == 1:
        yield from (_call_one(call, number, item) for number, item in enumerate(items))
        return
    calls = (delayed(_call_one)(call, number, item) for number, item in enumerate(items))
    try:
        yield from Parallel(n_jobs=jobs, batch_size=1, return_as="generator_unordered")(calls)
    except (KeyboardInterrupt, GeneratorExit):
        from joblib.externals.loky import get_reusable_executor

        get_reusable_executor().shutdown(wait=True, kill_workers=True)
        raise
