"""The part of the scene file that limits the machine's joints."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from backhoe_planner.files.numbers import number
from backhoe_planner.files.records import Record
from backhoe_planner.site.schema.quantities import Finite, Positive

_SLOWEST = 1e-4  # rad/s or m/s, and per second: chosen, a motion of 1 rad then takes hours


def _not_too_slow(rate: float) -> float:
    if rate < _SLOWEST:
        raise ValueError(
            f"is too slow: {rate:g}; allowed: at least {_SLOWEST:g} (a joint that is to stand still is one of `hold`)"
        )
    return rate


def _in_order(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] >= ends[1]:
        raise ValueError(f"low is not below high: {list(ends)} (a joint that is to stand still is one of `hold`)")
    return ends


Rate = Annotated[Positive, AfterValidator(_not_too_slow)]
PositionRange = Annotated[tuple[Finite, Finite], AfterValidator(_in_order)]


class Limits(Record):
    """How much of the machine's limits may be used, and limits that its URDF does not have."""

    velocity_scale: Annotated[float, number(gt=0.0, le=1.0), AfterValidator(_not_too_slow)] = 1.0
    """Part of each joint's rate that may be used."""
    acceleration: dict[str, Rate] = Field(default_factory=dict)
    """By joint name [rad/s^2 or m/s^2]; by default the URDF's, or if it has none, full rate in 0.5 s."""
    velocity: dict[str, Rate] = Field(default_factory=dict)
    """By joint name [rad/s or m/s]: at most the URDF's, or any if it has none; by default the URDF's, or else 1."""
    effort: dict[str, Positive] = Field(default_factory=dict)
    """By joint name [N m or N]: at most the URDF's, or any if it has none; by default the URDF's, or else no limit."""
    position: dict[str, PositionRange] = Field(default_factory=dict)
    """[low, high] by joint name, within the URDF's limits [rad or m]."""
