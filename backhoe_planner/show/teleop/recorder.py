"""Takes down a driven motion, from rest to rest, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.live import plan_from_recording
from backhoe_planner.machine import Robot
from backhoe_planner.motion import Trajectory
from backhoe_planner.planning import Plan
from backhoe_planner.site import Scene, zone_log

__all__ = ["Recorder", "Recording"]

Vector = NDArray[np.float64]

_FIRST = 4096  # samples that there is room for at first


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
        """The motion as a plan, with its certificate, and its visits to zones in the details."""
        trajectory = Trajectory.from_steps(np.asarray(np.arange(len(self.q)) * self.dt, dtype=np.float64), self.q)
        visits = [asdict(visit) for visit in zone_log(robot, scene, trajectory)]
        details = {"recorded": {"dt": self.dt, "notes": list(self.notes)}, "zones": visits}
        return plan_from_recording(robot, scene, trajectory, obstacles=self.obstacles, details=details)


class Recorder:
    """Keeps samples at even times.

    Parameters
    ----------
    begun: time of the first sample [s].
    q: (n,) the first sample; the machine is at rest there.
    dt: between samples [s].
    longest: after which no more are taken [s].
    """

    def __init__(self, begun: float, q: Vector, dt: float, *, longest: float) -> None:
        self.begun = begun
        self._dt = dt
        self._most = int(longest / dt) + 1
        self._samples = np.empty((_FIRST, len(q)))
        self._samples[0] = q
        self._count = 1

    @property
    def duration(self) -> float:
        """[s]"""
        return (self._count - 1) * self._dt

    @property
    def full(self) -> bool:
        """Whether there is no room for more."""
        return self._count >= self._most

    def note(self, q: Vector) -> None:
        """Take the next sample (n,)."""
        if self._count == len(self._samples):
            self._samples = np.vstack((self._samples, np.empty_like(self._samples)))
        self._samples[self._count] = q
        self._count += 1

    def finish(self, obstacles: Sequence[dict[str, Any]], notes: Sequence[str]) -> Recording:
        """What was taken down."""
        return Recording(self._dt, self._samples[: self._count].copy(), obstacles, notes)
