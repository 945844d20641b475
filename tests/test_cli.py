"""The command line: what it prints, its exit status, and its one message about bad input."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time as clock
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import trimesh
import yaml
from waiting import PATIENCE

import backhoe_planner as bp
from backhoe_planner.cli import main, terminal
from backhoe_planner.native import native_version
from backhoe_planner.planning import describe_quantity

Data = dict[str, Any]
Run = Callable[..., tuple[int, str, str]]

ROOT = Path(__file__).resolve().parents[1]
PLANAR4 = str(ROOT / "models" / "planar4.urdf")
COMMAND = [sys.executable, "-c", "from backhoe_planner.cli import main; main()"]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
QUICK = ("--effort", "quick")
JOINTS = {"joint1": 0.0, "joint2": 0.3, "joint3": 0.3, "joint4": 0.3}
REACH: Data = {"version": 1, "start": {"joints": JOINTS}, "task": {"goal": {"position": [2.6, 2.4, 0.0]}}}


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Call the command line in this process: exit status, output, and messages."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(terminal, "_FIRST_LINE", 600.0)  # s: no lines of a log, however slow the computer is

    def call(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["backhoe-planner", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            main()
        said = capsys.readouterr()
        assert isinstance(caught.value.code, int)
        return caught.value.code, said.out, said.err

    return call


@cache
def validator_of(schema: str) -> jsonschema.Draft202012Validator:
    """Of a printed schema; that it is a valid schema is checked here, once, since that takes the longest."""
    jsonschema.Draft202012Validator.check_schema(json.loads(schema))
    return jsonschema.Draft202012Validator(json.loads(schema))


def scene_file(folder: Path, content: Data | str = REACH) -> Path:
    file = folder / "scene.yaml"
    file.write_text(content if isinstance(content, str) else yaml.safe_dump(content), encoding="utf-8")
    return file


# --- valid input ------------------------------------------------------------------


def test_plan_and_check_print_the_reached_goal_and_the_margin_of_keep(run: Run, tmp_path: Path) -> None:
    """A planar arm stays at z = 0, a metre above the limit of `keep`."""
    goals = [{"position": [9.0, 0.0, 0.0]}, {"joints": {**JOINTS, "joint1": 0.4}}]
    scene = scene_file(tmp_path, {**REACH, "task": {"goal": goals, "keep": {"above": -1.0}}})
    status, planned, _ = run("plan", PLANAR4, scene, "-o", "out.json", *QUICK)
    assert status == 0
    for said in (planned, run("check", "out.json")[1]):
        assert "goal          2 of 2 is reached" in said
        assert "keep          above: +1.000 m left at least" in said
    content = json.loads((tmp_path / "out.json").read_text())["certificate"]
    assert content["goal"] == 2
    assert content["keep"][0]["margin"] == pytest.approx(1.0)


def test_the_tolerance_of_a_goal_is_printed_beside_the_error_that_it_allows(run: Run, tmp_path: Path) -> None:
    goal = {**REACH["task"]["goal"], "tolerance": 0.1}
    for task, allows in (({"goal": goal}, True), (REACH["task"], False)):
        planned = run("plan", PLANAR4, scene_file(tmp_path, {**REACH, "task": task}), "-o", "out.json", *QUICK)[1]
        for said in (planned, run("check", "out.json")[1]):
            line = next(line for line in said.splitlines() if line.startswith("tip error"))
            assert line.endswith(" mm at most, the goal allows 100 mm" if allows else " mm at most")


def test_the_saving_is_printed_if_another_cost_than_the_time_is_minimised(run: Run, tmp_path: Path) -> None:
    for objective, prints in (("kinetic", True), ("time", False)):
        scene = scene_file(tmp_path, {**REACH, "objective": objective})
        status, said, _ = run("plan", PLANAR4, scene, "-o", "out.json", *QUICK)
        assert status == 0
        found = re.search(r"^saving +\d+ % less than a motion of [\d.]+ s, which takes [\d.]+ J s$", said, re.M)
        assert (found is not None) == prints


def test_rows_of_a_sequence_name_their_leg_and_show_its_own_objective(run: Run, tmp_path: Path) -> None:
    legs: list[Data] = [
        {"name": "out", "goal": {"joints": {**JOINTS, "joint1": 0.4}}, "objective": "kinetic", "max_duration": 20.0,
         "keep": {"above": -1.0}},
        {"name": "stand", "wait": 0.5},
        {"name": "back", "goal": {"joints": JOINTS}, "keep": {"above": -2.0}},
    ]  # fmt: skip
    scene = scene_file(tmp_path, {**REACH, "task": {"sequence": legs}})
    status, planned, _ = run("plan", PLANAR4, scene, "-o", "out.json", *QUICK)
    assert status == 0
    checked = run("check", "out.json")[1]
    for said in (planned, checked):
        assert re.search(r"keep +above: \+1\.000 m left at least \(at [\d.]+ s, leg out\)", said)
        assert re.search(r"keep +above: \+2\.000 m left at least \(at [\d.]+ s, leg back\)", said)
        assert re.search(r"leg +out +[\d.]+ s, kinetic [\d.]+ J s, margin", said)
        assert re.search(r"leg +stand +0\.50 s, margin", said)
        assert re.search(r"leg +back +[\d.]+ s, margin", said)
    searched = re.compile(
        r"^leg +out .*\n +at most [\d.]+ s was allowed by the planner, which limits it: max_duration may allow more; "
        r"\d+ % less than a motion of [\d.]+ s, which takes [\d.]+ J s\nleg +stand ", re.M
    )  # fmt: skip
    assert searched.search(planned)
    assert (
        planned.count("was allowed by") == planned.count("less than a motion of") == 1
    )  # not of a wait, nor of a time
    assert "was allowed by" not in checked
    assert re.search(r"duration +[\d.]+ % of max_duration \(20 s, leg out\)", checked)
    assert re.search(r"\(margin \+\d\.\d{3} m, at [\d.]+ s, leg (out|stand|back)\)", planned)
    assert re.search(r"margin \[m\] +at \[s\] +leg *\n", checked)
    assert re.search(r"velocity +[\d.]+ % of its limit at most \(joint\d, [\d.]+ s, leg (out|back)\)", checked)
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["metrics"]["cost"] is None  # J s and s do not add up
    assert [leg["metrics"]["cost"]["objective"] for leg in content["legs"]][::2] == ["kinetic", "time"]
    assert [row["leg"] for row in content["certificate"]["keep"]] == ["out", "back"]
    assert "leg" not in content["legs"][0]["certificate"]["keep"][0]


def test_a_sequence_that_fails_prints_the_tip_error_of_the_legs_that_are_done(run: Run, tmp_path: Path) -> None:
    """The tip is far from the goal of the second leg, in a ball: that is no error of the motion."""
    legs = [
        {"name": "out", "goal": {"joints": {**JOINTS, "joint1": 0.4}}},
        {"name": "far", "goal": {"position": [-2.6, 2.4, 0.0]}},
    ]
    ball = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [-2.6, 2.4, 0.0]}
    content = {**REACH, "obstacles": [ball], "task": {"sequence": legs}}
    status, planned, _ = run("plan", PLANAR4, scene_file(tmp_path, content), *QUICK)
    assert status == 1
    for said in (planned, run("check", "plan.json")[1]):
        assert re.search(r"leg +out .*, tip error \d\.\d\d mm\n", said)
        assert re.search(r"leg +far .*, not verified\n", said)
        assert said.count("tip error") == 1


def test_plan_prints_zones_in_one_line_and_check_one_row_for_each(run: Run, tmp_path: Path) -> None:
    sector = {"kind": "swing_sector", "name": "road", "from": -0.2, "to": 1.5, "stop": 0.1, "warn": 0.3}
    scene = scene_file(tmp_path, {**REACH, "zones": [sector]})
    status, planned, _ = run("plan", PLANAR4, scene, "-o", "out.json", *QUICK)
    assert status == 0
    _, checked, _ = run("check", "out.json")
    (line,) = [line for line in planned.splitlines() if line.startswith("zones")]
    assert "beyond the warn distance of road" in line
    assert line.split()[1] == "joint1"
    lines = checked.splitlines()
    row = lines[next(k for k, line in enumerate(lines) if line.startswith("zones")) + 2].split()
    assert row[:3] == ["road", "warn", "joint1"]
    assert row[4] == "rad"
    assert float(row[3]) == pytest.approx(float(line.split()[2]))
    run("plan", PLANAR4, scene_file(tmp_path), "-o", "out.json", *QUICK)
    assert "zones" not in run("check", "out.json")[1]


def test_check_lists_every_zone(run: Run, tmp_path: Path) -> None:
    """Two ceilings over an arm that stays at height 0, 0.5 m and 0.7 m above it."""
    zones = [
        {"name": name, "kind": "ceiling", "height": height, "warn": 2.0}
        for name, height in (("roof", 0.7), ("wire", 0.5))
    ]
    scene = scene_file(tmp_path, {**REACH, "zones": zones})
    status, planned, _ = run("plan", PLANAR4, scene, "-o", "out.json", *QUICK)
    assert status == 0
    assert "(and 1 more)" in planned
    lines = run("check", "out.json")[1].splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("zones"))
    rows = [line.split() for line in lines[head + 2 : head + 4]]
    assert [row[:2] for row in rows] == [["wire", "warn"], ["roof", "warn"]]
    assert float(rows[0][3]) - float(rows[1][3]) == pytest.approx(0.2, abs=1e-3)


def test_self_collision_pairs_objective_and_tip_speed_are_printed_in_words(run: Run, tmp_path: Path) -> None:
    points = [{"position": [4.6, 0.0, -0.3]}, {"position": [3.9, 0.0, -0.6]}]
    scene = {"version": 1, "objective": "effort", "task": {"path": {"waypoints": points, "speed": 0.4}}}
    _, planned, _ = run("plan", "example:backhoe", scene_file(tmp_path, scene), "-o", "out.json", *QUICK)
    _, checked, _ = run("check", "out.json")
    assert re.search(r"between \w+ and the machine itself \(\w+\) ", planned)
    assert "the machine itself (" in checked
    assert "self: " not in planned + checked
    assert re.search(r"objective +effort [\d,.]+ \(kN m\)\^2 s along the path", planned)
    assert re.search(r"work +[\d.]+ k?J ", planned)
    assert re.search(r"tip speed +\d+\.\d % of the asked 0\.4 m/s at most", checked)


@pytest.mark.parametrize(
    ("value", "unit", "said"),
    [
        (0.7131, "J", "0.7131 J"),
        (11394.2, "J", "11.39 kJ"),
        (-2.5e6, "J", "-2.500 MJ"),
        (14_000.4, "J", "14.00 kJ"),
        (999.96, "J", "1000 J"),
        (3.21e9, "J s", "3.210 GJ s"),
        (1.357e9, "N^2 m^2 s", "1357 (kN m)^2 s"),
        (2.5e11, "N^2 m^2 s", "250,000 (kN m)^2 s"),
        (120.0, "N^2 m^2 s", "120.0 N^2 m^2 s"),
        (3.4567, "s", "3.457 s"),
        (0.0, "rad^2/s", "0 rad^2/s"),
    ],
)
def test_quantities_are_printed_with_an_si_prefix(value: float, unit: str, said: str) -> None:
    assert describe_quantity(value, unit) == said


@pytest.mark.parametrize(
    ("objective", "line"),
    [
        (None, r"duration +\d+\.\d\d s \(\d+ samples\), the objective\n"),
        ("work", r"work +[\d.]+ J \(gravity and inertia\), the objective\n"),
        pytest.param("velocity_norm", r"objective +velocity_norm [\d.]+ rad\^2/s\n", marks=pytest.mark.long),
        ("kinetic", r"objective +kinetic [\d.]+ J s\n"),
        pytest.param("effort", r"objective +effort [\d.]+ \(kN m\)\^2 s\n", marks=pytest.mark.long),
    ],
)
def test_the_objective_of_a_motion_to_a_goal_is_printed_once_with_its_unit(
    run: Run, tmp_path: Path, objective: str | None, line: str
) -> None:
    content = REACH if objective is None else REACH | {"objective": objective}
    status, said, _ = run("plan", PLANAR4, scene_file(tmp_path, content), *QUICK)
    assert status == 0
    assert re.search(line, said), said
    assert said.count("objective") == 1


@pytest.mark.parametrize(
    ("given", "legs", "line"),
    [
        ({}, ({}, {}), r"duration +\d+\.\d\d s \(\d+ samples\), the objective\n"),
        ({"objective": "work"}, ({}, {}), r"work +[\d.]+ J \(gravity and inertia\), the objective\n"),
        ({}, ({"objective": "kinetic"}, {"objective": "kinetic"}), r"objective +kinetic [\d.]+ J s\n"),
        ({}, ({"objective": "work"}, {}), None),
    ],
)
def test_an_objective_common_to_all_legs_of_a_sequence_is_printed_once(
    run: Run, tmp_path: Path, given: Data, legs: tuple[Data, Data], line: str | None
) -> None:
    goals = [{**JOINTS, "joint1": angle} for angle in (0.2, 0.4)]
    there, on = ({"goal": {"joints": goal}} | leg for goal, leg in zip(goals, legs, strict=True))
    sequence = [{"name": "there"} | there, {"name": "rest", "wait": 0.5}, {"name": "on"} | on]
    content = {key: REACH[key] for key in ("version", "start")} | given | {"task": {"sequence": sequence}}
    status, said, _ = run("plan", PLANAR4, scene_file(tmp_path, content), *QUICK)
    assert status == 0
    assert said.count("objective") == (line is not None)
    assert line is None or re.search(line, said), said
    cost = json.loads((tmp_path / "plan.json").read_text())["metrics"]["cost"]
    assert line is None or (legs[0] | given).get("objective", "time") == cost["objective"]


def test_plan_check_and_export_work_one_after_the_other(run: Run, tmp_path: Path) -> None:
    chosen = ("--seed", "3", *QUICK)
    status, said, _ = run("plan", PLANAR4, scene_file(tmp_path), "-o", "out.json", *chosen)
    assert status == 0
    assert said.startswith("verified\n")
    for word in ("clearance", "tip error", "duration", "work", "planned in", "out.json"):
        assert word in said
    assert "(method auto, seed 3, effort quick)\n" in said
    content = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert (content["verdict"], content["effort"]) == ("verified", "quick")
    status, said, _ = run("check", "out.json")
    assert status == 0
    assert said.startswith("verified\nplanned with method auto, seed 3, effort quick\n")
    assert re.search(r"velocity +\d+\.\d % of its limit", said)
    assert "not checked  method, seed, effort, findings and message are the file's own words" in said
    edited = content | {"verdict": "failed", "reason": "blocked", "message": "a wall"}
    (tmp_path / "edited.json").write_text(json.dumps(edited), encoding="utf-8")
    status, said, told = run("check", "edited.json")
    assert (status, said.partition("\n")[0]) == (0, "verified")
    assert "verdict: the file says failed (blocked: a wall), but its motion is verified" in told
    for name in ("motion:key:.csv", "motion.npz", "motion.yaml"):  # `:key:` in a name is not replaced by an emoji
        status, said, _ = run("export", "out.json", name)
        assert (status, said) == (0, f"wrote {name}\n")
        assert (tmp_path / name).stat().st_size > 0
    status, _, told = run("export", "out.json", "motion.txt")
    assert status == 2
    assert "motion.txt" in told
    assert "allowed: .csv, .npz, .yaml" in told


def test_plan_prints_the_kept_speed_and_the_approach_of_a_path(run: Run, tmp_path: Path) -> None:
    points = [{"position": [2.0, -0.6, 0.0]}, {"position": [2.0, 0.6, 0.0]}]
    scene = {"version": 1, "start": {"joints": JOINTS}, "task": {"path": {"waypoints": points, "speed": 0.4}}}
    file = scene_file(tmp_path, scene | {"objective": "velocity_norm"})
    status, said, _ = run("plan", PLANAR4, file, "-o", "out.json", *QUICK)
    assert status == 0
    metrics = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["metrics"]
    kept = metrics["asked_speed"]["kept_percent"]
    assert re.search(rf"^asked speed   0\.4 m/s kept on {kept:.0f} % of the path; slower from 0\.00 to ", said, re.M)
    whole = metrics["objective"]["whole"]
    assert f"{whole:.4g} rad^2/s with the approach to it; the local law after the same approach" in said


def test_check_prints_the_length_of_the_path_left_out_by_a_detour(run: Run, around_a_ball: bp.Plan) -> None:
    """A ball of radius 0.3 m is in the middle of the path, with a clearance of 0.02 m."""
    around_a_ball.save("plan.json")
    status, said, _ = run("check", "plan.json")
    assert status == 0
    found = re.search(r"^left out +(\S+) m of 1\.20 m of the path, in 1 detour; it is not proven that .*$", said, re.M)
    assert found is not None
    assert 0.64 <= float(found[1]) < 1.0


def test_check_prints_why_a_plan_failed(run: Run, tmp_path: Path) -> None:
    far = REACH | {"start": {"joints": JOINTS | {"joint2": 9.0}}}
    assert run("plan", PLANAR4, scene_file(tmp_path, far), "-o", "far.json")[0] == 1
    status, said, _ = run("check", "far.json")
    assert status == 1
    assert said.startswith("not verified: outside_limits\n  joint2 starts at 9 rad, allowed -")
    assert said.splitlines()[1].endswith(" rad (9 degrees are 0.1571 rad)")
    assert said.splitlines()[2].startswith("  there is no motion: ")
    assert said.splitlines()[3].startswith("planned with ")
    assert "tip error" not in said


def test_a_tilt_that_may_be_in_degrees_is_told_before_the_plan_is_made_and_not_again(run: Run, tmp_path: Path) -> None:
    wide = REACH | {"task": REACH["task"] | {"keep": {"tilt": {"axis": [0, 0, 1], "tolerance": 1.5}}}}
    warning = "1.5 rad are 85.9 deg; 1.5 degrees are 0.02618 rad"
    status, _, told = run("plan", PLANAR4, scene_file(tmp_path, wide), *QUICK)
    assert (status, told.count(warning)) == (0, 1)
    assert "degrees" not in "".join(run("check", "plan.json")[1:])


def test_a_tampered_plan_fails_the_check(run: Run, tmp_path: Path) -> None:
    run("plan", PLANAR4, scene_file(tmp_path), *QUICK)
    content = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    content["metrics"]["duration"] = 77.0
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    status, _, told = run("check", "plan.json")
    assert status == 0
    assert told.startswith("warning: metrics.duration: the file says 77, the motions have ")
    content["trajectory"]["q"][5][0] += 1.0
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    status, said, _ = run("check", "plan.json")
    assert status == 1
    assert said.startswith("not verified: ")
    assert "joint1 exceeds its velocity limit" in said


def test_with_json_nothing_else_is_printed(run: Run, tmp_path: Path) -> None:
    status, said, told = run("plan", PLANAR4, scene_file(tmp_path), "--json", "--seed", "4", *QUICK)
    content = json.loads(said)
    assert (status, told) == (0, "")
    assert (content["verdict"], content["seed"]) == ("verified", 4)
    assert content["trajectory"]["file"] == "plan.json"


def test_the_printed_schema_accepts_a_scene_and_refuses_an_unknown_key(run: Run) -> None:
    status, said, _ = run("schema")
    validator_of(said).validate(REACH)
    with pytest.raises(jsonschema.ValidationError):
        validator_of(said).validate(REACH | {"clearence": 0.1})
    assert status == 0


@pytest.mark.parametrize(("kind", "folder"), [("job", "scenes/jobs"), ("study", "scenes/studies")])
def test_the_schemas_of_jobs_and_studies_accept_the_examples_which_refer_to_them(
    run: Run, kind: str, folder: str
) -> None:
    status, said, _ = run("schema", kind)
    assert status == 0
    beside = ROOT / folder
    assert json.loads((beside / f"{kind}.schema.json").read_text(encoding="utf-8")) == json.loads(said)
    files = list(beside.glob("*.yaml"))
    assert files
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert text.startswith(f"# yaml-language-server: $schema={kind}.schema.json\n")
        validator_of(said).validate(yaml.safe_load(text))


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("job", {"site": {"clearence": 0.1}}),
        ("job", {"site": {"obstacles": [{"name": "pipe", "shape": "capsule"}]}}),
        ("job", {"site": {"task": {"goal": {"position": [3.0, 0.0, 0.0]}}}}),
        ("job", {"pattern": {"layer": 0.2}}),
        ("job", {"dig": {"trench": {"from": [4.9, 0.0], "to": [1.9, 0.0], "width": 0.6, "depth": "1.2"}}}),
        ("study", {"combine": "all"}),
        ("study", {"best": {"smallest": "duration"}}),
    ],
)
def test_the_schemas_of_jobs_and_studies_refuse_wrong_values(run: Run, kind: str, wrong: Data) -> None:
    _, said, _ = run("schema", kind)
    example = {"job": "scenes/jobs/long_trench.yaml", "study": "scenes/studies/clearance_and_place.yaml"}[kind]
    content = yaml.safe_load((ROOT / example).read_text(encoding="utf-8"))
    validator_of(said).validate(content)
    with pytest.raises(jsonschema.ValidationError):
        validator_of(said).validate(content | wrong)


def test_an_unknown_schema_name_is_refused_with_the_allowed_ones(run: Run) -> None:
    status, _, told = run("schema", "plan")
    assert status == 2
    assert "found plan; allowed: scene, job, study" in told


def test_inspect_prints_the_working_envelope(run: Run) -> None:
    status, said, _ = run("inspect", "example:backhoe")
    assert status == 0
    for word in ("swing", "stick", "bucket_tip", "Denavit-Hartenberg", "working envelope", "digging depth"):
        assert word in said
    assert "greatest height of the teeth  5.50 m" in said


def test_inspect_applies_tip_held_joints_and_limits_of_a_scene(run: Run, tmp_path: Path) -> None:
    joints = {"swing": 0.0, "boom": 0.4, "stick": -1.6}
    content = REACH | {"start": {"joints": joints}, "hold": {"bucket": -0.6}, "tip": "bucket"}
    content["limits"] = {"velocity": {"swing": 0.25}, "position": {"stick": [-2.0, -1.0]}}
    scene = tmp_path / "held.yaml"
    scene.write_text(yaml.safe_dump(content))
    status, said, _ = run("inspect", "example:backhoe", scene)
    assert status == 0
    assert "3 joints move bucket" in said
    assert re.search(r"^swing +-90.0 deg +90.0 deg +0.25 rad/s", said, re.MULTILINE)
    assert re.search(r"^stick +-114.6 deg +-57.3 deg", said, re.MULTILINE)
    assert re.search(r"^ +bucket +-34.4 deg \(-0.6 rad\) +held by the scene", said, re.MULTILINE)
    status, _, said = run("inspect", "example:backhoe", scene, "--tip", "stick")
    assert (status, said) == (2, "error: --tip: is not the scene's tip; found stick; allowed: bucket\n")


def test_inspect_prints_the_extent_of_each_obstacle(run: Run, tmp_path: Path) -> None:
    """A box of 2 x 1 x 1 m turned by 90 degrees, a cube of 2 x 2 x 2 voxels of 1 m, half-spaces and a ceiling."""
    cells = [[x, y, z] for x in (5.5, 6.5) for y in (0.5, 1.5) for z in (0.5, 1.5)]
    (tmp_path / "scan.csv").write_text("\n".join(",".join(map(str, cell)) for cell in cells))
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        PLAIN + "obstacles:\n"
        "- {name: crate, shape: box, size: [2, 1, 1], position: [5, 0, 0.5], rpy: [0, 0, 1.5707963267948966],\n"
        "   clearance: 0.2}\n"
        "- {name: heap, shape: pointcloud, file: scan.csv, resolution: 1}\n"
        "- {name: ground, shape: halfspace, point: [0, 0, -2], normal: [0, 0, 1]}\n"
        "- {name: hall beside the field, shape: box, size: [200, 200, 5], position: [-190, -190, 2.499]}\n"
        "- {name: slope, shape: halfspace, point: [0, 0, -9], normal: [1, 0, 1]}\n"
        "zones:\n- {name: wires, kind: ceiling, height: 8, stop: 0.5, slow: 1.2, warn: 2, links: [boom, stick]}\n"
    )
    status, said, _ = run("inspect", "example:backhoe", scene)
    assert status == 0
    rows = {line.split()[0]: " ".join(line.split()) for line in said.splitlines() if line[:1].strip()}
    assert rows["crate"] == "crate box 4.50..5.50 -1.00..1.00 0.00..1.00 1 piece"
    assert rows["heap"].startswith("heap pointcloud 5.00..7.00 0.00..2.00 0.00..2.00")
    assert rows["ground"] == "ground halfspace no end no end up to -2.00 1 piece"
    assert rows["slope"] == "slope halfspace no end no end no end 1 piece"
    hall = "hall beside the field box -290.00..-90.00 -290.00..-90.00 0.00..5.00 1 piece"
    assert hall in map(" ".join, map(str.split, said.splitlines()))  # a log cuts nothing, and no 0 has a sign
    assert "wires zone, ceiling no end no end from 8.00 1 piece" in map(" ".join, map(str.split, said.splitlines()))
    assert "site a clearance of 0.05 m, where no other is given" in " ".join(said.split())
    assert "  crate has a clearance of 0.2 m\n" in said
    assert "  wires warns at 2 m, slows down at 1.2 m, stops at 0.5 m; is only for boom, stick\n" in said
    assert "  heap " not in said.partition("site  ")[2].partition("  crate")[2]  # it has nothing else to be said


def test_inspect_prints_what_moves_or_appears_and_the_swing_sectors(run: Run, tmp_path: Path) -> None:
    sector = {"kind": "swing_sector", "name": "road", "from": -1.0, "to": 1.2, "stop": 0.2}
    walker = {"name": "walker", "shape": "sphere", "radius": 0.3, "position": [4, -3, 1]}
    content = REACH | {
        "obstacles": [walker | {"velocity": [0.3, 0.4, 0.0], "appears_at": 2.0}, walker | {"name": "post"}],
        "zones": [sector],
    }
    status, said, _ = run("inspect", PLANAR4, scene_file(tmp_path, content))
    assert status == 0
    assert "  walker appears at 2 s and moves at 0.50 m/s, by (0.30, 0.40, 0.00) m every second\n" in said
    assert "  post " not in said
    assert (
        "  road (zone, swing_sector) keeps joint1 within -45.8 to 57.3 deg; stops at 11.46 deg\n" in said
    )  # -0.8 to 1 rad
    content |= {"tracking": {"joints": 0.1}, "zones": [sector | {"slow": 0.3}]}
    _, said, _ = run("inspect", PLANAR4, scene_file(tmp_path, content))
    kept = "keeps joint1 within -40.1 to 51.6 deg (5.7 deg less for the tracking error)"
    assert f"{kept}; warns at 17.19 deg, slows down at 17.19 deg, stops at 11.46 deg" in " ".join(said.split())
    content |= {"limits": {"position": {"joint1": [-0.2, 0.2]}}}
    _, said, _ = run("inspect", PLANAR4, scene_file(tmp_path, content))
    assert f"{kept}; its range is narrower anyway; warns at" in " ".join(said.split())


def test_inspect_prints_the_position_of_joints_that_do_not_move_the_tip(run: Run) -> None:
    status, said, _ = run("inspect", "example:panda", "--tip", "panda_hand")
    assert status == 0
    assert "at 0, since they do not move the tip: panda_finger_joint1, panda_finger_joint2" in said


def test_inspect_marks_assumed_limits_and_prints_no_negative_zero(run: Run, tmp_path: Path) -> None:
    """The URDF of the Panda gives rates, 2.175 rad/s for the first joint, but no accelerations."""
    _, said, _ = run("inspect", "example:panda", "--tip", "panda_hand")
    assert "2.17 rad/s  4.35 rad/s2 (assumed)  87 N m" in said
    assert "an assumed acceleration gives the full rate after 0.5 s" in said
    assert "-0.0000" not in said
    assert "-0.00 " not in said
    content = {
        "version": 1, "tip": "panda_hand", "limits": {"acceleration": {"panda_joint1": 2.0}},
        "task": {"path": {"waypoints": [{"position": [0.4, 0.0, 0.5]}, {"position": [0.4, 0.1, 0.5]}]}},
    }  # fmt: skip
    _, said, _ = run("inspect", "example:panda", scene_file(tmp_path, content))
    assert "2.17 rad/s  2 rad/s2               87 N m" in said  # the second joint's is assumed still
    assert said.count("(assumed)") == 6
    _, said, _ = run("inspect", "example:backhoe")
    assert "assumed" not in said


def test_inspect_and_plan_warn_of_limits_missing_in_the_urdf(run: Run, tmp_path: Path) -> None:
    urdf = tmp_path / "bare.urdf"
    urdf.write_text(Path(PLANAR4).read_text().replace('velocity="', 'velocity="0" was="'))
    status, said, warned = run("inspect", urdf)
    assert status == 0
    assert "1 rad/s" in said
    assert "warning: the URDF gives no velocity limit, or 0, for joint1, joint2, joint3, joint4: 1 rad/s" in warned
    given = REACH | {"limits": {"velocity": dict.fromkeys(JOINTS, 0.9)}}
    for content, count in ((REACH, 1), (given, 0)):
        (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
        status, _, warned = run("plan", urdf, tmp_path / "scene.yaml", *QUICK)
        assert (status, warned.count("no velocity limit")) == (0, count)


def test_plan_check_and_inspect_warn_once_of_an_open_mesh(run: Run, tmp_path: Path) -> None:
    """Two crates without a front from one file, a closed ring, and a flat sheet, which has no inside."""
    crate = trimesh.creation.box((1.0, 1.0, 1.0))
    trimesh.creation.annulus(r_min=0.5, r_max=1.0, height=0.2).export(tmp_path / "ring.stl")
    for _ in range(4):  # too fine for a set of hulls
        crate = crate.subdivide()
    trimesh.Trimesh(crate.vertices, crate.faces[crate.face_normals[:, 0] < 0.5]).export(tmp_path / "crate.stl")
    trimesh.Trimesh(crate.vertices, crate.faces[crate.face_normals[:, 0] > 0.5]).export(tmp_path / "sheet.stl")
    files = {"left": "crate.stl", "right": "crate.stl", "ring": "ring.stl", "sheet": "sheet.stl"}
    meshes = [
        {"name": name, "shape": "mesh", "file": file, "position": [0.0, 2.0 * place, 9.0]}
        for place, (name, file) in enumerate(files.items())
    ]
    scene = scene_file(tmp_path, {**REACH, "obstacles": meshes})
    for command in (("plan", PLANAR4, scene, "-o", "plan.json", *QUICK), ("check", "plan.json"),
                    ("inspect", PLANAR4, scene)):  # fmt: skip
        status, _, warned = run(*command)
        assert status == 0
        assert warned.count("warning") == 1
        assert "the mesh crate.stl (left, right) is not closed" in warned
        assert "fill its holes" in warned


LOST = "error: the output cannot be written: {}\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize(
    "command", [pytest.param(["schema"], marks=pytest.mark.long), ["inspect", PLANAR4], ["--help"]]
)
def test_an_output_that_cannot_be_written_is_one_message_without_traceback(command: list[str]) -> None:
    assert with_output("/dev/full", command) == (2, LOST.format("No space left on device"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_plan_and_its_page_are_written_before_anything_is_printed(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = [tmp_path / "plan.json", tmp_path / "plan.html"]
    scene = scene_file(tmp_path)
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        status, _, errors = run("plan", PLANAR4, scene, *QUICK, "-o", written[0], "--html", written[1])
    assert (status, errors) == (2, LOST.format("No space left on device"))
    assert written[1].read_text(encoding="utf-8").endswith("</html>\n")
    assert json.loads(written[0].read_text(encoding="utf-8"))["verdict"] == "verified"


def test_a_page_that_cannot_be_written_does_not_lose_the_plan(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(plan: bp.Plan, file: Path) -> tuple[str, ...]:
        raise bp.OutputError("cannot be written: No space left on device", file=file)

    monkeypatch.setattr("backhoe_planner.show.write_page", full)
    plan_file, page = tmp_path / "plan.json", tmp_path / "plan.html"
    status, out, err = run("plan", PLANAR4, scene_file(tmp_path), *QUICK, "-o", plan_file, "--html", page)
    assert status == 2
    assert "verified" in out
    assert f"plan          {plan_file}" in out
    assert "No space left on device" in err
    assert bp.load_plan(plan_file).verified


@pytest.mark.parametrize("command", [pytest.param(["inspect", PLANAR4], marks=pytest.mark.long), ["--help"]])
def test_a_command_whose_output_nobody_reads_ends_without_a_word(command: list[str]) -> None:
    """A pipe whose other end is closed, as after `| head -1`; 141 is a shell's status after SIGPIPE."""
    reading, writing = os.pipe()
    os.close(reading)
    assert with_output(writing, command) == (141, "")


def test_without_an_output_a_command_works_and_writes_only_its_plan_to_the_file(tmp_path: Path) -> None:
    """Closed as by `>&-`: the plan file would get descriptor 1, and with it whatever a library prints."""
    plan_file = tmp_path / "plan.json"
    arguments = ["plan", PLANAR4, str(scene_file(tmp_path)), *QUICK, "-o", str(plan_file)]
    done = subprocess.run(
        [*COMMAND, *arguments], stderr=subprocess.PIPE, text=True, timeout=PATIENCE, env=ENVIRONMENT, check=False,
        preexec_fn=lambda: os.close(1),
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(plan_file.read_text(encoding="utf-8"))["verdict"] == "verified"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize("unbuffered", ["", pytest.param("1", marks=pytest.mark.long)])
def test_without_output_and_error_stream_the_exit_status_is_2(unbuffered: str) -> None:
    environment = ENVIRONMENT | {"PYTHONUNBUFFERED": unbuffered}
    with Path("/dev/full").open("wb") as full:
        for command in (["--help"], ["plan", "none.urdf", "none.yaml"]):
            done = subprocess.run(
                [*COMMAND, *command], stdout=full, stderr=full, env=environment, timeout=PATIENCE, check=False
            )
            assert done.returncode == 2


def with_output(output: str | int, command: list[str]) -> tuple[int, str]:
    """The exit status of a command whose output goes to `output`, and its messages."""
    with open(output, "wb") as stream:  # noqa: PTH123  a descriptor or a name
        done = subprocess.run(
            [*COMMAND, *command], stdout=stream, stderr=subprocess.PIPE, text=True, timeout=PATIENCE, env=ENVIRONMENT,
            check=False,
        )  # fmt: skip
    return done.returncode, done.stderr


READY = "from backhoe_planner.__main__ import main; print('ready', flush=True); main()"


TO_AND_FRO = {
    "version": 1,
    "task": {
        "path": {"waypoints": [{"position": [2.0, -1.0, 0.0]}, {"position": [2.4, 1.0, 0.0]}] * 120, "speed": 0.4}
    },
}


def test_an_interrupted_plan_leaves_no_file(tmp_path: Path) -> None:
    """A path of half a kilometre, to and fro, which takes long to plan."""
    scene = scene_file(tmp_path, TO_AND_FRO)
    plan_file = tmp_path / "plan.json"
    with subprocess.Popen(
        [sys.executable, "-c", READY, "plan", PLANAR4, str(scene), "-o", str(plan_file), "--budget", "600"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT,
        # SIGINT is ignored when the tests run in the background
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as running:  # fmt: skip
        assert running.stdout is not None
        assert running.stdout.readline() == "ready\n"
        clock.sleep(1.0)
        assert running.poll() is None, running.communicate()
        running.send_signal(signal.SIGINT)
        _, told = running.communicate(timeout=PATIENCE)  # not the ten minutes of its budget
    assert running.returncode == 130
    assert "Traceback" not in told
    assert told.strip() == "interrupted"
    assert sorted(tmp_path.iterdir()) == [scene]


@pytest.mark.parametrize("after", [0.05, 0.3, 0.7, *(pytest.param(t, marks=pytest.mark.long) for t in (0.15, 0.5))])
def test_an_interrupt_during_imports_gives_no_traceback(tmp_path: Path, after: float) -> None:
    scene, plan_file = scene_file(tmp_path, TO_AND_FRO), tmp_path / "plan.json"
    with subprocess.Popen(
        [sys.executable, "-c", READY, "plan", PLANAR4, str(scene), "-o", str(plan_file), "--budget", "60"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as running:  # fmt: skip
        assert running.stdout is not None
        assert running.stdout.readline() == "ready\n"
        clock.sleep(after)
        running.send_signal(signal.SIGINT)
        _, told = running.communicate(timeout=PATIENCE)
    assert (running.returncode, told.strip()) == (130, "interrupted")
    assert not plan_file.exists()


def test_without_a_command_the_help_is_shown(run: Run) -> None:
    status, said, errors = run()
    assert status == 2
    assert not said
    assert errors.startswith("Usage: ")
    assert "teleop" in errors


def test_an_option_that_is_a_key_of_the_scene_is_told_where_it_belongs(run: Run, tmp_path: Path) -> None:
    told = "objective is a key of the scene file"
    status, _, error = run("plan", PLANAR4, scene_file(tmp_path), "--objective", "work")
    assert (status, told in error) == (2, True)
    assert "payload_at is a key" in run("plan", PLANAR4, scene_file(tmp_path), "--payload-at", "0")[2]
    status, _, error = run("plan", PLANAR4, scene_file(tmp_path), "--speed", "1")
    assert (status, "is a key" in error) == (2, False)  # its place in the scene is another
    assert told not in run("job", "job.yaml", "--objective", "work")[2]


def test_the_version_is_printed_and_the_help_cuts_no_sentence(run: Run) -> None:
    status, out, error = run("--version")
    native = native_version()
    told = f"backhoe-planner {bp.__version__}" + ("" if native is None else f", native {native}")
    assert (status, out.strip(), error) == (0, told, "")
    status, out, _ = run("--help")
    assert status == 0
    assert "..." not in out.partition("Commands:")[2]


def test_help_does_not_load_the_robot_libraries() -> None:
    asked = (
        "import sys\n"
        "from backhoe_planner.__main__ import main\n"
        "sys.argv = ['backhoe-planner', '--help']\n"
        "try:\n    main()\n"
        "except SystemExit as done:\n"
        "    print(done.code, [name for name in ('pinocchio', 'scipy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, env=ENVIRONMENT, check=True)
    assert done.stdout.rstrip().endswith("0 []")


# --- no motion exists: exit 1, and the plan file says why -------------------------------


@pytest.mark.parametrize(
    ("keys", "reason", "word"),
    [
        ({"task": {"goal": {"position": [5.0, 0.0, 0.0]}}}, "unreachable", "1.000 m away"),
        ({"start": {"joints": JOINTS | {"joint3": 3.5}}}, "outside_limits", "joint3 starts at 3.5"),
        (
            {"obstacles": [{"name": "rock", "shape": "sphere", "radius": 0.2, "position": [0.5, 0.1, 0.0]}]},
            "start_in_collision",
            "link1 is 0.140 m inside rock",
        ),
    ],
)
def test_without_a_motion_output_and_plan_file_give_the_reason(
    run: Run, tmp_path: Path, keys: Data, reason: str, word: str
) -> None:
    status, said, _ = run("plan", PLANAR4, scene_file(tmp_path, REACH | keys))
    assert status == 1
    assert said.startswith(f"failed: {reason}\n")
    assert word in said
    content = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    assert (content["verdict"], content["reason"]) == ("failed", reason)
    assert word in content["message"]


def test_a_machine_already_at_its_goal_has_duration_and_bound_0(run: Run, tmp_path: Path) -> None:
    status, said, _ = run("plan", PLANAR4, scene_file(tmp_path, REACH | {"task": {"goal": {"joints": JOINTS}}}))
    assert status == 0
    assert re.search(r"^duration +0\.00 s \(the machine already stands there\)", said, re.MULTILINE)
    assert re.search(r"^bound +no motion can take less than 0\.00 s$", said, re.MULTILINE)


# --- bad input: exit 2, one message, no file ----------------------------------------------


def refused(run: Run, folder: Path, *arguments: str | Path) -> str:
    """The one message; afterwards the folder holds only the inputs."""
    before = sorted(folder.iterdir())
    status, said, told = run(*arguments)
    assert status == 2
    assert said == ""
    assert told.startswith("error: ")
    assert told.count("error: ") == 1
    assert "Traceback" not in told
    assert sorted(folder.iterdir()) == before
    return told


PLAIN = yaml.safe_dump(REACH)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["the file is empty"]),
        ("version: 1\n\ttask: 3\n", ["line 2", "tab", "spaces"]),
        (PLAIN + "version: 1\n", ["version", "twice", "line"]),
        ("- 1\n", ["keys and values"]),
        ('{"format": "backhoe-planner/plan", "version": 1}\n', ["is a plan, not a scene"]),
        ('{"format": "backhoe-planner/job", "version": 1}\n', ["is the plan of a job, not a scene"]),
        (PLAIN.replace("2.6", ".nan"), ["task.goal.position[0]", "finite"]),
        (PLAIN.replace("2.6", ".inf"), ["task.goal.position[0]", "finite"]),
        (PLAIN.replace("joint2: 0.3", "joint2: -.inf"), ["start.joints.joint2", "finite"]),
        (PLAIN.replace("joint2", "jiont2"), ["start.joints", "jiont2", "did you mean 'joint2'"]),
        (PLAIN.replace("    joint2: 0.3\n", ""), ["start.joints", "joints are missing: joint2"]),
        (PLAIN + "clearence: 0.1\n", ["clearence", "clearance"]),
        (PLAIN + "clearance: -0.1\n", ["clearance", "0"]),
        (PLAIN + "tip: bucket\n", ["bucket"]),
        (PLAIN + "payload: .nan\n", ["payload", "finite"]),
        (
            PLAIN + "obstacles:\n- {name: rock, shape: sphere, radius: -0.2, position: [1, 1, 0]}\n",
            ["obstacles[0].radius", "equal to 0.000001", "-0.2"],
        ),
        (PLAIN + "obstacles:\n- {name: spoil, shape: mesh, file: spoil.stl}\n", ["spoil.stl"]),
        (PLAIN + "obstacles:\n- {name: scan, shape: pointcloud, file: empty.xyz, resolution: 0.1}\n", ["empty.xyz"]),
        (PLAIN + "obstacles:\n- {name: land, shape: heightmap, file: empty.xyz, size: [2, 2]}\n", ["empty.xyz"]),
        ("version: 1\ntask: {path: {waypoints: [{position: [2, 0, 0]}]}}\n", ["task.path", "at least 2 waypoints"]),
        ("version: 1\ntask: {path: {file: none.csv}}\n", ["none.csv", "no such path file"]),
        ("version: 1\ntask: {path: {file: empty.xyz}}\n", ["empty.xyz", "empty"]),
    ],
)
def test_a_bad_scene_is_refused_with_one_message(run: Run, tmp_path: Path, text: str, words: list[str]) -> None:
    (tmp_path / "empty.xyz").touch()
    told = refused(run, tmp_path, "plan", PLANAR4, scene_file(tmp_path, text))
    for word in words:
        assert word in told
    if words[0] not in ("start.joints", "bucket"):
        assert str(tmp_path) in told


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: "", []),
        (lambda text: "<robot", []),
        (lambda text: text[: len(text) // 2], []),
        (lambda text: "{}", []),
        (lambda text: text.replace('velocity="1.0"', 'velocity="nan"', 1), ["joint1"]),
        (lambda text: text.replace('upper="3.14159265358979"', 'upper="inf"', 1), ["joint1"]),
        (lambda text: text.replace('xyz="0.5 0 0"', 'xyz="nan 0 0"', 1), []),
        (lambda text: text.replace('size="1.0 0.08 0.08"', 'size="-1.0 0.08 0.08"', 1), []),
        (lambda text: text.replace('radius="0.06"', 'radius="-0.06"'), []),
    ],
)
def test_a_bad_urdf_is_refused_with_its_file_and_joint(
    run: Run, tmp_path: Path, change: Callable[[str], str], words: list[str]
) -> None:
    urdf = tmp_path / "broken.urdf"
    urdf.write_text(change(Path(PLANAR4).read_text(encoding="utf-8")), encoding="utf-8")
    told = refused(run, tmp_path, "plan", urdf, scene_file(tmp_path))
    for word in ("broken.urdf", *words):
        assert word in told


def test_missing_files_and_folders_are_named(run: Run, tmp_path: Path) -> None:
    scene = scene_file(tmp_path)
    assert "none.yaml: no such scene file" in refused(run, tmp_path, "plan", PLANAR4, "none.yaml")
    assert "none.urdf" in refused(run, tmp_path, "plan", "none.urdf", scene)
    assert "the machine comes before the file" in refused(run, tmp_path, "plan", scene, "example:planar4")
    assert "none.json: no such plan file" in refused(run, tmp_path, "check", "none.json")
    assert "create it first" in refused(run, tmp_path, "plan", PLANAR4, scene, "-o", "none/plan.json")
    assert "create it first" in refused(run, tmp_path, "plan", PLANAR4, scene, "--html", "none/page.html")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["plam"], "plam"),
        (["schema", "--loud"], "--loud"),
        (["plan", PLANAR4], "SCENE"),
        (["plan", PLANAR4, "scene.yaml", "--seed", "one"], "--seed"),
        (["plan", PLANAR4, "scene.yaml", "--budget", "-1"], "budget"),
        (["plan", PLANAR4, "scene.yaml", "--method", "magic"], "auto, reactive"),
        (["inspect", PLANAR4, "--tip", "bucket"], "bucket"),
        (["inspect", PLANAR4, "--plot", "reach.jpgg"], ".png, .svg, .pdf"),
        (["plan", PLANAR4, "scene.yaml", "--html", "page.pdf"], ".html, .htm"),
    ],
)
def test_a_bad_command_line_names_the_wrong_argument(run: Run, tmp_path: Path, arguments: list[str], word: str) -> None:
    scene_file(tmp_path)
    assert word in refused(run, tmp_path, *arguments)


ONE_JOINT = """<robot name="one"><link name="base"/>
  <link name="arm"><collision><geometry><mesh filename="arm.obj"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""
WEDGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_a_machine_with_one_joint_is_inspected(run: Run, tmp_path: Path) -> None:
    (tmp_path / "arm.obj").write_text(WEDGE, encoding="utf-8")
    (tmp_path / "one.urdf").write_text(ONE_JOINT, encoding="utf-8")
    assert run("inspect", "one.urdf")[0] == 0


@pytest.mark.parametrize(("given", "shown"), [("0.3", "0.3 N m"), ("87.5", "87.5 N m"), ("25000", "25,000 N m")])
def test_inspect_prints_torque_limits_of_any_size(run: Run, tmp_path: Path, given: str, shown: str) -> None:
    (tmp_path / "arm.obj").write_text(WEDGE, encoding="utf-8")
    (tmp_path / "one.urdf").write_text(ONE_JOINT.replace('effort="1"', f'effort="{given}"'), encoding="utf-8")
    status, said, _ = run("inspect", "one.urdf")
    assert status == 0
    assert f" {shown}" in said


def test_plan_and_page_cannot_be_the_same_file(run: Run, tmp_path: Path) -> None:
    assert "the path of another output" in refused(
        run, tmp_path, "plan", PLANAR4, scene_file(tmp_path), "-o", "both.json", "--html", "both.json"
    )


@pytest.fixture
def site_of_files(tmp_path: Path) -> Path:
    """A machine with a mesh, and a scene with a file of every kind."""
    (tmp_path / "arm.obj").write_text(WEDGE, encoding="utf-8")
    (tmp_path / "one.urdf").write_text(ONE_JOINT, encoding="utf-8")
    (tmp_path / "path.csv").write_text("x,y,z\n0,0,0\n0,0,0.1\n", encoding="utf-8")
    (tmp_path / "hill.csv").write_text("0,0\n0,0\n", encoding="utf-8")
    (tmp_path / "scan.xyz").write_text("9 9 9\n", encoding="utf-8")
    (tmp_path / "rock.obj").write_text(WEDGE, encoding="utf-8")
    obstacles = [
        {"name": "hill", "shape": "heightmap", "file": "hill.csv", "size": [1, 1], "position": [0, 9, -9]},
        {"name": "scan", "shape": "pointcloud", "file": "scan.xyz", "resolution": 0.1},
        {"name": "rock", "shape": "mesh", "file": "rock.obj", "position": [9, 0, 0]},
    ]
    return scene_file(tmp_path, {"version": 1, "task": {"path": {"file": "path.csv"}}, "obstacles": obstacles})


@pytest.mark.parametrize("option", ["-o", "--html"])
@pytest.mark.parametrize(
    "name", ["one.urdf", "arm.obj", "scene.yaml", "path.csv", "hill.csv", "scan.xyz", "rock.obj", "other_name"]
)
def test_no_output_replaces_an_input(run: Run, site_of_files: Path, name: str, option: str) -> None:
    folder = site_of_files.parent
    (folder / "other_name").symlink_to("hill.csv")
    before = {file: file.read_bytes() for file in folder.iterdir()}
    told = refused(run, folder, "plan", "one.urdf", site_of_files, option, name)
    assert name in told
    assert "input of this command" in told
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_view_and_export_do_not_replace_the_inputs_of_a_plan(run: Run, tmp_path: Path) -> None:
    shutil.copy(ROOT / "models" / "backhoe.urdf", tmp_path)
    shutil.copy(ROOT / "models" / "backhoe.hydraulics.yaml", tmp_path)
    joints = {"swing": 0.0, "boom": 0.3, "stick": -0.9, "bucket": -0.5}
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"joints": joints | {"swing": 0.1}}}}
    assert run("plan", "backhoe.urdf", scene_file(tmp_path, content), "-o", "plan.json", *QUICK)[0] == 0
    for arguments in (
        ("view", "plan.json", "--html", "plan.json"),
        ("view", "plan.json", "--html", "backhoe.urdf"),
        ("export", "plan.json", "backhoe.hydraulics.yaml"),
    ):
        assert "input of this command" in refused(run, tmp_path, *arguments)


def test_plot_and_live_view_refuse_the_plan_of_a_job(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "job.json"
    file.write_text('{"format": "backhoe-planner/job"}\n', encoding="utf-8")
    for command in (("plot", file, "job.png"), ("view", file)):
        assert "view PLAN --html PAGE" in refused(run, tmp_path, *map(str, command))
