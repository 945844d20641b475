"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["PlanFile", "PlanUrdf", "SceneFile", "Urdf"]

Urdf = Annotated[str, typer.Argument(metavar="URDF", help="A URDF file, or example:NAME.", show_default=False)]
SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="A scene file (YAML).", show_default=False)]
PlanFile = Annotated[Path, typer.Argument(metavar="PLAN", help="A plan file (JSON).", show_default=False)]
PlanUrdf = Annotated[
    str | None, typer.Option("--urdf", metavar="URDF", help="Where the URDF lies now, if not where the plan says.")
]
