"""The kinds of file that the commands take, told by their beginning or keys, so that a wrong one is recognised."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from backhoe_planner.errors import InputError

Kind = Literal["scene", "job", "study", "plan", "job plan", "stand", "urdf"]


@dataclass(frozen=True)
class _FileKind:
    """The words for one kind of file, and which command takes it; the file's name goes into the braces."""

    words: str
    taken: str


_KINDS: dict[Kind, _FileKind] = {
    "scene": _FileKind("a scene", "`backhoe-planner plan URDF {}` takes it"),
    "job": _FileKind("a job", "`backhoe-planner job {0}` and `backhoe-planner stand {0}` take it"),
    "study": _FileKind("a study", "`backhoe-planner study {}` takes it"),
    "plan": _FileKind("a plan", "`backhoe-planner view`, `check`, `plot` and `export` take it"),
    "job plan": _FileKind("the plan of a job", "`backhoe-planner check`, `view --html` and `export` take it"),
    "stand": _FileKind("the answer of `backhoe-planner stand`", "the jobs and the plans of its places lie beside it"),
    "urdf": _FileKind(
        "a URDF", "`backhoe-planner plan {0} SCENE` takes it, before the scene, and `backhoe-planner inspect {0}`"
    ),
}
_KEYS: dict[Kind, frozenset[str]] = {  # every file of that kind has one of these keys, and no other file does
    "scene": frozenset({"task"}),
    "job": frozenset({"dig"}),
    "study": frozenset({"scene", "job", "parameters"}),
}
_FORMATS: dict[str, Kind] = {"plan": "plan", "job": "job plan", "stand": "stand"}
_FORMAT = re.compile(r'"format":\s*"backhoe-planner/(\w+)"')  # the beginning of files that the package writes
_KEY = re.compile(r"""^["']?(\w+)["']?\s*:""", re.MULTILINE)  # a key of YAML that is not indented
_BEGINNING = 200  # characters from the start that contain the format


def refuse_other_kind(text: str, wanted: Kind, *, file: Path, error: type[InputError]) -> None:
    """Refuse a file of another kind than the `wanted` one; do nothing if the kind is not recognised.

    Parameters
    ----------
    text: of the file.
    error: the class of the exception.

    Raises
    ------
    error: says what the file seems to be, and which command takes it.
    """
    found = _kind_of(text, wanted)
    if found is not None and found != wanted:
        kind = _KINDS[found]
        raise error(f"is {kind.words}, not {_KINDS[wanted].words}", file=file, hint=kind.taken.format(file.name))


def _kind_of(text: str, wanted: Kind) -> Kind | None:
    beginning = text[:_BEGINNING].lstrip("\ufeff \t\r\n")
    written = _FORMAT.search(beginning)
    if written is not None:
        return _FORMATS.get(written[1])
    if beginning.startswith("<"):
        return "urdf" if "<robot" in text else None
    keys = _keys(text)
    if "format" in keys:
        return None  # a program wrote it: it is damaged, or from another package
    return next((kind for kind in dict.fromkeys((wanted, *_KEYS)) if keys & _KEYS.get(kind, frozenset())), None)


def _keys(text: str) -> frozenset[str]:
    """The keys of the outermost mapping, as far as they are recognised without parsing the YAML."""
    if text.lstrip().startswith("{"):
        try:
            content = json.loads(text)
        except (ValueError, RecursionError):
            return frozenset()
        return frozenset(map(str, content)) if isinstance(content, dict) else frozenset()
    return frozenset(_KEY.findall(text))
