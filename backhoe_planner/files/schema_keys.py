"""The keys of a schema: which may stand at a place of a file, and where one that stands in the wrong place belongs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from backhoe_planner.errors import nearest_name

_HINTED_LEVELS = 2  # below a key that is not allowed, in which a place for it is looked for


def variants(root: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Every record within `root` that a tag chooses, by that tag."""
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
    """The record that holds the key to which `loc` points, from the schema itself."""
    node, choices = root, [root]
    for part in loc[:-1]:
        below = [record for field in _fields_called(part, node) for record in _models_in(field.annotation)]
        if below:
            node, choices = below[0], below
        else:  # an index, or what pydantic adds for the member of a union: its tag, or the name of its record
            named = [record for record in choices if record.__name__ == part]
            node = named[0] if named else tagged.get(str(part), node)
    return node


def _fields_called(key: str | int, record: type[BaseModel]) -> list[FieldInfo]:
    return [field for name, field in record.model_fields.items() if key in (name, field.alias)]


def fields_of(record: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a record by their keys as they stand in a file."""
    return {field.alias or name: field for name, field in record.model_fields.items()}


def meant_by(key: str, given: Mapping[str, Any], record: type[BaseModel]) -> str | None:
    """What `key`, one of those `given` for a record that does not have it, seems to stand for; None where that is open.

    That is the only place below where such a key may stand, as `task.goal`, else the key of the record that is spelt
    nearly so. Names with numbers count as a mapping of them where nothing else is given.
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
    """Where `key` may stand in what the `records` hold, each with how its place begins, at the least depth."""
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
    """How many numbers the list at `loc` has, in words; nothing where that is not fixed."""
    for field in _fields_called(loc[-1], record_at(loc, root, tagged)):
        for annotation in (field.annotation, *get_args(field.annotation)):
            entries = get_args(annotation) if get_origin(annotation) is tuple else ()
            if entries and Ellipsis not in entries:
                return f", {len(entries)} numbers"
    return ""


def _models_in(annotation: Any, *, in_lists: bool = True) -> Iterator[type[BaseModel]]:
    """The records that `annotation` takes; without `in_lists` those of which it takes one, not a list of them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    if in_lists or get_origin(annotation) is not tuple:
        for argument in getattr(annotation, "__args__", ()):
            yield from _models_in(argument, in_lists=in_lists)
