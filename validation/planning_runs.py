"""The planner on many random sites: how often, how fast and how well it solves them.

Every (machine, kind, task) is a group of sites, each drawn from its own seed. A site
gives a `Row`, a group a `Summary`, and two runs a `Comparison`. Planning time is processor
time, in seconds and as a multiple of a reference measured beside it, 1000 calls of
`Proximity.distances` on the same site: other processes do not lengthen it, and on a faster
machine the multiple stays the same.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.files.output_file import whole_file
from validation.campaigns import call_for_all
from validation.habitats import load_machine
from validation.independent_check import refutations
from validation.sites import Site, SiteKey, random_site
from validation.tables import Row as TableRow
from validation.tables import markdown

Group = tuple[str, str, str]

VERSION = 2
REFERENCE_CALLS = 1000


@dataclass(frozen=True)
class Settings:
    """The settings with which every site is planned."""

    method: str = "auto"
    effort: str = "normal"
    refute: bool = False


@dataclass(frozen=True)
class Row:
    """The result on one site.

    Attributes
    ----------
    verdict: ``verified``, ``failed``, or ``error`` if an exception was raised.
    seconds: processor time of planning [s].
    reference: time of 1000 calls of `Proximity.distances` on this site [s]; None if
        an exception came before.
    duration, tip_length: of the motion [s, m]; of verified plans only, else None.
    margin: the least, of verified plans with anything near [m].
    bound: lower bound on the duration of any motion, of verified plans to a goal [s].
    refuted: what contradicts the certificate; empty if nothing does, None if the plan
        was not checked independently.
    """

    machine: str
    kind: str
    task: str
    index: int
    seed: int
    form: str
    way_known: bool
    blocked: bool
    verdict: str
    reason: str
    message: str
    seconds: float
    reference: float | None
    duration: float | None = None
    tip_length: float | None = None
    margin: float | None = None
    refuted: list[str] | None = None
    bound: float | None = None

    @property
    def key(self) -> SiteKey:
        """The name of the site."""
        return SiteKey(self.machine, self.kind, self.task, self.index, self.seed)

    @property
    def group(self) -> Group:
        """(machine, kind, task)."""
        return self.machine, self.kind, self.task

    @property
    def ratio(self) -> float | None:
        """Planning time over the reference."""
        return self.seconds / self.reference if self.reference else None

    @property
    def above_bound(self) -> float | None:
        """The duration over its bound; None if there is no bound above 0."""
        return self.duration / self.bound if self.duration is not None and self.bound else None

    @property
    def verified(self) -> bool:
        """Whether the plan is verified."""
        return self.verdict == "verified"

    @property
    def is_wrong(self) -> bool:
        """Whether a verified plan was refuted, or an exception was raised."""
        return bool(self.refuted) or self.verdict == "error"


@dataclass(frozen=True)
class Summary:
    """The rows of one group."""

    group: Group
    rows: list[Row]

    @property
    def verified(self) -> list[Row]:
        """The rows with a verified plan."""
        return [row for row in self.rows if row.verified]

    @property
    def reasons(self) -> dict[str, int]:
        """The reasons of the others and their numbers, the most frequent first."""
        return dict(Counter(row.reason for row in self.rows if not row.verified).most_common())

    @property
    def refuted(self) -> int | None:
        """The number of verified plans that the independent check refutes; None without the check."""
        checked = [row.refuted for row in self.verified if row.refuted is not None]
        return sum(map(bool, checked)) if checked else None


@dataclass(frozen=True)
class Comparison:
    """The changes in one group, on the sites that both runs have.

    Attributes
    ----------
    before, now: numbers of verified plans.
    time_ratio: median of planning time now over before, each as a multiple of its own
        reference; over the sites that both runs verified.
    lost, won: the sites that are no longer, and those that are newly verified.
    """

    group: Group
    sites: int
    before: int
    now: int
    time_ratio: float
    lost: tuple[SiteKey, ...]
    won: tuple[SiteKey, ...]


# --- one site -------------------------------------------------------------------------


def run_site(key: SiteKey, settings: Settings) -> Row:
    """Draw a site, plan it, and check the plan independently if the settings ask for it."""
    known: dict[str, Any] = {"form": key.kind, "way_known": False, "blocked": False, "reference": None}
    begun = time.process_time()
    try:
        robot = load_machine(key.machine)
        site = random_site(robot, key)
        known |= {"form": site.form, "way_known": site.way_known, "blocked": site.blocked}
        known["reference"] = _reference(robot, site)
        begun = time.process_time()
        plan = bp.plan(robot, site.scene, method=settings.method, effort=settings.effort)
        seconds = time.process_time() - begun
        found: dict[str, Any] = {"verdict": plan.verdict, "reason": plan.reason, "message": plan.message}
        if plan.verified:
            least = plan.certificate.min_clearance
            found["duration"], found["tip_length"] = plan.metrics.duration, plan.metrics.tip_length
            found["margin"] = None if least is None else float(least.margin)
            found["bound"] = None if plan.bound is None else plan.bound.duration
            found["refuted"] = refutations(plan) if settings.refute else None
    except Exception as error:  # noqa: BLE001  an exception is a finding, not the end of the run
        seconds = time.process_time() - begun
        found = {"verdict": "error", "reason": "error", "message": f"{type(error).__name__}: {error}"}
    return Row(**asdict(key), **known, **found, seconds=seconds)


def _reference(robot: bp.Robot, site: Site) -> float:
    """Time of 1000 calls of `Proximity.distances` [s], from a tenth of them."""
    proximity = bp.Proximity(robot, bp.build_obstacles(site.scene, robot))
    rng = np.random.default_rng(0)
    configurations = [robot.random_q(rng) for _ in range(REFERENCE_CALLS // 10)]
    begun = time.process_time()
    for q in configurations:
        proximity.distances(q)
    return 10.0 * (time.process_time() - begun)


# --- all sites ----------------------------------------------------------------------


def run(
    keys: Sequence[SiteKey],
    settings: Settings,
    *,
    jobs: int = -1,
    folder: Path | None = None,
    watch: Callable[[int, object], object] = lambda done, result: None,
) -> tuple[list[Row], bool]:
    """The rows of all sites in the order of the keys, and whether the run was interrupted; see `call_for_all`."""
    call = partial(run_site, settings=settings)
    return call_for_all(call, keys, result=Row, jobs=jobs, folder=folder, watch=watch, died=_died)


def _died(key: SiteKey) -> Row:
    """The row of a site at which the process died twice."""
    return Row(
        **asdict(key), form=key.kind, way_known=False, blocked=False, verdict="error", reason="error",
        message="the process that planned it died, twice", seconds=float("nan"), reference=None,
    )  # fmt: skip


def all_keys(
    sites: int, *, machines: Sequence[str], kinds: Sequence[str], tasks: Sequence[str], seed: int
) -> list[SiteKey]:
    """The keys of all groups, the first of each before the second of any."""
    return [
        SiteKey(machine, kind, task, index, seed)
        for index in range(sites) for machine in machines for kind in kinds for task in tasks
    ]  # fmt: skip


# --- figures --------------------------------------------------------------------------


def summarise(rows: Sequence[Row]) -> list[Summary]:
    """The figures of every group, in the order in which the groups first appear."""
    groups = dict.fromkeys(row.group for row in rows)
    return [Summary(group, [row for row in rows if row.group == group]) for group in groups]


def _median(values: Sequence[float | None]) -> float:
    finite = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.median(finite)) if finite else float("nan")


def _percentile(values: Sequence[float | None], part: float) -> float:
    finite = [value for value in values if value is not None]
    return float(np.percentile(finite, part)) if finite else float("nan")


def table(summaries: Sequence[Summary]) -> str:
    """The figures of every group as text: times of all its sites, motions of the verified plans."""
    return markdown([_figures(summary) for summary in summaries])


def _figures(summary: Summary) -> TableRow:
    rows, verified = summary.rows, summary.verified
    known = [row.verified for row in rows if row.way_known]
    return {
        "group": " ".join(summary.group),
        "sites": len(rows),
        "verified": _part(len(verified), len(rows)),
        "of known ways": f"{_part(sum(known), len(known))} of {len(known)}" if known else "-",
        "median [s]": _median([row.seconds for row in rows]),
        "p95 [s]": float(np.percentile([row.seconds for row in rows], 95)),
        "/ref": _median([row.ratio for row in rows]),
        "motion [s]": _median([row.duration for row in verified]),
        "/bound": _median([row.above_bound for row in verified]),
        "p90": _percentile([row.above_bound for row in verified], 90),
        "tip [m]": _median([row.tip_length for row in verified]),
        "margin [mm]": 1e3 * min((row.margin for row in verified if row.margin is not None), default=float("nan")),
        "refuted": "-" if summary.refuted is None else str(summary.refuted),
        "reasons": ", ".join(f"{reason} {count}" for reason, count in summary.reasons.items()),
    }


def _part(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.1f} %"


def failures(rows: Sequence[Row]) -> str:
    """The indices of the sites that are not verified, group by group; a star marks a known solution."""
    failed: dict[Group, list[str]] = {}
    for row in rows:
        if not row.verified:
            failed.setdefault(row.group, []).append(f"{row.index}{'*' if row.way_known else ''}")
    if not failed:
        return ""
    seed = rows[0].seed
    head = f"not verified (* a way is known), seed {seed}; rerun with --only MACHINE/KIND/TASK/INDEX --seed {seed}:"
    return "\n".join([head, *(f"  {'/'.join(group)}: {' '.join(indices)}" for group, indices in failed.items())])


def compare(before: Sequence[Row], now: Sequence[Row]) -> list[Comparison]:
    """The changes from one run to another, by group, on the sites that both have."""
    old = {row.key: row for row in before}
    pairs = [(old[row.key], row) for row in now if row.key in old]
    found = []
    for group in dict.fromkeys(row.group for _, row in pairs):
        mine = [(was, row) for was, row in pairs if row.group == group]
        times = [
            row.ratio / was.ratio for was, row in mine if was.verified and row.verified and row.ratio and was.ratio
        ]
        found.append(
            Comparison(
                group=group,
                sites=len(mine),
                before=sum(was.verified for was, _ in mine),
                now=sum(row.verified for _, row in mine),
                time_ratio=_median(times),
                lost=tuple(row.key for was, row in mine if was.verified and not row.verified),
                won=tuple(row.key for was, row in mine if not was.verified and row.verified),
            )
        )
    return found


def comparison_table(comparisons: Sequence[Comparison]) -> str:
    """The changes as text."""
    if not comparisons:
        return "no site is in both runs"
    rows: list[TableRow] = [
        {
            "compared": " ".join(c.group),
            "sites": c.sites,
            "before": _part(c.before, c.sites),
            "now": _part(c.now, c.sites),
            "won": len(c.won),
            "lost": len(c.lost),
            "time": c.time_ratio,
        }
        for c in comparisons
    ]
    lost = [str(key) for c in comparisons for key in c.lost]
    return markdown(rows) + (f"\nverified before, failed now: {' '.join(lost)}" if lost else "")


# --- the file ------------------------------------------------------------------------


def save_rows(path: Path, rows: Sequence[Row], settings: Settings) -> None:
    """Write a run as JSON, whole or not at all."""
    content = {"version": VERSION, "settings": asdict(settings), "rows": [asdict(row) for row in rows]}
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    with whole_file(path) as stream:
        stream.write(text)


def load_rows(path: Path) -> list[Row]:
    """The rows of a saved run.

    Raises
    ------
    ValueError: the file is not one that `save_rows` wrote.
    """
    content = json.loads(path.read_text())
    if not isinstance(content, dict) or content.get("version") != VERSION or "rows" not in content:
        raise ValueError(f"{path} is not a saved run of version {VERSION}")
    names = {field.name for field in fields(Row)}
    for record in content["rows"]:
        if set(record) != names:
            raise ValueError(f"{path}: a row has other fields than a run of version {VERSION}")
    return [Row(**record) for record in content["rows"]]
