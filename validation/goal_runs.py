"""Motions to a goal compared with the best known: duration or cost, bound, and spread over seeds.

Every random site is planned with one or several seeds of the planner. The least known cost of a
site is kept in a file from run to run: a better motion, by another seed, more effort or another
planner, makes the ratios of all others larger. It is kept with a digest of the scene, so that a
site that is drawn differently begins anew.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.files.output_file import whole_file
from backhoe_planner.machine import GRAVITY, Dynamics
from validation.campaigns import call_for_all
from validation.habitats import load_machine
from validation.sites import Site, SiteKey, random_site
from validation.tables import Row as TableRow
from validation.tables import markdown, percent

VERSION = 1
WITHIN = (1.03, 1.1, 1.3)  # multiples of the best known cost within which motions are counted
_LIFTED = 1e-3  # m by which the work that counts as little lifts all moving parts; chosen
_ROUNDING = 1e-6  # part of a bound by which a motion may be below it


@dataclass(frozen=True)
class Settings:
    """The settings with which every site is planned."""

    effort: str = "normal"
    objective: str = "time"
    planning_seeds: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Row:
    """The result on one site with one seed of the planner.

    Attributes
    ----------
    planning_seed: of the planner, not of the site.
    verdict: ``verified``, ``failed``, or ``error`` if an exception was raised.
    seconds: processor time of planning [s].
    cost: of the motion by the objective, in its unit; of verified plans only, else None.
    duration: of the motion [s]; likewise.
    bound: proven lower bound on the cost of any motion; None if the plan has none.
    digest: of the scene.
    little: the cost that counts as little, see `little_cost`; 0 if none does.
    """

    machine: str
    kind: str
    index: int
    seed: int
    planning_seed: int
    objective: str
    digest: str
    way_known: bool
    verdict: str
    reason: str
    message: str
    seconds: float
    cost: float | None = None
    duration: float | None = None
    bound: float | None = None
    little: float = 0.0

    @property
    def key(self) -> SiteKey:
        """The name of the site."""
        return SiteKey(self.machine, self.kind, "goal", self.index, self.seed)

    @property
    def name(self) -> str:
        """The name of site, seed and objective in the file of the best."""
        return name_of(self.key, self.objective)

    @property
    def group(self) -> tuple[str, str]:
        """(machine, kind)."""
        return self.machine, self.kind

    @property
    def verified(self) -> bool:
        """Whether the plan is verified."""
        return self.verdict == "verified"


def name_of(key: SiteKey, objective: str) -> str:
    """The name of a site and an objective in the file of the best."""
    return f"{key}, seed {key.seed}, {objective}"


# --- the best known -----------------------------------------------------------------


@dataclass
class Best:
    """The least known cost of every site, and what found it.

    Attributes
    ----------
    costs: by `name_of` and digest of the scene.
    found_by: likewise, in words.
    """

    costs: dict[tuple[str, str], float] = field(default_factory=dict)
    found_by: dict[tuple[str, str], str] = field(default_factory=dict)

    def add(self, name: str, digest: str, cost: float, found_by: str) -> None:
        """Add a verified motion."""
        place = (name, digest)
        if cost < self.costs.get(place, np.inf):
            self.costs[place], self.found_by[place] = cost, found_by

    def add_rows(self, rows: Iterable[Row], effort: str) -> None:
        """Add all verified motions of a run."""
        for row in rows:
            if row.cost is not None:
                self.add(row.name, row.digest, row.cost, f"{effort}, seed {row.planning_seed}")

    def of(self, row: Row) -> float:
        """The least known cost of a row's site; NaN if none is known."""
        return self.costs.get((row.name, row.digest), np.nan)

    @staticmethod
    def load(path: Path) -> Best:
        """Load a saved file; empty if there is none.

        Raises
        ------
        ValueError: the file is not one that `save` wrote.
        """
        if not path.exists():
            return Best()
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict) or content.get("version") != VERSION or "best" not in content:
            raise ValueError(f"{path} is not a file of the best known, version {VERSION}")
        best = Best()
        for entry in content["best"]:
            best.add(entry["site"], entry["scene"], entry["cost"], entry["found by"])
        return best

    def save(self, path: Path) -> None:
        """Write the file, whole or not at all."""
        entries = [
            {"site": name, "scene": digest, "cost": cost, "found by": self.found_by[name, digest]}
            for (name, digest), cost in sorted(self.costs.items())
        ]
        with whole_file(path) as stream:
            stream.write(json.dumps({"version": VERSION, "best": entries}, indent=1, allow_nan=False) + "\n")


# --- one site -----------------------------------------------------------------------


def with_objective(scene: bp.Scene, objective: str) -> bp.Scene:
    """The scene with an objective to minimize."""
    return scene.model_copy(update={"objective": objective})


def digest_of(scene: bp.Scene) -> str:
    """A short text that differs if anything but the objective and the name differs."""
    content = scene.model_dump(by_alias=True, exclude_unset=True, exclude={"objective", "name"}, mode="json")
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


def little_cost(robot: bp.Robot, scene: bp.Scene, objective: str) -> float:
    """The energy that lifts all moving links and the payload by a millimetre [J]; 0 if the objective is no energy.

    The difference between plans that cost less cannot be measured on the machine.
    """
    if objective not in ("work", "hydraulic"):
        return 0.0
    masses, _ = Dynamics(robot, payload=scene.payload).bodies()
    return float(np.sum(masses)) * GRAVITY * _LIFTED


def cost_of(plan: bp.Plan, objective: str) -> float:
    """The cost of a plan's motion, in the objective's unit."""
    return float(plan.metrics.duration if objective == "time" else plan.metrics.energy[objective])


def bound_of(plan: bp.Plan, objective: str) -> float | None:
    """The lower bound on the cost of any motion, by the objective; None if the plan has none."""
    if plan.bound is None:
        return None
    return float(plan.bound.duration) if objective == "time" else plan.bound.energy.get(objective)


def run_site(key: SiteKey, settings: Settings, draw: Callable[[bp.Robot, SiteKey], Site] = random_site) -> list[Row]:
    """Draw a site and plan it with every seed of the planner."""
    robot = load_machine(key.machine)
    site = draw(robot, key)
    scene = with_objective(site.scene, settings.objective)
    about: dict[str, Any] = {
        "machine": key.machine, "kind": key.kind, "index": key.index, "seed": key.seed,
        "objective": settings.objective, "digest": digest_of(scene), "way_known": site.way_known,
        "little": little_cost(robot, scene, settings.objective),
    }  # fmt: skip
    return [_run(robot, scene, seed, settings, about) for seed in settings.planning_seeds]


def _run(robot: bp.Robot, scene: bp.Scene, seed: int, settings: Settings, about: Mapping[str, Any]) -> Row:
    begun = time.process_time()
    try:
        plan = bp.plan(robot, scene, seed=seed, effort=settings.effort)
        seconds = time.process_time() - begun
        found: dict[str, Any] = {"verdict": plan.verdict, "reason": plan.reason, "message": plan.message}
        if plan.verified:
            found |= {"cost": cost_of(plan, settings.objective), "duration": float(plan.metrics.duration)}
            found["bound"] = bound_of(plan, settings.objective)
    except Exception as error:  # noqa: BLE001  an exception is a finding, not the end of the run
        seconds = time.process_time() - begun
        found = {"verdict": "error", "reason": "error", "message": f"{type(error).__name__}: {error}"}
    return Row(**about, **found, planning_seed=seed, seconds=seconds)


def run(
    keys: Sequence[SiteKey],
    settings: Settings,
    *,
    draw: Callable[[bp.Robot, SiteKey], Site] = random_site,
    jobs: int = -1,
    folder: Path | None = None,
    watch: Callable[[int, object], object] = lambda done, result: None,
) -> tuple[list[Row], bool]:
    """The rows of all sites in the order of the keys, and whether the run was interrupted; see `call_for_all`."""
    call = partial(run_site, settings=settings, draw=draw)
    found, interrupted = call_for_all(call, keys, result=list[Row], jobs=jobs, folder=folder, watch=watch)
    return [row for rows in found for row in rows], interrupted


# --- figures ------------------------------------------------------------------------


def spreads(rows: Sequence[Row]) -> list[float]:
    """The greatest cost over the least, of every site planned with several seeds."""
    costs: dict[str, list[float]] = {}
    for row in rows:
        if row.cost is not None:
            costs.setdefault(row.name, []).append(row.cost)
    return [_ratio(max(found), min(found)) for found in costs.values() if len(found) > 1]


def violations(rows: Sequence[Row], best: Best) -> list[str]:
    """The sites with a verified motion, of any run, below a proven bound of the same site."""
    bounds: dict[str, float] = {}
    for row in rows:
        if row.bound is not None:
            bounds[row.name] = max(row.bound, bounds.get(row.name, -np.inf))
    least = {row.name: best.of(row) for row in rows}
    return [name for name, bound in bounds.items() if least[name] < bound * (1.0 - _ROUNDING)]


def table(rows: Sequence[Row], best: Best) -> str:
    """The figures of every group, and of all of them, as text.

    If a cost can be little (`little_cost`), the shares are given again with lower costs raised to it.
    """
    groups = dict.fromkeys(row.group for row in rows)
    lines = [_figures(" ".join(group), [row for row in rows if row.group == group], best) for group in groups]
    return markdown([*lines, _figures("all", rows, best)] if len(groups) > 1 else lines)


def _figures(name: str, rows: Sequence[Row], best: Best) -> TableRow:
    # a motion that is not verified is within no multiple
    ratios = [np.inf if row.cost is None else _ratio(row.cost, best.of(row)) for row in rows]
    some = [
        np.inf if row.cost is None else _ratio(max(row.cost, row.little), max(best.of(row), row.little)) for row in rows
    ]
    within = ", ".join(f"{percent(ratio <= part for ratio in some):.0f}" for part in WITHIN)
    over_bound = [row.cost / row.bound for row in rows if row.cost is not None and row.bound]
    return {
        "group": name,
        "sites": len({row.name for row in rows}),
        "verified": f"{percent(row.verified for row in rows):.1f} %",
        "/ best: median, p90, max": _spread([ratio for ratio in ratios if np.isfinite(ratio)]),
        **{f"within {part:g}": f"{percent(ratio <= part for ratio in ratios):.0f} %" for part in WITHIN},
        **({"the same, beside little": f"{within} %"} if any(row.little for row in rows) else {}),
        "CPU s: median, p90, max": _spread([row.seconds for row in rows]),
        "/ bound: median": float(np.median(over_bound)) if over_bound else np.nan,
        "below bound": len(violations(rows, best)) if over_bound else np.nan,
        "seeds, worst / best: median, p90": _spread(spreads(rows), parts=(0.5, 0.9)),
    }


def _ratio(a: float, b: float) -> float:
    """`a` over `b`; 1 if both costs are 0."""
    return a / b if b > 0.0 else (1.0 if a <= b else np.inf)


def _spread(values: Sequence[float], parts: Sequence[float] = (0.5, 0.9, 1.0)) -> str:
    return ", ".join(f"{np.quantile(values, part):.3g}" for part in parts) if len(values) else "-"


def failures(rows: Sequence[Row]) -> str:
    """A line for every row that is not verified."""
    return "\n".join(
        f"  {row.name}, planned with seed {row.planning_seed}{' (a way is known)' if row.way_known else ''}: "
        f"{row.reason}, {row.message}"
        for row in rows if not row.verified
    )  # fmt: skip


def save_rows(path: Path, rows: Sequence[Row], settings: Settings) -> None:
    """Write a run as JSON, whole or not at all."""
    content = {"version": VERSION, "settings": asdict(settings), "rows": [asdict(row) for row in rows]}
    with whole_file(path) as stream:
        stream.write(json.dumps(content, indent=1, allow_nan=False) + "\n")
