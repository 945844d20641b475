"""The compiled functions agree with their plain versions, and the plain versions with hand calculations.

Each function has a source of random arguments here, as it is called in a step. Where the package
`backhoe_planner_native` is not installed, nothing is compared, and only the plain versions are tested.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
import pytest

from backhoe_planner import Robot, native
from backhoe_planner.law import CompletedLaw, CriticalRows
from backhoe_planner.law.completed import LawSettings
from backhoe_planner.live import Feedback, Servo  # noqa: F401  loads all marked functions
from backhoe_planner.live.servo.feedback import HandSettings
from backhoe_planner.machine import Kinematics
from backhoe_planner.machine.kinematics.kinematics import place_chain
from backhoe_planner.motion import Rows  # noqa: F401  the same
from backhoe_planner.native import find_compiled, native_version, plain_versions
from backhoe_planner.planning import Stepper, cheapen_stretch  # noqa: F401  the same
from backhoe_planner.proof import least_duration  # noqa: F401  the same
from backhoe_planner.site import ClearanceScreen  # noqa: F401  the same

Rng: TypeAlias = np.random.Generator
Arguments: TypeAlias = tuple[Any, ...]

needs_native = pytest.mark.skipif(find_compiled() is None, reason="backhoe_planner_native is not installed")


def some(rng: Rng, most: int = 40) -> int:
    return int(rng.integers(0, most))


def joints(rng: Rng) -> int:
    return int(rng.integers(1, 9))


def chosen(rng: Rng, of: int) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Some of the first `of` numbers, ascending."""
    return np.sort(rng.choice(of, size=int(rng.integers(0, of + 1)), replace=False)).astype(np.intp)


def rows_of(columns: tuple[Any, ...]) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, np.column_stack(columns).tolist()))


def rotation(rng: Rng) -> Any:
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


def placements(rng: Rng, samples: int, bodies: int) -> Any:
    T = np.zeros((samples, bodies, 4, 4))
    for sample in range(samples):
        for body in range(bodies):
            T[sample, body] = np.eye(4)
            if body:
                T[sample, body, :3, :3], T[sample, body, :3, 3] = rotation(rng), rng.normal(size=3)
    return T


def chain(rng: Rng, n: int) -> tuple[Any, Any]:
    """Factors (33, n) and which joints slide (n,) of a chain of joints, see `chain_factors`."""
    factors = np.zeros((33, n))
    for joint in range(n):
        R, axis, x = rotation(rng), rotation(rng)[0], rng.normal(size=3)
        K = np.cross(np.eye(3), axis)
        factors[:, joint] = np.column_stack((R, R @ K, R @ K @ K, R @ axis, x)).T.ravel()
    return factors, rng.integers(0, 2, n).astype(float)


def bounds_after(rng: Rng) -> Arguments:
    count, n = some(rng), joints(rng)
    travel = np.abs(rng.normal(size=(count, n)))
    return rng.normal(size=count), np.asfortranarray(travel), rng.normal(size=n), rng.normal(size=n)


def reach_of_lead(rng: Rng) -> Arguments:
    count, n = some(rng), joints(rng)
    return (
        rng.uniform(0.0, 3.0, count), np.asfortranarray(rng.uniform(0.0, 5.0, (count, n))),
        rng.uniform(0.0, 1.0, count), rng.uniform(0.0, 0.2, count), rng.uniform(0.0, 1.0, count),
        rng.uniform(0.0, 0.5, n), rng.uniform(0.0, 0.4),
    )  # fmt: skip


def approach_rates(rng: Rng) -> Arguments:
    n, own, others, count = joints(rng), 1 + some(rng, 6), 1 + some(rng, 6), some(rng)
    poses = placements(rng, 1, n + 1)[0, :, :3]
    centre = 3.0 * rng.normal(size=(3, own + others))
    size = np.append(rng.uniform(0.0, 0.5, own), rng.choice([0.2, 1.0, 5.0, np.inf], others))
    joint = np.append(rng.integers(0, n + 1, own), np.zeros(others, dtype=int)).astype(np.intp)
    piece, body = rng.integers(0, own, count), rng.integers(0, own + others, count)
    ends = np.column_stack((rng.normal(size=(own, 3)), np.ones(own)))
    return (
        poses, ends, centre, size, joint, rng.normal(size=(6, n)), rng.normal(size=n), piece, body,
        0.1 * rng.normal(size=(count, 3)), rng.normal(size=(count, 3)) * rng.integers(0, 2),
    )  # fmt: skip


def pairs_within(rng: Rng) -> Arguments:
    count = some(rng)
    return rng.permutation(count), rng.normal(size=count), rng.normal(size=count)


def near_rows(rng: Rng) -> Arguments:
    every, n = 1 + some(rng), joints(rng)
    measured = chosen(rng, every)
    found = rng.normal(size=(len(measured), 10))
    lead: Arguments = (rng.normal(size=n), rng.uniform(0.0, 0.3, n), rng.uniform(0.0, 1.0))
    return (
        measured, found, rng.uniform(0.0, 2.0, len(measured)), rng.uniform(0.0, 0.2, every),
        rng.integers(-1, 2, (every, n)).astype(float), rng.normal(size=(every, 3)) if rng.integers(2) else None,
        rng.normal(size=(6, n)), 0.3, *(lead if rng.integers(3) else (None, None, 0.0)),
    )  # fmt: skip


def unproven_of_near(rng: Rng) -> Arguments:
    every, n = 1 + some(rng), joints(rng)
    travel, speed = rng.uniform(0.0, 4.0, (every, n)), rng.uniform(0.0, 1.0, every) * rng.integers(0, 2)
    pairs, q = chosen(rng, every), rng.normal(size=n)
    return (
        pairs, rng.uniform(0.0, 0.5, len(pairs)), rng.uniform(0.0, 2.0), travel, speed, travel.max(axis=0),
        float(speed.max()), q, q + 0.05 * rng.normal(size=n), 0.02, rng.choice([0.0, -1e-5, 0.01]),
    )  # fmt: skip


def read_results(rng: Rng) -> Arguments:
    numbers = rng.uniform(0.0, 1.0, (1 + some(rng), 14))[:, 2:12]
    return numbers, chosen(rng, len(numbers)), rng.choice([1e-9, 0.5])


def placed_arrays(rng: Rng) -> Arguments:
    n = joints(rng)
    return rng.normal(size=(6, n)), rng.normal(size=(n, 3)), rng.normal(size=3)


def keep_placements(rng: Rng) -> Arguments:
    n = joints(rng)
    return rng.normal(size=(n + 1, 3, 4)), rng.normal(size=(6, n)), np.zeros((n + 1, 4, 4))[:, :3], np.zeros((6, n))


def place_tip(rng: Rng) -> Arguments:
    n = joints(rng)
    tip = np.append(rng.normal(size=3), 1.0)
    return placements(rng, 1, 2)[0, 1], tip, rng.normal(size=(6, n)), np.eye(6), np.zeros((6, n))


def quick_terms(rng: Rng) -> Arguments:
    """With a task of three and four joints, which the plain version can solve too."""
    count = some(rng, 60)
    s_e, s_o = rng.choice([1.0, 0.5], 2).tolist()
    settings = LawSettings(s_e, s_o, 0.6, 0.2, 0.1, float(rng.integers(2)))
    ranges = ((-2.0, 2.0, 0.6),) * 4
    return (
        rng.uniform(-2.1, 2.1, 4), 2.0 * rng.normal(size=(3, 4)), rng.normal(size=3), rng.uniform(-0.05, 0.8, count),
        rng.normal(size=(count, 4)), 0.1 * rng.normal(size=count), ranges, settings,
    )  # fmt: skip


def soft_solution(rng: Rng) -> Arguments:
    """Problems some of whose rows cannot all be kept within the bounds."""
    n, rows = joints(rng), some(rng, 30)
    A = rng.normal(size=(n, n))
    return (
        A.dot(A.T) + 0.1 * np.eye(n), rng.normal(size=n), -rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n),
        rng.normal(size=(rows, n)), rng.normal(0.3, 0.5, rows), 150,
    )  # fmt: skip


def step_conditions(rng: Rng) -> Arguments:
    count, n = some(rng), joints(rng)
    velocity, a, dt = rng.uniform(0.2, 1.0, n), rng.uniform(0.5, 2.0, n), 0.02
    room = 0.5 * velocity**2 / a
    table = rows_of((np.full(n, -2.0), np.full(n, 2.0), room - 2.0, 2.0 - room, velocity, a, a * dt, 1.0 / a))
    v = rng.uniform(-0.4, 0.4, n)
    return (
        v + 0.02 * rng.normal(size=n), rng.uniform(-2.2, 2.2, n), v, dt, table, rng.uniform(-0.05, 0.5, count),
        rng.uniform(0.0, 0.01, count) if rng.integers(2) else 0.002, rng.normal(size=(count, n)),
        0.1 * rng.normal(size=count), (1.6, 1.0, 0.25),
    )  # fmt: skip


def nearest_safe_program(rng: Rng) -> Arguments:
    count, n = some(rng), joints(rng)
    low = rng.uniform(-0.5, 0.0, n)
    wish = rng.normal(size=n) * rng.integers(0, 2)
    return (
        wish, rng.normal(size=(3, n)), rng.normal(size=(count, n)), rng.uniform(-0.1, 1.0, count), low,
        low + rng.uniform(0.0, 0.5, n), (10.0, 1.0, 0.05), 16,
    )  # fmt: skip


def reachable_velocities(rng: Rng) -> Arguments:
    n = joints(rng)
    change, braking = rng.uniform(0.001, 0.1, n), rng.uniform(0.5, 2.0, n)
    table = rows_of((np.full(n, -2.0), np.full(n, 2.0), np.full(n, 0.8), change, braking, 1.0 / braking))
    return (
        rng.uniform(-2.1, 2.1, n), rng.uniform(-0.9, 0.9, n), rng.normal(size=n), 0.004, table,
        (1.0, 0.02, 0.25, 1e-9, 0.8),
    )  # fmt: skip


def straight_towards(rng: Rng) -> Arguments:
    n = joints(rng)
    return rng.normal(size=n), rng.normal(size=n), tuple(rng.uniform(0.1, 3.0, n).tolist())


def changes_of_end(rng: Rng) -> Arguments:
    n = joints(rng)
    return (*rng.normal(size=(3, n)), tuple(rng.uniform(0.0, 0.1, n).tolist()), 0.3, 0.005)


def near_now(rng: Rng) -> Arguments:
    every, classes = 1 + some(rng), 1 + some(rng, 6)
    pairs = chosen(rng, every)
    return (
        rng.normal(size=every), rng.uniform(0.0, 1.0, every), pairs, rng.integers(0, classes, len(pairs)),
        rng.uniform(0.0, 1.0, classes),
    )  # fmt: skip


def not_proven(rng: Rng) -> Arguments:
    every, classes = 1 + some(rng), 1 + some(rng, 6)
    pairs = chosen(rng, every)
    return (
        rng.normal(size=every), rng.uniform(0.0, 0.5, every), pairs, rng.integers(0, classes, len(pairs)),
        rng.uniform(0.0, 1.0, classes), rng.uniform(0.0, 0.1, classes), 0.002,
    )  # fmt: skip


def corner_gaps(rng: Rng) -> Arguments:
    every, bodies, samples, corners = 1 + some(rng), 1 + joints(rng), 1 + some(rng, 5), 1 + some(rng, 9)
    pairs = chosen(rng, every)[: 20 if rng.integers(4) else 0]
    if not len(pairs):
        pairs = np.zeros(1, dtype=np.intp)
    pieces = 1 + some(rng, 5)
    columns = rng.normal(size=(pieces, 4, corners))
    columns[:, 3] = 1.0
    return (
        pairs, rng.normal(size=(every, 4)), rng.integers(1, bodies, every) if bodies > 1 else np.zeros(every, np.intp),
        rng.integers(0, bodies, every) if rng.integers(2) else None, rng.integers(0, pieces, every), columns,
        placements(rng, samples, bodies),
        rng.normal(size=every) if rng.integers(2) else None, 0.05, np.zeros((len(pairs), samples, corners)),
    )  # fmt: skip


def blended_points(rng: Rng) -> Arguments:
    count, samples, corners = some(rng), 1 + some(rng, 3), 1 + some(rng, 9)
    gaps = 0.1 * rng.normal(size=(count, samples, corners))
    pieces = 1 + some(rng, 5)
    columns = rng.normal(size=(pieces, 4, corners))
    columns[:, 3] = 1.0
    return gaps, gaps.min(axis=2), rng.integers(0, pieces, count), columns, 0.1


def count_travel(rng: Rng) -> Arguments:
    every, classes, n = 1 + some(rng), 1 + some(rng, 6), joints(rng)
    pairs = chosen(rng, every)
    return (
        rng.uniform(0.0, 5.0, (classes, n)), rng.normal(size=n), rng.normal(size=n) if rng.integers(4) else None,
        pairs, rng.normal(size=len(pairs)), rng.integers(0, classes, every), rng.uniform(0.0, 9.0, classes),
        rng.uniform(0.0, 9.0, classes), rng.normal(size=every),
    )  # fmt: skip


def keep_proven(rng: Rng) -> Arguments:
    every = 1 + some(rng)
    pairs = chosen(rng, every)
    stands = rng.integers(0, 2, every).astype(bool)
    return pairs, rng.normal(size=len(pairs)), rng.uniform(0.0, 0.5, every), stands, rng.normal(size=every)


def note_gaps(rng: Rng) -> Arguments:
    every = 1 + some(rng)
    pairs = chosen(rng, every)
    count = len(pairs)
    return (
        pairs, rng.normal(size=count), rng.uniform(0.0, 9.0, count), rng.normal(size=(count, 1 + some(rng, 4))),
        rng.uniform(0.0, 0.5, every), rng.normal(size=every),
    )  # fmt: skip


def left_over_path(rng: Rng) -> Arguments:
    every = 1 + some(rng)
    pairs = chosen(rng, every)
    return pairs, rng.normal(size=len(pairs)), rng.normal(size=every), rng.choice([1e-9, -0.3])


def keeps_rows(rng: Rng) -> Arguments:
    count, n = some(rng, 8), joints(rng)
    return rng.normal(size=(count, n)), 3.0 * rng.uniform(size=count), rng.normal(size=n), rng.choice([0.0, 0.5])


def braking_line(rng: Rng) -> Arguments:
    n = joints(rng)
    v = rng.normal(size=n) * rng.integers(0, 3)
    return rng.normal(size=n), v, rng.choice([0.0, 0.01]), tuple(rng.uniform(0.2, 2.0, n).tolist())


def largest_part(rng: Rng) -> Arguments:
    n = joints(rng)
    return rng.normal(size=n), tuple(rng.uniform(0.2, 4.0, n).tolist())


def plane_rows(rng: Rng) -> Arguments:
    every, n, samples = 1 + some(rng), joints(rng), 1 + some(rng, 5)
    pairs = rng.integers(0, every, 1 + some(rng))
    points = np.column_stack((rng.normal(size=(len(pairs), 3)), np.ones(len(pairs))))
    return (
        pairs, rng.integers(0, samples, len(pairs)) if rng.integers(2) else samples - 1, points,
        rng.normal(size=(every, 4)), rng.integers(0, n + 1, every),
        rng.integers(0, n + 1, every) if rng.integers(2) else None, rng.integers(-1, 2, (every, n)).astype(float),
        placements(rng, samples, n + 1), rng.normal(size=(samples, 6, n)),
    )  # fmt: skip


def binding_corners(rng: Rng) -> Arguments:
    every, classes, samples, corners = 1 + some(rng), 1 + some(rng, 6), 2 + some(rng, 5), 1 + some(rng, 9)
    pairs = chosen(rng, every)
    if not len(pairs):
        pairs = np.zeros(1, dtype=np.intp)
    gaps = rng.choice([0.05, 0.5]) + 0.2 * rng.normal(size=(len(pairs), samples, corners))
    least = gaps.min(axis=2)
    closely = rng.integers(0, samples, len(pairs)) * (rng.uniform(size=len(pairs)) < 0.2)
    return (
        pairs, gaps, gaps.argmin(axis=2), least, least.min(axis=1) - rng.uniform(0.0, 0.1, len(pairs)),
        closely.astype(np.intp), rng.uniform(0.0, 0.2, every), rng.integers(0, classes, every),
        rng.uniform(0.0, 0.01, classes), rng.uniform(0.0, 0.2, classes),
        rng.integers(0, 2, every) > 0 if rng.integers(2) else None, (0.002, 24.0, 16.0),
    )  # fmt: skip


def rows_by_velocity(rng: Rng) -> Arguments:
    n, count, parts = joints(rng), some(rng), 1 + some(rng, 8)
    later = rng.integers(2) > 0
    return (
        rng.normal(size=(count, n)), 0.1 * rng.normal(size=count), 0.1 * rng.normal(size=count),
        rng.integers(1, parts + 1, count), parts, rng.normal(size=n), 0.3, int(rng.integers(n)), rng.normal(),
        0.01 * rng.normal(size=(2, n)) if later else None, 0.01 * rng.normal(size=count) if later else None,
    )  # fmt: skip


def rows_of_path(rng: Rng) -> Arguments:
    of_corners = binding_corners(rng)
    if rng.integers(4) == 0:
        of_corners[6][:] = -100.0  # nothing binds
    every, samples, hull = len(of_corners[6]), of_corners[1].shape[1], of_corners[1].shape[2]
    n, pieces = joints(rng), 1 + some(rng, 5)
    later, relative = rng.integers(2) > 0, rng.integers(2) > 0
    corners = np.ones((pieces, hull, 4))
    corners[..., :3] = rng.normal(size=(pieces, hull, 3))
    end = rng.normal(size=(2, n))
    return (
        *of_corners, rng.normal(size=(every, 4)), rng.integers(0, n + 1, every),
        rng.integers(0, n + 1, every) if relative else None, rng.integers(0, pieces, every), corners,
        rng.integers(-1, 2, (every, n)).astype(float), placements(rng, samples, n + 1),
        rng.normal(size=(samples, 6, n)), 0.1 * rng.normal(size=every), samples - 1, rng.normal(size=n), 0.3,
        int(rng.integers(n)), rng.normal(), *end, *(rng.normal(size=(2, n)) if later else (None, None)), 0.01,
    )  # fmt: skip


def turn_along_surface(rng: Rng) -> Arguments:
    """Wishes along a surface and straight into it, with and without a previous sense of turning."""
    normal = rotation(rng)[0]
    tip = rng.uniform(0.1, 1.0) * normal + rng.choice([0.0, 0.1, 1.0]) * rotation(rng)[0]
    return tip, normal, float(rng.integers(2)) * rotation(rng)[0], bool(rng.integers(2))


def place_on_line(rng: Rng) -> Arguments:
    n, parts = joints(rng), 1 + some(rng, 8)
    factors, slides = chain(rng, n)
    T, J = np.zeros((parts + 2, n + 1, 4, 4)), np.zeros((parts + 2, 6, n))
    return rng.normal(size=n), rng.normal(size=n), parts, int(rng.integers(1, 3)), factors, slides, T, J


def bend_in_parts(rng: Rng) -> Arguments:
    n = joints(rng)
    turning = rng.integers(0, 2, n).astype(float)
    return rng.choice([0.0, 0.1]) * rng.normal(size=n), turning, rng.uniform(1.0, 5.0, n), (0.002, 8.0)


def least_over_path(rng: Rng) -> Arguments:
    every, classes = 1 + some(rng), 1 + some(rng, 6)
    pairs = chosen(rng, every)
    least = rng.normal(size=(len(pairs), 1 + some(rng, 6)))
    return pairs, least, rng.integers(0, classes, every), rng.uniform(0.0, 0.1, classes)


def gaps_along_path(rng: Rng) -> Arguments:
    q, delta, parts, _, factors, slides, T, J = place_on_line(rng)
    pairs, planes, _, _, piece, corners, *_ = corner_gaps(rng)
    every, n, classes = len(planes), len(q), 1 + some(rng, 6)
    T[:, :] = np.eye(4)
    return (
        q, delta, parts, rng.uniform(0.0, 0.1, n), factors, slides, rng.uniform(0.0, 5.0, (classes, n)), pairs, planes,
        rng.integers(0, n + 1, every), rng.integers(0, n + 1, every) if rng.integers(2) else None, piece, corners,
        rng.normal(size=every) if rng.integers(2) else None, 0.05, rng.integers(0, classes, every),
        rng.normal(size=every), 1e-9, T, J, np.zeros((len(pairs), parts + 1, corners.shape[2])),
    )  # fmt: skip


def near_gaps(rng: Rng) -> Arguments:
    pairs, planes, joint, other, piece, corners, T, *_ = corner_gaps(rng)
    every, count = len(planes), len(pairs)
    return (
        pairs, rng.normal(size=count), rng.uniform(0.0, 9.0, count), planes, joint, other, piece, corners, T,
        rng.uniform(0.0, 0.5, every), rng.normal(size=every),
    )  # fmt: skip


def nearest_rows(rng: Rng) -> Arguments:
    pairs, planes, _, _, piece, corners, *_ = corner_gaps(rng)
    every, n = len(planes), joints(rng)
    gaps = 0.1 * rng.normal(size=(len(pairs), 1 + some(rng, 3), corners.shape[2]))
    return (
        pairs, gaps, gaps.min(axis=2), piece, corners, 0.1, planes, rng.integers(0, n + 1, every),
        rng.integers(0, n + 1, every) if rng.integers(2) else None, rng.integers(-1, 2, (every, n)).astype(float),
        placements(rng, 2, n + 1), rng.normal(size=(2, 6, n)),
    )  # fmt: skip


def cost_of_tip(rng: Rng) -> Arguments:
    n = joints(rng)
    return rng.normal(size=(1 + some(rng, 5), n)), rng.normal(size=n), rng.normal(size=n), 0.005


def next_within(rng: Rng) -> Arguments:
    n, count = joints(rng), some(rng, 8)
    v, low = rng.normal(size=n), rng.normal(size=n) - rng.choice([0.0, 5.0])
    changes, fastest = tuple(rng.uniform(0.0, 0.1, n).tolist()), tuple(rng.uniform(0.5, 2.0, n).tolist())
    h = rng.uniform(0.0, 1.0, count) + rng.choice([0.0, 10.0])
    high = low + rng.choice([0.5, 10.0])
    return (
        rng.normal(size=n),
        v,
        low,
        high,
        changes,
        fastest,
        rng.uniform(0.5, 1.5),
        rng.normal(size=(count, n)),
        h,
        1e-9,
    )


def velocity_within_rows(rng: Rng) -> Arguments:
    """Some of the rows cannot be kept; no rates limit the velocity, for there the two solvers differ."""
    n, count = joints(rng), some(rng, 25)
    v, change = 0.3 * rng.normal(size=n), rng.uniform(0.05, 0.5, n)
    return (
        rng.normal(size=n), rng.normal(size=(3, n)) if rng.integers(3) else None, 0.1 * rng.normal(size=n), 0.1, v,
        v - change, v + change, np.full(n, -1.0), np.full(n, 1.0), rng.normal(size=(count, n)),
        rng.normal(0.5, 0.5, count), tuple(change.tolist()), (1.1,) * n, 1e-9, 150,
    )  # fmt: skip


def velocity_held_as_before(rng: Rng) -> Arguments:
    path = rows_of_path(rng)
    n = path[19].shape[2]
    v, change, target = 0.3 * rng.normal(size=n), rng.uniform(0.05, 0.5, n), rng.normal(size=n)
    return (
        *path[:10], None, *path[11:22], *path[26:28], path[26] + 0.001, target, 0.001,
        tuple(rng.uniform(0.5, 2.0, n).tolist()), rng.normal(size=n),
        rng.normal(size=(3, n)) if rng.integers(3) else None, 0.1 * rng.normal(size=n), 0.1, v,
        v - change, v + change, np.full(n, -1.0), np.full(n, 1.0), tuple(change.tolist()), (1.1,) * n,
        bool(rng.integers(2)), (1e-5, 1e-9, 48, 150),
    )  # fmt: skip


def ways_of_links(rng: Rng) -> Arguments:
    bodies, links = 1 + joints(rng), some(rng, 9)
    T = placements(rng, 1 + some(rng, 4), bodies)
    columns = rng.normal(size=(links, 4, 1 + some(rng, 12)))
    columns[:, 3] = 1.0
    joint = rng.integers(0, bodies, links)
    begun = np.ascontiguousarray(T[0, joint, :3]) + 0.1 * rng.normal(size=(links, 3, 4)) * rng.integers(0, 2)
    return T, joint, begun, columns, rng.uniform(0.0, 0.3, links)


def line_ahead(rng: Rng) -> Arguments:
    n, classes = joints(rng), some(rng, 6)
    travel, q, v = rng.uniform(0.0, 5.0, (classes, n)), rng.normal(size=n), rng.normal(size=n) * rng.integers(0, 2)
    furthest = rng.uniform(1.0, 5.0, n) * rng.choice([0.01, 1.0])
    return (
        q, v, q + 0.3 * v, rng.uniform(0.001, 0.1, n), rng.uniform(0.5, 2.0, n), travel, furthest,
        rng.integers(0, 2, n).astype(float), (0.011, 0.02, 4),
    )  # fmt: skip


def box_urgency(rng: Rng) -> Arguments:
    links, classes = 1 + some(rng, 8), 1 + some(rng, 5)
    return (
        rng.uniform(0.0, 0.3, (1 + some(rng, 4), links)), rng.uniform(0.1, 1.0, links), rng.uniform(-0.1, 1.0, links),
        rng.uniform(0.0, 0.2, links), rng.uniform(0.0, 0.5, links), rng.integers(0, 2, links).astype(float),
        rng.integers(0, classes, links), rng.uniform(0.0, 0.1, classes), 0.3,
        rng.integers(0, 2, links).astype(float), (0.2, 0.02),
    )  # fmt: skip


def inexact_boxes(rng: Rng) -> Arguments:
    links, bodies, classes, every = 1 + some(rng, 6), 1 + some(rng, 5), 1 + some(rng, 5), 5 + some(rng)
    columns = np.ones((links, 4, 1 + some(rng, 9)))
    columns[:, :3] = rng.normal(size=(links, 3, columns.shape[2]))
    witnesses = rng.normal(size=(links, 3, 6))
    witnesses[rng.random((links, 3)) < 0.3] = np.nan
    return (
        placements(rng, 1 + some(rng, 4), bodies), rng.integers(0, bodies, links), columns, witnesses,
        rng.normal(size=(every, 4)) + np.array([0.0, 0.0, 0.0, 3.0]), rng.integers(0, every, 3 * links),
        rng.integers(0, classes, links), rng.uniform(0.0, 0.2, links), *rng.uniform(0.0, 0.3, (3, classes)),
        rng.uniform(0.0, 2.0, every), rng.uniform(0.0, 0.2, classes), rng.uniform(-2.0, 1.0, every),
        rng.uniform(0.0, 0.2, classes), (rng.uniform(0.0, 0.5), 0.05, 0.85),
    )  # fmt: skip


def most_urgent_boxes(rng: Rng) -> Arguments:
    line = line_ahead(rng)
    while not len(line[5]):
        line = line_ahead(rng)
    n, classes, links, every = len(line[0]), len(line[5]), 1 + some(rng, 6), 5 + some(rng)
    _, _, columns, witnesses, planes, pairs, *_ = inexact_boxes(rng)
    columns, witnesses = np.resize(columns, (links, *columns.shape[1:])), np.resize(witnesses, (links, 3, 6))
    planes, pairs = np.resize(planes, (every, 4)), np.resize(pairs, 3 * links) % every
    factors, slides = chain(rng, n)
    return (
        *line, factors, slides, rng.integers(0, n + 1, links), columns, witnesses, planes, pairs,
        rng.integers(0, classes, links), rng.uniform(0.0, 0.2, links), rng.uniform(0.0, 2.0, every),
        rng.uniform(0.0, 0.2, classes), rng.uniform(-2.0, 1.0, every), rng.uniform(0.0, 0.2, classes),
        (0.3, 0.05, 0.85), rng.normal(size=(links, 3, 4)), rng.uniform(0.0, 0.3, links), rng.uniform(0.1, 9.0, links),
        rng.uniform(-0.1, 1.0, links), rng.uniform(0.0, 0.1, links), rng.integers(0, 2, links).astype(float),
        (0.2, 0.02), placements(rng, 1, n + 1)[0], placements(rng, 5, n + 1), np.zeros((5, 6, n)),
    )  # fmt: skip


def margins_now(rng: Rng) -> Arguments:
    every, classes = 1 + some(rng), 1 + some(rng, 6)
    pairs, distance = chosen(rng, every), rng.uniform(0.0, 0.5, every)
    return (
        pairs,
        distance,
        rng.uniform(0.0, 0.2, every),
        rng.integers(0, classes, every),
        rng.uniform(0.0, 0.2, classes),
    )


def tightest_pair(rng: Rng) -> Arguments:
    pairs, *others = margins_now(rng)
    return pairs if len(pairs) else np.zeros(1, dtype=np.intp), *others


def known_apart(rng: Rng) -> Arguments:
    every, bodies = 1 + some(rng), 1 + joints(rng)
    points, faces = rng.normal(size=(every, 6)), rng.normal(size=(every, 15))
    faces[:, :9], faces[:, 12:] = rotation(rng).reshape(-1), rng.choice([0.1, np.inf], 3)
    for numbers in (points, faces):
        numbers[rng.random(every) < 0.4] = np.nan
    velocity = rng.normal(size=(every, 3)) * (rng.random((every, 1)) < 0.2)
    return (
        int(rng.integers(every)), rng.integers(0, bodies, every), rng.integers(0, bodies, every), velocity, points,
        faces, rng.normal(size=3), placements(rng, 1, bodies)[0],
    )  # fmt: skip


def hulls_apart(rng: Rng) -> Arguments:
    corners = np.ones((1 + some(rng, 9), 4))
    corners[:, :3] = rng.normal(size=(len(corners), 3))
    T = placements(rng, 1, 3)[0]
    return corners, 0.1, T[1], 3.0 + rng.normal(size=(some(rng, 9), 3)), 0.2, rng.normal(size=3), T[2]


def stalest_pair(rng: Rng) -> Arguments:
    pairs, distance, clearance, classes, odometer = margins_now(rng)
    renewed = odometer[classes] - rng.choice([0.001, 0.01, 0.1]) * rng.uniform(0.0, 1.0, len(distance))
    first, far = bool(rng.integers(2)), bool(rng.integers(2))
    return pairs, distance, clearance, renewed, classes, odometer, first, far, (0.1, 0.02, 0.05)


def lower_on_grid(rng: Rng) -> Arguments:
    counts = rng.integers(1, 6, 3)
    bounds = np.sort(rng.uniform(-1.0, 2.0, (2, 3)), axis=0)
    values = rng.uniform(0.0, 1.0, int(counts.prod())).astype(np.float32)
    return rng.uniform(-1.0, 3.0, (3, some(rng))), rng.uniform(-0.5, 0.5, 3), 2.5, counts, values, bounds


def off_turned_box(rng: Rng) -> Arguments:
    points = 2.0 * rng.normal(size=(3, some(rng)))
    return points, rotation(rng), rng.normal(size=3), rng.uniform(0.0, 1.0, 3), rng.uniform(0.0, 0.3)


def cells_of_tiles(rng: Rng) -> Arguments:
    """Cells in a heap of tiles, some of them empty."""
    counts = rng.integers(1, 6, 3)
    number = chosen(rng, int(counts.prod()))
    start = np.append(0, rng.integers(1, 5, len(number)).cumsum())
    low = 3.0 * rng.normal(size=3)
    _, R, of_link, half, radius = off_turned_box(rng)
    return (
        low, low + rng.uniform(0.0, 4.0, 3), rng.normal(size=3) - 2.0, rng.uniform(0.0, 0.2, 3), 0.7, counts, number,
        start, 2.0 * rng.normal(size=(3, len(number))), rng.uniform(0.0, 0.5, len(number)), R, of_link, half, radius,
        rng.choice([0.5, 3.0, np.inf]),
    )  # fmt: skip


def cells(rng: Rng) -> Arguments:
    cubes, triangles = (some(rng) * int(rng.integers(2)) for _ in range(2))
    return rng.normal(size=(3, cubes)), rng.uniform(0.0, 0.3, cubes), rng.normal(size=(3, 3, triangles))


def split_by_plane(rng: Rng) -> Arguments:
    middle, half, corners = cells(rng)
    while not len(half) and not corners.shape[2]:
        middle, half, corners = cells(rng)
    nearest = int(rng.integers(len(half) + corners.shape[2]))
    return rotation(rng)[0], nearest, rng.choice([1e-9, 0.5]), middle, half, corners


def boxes_of_cells(rng: Rng) -> Arguments:
    middle, half, corners = cells(rng)
    off = rng.uniform(0.0, 1.0, len(half) + corners.shape[2])
    rules = rng.uniform(0.0, 0.1), 0.15, 0.05, 1e-9
    return (
        5.0 + rng.normal(size=(1 + some(rng, 9), 3)), rotation(rng), middle, half, corners, off, some(rng, 16), rules,
        rotation(rng), rng.normal(size=3),
    )  # fmt: skip


def boxes_of_voxels(rng: Rng) -> Arguments:
    """Cells in two heaps of tiles."""

    def tiles() -> tuple[int, Arguments]:
        while True:
            _, _, origin, spread, edge, counts, number, start, middle, size, *_ = cells_of_tiles(rng)
            if len(number):
                return int(start[-1]), (origin, spread, edge, counts, number, start, middle, size)

    (coarse, of_coarse), (fine, of_fine) = tiles(), tiles()
    regions = np.array([[-5.0] * 3, [5.0] * 3, [-4.0] * 3, [4.0] * 3])
    return (
        rng.normal(size=(1 + some(rng, 9), 3)), rotation(rng), rotation(rng), 3.0 * rng.normal(size=3), rotation(rng),
        rng.normal(size=3), regions, (0.1, 0.15, 0.05, 1e-9, rng.uniform(0.1, 3.0), 0.5, 0.1), some(rng, 16),
        rng.normal(size=(3, coarse)), *of_coarse, rng.integers(-40, 40, (3, fine)).astype(np.int32),
        rng.normal(size=3), 0.05, *of_fine,
    )  # fmt: skip


def put_planes(rng: Rng) -> Arguments:
    every = 1 + some(rng)
    pairs = chosen(rng, every)
    numbers = rng.normal(size=(int(rng.integers(len(pairs) + 1)), 50))
    return (
        numbers, pairs, 0.1, rng.normal(size=(every, 3)), rng.normal(size=3),
        np.ascontiguousarray(placements(rng, 1, 2)[0, 1, :3]), 1e3, np.zeros((every, 4)), np.zeros(every),
        np.zeros((every, 6)), np.zeros((every, 15)), np.zeros((len(pairs), 6)),
    )  # fmt: skip


def extent_along(rng: Rng) -> Arguments:
    return rotation(rng), *cells(rng)


def force_on_hand(rng: Rng) -> Arguments:
    normal = rng.normal(size=3) * rng.integers(0, 2)
    state = (*rng.normal(size=6).tolist(), rng.uniform(0.0, 0.2), rng.uniform(0.0, 1.0))
    return rng.normal(size=3), rng.normal(size=3), normal, rng.uniform(), state, HandSettings(0.001, 60, 30, 200, 0.1)


def damped_steps(rng: Rng) -> Arguments:
    rows, n, count = int(rng.integers(1, 8)), joints(rng), some(rng)
    return rng.normal(size=(rows, n, count)), rng.normal(size=(rows, count)), rng.uniform(1e-3, 0.1, count)


def first_not_apart(rng: Rng) -> Arguments:
    n, own, around, pairs = joints(rng), 1 + some(rng, 5), some(rng, 5), some(rng)
    factors, slides = chain(rng, n)
    starts, corner_starts = (np.append(0, rng.integers(1, 4, count).cumsum()) for count in (own, own + around))
    balls, fine = rng.uniform(0.0, 0.5, (own, 4)), rng.uniform(0.0, 0.3, (int(starts[-1]), 4))
    axes = np.array([rotation(rng).ravel() for _ in range(around)]).reshape(-1, 9)
    half = rng.uniform(0.1, 1.0, (around, 3)) * rng.choice([1.0, -1.0], (around, 1))
    return (
        rng.normal(size=(some(rng, 6), n)), factors, slides, rng.integers(0, n + 1, own), balls, starts, fine,
        corner_starts, 0.3 * rng.normal(size=(3, int(corner_starts[-1]))), rng.uniform(0.0, 0.1, own + around),
        np.column_stack((axes, 3.0 * rng.normal(size=(around, 3)), half)), rng.integers(0, own, pairs),
        rng.integers(0, own + around, pairs), rng.uniform(0.0, 0.1, pairs), np.zeros((pairs, 3)),
    )  # fmt: skip


def ball_bounds(rng: Rng) -> Arguments:
    q, factors, slides, joint, _, starts, fine, _, _, radius, boxes, first, second, _, _ = first_not_apart(rng)
    return q, factors, slides, joint, starts, fine, boxes, radius[len(joint) :], first, second


def ways_of_pairs(rng: Rng) -> Arguments:
    q, factors, slides, joint, starts, fine, _, _, first, _ = ball_bounds(rng)
    travel = rng.uniform(0.0, 3.0, (len(first), q.shape[1]))
    return q, factors, slides, joint, starts, fine, travel, first, rng.random(len(first)) < 0.5


def pairs_not_apart(rng: Rng) -> Arguments:
    q, *rest = first_not_apart(rng)
    return rng.normal(size=(1, q.shape[1])), *rest


def distances_within(rng: Rng) -> Arguments:
    q, *rest = first_not_apart(rng)
    pairs = len(rest[-1])
    known = rng.choice([-np.inf, 0.1, 5.0], (len(q), pairs))
    sense = rng.integers(-1, 2, (pairs, q.shape[1])).astype(float)
    return rng.uniform(0.0, 2.0, len(q)), known, sense, q, *rest


def fastest_run(rng: Rng) -> Arguments:
    """A path that can be timed in most cases."""
    count = 1 + some(rng)
    grid, ends = np.append(0.0, rng.uniform(0.5, 1.5, count).cumsum()), []
    for rows in rng.integers(1, 6, 2).tolist():
        alpha = rng.normal(size=(count, rows)) * rng.integers(0, 5, (count, rows)).clip(0, 1)
        ends += [alpha, 0.3 * rng.normal(size=(count, rows)), rng.uniform(0.1, 1.0, (count, rows))]
    return grid, rng.uniform(0.5, 4.0, count + 1), *ends, bool(rng.integers(2))


def rods(rng: Rng) -> tuple[Any, Any, tuple[Any, Any]]:
    """Moment arms of cylinders, some at a dead centre, the joints that they move, and their areas."""
    n = joints(rng)
    joint_of = np.sort(rng.integers(0, n, int(rng.integers(1, n + 2)))).astype(np.intp)
    arms = rng.normal(size=(some(rng), len(joint_of)))
    arms[rng.random(arms.shape) < 0.1] = 0.0
    return arms, joint_of, (rng.uniform(1e-3, 1e-2, len(joint_of)), rng.uniform(1e-3, 1e-2, len(joint_of)))


def rod_limits(rng: Rng) -> Arguments:
    arms, joint_of, areas = rods(rng)
    joints_there = int(joint_of.max()) + 2
    return arms, joint_of, *areas, rng.uniform(1e-4, 1e-2, len(joint_of)), 2.5e7, 4e-3, joints_there


def rod_limit_slopes(rng: Rng) -> Arguments:
    arms, *others = rod_limits(rng)
    return arms, rng.normal(size=arms.shape), *others


def rod_forces(rng: Rng) -> Arguments:
    arms, joint_of, _ = rods(rng)
    return arms, joint_of, 1e4 * rng.normal(size=(len(arms), int(joint_of.max()) + 1))


def least_supplied(rng: Rng) -> Arguments:
    n, boxes = min(joints(rng), 4) if joints(rng) < 40 else 9, some(rng)
    amounts = np.cumsum(rng.uniform(0.1, 1.0, (3**n, 7)), axis=1) - 0.1
    return rng.uniform(0.0, 3.0, (boxes, n)), rng.integers(0, 3, (boxes, n)), amounts, np.linspace(0.0, 1.0, 7)


def oil_taken(rng: Rng) -> Arguments:
    arms, joint_of, torques = rod_forces(rng)
    areas = rng.uniform(1e-3, 1e-2, (2, len(joint_of)))
    return arms, joint_of, *areas, rng.normal(size=torques.shape), torques


def rod_flow_slopes(rng: Rng) -> Arguments:
    arms, joint_of, areas = rods(rng)
    v = rng.normal(size=(len(arms), int(joint_of.max()) + 1))
    v[rng.random(v.shape) < 0.1] = 0.0
    return arms, rng.normal(size=arms.shape), joint_of, *areas, v


def chain_placements(rng: Rng) -> Arguments:
    n, count = joints(rng), some(rng)
    q = rng.normal(size=(n, count))
    factors, slides = chain(rng, n)
    return q, np.sin(q), 1.0 - np.cos(q), factors, slides, np.vstack((rotation(rng), rng.normal(size=3)))


def chain_energies(rng: Rng) -> Arguments:
    n, count = joints(rng), some(rng)
    bodies = rng.normal(size=(n, 10))
    bodies[:, 0] = rng.uniform(0.0, 5.0, n)
    return *rng.normal(size=(2, count, n)), *chain(rng, n), bodies, rng.normal(size=3)


def chain_torques(rng: Rng) -> Arguments:
    q, *others = chain_energies(rng)
    return q, rng.normal(size=q.shape), *others


def chain_torque_slopes(rng: Rng) -> Arguments:
    return chain_torques(rng)


def contracted(rng: Rng) -> Arguments:
    n, boxes = joints(rng), some(rng)
    group = np.repeat(np.arange(3), rng.integers(0, 4, 3))
    m = len(group)
    H = 0.3 * rng.normal(size=(boxes, m, n, n))
    slack = rng.uniform(0.0, 0.1, (boxes, 3))
    slack[rng.random(slack.shape) < 0.1] = np.inf
    return (
        0.5 * rng.normal(size=(boxes, m)), rng.normal(size=(boxes, m, n)), H + np.swapaxes(H, 2, 3), slack, group,
        rng.uniform(0.0, 0.5, (boxes, n)),
    )  # fmt: skip


def missed_up_to(rng: Rng) -> Arguments:
    """Of boxes inside and outside of what is reached, with levels from 0 to 20."""
    *features, half = contracted(rng)
    start, middle = rng.normal(size=half.shape[1]), 0.5 * rng.normal(size=half.shape)
    reach = np.linspace(0.0, 1.5, 21)[:, None] * rng.uniform(0.5, 1.5, half.shape[1])
    known = rng.integers(0, 20, len(half))
    return *features, middle, middle - half, middle + half, start - reach, start + reach, known


def second_order(rng: Rng) -> Arguments:
    n, boxes = joints(rng), some(rng)
    hinge = rng.integers(0, 2, n).astype(float)
    bound = rng.uniform(0.5, 4.0, n)
    bound[rng.random(n) < 0.3] = np.inf
    return *rng.normal(size=(2, boxes, n, 3)), rng.uniform(0.0, 0.5, (boxes, n)), hinge, bound


def linkage_arms(rng: Rng) -> Arguments:
    """Triangles, and four-bars of which some do not close."""
    n, cylinders = joints(rng), int(rng.integers(1, 5))
    constants = rng.uniform(0.2, 1.0, (cylinders, 11))
    constants[:, 2] = rng.uniform(-3.0, 3.0, cylinders)
    constants[:, 4:6], constants[:, 7] = rng.uniform(-0.3, 0.3, (cylinders, 2)), rng.uniform(0.3, 0.8, cylinders)
    constants[:, 10] = rng.integers(-1, 2, cylinders)
    return rng.normal(size=(some(rng), n)), rng.integers(0, n, cylinders), constants


def linkage_arm_slopes(rng: Rng) -> Arguments:
    return linkage_arms(rng)


def solve_poses(rng: Rng) -> Arguments:
    """Poses, or positions alone, that most searches reach within the limits, and some that are out of reach."""
    n, count = joints(rng), some(rng)
    factors, slides = chain(rng, n)
    tip = np.vstack((rotation(rng), rng.normal(size=3)))
    q = rng.uniform(-1.0, 1.0, (count, n))
    at = place_chain(q, factors, slides, tip, prismatic=slides != 0.0, sense=0.0, pin=None)
    position, turned = at.tip_position.copy(), np.ascontiguousarray(at.tip_rotation)
    position[:: rng.integers(2, 9)] *= rng.choice([1.0, 30.0])
    settings = (1e-8, 0.98, 8.0, 0.1, 1e-2, 1e-12, 0.6, 1e-9, 1e-12, -0.9)
    return (
        q + rng.choice([0.05, 0.2]) * rng.normal(size=q.shape), position, turned[: count * int(rng.integers(2))],
        factors, slides, tip, np.full(n, -1.0), np.full(n, rng.choice([1.0, 4.0])), settings, int(rng.integers(0, 5)),
    )  # fmt: skip


def nearest_on_ground(rng: Rng) -> Arguments:
    rows, columns = rng.integers(2, 9, 2)
    x, y = (np.sort(rng.uniform(-2.0, 2.0, count)) for count in (columns, rows))
    hull = rng.normal([0.0, 0.0, 2.0], 1.0, (1 + some(rng, 9), 3))
    return hull, rng.uniform(0.0, 0.1), 0.3 * rng.normal(size=(rows, columns)), x, y, rng.choice([0.5, 5.0])


def cheapest_with_turns(rng: Rng) -> Arguments:
    layers, width = int(rng.integers(2, 7)), int(rng.integers(1, 6))
    steps = rng.uniform(0.0, 1.0, (layers - 1, width, width))
    steps[rng.random(steps.shape) < 0.1] = np.inf
    closed = np.where(rng.random((layers, width)) < 0.2, np.inf, 0.0)
    return steps, rng.normal(size=(joints(rng), layers - 1, width, width)), closed, rng.uniform(0.0, 1.0)


def nearest_on_cells(rng: Rng) -> Arguments:
    """A hull near a few triangles or cubes, in a tree of four leaves."""
    cells, half = rng.normal(size=(some(rng, 9), int(rng.choice([3, 9])))), rng.uniform(0.0, 0.5)
    corners = cells if cells.shape[1] == 9 else np.tile(cells, 2) + half * np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
    boxes = np.full((8, 6), np.inf)
    boxes[:, 3:] = -np.inf
    for leaf in range(4):
        own = corners[4 * leaf : 4 * leaf + 4].reshape(-1, 3)
        if len(own):
            boxes[4 + leaf] = *own.min(axis=0), *own.max(axis=0)
    for node in (3, 2, 1):
        children = boxes[2 * node : 2 * node + 2]
        boxes[node] = *children[:, :3].min(axis=0), *children[:, 3:].max(axis=0)
    hull = rng.normal([0.0, 0.0, 3.0], 1.0, (1 + some(rng, 9), 3))
    return hull, rng.uniform(0.0, 0.1), boxes, cells, 4, half, rng.choice([0.5, 5.0])


def read_over_ground(rng: Rng) -> Arguments:
    """Pieces with a few corners each, over, in and beside uneven ground."""
    configurations, carriers, pieces, asked = 1 + some(rng, 3), 1 + some(rng, 2), 1 + some(rng, 3), some(rng)
    starts = np.append(0, rng.integers(1, 6, pieces).cumsum())
    rows, columns = rng.integers(2, 9, 2)
    R = np.array([[rotation(rng) for _ in range(carriers)] for _ in range(configurations)])
    t = rng.normal([0.0, 0.0, 1.0], 0.7, (configurations, carriers, 3))
    return (
        R, t, rng.integers(0, carriers, pieces), rng.normal(scale=0.3, size=(starts[-1], 3)), starts,
        rng.uniform(0.0, 0.1, pieces), np.sort(rng.integers(0, configurations, asked)), rng.integers(0, pieces, asked),
        rng.uniform(-0.1, 0.8, asked), rotation(rng), rng.normal(scale=0.1, size=3),
        0.2 * rng.normal(size=(rows, columns)), np.linspace(-1.5, 1.5, columns), np.linspace(-2.0, 2.0, rows),
        (-1.0, 0.8),
    )  # fmt: skip


def kept_over_ground(rng: Rng) -> Arguments:
    asked = read_over_ground(rng)
    ball_starts = np.append(0, rng.integers(1, 4, len(asked[5])).cumsum())
    balls = np.column_stack((rng.normal(scale=0.3, size=(ball_starts[-1], 3)), rng.uniform(0.1, 0.5, ball_starts[-1])))
    return *asked, balls, ball_starts, *lower_over_heights(rng)[1:]


def least_on_grid(rng: Rng) -> Arguments:
    asked = kept_over_ground(rng)[:17]
    starts = np.append(0, rng.integers(1, 6, len(asked[5])).cumsum())
    fine = np.column_stack((rng.normal(scale=0.3, size=(starts[-1], 3)), rng.uniform(0.05, 0.2, starts[-1])))
    return *asked[:11], *asked[15:], fine, starts, *lower_on_grid(rng)[1:]


def kept_over_cells(rng: Rng) -> Arguments:
    counts = rng.integers(1, 5, 3)
    sides = rng.integers(0, 3, int(counts.prod())).astype(np.uint8)
    return *least_on_grid(rng), *nearest_on_cells(rng)[2:6], rng.uniform(-1.5, -0.5, 3), 2.0, counts, sides


def read_over_cells(rng: Rng) -> Arguments:
    return *read_over_ground(rng)[:11], *kept_over_cells(rng)[20:]


def lower_over_heights(rng: Rng) -> Arguments:
    counts, rings = rng.integers(1, 6, 2), 1 + some(rng, 4)
    highest = np.sort(rng.normal(size=(int(counts.prod()), rings)), axis=1).astype(np.float32)
    aside = np.append(0.0, rng.uniform(0.0, 0.5, rings - 1).cumsum())
    bounds = np.array([[-1.0, -1.0, -3.0], [1.0, 1.0, 1.0]])
    return (
        2.0 * rng.normal(size=(3, some(rng))), rng.uniform(-1.0, 0.0, 2), rng.uniform(1.0, 4.0, 2), counts, highest,
        aside**2, float(aside[-1]), bounds,
    )  # fmt: skip


SOURCES: list[Callable[[Rng], Arguments]] = [
    approach_rates, ball_bounds, bend_in_parts, binding_corners, blended_points, bounds_after, box_urgency,
    boxes_of_cells, boxes_of_voxels, braking_line, cells_of_tiles, chain_energies, chain_placements,
    chain_torque_slopes, chain_torques, changes_of_end, cheapest_with_turns, contracted, corner_gaps, cost_of_tip,
    count_travel, damped_steps, distances_within, extent_along, fastest_run, first_not_apart, force_on_hand,
    gaps_along_path, hulls_apart, inexact_boxes, keep_placements, keep_proven, keeps_rows, kept_over_cells,
    kept_over_ground, known_apart, largest_part, least_on_grid, least_over_path, least_supplied, left_over_path,
    line_ahead, linkage_arm_slopes, linkage_arms, lower_on_grid, lower_over_heights, margins_now, missed_up_to,
    most_urgent_boxes, near_gaps, near_now, near_rows, nearest_on_cells, nearest_on_ground, nearest_rows,
    nearest_safe_program, next_within, not_proven, note_gaps, off_turned_box, oil_taken, pairs_not_apart,
    pairs_within, place_on_line, place_tip, placed_arrays, plane_rows, put_planes, quick_terms, reach_of_lead,
    reachable_velocities, read_over_cells, read_over_ground, read_results, rod_flow_slopes, rod_forces,
    rod_limit_slopes, rod_limits, rows_by_velocity, rows_of_path, second_order, soft_solution,
    solve_poses, split_by_plane, stalest_pair,
    step_conditions, straight_towards, tightest_pair, turn_along_surface, unproven_of_near, velocity_held_as_before,
    velocity_within_rows, ways_of_links, ways_of_pairs,
]  # fmt: skip


# functions whose integers are not indices, or too many to check
UNLOOKED = pairs_within, cells_of_tiles, boxes_of_voxels, lower_on_grid

# functions that write to their last arguments, and how many of them
WRITERS: dict[Callable[[Rng], Arguments], int] = {
    corner_gaps: 1, count_travel: 3, gaps_along_path: 3, keep_placements: 2, keep_proven: 1, near_gaps: 1, note_gaps: 1,
    most_urgent_boxes: 2, place_on_line: 2, place_tip: 2,
    put_planes: 5,
}  # fmt: skip


# Functions that may answer instead of coal. Their plain versions leave the answer to coal, with which they are compared
# in tests/machine/test_clusters.py, tests/site/test_clearance_screen.py, tests/site/test_over_ground.py,
# tests/site/test_beside_solids.py.
OF_COAL = (
    first_not_apart, pairs_not_apart, boxes_of_cells, boxes_of_voxels, hulls_apart, nearest_on_ground, nearest_on_cells,
    distances_within, kept_over_ground, kept_over_cells, read_over_cells, read_over_ground,
)  # fmt: skip

WITHOUT_JOINTS = (  # of these, those that answer whatever the number of joints
    boxes_of_cells, boxes_of_voxels, hulls_apart, nearest_on_ground, nearest_on_cells, kept_over_ground,
    kept_over_cells, read_over_cells, read_over_ground,
)  # fmt: skip


def copied(arguments: Arguments) -> Arguments:
    return tuple(one.copy(order="K") if isinstance(one, np.ndarray) else one for one in arguments)


def same(found: Any, plain: Any) -> bool:
    """Whether two results are equal within rounding and have the same kind, shape and type."""
    if isinstance(plain, tuple):
        return isinstance(found, tuple) and len(found) == len(plain) and all(map(same, found, plain))
    if isinstance(plain, np.ndarray):
        alike = isinstance(found, np.ndarray) and found.shape == plain.shape and found.dtype == plain.dtype
        return alike and np.allclose(found, plain, rtol=1e-9, atol=1e-11, equal_nan=True)
    if plain is None or isinstance(plain, bool | int):
        return bool(found == plain)
    return math.isclose(found, plain, rel_tol=1e-9, abs_tol=1e-11)


def agree(source: Callable[[Rng], Arguments], found: Any, plain: Any) -> bool:
    """As `same`; of two solvers only the solutions, within the tolerance of the general one."""
    if source not in (soft_solution, velocity_within_rows, velocity_held_as_before) or plain is None:
        return same(found, plain)
    counts = all(isinstance(count, int) for count in found[1:]) and len(found) == len(plain)
    return counts and bool(np.allclose(found[0], plain[0], rtol=0.0, atol=2e-6))


def test_every_marked_function_has_random_arguments() -> None:
    assert sorted(plain_versions()) == [source.__name__ for source in SOURCES]


@needs_native
@pytest.mark.parametrize(
    "source", [one for one in SOURCES if one not in OF_COAL], ids=lambda source: str(source.__name__)
)
def test_compiled_and_plain_versions_agree(source: Callable[[Rng], Arguments]) -> None:
    rng = np.random.default_rng(7)
    plain, compiled = plain_versions()[source.__name__], getattr(find_compiled(), source.__name__)
    answered = 0
    for _ in range(40):
        arguments = source(rng)
        for_plain, for_compiled = copied(arguments), copied(arguments)
        expected, found = plain(*for_plain), compiled(*for_compiled)
        if source is quick_terms and expected is None:  # the plain version leaves the answer to the general law
            continue
        answered += 1
        assert agree(source, found, expected)
        if source in WRITERS:
            written = WRITERS[source]
            assert same(for_compiled[-written:], for_plain[-written:])
    assert answered > 25


@needs_native
@pytest.mark.parametrize("source", SOURCES, ids=lambda source: str(source.__name__))
def test_compiled_versions_refuse_arrays_of_wrong_type_shape_or_index_range(source: Callable[[Rng], Arguments]) -> None:
    """Such an array is refused before it is read."""
    rng = np.random.default_rng(11)
    compiled = getattr(find_compiled(), source.__name__)
    with pytest.raises(TypeError, match="takes"):
        compiled()
    refused, plain = 0, plain_versions()[source.__name__]
    for _ in range(6):
        arguments = source(rng)
        for place, one in enumerate(arguments):
            if isinstance(one, np.ndarray):
                swapped = one.astype(one.dtype.newbyteorder())  # the other byte order
                other_kind = np.float32 if one.dtype != np.float32 else float
                wrong: list[Any] = [one.astype(other_kind), one[None], *([swapped] if one.dtype.itemsize > 1 else [])]
                if one.dtype.kind == "i" and len(one):
                    wrong += [one - 10**6, one + 10**6] if source not in UNLOOKED else []
                for other in wrong:
                    refused += 1
                    with pytest.raises((TypeError, ValueError, IndexError)):
                        compiled(*arguments[:place], other, *arguments[place + 1 :])
                for axis in [axis for axis, length in enumerate(one.shape) if length]:
                    shorter = (*arguments[:place], np.delete(one, -1, axis), *arguments[place + 1 :])
                    try:
                        found = compiled(*copied(shorter))
                    except (TypeError, ValueError, IndexError):
                        refused += 1
                    else:  # a shorter array may be valid
                        expected = plain(*copied(shorter))
                        left_open = source in OF_COAL or (source is quick_terms and expected is None)
                        assert left_open or agree(source, found, expected)
    assert refused > 5


@needs_native
@pytest.mark.parametrize(
    "source", [one for one in SOURCES if one not in WITHOUT_JOINTS], ids=lambda source: str(source.__name__)
)
def test_with_40_joints_the_compiled_versions_agree_with_the_plain_ones(
    source: Callable[[Rng], Arguments], monkeypatch: pytest.MonkeyPatch
) -> None:
    """That is more than the compiled versions have room for: the plain version answers."""
    monkeypatch.setattr(sys.modules[__name__], "joints", lambda _: 40)
    rng = np.random.default_rng(17)
    plain, compiled = plain_versions()[source.__name__], getattr(find_compiled(), source.__name__)
    for _ in range(2):
        arguments = source(rng)
        found, expected = compiled(*copied(arguments)), plain(*copied(arguments))
        assert agree(source, found, expected)


@needs_native
def test_compiled_and_plain_versions_read_the_same_depths_in_ground() -> None:
    """The plain version leaves other distances to coal."""
    rng, depths = np.random.default_rng(7), 0
    for _ in range(100):
        arguments = read_over_ground(rng)
        states, found = find_compiled().read_over_ground(*arguments)  # type: ignore[union-attr]
        plain_states, plain = plain_versions()["read_over_ground"](*arguments)
        sunk = plain_states == 2
        np.testing.assert_array_equal(states == 2, sunk)
        np.testing.assert_allclose(found[sunk], plain[sunk], atol=1e-12)
        depths += int(sunk.sum())
    assert depths > 100


@needs_native
@pytest.mark.parametrize(
    ("source", "outputs"), [(corner_gaps, 1), (keep_placements, 2), (keep_proven, 1), (note_gaps, 1), (place_tip, 2)]
)
def test_read_only_outputs_are_refused_and_stay_unchanged(source: Callable[[Rng], Arguments], outputs: int) -> None:
    """By both versions; the last arguments are the outputs."""
    rng = np.random.default_rng(13)
    for function in (plain_versions()[source.__name__], getattr(find_compiled(), source.__name__)):
        for place in range(-outputs, 0):
            arguments = copied(source(rng))
            arguments[place].flags.writeable = False
            before = arguments[place].copy()
            with pytest.raises(ValueError, match=r"read-only|not acceptable"):
                function(*arguments)
            assert np.array_equal(arguments[place], before)


@needs_native
@pytest.mark.parametrize("rows", [3, 6])
@pytest.mark.parametrize("least", [0.5, 0.0801, 0.0799, 0.01, 1e-3, 0.0])
def test_the_compiled_law_equals_the_general_one_for_seven_joints(panda: Robot, rows: int, least: float) -> None:
    """A task of three or six, the smallest singular value on both sides of the threshold of damping.

    The plain quick version covers a one-dimensional null space away from singularities, the compiled one all cases.
    """
    rng, law, at = np.random.default_rng(3), CompletedLaw(panda, influence=0.5), Kinematics(panda).at(np.zeros(7))
    for _ in range(10):
        s = np.append(rng.uniform(0.6, 1.5, rows - 1), least)
        U, V = (np.linalg.qr(rng.normal(size=(size, size)))[0] for size in (rows, 7))
        J, xdot = (U * s).dot(V[:rows]), rng.normal(size=rows)
        nearby = CriticalRows(rng.uniform(-0.05, 0.7, 9), rng.normal(size=(9, 7)), 0.1 * rng.normal(size=9))
        found, wish = law.quick_terms_unchecked(at.q, J, xdot, nearby), law.wish(at, J, xdot, nearby)
        assert found is not None
        assert found[0] == pytest.approx(wish.primary, rel=1e-10, abs=1e-11)
        assert found[1] == pytest.approx(wish.null, rel=1e-10, abs=1e-11)
        assert found[2] == pytest.approx(0.08 * np.sqrt(1.0 - (least / 0.08) ** 2) if least < 0.08 else 0.0, abs=1e-12)


@needs_native
@pytest.mark.parametrize("s", [(1.0, 1.0, 1.0, 0.01, 0.01, 0.01), (1.0, 1.0, 1.0, 0.5, 0.0, 0.0), (2.0, 2.0, 0.01)])
def test_the_compiled_law_equals_the_general_one_with_equal_singular_values(panda: Robot, s: tuple[float, ...]) -> None:
    rng, law, at = np.random.default_rng(0), CompletedLaw(panda, influence=0.5), Kinematics(panda).at(np.zeros(7))
    nothing = CriticalRows(np.zeros(0), np.zeros((0, 7)), np.zeros(0))
    for _ in range(150):
        U, V = (np.linalg.qr(rng.normal(size=(size, size)))[0] for size in (len(s), 7))
        J, xdot = (U * s).dot(V[: len(s)]), rng.normal(size=len(s))
        found = law.quick_terms_unchecked(at.q, J, xdot, nothing)
        assert found is not None
        assert found[0] == pytest.approx(law.wish(at, J, xdot, nothing).primary, rel=1e-9, abs=1e-10)


# --- plain versions by hand -------------------------------------------------------------------


def test_bounds_decrease_by_travel_times_the_motion_of_each_joint() -> None:
    """3 - (2 * 0.5 + 1 * 0.25) and 1 - (0 * 0.5 + 4 * 0.25)."""
    bounds = plain_versions()["bounds_after"]
    travel = np.array([[2.0, 1.0], [0.0, 4.0]])
    assert bounds(np.array([3.0, 1.0]), travel, np.array([1.0, 1.0]), np.array([0.5, 1.25])).tolist() == [1.75, 0.0]


def test_a_pair_is_proven_if_its_margin_exceeds_the_travel() -> None:
    """Two radians at 0.5 m/rad and 0.1 s at 1 m/s use 1.1 m: the pair with a margin of 1.0 m is not proven."""
    unproven = plain_versions()["unproven_of_near"]
    pairs, travel, speed = np.array([4, 7]), np.full((8, 1), 0.5), np.ones(8)

    def asked(beyond: float) -> Any:
        left, q = np.array([1.2, 1.0]), np.zeros(1)
        return unproven(pairs, left, beyond, travel, speed, np.array([0.5]), 1.0, q, q + 2.0, 0.1, 0.0)

    assert asked(1.3).tolist() == [7]
    assert asked(1.0) is None  # other pairs may have a smaller margin than they use


def test_a_gap_is_the_distance_from_the_plane_to_the_nearest_corner() -> None:
    """Corners at x = 1 and 2 on a link that is shifted by 0.5 along x, and a wall at x = 4: 2.5 and 1.5 m."""
    gaps, T = np.zeros((1, 1, 2)), np.tile(np.eye(4), (1, 2, 1, 1))
    T[0, 1, 0, 3] = 0.5
    columns = np.array([[[1.0, 2.0], [0.0, 0.0], [0.0, 0.0], [1.0, 1.0]]])
    first, link = np.zeros(1, dtype=np.intp), np.ones(1, dtype=np.intp)
    planes = np.array([[-1.0, 0.0, 0.0, 4.0]])
    nearest, least = plain_versions()["corner_gaps"](first, planes, link, None, first, columns, T, None, 0.0, gaps)
    assert gaps.tolist() == [[[2.5, 1.5]]]
    assert (nearest.tolist(), least.tolist()) == ([[1]], [[1.5]])


def test_the_distance_required_of_a_fixed_pair_does_not_decrease() -> None:
    """Required: 0.03 m, at most 0.1 m. With 0.02 m proven, a fixed pair still requires 0.03 m, a moving one 0.02 m."""
    required, pairs = np.full(3, 0.03), np.arange(3)
    bound, stands = np.array([0.02, 0.02, 0.4]), np.array([True, False, True])
    plain_versions()["keep_proven"](pairs, bound, np.full(3, 0.1), stands, required)
    assert required.tolist() == [0.03, 0.02, 0.1]


def test_travel_adds_the_motion_of_each_joint_times_its_radius() -> None:
    """Radii of 1 and 3 m, joints that turn by 0.1 and -0.2 rad: 0.7 m; without the path's motion its travel stays."""
    start, path, proven = np.array([5.0]), np.array([2.0]), np.array([0.4])
    travel, moved, nobody = np.array([[1.0, 3.0]]), np.array([0.1, -0.2]), np.zeros(1, dtype=np.intp)
    count = plain_versions()["count_travel"]
    moved_by, most, on_path = count(travel, moved, None, nobody, np.array([0.3]), nobody, start, path, proven)
    assert (moved_by[0], most, on_path) == pytest.approx((0.7, 0.7, 0.0))
    assert (start[0], path[0], proven[0]) == pytest.approx((5.7, 2.0, 0.4))
    assert count(travel, moved, moved, nobody, np.array([0.3]), nobody, start, path, proven)[2] == pytest.approx(0.7)
    assert (start[0], path[0], proven[0]) == pytest.approx((6.4, 2.7, 3.0))


def test_compiled_functions_of_another_version_are_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("BACKHOE_PLANNER_PLAIN", raising=False)
    monkeypatch.setitem(sys.modules, "backhoe_planner_native", SimpleNamespace(INTERFACE=-1))
    assert find_compiled.__wrapped__() is None


def test_functions_missing_in_the_installed_compiled_package_run_in_plain_python(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def later(x: float, /) -> float:
        return 2.0 * x

    older = SimpleNamespace(plain={})
    monkeypatch.setattr(native, "find_compiled", lambda: older)
    monkeypatch.setattr(native, "_plain", {})
    assert native.compiled(later) is later


def test_an_environment_variable_turns_compiled_functions_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BACKHOE_PLANNER_PLAIN", "1")
    assert find_compiled.__wrapped__() is None


def test_the_version_says_whether_compiled_functions_are_used() -> None:
    assert (native_version() is None) == (find_compiled() is None)
