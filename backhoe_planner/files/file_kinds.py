"""The kinds of file that the commands take, known by how they begin or by their keys, so that the wrong one is told."""

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
    """What a file of one kind is called, and which command takes it; its name goes into the braces."""

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
_KEYS: dict[Kind, frozenset[str]] = {  # of which one is in every file of that kind, and in no other
    "scene": frozenset({"task"}),
    "job": frozenset({"dig"}),
    "study": frozenset({"scene", "job", "parameters"}),
}
_FORMATS: dict[str, Kind] = {"plan": "plan", "job": "job plan", "stand": "stand"}
_FORMAT = re.compile(r'"format":\s*"backhoe-planner/(\w+)"')  # as files that the package writes begin
_KEY = re.compile(r"""^["']?(\w+)["']?\s*:""", re.MULTILINE)  # of YAML that is not indented
_BEGINNING = 200  # characters in which the format stands


def refuse_other_kind(text: str, wanted: Kind, *, file: Path, error: type[InputError]) -> None:
    """Refuse a file that is of another kind than the one that is wanted; nothing where that cannot be told.

    Parameters
    ----------
    text: of the file.
    error: the class of what is raised.

    Raises
    ------
    error: says what the file seems to be, and what takes it.
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
        return None  # written by a program, and damaged or of another package
    return next((kind for kind in dict.fromkeys((wanted, *_KEYS)) if keys & _KEYS.get(kind, frozenset())), None)


def _keys(text: str) -> frozenset[str]:
    """The keys of the outermost mapping, as far as they can be told without reading all of YAML."""
    if text.lstrip().startswith("{"):
        try:
            content = json.loads(text)
        except (ValueError, RecursionError):
            return frozenset()
        return frozenset(map(str, content)) if isinstance(content, dict) else frozenset()
    return frozenset(_KEY.findall(text))
