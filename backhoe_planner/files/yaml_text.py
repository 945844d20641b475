"""YAML as a person means it: no duplicate keys, no tabs, numbers as in YAML 1.2.

PyYAML's own loader keeps the last of two equal keys, reads ``1e-3`` as text and
``no`` as false; this one does not, and it knows the line of each key.
The text is parsed by libyaml, in a tenth of the time, where PyYAML has it; what libyaml
refuses is parsed once more in Python, whose messages say more.
ruamel.yaml was tried instead: it reports a duplicate key without its path and its
first line, and accepts lists as keys. With both corrected by hand the code was as long as
this, and reading a scene of 20 lines took two to three times as long.
"""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.files.file_kinds import Kind, refuse_other_kind
from backhoe_planner.files.text_file import read_text

KeyPath = tuple[str | int, ...]

# keys and entries of one file, aliases expanded: 1 kB of aliases can expand to 10^9 of them
_MOST_KEYS = 200_000


_TAGS = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq", "str", "int", "float", "bool", "null"))
DECIMAL_COMMA = "a number takes a decimal point, not a comma"
# what PyYAML says it was reading, and the sign with which that begins
_SIGNS = {"flow mapping": "{", "flow sequence": "[", "quoted scalar": "quotation mark"}
_WHOLE_NUMBER = re.compile(r"[-+]?[0-9]+")
_HALF_CHARACTER = re.compile("[\ud800-\udfff]")  # surrogates, which no file in UTF-8 can hold


class _Loader(yaml.SafeLoader):
    """SafeLoader with the scalars of YAML 1.2's core schema."""


_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", "tTfF"),
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("int", r"^[-+]?[0-9]+$", "-+0123456789"),
    ("float", r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$", "-+.0123456789"),
    ("float", r"^(?:[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$", "-+."),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(_pattern), list(_first))


_Loader.add_constructor("tag:yaml.org,2002:int", lambda _, node: int(node.value))
_Loader.add_constructor(
    "tag:yaml.org,2002:float",
    lambda _, node: float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan")),
)


if yaml.__with_libyaml__:
    from yaml._yaml import CParser

    class _CompiledLoader(Composer, CParser, SafeConstructor, Resolver):
        """A loader of libyaml's events. They are composed in Python: libyaml would end the process if nested deeply."""

        yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers
        yaml_constructors = _Loader.yaml_constructors

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            for base in (Composer, SafeConstructor, Resolver):
                base.__init__(self)


def _composed(text: str) -> tuple[yaml.SafeLoader, yaml.Node | None]:
    """The loader of a text, and the node of its document."""
    if yaml.__with_libyaml__ and "\t" not in text:  # libyaml takes some tabs for spaces
        try:
            quick: Any = _CompiledLoader(text)
            return quick, quick.get_single_node()
        except (yaml.YAMLError, ValueError, RecursionError):
            pass  # the plain parser says what is wrong
    loader = _Loader(text)
    return loader, loader.get_single_node()


def read_yaml(
    path: Path,
    *,
    what: str = "scene",
    keys: str = "version, task, ...",
    kind: Kind | None = None,
    error: type[InputError] = SceneError,
) -> tuple[dict[str, Any], dict[KeyPath, int]]:
    """The mapping in a YAML file, and the line (from 1) of every key in it.

    Parameters
    ----------
    path: the file.
    what, keys: for messages: what the file holds, and some of its keys.
    kind: the kind of file, if a command takes it; a file of another kind is refused.
    error: the class of the exception.

    Raises
    ------
    error: the file cannot be read, is empty, is not YAML, or has a key twice.
    """
    text = read_text(path, what=what, error=error)
    if kind is not None:
        refuse_other_kind(text, kind, file=path, error=error)
    loader: yaml.SafeLoader | None = None
    try:
        loader, node = _composed(text)
        if not isinstance(node, yaml.MappingNode):
            raise error("does not hold keys and values", file=path, allowed=f"a {what}: {keys}")
        lines: dict[KeyPath, int] = {}
        _note_lines(node, (), lines, path, error)
        content = loader.construct_document(node)
    except yaml.YAMLError as problem:
        raise error(_describe(problem), file=path) from problem
    except InputError:
        raise
    except (AttributeError, LookupError, TypeError) as problem:  # raised inside PyYAML's constructors
        raise error("cannot be read: a tag does not fit its value", file=path) from problem
    except (ValueError, RecursionError) as problem:
        raise error(f"cannot be understood: {problem}", file=path) from problem
    finally:
        if loader is not None:
            loader.dispose()
    return content, lines


def _note_lines(node: yaml.Node, at: KeyPath, lines: dict[KeyPath, int], path: Path, error: type[InputError]) -> None:
    """Add the line of every key and entry below `node`, whose place is `at`, to `lines`."""
    if len(lines) > _MOST_KEYS:
        raise error(f"holds more than {_MOST_KEYS} entries, counting what its aliases stand for", file=path)
    where = f"{'.'.join(map(str, at))} (line {node.start_mark.line + 1})" if at else None
    if node.tag not in _TAGS:
        allowed = ", ".join(f"!!{tag.rpartition(':')[2]}" for tag in _TAGS)
        raise error("the tag is none of YAML's core schema", file=path, key=where, found=node.tag, allowed=allowed)
    if isinstance(node, yaml.ScalarNode) and _HALF_CHARACTER.search(node.value):
        raise error("a text contains an incomplete character", file=path, key=where, found=ascii(node.value))
    if isinstance(node, yaml.MappingNode):
        _refuse_decimal_comma(node, at, path, error)
        for key, value in node.value:
            place = (*at, str(key.value))
            if place in lines:
                raise error(
                    "the key stands twice",
                    file=path,
                    key=".".join(map(str, place)),
                    found=f"line {lines[place]} and line {key.start_mark.line + 1}",
                )
            lines[place] = key.start_mark.line + 1
            _note_lines(value, place, lines, path, error)
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            lines[(*at, index)] = value.start_mark.line + 1
            _note_lines(value, (*at, index), lines, path, error)


def _refuse_decimal_comma(node: yaml.MappingNode, at: KeyPath, path: Path, error: type[InputError]) -> None:
    """Raise `error` if a number is written with a comma: {a: 0,9} is a: 0 and another key, 9, without a value."""
    for (name, before), (key, after) in itertools.pairwise(node.value if node.flow_style else ()):
        whole, part = str(before.value), str(key.value)
        if after.value == "" and part.isdecimal() and _WHOLE_NUMBER.fullmatch(whole):
            where = ".".join(map(str, (*at, name.value)))
            raise error(
                DECIMAL_COMMA, file=path,
                key=f"{where} (line {name.start_mark.line + 1})", found=f"{whole},{part}", allowed=f"{whole}.{part}",
            )  # fmt: skip


def _describe(error: yaml.YAMLError) -> str:
    """What is wrong with the text, with line and column."""
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or str(error)
    where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
    if "'\\t'" in problem:
        return f"{where}there is a tab; YAML allows only spaces before and between keys and values"
    return f"{where}is not YAML: {problem}{_opened(error)}"


def _opened(error: yaml.YAMLError) -> str:
    """Where what is not closed was opened, in words: in the text, the parser notices that at the next key or later."""
    context, mark = getattr(error, "context", None) or "", getattr(error, "context_mark", None)
    for what, sign in _SIGNS.items():
        if mark is not None and what in context:
            return f"; the {sign} of line {mark.line + 1}, column {mark.column + 1} is not closed before"
    return ""
