"""Searches beside the loop, for detours and for proofs: one at a time, in a thread or another executor."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from typing import Any

from backhoe_planner.live.detours.rejoining import LONGEST

_LONGEST_SEARCH = LONGEST + 5.0  # s after which an answer is no longer awaited: the search has ended by itself before


class Searches:
    """Runs one call at a time in an executor: the given one, or a thread of its own.

    Parameters
    ----------
    executor: runs the calls; None for a thread of its own, which ends with `close`.

    Attributes
    ----------
    revision: of the surroundings, for which the last call was begun.
    """

    def __init__(self, executor: Executor | None) -> None:
        self._executor = executor
        self._own: ThreadPoolExecutor | None = None
        self._future: Future[Any] | None = None
        self._closed = False
        self._begun = 0.0
        self.revision = -1

    @property
    def under_way(self) -> bool:
        """Whether an answer is awaited."""
        return self._future is not None

    def begin(self, revision: int, now: float, function: Callable[..., Any], *args: Any) -> None:
        """Begin a call at a `revision` of the surroundings, `now` [s]; if it cannot begin, the answer is the error."""
        self.revision, self._begun = revision, now
        try:
            if self._closed:
                raise RuntimeError("the follower is closed")
            self._future = self._pool().submit(function, *args)
        except Exception as error:  # noqa: BLE001  no exception may leave the loop
            self._future = Future()
            self._future.set_exception(error)

    def answer(self, now: float) -> Any:
        """The result of the call, or the exception that ended it; None while it runs."""
        future = self._future
        if future is None:
            return None
        if not future.done():
            if now - self._begun < _LONGEST_SEARCH:
                return None
            self.drop()
            return TimeoutError(f"no answer within {_LONGEST_SEARCH:g} s")
        self._future = None
        try:
            found = future.exception() or future.result()
        except CancelledError as error:  # cancelled by the owner of the executor
            return error
        return TypeError("no answer came back") if found is None else found

    def drop(self) -> None:
        """Stop waiting for the answer."""
        if self._future is not None:
            self._future.cancel()
            self._future = None

    def close(self) -> None:
        """Stop waiting, and end the thread once a running call is over; later calls are answered by an error."""
        self._closed = True
        self.drop()
        if self._own is not None:
            self._own.shutdown(wait=True, cancel_futures=True)

    def _pool(self) -> Executor:
        if self._executor is not None:
            return self._executor
        if self._own is None:
            self._own = ThreadPoolExecutor(max_workers=1, thread_name_prefix="rejoining")
            weakref.finalize(self, self._own.shutdown, wait=False, cancel_futures=True)
        return self._own
