"""The work that the global optimum saves against local laws, on seeded straight paths of the backhoe.

Every case is a straight path of the bucket tip, 1 to 5 m long, position only, from a
random configuration. It is planned twice, from that configuration and with a free start,
and each motion is compared with two local laws that begin at the same configuration and
keep the plan's timing: the pseudo-inverse (least velocity norm, ignores limits) and the
completed law (keeps the limits, may get stuck). A path counts only if it can be followed
from its configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.motion import PathCost, Problem, TipPath, Trajectory, build_problem, trajectory_costs
from backhoe_planner.planning import (
    Layering,
    PathResolver,
    Stretch,
    cheapen_stretch,
    law_motion,
    least_norm_resolution,
    resolve_along,
)
from validation.campaigns import Campaign
from validation.habitats import load_machine
from validation.scenes import scene_of
from validation.tables import Row

SHORTEST, LONGEST = 1.0, 5.0  # m
SPEED = 0.4  # m/s
GRIDS = ((5.0, 0.2), (2.5, 0.2), (1.25, 0.2))  # deg of pitch, m of path between layers
Costs = list[tuple[float, float]]
"""The costs of the best and of the refined route of one case, on every grid of `GRIDS` [J]."""
_MACHINE = "backhoe"
LAWS = (
    "pseudo-inverse, limits or not",
    "pseudo-inverse, where it keeps the limits",
    "completed law, where it gets along",
)


@dataclass(frozen=True, eq=False)
class Case:
    """A configuration (n,), the path of the tip from it, (3,) each [m], and the number of cases drawn before."""

    number: int
    q: Vector
    begin: Vector
    end: Vector

    def problem(self, robot: bp.Robot, *, free: bool) -> tuple[Problem, TipPath]:
        """The path as a problem, with the start at the configuration or free."""
        waypoints = [{"position": place.tolist()} for place in (self.begin, self.end)]
        task = {"path": {"waypoints": waypoints, "speed": SPEED}}
        scene = scene_of(robot, [], start=None if free else self.q, task=task, objective="work")
        problem = build_problem(robot, scene)
        assert problem.path is not None
        return problem, problem.path


@dataclass(frozen=True)
class Savings:
    """The work of one optimum and of every law of `LAWS` at its timing [J]; None if a law gives no motion."""

    optimum: float
    laws: tuple[float | None, ...]


@dataclass(frozen=True)
class Result:
    """The savings of one case from the same start and from a free one (None if that failed), by its number."""

    number: int
    same: Savings
    free: Savings | None
    pseudo_inverse_breaks: bool
    law_stuck: bool

    @property
    def worse(self) -> bool:
        """Whether a law that keeps the limits needs less work from the same start."""
        return any(law is not None and exceeds(self.same.optimum, law) for law in self.same.laws[1:])


def exceeds(optimum: float, law: float) -> bool:
    """Whether an optimum is worse by more than inertia, which the search ignores, can explain: 0.1 % and 1 J."""
    return optimum > law * 1.001 + 1.0


def draw_cases(robot: bp.Robot, seed: int) -> Iterator[Case]:
    """Yield cases without end; not all can be followed."""
    rng = np.random.default_rng(seed)
    kinematics = bp.Kinematics(robot)
    proximity = bp.Proximity(robot, ())
    number = 0
    while True:
        q = robot.random_q(rng)
        direction = rng.standard_normal(3)
        length = rng.uniform(SHORTEST, LONGEST)
        begin = np.array(kinematics.at(q).tip_position)
        end = begin + length * direction / np.linalg.norm(direction)
        inside = bp.solve_inverse_kinematics(robot, bp.TipTarget(end))
        if inside.reached and bool(np.all(proximity.distances(q) >= proximity.clearance)):
            yield Case(number, q, begin, end)
            number += 1


def measure_paths(
    *, paths: int, seed: int, jobs: int, folder: Path | None, watch: Callable[[int, Result], object]
) -> tuple[list[Result], bool]:
    """The first cases that can be followed from their configuration, and whether it was interrupted; see `Campaign`."""
    cases = draw_cases(load_machine(_MACHINE), seed)
    with Campaign(measure_case, list[Result], jobs=jobs, folder=folder) as campaign:
        return campaign.first(cases, paths, watch=watch), campaign.interrupted


def measure_case(case: Case) -> list[Result]:
    """One case; nothing if it cannot be followed from its configuration."""
    robot = load_machine(_MACHINE)
    problem, path = case.problem(robot, free=False)
    same = bp.plan(robot, problem.scene, method="optimal")
    if not _follows(same):
        return []
    free = bp.plan(robot, case.problem(robot, free=True)[0].scene, method="optimal")
    kinematics = bp.Kinematics(robot)
    blind = least_norm_resolution(problem, path, case.q, kinematics=kinematics)
    law = resolve_along(problem, path, 0.0, case.q, proximity=bp.Proximity(robot, ()), kinematics=kinematics)
    breaks = blind is None or blind.obstruction is not None
    others = (blind, None if breaks else blind, law if law.obstruction is None else None)

    def work(motion: Trajectory) -> float:
        return trajectory_costs(problem, motion)["work"]

    def savings(motion: Trajectory) -> Savings:
        moved = [None if other is None else law_motion(path, other, motion, kinematics=kinematics) for other in others]
        return Savings(work(motion), tuple(None if other is None else work(other) for other in moved))

    return [
        Result(
            number=case.number,
            same=savings(same.trajectory),
            free=savings(free.trajectory) if _follows(free) else None,
            pseudo_inverse_breaks=breaks,
            law_stuck=law.obstruction is not None,
        )
    ]


def _follows(plan: bp.Plan) -> bool:
    return plan.verified and not plan.certificate.detours


def savings_table(results: list[Result]) -> list[Row]:
    """Work summed over the cases: every law and the optimum, from the same start and from a free one."""
    rows: list[Row] = []
    for start in ("same", "free"):
        found = [savings for result in results if (savings := getattr(result, start)) is not None]
        for place, name in enumerate(LAWS):
            pairs = [(savings.laws[place], savings.optimum) for savings in found if savings.laws[place] is not None]
            laws, optima = (sum(column) / 1e3 for column in zip(*pairs, strict=True)) if pairs else (np.nan, np.nan)
            rows.append(
                {
                    "start": start,
                    "against": name,
                    "paths": len(pairs),
                    "law [kJ]": laws,
                    "optimum [kJ]": optima,
                    "saving [%]": 100.0 * (1.0 - optima / laws),
                    "optimum worse": sum(exceeds(optimum, law) for law, optimum in pairs),
                }
            )
    return rows


def measure_grids(*, paths: int, seed: int, jobs: int, folder: Path | None) -> tuple[list[Costs], bool]:
    """The costs of the first cases with a free start that can be followed on every grid; see `Campaign`."""
    cases = draw_cases(load_machine(_MACHINE), seed)
    with Campaign(cost_on_grids, list[Costs], jobs=jobs, folder=folder) as campaign:
        return campaign.first(cases, paths), campaign.interrupted


def cost_on_grids(case: Case) -> list[Costs]:
    """The costs of one case with a free start; nothing if it cannot be followed on every grid."""
    problem, path = case.problem(load_machine(_MACHINE), free=True)
    costs = [_route_costs(problem, path, grid, layer) for grid, layer in GRIDS]
    found = [cost for cost in costs if cost is not None]
    return [found] if len(found) == len(GRIDS) else []


def convergence_table(found: Sequence[Costs]) -> list[Row]:
    """Quasi-static work summed over cases: the best route on every grid, and the refined one."""
    totals: NDArray[np.float64] = np.sum(found, axis=0) / 1e3
    change = 100.0 * (totals / np.vstack((np.full(2, np.nan), totals[:-1])) - 1.0)
    return [
        {
            "pitch [deg]": grid,
            "layers [m]": layer,
            "best route on the grid [kJ]": total[0],
            "its change [%]": by[0],
            "refined [kJ]": total[1],
            "change [%]": by[1],
        }
        for (grid, layer), total, by in zip(GRIDS, totals.tolist(), change.tolist(), strict=True)
    ]


def _route_costs(problem: Problem, path: TipPath, grid: float, layer: float) -> tuple[float, float] | None:
    """The costs of the graph's route and of the refined one [J]; None if there is no route."""
    objective, proximity = PathCost(problem), bp.Proximity(problem.robot, ())
    resolver = PathResolver(
        problem, path, proximity=proximity, find_detour=lambda *_: None,
        cost=objective.step_costs, layering=Layering(layer, float(np.radians(grid))),
    )  # fmt: skip
    found = resolver.resolve(None, detours=False)
    if found.obstruction is not None:
        return None
    (piece,) = found.pieces
    assert isinstance(piece, Stretch)
    q = cheapen_stretch(problem, path, piece, cost=objective, proximity=proximity, free_start=True, free_end=True).q
    return objective.value(piece.stations, piece.q), objective.value(piece.stations, q)
