"""Quantities in words, for the terminal and the page."""

from __future__ import annotations


def describe_quantity(value: float, unit: str) -> str:
    """A `value` in four digits with its `unit` and a suitable prefix: 11.39 kJ, 14.00 kJ, 1357 (kN m)^2 s."""
    if unit == "N^2 m^2 s" and abs(value) >= 1e4:
        value, unit = 1e-6 * value, "(kN m)^2 s"
    elif unit.startswith("J"):
        for prefix, factor in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
            if abs(value) >= factor:
                return f"{_in_digits(value / factor)} {prefix}{unit}"
    return f"{_in_digits(value)} {unit}" if abs(value) < 1e4 else f"{value:,.0f} {unit}"


def _in_digits(value: float) -> str:
    """A value in four digits, with trailing zeros; only 0 is just 0."""
    return f"{value:#.4g}".removesuffix(".") if value else "0"


def describe_least_cost(objective: str, least: float, unit: str) -> str:
    """The `least` possible cost by an objective in words: ``no motion can take less work than 1.234 kJ``."""
    what = "hydraulic energy" if objective == "hydraulic" else objective
    return f"no motion can take less {what} than {describe_quantity(least, unit)}"


def describe_excess(value: float, least: float) -> str:
    """How much a `value` is above the `least` possible one, such as ``18 % more``; never negative."""
    return f"{max(100.0 * (value / least - 1.0), 0.0):.0f} % more"
