"""The list of public names is complete, and every name in it is used."""

from __future__ import annotations

import ast
import inspect
import pydoc
import re
import typing
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from source import nodes

import backhoe_planner

ROOT = Path(backhoe_planner.__file__).resolve().parents[1]
PACKAGE = ROOT / "backhoe_planner"
ROOMS = sorted(door.parent.name for door in PACKAGE.glob("*/__init__.pyi"))
PUBLIC = {name: getattr(backhoe_planner, name) for name in dir(backhoe_planner) if not name.startswith("_")}
# scene files are described by `scene_schema`, machines by their URDF, scans by their file
FILE_ENTRIES = tuple(
    f"backhoe_planner.{part}"
    for part in (
        "site.scene_file",
        "site.schema",
        "machine.description",
        "machine.robot",
        "machine.clusters.cluster",
        "job.schema",
        "studies.schema",
    )
)


def listed(door: Path) -> list[str]:
    """The names that a stub re-exports."""
    nodes = ast.parse(door.read_text(encoding="utf-8")).body
    return [alias.name for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names]


def test_the_listed_names_are_those_that_can_be_imported() -> None:
    names = listed(PACKAGE / "__init__.pyi")
    assert len(set(names)) == len(names)
    assert sorted(names) == sorted(PUBLIC)
    assert all(inspect.isclass(thing) or inspect.isfunction(thing) for thing in PUBLIC.values())


def test_the_version_is_that_of_the_installed_package() -> None:
    assert backhoe_planner.__version__ == metadata.version("backhoe_planner")


def test_help_shows_every_public_name() -> None:
    shown = re.sub(".\x08", "", pydoc.render_doc(backhoe_planner))  # bold is a letter struck over itself
    for name in PUBLIC:
        assert f"class {name}" in shown or f"\n    {name}(" in shown, name


def parts(hint: Any) -> Iterator[type]:
    """All classes in an annotation."""
    arguments = typing.get_args(hint)
    if not arguments and inspect.isclass(hint):
        yield hint
    for argument in arguments:
        for part in argument if isinstance(argument, (list, tuple)) else [argument]:
            yield from parts(part)


def annotated(thing: Any) -> Iterator[Any]:
    """A function, or a class with its public methods and properties; those that check nothing are the package's own."""
    yield thing
    if not inspect.isclass(thing):
        return
    for name, member in vars(thing).items():
        if (name.startswith("_") and name != "__init__") or name.endswith("_unchecked"):
            continue
        inner = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
        if inspect.isfunction(inner) and inner.__module__ == thing.__module__:
            yield inner


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_types_that_a_public_name_takes_and_returns_are_public(name: str) -> None:
    for thing in annotated(PUBLIC[name]):
        for field, hint in typing.get_type_hints(thing, localns={"Self": Any}).items():
            for part in () if field.startswith("_") else parts(hint):
                own = part.__module__.startswith("backhoe_planner.") and not part.__module__.startswith(FILE_ENTRIES)
                if own and not getattr(part, "_is_protocol", False):
                    assert part in PUBLIC.values(), f"{name}: {field} is a {part.__module__}.{part.__name__}"


# the statement, with its names in brackets or on one line; to parse a whole file takes twenty times as long
_FROM_IMPORT = re.compile(r"^[ \t]*(from [.\w]+ import (?:\([^)]*\)|[^\n(]+))", re.MULTILINE)


def names_taken(file: Path) -> Iterator[tuple[str, str]]:
    """(room, name) of everything that a file imports through a door."""
    text = file.read_text(encoding="utf-8")
    for found in _FROM_IMPORT.finditer(text):
        (node,) = ast.parse(found[1]).body
        assert isinstance(node, ast.ImportFrom)
        module = node.module or ""
        room = module if node.level == 1 else module.removeprefix("backhoe_planner.")
        if room in ROOMS:
            yield from ((room, alias.name) for alias in node.names)
        elif module == "backhoe_planner":
            whole = {alias.asname or alias.name: alias.name for alias in node.names if alias.name in ROOMS}
            for used in nodes(file) if whole else ():
                if isinstance(used, ast.Attribute) and isinstance(used.value, ast.Name) and used.value.id in whole:
                    yield whole[used.value.id], used.attr


def test_every_name_of_a_door_is_used() -> None:
    taken = set()
    for folder in (PACKAGE, ROOT / "tests", ROOT / "validation", ROOT / "scripts"):
        for file in folder.rglob("*.py"):
            own = file.relative_to(PACKAGE).parts[0] if file.is_relative_to(PACKAGE) else ""
            taken |= {(room, name) for room, name in names_taken(file) if room != own}
    taken |= set(names_taken(PACKAGE / "__init__.pyi"))
    unused = {(room, name) for room in ROOMS for name in listed(PACKAGE / room / "__init__.pyi")} - taken
    assert not unused
