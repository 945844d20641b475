"""Job plans that were edited: statements that their motions do not confirm are reported and not verified."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_jobs import TINY, tiny_plan

import backhoe_planner as bp
from backhoe_planner.job import Cut, Digger, Profile, find_cut
from backhoe_planner.job.cuts.cut_rules import broken_rules
from backhoe_planner.site import Soil


def content() -> dict[str, Any]:
    """The content of the plan's file with the first cycle alone."""
    from backhoe_planner.job.result.job_plan_file import job_plan_record

    part = replace(tiny_plan(), cycles=tiny_plan().cycles[:1])
    return dict(json.loads(job_plan_record(part, None).model_dump_json()))


def read(edited: dict[str, Any], folder: Path) -> bp.JobPlan:
    file = folder / "job.json"
    file.write_text(json.dumps(edited))
    return bp.load_job_plan(file)


def test_an_unchanged_plan_loads_verified_with_the_same_figures(tmp_path: Path) -> None:
    tiny_plan().save(tmp_path / "job.json")
    found = bp.load_job_plan(tmp_path / "job.json")
    assert (found.verdict, found.note) == ("verified", "")
    assert [cycle.depth for cycle in found.cycles] == [cycle.depth for cycle in tiny_plan().cycles]


def test_an_unchanged_plan_whose_patterns_dig_nothing_is_not_said_to_be_changed(tmp_path: Path) -> None:
    """As for a survey by which nearly everything is dug: no cycle, and an infinite cost per m^3."""
    nothing = tuple(replace(one, cycles=0, bank=0.0, cost=math.inf) for one in tiny_plan().compared)
    plan = replace(tiny_plan(), cycles=(), compared=nothing, failure="not_done")
    plan.save(tmp_path / "job.json")
    assert "compared patterns or steps were changed" not in bp.load_job_plan(tmp_path / "job.json").note
    edited = json.loads((tmp_path / "job.json").read_text())
    edited["compared"][0]["bank"] = 0.1
    assert "compared patterns or steps were changed" in read(edited, tmp_path).note


def test_edited_motions_loads_and_settings_are_reported(tmp_path: Path) -> None:
    edited = content()
    cycle = edited["cycles"][0]
    cycle["place"][0] += 0.3
    cycle["load"]["mass"] = [1.05 * mass for mass in cycle["load"]["mass"]]
    legs = {leg["name"]: leg for leg in cycle["legs"]}
    legs["swing"]["payload"], legs["cut"]["payload"] = 0.0, 9999.0
    for key in ("time", "q"):
        legs["dump"][key] = legs["dump"][key][: len(legs["dump"][key]) // 3]
    edited["ground"]["bank"] = -0.01
    edited["seed"] = 7
    found = read(edited, tmp_path)
    assert not found.verified
    for said in (
        "the soil falls at x", "kg in the bucket with the teeth at r", "swing: the file says 0.000 kg",
        "cut: the file says 9999.000 kg",
        "the bucket is not open at its end", "ground before the first cycle is not that of the job",
        "effort, seed, compared patterns or steps were changed",
    ):  # fmt: skip
        assert said in found.note, said


def test_a_failure_that_the_motions_refute_is_reported(tmp_path: Path) -> None:
    from backhoe_planner.job.result.job_plan_file import job_plan_record

    assert not tiny_plan().refutes_failure
    edited = dict(json.loads(job_plan_record(tiny_plan(), None).model_dump_json()))
    found = read(edited | {"verdict": "failed", "reason": "full", "message": "no room"}, tmp_path)
    assert found.refutes_failure
    assert not read(content(), tmp_path).refutes_failure  # of its cycles one alone is there


def test_a_claimed_survey_that_did_not_take_place_is_reported(tmp_path: Path) -> None:
    note = read(content() | {"surveyed": True}, tmp_path).note
    assert "the file says that the ground was surveyed, which is that of the job" in note


def test_a_bucket_claimed_empty_at_one_place_of_the_cut_is_reported(tmp_path: Path) -> None:
    edited = content()
    load = edited["cycles"][0]["load"]
    there = int(np.argmax(load["mass"])) + 1  # between places with the same load
    load["mass"][there] = 0.0
    assert "during the cut the file says 0 kg in the bucket with the teeth at r" in read(edited, tmp_path).note


def test_figures_that_differ_from_those_of_the_motions_are_reported(tmp_path: Path) -> None:
    edited = content()
    cycle = edited["cycles"][0]
    wrong = {"bank": 9.0, "taken": 0.5, "spilt": 0.5, "filled": 0.1, "depth": 3.0}
    cycle.update(wrong)
    note = read(edited, tmp_path).note
    for key, value in wrong.items():
        assert f"cycles[0].{key}: the file says {value:g}, the motions have " in note
    assert "effort, seed" not in note


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("cycles[0].bank", None), ("cycles[0].held", None), ("cycles[0].spilt", -0.1),
        ("cycles[0].legs[2].payload", -500.0), ("cycles[0].load.mass[1]", -1e4), ("cycles[0].truck", 7),
        ("effort", "x"), ("seed", -5), ("compared", []), ("compared[0].name", "far end first, cuts of 0.41 m"),
        ("cycles[0].legs[2].name", "return"), ("ground.shape", [100000, 100000]),
    ],
)  # fmt: skip
def test_impossible_values_are_refused_naming_file_and_key(key: str, value: Any, tmp_path: Path) -> None:
    edited: Any = content()
    path = key.replace("[", ".").replace("]", "").split(".")
    *above, last = [int(part) if part.isdigit() else part for part in path]
    node: Any = reduce(lambda found, part: found[part], above, edited)
    node[last] = value
    with pytest.raises(bp.PlanFileError) as refused:
        read(edited, tmp_path)
    assert f"{tmp_path / 'job.json'}: {'ground' if key.startswith('ground') else key}: " in str(refused.value)


def test_digging_beside_the_design_is_reported_and_not_verified(tmp_path: Path) -> None:
    assert tiny_plan().beside == 0.0
    edited = content()
    edited["job"]["dig"]["trench"] |= {"from": [4.2, 0.0], "to": [3.9, 0.0]}  # the cuts go on to 3.2
    found = read(edited, tmp_path)
    assert not found.is_met
    assert found.beside > 0.2
    assert "deep beside what is to be dug" in found.note
    nothing = replace(tiny_plan(), share=np.zeros_like(tiny_plan().share))
    assert nothing.beside > 0.3
    assert not nothing.is_met


def test_dumping_away_from_the_jobs_heap_is_reported(tmp_path: Path) -> None:
    edited = content()
    edited["job"]["dump"]["heap"]["at"] = [2.4, -3.1]
    found = read(edited, tmp_path)
    assert not found.verified
    assert "the dump: x 2.40, y -2.80 m is no place at which the job dumps" in found.note


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("machine", "example:planar4", "job: machine: a bucket digs in an upright plane"),
        ("cycles.0.legs.2.time.1", 0.0, "cycles[0].legs[2]: trajectory.time: does not increase"),
        ("cycles.0.legs.3.q", [[0.0] * 5] * 2, "cycles[0].legs[3]: dump.q: is no motion"),
    ],
)
def test_invalid_jobs_and_motions_are_refused_naming_file_and_key(
    key: str, value: Any, said: str, tmp_path: Path
) -> None:
    edited: Any = content()
    *above, last = [int(part) if part.isdigit() else part for part in key.split(".")]
    reduce(lambda found, part: found[part], above, edited)[last] = value
    with pytest.raises(bp.PlanFileError) as refused:
        read(edited, tmp_path)
    assert f"{tmp_path / 'job.json'}: {said}" in str(refused.value)


def test_a_cycle_without_its_swing_and_dump_is_refused(tmp_path: Path) -> None:
    edited = content()
    edited["cycles"][0]["legs"] = edited["cycles"][0]["legs"][:2]
    with pytest.raises(bp.PlanFileError, match="not those of a cycle"):
        read(edited, tmp_path)


def test_only_an_interrupted_plan_of_the_same_job_can_be_resumed() -> None:
    with pytest.raises(bp.InputError, match="not the plan of a job that was interrupted"):
        bp.plan_job(bp.job_from_dict(TINY), resume=tiny_plan())
    other = copy.deepcopy(TINY) | {"bucket": {"capacity": 0.19}}
    with pytest.raises(bp.InputError, match="plan of another job"):
        bp.plan_job(bp.job_from_dict(other), resume=tiny_plan())


@pytest.fixture(scope="module")
def digger() -> Digger:
    return Digger(bp.load_robot("example:backhoe"), Soil())


def test_a_found_cut_breaks_no_rule_of_digging_and_changed_cuts_do(digger: Digger) -> None:
    ground = Profile.level(0.0, 1.0, 6.0)
    cut = find_cut(digger, ground, swing=0.0, start=4.2, end=2.5, depth=0.2)
    assert isinstance(cut, Cut)
    above = digger.plane.joints(0.0, cut.r[:1], cut.z[:1] + 0.1, cut.pitch[:1])
    middle = (cut.begin[1] + cut.begin[2]) // 2
    r, z, pitch = cut.r[middle], cut.z[middle], cut.pitch[middle]

    def broken(way: list[tuple[float, float, float]], *, swing: float = 0.0, upto: int = len(cut.q)) -> str:
        at = np.array(way).reshape(-1, 3)
        detour = digger.plane.joints(0.0, r + at[:, 0], z + at[:, 1], pitch + at[:, 2])
        assert np.isfinite(detour).all()
        q = np.vstack((above, cut.q[: middle + 1], detour, cut.q[middle:upto]))
        return "; ".join(broken_rules(digger, ground, q, swing=swing))

    assert broken([]) == ""
    assert broken([], swing=0.1) == "the cut leaves the plane in which it digs"
    assert broken([], upto=middle + 1) == "the cut does not begin and end above the ground"
    assert "pushed backwards" in broken([(0.1, 0.0, 0.0), (0.2, 0.0, 0.0), (0.1, 0.0, 0.0)])
    assert "back presses" in broken([(0.0, 0.0, -0.4), (0.0, 0.0, -0.8), (0.0, 0.0, -0.4)])
