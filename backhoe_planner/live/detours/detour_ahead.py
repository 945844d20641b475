"""A detour that begins ahead of the machine, and is searched while it drives there.

The plan's clock comes to rest at the place where the detour begins (`stop_ahead`). If it is found by then, the machine
goes on along it at once; otherwise it rests there until the answer comes.
"""

from __future__ import annotations

from dataclasses import dataclass

from backhoe_planner.live.detours.rejoining import Rejoining
from backhoe_planner.live.detours.stop_ahead import Approach
from backhoe_planner.live.detours.track_proof import Blockage
from backhoe_planner.live.servo.track import Track

_SAME = 0.1  # s by which the beginning of a blockage may differ and still be that of the same one; chosen


@dataclass
class DetourAhead:
    """A detour around a blockage of the plan, from a place before it.

    Attributes
    ----------
    approach: the plan up to where the detour begins, at rest there.
    track: of the approach.
    blockage: that the detour goes around.
    found: the detour, once it is found.
    failed: whether none was found. Then the machine goes on along the plan, once it has come to rest: on the way it may
        depend on the approach.
    """

    approach: Approach
    track: Track
    blockage: Blockage
    found: Rejoining | None = None
    failed: bool = False

    def is_around(self, blockage: Blockage) -> bool:
        """Whether it is still this that is in the way."""
        own = self.blockage
        return blockage.name == own.name and abs(blockage.begins - own.begins) < _SAME

    @property
    def reason(self) -> str:
        """Why the machine will leave the plan, in words."""
        way = (
            "a way round is searched for"
            if self.found is None
            else f"a way round begins at {self.approach.place:.1f} s of it"
        )
        return f"{self.blockage.name} is on the rest of the plan; {'no way round was found' if self.failed else way}"
