"""The program `backhoe-planner COMMAND ...`, with all its commands.

Exit status: 0 verified (or done), 1 no verified plan, 2 bad input, 130 interrupted.
"""

from __future__ import annotations

import typer

from backhoe_planner.cli import file_commands, inspect_command, plan_commands, teleop_command

__all__ = ["app"]

app = typer.Typer(
    help="Proven motions for a backhoe, or any redundant arm, along a path among obstacles.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

for command in (
    plan_commands.plan,
    plan_commands.view,
    plan_commands.check,
    inspect_command.inspect,
    file_commands.plot,
    file_commands.export,
    teleop_command.teleop,
    file_commands.schema,
):
    app.command()(command)
