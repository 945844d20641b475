"""The study file: values of parameters, the rows they give, and errors before anything runs."""

from __future__ import annotations

import json
import math
import re
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.files.records import described_fields
from backhoe_planner.job import JobFigures
from backhoe_planner.planning import Bound, CertificateRecord, Findings, Metrics
from backhoe_planner.studies import Study, study_from_dict
from backhoe_planner.studies.rows.drawing import draw_rows
from backhoe_planner.studies.rows.key_paths import is_record, members
from backhoe_planner.studies.rows.metrics import annotation_below, find_metric, keys_of
from backhoe_planner.studies.rows.template import build_template
from backhoe_planner.studies.rows.units import unit_in, unit_of
from backhoe_planner.studies.schema.values import read_values

ROOT = Path(bp.__file__).resolve().parents[1]
JOINTS = {"joint1": 1.42, "joint2": 1.86, "joint3": 1.71, "joint4": 1.16}
SCENE: dict[str, Any] = {
    "version": 1,
    "start": {"joints": JOINTS},
    "task": {"goal": {"position": [0.45, -2.16, 0.0]}},
    "obstacles": [
        {"name": "point", "shape": "sphere", "radius": 0.01, "position": [0.63, 0.59, 0.0]},
        {"name": "pipe no. 2.5", "shape": "sphere", "radius": 0.01, "position": [-3.0, 3.0, 0.0]},
    ],
}


def study(parameters: dict[str, Any], **keys: Any) -> Study:
    return study_from_dict(
        {"version": 1, "machine": "example:planar4", "scene": SCENE, "parameters": parameters, **keys}
    )


def rows(parameters: dict[str, Any], **keys: Any) -> list[dict[str, Any]]:
    return [dict(row.values) for row in draw_rows(study(parameters, **keys))]


@pytest.mark.parametrize(
    ("given", "listed"),
    [
        (0.3, (0.3,)),
        ("auto", ("auto",)),
        ([1, 2.5], (1, 2.5)),
        ({"from": 0.0, "to": 0.4, "count": 3}, (0.0, 0.2, 0.4)),
        ({"from": 0.1, "to": 0.3, "step": 0.1}, (0.1, 0.2, 0.3)),
        ({"from": 0.0, "to": 0.35, "step": 0.1}, (0.0, 0.1, 0.2, 0.3)),
        ({"from": 3, "to": 1, "step": -1}, (3, 2, 1)),
        ({"from": 2.0, "to": 2.0, "count": 1}, (2.0,)),
    ],
)
def test_values_may_be_listed_or_given_as_ranges(given: Any, listed: tuple[Any, ...]) -> None:
    assert read_values(given).listed == listed


@pytest.mark.parametrize(
    ("given", "mean", "low", "high"),
    [
        ({"uniform": [2.0, 4.0]}, 3.0, 2.0, 4.0),
        ({"normal": [1.0, 0.1]}, 1.0, 0.4, 1.6),
        ({"log_uniform": [0.1, 10.0]}, 9.9 / math.log(100.0), 0.1, 10.0),
        ({"choice": [1.0, 3.0]}, 2.0, 1.0, 3.0),
    ],
)
def test_distributions_have_the_expected_mean_and_bounds(given: Any, mean: float, low: float, high: float) -> None:
    rng, values = np.random.default_rng(1), read_values(given)
    drawn = [values.one(rng) for _ in range(4000)]
    assert min(drawn) >= low
    assert max(drawn) <= high
    assert float(np.mean(drawn)) == pytest.approx(mean, rel=0.06)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([], "empty list"),
        (None, "has no value"),
        ({"from": 0.0, "to": 1.0, "count": 0}, "the range is empty"),
        ({"from": 0.0, "to": 1.0, "step": -0.1}, "the range is empty"),
        ({"from": 0.0, "to": 1.0}, "one of count and step"),
        ({"to": 1.0, "count": 2}, "the range has no from"),
        ({"from": 0.0, "to": 1.0, "count": 2, "stop": 3}, "did you mean 'step'"),
        ({"unifrom": [0, 1]}, "did you mean 'uniform'"),
        ({"uniform": [1.0, 1.0]}, "uniform is empty"),
        ({"uniform": [1.0]}, "not a pair of numbers"),
        ({"normal": [0.0, -1.0]}, "negative standard deviation"),
        ({"log_uniform": [0.0, 1.0]}, "allowed: numbers above 0"),
        ({"choice": []}, "at least one value"),
        ([0.1, float("nan")], "finite numbers"),
    ],
)
def test_invalid_values_are_refused_naming_the_key(given: Any, said: str) -> None:
    with pytest.raises(bp.StudyError, match=r"parameters\.clearance: .*" + said):
        study({"clearance": given})


def test_a_grid_has_every_combination_and_the_last_parameter_changes_first() -> None:
    assert rows({"clearance": [0.1, 0.2], "seed": [0, 1]}) == [
        {"clearance": clearance, "seed": seed} for clearance in (0.1, 0.2) for seed in (0, 1)
    ]


def test_zip_combines_values_by_position_and_repeats_a_single_value() -> None:
    found = rows({"clearance": [0.1, 0.2], "seed": [5, 6], "effort": "quick"}, combine="zip")
    assert found == [{"clearance": 0.1, "seed": 5, "effort": "quick"}, {"clearance": 0.2, "seed": 6, "effort": "quick"}]


def test_a_larger_count_adds_rows_without_changing_the_others() -> None:
    parameters = {"clearance": {"uniform": [0.1, 0.3]}, "seed": [0, 1, 2]}
    few, many = (rows(parameters, combine="random", count=count, seed=4) for count in (5, 50))
    assert many[:5] == few
    assert {row["seed"] for row in many} == {0, 1, 2}
    assert rows(parameters, combine="random", count=5, seed=5) != few
    gridded = {"clearance": {"uniform": [0.1, 0.3]}, "seed": [0, 1]}
    assert rows(gridded, count=3)[:4] == rows(gridded, count=2)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"combine": "random"}, "count is missing"),
        ({"count": 3}, "count cannot be given beside a grid of lists"),
        ({"combine": "zip", "parameters": {"clearance": [0.1, 0.2], "seed": [1, 2, 3]}}, "clearance: 2, seed: 3"),
        ({"scene": None}, "exactly one of scene, job"),
        ({"machine": None}, "machine is missing"),
        ({"parameters": {f"obstacles.point.position.{k}": {"from": 0, "to": 1, "count": 1000} for k in (0, 1, 2)}},
         "at most 1000000"),
        ({"metric": ["duration"]}, "did you mean 'metrics'"),
        ({"best": {"lest": "duration"}}, r"^best\.lest: there is no such key; did you mean 'least'"),
    ],
)  # fmt: skip
def test_inconsistent_studies_are_refused(keys: dict[str, Any], said: str) -> None:
    content = {"version": 1, "machine": "example:planar4", "scene": SCENE, "parameters": {"clearance": [0.1]}}
    with pytest.raises(bp.StudyError, match=said):
        study_from_dict(content | keys)


@pytest.mark.parametrize(
    ("path", "address"),
    [
        ("clearance", ("clearance",)),
        ("obstacles.point.position", ("obstacles", 0, "position")),
        ("obstacles.pipe no. 2.5.position.1", ("obstacles", 1, "position", 1)),
        ("obstacles.1.clearance", ("obstacles", 1, "clearance")),
        ("gains.s_o", ("gains", "s_o")),
        ("base.position", ("base", "position")),
        ("base.position.0", ("base", "position", 0)),
        ("limits.velocity_scale", ("limits", "velocity_scale")),
        ("limits.acceleration.joint1", ("limits", "acceleration", "joint1")),
        ("task.goal.position.2", ("task", "goal", "position", 2)),
        ("start.joints.joint2", ("start", "joints", "joint2")),
        ("seed", ()),
    ],
)
def test_key_paths_address_the_keys_of_the_schema(path: str, address: tuple[Any, ...]) -> None:
    template, _ = build_template(study({path: [1]}))
    assert template.addresses[path] == address
    content, settings = template.filled({path: 7})
    node: Any = content
    for part in address:
        node = node[part]
    assert (node if address else settings[path]) == 7


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("clearence", "did you mean 'clearance'"),
        ("efort", "did you mean 'effort'"),
        ("obstacles.pint.position", "did you mean 'point'"),
        ("obstacles.2.position", "0 to 1"),
        ("obstacles.point.length", "there is no key 'length' in obstacles.0"),
        ("task.goal.position.3", "0 to 2"),
        ("gains.s_oo", "did you mean 's_o'"),
        ("clearance.deep", "there is no key 'deep'"),
    ],
)
def test_an_unknown_key_path_is_refused_with_the_nearest_key(path: str, said: str) -> None:
    with pytest.raises(bp.StudyError, match=said) as caught:
        build_template(study({path: [1]}))
    assert caught.value.key == f"parameters.{path}"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"parameters": {"obstacles.point.position": [[1, 1, 0]], "obstacles.0.position.1": [1]}}, "sets too"),
        ({"parameters": {"method": ["automatic"]}}, "there is no such method; found automatic"),
        ({"parameters": {"effort": ["quik"]}}, "did you mean 'quick'"),
        ({"parameters": {"seed": [-1]}}, "is not a seed"),
        ({"parameters": {"seed": {"uniform": [0, 9]}}}, "not whole"),
        ({"metrics": ["durration"]}, "did you mean 'duration'"),
        ({"metrics": ["energy.wrk"]}, "did you mean 'work'"),
        ({"metrics": ["min_clearance"]}, "is no single figure; allowed: min_clearance.link"),
        ({"metrics": ["planning_time"]}, "depends on the computer"),
        ({"best": "findings.way"}, "is no number"),
        ({"scene": "no_such.yaml"}, "scene: no_such.yaml: no such scene file"),
        ({"machine": "example:planar5"}, "no such example robot"),
        ({"scene": SCENE | {"clearence": 1}}, "scene: clearence: there is no such key"),
    ],
)
def test_unknown_settings_metrics_and_files_are_refused_before_anything_runs(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(bp.InputError, match=said):
        build_template(study(**({"parameters": {"clearance": [0.1]}} | keys)))


def test_errors_in_a_study_file_name_the_line(tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    text = f"version: 1\nmachine: example:planar4\nscene: {ROOT}/scenes/paper_planar.yaml\nparameters:\n  CLEAR: [1]\n"
    file.write_text(text.replace("CLEAR", "clearence"))
    with pytest.raises(bp.StudyError, match=rf"{file}: parameters\.clearence \(line 5\): there is no key"):
        build_template(bp.load_study(file))
    file.write_text(text.replace("CLEAR: [1]", "clearance: {from: 1, to: 0, step: 1}"))
    with pytest.raises(bp.StudyError, match=r"parameters\.clearance \(line 5\): the range is empty"):
        bp.load_study(file)
    file.write_text("version: 1\ntask: {}\nstart: {}\n")
    with pytest.raises(bp.StudyError, match="is a scene, not a study"):
        bp.load_study(file)


def test_parameters_may_address_keys_of_a_job_and_of_its_site() -> None:
    content = {"version": 1, "job": "scenes/jobs/trench_beside_gas_pipe.yaml"}
    site = bp.load_job(ROOT / "scenes/jobs/trench_beside_gas_pipe.yaml").site_scene
    name = site.obstacles[0].name
    paths = ["dig.trench.depth", "bucket.fill", f"obstacles.{name}.clearance", "base.position.0", "machine", "seed"]
    values = [1.0, 0.9, 0.3, 0.5, "example:backhoe", 3]
    given = {path: [value] for path, value in zip(paths, values, strict=True)}
    template, _ = build_template(study_from_dict(content | {"parameters": given}))
    assert template.addresses[paths[2]] == ("site", "obstacles", 0, "clearance")
    filled, settings = template.filled(dict(zip(paths, values, strict=True)))
    assert (filled["dig"]["trench"]["depth"], filled["site"]["base"]["position"][0], settings["seed"]) == (1.0, 0.5, 3)
    with pytest.raises(bp.StudyError, match="not a setting of a job"):
        build_template(study_from_dict(content | {"parameters": {"method": ["auto"]}}))


def test_parameters_have_the_units_of_their_keys() -> None:
    """The units are those of docs/scene-file.md and docs/jobs.md."""
    units = {
        "clearance": "m", "payload": "kg", "soil.density": "kg/m^3", "obstacles.point.position.0": "m",
        "obstacles.point.velocity": "m/s", "obstacles.point.appears_at": "s", "task.max_duration": "s",
        "task.goal.pitch": "rad", "task.goal.quaternion": "", "limits.velocity.joint1": "rad/s or m/s",
        "limits.velocity_scale": "", "gains.s_o": "", "method": "", "seed": "", "base.heading": "rad",
        "base.position.1": "m", "objective": "",
    }  # fmt: skip
    template, _ = build_template(study({path: [1] for path in units if path not in ("method", "objective")}))
    assert template.units == {path: unit for path, unit in units.items() if unit}
    assert template.heading("clearance") == "clearance [m]"
    assert template.heading("seed") == "seed"
    units = {"dig.trench.depth": "m", "bucket.capacity": "m^3", "bucket.fill": "", "base.heading": "rad"}
    content = {"version": 1, "job": "scenes/jobs/trench_beside_gas_pipe.yaml"}
    template, _ = build_template(study_from_dict(content | {"parameters": {path: [1] for path in units}}))
    assert template.units == {path: unit for path, unit in units.items() if unit}


def test_the_shipped_studies_can_be_prepared() -> None:
    files = sorted((ROOT / "scenes" / "studies").glob("*.yaml"))
    assert files
    for file in files:
        template, _ = build_template(bp.load_study(file))
        assert template.metrics
    assert bp.load_study(Path("scenes/studies") / files[0].name).rows > 1, "from any working directory"


@pytest.mark.parametrize(
    ("objectives", "parameters", "metric"),
    [
        (("work", "work"), {"clearance": [0.1]}, "cost.value"),
        (("work", "time"), {"clearance": [0.1]}, "duration"),
        (("work", None), {"clearance": [0.1]}, "duration"),  # to a goal, the default is the time
        (("work", "work"), {"task.sequence.b.objective": ["time"]}, "duration"),
    ],
)
def test_sequences_of_legs_with_different_objectives_are_compared_by_the_duration(
    objectives: tuple[str | None, ...], parameters: dict[str, Any], metric: str
) -> None:
    goal = SCENE["task"]["goal"]
    legs = [
        {"name": name, "goal": goal} | ({"objective": objective} if objective else {})
        for name, objective in zip("ab", objectives, strict=True)
    ]
    scene = SCENE | {"task": {"sequence": [*legs, {"name": "c", "wait": 1.0}]}}
    template, _ = build_template(study(parameters, scene=scene))
    assert template.best.metric == metric


def numbers_below(annotation: Any, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """The paths to all numbers of a plan below an annotation, the first entry of each list."""
    for kind in members(annotation):
        if typing.get_origin(kind) is tuple:
            yield from numbers_below(typing.get_args(kind)[0], (*path, "0"))
        elif keys := keys_of(kind):
            for key in keys:
                yield from numbers_below(annotation_below(kind, key), (*path, key))
        elif kind is float:
            yield path


WITHOUT_UNIT = {  # a ratio, or a figure whose unit differs from plan to plan
    r"certificate\.limits\.\w+\.(?!time)\w+", r"certificate\.keep\.0\.(margin|value)", r"metrics\.joint_length",
    r".*\.(obstruction|law_breaks)\.(distance|margin)", r"findings\.detours\.0\.(distance|margin)",
    r"findings\.nearest\.q\.0", r"findings\.zones\.0\.depth", r"metrics\.(cost|objective)\.(value|law|whole)",
    r"figures\.(pump|engine)", r"findings\.fast\.cost",
}  # fmt: skip


def test_every_figure_has_its_unit() -> None:
    roots = {"metrics": Metrics, "certificate": CertificateRecord, "bound": Bound, "findings": Findings}
    found = {path for name, kind in {**roots, "figures": JobFigures}.items() for path in numbers_below(kind, (name,))}
    assert len(found) > 100
    for path in found:
        free = any(re.fullmatch(pattern, ".".join(path)) for pattern in WITHOUT_UNIT)
        assert free == (unit_of(path) == ""), path
    assert unit_of(("findings", "fast", "cost"), "work") == "J"


def docstrings_below(annotation: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    """The paths to all numbers of records below an annotation, with the docstrings of their keys."""
    for kind in members(annotation):
        if typing.get_origin(kind) is tuple:
            yield from docstrings_below(typing.get_args(kind)[0], (*path, "0"))
        elif is_record(kind):
            words = described_fields(kind)
            for key, field in kind.model_fields.items():
                if float in members(field.annotation):
                    yield (*path, key), words.get(key, "")
                yield from docstrings_below(field.annotation, (*path, key))


def test_units_of_figures_are_those_of_their_docstrings() -> None:
    """A docstring with several units describes several keys; `asked` of a limit is only in older files."""
    roots = {"metrics": Metrics, "certificate": CertificateRecord, "findings": Findings, "figures": JobFigures}
    found = {path: words for name, kind in roots.items() for path, words in docstrings_below(kind, (name,))}
    units = {path: unit for path, words in found.items() if (unit := unit_in([words])) and path[-1] != "asked"}
    assert len(units) > 30
    wrong = {path: unit for path, unit in units.items() if unit != "unit" and unit_of(path) != unit}
    assert wrong == {}


@pytest.mark.parametrize(
    ("name", "kind", "objective", "unit"),
    [
        ("duration", "scene", None, "s"),
        ("energy.work", "scene", None, "J"),
        ("energy.effort", "scene", None, "N^2 m^2 s"),
        ("cost.value", "scene", "work", "J"),
        ("cost.value", "scene", "time", "s"),
        ("cost.value", "scene", None, ""),
        ("min_clearance.margin", "scene", None, "m"),
        ("tip_error.max", "scene", None, "m"),
        ("tip_error.max_angle", "scene", None, "rad"),
        ("limits.position.time", "scene", None, "s"),
        ("findings.nearest.position.2", "scene", None, "m"),
        ("longer_percent", "scene", None, "%"),
        ("goal", "scene", None, ""),
        ("production", "job", None, "m^3/h"),
        ("cycles", "job", None, ""),
    ],
)
def test_units_are_those_of_the_plan_file(name: str, kind: Any, objective: str | None, unit: str) -> None:
    assert find_metric(name, kind, objective=objective).unit == unit


def test_a_study_takes_the_files_beside_those_of_its_scene_along(tmp_path: Path) -> None:
    """The scale of heights is in the .aux.xml of a GeoTIFF, the numbers of a glTF are in the files that it names."""
    (tmp_path / "ground.tif").touch()
    (tmp_path / "rock.gltf").write_text(json.dumps({"buffers": [{"uri": "rock%201.bin"}, {"uri": "data:,"}]}))
    beside = {"ground.tif.aux.xml", "ground.tfw", "ground.prj", "rock 1.bin"}
    for name in (*beside, "other.bin", "ground.csv"):
        (tmp_path / name).touch()
    scene = {
        "version": 1, "start": {"joints": {}}, "task": {"goal": {"joints": {}}},
        "obstacles": [
            {"name": "ground", "shape": "heightmap", "file": "ground.tif", "size": [1, 1]},
            {"name": "rock", "shape": "mesh", "file": "rock.gltf"},
        ],
    }  # fmt: skip
    (tmp_path / "scene.yaml").write_text(json.dumps(scene))
    content = {"version": 1, "machine": "example:planar4", "scene": "scene.yaml", "parameters": {"clearance": [0.1]}}
    _, inputs = build_template(study_from_dict(content, folder=tmp_path))
    assert {file.name for file in inputs.files} == {"ground.tif", "rock.gltf", *beside}
