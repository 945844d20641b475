"""One function called for many items, in the processes of studies; Ctrl-C keeps what is done."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TypeVar

from backhoe_planner.studies import Died, call_in_processes, process_count

T = TypeVar("T")
R = TypeVar("R")


def call_for_all(
    call: Callable[[T], R],
    items: Sequence[T],
    *,
    jobs: int = -1,
    progress: Callable[[int], None] = lambda done: None,
    died: Callable[[T], R] | None = None,
) -> tuple[list[R], bool]:
    """The results in the order of the items, and whether it was interrupted before the last.

    Parameters
    ----------
    jobs: processes; -1 for one on each core, 1 for this process alone.
    progress: is called with the number of items done.
    died: the result for an item at which the process dies, twice; by default there is none, with a warning.
    """
    found: list[tuple[int, R]] = []
    ended, interrupted = 0, False
    with (
        tempfile.TemporaryDirectory(prefix="campaign-") as folder,
        closing(_results(call, items, jobs, folder)) as all_,
    ):
        try:
            for index, result in all_:
                ended += 1
                if not isinstance(result, Died):
                    found.append((index, result))
                elif died is not None:
                    found.append((index, died(items[index])))
                else:
                    warnings.warn(f"the process died twice at {items[index]}", stacklevel=2)
                progress(ended)
        except KeyboardInterrupt:
            interrupted = ended < len(items)
    return [result for _, result in sorted(found, key=lambda one: one[0])], interrupted


def _results(
    call: Callable[[T], R], items: Sequence[T], jobs: int, folder: str
) -> Generator[tuple[int, R | Died], None, None]:
    if jobs == 1:
        yield from ((index, call(item)) for index, item in enumerate(items))
    else:
        yield from call_in_processes(call, items, Path(folder), processes=min(process_count(jobs), len(items) or 1))
