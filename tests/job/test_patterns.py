"""A pattern's cuts one after the other on the changing ground, without the motions between them."""

from __future__ import annotations

import numpy as np
import pytest
from small_jobs import small_job

from backhoe_planner.job import BladeSweep, build_worksite, swept
from backhoe_planner.job.cycles.patterns import NextCut, Pattern, next_cut
from backhoe_planner.job.worksite.lanes import ENTRY, LEAVE, allowed_heights, lanes_of


@pytest.mark.parametrize(("cell", "off"), [(0.025, 0.009), (0.05, 0.031)])
def test_a_trench_is_dug_to_its_design_whatever_the_columns_of_the_ground(cell: float, off: float) -> None:
    """A trench of 1.8 m, 0.8 m deep: near its end boom and stick only clear the ground with the bucket drawn in."""
    low = np.array([0.5, -1.5]) + off
    ground = {"low": low.tolist(), "high": (low + np.array([5.0, 3.0])).tolist(), "cell": cell}
    dig = {"trench": {"from": [4.2, 0.0], "to": [2.4, 0.0], "width": 0.6, "depth": 0.8}}
    site = build_worksite(
        small_job(ground=ground, dig=dig, site={"clearance": 0.1}, dump={"heap": {"at": [2.5, -1.3]}})
    )
    lanes, design = lanes_of(site), site.design_heights()
    allowed, _ = allowed_heights(site, lanes, design)
    now, bank, cuts = site.ground, 0.0, 0
    while isinstance(found := next_cut(site, lanes, Pattern("face", 0.4), now), NextCut):
        sweep = swept(now, BladeSweep(found.cut.position, found.cut.across, found.cut.bucket.width))
        now, bank, cuts = sweep.terrain, bank + float(sweep.bank[-1]), cuts + 1
        assert cuts < 10
    assert found is None
    assert np.max((now.surface - allowed)[site.share > 1.0 - 1e-9]) <= 0.05
    # the section less the wedges at its ends, as wide as the blade
    wedges = 0.5 * 0.8**2 * (1.0 / np.tan(ENTRY) + 1.0 / np.tan(LEAVE))
    assert bank == pytest.approx((1.8 * 0.8 - wedges) * site.bucket.width, rel=0.05)
