"""Routes that keep a condition that no random sample fulfils by chance, such as a narrow cone of orientations.

Two trees grow towards each other (RRTConnect); every new configuration is projected onto the condition
before it is joined (Berenson et al., Manipulation planning on constraint manifolds, 2009).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.planning.search.first_order import FirstOrder

_STEP = 0.25  # s of the slowest joint in one step; chosen: the projection of a longer step leaves the condition
_AHEAD = 0.2  # part of a step by which it must come nearer; chosen, so that no tree creeps along a limit


class KeptTrees:
    """Two trees of configurations that satisfy conditions.

    Parameters
    ----------
    rate: (n,) by which the joints are weighted [rad/s or m/s].
    limits_at: how the conditions limit a step from a configuration.
    project: a configuration near another one that satisfies the conditions, or None; it counts the work.
    allows: whether the straight motion between two configurations may be used; it counts the work.
    ended: whether to stop.
    """

    def __init__(
        self, *, rate: Vector, project: Callable[[Vector], Vector | None], limits_at: Callable[[Vector], FirstOrder],
        allows: Callable[[Vector, Vector], bool], ended: Callable[[], bool],
    ) -> None:  # fmt: skip
        self._rate, self._project, self._limits_at, self._allows, self._ended = rate, project, limits_at, allows, ended

    def connect(
        self, start: Vector, goals: Sequence[Vector], low: Vector, high: Vector, rng: np.random.Generator
    ) -> Matrix | None:
        """(K, n) corners of a route from `start` to one of `goals`; None if none is found before `ended`.

        Parameters
        ----------
        low, high: (n,) the box of samples [rad or m].
        """
        trees = (_Tree([start], self._rate), _Tree(goals, self._rate))
        forward = True
        while not self._ended():
            one, other = trees if forward else trees[::-1]
            tip = self._grow(one, self._near(one, rng.uniform(low, high)))
            if tip is not None:
                reached = self._grow(other, one.nodes[tip])
                if reached is not None and np.array_equal(other.nodes[reached], one.nodes[tip]):
                    here, there = one.way_to(tip), other.way_to(reached)
                    return np.array(here + there[-2::-1] if forward else there + here[-2::-1])
            forward = not forward
        return None

    def _near(self, tree: _Tree, sample: Vector) -> Vector:
        """A configuration near a sample (n,) that satisfies the conditions, on the side of the tree; or the sample.

        Joints that the conditions hold stay away from a random sample however long the tree grows, and so hide what the
        others gain.
        """
        at = tree.nearest(sample)
        found = self._project(self._along(tree, at, sample - tree.nodes[at]))
        return sample if found is None else found

    def _along(self, tree: _Tree, at: int, step: Vector) -> Vector:
        """The end (n,) of a step from a node, turned so that it satisfies the conditions to first order."""
        limits = tree.limits.get(at)
        if limits is None:
            limits = tree.limits[at] = self._limits_at(tree.nodes[at])
        return tree.nodes[at] + limits.kept_by(step)

    def _grow(self, tree: _Tree, towards: Vector) -> int | None:
        """The last node that was added from the nearest node towards `towards` (n,); None if none was."""
        at = tree.nearest(towards)
        last, left = None, tree.distance(at, towards)
        while not self._ended():
            q = tree.nodes[at]
            if left <= _STEP and self._allows(q, towards):
                return tree.add(towards, at)
            part = min(_STEP / max(left, _STEP), 1.0)
            found = self._project(self._along(tree, at, part * (towards - q)))
            if found is None:
                return last
            now = float(np.max(np.abs(towards - found) / self._rate))
            if now > left - _AHEAD * part * left or not self._allows(q, found):
                return last
            at = last = tree.add(found, at)
            left = now
        return last


class _Tree:
    def __init__(self, roots: Sequence[Vector], rate: Vector) -> None:
        self.nodes = list(roots)
        self.limits: dict[int, FirstOrder] = {}  # of steps from nodes
        self._rate = rate
        self._parents = [-1] * len(self.nodes)
        self._places = np.array(self.nodes) / rate  # of the nodes and of some more, in s of each joint

    def add(self, q: Vector, parent: int) -> int:
        if len(self.nodes) == len(self._places):
            self._places = np.concatenate((self._places, np.empty_like(self._places)))
        self._places[len(self.nodes)] = q / self._rate
        self.nodes.append(q)
        self._parents.append(parent)
        return len(self.nodes) - 1

    def nearest(self, q: Vector) -> int:
        return int(np.argmin(np.abs(self._places[: len(self.nodes)] - q / self._rate).max(axis=1)))

    def distance(self, node: int, q: Vector) -> float:
        return float(np.max(np.abs(self.nodes[node] - q) / self._rate))

    def way_to(self, node: int) -> list[Vector]:
        """The configurations from the root of a node to it."""
        way = []
        while node >= 0:
            way.append(self.nodes[node])
            node = self._parents[node]
        return way[::-1]
