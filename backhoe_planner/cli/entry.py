"""The program `backhoe-planner COMMAND ...`: all its commands, and its exit status.

Exit status: 0 verified (or done), 1 no verified plan, 2 bad input or an output that cannot
be written, 130 interrupted, 141 nobody reads the output.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, NoReturn

import typer

import backhoe_planner as bp
from backhoe_planner.cli import (
    inspect_command,
    job_command,
    plan_commands,
    stand_command,
    study_command,
    teleop_command,
)
from backhoe_planner.cli.terminal import BAD_INPUT, ERR, INTERRUPTED, OUT, UNREAD, VERIFIED, let_go, print_error
from backhoe_planner.native import native_version

COMMANDS = {
    command.__name__: command
    for command in (
        plan_commands.plan,
        job_command.job,
        stand_command.stand,
        study_command.study,
        plan_commands.view,
        plan_commands.check,
        inspect_command.inspect,
        plan_commands.plot,
        plan_commands.export,
        teleop_command.teleop,
        inspect_command.schema,
    )
}

_WITH_SCENE = ("plan", "inspect", "teleop")  # commands that take a scene


def _print_version(wanted: bool) -> None:
    if wanted:
        native = native_version()
        OUT.print(f"backhoe-planner {bp.__version__}" + ("" if native is None else f", native {native}"))
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version.")
    ] = False,
) -> None:
    pass


def _app_of(commands: Iterable[Callable[..., object]]) -> typer.Typer:
    app = typer.Typer(
        help="Proven motions for a backhoe, or any redundant arm, along a path among obstacles.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["--help", "-h"]},
    )
    app.callback()(_options)
    for command in commands:
        app.command()(command)
    return app


app = _app_of(COMMANDS.values())


def _app_for(arguments: Sequence[str]) -> typer.Typer:
    """The app of only the command that the arguments name: typer reads the signatures of all that an app has."""
    asked = next((word for word in arguments if not word.startswith("-")), "")
    return _app_of([COMMANDS[asked]]) if asked in COMMANDS else app


def main() -> NoReturn:
    """Entry point of `backhoe-planner`."""
    _open_what_is_closed()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # the terminal may lack some letters of a name
    try:
        status = _app_for(sys.argv[1:])(standalone_mode=False)
        sys.stdout.flush()
    except bp.InputError as error:
        print_error(str(error))
        sys.exit(BAD_INPUT)
    except (KeyboardInterrupt, typer.Abort):
        ERR.print("interrupted")
        sys.exit(INTERRUPTED)
    except SystemExit as ended:
        if not isinstance(ended.__context__, BrokenPipeError):
            raise
        sys.exit(_output_lost(ended.__context__))  # rich and typer exit silently when nobody reads the output
    except typer.Exit as done:
        sys.exit(done.exit_code)
    except OSError as error:
        if error.filename is not None:
            raise
        sys.exit(_output_lost(error))
    except Exception as error:
        if not _is_usage_error(error):
            raise
        message = f"{error.format_message()}{_where_instead(error, sys.argv[1:])}"  # type: ignore[attr-defined]
        if type(error).__name__ == "NoArgsIsHelpError":  # typer has its own copy of click, and does not export it
            ERR.print(message)
        else:
            print_error(message)
        sys.exit(BAD_INPUT)
    if status == INTERRUPTED:  # typer turns Ctrl-C into a return value
        ERR.print("interrupted")
    sys.exit(status if isinstance(status, int) else VERIFIED)


def _open_what_is_closed() -> None:
    """Give the program an output and an error stream if it was started without one.

    Otherwise the next file that is opened would get the number of the closed stream, and anything a library prints.
    """
    for name, number in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_WRONLY)
            if descriptor != number:
                os.dup2(descriptor, number)
                os.close(descriptor)
            setattr(sys, name, open(number, "w", encoding="utf-8", closefd=False))  # noqa: SIM115


def _output_lost(error: OSError) -> int:
    """The exit status if the output cannot be written: the disk is full, or nobody reads it, as after `| head`."""
    let_go(sys.stdout)
    if isinstance(error, BrokenPipeError):
        return UNREAD
    print_error(f"the output cannot be written: {error.strerror}")
    return BAD_INPUT


def _where_instead(error: Exception, arguments: Sequence[str]) -> str:
    """A hint that an unknown option of a command that takes a scene is a key of the scene file; empty otherwise."""
    key = str(getattr(error, "option_name", "")).removeprefix("--").replace("-", "_")
    if set(arguments).isdisjoint(_WITH_SCENE) or key not in bp.Scene.model_fields:
        return ""
    return f" ({key} is a key of the scene file: docs/scene-file.md)"


def _is_usage_error(error: Exception) -> bool:
    """Whether an error is click's own complaint about the command line."""
    return hasattr(error, "format_message") and hasattr(error, "exit_code")
