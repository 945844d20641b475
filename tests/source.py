"""The project's own Python as trees, for rules that its files keep."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path


@cache
def nodes(file: Path) -> list[ast.AST]:
    """Everything in a file, read once for all rules."""
    return list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
