"""Proves recordings and writes them; a recording that cannot be written is kept, and writing is tried again.

A recording goes to its file. If that cannot be written (the disk is full, the folder is gone), it goes under the same
name to another folder. If no folder is writable, the recording is kept in memory and tried again from time to time,
with the next recording, and at the end. Some descriptors are reserved, so that a file can be opened even when
connections have used up all others.
"""

from __future__ import annotations

import contextlib
import os
import queue
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from backhoe_planner.errors import InputError
from backhoe_planner.machine import Robot
from backhoe_planner.planning import Plan
from backhoe_planner.show.teleop.session import Recording
from backhoe_planner.site import Scene

_AGAIN = 10.0  # s after which writing is tried again; chosen, a person frees a disk no faster
_HELD_BACK = 4  # descriptors: a file and its folder, twice


@dataclass
class _Kept:
    """A recording that is not in a file yet, and its plan once it is proven."""

    recording: Recording
    plan: Plan | None = None


class Recorder:
    """Proves and writes recordings, one after the other, in a thread of its own.

    Parameters
    ----------
    output: the file to be written; an existing file is never overwritten, further recordings get a number.
    tell: called with facts about a recording: `writing`; `file`, `verdict`, `seconds`, `zones`, `left_out`, and
        `instead`, which says why it is not in the intended file; or `error`.
    """

    def __init__(self, robot: Robot, scene: Scene, output: Path, tell: Callable[..., None]) -> None:
        self._robot, self._scene, self._output, self._tell = robot, scene, output, tell
        self._queue: queue.SimpleQueue[Recording | None] = queue.SimpleQueue()
        self._kept: list[_Kept] = []
        self._working = False
        self._spare = _hold_back()
        self._thread = threading.Thread(target=self._run, name="teleop recordings", daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether a recording is still to be proven or written."""
        return self._working or not self._queue.empty()

    @property
    def unwritten(self) -> tuple[Plan, ...]:
        """Plans of recordings that could not be written anywhere yet."""
        return tuple(kept.plan for kept in self._kept if kept.plan is not None)

    def take(self, recording: Recording) -> None:
        """Prove and write a recording, after the earlier ones."""
        self._queue.put(recording)

    def close(self) -> None:
        """Wait until everything is written, or has been tried once more. May be called again."""
        self._queue.put(None)
        self._thread.join()
        while self._spare:
            os.close(self._spare.pop())

    def _run(self) -> None:
        ended = False
        while not ended:
            try:
                recording = self._queue.get(timeout=_AGAIN if self.unwritten else None)
            except queue.Empty:
                self._write_kept(again=True)
                continue
            ended = recording is None
            if recording is not None:
                self._working = True
                self._kept.append(_Kept(recording))
                self._tell(writing=True)
            self._write_kept(again=False)
            self._working = False

    def _write_kept(self, *, again: bool) -> None:
        """Write what is not written yet; `again` skips recordings that could not be proven: waiting does not help."""
        for kept in list(self._kept):
            try:
                if kept.plan is None and not again:
                    kept.plan = kept.recording.plan(self._robot, self._scene)
                if kept.plan is not None:
                    self._write(kept.recording, kept.plan)
                    self._kept.remove(kept)
            except (InputError, OSError) as error:
                self._tell(error=f"{error}; the recording is kept, and tried again")
            except Exception as error:  # noqa: BLE001  the next recording is written all the same
                self._tell(error=f"the recording could not be written: {type(error).__name__}; it is kept")

    def _write(self, recording: Recording, plan: Plan) -> None:
        """Write a plan to the first place that accepts it.

        Raises
        ------
        InputError, OSError: no place does; the error is that of the first.
        """
        problems: list[InputError | OSError] = []
        for place in (self._output, *(folder / self._output.name for folder in other_folders())):
            try:
                with self._room_to_open():
                    file = free_name(place)
                    plan.save(file)
            except (InputError, OSError) as error:
                problems.append(error)
                continue
            self._tell(
                file=str(file), verdict=plan.verdict, seconds=recording.duration, zones=len(plan.findings.zones),
                left_out=recording.notes, instead=str(problems[0]) if problems else "",
            )  # fmt: skip
            return
        raise problems[0]

    @contextlib.contextmanager
    def _room_to_open(self) -> Iterator[None]:
        """Release the reserved descriptors, and reserve them again afterwards."""
        while self._spare:
            os.close(self._spare.pop())
        try:
            yield
        finally:
            self._spare = _hold_back()


def other_folders() -> tuple[Path, ...]:
    """Folders for a recording that cannot be written to its intended one, the likeliest first."""
    return Path.cwd(), Path.home(), Path(tempfile.gettempdir())


def free_name(path: Path) -> Path:
    """`path`, or, if that exists, the first of ``name-2``, ``name-3``, ... that does not."""
    found, number = path, 2
    while found.exists():
        found = path.with_name(f"{path.stem}-{number}{path.suffix}")
        number += 1
    return found


def _hold_back() -> list[int]:
    found: list[int] = []
    with contextlib.suppress(OSError):
        while len(found) < _HELD_BACK:
            found.append(os.open(os.devnull, os.O_RDONLY))
    return found
