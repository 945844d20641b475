"""The rows of a study as an aligned table, in Markdown and as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

Row = Mapping[str, str | float]


def percent(holds: Iterable[bool]) -> float:
    """The share that is true [%]; NaN for none."""
    found = list(holds)
    return 100.0 * sum(found) / len(found) if found else float("nan")


def markdown(rows: Sequence[Row]) -> str:
    """An aligned table, names left and numbers right; the first row's keys are the heads."""
    heads = list(rows[0])
    cells = [[_cell(row[head]) for head in heads] for row in rows]
    widths = [max(len(head), *(len(line[column]) for line in cells)) for column, head in enumerate(heads)]
    left = [isinstance(rows[0][head], str) for head in heads]

    def line(texts: Sequence[str]) -> str:
        padded = (t.ljust(w) if at_left else t.rjust(w) for t, w, at_left in zip(texts, widths, left, strict=True))
        return "| " + " | ".join(padded) + " |"

    rule = ["-" * w if at_left else "-" * (w - 1) + ":" for w, at_left in zip(widths, left, strict=True)]
    return "\n".join([line(heads), line(rule), *(line(texts) for texts in cells)])


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return value
    return "-" if value != value else f"{value:.4g}"  # NaN: there is no such figure


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write the rows with a line of heads."""
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
