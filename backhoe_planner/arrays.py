"""Numbers and arrays of numbers: their names in annotations, and the checks of arguments.

The shape of an array is given where its name is used. Public functions call the functions here
first. A value that can be read as such an array, such as a list, is returned as an array;
anything else is an `InputError` that names the argument.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError

Array: TypeAlias = NDArray[np.float64]
"""Of any shape."""
Matrix: TypeAlias = NDArray[np.float64]
"""With two axes."""
Vector: TypeAlias = NDArray[np.float64]
"""With one axis."""
Indices: TypeAlias = NDArray[np.intp]
"""Indices of rows, with one axis."""
Flags: TypeAlias = NDArray[np.bool_]
"""Truth values, of any shape."""

_FLOAT = np.dtype(np.float64)
_SMALL = 10_000  # numbers: for more BLAS uses threads, which wait for each other on a busy machine


def as_array(
    value: Any, *shape: int | None, key: str, finite: bool = True, names: Sequence[str] | None = None
) -> Array:
    """`value` as an array of floats; `value` itself if it is one.

    Parameters
    ----------
    value: an array, or numbers in lists.
    shape: the length of each axis, None for any length; if no length is given, every shape is allowed.
    key: the name of the argument, for messages.
    finite: whether all numbers must be finite; otherwise only nan is refused.
    names: of the numbers, for messages, if there is one axis.

    Raises
    ------
    InputError: it holds something other than numbers, has another shape, or a number is not finite.
    """
    try:  # takes a microsecond if the value is already right
        is_right = value.dtype is _FLOAT and value.size <= _SMALL and math.isfinite(np.vdot(value, value))
        if is_right and (not shape or _fits(value.shape, shape)):
            return np.asarray(value)
    except (AttributeError, TypeError):
        pass
    try:
        found = np.asarray(value)
    except (TypeError, ValueError, OverflowError):  # such as lists of different lengths
        found = np.empty((), dtype=object)
    allowed = " x ".join("any" if n is None else str(n) for n in shape) + " numbers" * bool(shape) or "numbers"
    allowed += f": {', '.join(names)}" if names else ""
    if found.dtype.kind not in "fiu":
        raise InputError("is not numbers", key=key, found=reprlib.repr(value), allowed=allowed)
    if shape and not _fits(found.shape, shape):
        raise InputError("has the wrong shape", key=key, found=f"shape {found.shape}", allowed=allowed)
    array = np.asarray(found, dtype=float)
    wrong = ~np.isfinite(array) if finite else np.isnan(array)
    if wrong.any():
        where = f" ({', '.join(name for name, bad in zip(names, wrong, strict=False) if bad)})" if names else ""
        raise InputError("is not finite", key=key + where, found=reprlib.repr(array.tolist()), allowed=allowed)
    return array


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(shape) == len(wanted) and all(n is None or n == m for n, m in zip(wanted, shape, strict=True))


def as_vector(value: Any, n: int | None, *, key: str, names: Sequence[str] | None = None) -> Vector:
    """(n,) finite numbers, any number of them if `n` is None; see `as_array`. Takes half a microsecond for an array."""
    try:
        if value.dtype is _FLOAT and value.shape == (n,) and math.isfinite(sum(value.tolist())):
            return value  # type: ignore[no-any-return]
    except (AttributeError, TypeError):
        pass
    return as_array(value, n, key=key, names=names)


def as_rows(value: Any, n: int, *, key: str, beside: Array | None = None) -> Array:
    """(..., n) finite numbers, see `as_array`; their shape must broadcast with that of `beside`.

    Raises
    ------
    InputError: it is not such an array.
    """
    array = as_array(value, key=key)
    if array.ndim == 0 or array.shape[-1] != n:
        raise InputError("has the wrong shape", key=key, found=f"shape {array.shape}", allowed=f"... x {n} numbers")
    if beside is not None and array.shape != beside.shape:
        try:
            np.broadcast_shapes(array.shape[:-1], beside.shape[:-1])
        except ValueError:
            allowed = f"as many rows as shape {beside.shape} has"
            raise InputError("has the wrong shape", key=key, found=f"shape {array.shape}", allowed=allowed) from None
    return array


def as_number(
    value: Any,
    *,
    key: str,
    least: float = -math.inf,
    most: float = math.inf,
    above: float = -math.inf,
    finite: bool = True,
) -> float:
    """`value` as a float from `least` to `most` that is greater than `above`; finite unless `finite` is false.

    Raises
    ------
    InputError: it is not such a number.
    """
    if isinstance(value, float) and least <= value <= most and value > above and (not finite or math.isfinite(value)):
        return float(value)
    limits = ((above, "greater than"), (least, "of at least"), (most, "of at most"))
    words = [f"{word} {limit:g}" for limit, word in limits if math.isfinite(limit)]
    allowed = " ".join(("a number", " and ".join(words))).strip()
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InputError("is not a number", key=key, found=reprlib.repr(value), allowed=allowed)
    try:
        found = float(value)
    except OverflowError:  # it has hundreds of digits, too many to print
        below = f"a whole number {'below -' if value < 0 else 'above '}1e308"
        raise InputError("is not in its range", key=key, found=below, allowed=allowed) from None
    if not (least <= found <= most and found > above) or (finite and math.isinf(found)):
        raise InputError("is not in its range", key=key, found=found, allowed=allowed)
    return found


def as_count(value: Any, *, key: str, least: int = 0) -> int:
    """`value` as an int of at least `least`.

    Raises
    ------
    InputError: it is not such a number.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(
            "is not a whole number in its range", key=key, found=reprlib.repr(value), allowed=f"{least} or more"
        )
    return int(value)
