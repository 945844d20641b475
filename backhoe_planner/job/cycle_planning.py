"""One cycle: the approach, the cut, the swing with the bucket level, and the dump, against the ground as it then is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.job.cut_leg import CutPath, cut_motion, cut_path, cut_problem
from backhoe_planner.job.cuts.cut import Cut
from backhoe_planner.job.dumping import Dumping, HeapDump, Site
from backhoe_planner.job.ground.heaps import poured
from backhoe_planner.job.ground.sweep import BladeSweep, Sweep, swept
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.patterns import NextCut
from backhoe_planner.job.result.cycles import Cycle, Digging, Leg
from backhoe_planner.job.transfers import Transfers, make_leg
from backhoe_planner.job.worksite import Worksite
from backhoe_planner.motion import Trajectory
from backhoe_planner.proof import certify_problem

_HIGHER = (0.0, 0.15, 0.35)  # m by which the bucket is lifted more at both ends of a cut, tried in turn; chosen
_PLACES = 3  # at which a bucketful is tried to be dumped


@dataclass(frozen=True, eq=False)
class Failed:
    """Why there is no cycle.

    Attributes
    ----------
    part: ``cut`` where it is the cut that cannot be, so that another may be tried; else ``approach``, ``swing``,
        ``dump``, or ``full`` where no soil can be dumped any more.
    words: in a sentence.
    """

    part: str
    words: str


class CyclePlanner:
    """Plans cycles one after the other.

    Parameters
    ----------
    site: the job on its machine.
    dump: where the soil goes.
    effort, seed: of the searches.
    """

    def __init__(self, site: Worksite, dump: HeapDump, *, effort: str, seed: int) -> None:
        self._site, self._dump = site, dump
        self._transfers = Transfers(site.problem, effort=effort, seed=seed)
        self._clearance = site.problem.scene.clearance

    def first(self, ground: Terrain, *, truck: Cycle | None) -> Site:
        """The site before the next cycle.

        Parameters
        ----------
        truck: the cycle before it, if any, that says how full the truck is.
        """
        return Site.of(ground, clearance=self._clearance)

    def plan(self, number: int, start: Vector | None, state: Site, chosen: NextCut) -> tuple[Cycle, Site] | Failed:
        """One cycle, and the site after it.

        Parameters
        ----------
        number: of the cycle, from 1.
        start: (n,) where the machine stands; None where it may begin above the cut.
        state: the site as it is.
        chosen: the cut.
        """
        failed = Failed("cut", "")
        for higher in _HIGHER:
            made = self._cut(chosen.cut, state, higher)
            if isinstance(made, Failed):
                failed = made
                continue
            cut_leg, path = made
            legs: list[Leg] = []
            if start is not None:
                approach = self._transfers.to(
                    "approach", start, [path.q[0]], ground=[state.obstacle], payload=0.0
                )
                if approach.leg is None:
                    failed = Failed("approach", approach.why)
                    continue
                legs.append(approach.leg)
            found = self._after(number, [*legs, cut_leg], path, state, chosen)
            if not isinstance(found, Failed):
                return found
            failed = found
            if found.part == "full":
                break
        return failed

    def _cut(self, cut: Cut, state: Site, higher: float) -> tuple[Leg, CutPath] | Failed:
        site = self._site
        path = cut_path(site, cut, state.ground, higher=higher)
        if isinstance(path, str):
            return Failed("cut", path)
        motion = cut_motion(site, cut, path)
        arm = [link for link in site.robot.moving_links if link not in bucket_links(site)]
        ground = replace(state.obstacle, links=tuple(arm))
        problem = self._transfers.problem(motion.q[0], [motion.q[-1]], ground=[ground], payload=0.0)
        problem = cut_problem(site, cut, problem)
        certificate = certify_problem(problem, motion)
        if not certificate.verified:
            return Failed("cut", "; ".join(certificate.problems))
        leg = make_leg("cut", problem, motion, certificate)
        return replace(leg, payload=float(cut.held[-1])), path

    def _after(
        self, number: int, legs: list[Leg], path: CutPath, state: Site, chosen: NextCut
    ) -> tuple[Cycle, Site] | Failed:
        """The swing and the dump after a cut."""
        site, cut, motion = self._site, chosen.cut, legs[-1].trajectory
        digging, sweep = dig(site, motion, cut.across, state.ground)
        volume = float(sweep.volume[-1])
        held = min(volume, site.bucket.capacity)
        spilt = volume - held
        ground = sweep.terrain
        if spilt > 0.0:
            ground = poured(ground, digging.edge[-1, :2], spilt)
        dug = Site.of(ground, clearance=self._clearance, before=state)
        payload = site.digger.soil.density * held / site.job.soil.swell
        options = self._dump.options(ground, held, motion.q[-1])
        if isinstance(options, str):
            return Failed("full", options)
        failed = Failed("swing", "")
        for option in options[:_PLACES]:
            swing = self._transfers.to(
                "swing", motion.q[-1], list(option.arrivals), ground=[dug.obstacle], payload=payload, level=True
            )
            if swing.leg is None:
                failed = Failed("swing", swing.why)
                continue
            after = Site.of(option.after, clearance=self._clearance, before=dug)
            opening = self._open(swing.leg.trajectory.q[-1], option, after, payload)
            if isinstance(opening, Failed):
                failed = opening
                continue
            depth = float(np.max(cut.depth))
            cycle = Cycle(
                number, (*legs, swing.leg, opening), digging, before=state.ground, dug=ground, after=option.after,
                bank=float(sweep.bank[-1]), taken=float(sweep.loose[-1]), held=held, spilt=spilt, place=option.place,
                truck=option.truck, step=chosen.step, filled=held / site.bucket.capacity, depth=depth,
            )  # fmt: skip
            return cycle, after
        return failed

    def _open(self, q: Vector, option: Dumping, after: Site, payload: float) -> Leg | Failed:
        """The bucket opens over what then lies there."""
        reached = int(np.argmin(np.max(np.abs(option.arrivals - q), axis=1)))
        found = self._transfers.to("dump", q, [option.openings[reached]], ground=[after.obstacle], payload=payload)
        return Failed("dump", found.why) if found.leg is None else found.leg


def bucket_links(site: Worksite) -> tuple[str, ...]:
    """The links beyond the last joint."""
    return tuple(dict.fromkeys(piece.link for piece in site.robot.pieces if piece.joint == site.robot.n))


def dig(site: Worksite, motion: Trajectory, across: Vector, ground: Terrain) -> tuple[Digging, Sweep]:
    """What a motion through the soil takes out of the ground.

    Parameters
    ----------
    motion: of the machine.
    across: (3,) unit vector along the cutting edge, world.
    ground: before it.
    """
    edge = site.plane.kinematics.at(motion.q).tip_position
    sweep = swept(ground, BladeSweep(edge, across, site.bucket.width))
    return Digging(motion.time, edge, across, site.bucket.width, sweep.bank, sweep.loose), sweep
