"""Reach maps: how deep the teeth reach at every radius, and what a cycle costs there, wherever the machine stands.

They are computed once for a machine and its soil, on level ground without obstacles, and looked up for thousands of
places: a place only determines the radius and direction of soil and dump.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.errors import SceneError
from backhoe_planner.job import (
    Cut,
    Digger,
    Job,
    NoCut,
    Profile,
    Worksite,
    build_worksite,
    find_cut,
    lanes_of,
    postures_over,
)
from backhoe_planner.machine import Base, Dynamics, JointLimits, travel_times
from backhoe_planner.standing.moved_job import job_with

_FARTHEST, _NEAREST = 7.5, 0.9  # m from the swing axis between which the reach is computed; the machine with 4.4 m
# digging depth reaches 5.7 m
_DEEPER = 0.05  # m: depths are rounded up to this for sharing a map
_SHALLOWEST = 0.1  # m: as deep is the trench of a map at least; more than the tolerance of a trench
_EVERY = 0.25  # m between radii at which a cut is searched; chosen
_DEPTH = 0.3  # m, greatest depth of these cuts; chosen, that of the layers that are chosen most often
_LENGTH = 2.5  # m of radius in which such a cut must end; chosen, a bucket is full after 0.8 to 1.5 m
_NEARLY_AS_FULL = 0.5  # of the soil in the fullest cut, if none fills the bucket; chosen
_DIGS = 1e-6  # m below the ground at which the teeth dig; rounding
_DUMPS = np.arange(0.6, _FARTHEST, 0.1)  # m, radii at which emptying the bucket is evaluated


@dataclass(frozen=True, eq=False)
class DumpTable:
    """Emptying the bucket over a height, by radius.

    Attributes
    ----------
    r: (D,) from the swing axis [m].
    level, opened: (D, n) postures before and after, with the first joint at 0; nan if there is none.
    lift: (D,) potential energy of the machine with a full bucket in `level` [J].
    fall: (D,) potential energy of the empty machine in `opened` [J].
    """

    r: Vector
    level: Matrix
    opened: Matrix
    lift: Vector
    fall: Vector


@dataclass(frozen=True, eq=False)
class ReachMap:
    """The reach of a machine, and the cost of a cycle, by radius from its swing axis.

    Attributes
    ----------
    r, floor: (K,) radii and the lowest heights z at which the teeth dig there [m]; infinite where they do not dig.
    cuts: (M,) radii at which a cut begins.
    time, work: (M,) of the cut alone [s], [J].
    bank: (M,) bank volume of the soil that the cut takes [m^3].
    begin, end: (M, n) postures at its beginning and end, with the first joint at 0.
    full, empty: (M,) potential energy in `end` with the soil, and in `begin` without [J].
    limits: of the joints.
    swings: (2,) least and greatest swing angle [rad].
    """

    r: Vector
    floor: Vector
    cuts: Vector
    time: Vector
    work: Vector
    bank: Vector
    begin: Matrix
    end: Matrix
    full: Vector
    empty: Vector
    limits: JointLimits
    swings: Vector

    def reaches(self, r: Array, z: Array) -> Flags:
        """(...) whether the teeth dig down to heights z (...) at radii r (...) [m]."""
        floor = np.interp(r, self.r, self.floor, left=np.inf, right=np.inf)
        return np.asarray(floor <= z)

    @property
    def farthest(self) -> float:
        """The greatest radius at which the teeth dig [m]; 1 if they dig nowhere."""
        return float(self.r[np.isfinite(self.floor)].max(initial=1.0))

    def depth_range(self, z: float) -> tuple[float, float] | None:
        """The least and the greatest radius of the longest stretch in which the teeth dig down to a height z [m].

        None if there is no such stretch.
        """
        fine = np.concatenate(([False], self.floor <= z, [False]))
        steps = np.flatnonzero(np.diff(fine.astype(int)))
        runs = steps.reshape(-1, 2)
        if not len(runs):
            return None
        first, after = max(runs.tolist(), key=lambda run: run[1] - run[0])
        return float(self.r[first]), float(self.r[after - 1])

    def cycle(self, r: Vector, turn: Vector, dump: DumpTable, radius: float) -> tuple[Vector, Vector]:
        """(C,) time [s/m^3] and (C,) work [J/m^3] of cycles per bank volume, for soil at radii r (C,) [m].

        Both are infinite if the bucket cannot be emptied there.

        Parameters
        ----------
        turn: (C,) angle from the soil to the dump [rad], of either sign.
        dump: for emptying the bucket, at a `radius` [m].
        """
        level, opened, lift, fall = (
            _at(dump.r, values, np.array([radius])) for values in (dump.level, dump.opened, dump.lift, dump.fall)
        )
        begin, end = (_at(self.cuts, values, r) for values in (self.begin, self.end))
        over, back = level - end, begin - opened
        over[:, 0], back[:, 0] = np.abs(turn), np.abs(turn)
        moving = sum(travel_times(step, self.limits) for step in (over, opened - level, back))
        cut, work, bank, full, empty = (
            _at(self.cuts, values, r) for values in (self.time, self.work, self.bank, self.full, self.empty)
        )
        lifting = np.maximum(lift - full, 0.0) + np.maximum(empty - fall, 0.0)
        time = np.where(np.isfinite(moving), (cut + moving) / bank, np.inf)
        return time, np.where(np.isfinite(moving), (work + lifting) / bank, np.inf)


class _Machine:
    """A job's machine in its soil on level ground; equal for all jobs that agree in everything that matters for it."""

    def __init__(self, job: Job, ground: float, depth: float) -> None:
        content = job.to_dict()
        own = {key: content.get(key) for key in ("machine", "soil", "bucket")}
        own |= {key: job.site_scene.to_dict().get(key) for key in ("tip", "hold", "clearance", "limits", "zones")}
        self.job, self.ground, self.depth = job, ground, depth
        self._key = json.dumps([own, str(job.folder), job.ground.cell, ground, depth], sort_keys=True)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Machine) and self._key == other._key


def reach_map(job: Job, *, ground: float, depth: float) -> ReachMap:
    """The reach map of a job's machine in its soil; computed once for all jobs with the same machine and soil.

    Parameters
    ----------
    ground: height z of level ground [m].
    depth: the greatest depth that is needed [m].

    Raises
    ------
    SceneError: the machine digs nowhere.
    """
    deepest = _DEEPER * math.ceil(max(depth, _SHALLOWEST) / _DEEPER - 1e-6)
    return _made(_Machine(job, round(ground, 3), round(deepest, 3)))


@lru_cache(maxsize=4)
def _made(machine: _Machine) -> ReachMap:
    ground, depth = machine.ground, machine.depth
    job = job_with(machine.job, base=Base(), obstacles=False, ground={"level": ground, "cell": machine.job.ground.cell})
    site = build_worksite(job)
    plane, digger = site.plane, site.digger
    ends = plane.world(0.0, np.array([_FARTHEST, _NEAREST]), np.zeros(2))[:, :2]
    trench = {"from": ends[0].tolist(), "to": ends[1].tolist(), "width": digger.bucket.width, "depth": depth}
    around = np.vstack((ends, site.plane.axis))
    level = {
        "level": ground, "cell": job.ground.cell,
        "low": (around.min(axis=0) - 2.0).tolist(), "high": (around.max(axis=0) + 2.0).tolist(),
    }  # fmt: skip
    probe = build_worksite(job_with(job, obstacles=False, dig={"trench": trench}, ground=level))
    lanes = lanes_of(probe)
    if not lanes:
        raise SceneError("the machine digs nowhere on level ground", file=job.file, key="machine")
    lane = lanes[0]
    known = np.isfinite(lane.design)
    found = _fullest(job, [_cut_at(site, digger, ground, r) for r in np.arange(1.5, _FARTHEST, _EVERY)])
    begin, end = np.array([cut.q[0] for cut in found]), np.array([cut.q[-1] for cut in found])
    begin[:, 0] = end[:, 0] = 0.0
    empty = Dynamics(site.robot)
    limits = site.problem.limits
    room = np.array([limits.lower[0], limits.upper[0]]) if plane.swings else np.zeros(2)
    return ReachMap(
        r=lane.r[known], floor=np.where(lane.floor < ground - _DIGS, lane.floor, np.inf)[known],
        cuts=np.array([float(cut.r[0]) for cut in found]),
        time=np.array([cut.time for cut in found]), work=np.array([cut.work for cut in found]),
        bank=np.array([cut.bank_volume for cut in found]), begin=begin, end=end,
        full=np.array([Dynamics(site.robot, payload=float(c.held[-1])).potential_energy(c.q[-1]) for c in found]),
        empty=np.array([empty.potential_energy(cut.q[0]) for cut in found]),
        limits=limits, swings=room,
    )  # fmt: skip


def dump_table(site: Worksite, top: float) -> DumpTable:
    """The table of emptying the bucket by radius.

    Parameters
    ----------
    top: height over which the bucket is emptied [m].
    """
    n, heading = site.robot.n, site.plane.heading(0.0)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    level, opened = np.full((len(_DUMPS), n), np.nan), np.full((len(_DUMPS), n), np.nan)
    for row, radius in enumerate(_DUMPS.tolist()):
        arrivals, openings = postures_over(site, site.plane.axis + radius * ahead, top)
        if len(arrivals):
            level[row], opened[row] = arrivals[0], openings[0]
    payload = site.digger.soil.density * site.volume / site.job.soil.swell
    full, empty = Dynamics(site.robot, payload=payload), Dynamics(site.robot)
    lift = np.array([full.potential_energy(q) if np.isfinite(q).all() else np.nan for q in level])
    fall = np.array([empty.potential_energy(q) if np.isfinite(q).all() else np.nan for q in opened])
    return DumpTable(_DUMPS, level, opened, lift, fall)


def _cut_at(site: Worksite, digger: Digger, ground: float, r: float) -> Cut | NoCut:
    profile = Profile.level(ground, 0.0, _FARTHEST + 1.0)
    end = max(r - _LENGTH, _NEAREST)
    return find_cut(digger, profile, swing=0.0, start=r, end=end, depth=_DEPTH, volume=site.volume)


def _fullest(job: Job, tried: Sequence[Cut | NoCut]) -> list[Cut]:
    """The cuts that fill the bucket; if none does, as in hard soil, those that take the most soil."""
    cuts = [cut for cut in tried if isinstance(cut, Cut)]
    if not cuts:
        hard = [cut for cut in tried if isinstance(cut, NoCut) and cut.kind == "cylinder"]
        why = next((cut.reason for cut in (*hard, *tried) if isinstance(cut, NoCut)), "no radius within reach")
        raise SceneError("the machine makes no cut in this soil", file=job.file, key="soil", found=why)
    least = _NEARLY_AS_FULL * max(cut.fill for cut in cuts)
    return [cut for cut in cuts if cut.is_full] or [cut for cut in cuts if cut.fill >= least]


def _at(x: Vector, values: Array, at: Vector) -> Array:
    """(C, ...) `values` (M, ...) over x (M,), interpolated linearly at `at` (C,); constant beyond the ends."""
    if values.ndim == 1:
        return np.interp(at, x, values)
    return np.column_stack([np.interp(at, x, column) for column in values.T])
