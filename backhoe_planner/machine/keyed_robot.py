"""A machine that a cache of functions takes for others with the same key."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

from backhoe_planner.machine.robot import Robot

_Key = TypeVar("_Key", bound=Hashable)


class KeyedRobot(Generic[_Key]):
    """A machine that equals every other one with the same key: all that a function of it depends on.

    The machine lives as long as this object, so that the `id` of what it holds may be a part of the key.
    """

    def __init__(self, robot: Robot, key: _Key) -> None:
        self.robot, self.key = robot, key

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, KeyedRobot) and bool(self.key == other.key)
