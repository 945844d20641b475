"""A timeline as an animation that plays in the browser by itself.

A track is a list of times and a list of values, packed as 32-bit numbers: a second of
motion costs about 1 kB per moving link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import umsgpack

from backhoe_planner.arrays import Array

__all__ = ["PlanAnimation", "Track"]


_TYPES = {"position": "vector3", "scale": "vector3", "quaternion": "quaternion", "material.color": "color"}
_FLOAT32 = 0x17  # meshcat's extension code


@dataclass(frozen=True, eq=False)
class Track:
    """One property of one node over time.

    Attributes
    ----------
    path: of the node in the viewer's tree.
    kind: ``position``, ``scale``, ``quaternion`` (x, y, z, w) or ``material.color``.
    time: (K,) rising [s].
    values: (K, 3) or, for a quaternion, (K, 4).
    """

    path: str
    kind: str
    time: Array
    values: Array

    def lower(self) -> dict[str, Any]:
        """As three.js reads it."""
        return {
            "name": f".{self.kind}",
            "type": _TYPES[self.kind],
            "times": _packed(self.time),
            "values": _packed(self.values),
        }


class PlanAnimation:
    """Tracks that play together; stands where meshcat expects its own ``Animation``."""

    def __init__(self, tracks: Sequence[Track], duration: float) -> None:
        self.tracks = tuple(tracks)
        self.duration = duration

    def lower(self) -> list[dict[str, Any]]:
        """As meshcat's viewer reads it: one clip per node."""
        clips: dict[str, list[dict[str, Any]]] = {}
        for track in self.tracks:
            clips.setdefault(track.path, []).append(track.lower())
        return [
            {"path": path, "clip": {"fps": 1, "name": "plan", "duration": self.duration, "tracks": tracks}}
            for path, tracks in clips.items()
        ]


def _packed(values: Array) -> Any:
    return umsgpack.Ext(_FLOAT32, np.ascontiguousarray(values, dtype="<f4").tobytes())
