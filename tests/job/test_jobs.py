"""A job of a few cycles: its volumes, its proof, its file, its going on after an interruption, its refusals."""

from __future__ import annotations

import copy
import json
from functools import cache, reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from validation.job_check import leg_refutations, volume_errors

TINY: dict[str, Any] = {
    "version": 1,
    "start": {"swing": 0.0, "boom": 0.9, "stick": -1.6, "bucket": -1.8},
    "site": {"clearance": 0.1},
    "ground": {"low": [0.5, -4.5], "high": [5.5, 1.0], "level": 0.0},
    "dig": {"trench": {"from": [4.2, 0.0], "to": [3.2, 0.0], "width": 0.6, "depth": 0.4}},
    "dump": {"heap": {"at": [2.4, -2.8], "edge_distance": 0.6}},
    "bucket": {"capacity": 0.2},
    "pattern": {"face": 0.4},
}
BALL = {"name": "ball", "shape": "sphere", "radius": 0.5, "position": [3.7, 0.0, 0.5]}


@cache
def plan() -> bp.JobPlan:
    return bp.plan_job(bp.job_from_dict(TINY), effort="quick")


def test_every_motion_is_proven_and_the_design_met() -> None:
    assert plan().verified, plan().note
    assert plan().over <= 0.05
    assert plan().under <= 0.05
    assert all(leg.certificate.verified for cycle in plan().cycles for leg in cycle.legs)


def test_no_soil_is_lost() -> None:
    assert volume_errors(plan()) == []
    area = plan().start.cell ** 2
    gone = float((plan().start.bank - plan().end.bank).sum()) * area
    assert plan().bank == pytest.approx(gone, abs=1e-9)
    assert plan().end.loose_volume == pytest.approx(1.25 * gone, abs=1e-9)


def test_the_independent_check_does_not_refute_a_cycle() -> None:
    cycle = plan().cycles[-1]
    assert [what for leg in cycle.legs for what in leg_refutations(plan(), leg, refine=2)] == []


def test_a_job_goes_on_after_an_interruption_as_if_there_had_been_none(tmp_path: Path) -> None:
    parts: list[bp.JobPlan] = []
    file = tmp_path / "job.json"

    class StopError(Exception):
        pass

    def stop(step: bp.JobStep) -> None:
        parts.append(step.plan)
        if len(step.plan.cycles) == 1:
            step.plan.save(file)
            raise StopError

    with pytest.raises(StopError):
        bp.plan_job(bp.job_from_dict(TINY), effort="quick", watch=stop)
    resumed = bp.plan_job(bp.job_from_dict(TINY), effort="quick", resume=bp.load_job_plan(file))
    assert len(resumed.cycles) == len(plan().cycles)
    for one, other in zip(resumed.cycles, plan().cycles, strict=True):
        for a, b in zip(one.legs, other.legs, strict=True):
            np.testing.assert_array_equal(a.trajectory.q, b.trajectory.q)
    np.testing.assert_array_equal(resumed.end.surface, plan().end.surface)


@pytest.mark.parametrize(
    ("key", "change", "said"),
    [
        ("dig", {"trench": {"from": [8.0, 0.0], "to": [7.0, 0.0], "width": 0.6, "depth": 0.4}}, "beyond the ground"),
        ("dig", {"trench": {"from": [4.2, 0.0], "to": [3.2, 0.0], "width": 0.3, "depth": 0.4}}, "bucket is wider"),
        ("dump", {"heap": {"at": [3.5, 0.6]}}, "edge distance"),
        ("dump", {"heap": {"at": [0.8, -0.9]}}, "out of reach"),
        ("start", {"swing": 0.0, "boom": 0.0, "stick": -1.6, "bucket": -1.8}, "stands in the ground"),
        ("ground", {"file": "no_such_survey.csv"}, "no_such_survey"),
        ("soil", {"width": 0.3}, "narrower than the bucket"),
        ("site", {"obstacles": [BALL | {"appears_at": 60.0}]}, "does not stand still"),
        ("site", {"obstacles": [BALL | {"velocity": [0.0, -0.2, 0.0]}]}, "does not stand still"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(key: str, change: dict[str, Any], said: str) -> None:
    content = copy.deepcopy(TINY) | {key: change}
    with pytest.raises(bp.SceneError, match=said) as refused:
        bp.plan_job(bp.job_from_dict(content), effort="quick")
    assert key in str(refused.value)


def test_a_plan_of_a_job_that_was_edited_is_not_verified(tmp_path: Path) -> None:
    file = tmp_path / "job.json"
    plan().save(file)
    content = json.loads(file.read_text())
    content["cycles"] = content["cycles"][:1]
    edited = copy.deepcopy(content)
    cycle = edited["cycles"][0]
    cycle["bank"] = 9.0
    cycle["place"][:2] = [4.0, -3.0]
    cycle["load"]["mass"] = [0.0] * len(cycle["load"]["mass"])
    for leg in cycle["legs"]:
        leg["payload"] = 0.0
    file.write_text(json.dumps(edited))
    found = bp.load_job_plan(file)
    assert not found.verified
    for said in (
        "says 9.000000 m^3 bank",
        "not dumped where",
        "more than the file says",
        "swing: the file says 0.000 kg",
    ):
        assert said in found.note
    without_swing = content["cycles"][0] | {"legs": content["cycles"][0]["legs"][:2]}
    file.write_text(json.dumps(content | {"cycles": [without_swing]}))
    with pytest.raises(bp.PlanFileError, match="not those of a cycle"):
        bp.load_job_plan(file)


@pytest.mark.parametrize(
    ("text", "said"),
    [("-0.3,deep", "row 1, column 2"), ("-0.3,-0.3\n-0.3", "different lengths"), (",\n,", "nowhere how deep"),
     ("-0.3,-1e308", "row 1, column 2")],
)  # fmt: skip
def test_a_design_surface_that_is_none_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "design.csv").write_text(text)
    surface = {"surface": {"file": "design.csv", "low": [3.2, -0.3], "cell": 0.1}}
    with pytest.raises(bp.SceneError, match=said):
        bp.plan_job(bp.job_from_dict(TINY | {"dig": surface}, folder=tmp_path), effort="quick")


def test_a_surface_of_which_nothing_can_be_dug_is_refused(tmp_path: Path) -> None:
    (tmp_path / "design.csv").write_text("\n".join([",".join(["-0.3"] * 11)] * 7))
    surface = {"surface": {"file": "design.csv", "low": [3.2, -0.3], "cell": 0.1}}
    slab = {"name": "slab", "shape": "box", "size": [3.0, 3.0, 0.2], "position": [3.7, 0.0, -0.15]}
    job = TINY | {"dig": surface, "site": {"clearance": 0.1, "obstacles": [slab]}}
    with pytest.raises(bp.SceneError, match=r"cannot be dug anywhere.*slab"):
        bp.plan_job(bp.job_from_dict(job, folder=tmp_path), effort="quick")


def test_depth_counts_from_the_ground_of_the_job_whatever_a_survey_says() -> None:
    found = bp.plan_job(bp.job_from_dict(TINY), effort="quick", terrain=plan().end)
    assert np.nanmin(found.design) == pytest.approx(-0.4, abs=1e-12)


def test_level_ground_does_not_end_with_its_grid() -> None:
    below = {"start": {"swing": 1.2, "boom": -0.5, "stick": -1.0, "bucket": -1.0}}  # the bucket at z -3 m, off the grid
    with pytest.raises(bp.SceneError, match="inside the ground north of what is known"):
        bp.plan_job(bp.job_from_dict(TINY | below), effort="quick")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("cycles[0].bank", None), ("cycles[0].held", None), ("cycles[0].spilt", -0.1),
        ("cycles[0].legs[2].payload", -500.0), ("cycles[0].load.mass[1]", -1e4), ("cycles[0].truck", 7),
        ("effort", "x"), ("seed", -5), ("compared", []),
    ],
)  # fmt: skip
def test_numbers_that_cannot_be_are_refused_with_file_and_key(key: str, value: Any, tmp_path: Path) -> None:
    file = tmp_path / "job.json"
    plan().save(file)
    content = json.loads(file.read_text())
    *above, last = [int(part) if part.isdigit() else part for part in key.replace("[", ".").replace("]", "").split(".")]
    reduce(lambda node, part: node[part], above, content)[last] = value
    file.write_text(json.dumps(content))
    with pytest.raises(bp.PlanFileError) as refused:
        bp.load_job_plan(file)
    assert f"{file}: {key}: " in str(refused.value)


def test_a_soil_that_no_cylinder_cuts_is_a_reason() -> None:
    found = bp.plan_job(bp.job_from_dict(TINY | {"soil": {"cohesion": 5e6}}), effort="quick")
    assert (found.verdict, found.reason) == ("failed", "too_hard")
    assert "stick" in found.note or "boom" in found.note or "bucket" in found.note
