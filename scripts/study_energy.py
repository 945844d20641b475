#!/usr/bin/env python
"""How much work the global optimum saves against local laws, on seeded straight paths of a backhoe.

Every case is a straight path of the bucket tip, 1 to 5 m long, position only, from a
random posture of the machine. It is planned twice, from that posture and with the start
left free, and each motion is held against two local laws that begin at the same posture
and keep the plan's own timing: the pseudo-inverse (least velocity norm, blind to limits)
and the completed law (keeps the limits, and may get stuck). A path counts only if it can
be followed at all from its posture. The results are in docs/measurements.md.

    python scripts/study_energy.py                 # the table of savings
    python scripts/study_energy.py --convergence   # the same costs on three grids
    python scripts/study_energy.py --time          # 200 samples among 5 obstacles
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.motion import PathCost, Problem, TipPath, Trajectory, build_problem, trajectory_costs
from backhoe_planner.planning import (
    PathResolver,
    Stretch,
    cheapen_stretch,
    law_motion,
    least_norm_resolution,
    resolve_along,
)

SHORTEST, LONGEST = 1.0, 5.0  # m
SPEED = 0.4  # m/s
GRIDS = ((5.0, 0.2), (2.5, 0.2), (1.25, 0.2))  # deg of pitch, m of path between layers


@dataclass(frozen=True)
class Case:
    """A posture, and where the tip goes from it, (3,) each [m]."""

    q: tuple[float, ...]
    begin: tuple[float, ...]
    end: tuple[float, ...]

    def scene(self, *, free: bool, objective: str = "work") -> bp.Scene:
        """The path as a scene, with the start at the posture or left free."""
        content: dict[str, Any] = {
            "version": 1,
            "objective": objective,
            "task": {"path": {"waypoints": [{"position": self.begin}, {"position": self.end}], "speed": SPEED}},
        }
        if not free:
            content["start"] = {"joints": dict(zip(("swing", "boom", "stick", "bucket"), self.q, strict=True))}
        return bp.scene_from_dict(content)


@dataclass(frozen=True)
class Result:
    """Work in [J]: of the two optima, each beside the laws at its own timing."""

    same: float
    same_least_norm: float | None
    same_law: float | None
    free: float
    free_least_norm: float | None
    free_law: float | None
    least_norm_breaks: bool
    law_stuck: bool
    verified: bool

    @property
    def worse(self) -> bool:
        """Whether, from the same start, a law that keeps the limits needs less."""
        laws = [self.same_law, None if self.least_norm_breaks else self.same_least_norm]
        return any(law is not None and _exceeds(self.same, law) for law in laws)


def _exceeds(optimum: float, law: float) -> bool:
    """Beyond what inertia, which the search leaves out, makes of nearly nothing: 0.1 % and 1 J."""
    return optimum > law * 1.001 + 1.0


def draw(robot: bp.Robot, seed: int) -> Iterator[Case]:
    """Cases, without end; not all can be followed."""
    rng = np.random.default_rng(seed)
    kinematics = bp.Kinematics(robot)
    proximity = bp.Proximity(robot, ())
    while True:
        q = robot.random_q(rng)
        direction = rng.standard_normal(3)
        length = rng.uniform(SHORTEST, LONGEST)
        begin = np.array(kinematics.at(q).tip_position)
        end = begin + length * direction / np.linalg.norm(direction)
        inside = bp.solve_inverse_kinematics(robot, bp.TipTarget(end))
        if inside.reached and bool(np.all(proximity.distances(q) >= proximity.clearance)):
            yield Case(tuple(q.tolist()), tuple(begin.tolist()), tuple(end.tolist()))


def _work(problem: Problem, motion: Trajectory) -> float:
    return trajectory_costs(problem, motion)["work"]


def _follows(plan: bp.Plan) -> bool:
    return plan.verified and not plan.certificate.detours


def measure(robot: bp.Robot, case: Case) -> Result | None:
    """One case; None where it cannot be followed from its posture."""
    same = bp.plan(robot, case.scene(free=False), method="optimal")
    if not _follows(same):
        return None
    free = bp.plan(robot, case.scene(free=True), method="optimal")
    if not _follows(free):
        print(f"start left free, not verified: {free.message}")
    problem = build_problem(robot, case.scene(free=False))
    path = problem.path
    assert path is not None
    kinematics = bp.Kinematics(robot)
    begin = np.array(case.q)
    blind = least_norm_resolution(problem, path, begin, kinematics=kinematics)
    law = resolve_along(problem, path, 0.0, begin, proximity=bp.Proximity(robot, ()), kinematics=kinematics)
    found: list[float | None] = []
    for plan in (same, free):
        motion = plan.trajectory
        found.append(_work(problem, motion))
        for other in (blind, law if law.obstruction is None else None):
            moved = None if other is None else law_motion(path, other, motion, kinematics=kinematics)
            found.append(None if moved is None else _work(problem, moved))
    assert found[0] is not None
    assert found[3] is not None
    breaks = blind is None or blind.obstruction is not None
    return Result(
        same=found[0], same_least_norm=found[1], same_law=found[2],
        free=found[3], free_least_norm=found[4], free_law=found[5],
        least_norm_breaks=breaks, law_stuck=law.obstruction is not None, verified=_follows(free),
    )  # fmt: skip


def study(robot: bp.Robot, *, paths: int, seed: int) -> None:
    """Print the table of savings."""
    results: list[Result] = []
    drawn = 0
    for case in draw(robot, seed):
        drawn += 1
        result = measure(robot, case)
        if result is not None and result.worse:
            print(f"case {drawn - 1} is worse than a law that keeps its limits: {result}")
        if result is not None:
            results.append(result)
        if len(results) >= paths:
            break
    print(
        f"{len(results)} straight paths of {drawn} drawn ({drawn - len(results)} cannot be followed from their posture)"
    )
    print(f"{'start':<6} {'law':<15} {'paths':>5} {'law [kJ]':>9} {'optimum [kJ]':>12} {'saving':>8} {'worse':>6}")
    for start in ("same", "free"):
        for name, kept in (("least_norm", False), ("least_norm", True), ("law", False)):
            rows = [
                (getattr(r, f"{start}_{name}"), getattr(r, start))
                for r in results
                if getattr(r, f"{start}_{name}") is not None
                and (start == "same" or r.verified)
                and not (kept and r.least_norm_breaks)
            ]
            laws, optima = (sum(column) / 1e3 for column in zip(*rows, strict=True))
            worse = sum(_exceeds(optimum, law) for law, optimum in rows)
            named = {"least_norm": "pseudo-inverse", "law": "completed law"}[name] + (" *" if kept else "")
            print(
                f"{start:<6} {named:<16} {len(rows):>4} {laws:>9.1f} {optima:>12.1f} "
                f"{100.0 * (1.0 - optima / laws):>6.1f} % {worse:>6}"
            )
    print("* where it keeps every joint limit")
    print(f"the pseudo-inverse breaks a joint limit on {sum(r.least_norm_breaks for r in results)} paths")
    print(f"the completed law gets stuck on {sum(r.law_stuck for r in results)} paths")
    print(f"optima with a free start that are not verified: {sum(not r.verified for r in results)}")


def convergence(robot: bp.Robot, *, paths: int, seed: int) -> None:
    """Print the sum of costs on three grids, with and without what comes after the grid."""
    totals: NDArray[np.float64] = np.zeros((len(GRIDS), 2))
    count = 0
    for case in draw(robot, seed):
        problem = build_problem(robot, case.scene(free=True))
        path = problem.path
        assert path is not None
        found = [_resolved(problem, path, grid, layer) for grid, layer in GRIDS]
        if all(costs is not None for costs in found):
            totals += np.array(found)
            count += 1
        if count >= paths:
            break
    print(f"{count} straight paths, start left free; work, quasi-static")
    print(f"{'pitch':>8} {'layers':>8} {'graph [kJ]':>11} {'change':>8} {'refined [kJ]':>13} {'change':>8}")
    for row, (grid, layer) in enumerate(GRIDS):
        change = 100.0 * (totals[row] / totals[row - 1] - 1.0) if row else (np.nan, np.nan)
        print(
            f"{grid:>4.2f} deg {layer:>6.3f} m {totals[row, 0] / 1e3:>11.2f} {change[0]:>6.2f} % "
            f"{totals[row, 1] / 1e3:>13.2f} {change[1]:>6.2f} %"
        )


def _resolved(problem: Problem, path: TipPath, grid: float, layer: float) -> tuple[float, float] | None:
    """The cost in [J] of the graph's route and of the refined one; None where there is none."""
    objective, proximity = PathCost(problem), bp.Proximity(problem.robot, ())
    resolver = PathResolver(
        problem, path, proximity=proximity, find_detour=lambda *_: None,
        cost=objective.step_costs, grid=np.radians(grid), layer=layer,
    )  # fmt: skip
    found = resolver.resolve(None, detours=False)
    if found.obstruction is not None:
        return None
    (piece,) = found.pieces
    assert isinstance(piece, Stretch)
    q = cheapen_stretch(problem, path, piece, cost=objective, proximity=proximity, free_start=True, free_end=True).q
    return objective.value(piece.stations, piece.q), objective.value(piece.stations, q)


def timing(robot: bp.Robot) -> None:
    """Print how long a path of 200 samples among 5 obstacles takes."""
    angle = np.linspace(0.0, 1.0, 200)
    points = np.column_stack((4.6 - 1.8 * angle, -0.8 + 1.6 * angle, 0.3 - 1.2 * np.sin(np.pi * angle)))
    shapes: list[dict[str, Any]] = [
        {"name": "pipe", "shape": "capsule", "from": [1.5, 2.0, -0.9], "to": [5.5, 2.0, -0.9], "radius": 0.1},
        {"name": "truck", "shape": "box", "size": [2.0, 4.0, 1.5], "position": [4.5, 5.0, 1.0]},
        {"name": "pole", "shape": "cylinder", "radius": 0.15, "length": 8.0, "position": [3.0, -2.2, 4.0]},
        {"name": "boulder", "shape": "sphere", "radius": 0.4, "position": [4.6, -0.1, -1.7]},
        {"name": "wire", "shape": "halfspace", "point": [0, 0, 5.0], "normal": [0, 0, -1]},
    ]
    for start in (None, "same"):
        content: dict[str, Any] = {
            "version": 1,
            "obstacles": shapes,
            "task": {"path": {"waypoints": [{"position": p} for p in points.tolist()], "speed": SPEED}},
        }
        found = bp.plan(robot, bp.scene_from_dict(content), method="optimal")
        if start is not None:
            q = found.trajectory.q[0]
            content["start"] = {"joints": dict(zip(robot.joint_names, q.tolist(), strict=True))}
        begun, busy = time.perf_counter(), time.process_time()
        found = bp.plan(robot, bp.scene_from_dict(content), method="optimal")
        busy, taken = time.process_time() - busy, time.perf_counter() - begun
        given = "start left free" if start is None else "start given"
        print(
            f"200 samples, 5 obstacles, {given}: {found.verdict}, {busy:.2f} s of one core with the comparison "
            f"({taken:.2f} s on the clock, {found.metrics.planning_time:.2f} s without)"
        )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--paths", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--convergence", action="store_true")
    parser.add_argument("--time", action="store_true")
    options = parser.parse_args()
    robot = bp.load_robot("example:backhoe")
    if options.convergence:
        convergence(robot, paths=options.paths, seed=options.seed)
    elif options.time:
        timing(robot)
    else:
        study(robot, paths=options.paths, seed=options.seed)


if __name__ == "__main__":
    main()
