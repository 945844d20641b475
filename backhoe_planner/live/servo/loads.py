"""What the machine carries in the legs of a scene's sequence, each as a machine with a larger shape."""

from __future__ import annotations

from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.live.planes.own_pieces import NO_LOAD
from backhoe_planner.machine import Robot
from backhoe_planner.site import Scene, with_carried


class Loads:
    """The loads of a scene's sequence by their legs; legs that carry the same share one load.

    Attributes
    ----------
    laden: the machine with each load; the index is the load's number.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self.laden: tuple[Robot, ...] = ()
        self._number: dict[str, int] = {}
        known: list[object] = []
        for index, leg in enumerate(scene.task.sequence or ()):
            if leg.carries is not None and leg.carries not in known:
                known.append(leg.carries)
                self.laden = (*self.laden, with_carried(robot, scene, index))
            self._number[leg.name] = NO_LOAD if leg.carries is None else known.index(leg.carries)

    def number_of(self, leg: str | None) -> int:
        """The number of the load of a leg, `NO_LOAD` if the leg carries nothing or `leg` is None.

        Raises
        ------
        InputError: the scene has no such leg.
        """
        if leg is None:
            return NO_LOAD
        if check_kind(leg, str, key="leg") not in self._number:
            allowed = ", ".join(self._number) or "none: the scene has no sequence"
            raise InputError("the scene has no such leg", key="leg", found=leg, allowed=allowed)
        return self._number[leg]
