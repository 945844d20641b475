"""Tables of numbers as survey software writes them: separated by commas, semicolons or blanks, quoted or not."""

from __future__ import annotations

import csv
from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector

COMMENTS = ("#", "//")  # beginnings of comment lines

# customary numbers in place of a missing height: no site is so deep or so high
_MISSING = (-9999.0, -32767.0, -32768.0, -99999.0, 65535.0)
_LARGEST_OF_32_BITS = float(np.finfo(np.float32).max)  # with either sign, also used for a missing height
_FEWEST_NUMBERED = 3  # rows from which on a rising first column counts as row numbers; chosen


def cells_of(line: str) -> list[str]:
    """The cells between tabs, or semicolons (a comma in them is a decimal point), or commas, or blanks."""
    if "\t" in line:
        return _unquoted(line, "\t")
    if ";" in line:
        return [cell.replace(",", ".") for cell in _unquoted(line, ";")]
    if "," in line:
        return _unquoted(line, ",")
    return [cell.strip('"') for cell in line.split()]


def delimiter_of(line: str) -> str | None:
    """What separates the cells of a line, as in `cells_of`; None for blanks."""
    return next((mark for mark in "\t;," if mark in line), None)


def is_number(cell: str) -> bool:
    """Whether a cell is a number, as in `number_in`."""
    try:
        number_in(cell)
    except ValueError:
        return False
    return True


def number_in(cell: str) -> float:
    """The number in a cell; unlike in Python, underscores and digits of other scripts are not allowed.

    Raises
    ------
    ValueError: there is none.
    """
    if "_" in cell or not cell.isascii():
        raise ValueError
    return float(cell)


def plain_table(text: str) -> Matrix | None:
    """(rows, columns) of a text that has only numbers separated by commas or by blanks; None for any other text.

    This takes a tenth of the time of reading line by line, which is for messages that name the wrong line.
    """
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith(COMMENTS)]
    if not lines:
        return None
    comma = "," in lines[0]
    if comma and len(lines[0].replace(",", " ").split()) != lines[0].count(",") + 1:
        return None
    try:
        found = np.loadtxt(lines, delimiter="," if comma else None, comments=None, ndmin=2)
    except ValueError:
        return None
    return found if found.size else None


def columns_of(lines: Sequence[str], columns: Sequence[int]) -> Matrix | None:
    """(rows, k) of some columns of lines, whatever the others hold; None if `cells_of` is needed to read them.

    All lines have the same number of cells, except where blanks separate them.
    """
    mark = delimiter_of(lines[0])
    if mark is not None and len({line.count(mark) for line in lines}) > 1:
        return None
    if mark == ";":
        lines = [line.replace(",", ".") for line in lines]
    try:
        return np.loadtxt(lines, delimiter=mark, comments=None, quotechar='"', usecols=columns, ndmin=2)
    except ValueError:
        return None


def are_missing(heights: Matrix | Vector) -> Flags:
    """Which of `heights`, of any shape, are numbers that mean a missing height."""
    return np.isin(heights, _MISSING) | np.isclose(np.abs(heights), _LARGEST_OF_32_BITS, rtol=1e-6, atol=0.0)


def counts_rows(column: Vector) -> bool:
    """Whether a column (rows,) numbers the rows: whole numbers, rising by the same step."""
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
