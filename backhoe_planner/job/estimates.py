"""The estimated cost of a pattern: its cuts are found one by one on the changing ground, its motions only estimated.

A cut takes the time of its own estimate. A motion through the air takes the least time that the joint rates
and accelerations allow. The work is done against gravity and soil.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.job.cycles.cut_leg import CutPath, cut_path
from backhoe_planner.job.cycles.dumping import travel_time
from backhoe_planner.job.cycles.patterns import NextCut, Pattern, next_cut
from backhoe_planner.job.ground.sweep import BladeSweep, swept
from backhoe_planner.job.result.job_plan import PatternEstimate
from backhoe_planner.job.worksite.lanes import Lane
from backhoe_planner.job.worksite.worksite import Worksite
from backhoe_planner.machine import Dynamics

_MOST_CYCLES = 2000
_ENOUGH = 0.95  # of the most that any pattern digs; chosen: the cost of a pattern that digs less cannot be compared
_LEAST = 1e-3  # m^3 dug by a cut: less is no progress


def estimate_pattern(
    site: Worksite, lanes: Sequence[Lane], pattern: Pattern, dump: Callable[[Vector], tuple[Vector, Vector] | None]
) -> PatternEstimate:
    """The cost of a pattern from the first cut to the last.

    Parameters
    ----------
    dump: returns the postures, level and open, for dumping a bucketful after a posture (n,).
    """
    ground, limits = site.ground, site.problem.limits
    empty = Dynamics(site.robot)
    cycles, bank, duration, work = 0, 0.0, 0.0, 0.0
    at: Vector | None = site.problem.start_q
    finished = False
    while cycles < _MOST_CYCLES:
        found = next_cut(site, lanes, pattern, ground)
        if not isinstance(found, NextCut):
            finished = found is None
            break
        cut = found.cut
        sweep = swept(ground, BladeSweep(cut.position, cut.across, cut.bucket.width), slump=False)
        if float(sweep.volume[-1]) < _LEAST:
            break
        path = cut_path(site, cut, ground)
        if isinstance(path, str):
            path = CutPath(cut.q, 0, len(cut.q) - 1)
        over = dump(path.q[-1])
        if over is None:
            break
        level, opened = over
        payload = site.digger.soil.density * float(sweep.volume[-1]) / site.job.soil.swell
        full = Dynamics(site.robot, payload=payload)
        ways = [(path.q[0], path.q[path.first]), (path.q[path.last], path.q[-1]), (path.q[-1], level), (level, opened)]
        if at is not None:
            ways.append((at, path.q[0]))
        duration += cut.time + sum(travel_time(b - a, limits) for a, b in ways)
        work += cut.work
        for index, (a, b) in enumerate(ways):
            dynamics = full if index in (1, 2, 3) else empty
            work += max(dynamics.potential_energy(b) - dynamics.potential_energy(a), 0.0)
        at, ground = opened, sweep.terrain
        bank += float(sweep.bank[-1])
        cycles += 1
    per = duration if site.job.objective == "time" else work
    cost = per / bank if bank > 0.0 else float("inf")
    return PatternEstimate(pattern.name, cycles, bank, duration, work, cost, finished)


def in_full(estimates: Sequence[PatternEstimate]) -> list[PatternEstimate]:
    """The same estimates; `finished` stays true only if the pattern digs nearly as much as the one that digs most."""
    most = max(one.bank for one in estimates)
    return [replace(one, finished=one.finished and one.bank > _ENOUGH * most) for one in estimates]


def choose(estimates: Sequence[PatternEstimate]) -> int:
    """The index of the best of `in_full`: the cheapest of those that are finished, otherwise of those that dig most."""
    most = max(one.bank for one in estimates)
    done = [index for index, one in enumerate(estimates) if one.finished]
    enough = done or [index for index, one in enumerate(estimates) if one.bank >= _ENOUGH * most]
    return int(min(enough, key=lambda index: estimates[index].cost)) if np.isfinite(most) else 0
