"""`teleop`: drive a machine from a page in the browser."""

from __future__ import annotations

import time as clock
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

import backhoe_planner as bp
from backhoe_planner import show, site
from backhoe_planner.cli.terminal import ERR, FAILED, SceneFile, Urdf, print_error, print_warnings


def teleop(
    urdf: Urdf,
    scene: SceneFile,
    host: Annotated[
        str, typer.Option(metavar="H", help="Address to listen on; by default only this computer can connect.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(metavar="N", min=0, max=65535, help="By default the first free one from 7000 on.")
    ] = None,
    password: Annotated[
        str | None,
        typer.Option(
            metavar="WORD",
            envvar="BACKHOE_PLANNER_PASSWORD",
            show_default=False,
            help="Whoever opens the page must give it; needed, or --allow-anyone, where others can connect.",
        ),
    ] = None,
    allow_anyone: Annotated[
        bool, typer.Option("--allow-anyone", help="Let everybody who can reach the address see and drive.")
    ] = False,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Plan file to which a recording is written.")
    ] = Path("teleop.json"),
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open the page.")] = False,
) -> int:
    """Drive the machine live from the browser.

    The scene's task is not used.
    """
    loaded = bp.load_scene(scene)
    robot = site.load_machine(urdf, loaded)
    if any(obstacle.legs is not None for obstacle in loaded.obstacles):
        print_warnings(["driving by hand has no legs: obstacles of single legs are there all the time"])
    with show.TeleopStation(
        robot,
        loaded,
        host=host,
        port=port,
        password=password,
        allow_anyone=allow_anyone,
        output=output,
        say=ERR.print,
    ) as station:
        print_warnings(site.input_warnings(robot, loaded, with_task=False))
        print_warnings(site.obstacle_warnings(robot, site.build_obstacles(loaded, robot)))
        print_warnings(station.warnings)
        ERR.print(f"open {station.url} in a browser to drive (Ctrl-C ends)")
        if station.url_from_elsewhere is not None:
            ERR.print(f"from other computers: {station.url_from_elsewhere}")
            print_warnings([station.openness])
        if not no_browser:
            webbrowser.open(station.url)
        while station.running:
            clock.sleep(0.1)
        if station.failure:
            print_error(station.failure)
    return FAILED
