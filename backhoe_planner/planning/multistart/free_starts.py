"""Starts of descents for another cost than the time, chosen by what descents without obstacles make of them.

Straight lines to all postures, then other paces on the way to the best ends: the cost of a motion often depends on
which joint moves first, and no small step leads there from an even pace. An arm that is unfolded after it was lowered
needs little of the work of one that is held out meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Dynamics
from backhoe_planner.motion import Problem
from backhoe_planner.planning.descent.curve import from_rest_to_rest
from backhoe_planner.planning.multistart.free_descents import FreeDescents
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start, StartPrices

LINES_FOR_ONE = 100  # straight lines for each of `Effort.ways_at_once`; chosen
_ENDS_FOR_ONE, _PACES_FOR_ONE = 2, 120  # ends to which other paces are tried, and paces of all of them; chosen
# parts of the motion at which a joint begins and ends its move, of which each joint draws one; a joint moves during
# half of the motion at least; chosen
_BEGINS, _ENDS, _LEAST = (0.0, 0.0, 0.25, 0.5), (0.5, 0.75, 1.0, 1.0), 0.5
_LEAST_PART = 1e-3  # of the joint that is moved hardest, as which every joint counts at least; chosen


def free_starts(
    problem: Problem, lines: Sequence[Start], prices: StartPrices, *, longest: float, ways: int
) -> list[PricedStart]:
    """Starts at which descents without obstacles end, in order of price, without those that are dear.

    The same lines always give the same starts.

    Parameters
    ----------
    lines: straight ones to the ends that may do.
    longest: the time that a motion may take [s].
    ways: see `Effort.ways_at_once`.
    """
    free, rng = FreeDescents(problem, longest=longest), np.random.default_rng(0)
    bent = prices.fair(prices.in_order(free.bent(lines)))
    best = prices.cheapest(bent, _ENDS_FOR_ONE * ways)
    count = _PACES_FOR_ONE * ways // max(len(best), 1)
    paced = [start for one in best for start in with_random_paces(one.start, rng, count)]
    bent += prices.fair(prices.in_order(free.bent(paced)))
    return prices.fair(iter(sorted(bent, key=lambda one: one.price)))


def with_random_paces(start: Start, rng: np.random.Generator, count: int) -> Iterator[Start]:
    """So many straight ways between the ends of a start, on each of which some joints move early and some late."""
    control = start.curve.control
    u = np.linspace(0.0, 1.0, len(control))[:, None]
    for _ in range(count):
        begins = rng.choice(_BEGINS, control.shape[1])
        ends = np.maximum(rng.choice(_ENDS, control.shape[1]), begins + _LEAST)
        part = from_rest_to_rest(np.clip((u - begins) / (ends - begins), 0.0, 1.0))
        yield replace(start, curve=start.curve.moved_to(control[0] + part * (control[-1] - control[0])))


def alike(problem: Problem, q: Matrix) -> Vector:
    """(n,) how far each joint may turn or slide in a second that count alike [rad/s or m/s].

    If torques count in the cost, a joint that moves little mass counts little: the last one of the Panda hardly
    changes a motion. They are then in proportion to the root of the mass that each joint moves in the mean of the
    configurations `q` (K, n); the one that is moved hardest by this has its velocity limit. Otherwise they are the
    velocity limits.
    """
    rate, objective = problem.limits.velocity, problem.objective
    if not (objective.lifts or objective.is_squared_torque):
        return rate
    scene = problem.scene
    dynamics = Dynamics(problem.robot, payload=scene.payload, payload_at=scene.payload_at)
    inertia = np.sqrt(np.mean(np.diagonal(dynamics.mass_matrices(q), axis1=1, axis2=2), axis=0))
    hardest = float(np.max(inertia * rate))
    return np.asarray(hardest / np.maximum(inertia, _LEAST_PART * hardest / rate)) if hardest > 0.0 else rate
