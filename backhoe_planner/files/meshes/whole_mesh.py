"""The check that a text file of points or triangles is complete: a file that was cut short or broken is refused."""

from __future__ import annotations

from pathlib import Path

from backhoe_planner.errors import InputError
from backhoe_planner.files.meshes.obj_lines import obj_lines

_HEADER = 1_000_000  # bytes in which the header of a PLY ends
_NUMBERS = (3, 4, 6, 7)  # of a vertex in an OBJ: position, perhaps a weight, perhaps a colour
_SHOWN = 60  # bytes of a wrong line in a message; chosen


def check_whole(path: Path) -> None:
    """Compare the lines of an ASCII PLY or OFF with the counts in its header, and look for the end of an ASCII STL.

    In an OBJ, whose reader lets numbers run on from line to line, check that each vertex has its numbers and each
    face its vertices. Other files do not tell whether they are complete, or are checked where they are read.

    Raises
    ------
    InputError: the counts differ from the header, or the end is missing; a vertex or face of an OBJ is invalid.
    OSError: the file cannot be read.
    """
    kind = path.suffix.lower()
    content = path.read_bytes() if kind in (".ply", ".off", ".stl") else b""
    if kind == ".ply":
        _check_ply(path, content)
    elif kind == ".off":
        _check_off(path, content)
    elif kind == ".obj":
        _check_obj(path)
    elif kind == ".stl" and _is_text_stl(content) and b"endsolid" not in content[-_HEADER:]:
        raise InputError("the file is cut short", file=path, found="no line with endsolid", allowed="a whole file")


def has_single_precision(path: Path) -> bool:
    """Whether the coordinates in a file of points or triangles are floats of 32 bits, or are read as such (DAE).

    Raises
    ------
    OSError: the file cannot be read.
    """
    kind = path.suffix.lower()
    with path.open("rb") as file:
        beginning = file.read(_HEADER)
    if kind == ".ply":
        head = beginning.partition(b"end_header")[0].split()
        return any(
            head[at : at + 3] in ([b"property", b"float", b"x"], [b"property", b"float32", b"x"])
            for at in range(len(head))
        )
    return kind in (".dae", ".glb", ".gltf") or (kind == ".stl" and not _is_text_stl(beginning))


def _check_ply(path: Path, content: bytes) -> None:
    head, end, _ = content[:_HEADER].partition(b"end_header")
    if not end or b"format ascii" not in head:
        return
    counts = {}
    for line in head.splitlines():
        kind = line.split()
        if len(kind) == 3 and kind[0] == b"element" and kind[2].isdigit():
            counts[kind[1].decode(errors="replace")] = int(kind[2])
    body, asked = content[len(head) + len(end) :], sum(counts.values())
    found = body.strip().count(b"\n") + 1
    if found != asked:  # some lines may be empty
        found = sum(1 for line in body.splitlines() if line.strip())
    words = " and ".join(f"{count} of {name}" for name, count in counts.items())
    if found > asked:
        said = f"{asked}: {words}"
        raise InputError("the file holds more than its header says", file=path, found=f"{found} lines", allowed=said)
    _check_rows(path, found, asked, words)


def _check_off(path: Path, content: bytes) -> None:
    lines = [line.partition(b"#")[0] for line in content.splitlines()]
    strange = next((number for number, line in enumerate(lines, start=1) if b"_" in line or not line.isascii()), None)
    if strange is not None:
        found = lines[strange - 1][:_SHOWN].decode(errors="replace").strip()
        raise InputError("is not a line of numbers", file=path, key=f"line {strange}", found=found)
    words = b" ".join(lines[:20]).split()
    if not words or not words[0].upper().endswith(b"OFF"):
        return
    if len(words) < 3 or not (words[1].isdigit() and words[2].isdigit()):
        return
    vertices, faces = int(words[1]), int(words[2])
    written = [line for line in lines if line.strip()]
    # the counts are on the first line or on a line of their own
    rows = len(written) - (1 if len(written[0].split()) > 1 else 2)
    _check_rows(path, rows, vertices + faces, f"{vertices} of vertices and {faces} of faces")


def _check_obj(path: Path) -> None:
    vertices, sizes, faces = 0, set[int](), list[tuple[int, list[int]]]()
    counted_back = 0  # number of vertices before the first face that counts back from the last vertex
    for number, words in obj_lines(path):
        if words[:1] == [b"v"]:
            vertices += 1
            sizes.add(len(words) - 1)
            if len(words) - 1 not in _NUMBERS or len(sizes) > 1:
                allowed = "v x y z, with or without a weight or a colour, the same in all lines"
                raise _wrong_line(path, number, words, "a vertex as those before", allowed)
        elif words[:1] == [b"f"]:
            corners = [word.partition(b"/")[0] for word in words[1:]]
            if len(corners) < 3 or not all(word.removeprefix(b"-").isdigit() and int(word) for word in corners):
                raise _wrong_line(path, number, words, "a face", "f and three vertices or more, numbered from 1")
            own = [int(word) for word in corners]
            faces.append((number, own))
            if min(own) < 0:
                counted_back = counted_back or vertices
                own.append(-min(own))  # at least this many vertices are needed
    for number, own in faces:
        if max(own) > vertices:
            raise InputError(
                "a face has a vertex that is not there", file=path, key=f"line {number}", found=f"{vertices} vertices"
            )
    if 0 < counted_back < vertices:
        raise InputError(
            "a face counts vertices back from the last one, and others follow", file=path, allowed="numbers from 1"
        )


def _wrong_line(path: Path, number: int, words: list[bytes], what: str, allowed: str) -> InputError:
    found = b" ".join(words)[:_SHOWN].decode(errors="replace")
    return InputError(f"is not {what}", file=path, key=f"line {number}", found=found, allowed=allowed)


def _is_text_stl(content: bytes) -> bool:
    return content.lstrip()[:5].lower() == b"solid" and b"facet" in content[:_HEADER] and b"\0" not in content[:_HEADER]


def _check_rows(path: Path, found: int, asked: int, words: str) -> None:
    if found < asked:
        raise InputError("the file is cut short", file=path, found=f"{found} lines", allowed=f"{asked}: {words}")
