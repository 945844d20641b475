"""Key paths: the place in a scene or a job that a text such as ``obstacles.pipe.position`` names.

The keys that are allowed at a place are read from the schema's own records. So a key that the template leaves
out can be a parameter too, and a key that does not exist is reported with the nearest name.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator, Mapping, MutableMapping, MutableSequence, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from backhoe_planner.errors import nearest_name
from backhoe_planner.files.records import described_fields

Address = tuple[str | int, ...]
_SEQUENCES = (tuple, list, Sequence)


class NoSuchKeyError(ValueError):
    """A key path leads nowhere; the message says where it ends and what is there."""

    def __init__(self, found: str, names: Sequence[str], *, within: Address = (), what: str = "key") -> None:
        near = nearest_name(found, names)
        hint = f"; did you mean {near!r}?" if near else "."
        place = f" in {spell(within)}" if within else ""
        super().__init__(f"there is no {what} {found!r}{place}{hint} Allowed: {', '.join(names) or 'none'}")


def spell(address: Address) -> str:
    """An address as a key path."""
    return ".".join(map(str, address))


def find_address(path: str, content: MutableMapping[str, Any], root: Any) -> Address:
    """The place in `content` that a key path names; missing keys above that place are created.

    Parameters
    ----------
    path: keys with dots between them; an entry of a list by its number from 0, or by its `name`.
    content: of the scene or job, plain data. Default entries are written out if the path needs them.
    root: the type of record that `content` describes, or an annotation.

    Raises
    ------
    NoSuchKeyError: the path leads nowhere.
    """
    address: list[str | int] = []
    node: Any = content
    kinds = list(members(root))
    rest = path
    while rest:
        at = tuple(address)
        if isinstance(node, MutableMapping) and (fields := _fields(kinds, node)):
            token, rest = _first(rest, fields)
            if token not in fields:
                raise NoSuchKeyError(token, sorted(fields), within=at)
            kinds = [kind for field in fields[token] for kind in members(field.annotation)]
            if rest:
                node[token] = _opened(node.get(token), kinds, fields[token][0], rest)
            node = node.get(token)
        elif isinstance(node, MutableMapping) and (entries := _entries(kinds, Mapping)):
            token, rest = _first(rest, node)
            kinds = [kind for entry in entries for kind in members(entry)]
            if rest:
                node[token] = _opened(node.get(token), kinds, None, rest)
            node = node.get(token)
        elif isinstance(node, MutableSequence):
            token, number, rest = _numbered(rest, node, at)
            kinds = [kind for entry in _entries(kinds, Sequence) for kind in members(entry)]
            address.append(number)
            node = node[number]
            continue
        else:
            raise NoSuchKeyError(_first(rest, ())[0], [], within=at)
        address.append(token)
    return tuple(address)


def descriptions_at(address: Address, content: Any, root: Any) -> tuple[str, ...]:
    """The schema's words about the field in which an address of `find_address` lies; "" for one without.

    An entry of a list or of a mapping lies in the field of the list or mapping. There are several words if `content`
    does not say of which record the field is; text has none.
    """
    found: tuple[str, ...] = ()
    node, kinds = content, list(members(root))
    for key in address:
        records = _records(kinds, node) if isinstance(node, Mapping) else []
        named = [(record, *pair) for record in records for pair in record.model_fields.items()]
        fields = [(record, name, field) for record, name, field in named if (field.alias or name) == key]
        if fields:
            kinds = [kind for _, _, field in fields for kind in members(field.annotation)]
            found = tuple(described_fields(record).get(name, "") for record, name, _ in fields if kinds != [str])
        else:
            entries = _entries(kinds, Mapping if isinstance(node, Mapping) else Sequence)
            kinds = [kind for entry in entries for kind in members(entry)]
        node = node.get(key) if isinstance(node, Mapping) else node[key] if isinstance(key, int) else None
    return found


def put(content: Any, address: Address, value: Any) -> None:
    """Write a value at an address."""
    *above, last = address
    node = content
    for part in above:
        node = node[part]
    node[last] = value


def members(annotation: Any) -> Iterator[Any]:
    """Every member of an annotation that is a union, with each `Annotated` unwrapped."""
    if isinstance(annotation, typing.TypeAliasType if hasattr(typing, "TypeAliasType") else ()):
        yield from members(annotation.__value__)
        return
    origin = typing.get_origin(annotation)
    if origin is Annotated:
        yield from members(typing.get_args(annotation)[0])
    elif origin in (typing.Union, types.UnionType):
        for one in typing.get_args(annotation):
            yield from members(one)
    elif annotation is not type(None):
        yield annotation


def is_record(kind: Any) -> bool:
    """Whether a member of an annotation is a record with fields."""
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _fields(kinds: Sequence[Any], node: Mapping[str, Any]) -> dict[str, list[FieldInfo]]:
    """The keys of the records among `kinds` that fit `node`, by their name in a file."""
    found: dict[str, list[FieldInfo]] = {}
    for record in _records(kinds, node):
        for name, field in record.model_fields.items():
            found.setdefault(field.alias or name, []).append(field)
    return found


def _records(kinds: Sequence[Any], node: Mapping[str, Any]) -> list[Any]:
    """The records among `kinds` that fit `node`; all of them if none does."""
    records = [kind for kind in kinds if is_record(kind)]
    return [record for record in records if _fits(record, node)] or records


def _fits(record: type[BaseModel], node: Mapping[str, Any]) -> bool:
    """Whether all keys of `node` belong to a record, and the keys that select a record have its values."""
    fields = {field.alias or name: field for name, field in record.model_fields.items()}
    chosen = (
        typing.get_origin(field.annotation) is not Literal or node.get(key) in typing.get_args(field.annotation)
        for key, field in fields.items()
        if key in node
    )
    return set(node) <= set(fields) and all(chosen)


def _entries(kinds: Sequence[Any], container: type) -> list[Any]:
    """The annotations of the entries of the lists, or of the mappings, among `kinds`."""
    found = []
    for kind in kinds:
        origin = typing.get_origin(kind)
        if container is Sequence and origin in _SEQUENCES:
            found += [one for one in typing.get_args(kind) if one is not Ellipsis]
        if container is Mapping and isinstance(origin, type) and issubclass(origin, Mapping):
            found.append(typing.get_args(kind)[1])
    return found


def _opened(node: Any, kinds: Sequence[Any], field: FieldInfo | None, rest: str) -> Any:
    """The value at a key below which the path continues: the value itself, its default, or an empty mapping."""
    if isinstance(node, (MutableMapping, MutableSequence)):
        return node
    if _first(rest, ())[0].isdigit() and _entries(kinds, Sequence) and field is not None and node is None:
        default = field.get_default(call_default_factory=True, validated_data={})
        if isinstance(default, (tuple, list)):
            return list(default)
    return {} if any(is_record(kind) for kind in kinds) or _entries(kinds, Mapping) else node


def _first(rest: str, names: Any) -> tuple[str, str]:
    """The first key of a path and the rest of it; a key may contain dots if it is one of `names`."""
    whole = [name for name in names if isinstance(name, str) and (rest == name or rest.startswith(f"{name}."))]
    first = max(whole, key=len, default="") or rest.partition(".")[0]
    return first, rest[len(first) + 1 :]


def _numbered(rest: str, node: Sequence[Any], at: Address) -> tuple[str, int, str]:
    """The first key of a path as the number of an entry of a list."""
    named = {one["name"]: number for number, one in enumerate(node) if isinstance(one, Mapping) and one.get("name")}
    token, after = _first(rest, named)
    if token in named:
        return token, named[token], after
    if token.isdecimal() and int(token) < len(node):
        return token, int(token), after
    numbers = [f"0 to {len(node) - 1}"] if node else []
    raise NoSuchKeyError(token, [*named, *numbers], within=at, what="entry")
