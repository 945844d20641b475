"""Text files, read whole."""

from __future__ import annotations

from pathlib import Path

from backhoe_planner.errors import InputError


def read_text(path: Path, *, what: str, error: type[InputError] = InputError, formats: str | None = None) -> str:
    """The text of a file in UTF-8, without the byte order mark that it may begin with.

    Parameters
    ----------
    what: what the file holds, for messages, such as ``scene``.
    error: the class of the exception.
    formats: the formats that are allowed, for the message about a file that is not text.

    Raises
    ------
    error: the file does not exist, is empty, or cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        swapped = "; the machine comes before the file" if path.name.startswith("example:") else ""
        raise error(f"no such {what} file{swapped}", file=path) from None
    except IsADirectoryError:
        raise error(f"is a folder, not a {what} file", file=path) from None
    except UnicodeDecodeError as problem:
        said = f"is not UTF-8 text: {problem.reason} at byte {problem.start}"
        raise error(said, file=path, allowed=formats) from problem
    except OSError as problem:
        raise error(f"cannot be read: {problem.strerror}", file=path) from problem
    except ValueError as problem:  # the name has a character that no name can have
        raise error(f"no such {what} file", file=path) from problem
    if formats is not None and "\0" in text:
        raise error("is not text: it has bytes of 0", file=path, allowed=formats)
    if not text.strip():
        raise error("the file is empty", file=path, allowed=f"a {what}")
    return text
