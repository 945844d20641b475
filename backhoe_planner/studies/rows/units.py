"""The units of the parameters of a study, and of the figures that it keeps, by their key paths."""

from __future__ import annotations

import re
from collections.abc import Sequence

from backhoe_planner.motion import OBJECTIVES

_UNITS = {
    "m": (
        "tip_length", "length", "max_deviation", "path_from", "path_to", "tracking", "followed", "max", "mean",
        "closest_distance", "position_error", "left", "below",
    ),
    "s": (
        "duration", "time", "time_from", "time_to", "allowed_time", "appears_at", "stopped_at", "dt", "waits",
        "begin", "end", "seconds_per_cycle", "planning_time",
    ),
    "m/s": ("asked", "least"),
    "%": ("kept_percent", "longer_percent"),
    "rad": ("max_angle", "angle_error"),
    "J": ("work", "hydraulic", "joules_per_cycle"),
    "m^3": ("design", "bank", "loose", "undug"),
    "m^3/h": ("production",),
    "kWh/m^3": ("kwh_per_m3",),
    "l": ("litres",),
}  # fmt: skip
_IN_WORDS = re.compile(r"\[([^\]]+)\]")  # as the descriptions of the schema's keys have them: "Edge of a voxel [m]."
_NO_UNITS = ("low, high", "w, x, y, z")  # other brackets in them
_OF_KEY = {key: unit for unit, keys in _UNITS.items() for key in keys}
_OF_CLEARANCE = ("value", "margin")  # [m]; the same keys have other units elsewhere
_OF_OBJECTIVE = ("value", "law", "whole", "cost")  # below `cost` and `objective`; the last below `fast`


def unit_of(keys: Sequence[str], objective: str | None = None) -> str:
    """The unit of a figure.

    Empty for a figure without a unit, such as a count or a ratio, and for one whose unit differs from plan to plan,
    such as that of `certificate.keep.0.margin`.

    Parameters
    ----------
    keys: the path to the figure, see `Metric`.
    objective: the name of the objective that all plans minimise; None if it differs.
    """
    last, above = keys[-1], list(keys[-2:-1])
    if above == ["energy"]:
        return OBJECTIVES[last].unit
    if above in (["cost"], ["objective"]) or (above == ["fast"] and last == "cost"):
        return OBJECTIVES[objective].unit if objective is not None and last in _OF_OBJECTIVE else ""
    if last in _OF_CLEARANCE:
        return "m" if "clearances" in keys or "min_clearance" in keys else ""
    if "limits" in keys:
        return "s" if last == "time" else ""
    if above == ["position"]:
        return "m"
    return _OF_KEY.get(last, "")


def unit_in(descriptions: Sequence[str]) -> str:
    """The unit of a parameter, from the schema's words about it; empty if they give none, or several."""
    found = {unit for words in descriptions for unit in _IN_WORDS.findall(words)}
    units = found.difference(_NO_UNITS)
    return units.pop() if len(units) == 1 else ""
