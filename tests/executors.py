"""Executors for the searches and proofs of a follower: one that answers at once, and one that never does."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from typing import Any


class AtOnce(Executor):
    """Runs each call before it returns."""

    def submit(self, function: Any, /, *args: Any, **keys: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*args, **keys))
        return future


class Never(Executor):
    """Never answers."""

    def submit(self, function: Any, /, *args: Any, **keys: Any) -> Future[Any]:
        return Future()
