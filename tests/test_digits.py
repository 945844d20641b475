"""Figures beside a bound: the printed digits say which of the two is larger."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from backhoe_planner.digits import beside_bounds, left_text, margin_text


@pytest.mark.parametrize(
    ("value", "bounds", "places", "bounds_as", "texts"),
    [
        (3.004, (3.0,), ".2f", ".6g", ("3.004", "3")),
        (3.14, (3.0,), ".2f", ".6g", ("3.14", "3")),
        (-169.02, (-169.0, 20.0), ".1f", ".4g", ("-169.02", "-169", "20")),
        (0.49996, (0.49998,), ".3f", ".3g", ("0.49996", "0.49998")),
        (2.0, (2.0,), ".2f", ".6g", ("2.00", "2")),
        (1.5, (-math.inf, math.inf), ".2f", ".6g", ("1.50", "-inf", "inf")),
        (100.00001, (100.0,), ".0f", ".0f", ("100.00001", "100.00000")),
        (5.704, (5.7296,), ".1f", ".4g", ("5.70", "5.73")),
        (5.7296, (5.7296,), ".1f", ".4g", ("5.73", "5.73")),
        (5.66, (5.7296,), ".1f", ".4g", ("5.66", "5.73")),
        (5.74, (5.7296,), ".1f", ".4g", ("5.74", "5.7296")),
        (5.64, (5.7296,), ".1f", ".4g", ("5.6", "5.73")),
        (8.82360003, (8.82359996,), ".2f", ".4g", ("8.82360003", "8.8236")),
    ],
)
def test_digits_are_added_until_the_side_shows(
    value: float, bounds: tuple[float, ...], places: str, bounds_as: str, texts: tuple[str, ...]
) -> None:
    assert beside_bounds(value, *bounds, places=places, bounds_as=bounds_as) == texts


@pytest.mark.parametrize(
    ("margin", "text"), [(0.0004, "+0.000"), (-0.0004, "-0.0004"), (-0.12345, "-0.123"), (-1e-9, "+0.000")]
)
def test_a_missing_margin_is_not_printed_as_none(margin: float, text: str) -> None:
    assert margin_text(margin) == text


@pytest.mark.parametrize(
    ("left", "text"),
    [
        (0.0004, "+0.0004"),
        (0.00061, "+0.001"),
        (0.0, "+0.000"),
        (1e-9, "+0.000"),
        (-1e-9, "+0.000"),
        (-0.0004, "-0.0004"),
    ],
)
def test_what_is_left_is_not_printed_as_nothing(left: float, text: str) -> None:
    assert left_text(left) == text


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_the_printed_pair_is_in_the_order_of_the_numbers(value: float, bound: float) -> None:
    shown, beside = map(float, beside_bounds(value, bound, places=".1f", bounds_as=".4g"))
    if abs(value - bound) > 1e-6:
        assert (shown > beside) == (value > bound)
        assert shown != beside
