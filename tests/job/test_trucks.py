"""Trucks of a job: the volume of their beds by hand, how they fill, and what is refused before planning."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from small_jobs import small_job

import backhoe_planner as bp
from backhoe_planner.job import build_worksite, plan_job
from backhoe_planner.job.cycles.dumping import NoDump, SiteState, TruckDump, dump_of, ground_obstacles

TAN = math.tan(0.6)
_WIDE = {"low": [0.5, -4.5], "high": [6.0, 4.5]}
_LOW_BED = {"position": [1.8, 2.9, 0.9], "size": [2.0, 1.4, 0.3]}
# struck 0.84 m^3, and a roof of half the width, hipped on all sides: w^2 (3 L - w) / 12 tan
_MOST = 2.0 * 1.4 * 0.3 + 1.4**2 * (3.0 * 2.0 - 1.4) / 12.0 * TAN


def truck_job(**keys: Any) -> bp.Job:
    return small_job(dump={"truck": {"bed": _LOW_BED, "capacity": 1.3} | keys}, ground=_WIDE)


@pytest.mark.parametrize(
    ("keys", "key", "said"),
    [
        ({"capacity": 40.0}, "capacity", "more than the bed holds"),
        ({"bed": _LOW_BED | {"size": [0.1, 1.4, 0.3]}}, "bed.size", "is no bed"),
        ({"bed": _LOW_BED | {"size": [900.0, 900.0, 0.3]}}, "bed.size", "is no bed"),
    ],
)
def test_an_impossible_truck_is_refused_naming_the_key(keys: dict[str, Any], key: str, said: str) -> None:
    with pytest.raises(bp.SceneError, match=said) as refused:
        dump_of(build_worksite(truck_job(**keys)))
    assert refused.value.key == f"dump.truck.{key}"
    if key == "capacity":
        words = str(refused.value.allowed).split()
        assert (words[:2], words[3:]) == (["up", "to"], ["m^3"])
        assert float(words[2]) == pytest.approx(_MOST, rel=0.01)


def test_a_truck_smaller_than_a_bucketful_is_refused_before_planning() -> None:
    with pytest.raises(bp.SceneError, match=r"less than one bucketful.*0\.20 m\^3 or more") as refused:
        plan_job(truck_job(capacity=0.15, count=1000), effort="quick")
    assert refused.value.key == "dump.truck.capacity"


def test_a_bed_is_filled_up_to_its_walls_before_the_next_truck_is_used() -> None:
    site = build_worksite(truck_job(count=2))
    dump = TruckDump(site, site.job.dump.truck)  # type: ignore[arg-type]
    state = dump.first(site.ground, ground_obstacles(site, site.ground))
    start = np.array([0.0, 0.9, -1.6, -1.8])
    numbers = []
    for count in range(1, 8):
        options = dump.options(state, 0.2, start)
        assert not isinstance(options, NoDump)
        option = options[0]
        after = dump.dumped(state, option.place[:2], 0.2, option.number)
        assert isinstance(after, SiteState)
        assert after.truck is not None
        numbers.append(option.number)
        assert after.truck.bed.volume == pytest.approx(0.2 * (count if count <= 6 else count - 6), rel=1e-9)
        z = after.truck.bed.load.loose
        assert max(z[0].max(), z[-1].max(), z[:, 0].max(), z[:, -1].max()) <= 0.3 + 0.025 * TAN + 1e-9
        assert after.load is not None
        state = after
    assert numbers == [1] * 6 + [2]  # 1.3 m^3 are six bucketfuls of 0.2 m^3
    refused = dump.dumped(state, option.place[:2], 1.2, 2)
    assert refused == "truck 2 takes 1.30 m^3, with this bucketful it would hold 1.40 m^3"
