"""Tests whether boxes of configurations miss a goal, from the goal's features.

For any direction w in the space of the features, a configuration in the box around c is on the goal only if

    w . (J d + d^T H d / 2) >= w . error - sum_g |w_g| slack_g,    d = q - c.

The left side is bounded joint by joint, exactly except for the products of two joints.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.native import compiled
from backhoe_planner.proof.goal_features import Features

_STEPS = 3  # of the descent to a direction; chosen: more steps cost more time than they save in boxes
_DAMPING = 1e-3  # part of the mean square of the derivatives; chosen, keeps the equations solvable
_LEAST_SHARE = 1e-3  # of a joint in its own row; if it is less, the row does not bound the joint; chosen
_TINY = 1e-300  # keeps quotients finite


def best_directions(features: Features, low: Matrix, high: Matrix) -> Matrix:
    """(B, m) directions along which boxes low .. high (B, n) around their middles are likely to miss the goal.

    The direction is the gradient of the squared error, relative to its uncertainty, where this error is least within
    the box. The test is valid for any direction. The direction is 0 if the first order alone reaches the goal.
    """
    half = np.maximum(np.maximum(-low, high), 0.0)
    bend = 0.5 * np.einsum("bmij,bi,bj->bm", np.abs(features.H), half, half)
    unsure = _lengths(features, bend) + features.slack
    weight = (1.0 / unsure**2)[:, features.group]
    square = half * half
    step = square / np.maximum(np.einsum("bmn,bn,bm->b", features.J**2, square, weight), _TINY)[:, None]
    x = np.zeros_like(low)
    for turn in range(_STEPS + 1):
        x = np.minimum(np.maximum(x, low), high)
        off = features.error - np.einsum("bmn,bn->bm", features.J, x)
        size = _lengths(features, off)
        with np.errstate(invalid="ignore"):
            left = np.where(size > features.slack, 1.0 - features.slack / np.maximum(size, _TINY), 0.0)
        w = weight * off * left[:, features.group]
        if turn < _STEPS:
            x = x + step * np.einsum("bmn,bm->bn", features.J, w)
    return np.asarray(w)


class Quadratic:
    """g . d + d^T h d / 2 over boxes, with g (B, n) and h (B, n, n)."""

    def __init__(self, g: Matrix, h: Array) -> None:
        self._g, self._own, self._across = g, np.einsum("bii->bi", h), np.abs(h)
        with np.errstate(divide="ignore", invalid="ignore"):
            self._top = np.where(self._own < 0.0, -g / self._own, np.inf)

    def greatest(self, low: Matrix, high: Matrix) -> Vector:
        """(B,) an upper bound on low <= d <= high (B, n)."""
        g, own, top = self._g, self._own, self._top
        found = np.maximum((g + 0.5 * own * low) * low, (g + 0.5 * own * high) * high)
        inside = (top > low) & (top < high)
        found = np.where(inside, 0.5 * g * np.where(inside, top, 0.0), found).sum(axis=1)
        size = np.maximum(np.abs(low), np.abs(high))
        across = np.einsum("bij,bi,bj->b", self._across, size, size) - np.einsum("bi,bi->b", np.abs(own), size * size)
        return np.asarray(found + 0.5 * across)


class DirectionTest:
    """The test along one direction w (B, m) of every box."""

    def __init__(self, features: Features, w: Matrix) -> None:
        g, h = np.einsum("bm,bmn->bn", w, features.J), np.einsum("bm,bmij->bij", w, features.H)
        self._left = Quadratic(g, h)
        lengths = _lengths(features, w)
        with np.errstate(invalid="ignore"):
            slack = np.where(lengths > 0.0, lengths * features.slack, 0.0).sum(axis=1)
        self._needed = np.einsum("bm,bm->b", w, features.error) - slack

    def misses(self, low: Matrix, high: Matrix) -> Flags:
        """(B,) whether no configuration with low <= d <= high (B, n), within the box, is on the goal."""
        return np.asarray(self._left.greatest(low, high) < self._needed)


@compiled
def missed_up_to(
    error: Matrix, J: Array, H: Array, slack: Matrix, group: Indices, middle: Matrix, lower: Matrix, upper: Matrix,
    furthest_down: Matrix, furthest_up: Matrix, known: Indices, /,
) -> Indices:  # fmt: skip
    """(B,) the highest level found up to which no reachable configuration of a box is on the goal.

    Parameters
    ----------
    error, J, H, slack, group, middle: of the `Features` over the boxes lower .. upper (B, n) [rad or m].
    furthest_down, furthest_up: (L + 1, n) all that is reached at each level.
    known: (B,) such levels that are known, less than L.
    """
    features = Features(middle, error, J, H, slack, group)

    def ends(level: Indices) -> tuple[Matrix, Matrix]:
        return np.maximum(lower, furthest_down[level]) - middle, np.minimum(upper, furthest_up[level]) - middle

    missed = known
    test = DirectionTest(features, best_directions(features, *ends(missed + 1)))
    level = np.full(len(known), len(furthest_down) - 1)
    reached = level + 1  # the lowest level at which a box is not known to miss
    while (reached - missed > 1).any():
        going = reached - missed > 1
        misses = test.misses(*ends(level))
        missed = np.where(going & misses, level, missed)
        reached = np.where(going & ~misses, level, reached)
        level = (missed + reached) // 2
    return np.array(missed)


@compiled
def contracted(
    error: Matrix, J: Array, H: Array, slack: Matrix, group: Indices, half: Matrix, /
) -> tuple[Matrix, Matrix]:
    """(B, n), (B, n) bounds of d on the goal, in boxes of half widths `half` (B, n).

    For each joint they follow from the direction that depends least on the other joints. The lower bound is above
    the upper one if no configuration in the box is on the goal. The other arguments are those of the `Features`.
    """
    n = half.shape[1]
    known = np.isfinite(slack)
    rows = known[:, group]
    slack, error = np.where(known, slack, 0.0), np.where(rows, error, 0.0)
    J = np.where(rows[:, :, None], J, 0.0)
    scaled = J * half[:, None, :]
    square = np.swapaxes(scaled, 1, 2) @ scaled
    square[:, range(n), range(n)] += _DAMPING * np.einsum("bii->b", square)[:, None] / n + _TINY
    W = np.linalg.solve(square, np.swapaxes(scaled, 1, 2))  # (B, n, m)
    g = W @ J
    h = (W @ H.reshape(len(W), -1, n * n)).reshape(-1, n, n, n)
    lengths = np.stack([np.sqrt((W[:, :, group == k] ** 2).sum(axis=2)) for k in range(slack.shape[1])], axis=2)
    wide = (lengths * slack[:, None, :]).sum(axis=2)
    middle = np.einsum("bjm,bm->bj", W, error)
    squared = half * half
    own = 0.5 * np.einsum("bjii->bji", h) * squared[:, None, :]
    across = 0.5 * np.einsum("bjik,bi,bk->bj", np.abs(h), half, half) - np.abs(own).sum(axis=2)
    part = np.abs(g) * half[:, None, :]
    share = np.einsum("bjj->bj", g)
    others = part.sum(axis=2) - np.einsum("bjj->bj", part) + across + wide
    with np.errstate(divide="ignore", invalid="ignore"):
        least = (middle - others - np.maximum(own, 0.0).sum(axis=2)) / share
        most = (middle + others - np.minimum(own, 0.0).sum(axis=2)) / share
    says = share * half > _LEAST_SHARE
    return np.where(says, np.maximum(least, -half), -half), np.where(says, np.minimum(most, half), half)


def bends(features: Features, half: Matrix) -> Matrix:
    """(B, n) each joint's part of the second order plus a fifth of its part of the first, for half widths `half`.

    Halving a box in the joint with the largest value improves the tests most; chosen by trial.
    """
    second = np.einsum("bmij,bj->bi", np.abs(features.H), half)
    return np.asarray(half * (second + 0.2 * np.abs(features.J).sum(axis=1)))


def _lengths(features: Features, vectors: Matrix) -> Matrix:
    """(B, g) the length of each group of `vectors` (B, m)."""
    groups = range(features.slack.shape[1])
    return np.stack([np.sqrt((vectors[:, features.group == k] ** 2).sum(axis=1)) for k in groups], axis=1)
