"""The folder of a study's results; one run at a time writes to it."""

from __future__ import annotations

import fcntl
import shutil
from pathlib import Path
from typing import IO

from backhoe_planner.errors import OutputError, StudyError

JOURNAL, TABLE, TIMINGS, PLANS, PAGE = "journal.jsonl", "table.parquet", "timings.parquet", "plans", "study.html"
_LOCK, _SCRATCH = ".lock", ".work"


class ResultsFolder:
    """A folder of results while a study runs in it; a context.

    Attributes
    ----------
    path: of the folder.
    """

    def __init__(self, path: Path, *, anew: bool = False) -> None:
        """Make the folder if there is none, and lock it against other runs.

        Parameters
        ----------
        anew: whether to delete the results of a study that are in it.

        Raises
        ------
        OutputError: it is a file, cannot be written, or contains a table but no journal.
        StudyError: another run writes to it.
        """
        self.path = path
        if path.exists() and not path.is_dir():
            raise OutputError("is a file; a folder is needed for the results of a study", file=path)
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._lock: IO[str] = (path / _LOCK).open("w")
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror}", file=path) from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._lock.close()
            raise StudyError(
                "another run writes its results here", file=path, hint="wait for it, or choose another folder"
            ) from None
        except OSError as error:
            self._lock.close()
            raise OutputError(
                f"cannot be kept from other runs: {error.strerror}", file=path, hint="choose a folder on a local disk"
            ) from error
        if (path / TABLE).exists() and not self.journal.exists():
            self._lock.close()
            raise OutputError(
                f"holds a {TABLE} but no {JOURNAL}, so that it is not of a study", file=path,
                hint="choose another folder",
            )  # fmt: skip
        if anew and self.journal.exists():
            for name in (JOURNAL, TABLE, TIMINGS, PAGE):
                (path / name).unlink(missing_ok=True)
            shutil.rmtree(path / PLANS, ignore_errors=True)
        shutil.rmtree(self.scratch, ignore_errors=True)  # left by a run that was killed

    def __enter__(self) -> ResultsFolder:
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self.scratch, ignore_errors=True)
        self._lock.close()  # the file stays: another run may be opening it now

    @property
    def journal(self) -> Path:
        """The journal's file."""
        return self.path / JOURNAL

    @property
    def scratch(self) -> Path:
        """The folder for temporary files of a run."""
        return self.path / _SCRATCH

    def plan_file(self, row: int) -> Path:
        """The file of a row's plan."""
        return self.path / PLANS / f"{row:06d}.json"
