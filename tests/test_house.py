"""The house rules: imports run one way, and public names are listed and explained."""

from __future__ import annotations

import ast
import importlib
import json
import re
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest
from source import nodes

import backhoe_planner

ROOT = Path(backhoe_planner.__file__).resolve().parents[1]
PACKAGE = ROOT / "backhoe_planner"
FLOORS = [
    "errors", "digits", "arrays", "blas", "native", "files",
    "machine", "site", "motion", "proof", "law", "planning", "live", "job", "standing", "studies", "show", "cli",
    "__main__",
]  # fmt: skip
FILES = sorted(PACKAGE.rglob("*.py"))
COMPILED = sorted((ROOT / "native" / "src").glob("*.[ch]"))


def module_name(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


@cache
def imported(file: Path) -> set[str]:
    """Full names of all modules that a file imports, at any level."""
    found = set()
    for node in nodes(file):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            found.add(str(node.module))
            if node.module == "backhoe_planner":
                found |= {f"backhoe_planner.{alias.name}" for alias in node.names}
    return found


def load(file: Path) -> ModuleType:
    return importlib.import_module(module_name(file))


# one test checks a rule in all files and names every violation: 1600 tests would cost more than their rules


def test_imports_run_one_way() -> None:
    wrong = []
    for file in FILES:
        name = module_name(file).split(".")
        if len(name) == 1:
            continue  # the package itself offers names from every room
        own = FLOORS.index(name[1])
        for other in imported(file):
            parts = other.split(".")
            if parts[0] != "backhoe_planner":
                continue
            if len(parts) == 1:
                if name[1] != "cli":
                    wrong.append(f"{file} imports the whole package")
            elif parts[1] not in FLOORS:
                wrong.append(f"{file} imports {other}, which is no room")
            elif FLOORS.index(parts[1]) > own:
                wrong.append(f"{file} imports {other} from above")
    assert not wrong, "\n".join(wrong)


SUITES = {
    # rooms within a room; "" is the room's own files
    "files": ["", "meshes"],
    "machine": ["shape", "clusters", "hydraulics", "description", "", "kinematics", "dynamics", "capability"],
    "site": ["surveys", "schema", "pairs", "", "distances"],
    "motion": ["keeping", "", "timing", "following"],
    "planning": [
        "search",
        "descent",
        "stretches",
        "paths",
        "reactive",
        "report",
        "result",
        "world",
        "multistart",
        "refining",
        "goals",
        "",
        "sequence",
    ],
    "live": ["braking", "boxes", "planes", "clearance", "recovery", "servo", "detours", ""],
    "job": ["schema", "ground", "cuts", "worksite", "result", "cycles", ""],
    "studies": ["schema", "rows", "results", "work", ""],
    "show": ["drawing", "plots", "page", "job", "standing", "study", "viewer", "teleop"],
}


def test_no_room_is_larger_than_the_house_allows() -> None:
    """The files of a room outside its inner rooms: docs/architecture.md."""
    for room in {file.parent for file in FILES} - {PACKAGE}:
        files = [file for file in room.glob("*.py") if file.name != "__init__.py"]
        assert len(files) <= 15, room
        assert sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files) <= 3_000, room


@pytest.mark.parametrize("floor", SUITES)
def test_imports_within_a_room_run_one_way(floor: str) -> None:
    order = SUITES[floor]
    inner = {path.name for path in (PACKAGE / floor).iterdir() if (path / "__init__.py").is_file()}
    assert inner == set(order) - {""}

    def place(name: str) -> int:
        parts = name.split(".")
        return order.index(parts[2] if len(parts) > 3 and parts[2] in inner else "")

    for file in (PACKAGE / floor).rglob("*.py"):
        for other in imported(file):
            if other.startswith(f"backhoe_planner.{floor}."):
                assert place(other) <= place(module_name(file)), f"{file} imports {other} from above"


def test_the_docs_say_about_how_large_each_room_is() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    (sizes,) = re.findall(r"In thousands of lines of Python: ([^.]*)\.", text)
    said = {room: 1_000 * int(size) for room, size in re.findall(r"(\w+) (\d+)", sizes)}
    lines: Counter[str] = Counter()
    for file in FILES:
        if file.parent != PACKAGE:
            lines[file.relative_to(PACKAGE).parts[0]] += len(file.read_text(encoding="utf-8").splitlines())
    assert set(said) == set(lines)
    assert not {room: lines[room] for room in said if abs(lines[room] - said[room]) > 1_000}


def test_no_file_is_longer_than_600_lines() -> None:
    lengths = {file: len(file.read_text(encoding="utf-8").splitlines()) for file in [*FILES, *COMPILED]}
    assert not {str(file): length for file, length in lengths.items() if length > 600}


# modules whose name tells the origin: `obstacle_shapes.Sphere`, `shapes.Sphere`
VOCABULARIES = {"backhoe_planner.site.schema.obstacle_shapes", "backhoe_planner.machine.shape.shapes"}


def test_rooms_are_imported_through_their_doors() -> None:
    wrong = []
    for file in FILES:
        own = module_name(file).split(".")[1:2]
        for node in nodes(file):
            if not isinstance(node, ast.ImportFrom) or not str(node.module).startswith("backhoe_planner."):
                continue
            room, *inner = str(node.module).split(".")[1:]
            if [room] == own or room in ("errors", "files") or not inner:
                continue
            if not {f"{node.module}.{alias.name}" for alias in node.names} <= VOCABULARIES:
                wrong.append(f"{file}:{node.lineno}: take it from backhoe_planner.{room}")
    assert not wrong, "\n".join(wrong)


def test_every_room_has_a_place_in_the_order_of_imports() -> None:
    rooms = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert rooms - {"__init__"} == set(FLOORS)


def test_importing_the_package_loads_no_viewer() -> None:
    heavy = ["meshcat", "matplotlib", "tornado", "toppra", "backhoe_planner.show", "backhoe_planner.cli"]
    code = (
        f"from backhoe_planner import *; import json, sys; print(json.dumps([m for m in {heavy} if m in sys.modules]))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(result.stdout) == []


def test_public_names_have_docstrings() -> None:
    """A name without an underscore is public in its room; the doors list those that are public outside."""
    wrong = []
    for file in FILES:
        tree = nodes(file)[0]
        assert isinstance(tree, ast.Module)
        if not ast.get_docstring(tree):
            wrong.append(f"{file} does not say what it is")
        for node in tree.body:
            public = isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_")
            if public and not ast.get_docstring(node):  # type: ignore[arg-type]
                wrong.append(f"{file}:{node.lineno} has no docstring")
    assert not wrong, "\n".join(wrong)


ROOMS = [file for file in FILES if file.name == "__init__.py"]


@pytest.mark.parametrize("file", ROOMS, ids=module_name)
def test_all_of_a_door_is_sorted_and_can_be_imported(file: Path) -> None:
    module = load(file)
    if file.parent.parent not in (PACKAGE, PACKAGE.parent):
        assert not hasattr(module, "__all__"), "only a room has a door, not a room within it"
    elif hasattr(module, "__all__"):  # without it nothing of the module is used outside
        names: list[str] = module.__all__
        in_order = sorted(names, key=lambda name: (not name.isupper(), not name[0].isupper(), name))
        assert names in (sorted(names), in_order), f"{file}: __all__ is not sorted"
        assert len(set(names)) == len(names)
        assert all(hasattr(module, name) for name in names)


def test_coal_is_called_in_two_files() -> None:
    users = [module_name(file) for file in FILES if {"coal", "hppfcl"} & {m.split(".")[0] for m in imported(file)}]
    assert users == ["backhoe_planner.machine.clusters.trees", "backhoe_planner.machine.shape.shapes"]


def test_only_the_command_line_prints() -> None:
    wrong = []
    for file in FILES:
        if module_name(file).split(".")[1:2] in (["cli"], ["__main__"]):
            continue
        for node in nodes(file):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                prints = node.func.id in ("print", "breakpoint", "input")
            elif isinstance(node, ast.Attribute) and node.attr in ("stdout", "stderr"):
                prints = isinstance(node.value, ast.Name) and node.value.id == "sys"
            else:
                prints = False
            if prints:
                wrong.append(f"{file}:{node.lineno}")  # type: ignore[attr-defined]
    assert not wrong, "\n".join(wrong)


def test_the_validation_package_lists_its_modules() -> None:
    folder = ROOT / "validation"
    text = (folder / "__init__.py").read_text(encoding="utf-8")
    listed = re.findall(r"^    (\w+) +\S", text, re.MULTILINE)
    assert sorted(listed) == sorted(["module", *(file.stem for file in folder.glob("*.py") if file.stem != "__init__")])
