"""The keys of a schema: which keys a place in a file may have, and where a misplaced key belongs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from backhoe_planner.errors import nearest_name

_HINTED_LEVELS = 2  # levels below a record that are searched for a place of a key that is not allowed there


def variants(root: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Every record within `root` that is chosen by a tag, by that tag."""
    found: dict[str, type[BaseModel]] = {}
    seen, todo = set[type[BaseModel]](), [root]
    while todo:
        record = todo.pop()
        if record in seen:
            continue
        seen.add(record)
        for field in record.model_fields.values():
            tags = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
            found |= {tag: record for tag in tags[:1] if len(tags) == 1 and isinstance(tag, str)}
            todo += _models_in(field.annotation)
    return found


def record_at(
    loc: tuple[str | int, ...], root: type[BaseModel], tagged: Mapping[str, type[BaseModel]]
) -> type[BaseModel]:
    """The record of the schema that contains the key at `loc`."""
    node, choices = root, [root]
    for part in loc[:-1]:
        below = [record for field in _fields_called(part, node) for record in _models_in(field.annotation)]
        if below:
            node, choices = below[0], below
        else:  # an index, or what pydantic adds for a member of a union: its tag, or the name of its record
            named = [record for record in choices if record.__name__ == part]
            node = named[0] if named else tagged.get(str(part), node)
    return node


def field_at(
    loc: tuple[str | int, ...], root: type[BaseModel], tagged: Mapping[str, type[BaseModel]]
) -> tuple[type[BaseModel], str] | None:
    """The innermost field on the way to `loc`: its record, and its name in the code; None if there is none.

    The last parts of `loc` may be indices, or what pydantic adds for a member of a union.
    """
    for end in range(len(loc), 0, -1):
        record = record_at(loc[:end], root, tagged)
        for name, field in record.model_fields.items():
            if loc[end - 1] in (name, field.alias):
                return record, name
    return None


def _fields_called(key: str | int, record: type[BaseModel]) -> list[FieldInfo]:
    return [field for name, field in record.model_fields.items() if key in (name, field.alias)]


def fields_of(record: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a record by their keys in a file."""
    return {field.alias or name: field for name, field in record.model_fields.items()}


def meant_by(key: str, given: Mapping[str, Any], record: type[BaseModel]) -> str | None:
    """The key that `key`, one of those `given` for a record that does not have it, seems to mean; None if unclear.

    It is the only place below the record that has such a key, such as `task.goal`, otherwise the key of the record
    with a similar spelling. If only names with numbers are given, they are taken for entries of a mapping.
    """
    found, fields = _places_below(key, [("", record)], depth=_HINTED_LEVELS), fields_of(record)
    if not found:
        near = nearest_name(key, sorted(fields))
        if near is not None:
            return near
        if all(isinstance(value, (int, float)) for value in given.values()) and fields.keys().isdisjoint(given):
            found = {f"{name}.{key}" for name, field in fields.items() if _takes_numbers_by_name(field.annotation)}
    return found.pop() if len(found) == 1 else None


def _places_below(key: str, records: Sequence[tuple[str, type[BaseModel]]], *, depth: int) -> set[str]:
    """The places of `key` below the `records`, each given with the beginning of its place, at the least depth."""
    below = [
        (f"{beginning}{name}.", inner)
        for beginning, record in records
        for name, field in fields_of(record).items()
        for inner in _models_in(field.annotation, in_lists=False)
    ]
    found = {f"{beginning}{key}" for beginning, inner in below if key in fields_of(inner)}
    return found if found or depth == 1 else _places_below(key, below, depth=depth - 1)


def _takes_numbers_by_name(annotation: Any) -> bool:
    key, value = (*get_args(annotation), None, None)[:2]
    if get_origin(annotation) is dict:
        return key is str and any(part is float for part in (value, *get_args(value)))
    return any(_takes_numbers_by_name(argument) for argument in get_args(annotation))


def entries_at(loc: tuple[str | int, ...], root: type[BaseModel], tagged: Mapping[str, type[BaseModel]]) -> str:
    """How many numbers the list at `loc` has, in words; empty if that is not fixed."""
    found = field_at(loc, root, tagged)
    count = 0 if found is None else _entries_of(found[0].model_fields[found[1]].annotation)
    return f"{count} numbers" if count else ""


def _entries_of(annotation: Any) -> int:
    """How many entries a list has that an annotation, or a member of its union, accepts; 0 if that is not fixed."""
    entries = get_args(annotation)
    if get_origin(annotation) is tuple:
        return 0 if Ellipsis in entries else len(entries)
    return next((count for count in map(_entries_of, entries) if count), 0)


def _models_in(annotation: Any, *, in_lists: bool = True) -> Iterator[type[BaseModel]]:
    """The records that `annotation` accepts; without `in_lists` not those that it accepts only in a list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    if in_lists or get_origin(annotation) is not tuple:
        for argument in getattr(annotation, "__args__", ()):
            yield from _models_in(argument, in_lists=in_lists)
