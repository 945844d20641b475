"""The estimated cost of a pattern: its cuts are found one by one on the changing ground, its motions only estimated.

A cut is run along its own path. A motion through the air takes the straight line of the joints, as if nothing were in
the way. Joint rates, accelerations, valves, pump and engine limit both. The work is done against gravity, inertia and
soil; what one joint gains while it is lowered does not help another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.job.checked_job import CheckedJob
from backhoe_planner.job.cuts.cut import Cut
from backhoe_planner.job.cycles.cut_leg import CutPath, cut_path
from backhoe_planner.job.cycles.dumping import NoDump
from backhoe_planner.job.cycles.patterns import NextCut, Pattern, next_cut, sweep_of
from backhoe_planner.job.result.job_plan import PatternEstimate
from backhoe_planner.job.worksite.worksite import Worksite
from backhoe_planner.machine import Dynamics

_MOST_CYCLES = 2000  # of an estimate; chosen, it only ends what would not end
_ENOUGH = 0.95  # of the most that any pattern digs; chosen: the cost of a pattern that digs less cannot be compared
_PLACES = 25  # along a motion through the air; chosen
_EASY = 2.0 / 3.0  # of the speed of the fastest motion, if the work counts: a plan then takes half as long again
CLOSE = 0.02  # part of the cost within which estimates of one job do not tell patterns apart; chosen
_LEAST = 1e-3  # m^3 dug by a cut: less is no progress


def estimate_pattern(work: CheckedJob, pattern: Pattern) -> PatternEstimate:
    """The cost of a pattern from the first cut to the last, with the soil dumped where a plan would dump it."""
    site, dump = work.site, work.dump
    pace = 1.0 if site.job.objective == "time" else _EASY
    state = dump.first(site.ground, work.grounds)
    empty = Dynamics(site.robot)
    cycles, bank, duration, energy = 0, 0.0, 0.0, 0.0
    at: Vector | None = site.problem.start_q
    finished = False
    while cycles < _MOST_CYCLES:
        found = next_cut(site, work.lanes, pattern, state.ground)
        if not isinstance(found, NextCut):
            finished = found is None
            break
        cut = found.cut
        sweep = found.sweep or sweep_of(cut, state.ground)
        if float(sweep.volume[-1]) < _LEAST:
            break
        path = cut_path(site, cut, state.ground)
        if isinstance(path, str):
            path = CutPath(cut.q, 0, len(cut.q) - 1)
        held = min(float(sweep.volume[-1]), site.bucket.capacity)
        options = dump.options(replace(state, ground=sweep.terrain), held, path.q[-1])
        if isinstance(options, NoDump):
            break
        over = options[0]
        after = dump.dumped(replace(state, ground=sweep.terrain), over.place[:2], held, over.number)
        if isinstance(after, str):
            break
        level, opened = over.arrivals[0], over.openings[0]
        payload = site.digger.soil.density * held / site.job.soil.swell
        full = Dynamics(site.robot, payload=payload)
        runs = [
            _cut_run(site, cut, path, (empty, full)),
            _air_run(site, path.q[-1], level, full, pace=pace),
            _air_run(site, level, opened, full),
        ]
        if at is not None:
            runs.append(_air_run(site, at, path.q[0], empty, pace=pace))
        duration += sum(time for time, _ in runs)
        energy += sum(used for _, used in runs)
        at, state = opened, after
        bank += float(sweep.bank[-1])
        cycles += 1
    cost = site.job.objective_of(duration, energy) / bank if bank > 0.0 else float("inf")
    return PatternEstimate(pattern.name, cycles, bank, duration, energy, cost, finished)


def _cut_run(site: Worksite, cut: Cut, path: CutPath, machines: tuple[Dynamics, Dynamics]) -> tuple[float, float]:
    """Time [s] and work [J] of a cut with the ways down to it and up from it; `machines` are the empty and the full."""
    empty, full = machines
    torque = np.vstack(
        (
            empty.gravity_torques(path.q[: path.first]),
            cut.torque[: path.last - path.first + 1],
            full.gravity_torques(path.q[path.last + 1 :]),
        )
    )
    return site.digger.estimated_run(path.q, torque, inertia=empty)


def _air_run(
    site: Worksite, start: Vector, end: Vector, machine: Dynamics, *, pace: float = 1.0
) -> tuple[float, float]:  # fmt: skip
    """Time [s] and work [J] of a motion on the straight line of the joints from `start` to `end` (n,)."""
    q = start + np.linspace(0.0, 1.0, _PLACES)[:, None] * (end - start)
    return site.digger.estimated_run(q, machine.gravity_torques(q), inertia=machine, part=1.0, pace=pace)


def compared_patterns(
    work: CheckedJob, patterns: Sequence[Pattern], known: Sequence[PatternEstimate] = ()
) -> tuple[PatternEstimate, ...]:
    """The estimates of all `patterns` for a job, the one that is chosen first, the others by their costs.

    Parameters
    ----------
    known: those estimates that `estimate_pattern` has already made for this job.
    """
    made = {one.name: one for one in known}
    estimates = [made.get(one.name) or estimate_pattern(work, one) for one in patterns]
    return chosen_first(estimates, work.site.job.objective)


def chosen_first(made: Sequence[PatternEstimate], objective: Literal["time", "work"]) -> tuple[PatternEstimate, ...]:
    """The estimates of `estimate_pattern`, the one that is chosen first, the others by their costs."""
    estimates = in_full(made)
    best = choose(estimates, objective)
    order = sorted(range(len(estimates)), key=lambda index: (index != best, estimates[index].cost))
    return tuple(replace(estimates[index], chosen=index == best) for index in order)


def in_full(estimates: Sequence[PatternEstimate]) -> list[PatternEstimate]:
    """The same estimates; `finished` stays true only if the pattern digs nearly as much as the one that digs most."""
    most = max(one.bank for one in estimates)
    return [replace(one, finished=one.finished and one.bank > _ENOUGH * most) for one in estimates]


def choose(estimates: Sequence[PatternEstimate], objective: Literal["time", "work"]) -> int:
    """The index of the best of `in_full`: the cheapest of those that are finished, otherwise of those that dig most.

    Costs that differ by less than `CLOSE` count as equal. Among these, the one that is best by the other objective is
    chosen.
    """
    most = max(one.bank for one in estimates)
    if most <= 0.0:
        return 0
    done = [one for one in estimates if one.finished]
    enough = done or [one for one in estimates if one.bank >= _ENOUGH * most]
    least = min(one.cost for one in enough)
    close = [one for one in enough if one.cost <= (1.0 + CLOSE) * least]
    best = min(close, key=lambda one: (one.work if objective == "time" else one.duration) / one.bank)
    return estimates.index(best)
