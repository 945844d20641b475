"""Which links of a machine must not touch each other, by their shapes as written.

Two links may be left out only if they touch by construction: their shapes as written touch
over at least 85 % of the range of the joint between them, or, with several joints between them,
in as many random configurations. MoveIt's setup assistant follows the same idea, from 95 % on.
Links that move together are no pair.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from backhoe_planner.arrays import Matrix
from validation.convex_gaps import Body, gap, least_pair
from validation.dense_sweep import past_link
from validation.raw_urdf import Placements, RawMachine

LinkPair = tuple[str, str]

BY_CONSTRUCTION = 0.85  # of a joint's range, or of random configurations
_POSTURES = 101  # configurations over the range of a joint, or random ones of all joints
_FIRM = 1001  # random configurations, by which a share of 85 % is known to within 1.1 %
_APART = 1e-6  # m, from which two links do not touch
PIN_PLAY = 0.01  # m: links that are never further apart are joined by a pin with play; the search can end


@dataclass(frozen=True)
class Pairs:
    """Pairs of links that move relative to each other, as (outer link, inner link).

    Attributes
    ----------
    counted: apart in some configuration; with the distance, up to `PIN_PLAY` [m].
    touching: touch at every position of the joint between them.
    touching_afar: touch in all random configurations, with more than one joint between them.
    adjacent: those of all these with one joint between them.
    """

    counted: dict[LinkPair, float]
    touching: set[LinkPair]
    touching_afar: set[LinkPair]
    adjacent: set[LinkPair]


def find_pairs(machine: RawMachine, bodies: Mapping[str, Body], tip: str) -> Pairs:
    """All pairs of links of a machine with the tip `tip`."""
    joints = machine.chain(tip)
    names = [joint.name for joint in joints]
    carriers = machine.bodies(names)
    rank = {"": 0, **{name: index + 1 for index, name in enumerate(names)}}
    placed = _postures(machine, tip)
    found = Pairs({}, set(), set(), set())
    for one, other in combinations(bodies, 2):
        outer, inner = (one, other) if rank[carriers[one]] > rank[carriers[other]] else (other, one)
        apart = rank[carriers[outer]] - rank[carriers[inner]]
        if apart == 0:
            continue
        if apart == 1:
            found.adjacent.add((outer, inner))
        furthest = _furthest(bodies[outer], bodies[inner], placed[carriers[outer] if apart == 1 else ""])
        if furthest > _APART:
            found.counted[outer, inner] = furthest
        else:
            (found.touching if apart == 1 else found.touching_afar).add((outer, inner))
    return found


def touch_share(machine: RawMachine, bodies: Mapping[str, Body], tip: str, pair: LinkPair) -> float:
    """The share (0 to 1) of the range of the joint between two links, or of random configurations, with contact."""
    outer, inner = pair
    names = [joint.name for joint in machine.chain(tip)]
    carriers = machine.bodies(names)
    adjacent = carriers[inner] == ["", *names][names.index(carriers[outer])]
    placed = _postures(machine, tip)[carriers[outer]] if adjacent else _postures(machine, tip, _FIRM)[""]
    rotations, translations = past_link(placed, outer, inner)
    touches = [
        least_pair(bodies[outer], bodies[inner], rotation, translation)[0] <= 0.0
        for rotation, translation in zip(rotations, translations, strict=True)
    ]
    return float(np.mean(touches))


def _postures(machine: RawMachine, tip: str, count: int = _POSTURES) -> dict[str, dict[str, Placements]]:
    """Placements with one joint over its range, by its name; under "" those with all joints at random."""
    joints = machine.chain(tip)
    bounds = np.array(
        [(-np.pi, np.pi) if joint.kind == "continuous" else (joint.lower, joint.upper) for joint in joints], dtype=float
    )
    share = np.random.default_rng(0).random((count, len(joints)))
    q: Matrix = bounds[:, 0] + share * (bounds[:, 1] - bounds[:, 0])
    found = {"": machine.placements(dict(zip((joint.name for joint in joints), q.T, strict=True)), count)}
    for joint, (low, high) in zip(joints, bounds.tolist(), strict=True):
        found[joint.name] = machine.placements({joint.name: np.linspace(low, high, count)}, count)
    return found


def _furthest(one: Body, other: Body, placed: Mapping[str, Placements]) -> float:
    """The largest distance of two links [m]; 0 if they touch in all configurations."""
    rotations, translations = past_link(placed, one.name, other.name)
    between = np.linalg.norm(rotations @ one.centre + translations - other.centre, axis=1) - one.reach - other.reach
    furthest = max(float(np.max(between)), 0.0)
    last: tuple[int, int] | None = None
    for rotation, translation in zip(rotations, translations, strict=True):
        if furthest > PIN_PLAY:
            break
        if last is not None and gap(one.parts[last[0]], other.parts[last[1]], rotation, translation) <= 0.0:
            continue
        distance, last = least_pair(one, other, rotation, translation)
        furthest = max(furthest, distance)
    return furthest
