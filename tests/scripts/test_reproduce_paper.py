"""scripts/reproduce_paper.py runs from any folder and writes all its files."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """One small run, in another working directory and into a folder that does not exist yet."""
    cwd = tmp_path_factory.mktemp("elsewhere")
    done = subprocess.run(
        [sys.executable, "-W", "error", str(ROOT / "scripts" / "reproduce_paper.py"), "--scenes", "1", "--out", "a/b"],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return cwd / "a" / "b", done.stdout


@pytest.mark.long
def test_every_figure_and_table_is_written(output: tuple[Path, str]) -> None:
    folder, _ = output
    figures = {f"{prefix}figure_{number}" for prefix in ("", "second_scene_") for number in (5, 6)} | {"population"}
    tables = {"scenes", "population", "terms"}
    expected = {f"{name}.{end}" for name in figures for end in ("png", "svg")}
    expected |= {f"{name}.{end}" for name in tables for end in ("csv", "md")}
    assert {path.name for path in folder.iterdir()} == expected
    assert all(path.stat().st_size > 100 for path in folder.iterdir())


@pytest.mark.long
def test_the_tables_have_the_results_and_are_printed(output: tuple[Path, str]) -> None:
    folder, printed = output
    with (folder / "population.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["law"] == "pseudo-inverse alone"
    assert len(rows) == 8
    completed = rows[-1]
    assert float(completed["touches [%]"]) == 0.0
    assert float(completed["nearer than 0.3 m [%]"]) == 0.0
    assert "| + both (gains: auto)" in printed
    assert str(folder) not in printed
    assert (folder / "terms.md").read_text().split("\n\n", 1)[1].strip() in printed


def test_the_scene_of_the_figures_equals_the_scene_file() -> None:
    """The same numbers are in the script and in the scene file."""
    script = (ROOT / "scripts" / "reproduce_paper.py").read_text()
    text = (ROOT / "scenes" / "paper_planar.yaml").read_text()
    assert "[1.42, 1.86, 1.71, 1.16]" in script
    assert "{joint1: 1.42, joint2: 1.86, joint3: 1.71, joint4: 1.16}" in text
    for numbers in ("0.45, -2.16, 0.0", "0.63, 0.59, 0.0"):
        assert numbers in script
        assert numbers in text
