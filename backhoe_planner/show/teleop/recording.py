"""A driven motion, from rest to rest, and what stood around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.live import plan_from_recording
from backhoe_planner.machine import Robot
from backhoe_planner.motion import Trajectory
from backhoe_planner.planning import Plan, RecordingNotes
from backhoe_planner.site import Scene, zone_log

__all__ = ["Recording"]


@dataclass(frozen=True)
class Recording:
    """A driven motion, and what stood around it.

    Attributes
    ----------
    dt: between samples [s].
    q: (T, n) joint positions [rad or m].
    obstacles: as in a scene file, times from the beginning of the recording.
    notes: what a scene file cannot say of them.
    """

    dt: float
    q: NDArray[np.float64]
    obstacles: Sequence[dict[str, Any]]
    notes: Sequence[str]

    @property
    def duration(self) -> float:
        """[s]"""
        return (len(self.q) - 1) * self.dt

    def plan(self, robot: Robot, scene: Scene) -> Plan:
        """The motion as a plan, with its certificate, and its visits to zones in the findings."""
        trajectory = Trajectory.from_steps(np.asarray(np.arange(len(self.q)) * self.dt, dtype=np.float64), self.q)
        return plan_from_recording(
            robot,
            scene,
            trajectory,
            obstacles=self.obstacles,
            recording=RecordingNotes(dt=self.dt, notes=tuple(self.notes)),
            zones=zone_log(robot, scene, trajectory),
        )
