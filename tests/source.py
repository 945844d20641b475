"""The project's own Python as trees, for rules that its files keep."""

from __future__ import annotations

import ast
import gc
from functools import cache
from pathlib import Path


@cache
def nodes(file: Path) -> list[ast.AST]:
    """Everything in a file, read once for all rules.

    Without a search for cycles meanwhile: nodes are in none, and it takes thrice as long as reading them.
    """
    gc.disable()
    try:
        return list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    finally:
        gc.enable()
