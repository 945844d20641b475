"""Finds the boxes that represent clusters around the links again when they no longer hold all cells that count."""

from __future__ import annotations

import math

from backhoe_planner.arrays import Array, Indices
from backhoe_planner.live.boxes.box_places import MOST_PARTS, Line
from backhoe_planner.live.boxes.cluster_pairs import ClusterPairs
from backhoe_planner.live.braking.braking_path import BrakingPath, JointState, Placements
from backhoe_planner.live.clearance.box_bounds import BoxBounds
from backhoe_planner.live.clearance.pair_bounds import Near
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.machine import Robot

_EVERY = 10  # steps after which boxes are checked again, if none are due; chosen
_AHEAD = 0.15  # m beyond what counts now, within which boxes are found; chosen


class BoxUpkeep:
    """Finds boxes again during the steps of one machine.

    Parameters
    ----------
    robot: the machine.
    check: the check of its braking paths.
    influence: margin within which obstacles act [m].
    """

    def __init__(self, robot: Robot, check: PathCheck, *, influence: float) -> None:
        self._separation, self._bounds, self._joints = check.separation, check.bounds, check.joints
        self._check, self._at, self._influence = check, check.at, influence
        self._box_bounds = BoxBounds(check.separation, check.bounds)
        self._line = Placements(robot, MOST_PARTS + 1)
        self._seen: tuple[JointState | None, int, Line | None] = None, 0, None  # the line that `self._line` holds
        self._due = 0
        self._blocking: ClusterPairs | None = None  # its boxes may have forbidden the last step
        self._in_vain_until = 0  # the step before which boxes that just proved too little are not found again

    def forget(self, *, blocking: bool = False) -> None:
        """Check boxes in the next step, and end a search; with `blocking` also forget which ones forbade a step."""
        self._due = 0
        self._box_bounds.forget()
        if blocking:
            self._blocking = None

    def note(self, near: Near, *, held_back: bool) -> None:
        """Note whether a step was found, or none was because something `held_back` the machine."""
        self._blocking = None
        if held_back:
            pair, _ = self._bounds.tightest(near)
            self._blocking = next((one for one in self._separation.counting_clusters if pair in one.pairs), None)

    def find_for(self, pairs: Indices, state: JointState) -> None:
        """Find the boxes of all links and clusters whose `pairs` (K,) are new or were moved."""
        moved = set(pairs.tolist())
        for one in self._separation.clusters:
            if not moved.isdisjoint(one.pairs.tolist()):
                self._box_bounds.find(one, self._at, reach=self._reach_of(one, state))

    def renew(self, state: JointState, step: int) -> bool:
        """Find the boxes of one link and one cluster again if that is due; those of more if the next step needs them.

        Boxes that can wait are found bit by bit in the following steps, so that none of these takes long.

        False if boxes cannot hold everything that the machine could come near: it has to slow down.
        """
        if self._box_bounds.short and not state.v.any():
            # no path from here keeps what these boxes must keep: only here are they as far away as the cells
            self._find(self._box_bounds.short[0], state)
        elif self._blocking is not None:
            # boxes that were found further away may forbid what the cells allow
            if self._blocking not in self._box_bounds.short or step >= self._in_vain_until:
                self._find(self._blocking, state)
                # while the machine brakes, they prove as little one step later
                self._in_vain_until = step + _EVERY
            self._blocking = None
        elif self._box_bounds.searches:
            self._box_bounds.search_on(self._at, self._path(state))
        if step < self._due:
            return True
        one, urgent = self._most_urgent(state, _EVERY)
        if one is None:
            self._due = step + _EVERY
            return True
        if urgent < math.inf:
            if not (
                self._box_bounds.searches or self._box_bounds.search(one, self._at, reach=self._reach_of(one, state))
            ):
                self._find(one, state)
            self._due = step + _EVERY
            return True
        self._find(one, state)
        self._due = step + 1  # the next step checks whether there are more that cannot wait long
        for _ in self._separation.clusters:
            # of the others, only those that this step or the next one needs cannot wait
            one, urgent = self._most_urgent(state, 1)
            if one is None or urgent < math.inf:
                return True
            self._find(one, state)
        return self._most_urgent(state, 1)[1] < math.inf

    def _path(self, state: JointState) -> BrakingPath:
        """The present braking path."""
        return self._check.path(state.q, state.v, step=False)

    def _find(self, one: ClusterPairs, state: JointState) -> None:
        """Find the boxes of a link and a cluster again."""
        self._box_bounds.find(one, self._at, reach=self._reach_of(one, state), path=self._path(state))

    def _reach_of(self, one: ClusterPairs, state: JointState) -> float:
        """Distance from a link within which the cells of a cluster count [m]."""
        line, T = self._ahead(state, _EVERY)
        way = self._separation.places.way_of(one, T) + float(line.beside[one.classes])
        return float(one.clearance + max(self._influence, way) + _AHEAD)

    def _ahead(self, state: JointState, steps: int) -> tuple[Line, Array]:
        """The line along which the machine goes on in so many steps, and the placements at the ends of its parts.

        The placements' row 0 must already hold the machine.
        """
        before, of_steps, seen = self._seen
        if seen is not None and before is state and of_steps == steps:
            return seen, self._line.T[: len(seen.ends)]
        separation = self._separation
        line = Line.ahead(
            state, self._joints, steps,
            travel=separation.travel, furthest=separation.furthest, turning=separation.turning,
        )  # fmt: skip
        self._line.T[0] = self._at.T[0]
        self._line.place_line(state.q, line.ends[-1] - state.q, len(line.ends) - 1)
        self._seen = state, steps, line
        return line, self._line.T[: len(line.ends)]

    def _most_urgent(self, state: JointState, steps: int) -> tuple[ClusterPairs | None, float]:
        """The link and cluster whose boxes must be found again first if all are to hold for `steps`, and how urgent."""
        separation = self._separation
        one, urgent, line = separation.places.most_urgent(
            state, self._joints, steps, self._at, self._line, self._bounds.known, separation.planes,
            travel=separation.travel, furthest=separation.furthest, turning=separation.turning, near=self._influence,
        )  # fmt: skip
        self._seen = state, steps, line
        return one, urgent
