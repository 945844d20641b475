"""Files that are written completely or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from backhoe_planner.errors import OutputError

# endings of other formats that this project writes or reads: JSON under one of them would be taken for that format
_TEXTS = (".html", ".htm", ".yaml", ".yml", ".urdf", ".xml")
_PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".tif", ".tiff")
_TABLES = (".csv", ".npz", ".npy", ".parquet", ".xyz", ".ply", ".stl", ".obj")
_OTHERS = frozenset((*_TEXTS, *_PICTURES, *_TABLES))


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[Any]]:
    """Open a file for writing; it appears under its name only once it is complete.

    If the name is a link, the file that it leads to is written.

    Parameters
    ----------
    path: where the file is to appear.
    mode: ``w`` for UTF-8 text with its line ends as they are, ``wb`` for bytes.

    Raises
    ------
    OutputError: the file cannot be written there.
    """
    target = check_writable(path)
    try:
        descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part")
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=target) from error
    part = Path(name)
    try:
        encoding, newline = (None, None) if "b" in mode else ("utf-8", "")
        with os.fdopen(descriptor, mode, encoding=encoding, newline=newline) as stream:
            yield stream
        mask = os.umask(0)
        os.umask(mask)
        part.chmod(0o666 & ~mask)
        part.replace(target)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=target) from error
    finally:
        part.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike[str]) -> Path:
    """The file to write, with links resolved; call this before the long work whose result it will hold.

    Raises
    ------
    OutputError: the path is a folder or a device, its folder does not exist or may not be written, links form
        a circle, or no file can have that name.
    """
    target, file = Path(path), os.fspath(path)  # messages name the path as given
    try:
        target = target.resolve() if target.is_symlink() else target
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            target.stat()  # of a circle of links it is an OSError, if `resolve` has not raised a RuntimeError before
    except (OSError, RuntimeError, ValueError) as error:
        said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OutputError(f"cannot be written: {said}", file=file) from error
    if target.is_dir():
        raise OutputError("is a folder; a file name is needed", file=file)
    if target.exists() and not target.is_file():
        raise OutputError("is not a regular file", file=file)
    if not target.parent.is_dir():
        raise OutputError("the folder does not exist", file=file, found=f"no {target.parent}", hint="create it first")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise OutputError("the folder may not be written", file=file, found=str(target.parent))
    return target


def check_ending(path: str | os.PathLike[str], allowed: Sequence[str], *, what: str) -> str:
    """The ending of a file's name in lower case, which must be one of `allowed`.

    Parameters
    ----------
    allowed: endings, such as ``.png``.
    what: what is to be written, for the message, such as ``a page``.

    Raises
    ------
    OutputError: the name has another ending.
    """
    ending = Path(path).suffix.lower()
    if ending not in allowed:
        raise OutputError(
            f"{what} cannot be written in this format", file=os.fspath(path), found=ending or "no ending",
            allowed=", ".join(allowed),
        )  # fmt: skip
    return ending


def check_apart(targets: Sequence[Path | None]) -> None:
    """Check that each output goes to a file of its own, by whatever name; None is not written.

    Raises
    ------
    OutputError: two of `targets` are one file.
    """
    found: set[str] = set()
    for target in targets:
        if target is None:
            continue
        place = os.path.realpath(target)
        if place in found:
            raise OutputError("is also the path of another output", file=target)
        found.add(place)


def check_record(path: str | os.PathLike[str], inputs: Iterable[Path]) -> None:
    """`check_output` for JSON: also check that the name is not that of a page, a figure, a table or a scene.

    Raises
    ------
    OutputError: the name has the ending of another kind of file; or see `check_output`.
    """
    check_output(path, inputs)
    ending = Path(path).suffix.lower().strip()
    if ending in _OTHERS:
        raise OutputError(
            "is the name of another kind of file than JSON", file=os.fspath(path), found=ending, allowed=".json",
        )  # fmt: skip


def check_output(path: str | os.PathLike[str], inputs: Iterable[Path]) -> None:
    """Check that a file can be written, see `check_writable`, and that it is none of the inputs of its content.

    Raises
    ------
    OutputError: it is one of `inputs`, by whatever name; or see `check_writable`.
    """
    target = check_writable(path)
    if target.exists() and any(target.samefile(given) for given in inputs if given.exists()):
        raise OutputError("is an input of this command", file=os.fspath(path), hint="write to another file")
