"""The code, scenes and commands in README and docs run, load or parse, and every link has a target."""

from __future__ import annotations

import json
import re
import shlex
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

import backhoe_planner as bp
from backhoe_planner.cli import app
from backhoe_planner.job import job_from_dict
from backhoe_planner.motion import OBJECTIVES
from backhoe_planner.site import scene_from_dict
from backhoe_planner.site.schema import obstacle_shapes
from backhoe_planner.studies import study_from_dict
from backhoe_planner.studies.rows.template import build_template

ROOT = Path(bp.__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LARGEST_README = 6144  # bytes


def snippets(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def pages_with(language: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("page", [p for p in PAGES if snippets(p, language)], ids=lambda page: page.name)


def heading_anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_readme_is_short() -> None:
    assert (ROOT / "README.md").stat().st_size <= LARGEST_README


@pytest.fixture(scope="module")
def plan_once() -> Callable[..., bp.Plan]:
    """`bp.plan`, which plans the same scene for the same machine once: three pages plan one trench."""
    plan, plans = bp.plan, dict[str, bp.Plan]()

    def planned(robot: bp.Robot, scene: bp.Scene, **settings: Any) -> bp.Plan:
        chosen = {"method": "auto", "seed": 0} | settings
        key = json.dumps([robot.urdf.sha256, scene.to_dict(), chosen], sort_keys=True)
        if key not in plans:
            plans[key] = plan(robot, scene, **settings)
        return plans[key]

    return planned


@pages_with("python")
def test_python_in_the_docs_runs(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plan_once: Callable[..., bp.Plan]
) -> None:
    for folder in ("models", "scenes"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bp, "plan", plan_once)
    monkeypatch.setattr(time, "sleep", lambda _: None)  # a loop at the pace of the clock goes on at once
    namespace: dict[str, object] = {}
    for number, snippet in enumerate(snippets(page, "python")):
        exec(compile(snippet, f"{page.name}, snippet {number + 1}", "exec"), namespace)


@pages_with("yaml")
def test_scenes_in_the_docs_load(page: Path) -> None:
    """A snippet without a `version` belongs to the first whole scene of its page."""
    whole: dict[str, Any] = {}
    for snippet in snippets(page, "yaml"):
        content = yaml.safe_load(snippet)
        if "version" in content:
            whole = content
        if "parameters" in whole:
            build_template(study_from_dict({**whole, **content}, folder=ROOT))
            continue
        read = job_from_dict if "dig" in whole else scene_from_dict
        read({**whole, **content})


@pages_with("sh")
def test_commands_in_the_docs_parse(page: Path) -> None:
    command: Any = typer.main.get_command(app)
    for line in "\n".join(snippets(page, "sh")).splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] != ["backhoe-planner"]:
            continue
        name, chosen, rest = command.resolve_command(command.make_context(words[0], words[1:]), words[1:])
        chosen.make_context(name, rest)


def test_every_shape_and_every_objective_is_described() -> None:
    shapes, objectives = (
        (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("scene-file.md", "planning.md")
    )
    assert [name for name in obstacle_shapes.shape_records() if f"`{name}`" not in shapes] == []
    assert [name for name in OBJECTIVES if f"\n| `{name}` |" not in objectives] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_in_the_docs_have_targets(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.is_file(), f"{page.name}: {target}"
        if anchor:
            assert anchor in heading_anchors(file), f"{page.name}: {target}"
    for script in re.findall(r"`python (scripts/\w+\.py)", page.read_text(encoding="utf-8")):
        assert (ROOT / script).is_file(), f"{page.name}: {script}"
