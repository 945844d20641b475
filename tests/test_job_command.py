"""`backhoe-planner job` after an interruption: its messages, how it resumes, and what it does not overwrite."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from small_jobs import TINY, tiny_plan

import backhoe_planner as bp
from backhoe_planner import job as jobs
from backhoe_planner.cli import main, terminal

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def resumed() -> list[bp.JobPlan | None]:
    """The plans from which each planning resumed."""
    return []


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, resumed: list[Any]) -> Run:
    """Call the command line in this process; planning is interrupted after one cycle, on a survey before the first."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(terminal, "_FIRST_LINE", 600.0)  # s: no lines of a log, however slow the computer is
    Path("job.yaml").write_text(yaml.safe_dump(TINY))

    def plan(job: jobs.Job, **options: Any) -> None:
        resumed.append(options["resume"])
        terrain = options["terrain"]
        part = replace(tiny_plan(), job=job, cycles=tiny_plan().cycles[:1], undug=(), failure="interrupted", note="")
        if terrain is not None:
            part = replace(part, cycles=(), start=terrain, surveyed=True)
        options["watch"](jobs.JobStep(part, 2))
        raise KeyboardInterrupt

    monkeypatch.setattr(bp, "plan_job", plan)

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["backhoe-planner", *arguments])
        with pytest.raises(SystemExit) as caught:
            main()
        said = capsys.readouterr()
        assert isinstance(caught.value.code, int)
        return caught.value.code, said.out, " ".join(said.err.split())

    return call


def test_an_interrupted_job_reports_its_cycles_and_resumes_with_the_same_settings(
    run: Run, resumed: list[bp.JobPlan | None]
) -> None:
    status, _, told = run("job", "job.yaml", "-o", "part.json")
    assert (status, told) == (130, "interrupted after 1 cycle, kept in part.json; the same command goes on there")
    status, said, _ = run("check", "part.json")
    assert status == 1
    assert "planning was interrupted after 1 cycle; the same command goes on there" in said
    run("job", "job.yaml", "-o", "part.json")
    assert resumed[0] is None
    assert resumed[1] is not None
    assert len(resumed[1].cycles) == 1
    before = Path("part.json").read_bytes()
    status, _, told = run("job", "job.yaml", "-o", "part.json", "--seed", "3")
    assert status == 2
    assert (
        "part.json: holds a part of this job that was planned with other settings; found --effort quick --seed 0"
        in told
    )
    assert Path("part.json").read_bytes() == before
    run("job", "job.yaml", "-o", "part.json", "--seed", "3", "--anew")
    assert resumed[2:] == [None]


@pytest.mark.long
def test_job_and_stand_warn_of_machine_meshes_and_far_obstacles(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without masses, an open crate on its site, and a pipe whose position is in millimetres."""
    urdf = bp.load_robot("example:backhoe").urdf.path.read_text()
    Path("light.urdf").write_text(re.sub("<inertial>.*?</inertial>", "", urdf, flags=re.DOTALL))
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    sides = [(1, 2, 4, 3), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [*("v {} {} {}".format(*at) for at in corners), *("f {} {} {} {}".format(*side) for side in sides)]
    Path("crate.obj").write_text("\n".join(lines))
    crate = {"name": "crate", "shape": "mesh", "file": "crate.obj", "position": [-6.0, 5.0, 0.0]}
    pipe = {"name": "pipe", "shape": "sphere", "radius": 0.1, "position": [0.0, 7000.0, 0.0]}
    site = {"obstacles": [crate, pipe]}
    Path("light.yaml").write_text(yaml.safe_dump(TINY | {"machine": "light.urdf", "site": site}))

    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    for command in ("plan_job", "stand"):
        monkeypatch.setattr(bp, command, interrupted)
    for command in ("job", "stand"):
        _, _, told = run(command, "light.yaml", "-o", "light.json")
        assert told.count("warning: no link that moves has a mass in the URDF") == 1
        assert "those of payload and soil alone" in told  # cuts need work nevertheless
        assert told.count("warning: the mesh crate.obj (crate) is not closed") == 1
        assert re.search(r"warning: pipe is \d,\d{3} m away, .*; sizes, positions and points of files are in", told)
        assert "warning" not in run(command, "job.yaml", "-o", "part.json")[2]


@pytest.mark.long
def test_a_job_on_a_survey_resumes_only_with_the_same_survey(run: Run, resumed: list[bp.JobPlan | None]) -> None:
    for name, height in (("survey.csv", -0.04), ("again.csv", -0.04), ("other.csv", -0.06)):  # 2 cm: beyond noise
        np.savetxt(name, np.full((111, 101), height), delimiter=",")
    begin = ("job", "job.yaml", "-o", "part.json")
    assert run(*begin, "--from-terrain", "survey.csv")[0] == 130
    assert run(*begin, "--from-terrain", "again.csv")[0] == 130
    assert resumed[0] is None
    assert resumed[1] is not None
    assert resumed[1].surveyed
    for other in ((), ("--from-terrain", "other.csv")):
        status, _, told = run(*begin, *other)
        assert status == 2
        assert "began on another ground; found that of a survey" in told
    assert "ground before the first cycle as surveyed" in " ".join(run("check", "part.json")[1].split())


def test_the_summary_has_the_tightest_spot_of_all_motions(run: Run, tmp_path: Path) -> None:
    plan = tiny_plan()
    plan.save(tmp_path / "tiny.json")
    _, said, _ = run("check", "tiny.json")
    margins = {
        (cycle.number, leg.name): near.margin
        for cycle in plan.cycles
        for leg in cycle.legs
        for near in leg.certificate.clearances
        if near == min(leg.certificate.clearances, key=lambda one: one.margin)
    }
    number, leg_name = min(margins, key=margins.__getitem__)
    (line,) = [line for line in said.splitlines() if line.startswith("clearance")]
    assert line.endswith(f"(margin {margins[number, leg_name]:+.3f} m, in cycle {number}, {leg_name})")
