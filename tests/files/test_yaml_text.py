"""YAML parsed by libyaml means the same as YAML parsed by PyYAML's own parser."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from backhoe_planner.files import yaml_text
from backhoe_planner.files.yaml_text import read_yaml

ROOT = Path(__file__).parents[2]
TEXTS = [
    file.read_text(encoding="utf-8") for folder in ("scenes", "models") for file in (ROOT / folder).rglob("*.yaml")
]
PIECES = [
    ": ",
    "- ",
    "\n",
    "  ",
    "[",
    "]",
    "{",
    "}",
    ",",
    "'",
    '"',
    "#",
    "|",
    ">",
    "&a ",
    "*a",
    "é",
    "~",
    "1e-3",
    "\r\n",
]

needs_libyaml = pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML was built without libyaml")


def parsed(loader: Callable[[str], Any], text: str) -> object:
    """Tags, values and lines of all nodes of a text; "refused" if it is not YAML."""
    try:
        return plain(loader(text).get_single_node())
    except yaml.YAMLError:
        return "refused"


def plain(node: yaml.Node | tuple[yaml.Node, yaml.Node] | None) -> object:
    if isinstance(node, tuple):
        return tuple(plain(part) for part in node)
    if node is None:
        return None
    value = node.value if isinstance(node, yaml.ScalarNode) else tuple(plain(part) for part in node.value)
    return node.tag, value, node.start_mark.line


@needs_libyaml
def test_both_parsers_give_the_same_nodes() -> None:
    """Every shipped file, and 400 pieces of them with random insertions and deletions."""
    assert len(TEXTS) > 20
    for text in TEXTS:
        assert parsed(yaml_text._CompiledLoader, text) == parsed(yaml_text._Loader, text) != "refused"
    chance, compared = random.Random(20), 0
    for _ in range(400):
        text = chance.choice(TEXTS)
        begin = text.find("\n", chance.randrange(len(text)))
        text = text[begin + 1 : begin + 600]
        for _ in range(chance.randrange(1, 3)):
            at = chance.randrange(len(text) + 1)
            text = text[:at] + chance.choice(PIECES) + text[at + chance.randrange(3) :]
        quick, slow = parsed(yaml_text._CompiledLoader, text), parsed(yaml_text._Loader, text)
        if "refused" not in (quick, slow):
            compared += 1
            assert quick == slow, text
    assert compared > 100


@needs_libyaml
@pytest.mark.parametrize(
    ("text", "message"),
    {
        "a tab that libyaml takes": ("a: \t1\n", "line 1, column 4: there is a tab"),
        "quotes": ("a: 'x'y\n", "expected <block end>, but found '<scalar>'"),
        "a control character": ("a: \x01\n", "unacceptable character"),
    }.values(),
)
def test_what_libyaml_refuses_is_told_as_without_it(
    text: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(text, encoding="utf-8")
    told = []
    for has_libyaml in (True, False):
        monkeypatch.setattr(yaml, "__with_libyaml__", has_libyaml)
        with pytest.raises(ValueError, match=r"scene\.yaml") as raised:
            read_yaml(file)
        told.append(str(raised.value))
    assert message in told[0]
    assert told[0] == told[1]
