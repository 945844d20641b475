"""One HTML page that shows a plan without a network: the picture, its figures, a scrubber.

The live viewer serves the same page, without content of its own.
"""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Callable, Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

from backhoe_planner.files.output_file import check_ending, check_output, whole_file
from backhoe_planner.planning import Plan
from backhoe_planner.show.page.display import Display
from backhoe_planner.show.page.page_content import show_plan

_FORMATS = (".html", ".htm")

# nothing may be fetched from anywhere; meshcat reads its own commands with eval
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src {connect}"
)


def write_page(plan: Plan, path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write a page that plays a plan in any browser, offline, whole or not at all.

    Returns
    -------
    What could not be drawn as the URDF specifies, in words.

    Raises
    ------
    OutputError: the name ends in neither .html nor .htm, the folder does not exist or cannot be written, or the
        file belongs to the machine or the scene.
    """
    return write_page_file(path, lambda: plan_page(plan), inputs=plan.input_files)


def write_page_file(
    path: str | os.PathLike[str], make: Callable[[], tuple[str, tuple[str, ...]]], *, inputs: Sequence[Path]
) -> tuple[str, ...]:
    """Write a page, whole or not at all.

    Parameters
    ----------
    make: returns the page as text, and what could not be drawn, in words; called once the file may be written.
    inputs: files that must not be overwritten.

    Returns
    -------
    What could not be drawn, in words.

    Raises
    ------
    OutputError: the name ends in neither .html nor .htm, the folder does not exist or cannot be written, or the
        file is one of `inputs`.
    """
    check_page(path, inputs)
    page, warnings = make()
    with whole_file(path) as stream:
        stream.write(page)
    return warnings


def check_page(path: str | os.PathLike[str], inputs: Sequence[Path]) -> None:
    """Check that a page can be written to a file; see `write_page_file`."""
    check_output(path, inputs)
    check_ending(path, _FORMATS, what="a page")


def plan_page(plan: Plan) -> tuple[str, tuple[str, ...]]:
    """The page as text, and what could not be drawn as the URDF specifies, in words."""
    display = Display()
    graph = show_plan(display, plan)
    return page_of(plan.scene.title, display), graph.warnings


def page_of(title: str, display: Display, *, css: str = "", body: str = "", script: str = "") -> str:
    """A page that shows the content of a display, offline.

    Parameters
    ----------
    css, body, script: additions to the plain page.
    """
    messages = display.messages().values()
    content = {
        "draw": [base64.b64encode(message).decode("ascii") for message in messages if isinstance(message, bytes)],
        "tell": [json.loads(message) for message in messages if isinstance(message, str)],
    }
    return _page(title, content, connect="'none'", css=css, body=body, script=script)


def live_page(*, css: str = "", body: str = "", script: str = "") -> str:
    """The page that a live viewer serves; its server sends the content.

    Parameters
    ----------
    css, body, script: additions to the plain live view.
    """
    return _page("backhoe_planner", None, connect="'self' ws: wss:", css=css, body=body, script=script)


def read_parts(package: str, *names: str) -> tuple[str, ...]:
    """The texts of the named files in the folder ``parts`` of a package."""
    parts = resources.files(package).joinpath("parts")
    return tuple(parts.joinpath(name).read_text(encoding="utf-8") for name in names)


def _page(title: str, content: Any, *, connect: str, css: str, body: str, script: str) -> str:
    own_css, own_body, own_script = read_parts("backhoe_planner.show.page", "page.css", "body.html", "page.js")
    scripts = [f"{_meshcat()}\n", f"{own_script}show({_json_in_script(content)});\n", *([script] if script else [])]
    return html_page(
        title, policy=_POLICY.format(connect=connect), css=own_css + css, body=own_body + body, scripts=scripts
    )


def html_page(title: str, *, policy: str, css: str, body: str, scripts: Sequence[str] = ()) -> str:
    """A page that needs no other file, as text.

    Parameters
    ----------
    title: plain text.
    policy: what its parts may load and run, as a content security policy.
    css, body, scripts: its parts, inserted unchanged.
    """
    return "".join(
        (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            f'<title>{html.escape(title)}</title>\n<link rel="icon" href="data:,">\n',
            f"<style>\n{css}</style>\n</head>\n<body>\n{body}",
            *(f"<script>\n{script}</script>\n" for script in scripts),
            "</body>\n</html>\n",
        )
    )


def _json_in_script(content: Any) -> str:
    """JSON that cannot end the script around it, whatever its strings contain."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@lru_cache(maxsize=1)
def _meshcat() -> str:
    """The viewer that comes with meshcat's Python package."""
    source = resources.files("meshcat").joinpath("viewer", "dist", "main.min.js").read_text(encoding="utf-8")
    return source.replace("</script", "<\\/script")
