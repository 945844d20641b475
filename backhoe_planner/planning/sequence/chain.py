"""Chooses the posture at the end of every leg with the later legs in mind.

The postures in which legs may end are the nodes of a layered graph, with a layer for each leg; the motions
between them are its edges, priced by estimates until they are planned. Repeatedly, the cheapest chain is found
and planned as a whole: first with the end of each leg anywhere on the goal that the chain chooses, then, if that
chain is still the cheapest, in exactly the postures of the chain. A motion that cannot be planned is removed
from the graph, so that other ends are tried. The result of planning leg by leg is one of the chains, so the
result is never dearer than that.

Most chains are planned roughly, with less effort, because many are compared and few are kept. What more effort gains is
known from the legs planned one by one both ways, and expected of the other motions too. Then the cheapest chain is
planned anew with all the effort, until no rough one promises more. The work for chains is counted, and bounded by that
for the legs one by one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import Goal, TipPath, motion_cost
from backhoe_planner.planning.search.effort import EFFORTS, Effort, OutOfTime, Work
from backhoe_planner.planning.sequence.ends import LegEnds, WayPrices, find_ends
from backhoe_planner.planning.sequence.leg import DoneLeg, Leg, posture_goal
from backhoe_planner.planning.sequence.leg_planning import LegPlanner
from backhoe_planner.planning.world.world import World

_SAME = 1e-9  # rad or m: rounding; postures nearer than this count as one end
_GAIN = 1e-3  # part of the whole cost by which another chain must be estimated to be better; chosen
_OFF = (0.2, 1.1)  # bounds of the factor on estimates of unplanned motions; chosen: low estimates try more chains
_CALIBRATED = (0.5, 3.0)  # bounds of the factor that corrects estimates between two goals; chosen
_FAILED = 2.0  # factor on the estimates between two goals for each motion that could not be planned; chosen
_NOTHING = 1e-9  # least value of a price, in place of 0
_GAINED = (0.2, 1.0)  # bounds of the factor on the costs of rough motions; chosen
# parts of the counted work of planning the legs one by one: chains are planned roughly until the first of these, and
# with all the effort until the second; chosen
_ROUGH_WORK, _WORK = 0.25, 0.5
# s: the least counted work of which these are parts, for the normal effort: sequences of easy legs have several
# chains then. Chosen on three sequences of four legs (seed 31), one of which is 5 % longer with half of it
_LEAST_WORK = 16.0


@dataclass(frozen=True, eq=False)
class _Way:
    """A planned motion: one edge of the graph; rough if it was planned with less effort only."""

    done: DoneLeg
    cost: float
    is_rough: bool


@dataclass(eq=False)
class _Layer:
    """One leg that moves: its possible ends, and the motions to them.

    Attributes
    ----------
    leg: the leg.
    goals: those on which its ends were looked for, from which the next leg can begin.
    prices: of straight motions.
    known: where it may begin and end; the motion planner chooses the end of the last leg.
    ends: (n,) each.
    names: the goal of each end; None along a path. Empty for the last leg.
    planned: by the indices of the end before and of its own; None if no motion was found.
    free: by the end before, the goal, and whether it was planned roughly, the end of the motion planned to anywhere on
        that goal; None for none.
    estimates: (A, B) costs of the motions that are not planned.
    unit: by which the cost is divided.
    off: factor on the estimates.
    gained: factor on the costs of rough motions, by which more effort is expected to make them cheaper.
    """

    leg: Leg
    goals: tuple[Goal, ...]
    prices: WayPrices
    known: LegEnds
    ends: list[Vector]
    names: list[str | None]
    planned: dict[tuple[int, int], _Way | None] = field(default_factory=dict)
    free: dict[tuple[int, str, bool], int | None] = field(default_factory=dict)
    estimates: Matrix = field(default_factory=lambda: np.zeros((0, 0)))
    unit: float = 1.0
    off: float = 1.0
    gained: float = 1.0

    def place(self, end: int) -> str | None:
        """The name of the goal of an end; None along a path, and if the end is left open."""
        return self.names[end] if end < len(self.names) else None

    def estimate(self, begins: Sequence[Vector]) -> None:
        """Estimate the costs of all motions from `begins`."""
        if not self.known.entries:
            self.estimates = self.prices.between(begins, self.known.ends)
            return
        to_entries = self.prices.between(begins, self.known.entries)
        across = self.prices.between(self.known.entries, self.known.ends)
        self.estimates = np.min(to_entries[:, :, None] + across[None, :, :], axis=1)

    def price(self, way: _Way) -> float:
        """The cost of a planned motion with all the effort: that of a rough one is estimated."""
        return self.gained * way.cost if way.is_rough else way.cost


class Chain:
    """The search for the cheapest chain of motions through all legs.

    Parameters
    ----------
    legs: at least two of them move, and none is among obstacles that move or appear.
    ready: the same legs, from `ready_for_next`: their ends are looked for.
    first: the result of planning leg by leg, as far as it got.
    planner: plans single legs.
    most: how many motions may be planned at most.
    rough: an effort less than that of `planner`, and the result of planning leg by leg with it; None to plan all chains
        with the same effort.
    worked: the counted work of planning leg by leg [s].
    """

    def __init__(
        self, legs: Sequence[Leg], ready: Sequence[Leg], first: Sequence[DoneLeg], planner: LegPlanner, *, most: int,
        rough: tuple[Effort, Sequence[DoneLeg]] | None, worked: float,
    ) -> None:  # fmt: skip
        self._legs, self._ready, self._first, self._left = tuple(legs), tuple(ready), tuple(first), most
        self._most = most
        # legs along paths are planned for many chains, and other ways along them were compared in the first result
        self._fine = replace(planner, effort=replace(planner.effort, other_ways=0))
        self._begun_roughly = () if rough is None else tuple(rough[1])
        self._rough = self._fine if rough is None else replace(planner, effort=replace(rough[0], other_ways=0))
        self._planner, self._begun = self._fine, planner.brake.done
        least = _LEAST_WORK * planner.effort.motions / EFFORTS["normal"].motions
        self._rough_work, self._work = (part * max(worked, least) for part in (_ROUGH_WORK, _WORK))
        self._moving = [index for index, leg in enumerate(legs) if leg.problem.wait is None]
        self._start = first[0].motion.q[0]
        self._layers: list[_Layer] = []
        self._tried: set[tuple[str | None, ...]] = set()  # goals of chains
        self.tried = 0

    def run(self) -> list[DoneLeg]:
        """The cheapest chain that was found, waits included; the first result if none is cheaper."""
        try:
            if not self._build():
                return list(self._first)
        except OutOfTime:
            return list(self._first)
        if self._rough is not self._fine:
            self._plan_chains(self._rough, self._rough_work, estimated=True)
            self._tried.clear()
            self._left = self._most
        self._plan_chains(self._fine, self._work, estimated=False)
        self._plan_chains(self._fine, self._work, estimated=True)
        for layer in self._layers:
            layer.gained = 1.0
        best = self._cheapest(estimated=False)
        return list(self._first) if best is None else self._with_waits(best)

    def _plan_chains(self, planner: LegPlanner, until: float, *, estimated: bool) -> None:
        """Plan the cheapest chain, again and again, until none promises to be cheaper.

        until: the counted work of all motions planned for chains at which this ends [s].
        estimated: whether motions count for which there are only estimates, not even a rough motion.
        """
        self._planner = planner
        while self._left > 0 and not planner.brake.is_used_up() and planner.brake.done - self._begun < until:
            chain = self._cheapest(estimated=estimated)
            if chain is None or not (self._promises(chain) if estimated else self._is_rough(chain)):
                return
            try:
                if not self._plan_chain(chain):
                    return
            except OutOfTime:  # while the ways on from a new end were priced: that end is left out
                return

    # --- the graph --------------------------------------------------------------------

    def _build(self) -> bool:
        """Create the layers, with the first result in them; False if a leg has no possible end.

        Raises
        ------
        OutOfTime: the budget is used up.
        """
        near, effort, brake = self._start, self._planner.effort, self._planner.brake
        for number, index in enumerate(self._moving):
            brake.check()
            leg = self._legs[index]
            world = World(leg.problem.beginning(near), seed=self._planner.seed, work=Work(effort, brake))
            ready = self._ready[index]
            known = find_ends(world, ready, near)
            if known is None and ready is not leg:
                ready, known = leg, find_ends(world, leg, near)
            if known is None:
                return False
            is_last = number == len(self._moving) - 1  # one node, for any end
            ends = list(known.ends[:1] if is_last else known.ends)
            names: list[str | None] = []
            if not is_last:
                names += [goal.name for goal in known.goals] if known.goals else [None] * len(ends)
            self._layers.append(_Layer(leg, ready.problem.goals, WayPrices(world), known, ends, names))
            near = known.ends[0]
        self._estimate()
        self._take_first()
        self._take_rough()
        return True

    def _estimate(self) -> None:
        begins: list[Vector] = [self._start]
        for layer in self._layers:
            layer.estimate(begins)
            if layer is self._layers[-1]:
                layer.estimates = np.min(layer.estimates, axis=1, keepdims=True)
            layer.off = 1.0
            begins = layer.ends

    def _take_first(self) -> None:
        """Add the first result, a chain of planned motions, which shows how far estimates are off."""
        before = 0
        totals: defaultdict[str, float] = defaultdict(float)
        for layer, index in zip(self._layers, self._moving, strict=True):
            name = layer.leg.problem.objective.name
            if index >= len(self._first) or self._first[index].failed:
                open_ = layer.estimates[np.isfinite(layer.estimates)]
                totals[name] += float(np.min(open_, initial=np.inf)) if len(open_) else 0.0
                continue
            done = self._first[index]
            guess = float(np.min(layer.estimates[min(before, len(layer.estimates) - 1)]))
            number = done.certificate.goal
            begun = before
            before, cost = self._note(layer, before, done)
            if number is not None:
                layer.free[begun, done.problem.goals[number - 1].name, False] = before
            layer.off = float(np.clip(cost / max(guess, _NOTHING), *_OFF))
            totals[name] += cost
        for layer in self._layers:
            name = layer.leg.problem.objective.name
            share = sum(other.leg.problem.objective.name == name for other in self._layers)
            layer.unit = max(totals[name], _NOTHING) / share

    def _take_rough(self) -> None:
        """Add the result of planning leg by leg roughly, which shows what more effort gains."""
        before = 0
        for layer, index in zip(self._layers, self._moving, strict=True):
            if index >= len(self._begun_roughly) or self._begun_roughly[index].failed:
                return
            done, begun = self._begun_roughly[index], before
            before, cost = self._note(layer, before, done, is_rough=True)
            if done.certificate.goal is not None:
                layer.free[begun, done.problem.goals[done.certificate.goal - 1].name, True] = before
            if index < len(self._first) and not self._first[index].failed:
                fine = motion_cost(done.problem, self._first[index].motion)
                layer.gained = float(np.clip(fine / max(cost, _NOTHING), *_GAINED))

    def _note(self, layer: _Layer, before: int, done: DoneLeg, *, is_rough: bool = False) -> tuple[int, float]:
        """Add a planned motion; returns the index of its end, and its cost."""
        end, cost = done.motion.q[-1], motion_cost(done.problem, done.motion)
        index = 0
        if layer is not self._layers[-1]:
            index = next((k for k, q in enumerate(layer.ends) if np.max(np.abs(q - end)) < _SAME), len(layer.ends))
            if index == len(layer.ends):
                row = self._row_after(layer, end)  # first, because it may raise an error
                layer.ends.append(end)
                number = done.certificate.goal
                layer.names.append(None if number is None else done.problem.goals[number - 1].name)
                column = np.full((len(layer.estimates), 1), np.inf)
                layer.estimates = np.hstack((layer.estimates, column))
                after = self._layers[self._layers.index(layer) + 1]
                after.estimates = np.vstack((after.estimates, row))
        known = layer.planned.get((before, index))
        is_rough = is_rough and (known is None or known.is_rough)
        best = _Way(done, cost, is_rough) if known is None or cost < known.cost else replace(known, is_rough=is_rough)
        layer.planned[before, index] = best
        return index, cost

    def _row_after(self, layer: _Layer, end: Vector) -> Matrix:
        """(1, B) costs of the motions of the leg after `layer` from a new end (n,) of that layer.

        Raises
        ------
        OutOfTime: the budget is used up.
        """
        after = self._layers[self._layers.index(layer) + 1]
        own = _Layer(after.leg, after.goals, after.prices, after.known, after.ends, after.names)
        own.estimate([end])
        row = own.estimates
        if after is self._layers[-1]:
            return np.asarray(np.min(row, axis=1, keepdims=True))
        missing = after.estimates.shape[1] - row.shape[1]
        return np.hstack((row, np.full((1, missing), np.inf)))

    # --- chains -----------------------------------------------------------------------

    def _weights(self, layer: _Layer, *, estimated: bool) -> Matrix:
        """(A, B) costs of all motions of a leg, as parts of the whole cost."""
        found = layer.off * layer.estimates if estimated else np.full(layer.estimates.shape, np.inf)
        found = found.copy()
        for (a, b), way in layer.planned.items():
            found[a, b] = np.inf if way is None else layer.price(way)
        return np.asarray(found / layer.unit)

    def _cheapest(self, *, estimated: bool) -> list[tuple[int, int]] | None:
        """The cheapest chain, as the indices of the ends before and after each leg; None if there is none."""
        cost, back = np.zeros(1), []
        for layer in self._layers:
            through = cost[:, None] + self._weights(layer, estimated=estimated)
            back.append(np.argmin(through, axis=0))
            cost = np.min(through, axis=0)
        if not np.isfinite(cost[0]):
            return None
        chain, end = [], 0
        for rows in reversed(back):
            chain.append((int(rows[end]), end))
            end = int(rows[end])
        return chain[::-1]

    def _cost(self, chain: Sequence[tuple[int, int]], *, estimated: bool) -> float:
        weights = (self._weights(layer, estimated=estimated) for layer in self._layers)
        return float(sum(matrix[way] for matrix, way in zip(weights, chain, strict=True)))

    def _is_rough(self, chain: Sequence[tuple[int, int]]) -> bool:
        """Whether some motion of a planned chain was planned roughly only."""
        ways = [layer.planned[way] for layer, way in zip(self._layers, chain, strict=True)]
        return any(way is not None and way.is_rough for way in ways)

    def _promises(self, chain: Sequence[tuple[int, int]]) -> bool:
        """Whether a chain may be cheaper than the cheapest known one."""
        best = self._cheapest(estimated=False)
        if best is None:
            return True
        return self._cost(chain, estimated=True) < (1.0 - _GAIN) * self._cost(best, estimated=False)

    def _plan_chain(self, chain: Sequence[tuple[int, int]]) -> bool:
        """Plan the motions of a chain that were not planned with this effort; False if nothing was left to be planned.

        It ends at a motion that cannot be planned.
        """
        is_rough = self._plans_roughly
        places = tuple(layer.place(b) for layer, (_, b) in zip(self._layers, chain, strict=True))
        anywhere = places not in self._tried
        self._tried.add(places)
        before, planned = 0, self.tried
        for layer, (_, b) in zip(self._layers, chain, strict=True):
            if self._left <= 0:
                break
            place = layer.place(b)
            if anywhere and place is not None:
                if (before, place, is_rough) not in layer.free:
                    layer.free[before, place, is_rough] = self._plan(layer, before, b, anywhere=True)
                    self._calibrate(layer, before, place)
                end = layer.free[before, place, is_rough]
            elif self._is_planned(layer, before, b):
                end = None if layer.planned[before, b] is None else b
            else:
                end = self._plan(layer, before, b, anywhere=False)
            if end is None:
                break
            before = end
        return anywhere or self.tried > planned

    @property
    def _plans_roughly(self) -> bool:
        return self._planner is not self._fine

    def _is_planned(self, layer: _Layer, before: int, end: int) -> bool:
        """Whether a motion was planned with the present effort or more, or could not be planned."""
        if (before, end) not in layer.planned:
            return False
        way = layer.planned[before, end]
        return way is None or self._plans_roughly or not way.is_rough

    def _calibrate(self, layer: _Layer, before: int, place: str) -> None:
        """Correct the estimates of all motions between two goals by the cost of a planned one."""
        end = layer.free[before, place, self._plans_roughly]
        rows, columns = self._between_the_same_goals(layer, before, place)
        own = layer.estimates[before, columns]
        least = float(np.min(own[np.isfinite(own)], initial=np.inf))
        if end is None or not np.isfinite(least):
            return
        way = layer.planned[before, end]
        assert way is not None
        factor = float(np.clip(layer.price(way) / max(layer.off * least, _NOTHING), *_CALIBRATED))
        layer.estimates[np.ix_(rows, columns)] *= factor

    def _plan(self, layer: _Layer, a: int, b: int, *, anywhere: bool) -> int | None:
        """Plan one motion from the end `a` of the leg before to the end `b`; the index of its end, None if it failed.

        anywhere: whether it may end anywhere on the goal of `b`, not just at `b`.
        """
        number = self._layers.index(layer)
        own = None if self._moving[0] == 0 else self._start  # only the first leg's problem gives its start
        start = self._layers[number - 1].ends[a] if number else own
        leg, asked = layer.leg, None
        self._left -= 1
        self.tried += 1
        if layer is not self._layers[-1] and leg.motion is None:
            if leg.problem.path is not None:
                asked = _ending_at(leg, layer.ends[b])
            else:
                on = next((goal for goal in layer.goals if goal.name == layer.place(b)), None)
                goal = on if anywhere and on is not None else posture_goal(leg.problem, layer.ends[b])
                asked = replace(leg, problem=replace(leg.problem, goals=(goal,)))
        done = self._planner.plan(leg, start, asked=asked)
        if not anywhere:
            layer.planned.setdefault((a, b), None)
        if done.failed:
            layer.estimates[np.ix_(*self._between_the_same_goals(layer, a, layer.place(b)))] *= _FAILED
            known = layer.planned.get((a, b))
            if known is not None and not self._plans_roughly:  # more effort does not make it cheaper
                layer.planned[a, b] = replace(known, is_rough=False)
            return None
        return self._note(layer, a, done, is_rough=self._plans_roughly)[0]

    def _between_the_same_goals(self, layer: _Layer, before: int, place: str | None) -> tuple[list[int], list[int]]:
        """The ends before a leg on the same goal as `before`, and its own ends on the goal `place`; all if None."""
        number = self._layers.index(layer)
        names = self._layers[number - 1].names if number else [None]
        rows = [k for k, name in enumerate(names) if name == names[before]]
        return rows, [k for k in range(len(layer.ends)) if place is None or layer.place(k) == place]

    def _with_waits(self, chain: Sequence[tuple[int, int]]) -> list[DoneLeg]:
        """The planned legs of a chain, with the waits between them."""
        ways = iter(zip(self._layers, chain, strict=True))
        found: list[DoneLeg] = []
        for leg in self._legs:
            if leg.problem.wait is not None:
                start = found[-1].motion.q[-1] if found else None
                found.append(self._planner.plan(leg, start))
                continue
            layer, way = next(ways)
            planned = layer.planned[way]
            assert planned is not None
            found.append(planned.done)
        return found


def _ending_at(leg: Leg, q: Vector) -> Leg:
    """The same leg along a path, with the pitch of a posture `q` (n,) required at its end if it was free there."""
    problem = leg.problem
    assert problem.path is not None
    last = problem.path.waypoints[-1]
    if not problem.robot.has_pitch or last.rotation is not None:
        return leg
    pitch = float(Kinematics(problem.robot).at(q).pitch)
    waypoints = [*problem.path.waypoints[:-1], last.model_copy(update={"pitch": (pitch, pitch)})]
    numbers = [problem.path.number(index) for index in range(len(waypoints))]
    return replace(leg, problem=replace(problem, path=TipPath(waypoints, numbers=numbers)))
