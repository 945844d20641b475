"""The user's cache folder: what takes seconds to work out, kept from one run to the next.

An entry begins with a checksum of what it was worked out from and of what follows. One that is damaged
counts as missing; one that cannot be written costs time only. The folder may be deleted at any time.
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
    """The folder of this package, whether or not it exists yet.

    In ``XDG_CACHE_HOME`` where it is set to an absolute path; else in the user's folder of caches on this system.
    A RuntimeError where the user has no home folder.
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
    """A digest of the code in `files` of a folder, and of the versions of the libraries that it calls."""
    from importlib.metadata import version

    digest = hashlib.sha256()
    for file in files:
        digest.update((folder / file).read_bytes())
    digest.update(" ".join(version(library) for library in libraries).encode())
    return digest.digest()


def read_entry(entry: Path, key: bytes) -> bytes | None:
    """What an entry holds; None where there is none for this `key`, or a damaged one."""
    try:
        content = entry.read_bytes()
    except OSError:
        return None
    body = content[_CHECKSUM:]
    return body if content[:_CHECKSUM] == hashlib.sha256(key + body).digest() else None


def keep_entry(entry: Path, key: bytes, body: bytes) -> None:
    """Write an entry, whole or not at all: another process may write the same one now."""
    with contextlib.suppress(OSError, OutputError):
        entry.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(entry, "wb") as file:
            file.write(hashlib.sha256(key + body).digest() + body)
