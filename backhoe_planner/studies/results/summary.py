"""The summary of a study: how often rows are verified, by parameter, where the best are, and the trade-offs."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from backhoe_planner.studies.results.outcome import Outcome
from backhoe_planner.studies.rows.drawing import StudyRow
from backhoe_planner.studies.rows.metrics import Metric
from backhoe_planner.studies.schema.study_file import Best

_MOST_VALUES = 12  # of a parameter that are shown one by one; chosen, more are shown in bins
_BINS = 8  # of a parameter with more values; chosen
ALIKE = 0.02  # part of a figure; chosen, plans of one site with two seeds mostly differ by less
_BEST_PART = 0.1  # of the verified rows that form the best region; chosen
_FEWEST_BEST = 5  # rows of the best region, so that it is meaningful for a short study; chosen


@dataclass(frozen=True)
class Share:
    """The rows in which a parameter has one value, or is in one bin.

    Attributes
    ----------
    label: the value, or the ends of the bin.
    rows, verified: how many rows there are, and how many of them are verified.
    best: the median over the verified rows of the metric by which rows are compared; nan if none is verified.
    """

    label: str
    rows: int
    verified: int
    best: float


@dataclass(frozen=True)
class Region:
    """The values of a parameter in the best rows, compared with all rows.

    Attributes
    ----------
    name: of the parameter.
    best: in the best rows: ends of the range, or the values that occur.
    every: the same for all rows.
    """

    name: str
    best: str
    every: str


@dataclass(frozen=True)
class Summary:
    """The summary of a study.

    Attributes
    ----------
    counts: of rows by verdict, and by reason if there is one, most frequent first.
    messages: of the first row with each verdict that gives no reason (`invalid`, `error`), with its number.
    best: the best verified row; None if none is verified or has the metric.
    best_value: of its metric.
    alike: how many others are within `ALIKE` of that value, by which searches with other seeds may differ.
    shares: of every parameter that differs.
    regions: the values of each of these parameters in the best rows.
    in_region: how many best rows there are.
    """

    counts: Mapping[str, int]
    messages: Mapping[str, tuple[int, str]]
    best: StudyRow | None
    best_value: float
    alike: int
    shares: Mapping[str, tuple[Share, ...]]
    regions: tuple[Region, ...]
    in_region: int

    @property
    def doubt(self) -> str:
        """How many rows are about as good as the best, in words; empty if none is."""
        if not self.alike:
            return ""
        others = "1 other is" if self.alike == 1 else f"{self.alike} others are"
        return f"{others} within {100.0 * ALIKE:.0f} %, by which plans with other seeds may differ"


@dataclass(frozen=True)
class Map:
    """A table of two parameters: for every pair of their values the rows, as a `Share`.

    Attributes
    ----------
    across, down: names of the parameters.
    columns, lines: labels of their values.
    cells: for every line one for each column; None if no row has both values.
    """

    across: str
    down: str
    columns: tuple[str, ...]
    lines: tuple[str, ...]
    cells: tuple[tuple[Share | None, ...], ...]


def summarise(rows: Sequence[StudyRow], outcomes: Mapping[int, Outcome], best: Best) -> Summary:
    """The summary of the rows that are done."""
    done = [row for row in rows if row.number in outcomes]
    counts = Counter(_ending(outcomes[row.number]) for row in done)
    figures = {row.number: _figure(outcomes[row.number], best.metric) for row in done}
    ranked = [row for row in done if not math.isnan(figures[row.number])]
    ranked.sort(key=lambda row: (best.sign * figures[row.number], row.number))
    top = ranked[: max(_FEWEST_BEST, math.ceil(_BEST_PART * len(ranked)))]
    varied = [name for name in (rows[0].values if rows else ()) if len({_label(row.values[name]) for row in rows}) > 1]
    return Summary(
        counts=dict(counts.most_common()),
        messages=_first_messages(outcomes[row.number] for row in done),
        best=ranked[0] if ranked else None,
        best_value=figures[ranked[0].number] if ranked else math.nan,
        alike=sum(math.isclose(figures[row.number], figures[ranked[0].number], rel_tol=ALIKE) for row in ranked[1:]),
        shares={name: _shares(name, done, outcomes, figures) for name in varied},
        regions=tuple(Region(name, _extent(name, top), _extent(name, done)) for name in varied if top),
        in_region=len(top),
    )


def trade_offs(
    metrics: Sequence[Metric], rows: Sequence[StudyRow], outcomes: Mapping[int, Outcome], best: Best
) -> list[tuple[str, str, list[tuple[float, float, int, bool]]]]:
    """Pairs of metrics of the verified rows: names, and for every row x, y, its number and whether no row beats it.

    The first metric of each pair is the one by which rows are compared. A row is beaten if another one is as good
    in one of the two metrics and better in the other; less of the second is better, for a margin more is.
    """
    found = []
    for metric in metrics:
        if metric.name == best.metric or metric.type not in ("float", "int"):
            continue
        points = []
        for row in rows:
            outcome = outcomes.get(row.number)
            if outcome is not None:
                x, y = _figure(outcome, best.metric), _figure(outcome, metric.name)
                if not math.isnan(x) and not math.isnan(y):
                    points.append((x, y, row.number))
        values = {(x, y) for x, y, _ in points}
        if len({x for x, _ in values}) < 2 or len({y for _, y in values}) < 2:
            continue
        if all(math.isclose(x, y, rel_tol=1e-12) for x, y in values):
            continue  # the same figure under two names
        front = _front(points, best.sign, -1.0 if wants_more(metric.name) else 1.0)
        found.append((best.metric, metric.name, [(x, y, number, number in front) for x, y, number in points]))
    return found


def map_of_two(summary: Summary, rows: Sequence[StudyRow], outcomes: Mapping[int, Outcome], best: Best) -> Map | None:
    """The table of the two parameters with the largest effect; None if fewer than two differ."""
    ranked = sorted(summary.shares, key=lambda name: (-_weight(summary.shares[name]), name))
    if len(ranked) < 2:
        return None
    across, down = ranked[:2]
    done = [row for row in rows if row.number in outcomes]
    columns, lines = _groups(across, done), _groups(down, done)
    figures = {row.number: _figure(outcomes[row.number], best.metric) for row in done}
    cells = []
    for line in lines.values():
        numbers = {row.number for row in line}
        both = ([row for row in column if row.number in numbers] for column in columns.values())
        cells.append(tuple(_share("", inside, outcomes, figures) if inside else None for inside in both))
    return Map(across, down, tuple(columns), tuple(lines), tuple(cells))


def _weight(shares: Sequence[Share]) -> float:
    """The effect of a parameter: the spread of the verified part, and of the median of the metric."""
    parts = [share.verified / share.rows for share in shares if share.rows]
    medians = [share.best for share in shares if not math.isnan(share.best)]
    spread = (max(medians) - min(medians)) / max(map(abs, medians)) if medians and any(medians) else 0.0
    return max(parts, default=0.0) - min(parts, default=0.0) + spread


def wants_more(name: str) -> bool:
    """Whether more of a metric is better: for margins, distances and production."""
    last = name.rpartition(".")[2]
    return last in ("margin", "production", "bank", "loose", "kept_percent") or (
        "clearance" in name and last == "value"
    )


def _front(points: Sequence[tuple[float, float, int]], sign_x: float, sign_y: float) -> set[int]:
    """The numbers of the points that no other point beats."""
    front, least = set(), math.inf
    for _, y, number in sorted(points, key=lambda one: (sign_x * one[0], sign_y * one[1], one[2])):
        if sign_y * y < least:
            least = sign_y * y
            front.add(number)
    return front


def _ending(outcome: Outcome) -> str:
    return outcome.verdict if outcome.reason in ("", outcome.verdict) else f"{outcome.verdict}: {outcome.reason}"


def _first_messages(outcomes: Iterable[Outcome]) -> dict[str, tuple[int, str]]:
    found: dict[str, tuple[int, str]] = {}
    for outcome in outcomes:
        if outcome.verdict not in ("verified", "failed") and outcome.message:
            found.setdefault(_ending(outcome), (outcome.row, outcome.message))
    return found


def _figure(outcome: Outcome, name: str) -> float:
    value = outcome.metrics.get(name) if outcome.verdict == "verified" else None
    return math.nan if value is None or isinstance(value, str) else float(value)


def _label(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_label, value))}]"
    return str(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _shares(
    name: str, rows: Sequence[StudyRow], outcomes: Mapping[int, Outcome], figures: Mapping[int, float]
) -> tuple[Share, ...]:
    return tuple(_share(label, inside, outcomes, figures) for label, inside in _groups(name, rows).items())


def _share(
    label: str, rows: Sequence[StudyRow], outcomes: Mapping[int, Outcome], figures: Mapping[int, float]
) -> Share:
    known = [figures[row.number] for row in rows if not math.isnan(figures[row.number])]
    verified = sum(outcomes[row.number].verdict == "verified" for row in rows)
    return Share(label, len(rows), verified, float(np.median(known)) if known else math.nan)


def _groups(name: str, rows: Sequence[StudyRow]) -> dict[str, list[StudyRow]]:
    """The rows by the value of a parameter, or by its bin if there are many values."""
    values = [row.values[name] for row in rows]
    if all(map(_is_number, values)) and len(set(values)) > _MOST_VALUES:
        edges = np.linspace(min(values), max(values), _BINS + 1)
        bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _BINS - 1).tolist()
        labels = [f"{low:.3g} to {high:.3g}" for low, high in itertools.pairwise(edges.tolist())]
        groups: dict[str, list[StudyRow]] = {label: [] for label in labels}
        for row, number in zip(rows, bins, strict=True):
            groups[labels[number]].append(row)
        return groups
    order = sorted(set(values)) if all(map(_is_number, values)) else values
    groups = {_label(value): [] for value in order}
    for row in rows:
        groups[_label(row.values[name])].append(row)
    return groups


def _extent(name: str, rows: Sequence[StudyRow]) -> str:
    values = [row.values[name] for row in rows]
    if all(map(_is_number, values)):
        low, high = min(values), max(values)
        return _label(low) if low == high else f"{_label(low)} to {_label(high)}"
    counts = Counter(map(_label, values)).most_common()
    return ", ".join(f"{label} ({count})" for label, count in counts[:_MOST_VALUES])
