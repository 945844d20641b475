"""A file given to the wrong command is refused; the message says what it is and which command takes it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import backhoe_planner as bp

SCENE = "version: 1\nstart: {joints: {swing: 0.1}}\ntask: {wait: 1.0}\n"
JOB = "version: 1\ndig: {depth: 1.0}\ndump: []\n"
FILES = {
    "scene.yaml": SCENE,
    "scene.json": json.dumps({"version": 1, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}}),
    "job.yaml": f"# a trench\n{JOB}site:\n  task: none\n",
    "study.yaml": 'version: 1\nmachine: "example:planar4"\nscene:\n  task: {}\n"parameters": {clearance: [0.1]}\n',
    "study_of_job.yaml": "version: 1\njob: job.yaml\n",
    "plan.json": '{"format": "backhoe-planner/plan", "version": 1}',
    "job_plan.json": '\ufeff{"format":"backhoe-planner/job", "version": 1}',
    "stand.json": '{\n "format": "backhoe-planner/stand",\n "version": 1}',
    "arm.urdf": '<?xml version="1.0"?>\n<!-- task: none -->\n<robot name="arm"/>',
}
TAKEN = {
    "scene.yaml": ("a scene", "`backhoe-planner plan URDF scene.yaml` takes it"),
    "scene.json": ("a scene", "`backhoe-planner plan URDF scene.json` takes it"),
    "job.yaml": ("a job", "`backhoe-planner job job.yaml` and `backhoe-planner stand job.yaml` take it"),
    "study.yaml": ("a study", "`backhoe-planner study study.yaml` takes it"),
    "study_of_job.yaml": ("a study", "`backhoe-planner study study_of_job.yaml` takes it"),
    "plan.json": ("a plan", "`backhoe-planner view`, `check`, `plot` and `export` take it"),
    "job_plan.json": ("the plan of a job", "`backhoe-planner check`, `view --html` and `export` take it"),
    "stand.json": ("the answer of `backhoe-planner stand`", "the jobs and the plans of its places lie beside it"),
    "arm.urdf": (
        "a URDF",
        "`backhoe-planner plan arm.urdf SCENE` takes it, before the scene, and `backhoe-planner inspect arm.urdf`",
    ),
}
READERS: dict[str, tuple[Callable[[Path], object], type[bp.InputError]]] = {
    "a scene": (bp.load_scene, bp.SceneError),
    "a job": (bp.load_job, bp.SceneError),
    "a study": (bp.load_study, bp.StudyError),
    "a plan": (bp.load_plan, bp.PlanFileError),
    "the plan of a job": (bp.load_job_plan, bp.PlanFileError),
    "a URDF": (bp.load_robot, bp.RobotError),
}


@pytest.mark.parametrize(
    ("name", "reader"), [(name, reader) for name in FILES for reader in READERS if TAKEN[name][0] != reader]
)
def test_a_file_of_another_kind_is_refused_naming_the_command_that_takes_it(
    name: str, reader: str, tmp_path: Path
) -> None:
    file = tmp_path / name
    file.write_text(FILES[name], encoding="utf-8")
    read, error = READERS[reader]
    words, taken = TAKEN[name]
    with pytest.raises(error) as raised:
        read(file)
    assert str(raised.value) == f"{file}: is {words}, not {reader} ({taken})"


@pytest.mark.parametrize("text", ["dig: {depth: 1}\ntask: {wait: 1.0}\n", "obstacles: []\n", "- task\n", "{task: ["])
def test_errors_in_a_file_with_keys_of_a_scene_or_of_no_kind_suggest_no_other_command(
    text: str, tmp_path: Path
) -> None:
    (tmp_path / "scene.yaml").write_text(text)
    with pytest.raises(bp.SceneError) as raised:
        bp.load_scene(tmp_path / "scene.yaml")
    assert "backhoe-planner" not in str(raised.value)
