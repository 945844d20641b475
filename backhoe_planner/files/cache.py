"""The user's cache folder: results that take seconds to compute, kept from one run to the next.

An entry begins with a checksum of its inputs and of the content that follows. A damaged entry counts
as missing; if an entry cannot be written, this only costs time. The folder may be deleted at any time.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from backhoe_planner.errors import OutputError
from backhoe_planner.files.output_file import whole_file

_CHECKSUM = 32  # bytes


def caches() -> Path:
    """The cache folder of this package, whether or not it exists yet.

    It is in ``XDG_CACHE_HOME`` if that is set to an absolute path, otherwise in the user's cache folder on this
    system. A RuntimeError is raised if the user has no home folder.
    """
    home, asked = Path.home(), os.environ.get("XDG_CACHE_HOME", "")
    if Path(asked).is_absolute():
        above = Path(asked)
    elif sys.platform == "darwin":
        above = home / "Library" / "Caches"
    elif sys.platform == "win32":
        above = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    else:
        above = home / ".cache"
    return above / "backhoe_planner"


def maker_digest(folder: Path, files: Sequence[str], libraries: Sequence[str]) -> bytes:
    """A digest of the code in `files` of a folder, and of the versions of the libraries that the code calls."""
    from importlib.metadata import version

    digest = hashlib.sha256()
    for file in files:
        digest.update((folder / file).read_bytes())
    digest.update(" ".join(version(library) for library in libraries).encode())
    return digest.digest()


def read_entry(entry: Path, key: bytes) -> bytes | None:
    """The content of an entry; None if there is no entry for this `key`, or it is damaged."""
    try:
        content = entry.read_bytes()
    except OSError:
        return None
    body = content[_CHECKSUM:]
    return body if content[:_CHECKSUM] == hashlib.sha256(key + body).digest() else None


def keep_entry(entry: Path, key: bytes, body: bytes) -> None:
    """Write an entry completely or not at all: another process may be writing the same one."""
    with contextlib.suppress(OSError, OutputError):
        entry.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(entry, "wb") as file:
            file.write(hashlib.sha256(key + body).digest() + body)
