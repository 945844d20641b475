"""Which pairs are measured, and how far a machine's own pieces can travel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import LinkPiece, Robot, reach_ball, self_pairs, self_pieces, tracking_room, travel_bounds
from backhoe_planner.site.distances.cluster_distances import ClusterDistances
from backhoe_planner.site.obstacles import Obstacle
from backhoe_planner.site.obstruction import Pair

REPORTED = 10.0  # m: an obstacle whose margin is always above this is not reported; chosen, beyond a machine's reach


def obstacles_in_reach(robot: Robot, obstacles: Sequence[Obstacle]) -> tuple[Obstacle, ...]:
    """The obstacles that move, or that some posture can bring within `REPORTED` of their clearances, in their order.

    What is left out lies beyond the ball that no part of the machine leaves, at any angles. A machine with slides has
    no such ball outside of its limits: all obstacles are kept.
    """
    if robot.prismatic.any() or not obstacles:
        return tuple(obstacles)
    anywhere = (np.inf,) * robot.n
    centre, radius = ball_within(robot, anywhere)
    off_plan = 0.0 if robot.tube is None else float((travel_of_pieces(robot, anywhere) @ robot.tube.joints).max())
    low, high = np.array([obstacle.bounds for obstacle in obstacles]).swapaxes(0, 1)
    away = np.linalg.norm(np.maximum(np.maximum(low - centre, centre - high), 0.0), axis=1) - radius
    clearance = np.array([obstacle.clearance for obstacle in obstacles])
    moves = np.array([obstacle.velocity for obstacle in obstacles]).any(axis=1)
    kept = moves | (away < REPORTED + clearance + off_plan)
    return tuple(obstacle for obstacle, near in zip(obstacles, kept.tolist(), strict=True) if near)


def list_pairs(
    robot: Robot, obstacles: Sequence[Obstacle], pieces: Sequence[LinkPiece], clusters: ClusterDistances, *, own: bool
) -> tuple[list[Pair], list[int], list[int]]:
    """The pairs of convex pieces, then those with clusters; the index of each one's obstacle, and of its other piece.

    Parameters
    ----------
    pieces: of the machine, those of `robot.pieces` first.
    own: whether pairs of the machine's own parts are measured too; their index of an obstacle is -1.
    """
    pairs: list[Pair] = []
    owner: list[int] = []
    second: list[int] = []
    for index, obstacle in enumerate(obstacles):
        rows = robot.pieces_of(obstacle.links)
        each = [Pair(robot.pieces[row].link, "obstacle", obstacle.name, row, obstacle.clearance) for row in rows]
        for part in range(len(obstacle.pieces)):
            pairs += each
            owner += [index] * len(rows)
            second += [part] * len(rows)
    for outer, inner in self_pairs(robot).kept if own else ():
        pairs.append(Pair(pieces[outer].link, "machine", pieces[inner].link, outer, 0.0))
        owner.append(-1)
        second.append(inner)
    for index, row in zip(clusters.owner.tolist(), clusters.piece.tolist(), strict=True):
        obstacle = obstacles[index]
        pairs.append(Pair(robot.pieces[row].link, "obstacle", obstacle.name, row, obstacle.clearance))
        owner.append(index)
        second.append(0)
    return pairs, owner, second


def with_tracking_room(
    robot: Robot, pairs: Sequence[Pair], pieces: Sequence[LinkPiece], travel: Matrix
) -> tuple[Pair, ...]:
    """The pairs with clearances enlarged by the machine's tracking error; see `tracking_room`."""
    if robot.tube is None:
        return tuple(pairs)
    room = tracking_room(robot, [pieces[pair.piece] for pair in pairs], travel)
    return tuple(
        replace(pair, clearance=pair.clearance + more, tracking=more) if more else pair
        for pair, more in zip(pairs, room.tolist(), strict=True)
    )


@lru_cache(maxsize=16)
def ball_within(robot: Robot, run_out: tuple[float, ...]) -> tuple[Vector, float]:
    """`reach_ball` with slides extended no further than `run_out` (n): centre (3,) and radius [m], world."""
    centre, radius = reach_ball(robot, np.array(run_out))
    centre.setflags(write=False)
    return centre, radius


@lru_cache(maxsize=16)
def travel_of_pieces(robot: Robot, run_out: tuple[float, ...]) -> Matrix:
    """(K, n) `travel_bounds` of the K pieces of `self_pieces`, with slides extended no further than `run_out` (n).

    Infinity for a hinge means any angle.
    """
    found = travel_bounds(robot, np.array(run_out), pieces=self_pieces(robot))
    found.setflags(write=False)
    return found
