"""The way back out of what is closer than allowed already.

What is measured. Of every obstacle (and of the machine with itself) the deepest violation

    V = max over its violated pairs of (clearance - distance)

This V falls at every step, as fast as the joints can make it fall, up to a speed that
dies away with it. A pair that is less deep may meanwhile become deeper, never deeper
than V: several links that stick in one obstacle need not leave it by the same side, and
what would hold each of them to its own depth would hold them all.

    max t   s.t.   g_i v + t <= k (V - depth_i)   for every corner of every violated pair

over the joint rates within reach in this step; g_i is how fast a corner's gap falls.
The term with k lets what is far from being the deepest go its way, and takes hold of
it gradually, so that no row enters with a jump. Of all the best velocities the one
nearest to the wish is taken.

Where no joint rate makes V smaller, t is 0: the machine is pinched, and V stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray

from backhoe_planner.redundancy.braking_path import MOST_PARTS, BrakingPath, Placements
from backhoe_planner.redundancy.proof import Proof
from backhoe_planner.redundancy.separation import Separation

__all__ = ["Recovery", "Step", "Way", "way_back"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]

_ATTEMPTS = 3
_BLENDS = (0.5, 0.2)
_RECOVERY = 1.0  # 1/s
_SLOWEST_RECOVERY, _FASTEST_RECOVERY = 0.02, 0.25  # m/s
_HOLDS = 2.0  # 1/s: how soon what is not the deepest is taken hold of
_INSIDE_SPEED = 0.5  # m/s
_FALLS = 1e-8  # m: by so much at least the deepest violation falls in a step
_STEP_END = MOST_PARTS + 1  # row of the placements
_WISH = 1e-3  # weight of the wish beside the speed of the way back
_SOFT, _HARD = 8, 0  # daqp's senses
_UNBOUNDED = -1e30
_SMALLEST = 1e-12


@dataclass(frozen=True)
class Step:
    """What the way back has to know of the step that is to be taken.

    Attributes
    ----------
    q, v: (n,) where the joints are, and their velocity.
    low, high: (n,) the velocities within reach, see `Recovery.slowed`.
    target, brake: (n,) the velocity that is wished, and the one that brakes.
    soft_rows, soft_bounds: (S, n), (S,) `row @ v <= bound`, of what comes nearer.
    path: the braking path of a velocity.
    prove: what is known of that path for all pairs that are not violated and could bind;
        it fills the placements with the path where there are any.
    rows: rows and bounds that keep what such a path did not.
    """

    q: Vector
    v: Vector
    low: Vector
    high: Vector
    target: Vector
    brake: Vector
    soft_rows: Matrix
    soft_bounds: Vector
    path: Callable[[Vector], BrakingPath]
    prove: Callable[[BrakingPath], Proof]
    rows: Callable[[BrakingPath, Proof], tuple[Matrix, Vector]]


@dataclass(frozen=True)
class Way:
    """A velocity that leads out, with what was measured and proven of it.

    Attributes
    ----------
    level: (K,) of every violated pair, how deep its obstacle's deepest will be [m].
    """

    path: BrakingPath
    proof: Proof
    level: Vector


class Recovery:
    """The way back of one machine.

    Parameters
    ----------
    separation, at: what is measured with; working memory of the servo.
    dt: length of a step [s].
    change: (n,) by how much a velocity may change in a step.
    """

    def __init__(self, separation: Separation, at: Placements, dt: float, change: Vector) -> None:
        self._separation, self._at, self._dt, self._change = separation, at, dt, change
        # no point moves faster than this by one joint while the machine is inside something
        self._slow = np.array([_INSIDE_SPEED / max(radius, 0.1) for radius in separation.furthest])

    def slowed(self, v: Vector, low: Vector, high: Vector) -> tuple[Vector, Vector]:
        """(n,), (n,) bounds so slow that little lies between what is measured of a braking path."""
        up, down = v + self._change, v - self._change
        low = np.minimum(np.maximum(np.maximum(low, -self._slow), down), up)
        high = np.minimum(np.maximum(np.minimum(high, self._slow), down), up)
        return low, high

    def choose(self, pairs: Indices, step: Step) -> tuple[Vector, Way | None]:
        """How deep the violated pairs are (K,) [m], and how their deepest falls fastest, measured where that leads.

        The violated pairs are measured where the step ends and along its braking path.
        Where the linear rows promised more than that, what was found there is one more
        row (a cutting plane), and the velocity is asked for anew.
        """
        at, separation = self._at, self._separation
        owner = separation.owner[pairs]
        distance, rows = separation.gradients(pairs, at, 0)
        depth = separation.clearance[pairs] - distance
        deepest = _by_owner(depth, owner)
        fastest = min(max(_RECOVERY * float(deepest.max()), _SLOWEST_RECOVERY), _FASTEST_RECOVERY)
        slack = _HOLDS * (deepest - depth)
        soft_rows, soft_bounds = step.soft_rows, step.soft_bounds
        tried = step.brake
        all_rows, all_slack = rows, slack
        for attempt in range(_ATTEMPTS + len(_BLENDS)):
            if attempt < _ATTEMPTS:
                found = way_back(
                    all_rows, all_slack, target=step.target, low=step.low, high=step.high,
                    fastest=fastest, soft_rows=soft_rows, soft_bounds=soft_bounds,
                )  # fmt: skip
                if found is None:
                    continue
                v = tried = found[0]
            else:
                v = step.brake + _BLENDS[attempt - _ATTEMPTS] * (tried - step.brake)
            path = step.path(v)
            proof = step.prove(path)
            if len(proof.bound) == 0:
                path.place(at)
            at.place(_STEP_END, step.q + v * self._dt)
            falls, before = True, deepest - _FALLS
            ends = [
                (_STEP_END, self._dt),
                *((part, path.look * part / path.parts) for part in range(1, path.parts + 1)),
            ]
            for sample, span in ends:
                there, cuts = separation.gradients(pairs, at, sample)
                deep = separation.clearance[pairs] - there
                now = _by_owner(deep, owner)
                worse = deep > np.maximum(before, 0.0)
                # still falling there, so that it falls all the way, braking too
                worse |= (deep > np.maximum(now - _FALLS, 0.0)) & (cuts @ v >= 0.0)
                if sample == _STEP_END:
                    level = now
                before = now
                if worse.any():
                    falls = False
                    more = slack[worse] + (there - distance)[worse] / span + cuts[worse] @ v
                    all_rows, all_slack = np.vstack((all_rows, cuts[worse])), np.append(all_slack, more)
                    break
            if falls and proof.stands_clear and (proof.clear or attempt == _ATTEMPTS - 1):
                return depth, Way(path, proof, level)
            if not proof.clear:
                more_rows, bounds = step.rows(path, proof)
                # nothing may be asked for that the way back could not give
                soft_rows = np.vstack((soft_rows, more_rows))
                soft_bounds = np.append(soft_bounds, np.maximum(bounds, 0.0))
        return depth, None

    def out(self, pairs: Indices, way: Way) -> tuple[Indices, Vector]:
        """Those of the pairs that keep their clearance again along the way's braking path, and the proven distance."""
        separation = self._separation
        pairs = pairs[way.level <= 0.0]
        if len(pairs) == 0:
            return pairs, np.zeros(0)
        bound, _ = separation.least_on(pairs, way.path, self._at, 0.0)
        for row in (bound < separation.clearance[pairs]).nonzero()[0].tolist():
            bound[row] = max(bound[row], separation.closer_look(int(pairs[row]), way.path, self._at, 0.0))
        kept = bound >= separation.clearance[pairs]
        return pairs[kept], bound[kept]


def way_back(
    rows: Matrix,
    slack: Vector,
    *,
    target: Vector,
    low: Vector,
    high: Vector,
    fastest: float,
    soft_rows: Matrix,
    soft_bounds: Vector,
) -> tuple[Vector, float] | None:
    """The velocity by which the deepest violation falls fastest, and how fast that is [m/s].

    Parameters
    ----------
    rows: (R, n) how fast the gaps of the violated pairs' corners fall with the joints [m/rad].
    slack: (R,) k (V - depth) [m/s].
    target: (n,) the velocity that is wished.
    low, high: (n,) what the joints can do in this step.
    fastest: speed that is enough [m/s].
    soft_rows, soft_bounds: (S, n), (S,) `row @ v <= bound` for everything else.

    None where the solver fails.
    """
    n, hard, soft = len(target), len(slack), len(soft_bounds)
    # in parts of what the joints can change, so that a start from rest is as exact as any other
    middle, reach = 0.5 * (low + high), np.maximum(0.5 * (high - low), _SMALLEST)
    A = rows * reach
    scale = max(float(np.abs(A).sum(axis=1).max()), _SMALLEST)
    B = soft_rows * reach
    size = np.maximum(np.abs(B).sum(axis=1), _SMALLEST)
    constraints = np.zeros((hard + soft, n + 1))
    constraints[:hard, :n], constraints[:hard, n] = A / scale, 1.0
    constraints[hard:, :n] = B / size[:, None]
    upper = np.concatenate(
        (
            np.ones(n),
            [fastest / scale],
            (slack - rows @ middle) / scale,
            (soft_bounds - soft_rows @ middle) / size,
        )
    )
    lower = np.full(n + 1 + hard + soft, _UNBOUNDED)
    lower[:n] = -1.0
    sense = np.full(n + 1 + hard + soft, _HARD, dtype=np.int32)
    sense[n + 1 + hard :] = _SOFT
    wished = np.minimum(np.maximum((target - middle) / reach, -1.0), 1.0)
    f = np.append(-_WISH * wished, -1.0)
    x, _, flag, _ = daqp.solve(_WISH * np.eye(n + 1), f, constraints, upper, lower, sense)
    if flag < 1 or not np.isfinite(x).all():
        return None
    return np.minimum(np.maximum(middle + reach * x[:n], low), high), float(x[n] * scale)


def _by_owner(depth: Vector, owner: Indices) -> Vector:
    """(K,) of every pair the deepest of its obstacle."""
    deepest = np.zeros(len(depth))
    for number in set(owner.tolist()):
        own = owner == number
        deepest[own] = depth[own].max()
    return deepest
