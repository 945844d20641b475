"""One cycle: the approach, the cut, the swing with the bucket level, and the dump, against the ground at each time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.job.cuts.cut import Cut
from backhoe_planner.job.cuts.cut_rules import broken_rules
from backhoe_planner.job.cuts.profile import Profile
from backhoe_planner.job.cycles.cut_leg import CutPath, cut_motion, cut_path, cut_problem, dig, load_of
from backhoe_planner.job.cycles.dump_rules import broken_dump_rules
from backhoe_planner.job.cycles.dumping import Dumping, DumpSite, NoDump, SiteState, ground_obstacles
from backhoe_planner.job.cycles.patterns import NextCut, shallower
from backhoe_planner.job.cycles.transfers import Transfer, Transfers, level_band, make_leg
from backhoe_planner.job.ground.heaps import poured
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.result.cycles import Cycle, CycleLeg, Digging, LegName
from backhoe_planner.job.worksite.worksite import Worksite
from backhoe_planner.motion import Keep, Problem, Trajectory
from backhoe_planner.proof import certify_problem

_HIGHER = (0.0, 0.15, 0.35)  # m by which the bucket is lifted further at both ends of a cut, tried in turn; chosen
# parts of the joint rates, and of the depth, tried in turn if a cut exceeds the limits; the depth also if it breaks a
# rule. On rough ground the force between the places of a cut was up to 8 % above that at its places, in one of 400
_PACES, _SHALLOWER = (1.0, 0.7), (0.7, 0.4)
_PLACES = 3  # greatest number of places that are tried for dumping a bucketful

FailedPart = Literal["cut", "rules", "limits", "approach", "swing", "dump", "full", "unreachable"]


@dataclass(frozen=True, eq=False)
class Failed:
    """Why there is no cycle.

    Attributes
    ----------
    part: ``cut`` if nothing leads along the cut, so that another may be tried, ``rules`` if its motion breaks a rule of
        cuts, or ``limits`` if the cut exceeds what the machine can do; otherwise ``approach``, ``swing``, ``dump``;
        ``full`` if no more soil can be dumped, and ``unreachable`` if the bucket cannot be emptied anywhere.
    words: the same in a sentence.
    """

    part: FailedPart
    words: str


class CyclePlanner:
    """Plans cycles one after the other.

    Parameters
    ----------
    site: the worksite.
    dump: where the soil goes.
    effort, seed: effort and seed of the searches.
    """

    def __init__(self, site: Worksite, dump: DumpSite, *, effort: str, seed: int) -> None:
        self._site, self._dump = site, dump
        self._transfers = Transfers(site.problem, effort=effort, seed=seed)

    @property
    def site(self) -> Worksite:
        """The worksite."""
        return self._site

    def first(self, ground: Terrain) -> SiteState:
        """The site before the first cycle."""
        return self._dump.first(ground, ground_obstacles(self._site, ground))

    def stay_in_something(self, start: Vector, state: SiteState) -> Transfer | None:
        """The stay at `start` (n,) if the machine is in something or too near to it there, so that no motion begins."""
        stay = self._transfers.to("approach", start, [start], ground=state.obstacles, payload=0.0)
        return stay if stay.stands_in else None

    def after_cut(self, ground: Terrain, before: SiteState) -> SiteState:
        """The site with the ground after a cut."""
        return replace(before, ground=ground, grounds=ground_obstacles(self._site, ground, before=before.grounds))

    def dumped(self, state: SiteState, place: Vector, volume: float, number: int) -> SiteState | str:
        """See `DumpSite`."""
        return self._dump.dumped(state, place, volume, number)

    def again(self, state: SiteState, cycle: Cycle) -> SiteState:
        """The site after a cycle that has already been planned."""
        found = self.dumped(self.after_cut(cycle.dug, state), cycle.place[:2], cycle.held, cycle.truck)
        assert not isinstance(found, str)
        return found

    def leg_problem(self, name: LegName, motion: Trajectory, state: SiteState, payload: float) -> Problem:
        """The problem of a motion of a cycle; for a cut, without its soil.

        Parameters
        ----------
        state: the site during the motion.
        payload: mass in the bucket [kg].
        """
        keep = Keep(self._site.robot, [level_band(self._site.problem)]) if name == "swing" else None
        ground = state.obstacles
        if name == "cut":
            arm = [link for link in self._site.plane.arm if link not in bucket_links(self._site)]
            ground = (replace(ground[0], links=tuple(arm)), *ground[1:])
            payload = 0.0  # the load grows during the cut: it belongs to the soil
        ends = (motion.q[0], [motion.q[-1]])
        return self._transfers.problem(*ends, ground=ground, payload=payload, keep=keep)

    def plan(
        self, number: int, start: Vector | None, state: SiteState, chosen: NextCut
    ) -> tuple[Cycle, SiteState] | Failed:
        """One cycle, and the site after it.

        Parameters
        ----------
        number: number of the cycle, from 1.
        start: (n,) the machine's posture at the start; None if it may begin above the cut.
        state: the site as it is.
        chosen: the cut; a shallower one is dug if its motion exceeds what the machine can do, or breaks a rule.
        """
        found = self._planned(number, start, state, chosen)
        for part in _SHALLOWER:
            if not isinstance(found, Failed) or found.part not in ("limits", "rules"):
                break
            less = shallower(self._site, chosen, state.ground, part)
            if less is not None:
                found = self._planned(number, start, state, less)
        return found

    def _planned(
        self, number: int, start: Vector | None, state: SiteState, chosen: NextCut
    ) -> tuple[Cycle, SiteState] | Failed:
        failed = Failed("cut", "")
        for higher in _HIGHER:
            made = self._cut(chosen.cut, state, higher)
            if isinstance(made, Failed):
                return made if not failed.words else failed
            cut_leg, path = made
            legs: list[CycleLeg] = []
            if start is not None:
                approach = self._transfers.to("approach", start, [path.q[0]], ground=state.obstacles, payload=0.0)
                if approach.leg is None:
                    failed = Failed("approach", approach.why)
                    continue
                legs.append(approach.leg)
            found = self._after(number, [*legs, cut_leg], state, chosen)
            if not isinstance(found, Failed):
                return found
            failed = found
            if found.part in ("full", "unreachable"):
                break
        return failed

    def _cut(self, cut: Cut, state: SiteState, higher: float) -> tuple[CycleLeg, CutPath] | Failed:
        site = self._site
        path = cut_path(site, cut, state.ground, higher=higher)
        if isinstance(path, str):
            return Failed("cut", path)
        profile = Profile.of_terrain(state.ground, site.plane, cut.swing, width=site.bucket.width)
        for pace in _PACES:
            motion = cut_motion(site, cut, path, pace=pace)
            broken = broken_rules(site.digger, profile, motion.q, swing=cut.swing)
            if broken:
                return Failed("rules", "; ".join(broken))
            digging, _ = dig(site, motion, cut.swing, state.ground)
            load = load_of(site, cut.swing, digging)
            problem = cut_problem(site, load, digging, self.leg_problem("cut", motion, state, 0.0), state.ground)
            certificate = certify_problem(problem, motion)
            if certificate.limits_kept:
                break
        if not certificate.verified:
            return Failed("cut" if certificate.limits_kept else "limits", "; ".join(certificate.problems))
        leg = make_leg("cut", problem, motion, certificate)
        return replace(leg, payload=float(load.mass[-1])), path

    def _after(
        self, number: int, legs: list[CycleLeg], state: SiteState, chosen: NextCut
    ) -> tuple[Cycle, SiteState] | Failed:
        """The swing and the dump after a cut."""
        site, cut, motion = self._site, chosen.cut, legs[-1].trajectory
        dug = dig_and_spill(site, motion, cut.swing, state.ground)
        after_cut = self.after_cut(dug.ground, state)
        payload = site.digger.soil.density * dug.held / site.job.soil.swell
        options = self._dump.options(after_cut, dug.held, motion.q[-1])
        if isinstance(options, NoDump):
            return Failed(options.reason, options.words)
        failed = Failed("swing", "")
        for option in options[:_PLACES]:
            after = self.dumped(after_cut, option.place[:2], dug.held, option.number)
            if isinstance(after, str):
                return Failed("full", after)
            emptied = self._empty(motion.q[-1], option, after_cut, after, payload)
            if isinstance(emptied, Failed):
                failed = emptied
                continue
            cycle = Cycle(
                number, (*legs, *emptied), dug.digging, load_of(site, cut.swing, dug.digging),
                before=state.ground, dug=dug.ground,
                after=after.ground, bank=dug.bank, taken=dug.taken, held=dug.held, spilt=dug.spilt, place=option.place,
                truck=option.number, truck_load=after.truck_load, step=chosen.step,
                filled=dug.held / site.bucket.capacity, depth=dug.depth,
            )  # fmt: skip
            return cycle, after
        return failed

    def _empty(
        self, start: Vector, option: Dumping, before: SiteState, after: SiteState, payload: float
    ) -> tuple[CycleLeg, CycleLeg] | Failed:
        """The swing to a place and the dump there; from higher up if the soil that is then there is in the way.

        Parameters
        ----------
        before, after: the site before and after the dump.
        """
        failed, lowest = Failed("swing", ""), 0
        while lowest < len(option.arrivals):
            arrivals = option.arrivals[lowest:]
            swing = self._transfers.to(
                "swing", start, list(arrivals), ground=before.obstacles, payload=payload, level=True
            )
            if swing.leg is None:
                return failed if failed.words else Failed("swing", swing.why)
            q = swing.leg.trajectory.q[-1]
            reached = lowest + int(np.argmin(np.max(np.abs(arrivals - q), axis=1)))
            opening = self._open(q, option.openings[reached], option.place[:2], after, payload)
            if not isinstance(opening, Failed):
                return swing.leg, opening
            failed, lowest = opening, reached + 1
        return failed

    def _open(self, q: Vector, opened: Vector, place: Vector, after: SiteState, payload: float) -> CycleLeg | Failed:
        """Open the bucket above the soil that is then there, at a place (2,) [m]."""
        found = self._transfers.to("dump", q, [opened], ground=after.obstacles, payload=payload)
        if found.leg is None:
            return Failed("dump", found.why)
        broken = broken_dump_rules(self._site, found.leg.trajectory.q, place)
        return Failed("dump", "; ".join(broken)) if broken else found.leg


def bucket_links(site: Worksite) -> tuple[str, ...]:
    """The links beyond the last joint."""
    return tuple(dict.fromkeys(piece.link for piece in site.robot.pieces if piece.joint == site.robot.n))


@dataclass(frozen=True, eq=False)
class Dug:
    """The result of a cut.

    Attributes
    ----------
    digging: how the ground changes.
    ground: the ground after the cut, with the spilt soil.
    bank: undisturbed soil that left the ground [m^3].
    taken: loose soil taken up with it [m^3].
    held: loose soil in the bucket [m^3].
    spilt: loose soil that fell back [m^3].
    depth: greatest depth of the edge below the ground before the cut [m].
    """

    digging: Digging
    ground: Terrain
    bank: float
    taken: float
    held: float
    spilt: float
    depth: float


def dig_and_spill(site: Worksite, motion: Trajectory, swing: float, ground: Terrain) -> Dug:
    """The soil that a motion takes out of the ground; what the bucket cannot hold falls where the bucket is lifted.

    Parameters
    ----------
    motion: motion of the machine.
    swing: angle of the arm's plane [rad].
    ground: the ground before the motion.
    """
    digging, sweep = dig(site, motion, swing, ground, slump=True)
    bank, taken, volume = float(sweep.bank[-1]), float(sweep.loose[-1]), float(sweep.volume[-1])
    held = min(volume, site.bucket.capacity)
    after = sweep.terrain if held == volume else poured(sweep.terrain, digging.edge[-1, :2], volume - held)
    profile = Profile.of_terrain(ground, site.plane, swing, width=site.bucket.width)
    depth = max(float(np.max(profile.depth(*site.plane.place(motion.q)[:2]))), 0.0)
    return Dug(digging, after, bank, taken, held, volume - held, depth)
