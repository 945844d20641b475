"""The lines of an OBJ, as its standard has them, and as trimesh reads them.

trimesh leaves out vertices after a byte order mark, after a tab or with CR as the end of a line, and so counts
others for a face; and it joins continued lines without a blank, so that 1 and 2 become 12.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from backhoe_planner.errors import InputError

_MARK = b"\xef\xbb\xbf"
_COUNTED = (b"v", b"f")  # keywords of vertices and faces


def obj_lines(path: Path) -> Iterator[tuple[int, list[bytes]]]:
    """The number, from 1, and the words of each line that is no comment; continued lines are one.

    Names may be in any encoding. A comment after a vertex or a face is left out.

    Raises
    ------
    InputError: the file is not text, a comment is continued, or a keyword is a capital V or F.
    OSError: the file cannot be read.
    """
    content = path.read_bytes().removeprefix(_MARK)
    if b"\0" in content:
        raise InputError("is not an OBJ that can be read: bytes of 0 are not text", file=path)
    for number, line in _joined(content, path) if b"\\" in content else enumerate(content.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith(b"#"):
            continue
        if words[0] in _COUNTED:
            yield number, _without_comment(words) if b"#" in line else words
        elif words[0].lower() in _COUNTED:
            found = words[0].decode()
            raise InputError("is no keyword of an OBJ", file=path, key=f"line {number}", found=found, allowed="v and f")
        else:
            yield number, words


def _joined(content: bytes, path: Path) -> Iterator[tuple[int, bytes]]:
    """The lines, with those that end with a backslash joined to the next one, and the number of the first of them."""
    line, first = b"", 0
    for number, own in enumerate(content.splitlines(), start=1):
        first, line = first or number, line + b" " + own.rstrip(b" \t")
        if not line.endswith(b"\\"):
            yield first, line
            line, first = b"", 0
        elif line.lstrip().startswith(b"#"):
            raise InputError("a comment ends with a backslash", file=path, key=f"line {number}", hint="delete it")
        else:
            line = line[:-1]
    if first:
        raise InputError("the file is cut short", file=path, found="a line that is continued by no other")


def _without_comment(words: list[bytes]) -> list[bytes]:
    return words[: next((at for at, word in enumerate(words) if word.startswith(b"#")), None)]


def plain_obj(path: Path) -> BinaryIO:
    """The lines of an OBJ, with one blank between words and no comments, as a file for trimesh."""
    return io.BytesIO(b"".join(b" ".join(words) + b"\n" for _, words in obj_lines(path)))
