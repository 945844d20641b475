"""Figures in messages, with as many digits as show on which side of a bound they lie.

A bound may be exceeded by less than a message usually shows: `the motion takes 3.00 s, max_duration allows 3 s`
contradicts itself. The functions here add digits until the printed figures say what the numbers do.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

_MORE = 9  # digits that are added at most; chosen: more is rounding of the numbers themselves
_MORE_OF_MARGIN = 3  # the same for a margin; chosen: a missing micrometre is rounding


def beside_bounds(
    value: float, *bounds: float, places: str = ".2f", bounds_as: str = ".6g", rounding: float = 0.0
) -> tuple[str, ...]:
    """A value and the bounds beside it, in words, so that each pair shows which of the two is larger.

    A value that equals a bound, and a bound that is infinite, need no more digits. A value that looks like a bound that
    is printed with more digits gets as many: ``5.71`` or ``5.73`` beside ``5.73``, not ``5.7``.

    Parameters
    ----------
    value: finite [any unit].
    bounds: in the same unit.
    places, bounds_as: how value and bounds are usually printed, as format specifications with a number of digits.
    rounding: a difference that counts as none [the same unit].

    Returns
    -------
    The value, then the bounds, in their order.
    """
    for more in range(_MORE + 1):
        texts = (_with(value, places, more), *(_with(bound, bounds_as, more) for bound in bounds))
        shown = [_number(text) for text in texts]
        pairs = tuple(zip(shown[1:], bounds, strict=True))
        if _is_right(shown[0], value, pairs, rounding):
            break
    value_text = texts[0]
    for finer in range(more, _MORE + 1):
        text = _with(value, places, finer)
        if not _is_right(_number(text), value, pairs, rounding):  # more digits may end in those of a bound
            continue
        value_text = text
        if not any(_number(text) == _number(_with(bound, places, finer)) != other for other, bound in pairs):
            break
    return value_text, *texts[1:]


def margin_text(margin: float, places: str = "+.3f") -> str:
    """A margin in words; one below 0 is not printed as 0 unless it is rounding.

    Parameters
    ----------
    margin: negative if something is not kept [any unit].
    places: how it is usually printed, as a format specification with a number of digits.
    """
    for more in range(_MORE_OF_MARGIN + 1) if margin < 0.0 else ():
        text = _with(margin, places, more)
        if float(text) < 0.0:
            return text
    return _with(0.0 if margin <= 0.0 else margin, places, 0)


def left_text(left: float, places: str = "+.3f") -> str:
    """What is left of a condition, in words; one above 0 is not printed as 0 either, unless it is rounding.

    Of a narrow cone so little may be left everywhere that the usual digits show nothing.

    Parameters
    ----------
    left, places: see `margin_text`.
    """
    for more in range(_MORE_OF_MARGIN + 1) if left > 0.0 else ():
        text = _with(left, places, more)
        if float(text) > 0.0:
            return text
    return margin_text(left, places)


def length_text(length: float) -> str:
    """A length of 0 or more [m] in words; below a millimetre, in mm with two digits."""
    return f"{length:.3f} m" if length == 0.0 or length >= 1e-3 else f"{1e3 * length:.2g} mm"


def _with(number: float, places: str, more: int) -> str:
    """A number by a format specification with `more` digits."""
    head, _, tail = places.partition(".")
    return f"{number:{head}.{int(tail[:-1]) + more}{tail[-1]}}"


def _number(text: str) -> float:
    """The number that a reader sees."""
    return float(text.replace(",", ""))


def _is_right(shown: float, value: float, pairs: Iterable[tuple[float, float]], rounding: float) -> bool:
    """Whether a value looks larger or smaller than each bound as it is; `pairs`: bounds as printed, and as they are."""
    return all(abs(value - bound) <= rounding or _sign(shown - seen) == _sign(value - bound) for seen, bound in pairs)


def _sign(difference: float) -> int:
    return 0 if difference == 0.0 or math.isnan(difference) else (1 if difference > 0.0 else -1)
