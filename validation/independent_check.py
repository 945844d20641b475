"""A second opinion on a motion: distances without coal, ten times finer in time, and loads and rates from the URDF.

Every link's collision shape, as read from the URDF itself, is covered with points; each
obstacle is a signed distance function of this package. The least value over all points
and moments cannot be below the true distance, so a motion is refuted as soon as that value
is below the certificate's claim.

All points at all moments are covered, but few are measured one by one: a link's points are
grouped in a tree of balls, the moments in windows. A signed distance changes by no more than
the point moves, so a ball and a window with a middle far enough away need no refinement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from backhoe_planner.machine import self_pairs, self_pieces
from validation.held_loads import unheld_loads
from validation.motion_loads import motion_contradictions
from validation.signed_distances import SignedDistance, obstacle_distance
from validation.surfaces import BRANCHES, Cover, Solid, link_shapes

Indices = NDArray[np.intp]

SPANS = np.array([64, 8, 1])  # moments in a window, from coarse to fine
CHUNK = 20_000  # balls in windows at once
CLAIM_SLACK = 1e-6  # m by which a distance may be below the proven one, for rounding
CLEARANCE_SLACK = 2e-4  # m below the clearance; twice what the certificate accepts as keeping it


@dataclass(frozen=True)
class Least:
    """The least distance found between two bodies, and its time [m, s]."""

    link: str
    obstacle: str
    distance: float
    clearance: float
    time: float


class _Track:
    """The motion of a cover past an obstacle: rotation (T, 3, 3) and translation (T, 3) at every moment."""

    def __init__(self, cover: Cover, rotation: Matrix, translation: Matrix) -> None:
        self.cover, self.rotation, self.translation = cover, rotation, translation
        count = len(translation)
        self.windows = -(-count // SPANS)
        self._first = np.concatenate(([0], np.cumsum(self.windows)[:-1]))
        middle = rotation @ cover.centre[0] + translation
        spreads = []
        for span, windows in zip(SPANS.tolist(), self.windows.tolist(), strict=True):
            mid = np.repeat(np.minimum(np.arange(windows) * span + span // 2, count - 1), span)[:count]
            # the norm of a difference of rotations is its Frobenius norm over the root of 2
            turned = np.sqrt(0.5 * np.sum(np.square(rotation - rotation[mid]), axis=(1, 2)))
            moved = np.linalg.norm(middle - middle[mid], axis=1) + cover.radius[0] * turned
            spreads.append(np.maximum.reduceat(moved, np.arange(windows) * span))
        self._spread = np.concatenate(spreads)

    def spread(self, level: Indices, window: Indices) -> NDArray[np.float64]:
        """(K,) the most that a point of the cover is off its place at a window's middle, within the window [m]."""
        return np.asarray(self._spread[self._first[level] + window])


def refutations(plan: bp.Plan, *, refine: int = 10, itself: bool = True) -> list[str]:
    """Describe what contradicts the plan's certificate; empty if nothing does.

    Parameters
    ----------
    refine: moments checked per sample of the plan.
    itself: whether the machine is also checked against itself.
    """
    proven = {entry.obstacle: entry.distance for entry in plan.certificate.clearances if entry.kind == "obstacle"}

    def floor(obstacle: str, clearance: float) -> float:
        allowed = clearance - CLEARANCE_SLACK if plan.verified else -np.inf
        claimed = proven.get(obstacle, -np.inf) - CLAIM_SLACK
        return allowed if obstacle.startswith("self: ") else max(allowed, claimed)

    found = unheld_loads(plan.problem, plan.trajectory) if plan.verified else []
    found += motion_contradictions(plan)
    for least in _search(plan, refine=refine, itself=itself, floor=floor):
        where = f"{least.link} is {least.distance:.5f} m from {least.obstacle} at {least.time:.3f} s"
        claim = proven.get(least.obstacle, -np.inf)
        if least.distance < claim - CLAIM_SLACK and not least.obstacle.startswith("self: "):
            found.append(f"{where}, proven were {claim:.5f} m")
        if plan.verified and least.distance < least.clearance - CLEARANCE_SLACK:
            found.append(f"{where}, allowed are {least.clearance:.5f} m")
    return found


def least_distances(plan: bp.Plan, *, refine: int = 10, itself: bool = True) -> list[Least]:
    """The least distance of every link to every obstacle, and of the machine to itself."""
    return _search(plan, refine=refine, itself=itself, floor=lambda obstacle, clearance: np.inf)


def _search(plan: bp.Plan, *, refine: int, itself: bool, floor: Callable[[str, float], float]) -> list[Least]:
    """The least distances below `floor(obstacle, clearance)`; those above it are left out."""
    robot, scene, motion = plan.robot, plan.scene, plan.trajectory
    time = _finer(motion.time, refine)
    placements = _placements(robot, motion.at(time))
    covers, solids = link_shapes(robot)
    tracks = [_Track(cover, *placements[cover.joint]) for cover in covers if cover.joint > 0]
    found = []
    for spec in scene.obstacles:
        distance = obstacle_distance(spec, scene)
        clearance = scene.clearance if spec.clearance is None else spec.clearance
        below = floor(spec.name, clearance)
        if below == -np.inf:
            continue
        shift = np.maximum(time - spec.appears_at, 0.0)[:, None] * np.array(spec.velocity)
        for rows, track in product(_moments_of(plan, spec.legs, time), tracks):
            link = track.cover.link
            if spec.links is not None and link not in spec.links:
                continue
            past = track
            if np.any(shift) or spec.legs is not None:
                past = _Track(track.cover, track.rotation[rows], track.translation[rows] - shift[rows])
            least, moment = _least(past, distance, time[rows] >= spec.appears_at, below)
            if np.isfinite(least):
                found.append(Least(link, spec.name, least, clearance, float(time[rows][moment])))
    return found + (_against_itself(robot, tracks, solids, placements, time, floor) if itself else [])


def _moments_of(plan: bp.Plan, legs: tuple[str, ...] | None, time: NDArray[np.float64]) -> list[slice]:
    """The rows of `time` (T,) in each of some legs of a sequence, by name, with both ends; all of them for None."""
    if legs is None:
        return [slice(None)]
    at = plan.trajectory.time
    ends = [(at[leg.first], at[leg.last]) for leg in plan.legs if leg.name in legs]
    return [slice(int(np.searchsorted(time, a)), int(np.searchsorted(time, b, side="right"))) for a, b in ends]


def _finer(time: NDArray[np.float64], refine: int) -> NDArray[np.float64]:
    steps = [np.linspace(a, b, refine, endpoint=False) for a, b in pairwise(time.tolist())]
    return np.concatenate([*steps, time[-1:]])


def _placements(robot: bp.Robot, q: Matrix) -> list[tuple[Matrix, Matrix]]:
    """Rotations (T, 3, 3) and translations (T, 3) of every joint's frame."""
    model = robot.model
    found = [(np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)))]
    for joint in range(1, model.njoints):
        R_parent, p_parent = found[model.parents[joint]]
        T = model.jointPlacements[joint]
        slide, axis = np.split(np.asarray(model.joints[joint].createData().S, dtype=float).reshape(6), 2)
        angle = q[:, model.joints[joint].idx_q]
        cross = pin.skew(axis)
        # Rodrigues; the axis of a prismatic joint is 0
        turn = np.eye(3) + np.sin(angle)[:, None, None] * cross + (1.0 - np.cos(angle))[:, None, None] * (cross @ cross)
        R_before = R_parent @ T.rotation
        moved = angle[:, None] * slide
        found.append((R_before @ turn, R_parent @ T.translation + p_parent + np.einsum("tij,tj->ti", R_before, moved)))
    return found


def _least(track: _Track, distance: SignedDistance, present: NDArray[np.bool_], below: float) -> tuple[float, int]:
    """The least distance over all points and moments, and its moment; infinite if it is not under `below`.

    A branch and bound over balls and windows at once: everything left when a distance is
    known may be under it.
    """
    cover, count = track.cover, len(track.translation)
    window = np.arange(track.windows[0])
    window = window[present[np.minimum((window + 1) * SPANS[0], count) - 1]]
    level, node = np.zeros_like(window), np.zeros_like(window)
    bound = np.full(len(window), -np.inf)
    least, moment, upper = np.inf, 0, below
    while len(window):
        kept = bound <= upper
        level, window, node, bound = level[kept], window[kept], node[kept], bound[kept]
        rest = None
        if len(window) > CHUNK:
            order = np.argpartition(bound, CHUNK)
            now, later = order[:CHUNK], order[CHUNK:]
            rest = (level[later], window[later], node[later], bound[later])
            level, window, node = level[now], window[now], node[now]
        row = np.minimum(window * SPANS[level] + SPANS[level] // 2, count - 1)
        middles = np.einsum("kij,kj->ki", track.rotation[row], cover.centre[node]) + track.translation[row]
        value = distance(middles)
        radius, point, here = cover.radius[node], cover.first[node] < 0, present[row]
        spread = track.spread(level, window)
        done = point & ((level == len(SPANS) - 1) | ((spread == 0.0) & here))
        if np.any(here):
            upper = min(upper, float(np.min(np.where(point, value - radius, value + radius)[here])))
        hits = np.flatnonzero(done & here)
        if len(hits):
            best = int(hits[np.argmin(value[hits] - radius[hits])])
            if value[best] - radius[best] < min(least, below):
                least, moment = float(value[best] - radius[best]), int(row[best])
        lower = value - radius - spread
        open_ = ~done & (lower <= upper)
        in_time = open_ & (level < len(SPANS) - 1) & (point | (spread > radius))
        in_space = open_ & ~in_time
        parts = [_in_time(level[in_time], window[in_time], node[in_time], lower[in_time], present)]
        parts.append(_in_space(level[in_space], window[in_space], node[in_space], lower[in_space], cover))
        if rest is not None:
            parts.append(rest)
        level, window, node, bound = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return least, moment


_Items = tuple[Indices, Indices, Indices, NDArray[np.float64]]


def _in_time(
    level: Indices, window: Indices, node: Indices, lower: NDArray[np.float64], present: NDArray[np.bool_]
) -> _Items:
    """Split every window into its parts."""
    finer = np.repeat(level + 1, BRANCHES)
    part = (window[:, None] * BRANCHES + np.arange(BRANCHES)).ravel()
    kept = part * SPANS[finer] < len(present)
    last = np.minimum((part + 1) * SPANS[finer], len(present)) - 1
    kept &= present[last]  # obstacles that have appeared stay
    return finer[kept], part[kept], np.repeat(node, BRANCHES)[kept], np.repeat(lower, BRANCHES)[kept]


def _in_space(level: Indices, window: Indices, node: Indices, lower: NDArray[np.float64], cover: Cover) -> _Items:
    """Split every ball into its children."""
    child = (cover.first[node][:, None] + np.arange(BRANCHES)).ravel()
    kept = (np.arange(BRANCHES) < cover.children[node][:, None]).ravel()
    repeated = (np.repeat(values, BRANCHES)[kept] for values in (level, window))
    finer_level, finer_window = repeated
    return finer_level, finer_window, child[kept], np.repeat(lower, BRANCHES)[kept]


def _against_itself(
    robot: bp.Robot,
    tracks: list[_Track],
    solids: list[Solid],
    placements: list[tuple[Matrix, Matrix]],
    time: NDArray[np.float64],
    floor: Callable[[str, float], float],
) -> list[Least]:
    pairs, pieces = self_pairs(robot), self_pieces(robot)
    links = {(pieces[a].link, pieces[b].link) for a, b in pairs.kept}
    links -= {(pair.link, pair.other) for pair in pairs.left_out if pair.touch}
    links |= {(b, a) for a, b in links}
    present = np.ones(len(time), dtype=bool)
    found = []
    for track in tracks:
        for inner in solids:
            cover, name = track.cover, f"self: {inner.link}"
            below = floor(name, 0.0)
            if cover.joint <= inner.joint or (cover.link, inner.link) not in links or below == -np.inf:
                continue
            R, p = inner.T_joint_shape.rotation, inner.T_joint_shape.translation
            if inner.joint == 0:
                least, moment = _least(track, _at(inner.signed_distance, R, p), present, below)
            else:
                R_inner, p_inner = placements[inner.joint]
                R_shape, p_shape = R_inner @ R, R_inner @ p + p_inner
                relative = _Track(
                    cover,
                    np.swapaxes(R_shape, 1, 2) @ track.rotation,
                    np.einsum("tji,tj->ti", R_shape, track.translation - p_shape),
                )
                least, moment = _least(relative, inner.signed_distance, present, below)
            if np.isfinite(least):
                found.append(Least(cover.link, name, least, 0.0, float(time[moment])))
    return found


def _at(distance: SignedDistance, rotation: Matrix, place: Matrix) -> SignedDistance:
    """The signed distance to the same shape at a placement."""
    return lambda points: distance((points - place) @ rotation)
