"""`plot`, `export` and `schema`: files for other tools."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

import backhoe_planner as bp
from backhoe_planner.cli.arguments import PlanFile, PlanUrdf
from backhoe_planner.cli.terminal import OUT, VERIFIED
from backhoe_planner.files.output_file import check_writable

__all__ = ["export", "plot", "schema"]


def plot(
    plan_file: PlanFile,
    file: Annotated[Path, typer.Argument(metavar="FILE", help=".png, .svg or .pdf", show_default=False)],
    urdf: PlanUrdf = None,
) -> int:
    """Plot joints, rates, clearances, power and energy of a plan over time."""
    from backhoe_planner.show import plot_plan

    check_writable(file)
    plot_plan(bp.load_plan(plan_file, urdf=urdf), file)
    OUT.print(f"wrote {file}")
    return VERIFIED


def export(
    plan_file: PlanFile,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help=".csv, .npz, or .yaml (ROS 2 JointTrajectory)", show_default=False)
    ],
    urdf: PlanUrdf = None,
) -> int:
    """Write a plan's motion for other tools."""
    from backhoe_planner.planning import export_plan

    check_writable(file)
    export_plan(bp.load_plan(plan_file, urdf=urdf), file)
    OUT.print(f"wrote {file}")
    return VERIFIED


def schema() -> int:
    """Print the scene file's JSON Schema."""
    sys.stdout.write(json.dumps(bp.scene_schema(), indent=2) + "\n")
    return VERIFIED
