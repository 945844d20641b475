"""A job of a few cycles: volumes, proof, file, resuming after an interruption, and errors."""

from __future__ import annotations

import copy
import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_jobs import TINY, small_job, tiny_plan

import backhoe_planner as bp
from backhoe_planner.job import Cycle, build_worksite, job_from_dict, plan_job, same_ground
from backhoe_planner.job.cycles.cycle_planning import CyclePlanner, Failed
from backhoe_planner.job.cycles.dumping import SiteState
from validation.job_check import leg_refutations, volume_errors

BALL = {"name": "ball", "shape": "sphere", "radius": 0.5, "position": [3.7, 0.0, 0.5]}


def test_a_start_without_a_joint_is_refused_by_its_key_in_the_job() -> None:
    with pytest.raises(bp.SceneError, match=r"^start: joints are missing: swing"):
        build_worksite(small_job(start={"boom": 0.9, "stick": -1.6, "bucket": -1.8}))


def test_every_motion_is_proven_and_the_design_is_met() -> None:
    assert tiny_plan().verified, tiny_plan().note
    assert tiny_plan().over <= 0.05
    assert tiny_plan().under <= 0.05
    assert all(leg.certificate.verified for cycle in tiny_plan().cycles for leg in cycle.legs)


def test_no_soil_is_lost() -> None:
    assert volume_errors(tiny_plan()) == []
    area = tiny_plan().start.cell ** 2
    gone = float((tiny_plan().start.bank - tiny_plan().end.bank).sum()) * area
    assert tiny_plan().bank == pytest.approx(gone, abs=1e-9)
    assert tiny_plan().end.loose_volume == pytest.approx(1.25 * gone, abs=1e-9)


def test_dug_and_remaining_volume_add_up_to_that_of_the_design() -> None:
    assert tiny_plan().design_volume == pytest.approx(1.0 * 0.6 * 0.4, rel=1e-9)
    stays = sum(one.volume for one in tiny_plan().undug)
    # the bucket is 0.61 m wide, and remains within the tolerance are not listed
    assert stays + tiny_plan().bank * 0.6 / 0.61 == pytest.approx(0.24, rel=0.03)
    told = " ".join(one.words for one in tiny_plan().undug)
    assert "no plane of the arm" not in told


def test_the_next_cycle_starts_from_the_ground_after_a_cycle_that_takes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second cut claims to take nothing; every cycle must start from the ground that the previous one left."""
    planned, count = CyclePlanner.plan, itertools.count(1)

    def plan(self: CyclePlanner, *given: Any) -> tuple[Cycle, SiteState] | Failed:
        found = planned(self, *given)
        if next(count) == 2:
            assert not isinstance(found, Failed)
            cycle, after = found
            return replace(cycle, bank=0.0, taken=0.0), after
        return found

    monkeypatch.setattr(CyclePlanner, "plan", plan)
    cycles = plan_job(job_from_dict(TINY), effort="quick").cycles
    assert len(cycles) >= 2
    for before, after in itertools.pairwise(cycles):
        assert same_ground(after.before, before.after)


def test_the_independent_check_does_not_refute_a_cycle() -> None:
    cycle = tiny_plan().cycles[-1]
    assert [what for leg in cycle.legs for what in leg_refutations(tiny_plan(), leg, refine=2)] == []


def test_a_job_without_a_start_begins_with_its_first_cut() -> None:
    half = {"trench": TINY["dig"]["trench"] | {"to": [3.7, 0.0]}}  # one cycle
    content = {key: value for key, value in TINY.items() if key != "start"}
    found = plan_job(job_from_dict(content | {"dig": half}), effort="quick")
    assert found.verified, found.note
    assert [leg.name for leg in found.cycles[0].legs] == ["cut", "swing", "dump"]


@pytest.mark.long
def test_a_resumed_job_equals_an_uninterrupted_one(tmp_path: Path) -> None:
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
    assert len(resumed.cycles) == len(tiny_plan().cycles)
    for one, other in zip(resumed.cycles, tiny_plan().cycles, strict=True):
        for a, b in zip(one.legs, other.legs, strict=True):
            np.testing.assert_array_equal(a.trajectory.q, b.trajectory.q)
    np.testing.assert_array_equal(resumed.end.surface, tiny_plan().end.surface)


@pytest.mark.parametrize(
    ("key", "change", "said"),
    [
        ("dig", {"trench": {"from": [8.0, 0.0], "to": [7.0, 0.0], "width": 0.6, "depth": 0.4}}, "beyond the ground"),
        ("dig", {"trench": {"from": [4.2, 0.0], "to": [3.2, 0.0], "width": 0.3, "depth": 0.4}}, "bucket is wider"),
        ("dump", {"heap": {"at": [3.5, 0.6]}}, "edge distance"),
        ("dump", {"heap": {"at": [0.8, -0.9]}}, "out of reach"),
        ("start", {"swing": 0.0, "boom": 0.0, "stick": -1.6, "bucket": -1.8}, "stands in the ground"),
        ("ground", {"file": "no_such_survey.csv"}, "no_such_survey"),
        ("ground", {"low": [-2e3, -2e3], "high": [2e3, 2e3]}, "too many columns"),
        ("soil", {"width": 0.3}, "narrower than the bucket"),
        ("site", {"obstacles": [BALL | {"appears_at": 60.0}]}, "does not stand still"),
        ("site", {"obstacles": [BALL | {"velocity": [0.0, -0.2, 0.0]}]}, "does not stand still"),
    ],
)
def test_impossible_jobs_are_refused_naming_the_key(key: str, change: dict[str, Any], said: str) -> None:
    content = copy.deepcopy(TINY) | {key: change}
    with pytest.raises(bp.SceneError, match=said) as refused:
        bp.plan_job(bp.job_from_dict(content), effort="quick")
    assert key in str(refused.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [("-0.3,deep", "row 1, column 2"), ("-0.3,-0.3\n-0.3", "different lengths"), (",\n,", "does not say how deep"),
     ("-0.3,-1e308", "row 1, column 2")],
)  # fmt: skip
def test_an_invalid_design_surface_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "design.csv").write_text(text)
    surface = {"surface": {"file": "design.csv", "low": [3.2, -0.3], "cell": 0.1}}
    with pytest.raises(bp.SceneError, match=said):
        bp.plan_job(bp.job_from_dict(TINY | {"dig": surface}, folder=tmp_path), effort="quick")


def test_a_design_surface_blocked_by_an_obstacle_is_refused_naming_it(tmp_path: Path) -> None:
    (tmp_path / "design.csv").write_text("\n".join([",".join(["-0.3"] * 11)] * 7))
    surface = {"surface": {"file": "design.csv", "low": [3.2, -0.3], "cell": 0.1}}
    slab = {"name": "slab", "shape": "box", "size": [3.0, 3.0, 0.2], "position": [3.7, 0.0, -0.15]}
    job = TINY | {"dig": surface, "site": {"clearance": 0.1, "obstacles": [slab]}}
    with pytest.raises(bp.SceneError, match=r"cannot be dug anywhere.*slab"):
        bp.plan_job(bp.job_from_dict(job, folder=tmp_path), effort="quick")


def test_the_depth_of_the_design_counts_from_the_ground_of_the_job_not_the_survey() -> None:
    found = bp.plan_job(bp.job_from_dict(TINY), effort="quick", terrain=tiny_plan().end)
    assert np.nanmin(found.design) == pytest.approx(-0.4, abs=1e-12)


@pytest.mark.long
def test_level_ground_extends_beyond_its_grid() -> None:
    # the bucket is at z -3 m, outside the grid
    below = {"start": {"swing": 1.2, "boom": -0.5, "stick": -1.0, "bucket": -1.0}}
    with pytest.raises(bp.SceneError, match="inside the ground north of what is known"):
        bp.plan_job(bp.job_from_dict(TINY | below), effort="quick")


@pytest.mark.long
def test_a_soil_that_no_cylinder_can_cut_ends_as_too_hard() -> None:
    found = bp.plan_job(bp.job_from_dict(TINY | {"soil": {"cohesion": 5e6}}), effort="quick")
    assert (found.verdict, found.reason) == ("failed", "too_hard")
    assert "stick" in found.note or "boom" in found.note or "bucket" in found.note
