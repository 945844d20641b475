"""Campaigns: one function called for many cases, with the processes and the journal of studies.

With a folder, the result of a case is stored there at once, so that a killed campaign resumes where it was; the
results are removed when all cases are done. Another function, other settings, other code or other versions of the
libraries make another campaign with its own folder.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import itertools
import json
import math
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from pydantic import TypeAdapter

from backhoe_planner.files.cache import caches, maker_digest
from backhoe_planner.files.provenance import installed_versions
from backhoe_planner.studies import Died, Journal, ResultsFolder, call_in_processes, process_count

T = TypeVar("T")
R = TypeVar("R")
X = TypeVar("X")

_ROOT = Path(__file__).resolve().parents[1]
_CODE = ("backhoe_planner/**/*.py", "validation/**/*.py", "models/**/*.*")  # files on which results depend


def kept_campaigns() -> Path:
    """The folder below the user's caches in which scripts keep unfinished campaigns."""
    return caches() / "campaigns"


def count_on_terminal(total: int) -> Callable[[int, object], None]:
    """A `watch` that shows the number of cases done of `total` in one line of the terminal, if there is one."""

    def show(done: int, _: object) -> None:
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{done} of {total} " + ("\n" if done == total else ""))
            sys.stderr.flush()

    return show


class Campaign(Generic[T, R]):
    """Calls of one function for many cases; a context.

    Parameters
    ----------
    call: a function that the processes can import; its keywords may be bound by `partial`.
    result: its type: plain data, or dataclasses of it.
    jobs: processes; -1 for one on each core, 1 for this process alone.
    folder: for campaigns that are not done; by default nothing is kept.
    died: the result for a case at which the process died twice; by default none, with a warning.

    Attributes
    ----------
    interrupted: whether Ctrl-C ended it before the last case.
    """

    def __init__(
        self,
        call: Callable[[T], R],
        result: Any,
        *,
        jobs: int = -1,
        folder: Path | None = None,
        died: Callable[[T], R] | None = None,
    ) -> None:
        self._call, self._type, self._died = call, TypeAdapter(result), died
        self._processes = process_count(jobs)
        self._folder, self._place = folder, Path()
        self._stack = ExitStack()
        self._journal: Journal | None = None
        self.interrupted = False

    def __enter__(self) -> Campaign[T, R]:
        """Resume the campaign, or begin it.

        Raises
        ------
        OutputError: the folder cannot be written.
        StudyError: another run of the same campaign writes there.
        """
        if self._folder is None:
            scratch = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="campaign-"))
            self._scratch = Path(scratch)
            return self
        header = _header(self._call)
        name = header["campaign"][0] if isinstance(header["campaign"], list) else header["campaign"]
        self._place = self._folder / f"{name}-{_digest(header)}"
        results = self._stack.enter_context(ResultsFolder(self._place))
        self._scratch = results.scratch
        self._journal = self._stack.enter_context(Journal(results.journal, header, kind="campaign"))
        if self._journal.done:
            warnings.warn(
                f"{len(self._journal.done)} cases were done by an earlier run; to begin anew, remove {self._place}",
                stacklevel=2,
            )
        return self

    def __exit__(self, error: object, *_: object) -> None:
        self._stack.close()
        if self._journal is not None and error is None and not self.interrupted:
            shutil.rmtree(self._place, ignore_errors=True)

    def run(self, cases: Sequence[T], *, watch: Callable[[int, R], object] = lambda done, result: None) -> list[R]:
        """The results in the order of the cases; after Ctrl-C those of the cases done.

        Parameters
        ----------
        watch: called with the number of cases done and the last result, first for those of an earlier run.
        """
        found: dict[int, R] = {}
        try:
            for index, result in itertools.chain(self._earlier(cases), self._now(cases, found)):
                found[index] = result
                watch(len(found), result)
        except KeyboardInterrupt:
            self.interrupted = len(found) < len(cases)
        return [found[index] for index in sorted(found)]

    def first(
        self: Campaign[T, list[X]],
        cases: Iterator[T],
        count: int,
        *,
        most: int = 1,
        watch: Callable[[int, X], object] = lambda done, result: None,
    ) -> list[X]:
        """The first `count` results of cases that give some or none each; after Ctrl-C those found so far.

        They do not depend on the processes.

        Parameters
        ----------
        cases: drawn as needed.
        most: largest number of results of one case.
        watch: called with the number of results and the last one; may be called for more than `count`.
        """
        found: list[X] = []
        numbers = itertools.count(1)

        def tell(_: int, some: list[X]) -> None:
            for one in some:
                watch(next(numbers), one)

        while len(found) < count and not self.interrupted:
            batch = list(itertools.islice(cases, math.ceil((count - len(found)) / most)))
            if not batch:
                break
            found += itertools.chain.from_iterable(self.run(batch, watch=tell))
        return found[:count]

    def _earlier(self, cases: Sequence[T]) -> Iterator[tuple[int, R]]:
        for index, case in enumerate(cases) if self._journal is not None and self._journal.done else ():
            kept = self._journal.done.get(_digest(case)) if self._journal is not None else None
            if kept is not None:
                yield index, self._read(kept["result"])

    def _now(self, cases: Sequence[T], done: Mapping[int, R]) -> Iterator[tuple[int, R]]:
        left = [index for index in range(len(cases)) if index not in done]
        with closing(self._results([cases[index] for index in left])) as results:
            for place, result in results:
                index = left[place]
                if isinstance(result, Died):
                    if self._died is None:
                        warnings.warn(f"the process died twice at {cases[index]}", stacklevel=3)
                        continue
                    result = self._died(cases[index])
                text = self._text(result)
                if self._journal is not None:
                    self._journal.add(_digest(cases[index]), {"result": text})
                yield index, self._read(text)  # the same as from an earlier run

    def _results(self, cases: Sequence[T]) -> Generator[tuple[int, R | Died], None, None]:
        if self._processes == 1 or not cases:
            yield from ((index, self._call(case)) for index, case in enumerate(cases))
        else:
            processes = min(self._processes, len(cases))
            yield from call_in_processes(self._call, cases, self._scratch / "cases", processes=processes)

    def _read(self, text: str) -> R:
        found: R = self._type.validate_python(json.loads(text))
        return found

    def _text(self, result: R) -> str:
        """A result as JSON, including values that are not finite."""
        return json.dumps(self._type.dump_python(result, warnings=False), default=lambda number: number.item())


def call_for_all(
    call: Callable[[T], R],
    cases: Sequence[T],
    *,
    result: Any,
    jobs: int = -1,
    folder: Path | None = None,
    watch: Callable[[int, R], object] = lambda done, result: None,
    died: Callable[[T], R] | None = None,
) -> tuple[list[R], bool]:
    """The results in the order of the cases, and whether the run was interrupted before the last; see `Campaign`."""
    with Campaign(call, result, jobs=jobs, folder=folder, died=died) as campaign:
        return campaign.run(cases, watch=watch), campaign.interrupted


def _header(call: Callable[..., Any]) -> dict[str, Any]:
    """Everything that determines a result, except the case."""
    files = sorted(str(file.relative_to(_ROOT)) for pattern in _CODE for file in _ROOT.glob(pattern) if file.is_file())
    return {
        "campaign": _plain(call),
        "code": maker_digest(_ROOT, files, ()).hex(),
        "versions": installed_versions(),
    }


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(_plain(value), sort_keys=True).encode()).hexdigest()[:24]


def _plain(value: Any) -> Any:
    """A case, or a campaign's function with its bound arguments, as plain data without loss."""
    if isinstance(value, functools.partial):
        return [_plain(value.func), _plain(value.args), _plain(value.keywords)]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return [type(value).__name__, fields]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    if callable(value):
        return f"{value.__module__}.{value.__qualname__}"
    json.dumps(value)  # raises for anything else, which may lose information
    return value
