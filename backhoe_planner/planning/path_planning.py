"""Planning along a path: its redundancy is resolved globally, and the path is left only where it must be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import BatchKinematics
from backhoe_planner.motion import (
    SAMPLE_PERIOD,
    PathCost,
    TipPath,
    Trajectory,
    WaypointStep,
    drive_of,
    longest_step,
    motion_cost,
    progress,
    slow_tip,
)
from backhoe_planner.planning.law_following import follow_with_law
from backhoe_planner.planning.paths.layer_stations import Layering
from backhoe_planner.planning.paths.path_layers import freest, redundancy_of
from backhoe_planner.planning.paths.path_resolution import PathResolver
from backhoe_planner.planning.paths.resolution import Bypass, Departure, Resolution
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.result.findings import Findings
from backhoe_planner.planning.search.effort import OutOfTime
from backhoe_planner.planning.search.sampling import JointPath
from backhoe_planner.planning.stretches.corners import SHARP, round_corners, time_stretch, with_halfways
from backhoe_planner.planning.stretches.dynamic_programming import cheapen_stretch
from backhoe_planner.planning.stretches.kept_cones import open_cones
from backhoe_planner.planning.stretches.smoothing import smooth_stretch
from backhoe_planner.planning.stretches.stretch import LawWay, Stretch
from backhoe_planner.planning.stretches.timed_stretch import TimedStretch, time_rounded
from backhoe_planner.planning.transit import find_detour, find_transit, play
from backhoe_planner.planning.world.outcome import (
    Outcome,
    at_rest,
    blocked_path,
    by_arc_length,
    no_posture,
    rest_at_start,
)
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import AT_CLEARANCE, describe_step
from backhoe_planner.site import ClearanceScreen

_ROOM = 5e-4  # m of margin below which the samples are closer; chosen: about the sagitta of chords
_FINE_PERIOD = SAMPLE_PERIOD / 5.0  # s between such samples: chords are 25 times nearer to the curve
# if there is only one free parameter: half the usual step of it, which is then affordable, and twice the usual distance
# between layers, so that a route can turn slowly
_DENSE = Layering(spacing=0.1, grid=float(np.radians(2.5)))
_MOST_DENSER = 3  # times that samples are inserted into a stretch; chosen: a curve then swings out by an eighth
_STEP_SPARE = 1e-3  # part of the allowed joint step between waypoints that is kept for chords and round corners; chosen
_TO_THE_END = 2  # of the other ways, roughly made cheaper, that are made cheaper to the end; chosen
_ON_PATH = 1e-4  # m and rad; chosen: within this the tip counts as being on the path


@dataclass(frozen=True, eq=False)
class AlongPath:
    """The task of following a path with the tip to its end."""

    path: TipPath

    def from_rest(self, world: World, stepper: Stepper) -> Outcome:
        """A motion to the path and along it, or further along it from where `stepper` has followed it to."""
        task = world.problem.scene.task.path
        assert task is not None
        since = progress(
            self.path, task.tolerance, stepper.trajectory(), world.kinematics, angle_tolerance=task.rotation_tolerance
        )
        return plan_along_path(world, self.path, stepper=stepper, since=since)

    def in_motion(self, world: World, stepper: Stepper) -> None:
        """Always None: a path is followed further only from rest."""

    def by_law(self, world: World, stepper: Stepper | None) -> Outcome:
        """A motion by the completed law alone, from rest or (None) from any configuration at the path's beginning."""
        return follow_with_law(world, self.path, stepper)


def plan_along_path(world: World, path: TipPath, *, stepper: Stepper | None, since: float | None = None) -> Outcome:
    """A motion to the path and along it to its end.

    Parameters
    ----------
    stepper: a motion that is at rest; None if the machine may begin in any
        configuration at the beginning of the path.
    since: arc length up to which the motion has followed the path already [m]; None for
        a motion that is not on the path yet.
    """
    low = 0.0 if since is None else since
    time = 0.0 if stepper is None else stepper.time
    on_path = stepper is not None and max(path.target(low).distances(world.kinematics.at(stepper.q))) < _ON_PATH
    cost = PathCost(world.problem)
    robot = world.problem.robot
    # with one free parameter the grid can be dense; layers far apart let a route turn slowly
    freest_target = freest(robot, [path.target(station) for station in path.stations])
    redundancy = redundancy_of(robot, freest_target)
    begin = stepper.q if stepper is not None and on_path else None

    def resolver_within(joint_steps: Vector | None) -> PathResolver:
        """A resolver of the path if a joint may move by `joint_steps` (n,) from waypoint to waypoint; None: freely."""
        return PathResolver(
            world.problem,
            path,
            proximity=world.proximity,
            cost=cost.step_costs,
            work=world.work,
            departure=Departure(low, begin, time),
            layering=replace(_DENSE if redundancy == 1 else Layering(), joint_steps=joint_steps),
            apart=np.array([world.apart.get((pair.link, pair.name), 0.0) for pair in world.proximity.pairs]),
            find_detour=lambda a, b, low, high: find_detour(world, path, a, b, low, high, time=time),
        )

    resolver = resolver_within(None)
    outside = resolver.outside_cones()
    if outside is not None:
        station, broken = outside
        why = f"no posture was found {station:.2f} m along the path that keeps it: at best {broken}"
        return Outcome(
            rest_at_start(world, robot.middle) if stepper is None else stepper.trajectory(), "goal_breaks_keep", why
        )
    if since is None and not len(resolver.first_layer) and not on_path:
        near = None if stepper is None else stepper.q
        found = world.postures.at(path.target(0.0), near=near, count=world.work.effort.starting_points, time=time)
        failure = no_posture(world, found, path.target(0.0), "goal_in_collision", "beginning of the path")
        if failure is not None:
            return failure
    # full poses leave so little free that the graph decides well
    other_ways = world.work.effort.other_ways if redundancy > 1 and freest_target.rotation is None else 0
    along = _Along(world, path, resolver, cost, stepper, resolver_within, other_ways)
    if stepper is None or (since is None and not on_path):
        return along.plan(None)
    return along.plan(stepper.q, off_path=not on_path)


def _first(pieces: Sequence[Stretch | Bypass]) -> Vector:
    """(n,) the joints at the beginning of a path."""
    first = pieces[0]
    assert isinstance(first, Stretch)
    return np.asarray(first.q[0])


class _Along:
    """One path, and the methods to resolve it."""

    def __init__(
        self,
        world: World,
        path: TipPath,
        resolver: PathResolver,
        cost: PathCost,
        stepper: Stepper | None,
        resolver_within: Callable[[Vector | None], PathResolver],
        other_ways: int,
    ) -> None:
        self._world = world
        self._path = path
        self._resolver = resolver
        self._cost = cost
        self._stepper = stepper
        self._resolver_within = resolver_within
        self._other_ways = other_ways
        self._steps, self._cones = world.problem.joint_steps, open_cones(world.problem, path)
        task = world.problem.scene.task.path
        assert task is not None
        self._may_leave, self._may_turn = task.detour, task.turn_on_the_spot
        self._time = 0.0 if stepper is None else stepper.time
        self._timed: dict[Stretch, TimedStretch] = {}  # those whose motions have been compared

    def plan(self, begin: Vector | None, *, off_path: bool = False) -> Outcome:
        """The motion to the path and along it.

        Parameters
        ----------
        begin: (n,) joints from which the path is followed [rad or m]; None for any at its beginning.
        off_path: whether the tip is off the path there.
        """
        resolved = self._resolver.resolve(begin, detours=False, price=self._price, off_path=off_path)
        if resolved.obstruction is not None and self._may_leave:
            resolved = self._resolver.resolve(begin, detours=True, price=self._price, off_path=off_path)
        if resolved.obstruction is None and not off_path:
            resolved = self._within_steps(resolved, begin)
            if resolved.step is not None:
                return self._too_long(resolved.step)
        if not resolved.pieces:
            return self._blocked(resolved, at_rest(self._anywhere() if self._stepper is None else self._stepper.q))
        stepper = self._stepper
        if stepper is not None and begin is None:
            # before the pieces are made cheaper, which does not change the first joints and may use up the time
            resolved = self._turned(resolved, stepper.q)
            transit = find_transit(self._world, stepper, [_first(resolved.pieces)])
            if isinstance(transit, str):
                return self._from_elsewhere(stepper, transit)
            stepper = transit
        elif stepper is not None:
            stepper = stepper.branch(attempt=stepper.attempt)
        # for a blocked path that may not be left, a quick answer is worth more than a cheaper beginning
        fails = resolved.obstruction is not None and not self._may_leave
        pieces, law = (list(resolved.pieces), None) if fails else self._improve(resolved, begin)
        message = self._world.work.brake.cut_short
        stepper = self._world.stepper(_first(pieces)) if stepper is None else stepper
        self._play(stepper, pieces)
        if resolved.obstruction is not None:
            return self._blocked(resolved, stepper.trajectory())
        detours = tuple(piece.obstruction for piece in pieces if isinstance(piece, Bypass))
        return Outcome(
            stepper.trajectory(),
            message=message,
            findings=Findings(detours=tuple(by_arc_length(detour, self._path) for detour in detours)),
            law=law,
        )

    def _within_steps(self, resolved: Resolution, begin: Vector | None) -> Resolution:
        """`resolved`, or if a joint moves too far from waypoint to waypoint, another resolution of the path."""
        if self._steps is None or self._keeps_steps(resolved.pieces):
            return resolved
        within = self._resolver_within((1.0 - _STEP_SPARE) * self._steps)
        return within.resolve(begin, detours=False, price=self._price)

    def _keeps_steps(self, pieces: Sequence[Stretch | Bypass]) -> bool:
        """Whether no joint moves too far from waypoint to waypoint; a detour counts as too far."""
        if self._steps is None:
            return True
        if any(isinstance(piece, Bypass) for piece in pieces):
            return False
        steps = [longest_step(self._path, piece.stations, piece.q, self._steps)
                 for piece in pieces if isinstance(piece, Stretch)]  # fmt: skip
        return all(step is None or step.ratio <= 1.0 for step in steps)

    def _too_long(self, step: WaypointStep) -> Outcome:
        """The failure if a joint has to move further from waypoint to waypoint than it may."""
        problem = self._world.problem
        motion = at_rest(self._anywhere()) if self._stepper is None else self._stepper.trajectory()
        asked = replace(step, allowed=step.allowed / (1.0 - _STEP_SPARE))
        message = f"a joint would have to move too far between two waypoints: at least, {describe_step(problem, asked)}"
        if asked.kept:
            message += f", of which {100.0 * _STEP_SPARE:g} % is left for chords and round corners"
        message += "; this is the first such pair, and a waypoint between the two makes the steps shorter"
        return Outcome(motion, "outside_limits", message, Findings(joints=(problem.robot.joint_names[step.joint],)))

    def _price(self, nodes: Matrix) -> Vector:
        """(N,) the cost of getting to each of `nodes` (N, n), by the objective [rad]."""
        if self._stepper is None:
            return np.zeros(len(nodes))
        return self._cost.of_approaches(self._stepper.q, nodes)

    def _turned(self, resolved: Resolution, near: Vector) -> Resolution:
        """The same with continuous joints shifted by whole turns: the path begins within half a turn of `near`."""
        first = _first(resolved.pieces)
        turns = self._world.problem.robot.reduce_unchecked(first, near=near) - first
        return replace(resolved, pieces=tuple(replace(piece, q=piece.q + turns) for piece in resolved.pieces))

    def _anywhere(self) -> Vector:
        nodes = self._resolver.first_layer
        return nodes[0] if len(nodes) else self._world.problem.robot.middle

    def _from_elsewhere(self, stepper: Stepper, failure: str) -> Outcome:
        """The motion from any configuration at the path's beginning that the machine can reach."""
        nodes = self._world.problem.robot.reduce_unchecked(self._resolver.first_layer, near=stepper.q)
        transit = find_transit(self._world, stepper, list(nodes))
        if isinstance(transit, str):
            message = f"no motion was found to the beginning of the path: {failure}"
            return Outcome(stepper.trajectory(), "blocked", message)
        along = _Along(
            self._world, self._path, self._resolver, self._cost, transit, self._resolver_within, self._other_ways
        )
        return along.plan(transit.q)

    def _improve(self, resolved: Resolution, begin: Vector | None) -> tuple[list[Stretch | Bypass], LawWay | None]:
        """The pieces, made cheaper where they follow the path; and the law's result, if there is only one piece."""
        pieces, law = list(resolved.pieces), None
        last = len(pieces) - 1
        for index, piece in enumerate(pieces):
            if isinstance(piece, Stretch) and len(piece.q) > 1:
                free_start = index == 0 and begin is None and self._stepper is None
                pieces[index] = cheap = self._cheapen(piece, free_start=free_start, free_end=index == last)
                # the law and other ways only make it cheaper
                if last == 0 and resolved.obstruction is None and not self._world.work.brake.is_used_up():
                    low = float(cheap.stations[0])
                    way = self._world.follow_law(self._path, low, cheap.q[0], time=self._time)
                    if not self._world.apart:  # the law does not know these extra clearances
                        cheap = self._cheaper_than_law(cheap, way, free_start=free_start)
                    if low == 0.0 and not self._world.problem.is_dynamic:
                        timed = self._timed.get(way)
                        law = LawWay(self._path, way, None if timed is None else timed.motion)
                    pieces[index] = self._cheaper_than_others(cheap, piece, free_start=free_start)
        return pieces, law

    def _cheapen(self, piece: Stretch, *, free_start: bool, free_end: bool, roughly: bool = False) -> Stretch:
        world = self._world
        setting: dict[str, Any] = {
            "proximity": world.proximity,
            "time": self._time,
            "free_start": free_start,
            "free_end": free_end,
        }
        if self._cost.objective.is_quadratic:  # its cost is close to that which smoothing lowers
            piece = smooth_stretch(world.problem, self._path, piece, brake=world.work.brake, **setting)
        return cheapen_stretch(
            world.problem, self._path, piece, cost=self._cost, work=world.work, roughly=roughly, **setting
        )

    def _cheaper_than_law(self, piece: Stretch, law: Stretch, *, free_start: bool) -> Stretch:
        """The cheapest of `piece`, the whole path, and the law's resolution from the same joints, also made cheaper.

        A cost has more than one minimum, and the grid may miss the one near the law's resolution. The search minimises
        an approximation of the cost without inertia, so the costs of the motions decide.
        """
        if law.obstruction is not None or (self._cones is not None and not self._cones.motion_holds(law.q)):
            return piece
        costs = self._motion_costs(piece, law)
        # for full poses the graph has all configurations, and lowering the law's cost would take as long again
        if self._path.target(0.0).rotation is None or min(costs, key=costs.__getitem__, default=piece) is law:
            costs |= self._motion_costs(self._cheapen(law, free_start=free_start, free_end=True))
        return min(costs, key=costs.__getitem__, default=piece)

    def _cheaper_than_others(self, best: Stretch, found: Stretch, *, free_start: bool) -> Stretch:
        """The cheapest of `best` and of other ways along the whole path, away from the one `found` by the graph.

        If several dimensions are free, the cost has minima that are far apart, and its value on the coarse graph says
        little about them. So several ways are made cheaper roughly, and the cheapest of these to the end.
        """
        others: list[Stretch] = []
        for _ in range(self._other_ways):
            try:
                way = self._resolver.another(others[-1] if others else found, begins_there=not free_start)
            except OutOfTime:
                break
            if way is None:
                break
            # from the same beginning, in the same turn of its continuous joints
            others.append(way if free_start else Stretch(way.stations, way.q + (found.q[0] - way.q[0])))
        rough = [self._cheapen(way, free_start=free_start, free_end=True, roughly=True) for way in others]
        costs = self._motion_costs(*rough)
        for way in sorted(costs, key=costs.__getitem__)[:_TO_THE_END]:
            costs |= self._motion_costs(self._cheapen(way, free_start=free_start, free_end=True))
        if costs:
            costs |= self._motion_costs(best)
        return min(costs, key=costs.__getitem__, default=best)

    def _motion_costs(self, *ways: Stretch) -> dict[Stretch, float]:
        """The motion costs of those ways on which no joint moves too far from waypoint to waypoint."""
        return {way: self._motion_cost(way) for way in ways if self._keeps_steps([way])}

    def _motion_cost(self, way: Stretch) -> float:
        """The cost of the fastest motion along a stretch, by the objective and in its unit."""
        world, problem = self._world, self._world.problem
        timed = self._timed.get(way)
        if timed is None:
            timed = time_rounded(problem, self._path, way, proximity=world.proximity, time=self._time)
            self._timed[way] = timed
        return motion_cost(problem, timed.motion)

    def _play(self, stepper: Stepper, pieces: Sequence[Stretch | Bypass]) -> None:
        world, problem = self._world, self._world.problem
        for piece in pieces:
            if isinstance(piece, Bypass):
                play(world, stepper, JointPath(piece.q), slowed=self._at_asked_speed)
            elif len(piece.q) > 1:
                timed = self._timed.get(piece)
                if timed is None or problem.is_dynamic:  # later, moving obstacles are elsewhere
                    corners = round_corners(problem, self._path, piece, proximity=world.proximity, time=stepper.time)
                    timed = TimedStretch(*corners)
                if not self._keeps_steps([timed.rounded]):
                    timed = TimedStretch(piece, self._path.corners(SHARP))
                for motion in self._clear_motions(timed, stepper.time):
                    stepper.play(motion)

    def _at_asked_speed(self, detour: Trajectory) -> Trajectory:
        """The motion of a detour, slowed to the speed of the path if it exceeds that within the path's tolerance."""
        problem, task = self._world.problem, self._world.problem.scene.task.path
        assert task is not None
        if task.speed is None or len(detour) < 2:
            return detour
        tips = BatchKinematics(problem.robot).tip_positions(detour.q)
        fast = np.linalg.norm(np.diff(tips, axis=0), axis=1) > task.speed * np.diff(detour.time)
        on_path = np.array([self._path.nearest(tip)[1] <= task.tolerance for tip in tips])
        if not np.any(fast & (on_path[1:] | on_path[:-1])):
            return detour
        return slow_tip(detour, problem.limits, speed=task.speed, robot=problem.robot, drive=drive_of(problem))

    def _clear_motions(self, timed: TimedStretch, time: float) -> Sequence[Trajectory]:
        """The motions along a stretch, each from rest to rest.

        Where the joints turn sharply, for example at the end of a turn on the spot, the smooth curve through the
        samples swings out. If it comes too near to something, samples are inserted between them, which halves the
        swing.
        """
        world, brake = self._world, self._world.work.brake
        screen = ClearanceScreen(world.proximity, time=time, spare=-AT_CLEARANCE)
        stretch, known = timed.rounded, timed.motions
        for denser in range(_MOST_DENSER + 1):
            period = _FINE_PERIOD if self._is_tight(stretch.q, time) else SAMPLE_PERIOD
            motions: Sequence[Trajectory] = known if period == SAMPLE_PERIOD else ()
            if not motions:
                motions = time_stretch(
                    world.problem, self._path, stretch, period=period, stops=timed.stops, brake=brake
                )
            known = ()
            if denser == _MOST_DENSER or brake.is_used_up():
                break
            kept = self._cones is None or all(self._cones.motion_holds(motion.q) for motion in motions)
            if kept and all(screen.keeps_all_unchecked(motion.q) for motion in motions):
                break
            stretch = with_halfways(world.problem, self._path, stretch)
        return motions

    def _is_tight(self, q: Matrix, time: float) -> bool:
        """Whether anything is so near that chords between samples of the usual period might touch it."""
        proximity = self._world.proximity
        floor = proximity.clearance + _ROOM
        return any(bool(np.any(proximity.lower_bounds(joints, time=time, floor=floor)[0] < floor)) for joints in q)

    def _blocked(self, resolved: Resolution, trajectory: Trajectory) -> Outcome:
        assert resolved.obstruction is not None
        why = ", and no detour was found" if self._may_leave else ", and detours are not allowed"
        if not self._may_turn:
            why += ", nor turns on the spot"
        if resolved.gave_up:
            why += f"; none of {resolved.routes:,} routes that were tested leads to its end"
        return blocked_path(trajectory, resolved.obstruction, self._path, why)
