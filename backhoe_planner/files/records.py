"""Files with a schema: their records, and messages that say what is wrong with a file.

A schema is written once, as pydantic records. `explain` turns pydantic's complaints into
messages that name the key as it is in the file, its line, what was found and what is
allowed, with the nearest name for a key that does not exist.
"""

from __future__ import annotations

import ast
import functools
import inspect
import itertools
import math
import re
import sys
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    model_validator,
)

from backhoe_planner.errors import InputError, nearest_name
from backhoe_planner.files.schema_keys import entries_at, field_at, fields_of, meant_by, record_at, variants
from backhoe_planner.files.yaml_text import DECIMAL_COMMA, KeyPath

_LARGEST_FIGURE = 1e30  # in any unit: its square is still finite
_WITH_COMMA = re.compile(r"[-+]?[0-9]+,[0-9]+")
# the unit in the docstring of a key: [m], [kg/m^3], [rad or m], ..., not [low, high]
_UNIT = re.compile(r"\[((?:kg|rad|deg|m|s|N|Nm|Pa|J|W|l)(?:[ /^][^\[\],]*)?)\]")
_BOUNDS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")  # complaints that end in a bound
_OF_NUMBERS = (*_BOUNDS, "float_type", "float_parsing", "finite_number")
_BRIEF = 80  # characters, about a line: longer values are not repeated in messages


def _figure(found: Any) -> Any:
    if isinstance(found, float) and _LARGEST_FIGURE < abs(found) < math.inf:
        raise ValueError(f"is {found:g}; allowed: at most {_LARGEST_FIGURE:g} either way")
    return math.nan if found is None else found


# a computed number, which may be nan; JSON has null for it
Figure = Annotated[float, Field(strict=True), BeforeValidator(_figure)]


class Record(BaseModel):
    """A part of a file with a schema: other keys are refused, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True, strict=False, defer_build=True)

    def __init__(self, /, **data: Any) -> None:
        """Make a record from keywords; a value that is not allowed is an InputError that names the key."""
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise InputError(explain(error, data, root=type(self)), key=type(self).__name__) from None

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse to set fields of the file; only names with an underscore, notes of the class itself, can be set."""
        if not name.startswith("_"):
            hint = f"model_copy(update={{{name!r}: ...}}) makes another, of which nothing is checked"
            raise InputError("does not change once it is made", key=f"{type(self).__name__}.{name}", hint=hint)
        super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        """Refuse to delete anything."""
        raise InputError("does not change once it is made", key=f"{type(self).__name__}.{name}")

    # pydantic then treats this `__init__` as its own, and reads records within records without calling it
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The JSON Schema, in which the docstring below a field describes it.

        Pydantic's `use_attribute_docstrings` would read the source of every record whenever it is imported.
        """
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name, text in described_fields(cls).items():
            field = cls.model_fields.get(name)  # None for an attribute of the class that is not in the file
            key = (field and field.alias) or name
            if key in properties:
                properties[key].setdefault("description", text)
        return schema


def described_fields(record: type[BaseModel]) -> dict[str, str]:
    """The docstrings below the fields of a record, its own and those it inherits, by the fields' names in the code."""
    found: dict[str, str] = {}
    for owner in record.__mro__:
        if issubclass(owner, Record):
            found = _described_fields(owner) | found
    return found


def _described_fields(record: type[BaseModel]) -> dict[str, str]:
    """The docstrings below the fields that a record itself adds."""
    body = _classes_of(record.__module__)[record.__qualname__]
    return {
        field.target.id: inspect.cleandoc(text.value.value)
        for field, text in itertools.pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


@functools.cache
def _classes_of(module: str) -> dict[str, list[ast.stmt]]:
    """The bodies of a module's classes by their qualified names; `inspect` would read the module for each class."""
    return dict(_class_bodies(ast.parse(inspect.getsource(sys.modules[module])), ""))


def _class_bodies(node: ast.AST, within: str) -> Iterator[tuple[str, list[ast.stmt]]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef):
            yield within + child.name, child.body
            yield from _class_bodies(child, f"{within}{child.name}.")
        elif isinstance(child, ast.FunctionDef):
            yield from _class_bodies(child, f"{within}{child.name}.<locals>.")
        elif isinstance(child, ast.stmt):
            yield from _class_bodies(child, within)


def exactly_one(*keys: str) -> Any:
    """A validator for a `Record`: exactly one of `keys` is given."""

    def check(record: Any) -> Any:
        if sum(getattr(record, key) is not None for key in keys) != 1:
            raise ValueError(f"exactly one of {', '.join(keys)} must be given")
        return record

    return model_validator(mode="after")(check)


def explain(
    error: ValidationError,
    content: Mapping[str, Any],
    *,
    root: type[BaseModel],
    lines: Mapping[KeyPath, int] | None = None,
) -> str:
    """What is wrong with `content`, one line for each problem.

    Parameters
    ----------
    error: pydantic's complaints about it.
    content: keys and values as in the file.
    root: the schema, or one that contains it.
    lines: the line of every key, if known.
    """
    tagged = variants(root)
    problems = []
    found = list(_of_one_kind(error.errors(include_url=False)))
    for detail in found:
        if detail["type"] == "too_short" and any(_is_within(other["loc"], detail["loc"]) for other in found):
            continue  # the list is only too short because pydantic does not count entries that are wrong
        place = _place_in_file(detail["loc"], content, missing=detail["type"] == "missing")
        is_short = detail["type"] == "missing" and isinstance(place[-1], int)  # the list, whose last entries it lacks
        place = place[:-1] if is_short else place
        above = (place[:k] for k in range(len(place), 0, -1))
        line = next((lines[part] for part in above if part in lines), None) if lines else None
        where = _spell(place) + (f" (line {line})" if line is not None else "")
        if detail["type"] == "extra_forbidden":
            record = record_at(detail["loc"], root, tagged)
            keys = sorted(fields_of(record))
            meant, at_top = meant_by(str(place[-1]), _at(place[:-1], content), record), False
            if meant is None or meant in keys:  # the same key elsewhere is more likely than a similar one here
                around = _same_key_around(detail["loc"], content, root, tagged)
                meant, at_top = (meant, False) if around is None else (_spell(around), len(around) == 1)
            hint = _meant(meant, at_top=at_top)
            what = f"there is no such key{hint} Allowed: {', '.join(keys)}"
        elif detail["type"].startswith("union_tag"):
            what = _wrong_tag(detail, tagged)
        elif detail["type"] == "tuple_type" and detail["input"] is not None:
            what = describe(detail, entries=entries_at(detail["loc"], root, tagged))
        elif is_short:
            given, entries = _at(place, content), entries_at(detail["loc"][:-1], root, tagged)
            what = f"has {len(given)} entries, allowed: {entries}{_brief(given)}"
        elif detail["type"] in _OF_NUMBERS:
            what = describe(detail, unit=_unit_at(detail["loc"], root, tagged))
        elif detail["type"] == "missing" and place == ("version",):
            what = f"{describe(detail)}; allowed: version: 1"
        else:
            what = describe(detail)
        problems.append(": ".join(part for part in (where, what) if part))
    unique = list(dict.fromkeys(problems))
    if len(unique) == 1:
        return unique[0]
    return f"{len(unique)} problems\n" + "\n".join(f"  - {problem}" for problem in unique)


def _is_within(place: tuple[Any, ...], other: tuple[Any, ...]) -> bool:
    return len(place) > len(other) and place[: len(other)] == other


def _unit_at(loc: tuple[str | int, ...], root: type[BaseModel], tagged: Mapping[str, type[BaseModel]]) -> str:
    """The unit of the number at `loc`, or of the list that it is in, as the docstring of its key has it; else empty."""
    field = field_at(loc, root, tagged)
    unit = None if field is None else _UNIT.search(described_fields(field[0]).get(field[1], ""))
    return unit.group(1) if unit else ""


def describe(detail: Any, *, unit: str = "", entries: str = "") -> str:
    """One of pydantic's complaints in plain words, without the place.

    Parameters
    ----------
    detail: an entry of `ValidationError.errors`.
    unit: of the number that it is about; empty if it has none.
    entries: what the list that it is about must hold; empty if that is not fixed.
    """
    kind, found = detail["type"], detail.get("input")
    if kind == "missing":
        return "is missing"
    if kind == "value_error":
        return str(detail["ctx"]["error"])
    brief = _brief(found)
    if kind == "too_long":
        count, most = detail["ctx"]["actual_length"], detail["ctx"]["max_length"]
        commas = isinstance(found, list) and count <= 2 * most and all(type(one) is int for one in found)
        hint = f"; {DECIMAL_COMMA}" if commas else ""
        return f"has {count} entries, allowed: at most {most}{brief}{hint}"
    if kind == "too_short":
        return f"has {detail['ctx']['actual_length']} entries, allowed: at least {detail['ctx']['min_length']}{brief}"
    shown = brief if isinstance(found, (Mapping, list)) else f"; found {found!r}"
    if kind == "literal_error":
        return _not_a_choice(str(found), shown, detail["ctx"]["expected"])
    if kind in ("model_type", "dict_type", "tuple_type") and found is None:
        return f"has no value; give {'a list' if kind == 'tuple_type' else 'keys and values'}, or leave the key out"
    if kind in ("model_type", "dict_type"):
        return f"does not hold keys and values{shown}; allowed: {{key: value, ...}}"
    if kind == "tuple_type":
        return f"is not a list{shown}; allowed: {f'a list of {entries}' if entries else '[...]'}"
    if kind in ("bool_type", "bool_parsing"):
        return f"is not true or false{shown}"
    if kind in ("float_type", "float_parsing") and isinstance(found, str) and _WITH_COMMA.fullmatch(found):
        return f"{DECIMAL_COMMA}{shown}; allowed: {found.replace(',', '.')}"
    what = f"{detail['msg'][0].lower()}{detail['msg'][1:]}"
    if unit:
        what += f" {unit}" if kind in _BOUNDS else f", in {unit}"
    return f"{what}{shown}"


def _brief(found: Any) -> str:
    """What was found, unless it is long."""
    return f"; found {found!r}" if len(str(found)) < _BRIEF else ""


def _not_a_choice(found: str, shown: str, expected: str) -> str:
    """The message for a value that is none of `expected`, which pydantic lists as: 'work', 'time' or ..."""
    near = nearest_name(found, expected.replace(" or ", ", ").replace("'", "").split(", "))
    hint = "without quotes" if near == found else f"did you mean {near!r}?"  # a number is not its text
    return f"is not one of the allowed values{shown}; allowed: {expected}" + (f" ({hint})" if near else "")


def _wrong_tag(detail: Any, tagged: Mapping[str, type[BaseModel]]) -> str:
    """The message for a key that chooses between records, if it is missing or chooses none."""
    key = str(detail["ctx"]["discriminator"]).strip("'")
    choices = sorted(tag for tag, record in tagged.items() if key in record.model_fields)
    if detail["type"] == "union_tag_not_found":
        return f"{key} is missing; allowed: {', '.join(choices)}"
    tag = str(detail["ctx"]["tag"])
    if key.endswith("()"):  # the kind of value chooses, not a key
        return f"is a {tag}; allowed: {{key: value, ...}}"
    return f"there is no {key} {tag!r}{_meant(nearest_name(tag, choices))} Allowed: {', '.join(choices)}"


def _meant(name: str | None, *, at_top: bool = False) -> str:
    return f"; did you mean {name!r}{' at the top level' if at_top else ''}?" if name else "."


def _same_key_around(
    loc: tuple[str | int, ...], content: Any, root: type[BaseModel], tagged: Mapping[str, type[BaseModel]]
) -> KeyPath | None:
    """The place of the last key of `loc` in the nearest record around that may have it and has not; None if none is."""
    key = loc[-1]
    places = [_place_in_file(loc[:end], content, missing=False) for end in range(len(loc))]
    for end in range(len(loc) - 1, 0, -1):
        place = places[end]
        is_key = isinstance(loc[end - 1], str) and len(place) > len(places[end - 1])
        if is_key and key in fields_of(record_at(loc[:end], root, tagged)) and key not in _at(place[:-1], content):
            return (*place[:-1], key)
    return None


def _of_one_kind(details: list[Any]) -> list[Any]:
    """The complaints; of those about a value that may be a number or a list or mapping, only those for its own kind."""

    def misses(detail: Any) -> bool:
        is_number_for_more = detail["type"] in ("tuple_type", "dict_type")
        return bool(
            detail["type"] == "float_type"
            if isinstance(detail.get("input"), (list, tuple, Mapping))
            else is_number_for_more
        )

    def is_answered(detail: Any) -> bool:
        """Whether the other member of the union, the last entry of the place, has a complaint too."""
        *above, member = detail["loc"]
        if not str(member).endswith(("float", "]")):
            return False
        beside = ([*one["loc"], ""] for one in details)
        return any(place[: len(above)] == above and place[len(above)] not in (member, "") for place in beside)

    return [detail for detail in details if not (misses(detail) and is_answered(detail))] or details


def _place_in_file(loc: tuple[str | int, ...], content: Any, *, missing: bool) -> KeyPath:
    """The path of keys in the file: `loc` without the names that pydantic adds for members of a union.

    missing: whether the last key is one that the file does not have.
    """
    place: list[str | int] = []
    node = content
    for part in loc[:-1] if missing else loc:
        if isinstance(node, Mapping):
            if part not in node:
                continue
            node = node[part]
        elif isinstance(node, (list, tuple)) and isinstance(part, int):
            node = node[part] if part < len(node) else None
        else:
            continue
        place.append(part)
    return (*place, *loc[-1:]) if missing else tuple(place)


def _at(place: KeyPath, content: Any) -> Any:
    for part in place:
        content = content[part]
    return content


def _spell(place: KeyPath) -> str:
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text
