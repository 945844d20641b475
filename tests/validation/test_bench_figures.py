"""The comparison of two runs of the bench, from files written by hand."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import bench_all
import pytest

from backhoe_planner.errors import InputError
from backhoe_planner.native import native_version
from validation import bench_figures
from validation.bench_figures import Figure, changes_table, compare, differences, load, save
from validation.benches import BENCHES

HALF = {"name": "a step", "value": 50.0, "unit": "us", "noise": 0.2, "reference": 100.0}


def write(path: Path, *figures: dict[str, Any], **keys: Any) -> Path:
    content = {
        "version": 1, "setting": "short", "processor": "an abacus", "versions": {"python": "3.11"}, "seconds": 1.0,
        "figures": list(figures),
    }  # fmt: skip
    path.write_text(json.dumps({**content, **keys}))
    return path


def verdict(tmp_path: Path, before: dict[str, Any], now: dict[str, Any]) -> tuple[str, float]:
    runs = [load(write(tmp_path / "run.json", HALF | keys)) for keys in (before, now)]
    (change,) = compare(*runs)
    return change.verdict, change.ratio


@pytest.mark.parametrize(
    ("before", "now", "expected", "ratio"),
    [
        ({}, {}, "same", 1.0),
        ({}, {"value": 100.0, "reference": 200.0}, "same", 1.0),  # a machine of half the speed
        ({}, {"value": 62.0}, "same", 1.24),  # 12 of 62 is within 0.2
        ({}, {"value": 63.0}, "worse", 1.26),
        ({}, {"value": 50.0, "reference": 200.0}, "better", 0.5),
        ({}, {"value": 63.0, "noise": 0.3}, "same", 1.26),  # the larger noise of the two counts
        ({"noise": 0.3}, {"value": 63.0}, "same", 1.26),
        ({"reference": None}, {"value": 100.0, "reference": None}, "worse", 2.0),
        ({"better": "more"}, {"better": "more", "value": 100.0}, "better", 2.0),
        ({"better": "more"}, {"better": "more", "value": 25.0}, "worse", 0.5),
        ({"value": 0.0}, {"value": 0.0}, "same", 1.0),
        ({"value": 0.0, "noise": 0.0}, {"value": 1.0, "noise": 0.0}, "worse", math.inf),
        ({"value": 1.0, "noise": 0.0}, {"value": 0.0, "noise": 0.0}, "better", 0.0),
    ],
)
def test_a_figure_is_compared_by_its_ratio_to_the_reference(
    tmp_path: Path, before: dict[str, Any], now: dict[str, Any], expected: str, ratio: float
) -> None:
    found, by = verdict(tmp_path, before, now)
    assert found == expected
    assert by == pytest.approx(ratio)


def test_figures_of_only_one_run_are_new_or_gone(tmp_path: Path) -> None:
    before = load(write(tmp_path / "a.json", HALF, HALF | {"name": "old"}))
    now = load(write(tmp_path / "b.json", HALF | {"name": "young"}, HALF | {"value": 500.0}))
    changes = compare(before, now)
    assert [(one.name, one.verdict) for one in changes] == [("young", "new"), ("a step", "worse"), ("old", "gone")]
    lines = changes_table(changes).splitlines()
    assert [line.split("|")[1].strip() for line in lines[2:]] == ["worse", "gone", "new"]
    assert changes_table(compare(before, before)) == "all 2 figures are the same within their noise"


def test_another_processor_and_other_versions_are_reported(tmp_path: Path) -> None:
    before = load(write(tmp_path / "a.json", versions={"python": "3.10", "pin": "4.0"}))
    now = load(write(tmp_path / "b.json", processor="a slide rule"))
    assert differences(before, now) == [
        "processor: an abacus before, a slide rule now",
        "pin: 4.0 before, none now",
        "python: 3.10 before, 3.11 now",
    ]
    assert differences(now, now) == []


def test_a_short_run_is_not_compared_with_a_long_one(tmp_path: Path) -> None:
    short, long = load(write(tmp_path / "a.json")), load(write(tmp_path / "b.json", setting="long"))
    with pytest.raises(InputError, match="another setting; found short; allowed: long"):
        compare(short, long)


def test_a_saved_run_is_loaded_unchanged(tmp_path: Path) -> None:
    figures = [Figure.model_validate(HALF), Figure(name="refuted", value=0.0, unit="", noise=0.0)]
    run = bench_figures.made_here("short", 12.0, figures)
    save(run, tmp_path / "run.json")
    assert load(tmp_path / "run.json") == run
    assert {"python", "pin", "coal", "numpy", "backhoe_planner", "scipy", "yourdfpy"} <= set(run.versions)
    assert run.versions.get("backhoe_planner_native") == native_version()
    assert run.processor


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read: No such file"),
        ("", "is not JSON"),
        ("{", "is not JSON"),
        ("[]", "version: is not a file of this bench; found list; allowed: 1"),
        ('{"best": []}', "is not a file of this bench"),
        ('{"version": 2}', "found 2; allowed: 1"),
        ('{"version": 1}', "figures: is missing"),
        ({"figures": [HALF, HALF]}, "figures: two figures have the same name; found a step"),
        ({"figures": [HALF | {"value": "fast"}]}, r"figures\[0\].value: .*found 'fast'"),
        ({"figures": [HALF | {"value": math.nan}]}, r"figures\[0\].value: .*finite"),
        ({"figures": [HALF | {"reference": 0.0}]}, r"figures\[0\].reference: .*greater than 0"),
        ({"figures": [HALF | {"better": "higher"}]}, r"figures\[0\].better: is not one of the allowed values"),
        ({"figures": [HALF | {"nose": 0.1}]}, r"figures\[0\].nose: there is no such key; did you mean 'noise'"),
        ({"setting": "medium"}, "setting: is not one of the allowed values"),
    ],
)
def test_an_invalid_file_is_refused_with_its_name_and_the_fault(
    tmp_path: Path, content: str | dict[str, Any] | None, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "run.json"
    if isinstance(content, str):
        file.write_text(content)
    elif content is not None:
        write(file, **content)
    with pytest.raises(InputError, match=said) as caught:
        load(file)
    assert str(caught.value).startswith(str(file))
    with pytest.raises(SystemExit) as ended:
        bench_all.main(["--against", str(file)])
    assert ended.value.code == 2
    assert str(file) in capsys.readouterr().err


def test_a_bench_is_compared_with_a_saved_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bench with constant figures: the exit status is 1 if any figure got worse."""
    monkeypatch.setitem(BENCHES, "step", lambda _: [Figure.model_validate(HALF)])
    own = tmp_path / "own.json"
    assert bench_all.main(["--only", "step", "--save", str(own)]) == 0
    assert bench_all.main(["--only", "step", "--against", str(own)]) == 0
    assert "all 1 figures are the same" in capsys.readouterr().out
    faster = write(tmp_path / "faster.json", HALF | {"value": 20.0}, HALF | {"name": "not measured"})
    assert bench_all.main(["--only", "step", "--against", str(faster)]) == 1
    said = capsys.readouterr().out
    assert "worse" in said
    assert "not measured" not in said
    assert "processor: an abacus before" in said
