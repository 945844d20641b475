"""The page from which a machine is driven: the live view, and what driving needs beside it."""

from __future__ import annotations

from importlib import resources

from backhoe_planner.show.page.page import Addition, live_page

__all__ = ["teleop_page"]


def teleop_page() -> str:
    """The page as text."""
    parts = resources.files("backhoe_planner.show.teleop").joinpath("parts")
    css, body, script = (
        parts.joinpath(name).read_text(encoding="utf-8") for name in ("teleop.css", "teleop.html", "teleop.js")
    )
    return live_page(Addition(css, body, script))
