"""Planning rows by the workers of a Dask cluster.

The files of a study go to the workers as bytes, through the scheduler: a worker that joins later, or replaces one
that was lost, gets them too. Dask plans the rows of a lost worker on another one.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import tempfile
import threading
import warnings
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from backhoe_planner.errors import OutputError, StudyError
from backhoe_planner.files.provenance import installed_versions
from backhoe_planner.studies.results.outcome import Outcome, crashed
from backhoe_planner.studies.rows.drawing import StudyRow
from backhoe_planner.studies.work.bundle import Bundle
from backhoe_planner.studies.work.row_planning import RowPlanner

_CONNECTED_WITHIN = 5.0  # s; chosen: a running scheduler answers within some milliseconds
_AHEAD = 4  # rows waiting or being planned for each thread of the cluster: enough that none is idle; chosen
_LEAST_AHEAD = 32  # rows, if workers are still to join; chosen

_ONE_AT_A_TIME = threading.Lock()  # for the threads of a worker: machines and scenes are not shared between threads


def plan_on_cluster(bundle: Bundle, rows: Sequence[StudyRow], address: str) -> Generator[Outcome, None, None]:
    """The outcomes of all rows, as they are finished; if the generator is closed, the other rows are cancelled.

    Parameters
    ----------
    address: of the scheduler, such as ``tcp://10.0.0.5:8786``.

    Raises
    ------
    StudyError: the scheduler cannot be reached, or is lost; a worker lacks what it needs.
    """
    import distributed

    with _quiet():
        client = _connect(address)
        try:
            yield from _plan_all(client, bundle, rows, distributed)
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone
                client.close(timeout=2)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence Dask's logging: this program reports each error once."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "distributed.core")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _connect(address: str) -> Any:
    import distributed
    from distributed.comm import get_address_host

    try:
        get_address_host(address)
    except ValueError as error:  # checked first: a client would try for a long time and end with a traceback
        raise StudyError(
            f"is no address of a scheduler: {error}", key="--scheduler", found=address or "nothing",
            allowed="such as tcp://127.0.0.1:8786",
        ) from None  # fmt: skip
    try:
        return distributed.Client(address, timeout=_CONNECTED_WITHIN, set_as_default=False)
    except (OSError, TimeoutError, ValueError, asyncio.TimeoutError) as error:
        raise StudyError(
            "the scheduler cannot be reached", key="--scheduler", found=address,
            allowed="the address of a running one, such as tcp://127.0.0.1:8786",
            hint=f"it was tried for {_CONNECTED_WITHIN:g} s: {type(error).__name__}",
        ) from None  # fmt: skip


def _plan_all(
    client: Any, bundle: Bundle, rows: Sequence[StudyRow], distributed: Any
) -> Generator[Outcome, None, None]:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph", category=UserWarning)
        # as a task, not scattered: Dask computes it again if all workers that had it are lost
        shared = client.submit(_hand_on, bundle, key=f"backhoe-planner-study-{bundle.digest[:16]}")
    left, again = deque(rows), set[int]()
    at_work: dict[Any, StudyRow] = {}
    finished = distributed.as_completed(loop=client.loop)

    def hand_out() -> None:
        ahead = max(_LEAST_AHEAD, _AHEAD * sum(client.nthreads().values()))
        while left and len(at_work) < ahead:
            row = left.popleft()
            future = client.submit(_plan_row, shared, row, pure=False)
            at_work[future] = row
            finished.add(future)

    try:
        hand_out()
        for future in finished:
            row = at_work.pop(future)
            try:
                outcome = future.result()
            except distributed.KilledWorker:
                if row.number in again:
                    outcome = crashed(row.number)
                else:
                    again.add(row.number)  # it may only have been waiting when another row killed the workers
                    left.append(row)
                    hand_out()
                    continue
            except (StudyError, OutputError):
                raise
            except (OSError, TimeoutError, asyncio.CancelledError, distributed.client.FutureCancelledError) as error:
                raise _lost(error) from None
            except Exception as error:  # noqa: BLE001  whatever a worker lacks
                raise StudyError(
                    f"a worker of the cluster cannot plan: {type(error).__name__}: {error}", key="--scheduler",
                    hint="backhoe_planner must be installed there in the same version",
                ) from None  # fmt: skip
            yield outcome
            hand_out()
    except (OSError, TimeoutError) as error:
        raise _lost(error) from None
    finally:
        for future in list(at_work):
            with contextlib.suppress(Exception):
                future.cancel()


def _lost(error: BaseException) -> StudyError:
    return StudyError(
        f"the scheduler was lost: {type(error).__name__}", key="--scheduler",
        hint="rows that were done are in the journal; the same command goes on from there",
    )  # fmt: skip


def _hand_on(bundle: Bundle) -> Bundle:
    return bundle


@lru_cache(maxsize=1)
def _planner(digest: str, folder: str) -> RowPlanner:
    return RowPlanner(Path(folder))


def _unpacked(bundle: Bundle) -> Path:
    """The folder of this worker process into which a bundle is unpacked."""
    import distributed

    worker = distributed.get_worker()
    known: dict[str, Path] = worker.__dict__.setdefault("_backhoe_planner_studies", {})
    if bundle.digest not in known:
        here = installed_versions()
        if here != dict(bundle.versions):
            other = {name: here.get(name) for name in bundle.versions if here.get(name) != bundle.versions[name]}
            raise StudyError(
                "a worker of the cluster has other versions", key="--scheduler", found=f"{other} on {worker.address}",
                allowed=str({name: bundle.versions[name] for name in other}),
            )  # fmt: skip
        folder = Path(tempfile.mkdtemp(prefix="study-", dir=worker.local_directory))  # Dask removes it with its own
        bundle.unpack(folder)
        known[bundle.digest] = folder
    return known[bundle.digest]


def _plan_row(bundle: Bundle, row: StudyRow) -> Outcome:
    with _ONE_AT_A_TIME:
        return _planner(bundle.digest, str(_unpacked(bundle))).plan(row)
