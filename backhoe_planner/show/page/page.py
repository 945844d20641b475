"""One HTML page that shows a plan without a network: the picture, its numbers, a scrubber.

The same page, without content of its own, is what the live viewer serves.
"""

from __future__ import annotations

import base64
import html
import json
import os
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

from backhoe_planner.files.output_file import check_writable, whole_file
from backhoe_planner.live import shown_problem
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.scene_graph import SceneGraph
from backhoe_planner.show.drawing.timeline import timeline
from backhoe_planner.show.page.page_content import plan_content, problem_content
from backhoe_planner.show.page.recording import Recording

__all__ = ["Addition", "live_page", "plan_page", "write_page"]

# nothing may be fetched from anywhere; meshcat reads its own commands with eval
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src {connect}"
)


def write_page(plan: Plan, path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write a page that plays a plan in any browser, offline, whole or not at all.

    Returns
    -------
    What could not be drawn as the URDF asks, in words.

    Raises
    ------
    OutputError: the folder does not exist or cannot be written.
    """
    check_writable(path)
    page, warnings = plan_page(plan)
    with whole_file(path) as stream:
        stream.write(page)
    return warnings


def plan_page(plan: Plan) -> tuple[str, tuple[str, ...]]:
    """The page as text, and what could not be drawn as the URDF asks."""
    problem = shown_problem(plan)
    frames = timeline(problem, plan.trajectory)
    recording = Recording()
    visualizer = recording.visualizer()
    graph = SceneGraph(visualizer, problem, q=plan.trajectory.q[0])
    graph.draw_trace(frames.tip)
    view = graph.look_at_motion(frames)
    visualizer.set_animation(graph.animation(frames), play=False, repetitions=1)
    messages = [message for _, message in recording.messages()]
    content = {
        "draw": [base64.b64encode(message).decode("ascii") for message in messages if isinstance(message, bytes)],
        "tell": [problem_content(problem, graph, view, frames.obstacles), plan_content(plan, frames, view)],
    }
    return _page(plan.scene.name or "plan", content, connect="'none'"), graph.warnings


@dataclass(frozen=True)
class Addition:
    """What a page has beyond the plain live view.

    Attributes
    ----------
    css, body, script: appended to the page's own.
    """

    css: str
    body: str
    script: str


def live_page(addition: Addition | None = None) -> str:
    """The page that a live viewer serves; it asks its server for what to show."""
    return _page("backhoe_planner", None, connect="'self' ws: wss:", addition=addition)


def _page(title: str, content: Any, *, connect: str, addition: Addition | None = None) -> str:
    parts = resources.files("backhoe_planner.show.page").joinpath("parts")
    names = ("page.css", "body.html", "page.js")
    css, body, script = (parts.joinpath(name).read_text(encoding="utf-8") for name in names)
    after = ""
    if addition is not None:
        css, body = css + addition.css, body + addition.body
        after = f"<script>\n{addition.script}</script>\n"
    return "".join(
        (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY.format(connect=connect)}">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            f'<title>{html.escape(title)}</title>\n<link rel="icon" href="data:,">\n',
            f"<style>\n{css}</style>\n</head>\n<body>\n{body}",
            f"<script>\n{_meshcat()}\n</script>\n",
            f"<script>\n{script}show({_json_in_script(content)});\n</script>\n{after}</body>\n</html>\n",
        )
    )


def _json_in_script(content: Any) -> str:
    """JSON that cannot end the script in which it stands, whatever its strings hold."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@lru_cache(maxsize=1)
def _meshcat() -> str:
    """The viewer that meshcat's Python package brings along."""
    source = resources.files("meshcat").joinpath("viewer", "dist", "main.min.js").read_text(encoding="utf-8")
    return source.replace("</script", "<\\/script")
