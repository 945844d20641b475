"""Which pairs of the machine's own collision pieces must keep apart, and why the others need not.

Links overlap at the joints that hold them together, and such pairs say nothing. They are
found by geometry, piece by piece and not body by body: what is fixed to a link (a cab, a
tool) counts as itself. Left out are pieces

    on one body             they never move against each other
    that cannot meet        one joint apart, proven over the joint's whole range
    that touch at the pin   of the joint's own two links, near its axis only; of other links one joint
                            apart that touch over its whole range, near its axis or only grazing
    that touch at the stop  of the joint's own two links, grazing at the ends of its range
    of links that touch     in nearly every posture, two or more joints apart, where the pieces often do

Whatever else may touch somewhere counts.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Matrix
from backhoe_planner.machine.collision_model import geometry_model, travel_bounds
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.shape import shapes

_POSTURES = 60  # a rate of 0.9 is then known to within 0.04 (one standard deviation)
_TOUCHES_BY_CONSTRUCTION = 0.9  # of the postures, or of the joint's range
_PLACES = 41  # over a joint's range; 9 deg of a full turn, and between them it is proven
_HALVINGS = 8  # of the distance between two places, to prove that a pair does not meet there
_PIN_OF_CONTACT = 1.5  # times the distance from the joint at which its links touch anyway: still at the pin
_PIN_OF_LINK = 0.25  # or this part of the smaller link
_STOP = 2  # places at each end of the range: 5 % of it
_TOUCH = 1e-3  # m: nearer is touching; links of machines in use run past each other at 0.2 mm
_SOMETIMES = 0.25  # of the postures in which two pieces touch, of links that touch throughout; less is no pin
_GRAZE = 5e-3  # m of overlap, of convex pieces that approximate two links; what folds into a link goes deeper
_GRAZE_OF_LINK = 0.02  # or this part of the smaller link, where that is less


@dataclass(frozen=True)
class LeftOut:
    """Two links of which some pieces do not count as a pair that must keep apart.

    Attributes
    ----------
    link, other: names of the links, the one further out first.
    touch: whether they touch by construction; else they cannot meet.
    why: in words.
    """

    link: str
    other: str
    touch: bool
    why: str


@dataclass(frozen=True)
class SelfPairs:
    """The pairs of a machine's own pieces.

    Attributes
    ----------
    kept: pairs of indices into `Robot.pieces` that must not touch each other.
    left_out: why the other pairs of links that move against each other need not be looked at.
    """

    kept: tuple[tuple[int, int], ...]
    left_out: tuple[LeftOut, ...]


@lru_cache(maxsize=8)
def self_pairs(robot: Robot, posture: tuple[float, ...] | None = None) -> SelfPairs:
    """The pairs of a machine's pieces that must not touch, and what is left out.

    Deterministic: the postures are seeded.

    Parameters
    ----------
    posture: n joint positions [rad or m], where the machine may stand outside of its joints' ranges:
        they are taken to reach so far.
    """
    beside: list[list[tuple[int, int]]] = [[] for _ in range(robot.n)]  # on the bodies that this joint joins
    beyond: list[tuple[int, int]] = []
    for a, first in enumerate(robot.pieces):
        for b, second in enumerate(robot.pieces[a + 1 :], start=a + 1):
            # the one further out is named first
            pair = (a, b) if first.joint > second.joint else (b, a)
            apart = abs(first.joint - second.joint)
            if apart == 1:
                beside[robot.pieces[pair[0]].joint - 1].append(pair)
            elif apart > 1:
                beyond.append(pair)
    reasons = _reasons_beyond(robot, beyond)
    for joint, pairs in enumerate(beside):
        reasons.update(_reasons_beside(robot, joint, pairs, None if posture is None else posture[joint]))
    kept = sorted(pair for pair in (*beyond, *(p for pairs in beside for p in pairs)) if pair not in reasons)
    left_out = dict.fromkeys(LeftOut(*_links(robot, pair), *reason) for pair, reason in sorted(reasons.items()))
    return SelfPairs(tuple(kept), tuple(left_out))


def _links(robot: Robot, pair: tuple[int, int]) -> tuple[str, str]:
    return robot.pieces[pair[0]].link, robot.pieces[pair[1]].link


def _reasons_beyond(robot: Robot, pairs: list[tuple[int, int]]) -> dict[tuple[int, int], tuple[bool, str]]:
    """Why pairs of pieces that two or more joints lie between are left out; without those that are not."""
    model = geometry_model(robot)
    for a, b in pairs:
        model.addCollisionPair(pin.CollisionPair(a, b))
    data, geometry = robot.model.createData(), model.createData()
    rng = np.random.default_rng(0)
    touches: Counter[tuple[str, str]] = Counter()
    pieces: Counter[tuple[int, int]] = Counter()
    for _ in range(_POSTURES if pairs else 0):
        pin.computeCollisions(robot.model, data, model, geometry, robot.random_q(rng), False)
        results = zip(pairs, geometry.collisionResults, strict=True)
        hit = [pair for pair, result in results if result.isCollision()]
        pieces.update(hit)
        touches.update({_links(robot, pair) for pair in hit})
    return {
        pair: (True, f"touch in {touches[links]} of {_POSTURES} postures")
        for pair in pairs
        if touches[links := _links(robot, pair)] >= _TOUCHES_BY_CONSTRUCTION * _POSTURES
        and pieces[pair] >= _SOMETIMES * _POSTURES
    }


def _reasons_beside(
    robot: Robot, joint: int, pairs: list[tuple[int, int]], stands_at: float | None
) -> dict[tuple[int, int], tuple[bool, str]]:
    """The same for pieces on the two bodies that `joint` (index) joins; see `self_pairs` for where it `stands_at`."""
    if not pairs:
        return {}
    sweep = _Sweep(robot, joint, pairs, stands_at)
    name, its_own = robot.joint_names[joint], _own_links(robot, joint)
    by_links: defaultdict[tuple[str, str], list[int]] = defaultdict(list)
    for row, pair in enumerate(pairs):
        by_links[_links(robot, pair)].append(row)
    reasons: dict[tuple[int, int], tuple[bool, str]] = {}
    for links, rows in by_links.items():
        own = set(links) == its_own
        touching = sweep.distance[:, rows] <= _TOUCH
        throughout = np.mean(touching.any(axis=1)) >= _TOUCHES_BY_CONSTRUCTION
        size = sweep.size(rows)
        pin_radius = sweep.pin_radius(rows, size) if throughout else _PIN_OF_LINK * size
        graze = min(_GRAZE, _GRAZE_OF_LINK * size)
        for row in rows:
            if sweep.never_meets(row):
                reasons[pairs[row]] = False, f"cannot meet over the range of {name}"
            elif (throughout or own) and sweep.touches_within(row, pin_radius, graze if throughout else 0.0):
                reasons[pairs[row]] = True, f"touch at {name}"
            elif own and sweep.grazes_at_the_ends(row, graze):
                reasons[pairs[row]] = True, f"touch at the stop of {name}"
    return reasons


def _own_links(robot: Robot, joint: int) -> set[str]:
    """The two links that a joint (index) joins in the URDF."""
    described = robot.urdf.joints[robot.joint_names[joint]]
    return {str(described.parent), str(described.child)}


class _Sweep:
    """Pairs of pieces on the two bodies that one joint joins, over the joint's range.

    Attributes
    ----------
    distance: (S, P) signed distances at S places of the joint [m].
    from_pin: (S, P) where the pieces come nearest: how far from a hinge's axis, or from the origin of a slide [m].
    """

    def __init__(self, robot: Robot, joint: int, pairs: list[tuple[int, int]], stands_at: float | None) -> None:
        self._robot, self._joint, self._pairs = robot, joint, pairs
        self._model = geometry_model(robot)
        for a, b in pairs:
            self._model.addCollisionPair(pin.CollisionPair(a, b))
        self._data, self._geometry = robot.model.createData(), self._model.createData()
        for request in self._geometry.distanceRequests:
            shapes.prepare(request)
        self._travel = travel_bounds(robot)[[outer for outer, _ in pairs], joint]
        lower, upper = robot.limits.lower[joint], robot.limits.upper[joint]
        if not (np.isfinite(lower) and np.isfinite(upper)):
            lower, upper = -np.pi, np.pi
        if stands_at is not None:
            lower, upper = min(lower, stands_at), max(upper, stands_at)
        if not robot.prismatic[joint]:
            upper = min(upper, lower + 2.0 * np.pi)  # then all comes again
        self._places = np.linspace(lower, upper, _PLACES)
        measured = [[self._measure(row, place) for row in range(len(pairs))] for place in self._places]
        self.distance: Matrix = np.array([[distance for distance, _ in row] for row in measured])
        self.from_pin: Matrix = np.array([[away for _, away in row] for row in measured])

    def _measure(self, row: int, place: float) -> tuple[float, float]:
        """Signed distance of a pair with the joint at `place`, and how far from the joint that is [m]."""
        robot, joint = self._robot, self._joint
        q = robot.middle.copy()
        q[joint] = place
        pin.updateGeometryPlacements(robot.model, self._data, self._model, self._geometry, q)
        result = shapes.measure(self._model, self._geometry, row)
        away = self._data.oMi[joint + 1].actInv(0.5 * (result.getNearestPoint1() + result.getNearestPoint2()))
        if not robot.prismatic[joint]:
            away -= (away @ robot.joint_axes[joint]) * robot.joint_axes[joint]
        return result.min_distance, float(np.linalg.norm(away))

    def size(self, rows: list[int]) -> float:
        """Of the two links of these pairs, how far the smaller one reaches from the joint's origin [m]."""
        sizes: defaultdict[str, float] = defaultdict(float)
        for row in rows:
            for index in self._pairs[row]:
                link = self._robot.pieces[index].link
                sizes[link] = max(sizes[link], self._reach(index))
        return min(sizes.values())

    def pin_radius(self, rows: list[int], size: float) -> float:
        """Up to where from the joint's axis two links of `size` [m] that touch throughout do so by construction [m]."""
        touching = self.distance[:, rows] <= _TOUCH
        nearest = np.where(touching, self.from_pin[:, rows], np.inf).min(axis=1)
        return max(_PIN_OF_CONTACT * float(nearest[np.isfinite(nearest)].max()), _PIN_OF_LINK * size)

    def _reach(self, index: int) -> float:
        """How far a piece reaches from the joint's origin, with the joint at 0 [m]."""
        piece, joint = self._robot.pieces[index], self._joint + 1
        origin = 0.0 if piece.joint == joint else self._robot.model.jointPlacements[joint].translation
        return float(np.linalg.norm(piece.piece.hull - origin, axis=1).max()) + piece.piece.radius

    def touches_within(self, row: int, radius: float, graze: float) -> bool:
        """Whether a pair was seen to touch, and near the joint only, over nearly all of its range, or hardly at all.

        Parameters
        ----------
        radius: from the joint's axis [m].
        graze: overlap that does not count [m].
        """
        touching = self.distance[:, row] <= _TOUCH
        if not np.any(touching):
            return False  # they meet between two places, if anywhere
        if np.mean(touching) >= _TOUCHES_BY_CONSTRUCTION:
            return True
        near = np.all(self.from_pin[touching, row] <= radius) or np.all(self.distance[:, row] > -graze)
        return bool(near) and self._keeps_apart_elsewhere(row)

    def grazes_at_the_ends(self, row: int, graze: float) -> bool:
        """Whether a pair touches only at the ends of the joint's range, and overlaps there by less than `graze` [m]."""
        distance = self.distance[:, row]
        at_ends = np.any(distance <= _TOUCH) and np.all(distance[_STOP:-_STOP] > _TOUCH)
        return bool(at_ends and np.all(distance > -graze)) and self._keeps_apart_elsewhere(row)

    def never_meets(self, row: int) -> bool:
        """Whether it is proven that a pair keeps apart over the joint's whole range."""
        return bool(np.all(self.distance[:, row] > _TOUCH)) and self._keeps_apart_elsewhere(row)

    def _keeps_apart_elsewhere(self, row: int) -> bool:
        """The same between all neighbouring places at neither of which it touches."""
        places, distance = self._places, self.distance[:, row]
        ends = zip(places, places[1:], distance, distance[1:], strict=False)
        return all(self._apart(row, *end) for end in ends if min(end[2:]) > _TOUCH)

    def _apart(self, row: int, a: float, b: float, d_a: float, d_b: float, halvings: int = _HALVINGS) -> bool:
        """The same between the places `a` and `b`, where the pair is `d_a` and `d_b` [m] apart."""
        if d_a + d_b > (b - a) * self._travel[row]:
            return True
        if halvings == 0:
            return False
        middle = 0.5 * (a + b)
        d_m, _ = self._measure(row, middle)
        return (
            d_m > _TOUCH
            and self._apart(row, a, middle, d_a, d_m, halvings - 1)
            and self._apart(row, middle, b, d_m, d_b, halvings - 1)
        )
