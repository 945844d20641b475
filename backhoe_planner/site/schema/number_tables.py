"""Tables of numbers as survey software writes them: with commas, semicolons or blanks between, quoted or not."""

from __future__ import annotations

import csv

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector

COMMENTS = ("#", "//")  # begin a line that says something of the table

# what stands in place of a height that is missing, by custom: no site lies so deep
_MISSING = (-9999.0, -32767.0, -32768.0, -99999.0)
_LARGEST_OF_32_BITS = float(np.finfo(np.float32).max)  # either way it stands for one, too
_FEWEST_NUMBERED = 3  # rows that are counted from the first on are numbered; chosen


def cells_of(line: str) -> list[str]:
    """The cells between semicolons, in which a comma is a decimal point, or else between commas, or else blanks."""
    if ";" in line:
        return [cell.replace(",", ".") for cell in _unquoted(line, ";")]
    if "," in line:
        return _unquoted(line, ",")
    return [cell.strip('"') for cell in line.split()]


def number_in(cell: str) -> float:
    """The number in a cell; unlike Python's own, it has no underscores and no digits of other scripts.

    Raises
    ------
    ValueError: there is none.
    """
    if "_" in cell or not cell.isascii():
        raise ValueError
    return float(cell)


def plain_table(text: str) -> Matrix | None:
    """(rows, columns) of a text of nothing but numbers with commas, or with blanks, between them; None of any other.

    It takes a tenth of the time that is needed line by line, where messages say what is wrong with which.
    """
    if not text.strip():
        return None
    first = text.lstrip().partition("\n")[0]
    comma = "," in first
    if comma and len(first.replace(",", " ").split()) != first.count(",") + 1:
        return None
    try:
        found = np.loadtxt(text.splitlines(), delimiter="," if comma else None, comments=None, ndmin=2)
    except ValueError:
        return None
    return found if found.size else None


def are_missing(heights: Matrix | Vector) -> Flags:
    """Which of `heights`, of any shape, are figures that stand for a missing one."""
    return np.isin(heights, _MISSING) | np.isclose(np.abs(heights), _LARGEST_OF_32_BITS, rtol=1e-6, atol=0.0)


def counts_rows(column: Vector) -> bool:
    """Whether a column (rows,) numbers the rows: whole numbers, each as much above the last."""
    steps = np.diff(column)
    return bool(
        len(column) >= _FEWEST_NUMBERED
        and steps[0] >= 1.0
        and np.all(steps == steps[0])
        and column[0] >= 0.0
        and np.all(column == np.floor(column))
    )


def _unquoted(line: str, delimiter: str) -> list[str]:
    return (
        next(csv.reader([line], delimiter=delimiter, skipinitialspace=True)) if '"' in line else line.split(delimiter)
    )
