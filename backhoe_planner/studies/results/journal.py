"""A journal: one line for every case that is done, written at once.

A line begins with a checksum of the rest of it. If the last line is torn, because the program was killed or the
disk is full, its checksum is wrong: the line is dropped, and its case is computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time as clock
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from backhoe_planner.errors import OutputError, StudyError

VERSION = 1
_CHECKSUM = 16  # hexadecimal digits: one torn line in 1e19 would be taken for a whole one
_SYNC_EVERY = 1.0  # s, between writes to the disk itself, in case the computer loses power; chosen


class Journal:
    """The journal in a folder of results, open for writing; a context.

    Attributes
    ----------
    done: the records of the cases that are done, plain data by the identity of the case.
    """

    def __init__(self, file: Path, header: Mapping[str, Any], *, kind: str, free: str = "") -> None:
        """Open the journal, or begin one.

        Parameters
        ----------
        header: all that the cases share and that determines them, plain data.
        kind: what the journal is for: ``study``, or another word.
        free: keys that may differ from run to run, in words.

        Raises
        ------
        StudyError: the journal is for another study; says what differs.
        OutputError: it cannot be read or written.
        """
        self._file, self._kind, self._free = file, kind, free
        self.done: dict[str, Mapping[str, Any]] = {}
        try:
            end = self._read(header)
            self._stream: IO[bytes] = file.open("ab", buffering=0)
            os.truncate(file, end)  # drop a torn line
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror}", file=file) from error
        self._end, self._synced = end, 0.0
        if end == 0:
            self._write({"format": self._format, "version": VERSION, **header})

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            os.fsync(self._stream.fileno())
        self._stream.close()

    def add(self, identity: str, content: Mapping[str, Any]) -> None:
        """Record a case that is done, with its result.

        Raises
        ------
        OutputError: it cannot be written; the lines before remain as they are.
        """
        self._write({"id": identity, **content})
        self.done[identity] = content

    @property
    def _format(self) -> str:
        return f"backhoe-planner/{self._kind}"

    def _write(self, content: Mapping[str, Any]) -> None:
        line = _line(json.dumps(content, allow_nan=False, separators=(",", ":")).encode())
        try:
            left = line
            while left:  # a raw stream may write only a part
                left = left[self._stream.write(left) :]
            if clock.monotonic() - self._synced > _SYNC_EVERY:
                os.fsync(self._stream.fileno())
                self._synced = clock.monotonic()
        except OSError as error:
            with contextlib.suppress(OSError):
                os.truncate(self._file, self._end)
            raise OutputError(
                f"cannot be written: {error.strerror}", file=self._file,
                hint=f"{len(self.done)} of what is done are in it; the same command goes on from there",
            ) from error  # fmt: skip
        self._end += len(line)

    def _read(self, header: Mapping[str, Any]) -> int:
        """Read the existing file; return up to where it is intact [bytes]."""
        if not self._file.exists():
            return 0
        content = self._file.read_bytes()
        first, *lines = content.splitlines(keepends=True) or [b""]
        known = _content(first)
        if known is None and b"\n" not in content:
            return 0  # killed while the first line was written
        if not isinstance(known, dict) or known.get("format") != self._format or known.get("version") != VERSION:
            raise StudyError(f"is not the journal of a {self._kind}", file=self._file, hint="choose another folder")
        differs = _differences({key: known[key] for key in known if key not in ("format", "version")}, header)
        if differs:
            raise StudyError(
                f"holds the results of another {self._kind}", file=self._file.parent,
                found=f"another {', another '.join(differs)}",
                allowed=f"the {self._kind} it was begun with{f'; only {self._free} may change' if self._free else ''}",
                hint="choose another folder with -o, or begin anew with --anew",
            )  # fmt: skip
        end = 0 if known is None else len(first)
        for line in lines:
            found = _content(line)
            if isinstance(found, dict) and "id" in found:
                self.done[found["id"]] = found
            elif line is lines[-1]:
                break  # torn
            end += len(line)  # a damaged line in the middle is kept, and its case is computed again
        return end


def _line(payload: bytes) -> bytes:
    return hashlib.sha256(payload).hexdigest()[:_CHECKSUM].encode() + b" " + payload + b"\n"


def _content(line: bytes) -> Any:
    """The content of a line; None if it is torn or damaged."""
    payload = line[_CHECKSUM + 1 : -1]
    if _line(payload) != line:
        return None
    return json.loads(payload)


def _differences(before: Mapping[str, Any], now: Mapping[str, Any], above: str = "") -> list[str]:
    """The keys in which two headers differ, down to the entries of their mappings."""
    found = []
    for key in dict.fromkeys((*before, *now)):
        one, other = before.get(key), now.get(key)
        if isinstance(one, dict) and isinstance(other, Mapping):
            found += _differences(one, other, f"{above}{key} ")
        elif one != other:
            found.append(f"{above}{key}")
    return found
