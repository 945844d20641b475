"""The values of a parameter: listed one by one, a range, or a distribution to draw from."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from backhoe_planner.errors import nearest_name

MOST_VALUES = 1_000_000  # of one parameter, and rows of a study; chosen: a month of a core at 2.5 s a plan
_DIGITS = 12  # of a number in a range, so that 0.1 + 2 * 0.1 is 0.3
_KINDS = ("from", "uniform", "normal", "log_uniform", "choice")


@dataclass(frozen=True)
class Values:
    """The values of a parameter.

    Attributes
    ----------
    listed: values one by one; empty if they are drawn.
    draw: draws one value with a generator; None if they are listed.
    words: describe a distribution in messages and pages: ``uniform [0.1, 0.3]``.
    """

    listed: tuple[Any, ...] = ()
    draw: Callable[[np.random.Generator], Any] | None = None
    words: str = ""

    def one(self, rng: np.random.Generator) -> Any:
        """A random value: from the distribution, or any of those listed."""
        return self.draw(rng) if self.draw is not None else self.listed[int(rng.integers(len(self.listed)))]


def plain(found: Any) -> Any:
    """The same as plain data: with lists instead of numpy arrays, and Python numbers.

    Raises
    ------
    ValueError: it contains a number that is not finite, or something that no file could contain.
    """
    if hasattr(found, "tolist"):
        found = found.tolist()
    if isinstance(found, Mapping):
        return {str(key): plain(value) for key, value in found.items()}
    if isinstance(found, (list, tuple)):
        return [plain(value) for value in found]
    if isinstance(found, float) and not math.isfinite(found):
        raise ValueError(f"holds {found}; allowed: finite numbers")
    if found is not None and not isinstance(found, (bool, int, float, str)):
        raise ValueError(f"holds {found!r:.60}; allowed: numbers, text, lists, keys and values")
    return found


def read_values(found: Any) -> Values:
    """The values of a parameter, from the way that the study file gives them.

    Raises
    ------
    ValueError: what is wrong with it, in words.
    """
    if isinstance(found, (list, tuple)):
        if not found:
            raise ValueError("is an empty list; allowed: at least one value")
        return Values(tuple(found))
    if not isinstance(found, Mapping):
        if found is None:
            raise ValueError("has no value; allowed: a value, a list, a range or a distribution")
        return Values((found,))
    kind = next((key for key in _KINDS if key in found), None)
    if kind is None or kind == "from":
        if kind is None and not {"to", "count", "step"} & set(found):
            first = next(iter(map(str, found)), "")
            near = nearest_name(first, _KINDS)
            hint = f"; did you mean {near!r}?" if near else "."
            raise ValueError(
                f"there is no such key: {first!r}{hint} Allowed: {{from, to, count}}, {{from, to, step}}, "
                "{uniform: [a, b]}, {normal: [m, s]}, {log_uniform: [a, b]}, {choice: [...]}"
            )
        return Values(_range(found))
    _only(found, {kind})
    if kind == "choice":
        choices = found[kind]
        if not isinstance(choices, (list, tuple)) or not choices:
            raise ValueError(f"choice is not a list of at least one value; found {choices!r}")
        return Values(draw=lambda rng: choices[int(rng.integers(len(choices)))], words=f"any of {list(choices)}")
    return Values(draw=_distribution(kind, found[kind]), words=f"{kind} {list(found[kind])}")


def _range(found: Mapping[str, Any]) -> tuple[float, ...]:
    """The values of {from, to, count} or {from, to, step}, including both ends if the step leads there."""
    _only(found, {"from", "to", "count", "step"})
    missing = [key for key in ("from", "to") if key not in found]
    if missing:
        raise ValueError(f"the range has no {missing[0]}; allowed: {{from, to, count}} or {{from, to, step}}")
    if ("count" in found) == ("step" in found):
        raise ValueError(
            "the range needs exactly one of count and step; allowed: {from, to, count} or {from, to, step}"
        )
    begin, end = _number(found["from"], "from"), _number(found["to"], "to")
    if "count" in found:
        count = found["count"]
        if type(count) is not int or not 1 <= count <= MOST_VALUES:
            raise ValueError(f"the range is empty or too long: count is {count!r}; allowed: 1 to {MOST_VALUES}")
        if count == 1 and begin != end:
            raise ValueError(f"a range from {begin:g} to {end:g} has at least 2 values; found count 1")
        steps = np.linspace(begin, end, count).tolist()
    else:
        step = _number(found["step"], "step")
        if step == 0.0 or (end - begin) / step < 0.0:
            raise ValueError(f"the range is empty: from {begin:g} to {end:g} in steps of {step:g}")
        # one part in 1e9 of a step beyond the end is rounding
        count = math.floor((end - begin) / step + 1e-9) + 1
        if count > MOST_VALUES:
            raise ValueError(f"the range has {count} values; allowed: at most {MOST_VALUES}")
        steps = [begin + k * step for k in range(count)]
    whole = all(type(found[key]) is int for key in ("from", "to")) and type(found.get("step", 0)) is int
    if whole and all(float(value).is_integer() for value in steps):
        return tuple(int(value) for value in steps)
    return tuple(float(f"{value:.{_DIGITS}g}") for value in steps)


def _distribution(kind: str, given: Any) -> Callable[[np.random.Generator], float]:
    names = "mean, standard deviation" if kind == "normal" else "least, greatest"
    if not isinstance(given, (list, tuple)) or len(given) != 2:
        raise ValueError(f"{kind} is not a pair of numbers; found {given!r}; allowed: [{names}]")
    first, second = (_number(value, kind) for value in given)
    if kind == "normal":
        if second < 0.0:
            raise ValueError(f"normal has a negative standard deviation: {second:g}")
        return lambda rng: float(rng.normal(first, second))
    if not first < second:
        raise ValueError(f"{kind} is empty: {first:g} is not below {second:g}")
    if kind == "uniform":
        return lambda rng: float(rng.uniform(first, second))
    if first <= 0.0:
        raise ValueError(f"log_uniform has {first:g}; allowed: numbers above 0")
    return lambda rng: math.exp(float(rng.uniform(math.log(first), math.log(second))))


def _number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{key} is not a finite number; found {value!r}")
    return float(value)


def _only(found: Mapping[str, Any], allowed: set[str]) -> None:
    extra = sorted(str(key) for key in found if key not in allowed)
    if extra:
        near = nearest_name(extra[0], allowed)
        hint = f"; did you mean {near!r}?" if near else "."
        raise ValueError(f"there is no such key: {extra[0]!r}{hint} Allowed: {', '.join(sorted(allowed))}")
