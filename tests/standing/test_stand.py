"""Where to place the machine: maps whose values follow from the geometry of the site."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from small_jobs import TINY, small_job

import backhoe_planner as bp
from backhoe_planner.cli.stand_command import print_stand
from backhoe_planner.job import Job, build_worksite, job_from_dict, load_job_plan
from backhoe_planner.machine import Base, Robot
from backhoe_planner.standing import (
    MachineFootprint,
    SiteMap,
    check_stand_outputs,
    layout,
    site_map,
    spot_finder,
    stand_to_dict,
)
from backhoe_planner.standing.one_place import in_order
from backhoe_planner.standing.reach_map import reach_map
from backhoe_planner.standing.result import Place, RankedPlace

TRENCH = {"width": 0.6, "depth": 0.3}
AT = (30.0, -12.0)  # m, the shift of machine and site together


def nobody(*_: object) -> None:
    """Ignore all messages."""


def _job(**keys: Any) -> Job:
    """A trench of 1.2 m on the x axis, on coarse ground without obstacles, with heaps on both sides."""
    content = {
        "site": {}, "ground": {"cell": 0.1}, "dig": {"trench": {"from": [4.4, 0.0], "to": [3.2, 0.0], **TRENCH}},
        "dump": {"heap": {"at": [[3.8, -3.0], [3.8, 3.0]]}},
    }  # fmt: skip
    return small_job(**(content | keys))


def _map(job: Job) -> SiteMap:
    return site_map(spot_finder(job, nobody), nobody)


@pytest.fixture(scope="module")
def plain() -> SiteMap:
    return _map(_job())


@pytest.fixture(scope="module")
def answer() -> bp.StandPlan:
    job = _job(
        ground={"cell": 0.1, "low": [0.5, -4.5], "high": [6.0, 1.5]}, dump={"heap": {"at": [2.5, -3.0]}},
        dig={"trench": {"from": [4.4, 0.0], "to": [3.7, 0.0], **TRENCH}},
        site={"base": {"position": [-0.25, 0.0], "heading": 0.0}},  # a place on the map
    )  # fmt: skip
    return bp.stand(job, count=1, effort="quick")


@pytest.mark.long
@pytest.mark.parametrize(
    "keys",
    [
        pytest.param({"soil": {"cohesion": 120_000.0}}, id="hard soil"),
        pytest.param({"bucket": {"capacity": 1.5}}, id="large bucket"),
    ],
)
def test_if_no_cut_fills_the_bucket_the_fullest_cuts_count(keys: dict[str, Any]) -> None:
    """Such jobs can be dug; they were once reported as having soil that cannot be cut."""
    found = reach_map(_job(**keys), ground=0.0, depth=0.3)
    assert len(found.cuts) > 3
    assert (found.bank > 0.0).all()
    assert found.bank.min() > 0.4 * found.bank.max()
    assert found.bank.max() < build_worksite(_job(**keys)).volume / 1.25  # in loose soil, with the default swell


@pytest.mark.long
def test_soil_that_cannot_be_cut_is_reported_with_the_force_of_a_3_cm_cut() -> None:
    with pytest.raises(bp.SceneError, match=r"makes no cut in this soil; found .*even at 3 cm it takes \w+: \d+ of"):
        reach_map(_job(soil={"cohesion": 1e6}), ground=0.0, depth=0.3)


@pytest.mark.long
def test_a_trench_as_wide_as_the_bucket_is_dug_only_from_its_own_line(plain: SiteMap) -> None:
    stands = np.isfinite(plain.cost)
    assert stands.any()
    assert np.abs(plain.y[stands]).max() < 1e-9
    for row in plain.spots:
        for spot in row:
            if math.isfinite(spot.cost):
                away = abs(spot.base.position[0] - 3.8)
                # the trench ends 0.6 m from its middle, the stabilizers stay 0.6 m off it and may be turned away
                # by 0.4 m; the greatest reach of the data sheet is 5.65 m
                assert 0.8 < away < 5.65 + 0.6


def _on_ramp(folder: Path, rise: float, *, known: float = -7.0) -> SiteMap:
    """The map of a trench, 0.3 m deep at x 4.4 m, in ground that rises from x 2 m on and is known from an x on [m]."""
    x, y = np.arange(known, 6.01, 0.1), np.arange(-4.0, 4.01, 0.1)
    np.savetxt(folder / "ramp.csv", np.tile(rise * np.maximum(x - 2.0, 0.0), (len(y), 1)), delimiter=",")
    ground = {"file": "ramp.csv", "low": [known, -4.0], "cell": 0.1}
    content = _job(dump={"heap": {"at": [2.5, -3.0]}}).to_dict() | {"ground": ground}
    return _map(job_from_dict(content, folder=folder))


def test_a_trench_in_ground_that_rises_from_the_machine_is_within_reach(tmp_path: Path) -> None:
    """The ground is 0.12 to 0.24 m higher at the trench, and as high as the machine where that stands."""
    found = _on_ramp(tmp_path, 0.1)
    best = max((spot for row in found.spots for spot in row if math.isfinite(spot.cost)), key=lambda spot: spot.share)
    assert best.share == pytest.approx(1.0)
    assert best.base.position[0] < 2.0


def test_ground_that_is_not_known_is_told_from_ground_that_is_not_level(tmp_path: Path) -> None:
    """Behind x 1.2 m the tractor, 5.2 m long, has its rear beyond the file; in front of x 2.5 m it is on the ramp."""
    found = _on_ramp(tmp_path, 0.3, known=-4.0)
    on_line = [(spot.base.position[0], spot.reason) for row in found.spots for spot in row if spot.reason != "line"]
    assert "unknown" in {reason for x, reason in on_line if x < 1.0}
    assert "ground" not in {reason for x, reason in on_line if x < 1.0}
    assert "unknown" not in {reason for x, reason in on_line if x > 1.4}
    assert "ground" in {reason for x, reason in on_line if 2.5 < x < 3.0}


def test_a_symmetric_site_has_the_same_cost_from_both_sides(plain: SiteMap) -> None:
    """The heaps are beside the middle of the trench."""
    np.testing.assert_allclose(plain.cost, plain.cost[:, ::-1], rtol=1e-9)
    np.testing.assert_allclose(plain.share, plain.share[:, ::-1], atol=1e-9)


@pytest.mark.long
def test_moving_the_site_moves_its_map(plain: SiteMap) -> None:
    def moved(x: float, y: float) -> list[float]:
        return [AT[0] - y, AT[1] + x]  # a quarter turn, then a shift

    job = _job(
        site={"base": {"position": list(AT), "heading": math.pi / 2.0}},
        dig={"trench": {"from": moved(4.4, 0.0), "to": moved(3.2, 0.0), **TRENCH}},
        dump={"heap": {"at": [moved(3.8, -3.0), moved(3.8, 3.0)]}},
    )
    there = _map(job)
    np.testing.assert_allclose(there.cost, plain.cost, rtol=1e-6)
    np.testing.assert_allclose(there.x, AT[0] - plain.y, atol=1e-9)
    np.testing.assert_allclose(there.y, AT[1] + plain.x, atol=1e-9)


def test_places_where_the_machine_would_overlap_an_obstacle_are_left_out(plain: SiteMap) -> None:
    """A wall crosses the line at x 7.6 m: a tractor that looks along -x either overlaps it or ends before it."""
    wall = {"name": "wall", "shape": "box", "size": [0.3, 20.0, 2.0], "position": [7.6, 0.0, 1.0]}
    walled = _map(_job(site={"obstacles": [wall]}))
    line = len(plain.spots) // 2
    for before, spot in zip(plain.spots[line], walled.spots[line], strict=True):
        x = spot.base.position[0]
        if math.isfinite(before.cost) and 3.8 < x < 7.5:
            assert spot.reason == "obstacle"
            assert "wall" in spot.why
        elif math.isfinite(before.cost) and x < 3.8:
            assert spot.cost == pytest.approx(before.cost)


@pytest.mark.long
def test_the_arm_does_not_start_inside_a_wall_beside_the_trench(plain: SiteMap) -> None:
    """The wall is 1.65 m beside the trench, and the arm starts 1.2 rad off the machine's heading."""
    wall = {"name": "garage", "shape": "box", "size": [30.0, 0.3, 3.0], "position": [5.0, 1.8, 1.5]}
    start = {"swing": 1.2, "boom": 0.9, "stick": -1.6, "bucket": -1.8}
    job = _job(start=start, site={"obstacles": [wall]}, dump={"heap": {"at": [[3.8, -3.0], [2.0, -3.0]]}})
    line = _map(job).spots[len(plain.spots) // 2]
    standing = [spot for spot in line if math.isfinite(spot.cost)]
    assert standing
    site = build_worksite(job)
    assert site.problem.start_q is not None
    for spot in standing:
        tip = bp.Kinematics(site.robot.with_base(spot.base)).at(site.problem.start_q).tip_position
        assert tip[1] < 1.65 - 0.05  # m, the wall's face and the scene's clearance


def test_the_ground_covered_by_the_machine_is_that_of_its_fixed_parts(backhoe: Robot) -> None:
    """In the model the stabilizers extend 1.43 m to both sides, the loader 5.24 m back, and nothing beyond x 0."""
    footprint = MachineFootprint(backhoe)
    base = Base((2.0, 1.0), math.pi / 2.0)  # looks along y: its x axis is the world's y
    points = np.array([[2.0 + 1.3, 0.9], [2.0, 1.0 - 5.0], [2.0, 3.0], [2.0 + 2.43, 0.9]])
    distances = footprint.distances(base, points)
    assert distances[:2] == pytest.approx([0.0, 0.0])
    assert 1.9 <= distances[2] <= 2.3  # from the rear plate, which ends at x -0.24 m, or the feet at x 0
    assert distances[3] == pytest.approx(1.0, abs=0.1)
    corners = np.vstack(footprint.placed(base))
    assert corners.max(axis=0) == pytest.approx([3.43, 1.0], abs=0.02)


@pytest.mark.long
def test_a_trench_of_nine_metres_takes_several_places_whose_sections_cover_it() -> None:
    trench = {"from": [4.0, 0.0], "to": [-5.0, 0.0], "width": 0.6, "depth": 0.3, "slope": -0.02}
    heaps = [[x, -3.4] for x in (4.5, 3.0, 1.5, 0.0, -1.5, -3.0, -4.5)]
    job = _job(dig={"trench": trench}, dump={"heap": {"at": heaps, "edge_distance": 0.6}})
    finder = spot_finder(job, nobody)
    sections = layout(job, finder)
    assert not isinstance(sections, str)
    assert 2 <= len(sections) <= 3  # 9 m in sections of at most 4.4 m, less their overlap
    assert sections[0].start == 0.0
    assert sections[-1].end == pytest.approx(9.0)
    begin = np.array(sections[0].dig["trench"]["from"])
    forth = np.allclose(begin, [4.0, 0.0])
    for before, after in itertools.pairwise(sections):
        assert after.start < before.end < after.end  # the remaining slope belongs to the next section
    for one in sections:
        own = one.dig["trench"]
        assert np.linalg.norm(np.subtract(own["from"], begin)) == pytest.approx(one.start, abs=1e-5)
        # the floor is that of the whole trench: 0.3 m deep at x 4 m, and 2 cm less every metre
        assert own["depth"] == pytest.approx(0.3 - 0.02 * (4.0 - own["from"][0]), abs=1e-5)
        assert own["slope"] == (-0.02 if forth else 0.02)
        ahead = 1.0 if not forth else -1.0
        for spot in one.spots:
            gap = ahead * (spot.base.position[0] - own["to"][0])
            assert gap >= 0.6  # the machine is beyond the section, on ground that is not dug yet
            assert abs(spot.base.position[1]) < 1e-9


@pytest.mark.long
def test_a_job_whose_dump_cannot_be_reached_from_any_place_fails_with_that_reason() -> None:
    """The trench is 20 m from the heap, and the machine reaches 5.65 m to both sides."""
    found = bp.stand(_job(dump={"heap": {"at": [24.0, 0.0]}}))
    assert (found.verdict, found.reason, found.places) == ("failed", "unreachable", ())
    assert "no dump in reach" in found.note
    assert "not in line" not in found.note


@pytest.mark.long
def test_the_answer_costs_no_more_than_the_given_place(answer: bp.StandPlan) -> None:
    given = answer.given
    assert answer.verified
    assert given is not None
    assert given.plan is not None
    assert answer.cost <= given.planned
    assert answer.bank >= 0.99 * given.bank
    assert answer.gain == pytest.approx(1.0 - answer.cost / given.planned)
    assert len(answer.places) == 1
    assert sum(one.plan is not None for one in answer.ranking) == 2
    with pytest.raises(dataclasses.FrozenInstanceError):
        answer.note = ""  # type: ignore[misc]


def test_a_cheaper_place_that_digs_less_than_the_given_one_says_how_much_less() -> None:
    """The rule allows 1 % less; 0.986 of 1 m^3 is 1.4 % less."""

    def place(x: float, bank: float, cost: float, *, given: bool = False) -> RankedPlace:
        plan = SimpleNamespace(verified=True, cost=cost)
        return RankedPlace(Base((x, 0.0), 0.0), given, 70.0, 80.0, bank, plan, "0.1 m^3 stays")  # type: ignore[arg-type]

    found = in_order([place(0.0, 1.0, 90.0, given=True), place(1.0, 0.986, 79.0), place(2.0, 0.995, 95.0)])
    assert [one.base.position[0] for one in found] == [0.0, 2.0, 1.0]
    assert found[2].note == "digs 1.4 % less than the given place; 0.1 m^3 stays"
    assert found[0].note == found[1].note == "0.1 m^3 stays"


def test_an_answer_that_is_the_given_place_gains_nothing(
    answer: bp.StandPlan, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = answer.given
    assert given is not None
    assert given.plan is not None
    stays = dataclasses.replace(answer, ranking=(given,), places=(Place(given.base, given.plan),))
    assert stays.stays
    assert stays.gain == 0.0
    print_stand(stays, tmp_path / "stand.json")
    assert "gain          none: the answer is the given place\n" in capsys.readouterr().out


def test_the_given_place_is_planned_once(answer: bp.StandPlan) -> None:
    spots = itertools.chain.from_iterable(answer.map.spots)
    assert min(math.dist(spot.base.position, (-0.25, 0.0)) for spot in spots) < 1e-6
    near = [one for one in answer.ranking if math.dist(one.base.position, (-0.25, 0.0)) < 1e-6]
    assert [one.given for one in near] == [True]


def test_the_files_of_an_answer_can_be_loaded_as_jobs_and_plans(answer: bp.StandPlan, tmp_path: Path) -> None:
    answer.save(tmp_path / "stand.json")
    content = json.loads((tmp_path / "stand.json").read_text())
    assert content["verdict"] == "verified"
    job, plan, ground = (tmp_path / name for name in content["places"][0]["files"])
    again = bp.load_job(job)
    assert again.site_scene.base.position == pytest.approx(answer.places[0].base.position)
    assert load_job_plan(plan).cost == pytest.approx(answer.cost)
    assert np.loadtxt(ground, delimiter=",").shape == answer.places[0].plan.start.shape
    assert stand_to_dict(answer)["cost"] == pytest.approx(answer.cost)


def test_files_that_cannot_be_written_are_found_before_the_search(tmp_path: Path) -> None:
    job = bp.job_from_dict(TINY)
    check_stand_outputs(tmp_path / "stand.json", job)
    (tmp_path / "stand_2.json").mkdir()
    check_stand_outputs(tmp_path / "stand.json", job, places=1)
    with pytest.raises(bp.OutputError, match=r"stand_2\.json: is a folder"):
        check_stand_outputs(tmp_path / "stand.json", job)
    (tmp_path / "dig_1.yaml").write_text(yaml.safe_dump(TINY))
    with pytest.raises(bp.OutputError, match=r"dig_1\.yaml: is an input of this command"):
        check_stand_outputs(tmp_path / "dig.json", bp.load_job(tmp_path / "dig_1.yaml"))
