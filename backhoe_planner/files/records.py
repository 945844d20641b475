"""Files with a schema: their records, and what is wrong with a file in words.

A schema is written once, as pydantic records. `explain` turns pydantic's complaints into
messages that name the key as it stands in the file, its line, what was found and what is
allowed, with the nearest name for a key that does not exist.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from backhoe_planner.errors import nearest_name
from backhoe_planner.files.yaml_text import KeyPath

__all__ = ["Record", "explain", "say"]

_NO_VARIANTS: Mapping[str, type[BaseModel]] = {}


class Record(BaseModel):
    """Keys that are not in the contract are refused; nothing changes after reading."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, populate_by_name=True, strict=False, use_attribute_docstrings=True
    )


def explain(
    error: ValidationError,
    content: Mapping[str, Any],
    lines: Mapping[KeyPath, int],
    *,
    root: type[BaseModel],
    variants: Mapping[str, type[BaseModel]] = _NO_VARIANTS,
) -> str:
    """What is wrong with `content`, one line for each problem.

    Parameters
    ----------
    lines: the line of every key, where it is known.
    root: the schema.
    variants: the records between which a tag chooses, by that tag.
    """
    problems = []
    for detail in error.errors(include_url=False):
        place = _place_in_file(detail["loc"], content, missing=detail["type"] == "missing")
        line = next((lines[place[:k]] for k in range(len(place), 0, -1) if place[:k] in lines), None)
        where = _spell(place) + (f" (line {line})" if line is not None else "")
        if detail["type"] == "extra_forbidden":
            what = _unknown_key(str(place[-1]), _keys_at(detail["loc"], root, variants))
        else:
            what = say(detail, variants)
        problems.append(": ".join(part for part in (where, what) if part))
    unique = list(dict.fromkeys(problems))
    if len(unique) == 1:
        return unique[0]
    return f"{len(unique)} problems\n" + "\n".join(f"  - {problem}" for problem in unique)


def say(detail: Any, variants: Mapping[str, type[BaseModel]] = _NO_VARIANTS) -> str:
    """One of pydantic's complaints in words, without the place."""
    kind, found = detail["type"], detail.get("input")
    if kind == "missing":
        return "is missing"
    if kind == "union_tag_not_found":
        return f"{_tag(detail)} is missing; allowed: {', '.join(_choices(detail, variants))}"
    if kind == "union_tag_invalid":
        tag = str(found.get(_tag(detail)) if isinstance(found, Mapping) else found)
        choices = _choices(detail, variants)
        near = nearest_name(tag, choices)
        hint = f"; did you mean {near!r}?" if near else "."
        return f"there is no {_tag(detail)} {tag!r}{hint} Allowed: {', '.join(choices)}"
    if kind == "value_error":
        return str(detail["ctx"]["error"])
    if kind == "too_long":
        has, most = detail["ctx"]["actual_length"], detail["ctx"]["max_length"]
        return f"has {has} entries, allowed: at most {most}" + (f"; found {found!r}" if len(str(found)) < 80 else "")
    shown = f"; found {found!r}" if not isinstance(found, (Mapping, list)) or len(str(found)) < 80 else ""
    if kind == "tuple_type":
        return f"is not a list{shown}"
    return f"{detail['msg'][0].lower()}{detail['msg'][1:]}{shown}"


def _tag(detail: Any) -> str:
    return str(detail["ctx"]["discriminator"]).strip("'")


def _choices(detail: Any, variants: Mapping[str, type[BaseModel]]) -> list[str]:
    """The tags among which the one that is complained about chooses."""
    return [name for name, record in variants.items() if _tag(detail) in record.model_fields]


def _unknown_key(key: str, allowed: list[str]) -> str:
    near = nearest_name(key, allowed)
    hint = f"; did you mean {near!r}?" if near else "."
    return f"there is no such key{hint} Allowed: {', '.join(sorted(allowed))}"


def _place_in_file(loc: tuple[str | int, ...], content: Any, *, missing: bool) -> KeyPath:
    """The key path without the names that pydantic adds for union members; `missing`: its last key is not there."""
    place: list[str | int] = []
    node = content
    for position, part in enumerate(loc):
        last = position == len(loc) - 1
        if isinstance(node, Mapping) and part in node:  # noqa: SIM114
            node = node[part]
        elif isinstance(node, (list, tuple)) and isinstance(part, int) and part < len(node):
            node = node[part]
        elif isinstance(node, Mapping) and isinstance(part, str) and last and missing:
            pass  # a key that is missing
        elif isinstance(node, (list, tuple)) and isinstance(part, int):
            pass
        else:
            continue
        place.append(part)
    return tuple(place)


def _spell(place: KeyPath) -> str:
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _keys_at(loc: tuple[str | int, ...], root: type[BaseModel], variants: Mapping[str, type[BaseModel]]) -> list[str]:
    """The keys that may stand where `loc` points, from the schema itself."""
    node = root
    for part in loc[:-1]:
        if isinstance(part, int):
            continue
        if part in variants and not _field(node, part):
            node = variants[part]
            continue
        field = _field(node, part)
        if field is not None:
            models = list(_models_in(field.annotation))
            node = models[0] if models else node
    return [field.alias or name for name, field in node.model_fields.items()]


def _field(model: type[BaseModel], key: str) -> Any:
    for name, field in model.model_fields.items():
        if key in (name, field.alias):
            return field
    return None


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in getattr(annotation, "__args__", ()):
        yield from _models_in(argument)
