"""What a planner found out besides the motion itself."""

from __future__ import annotations

from backhoe_planner.files.records import Figure, Record
from backhoe_planner.site import Obstruction, Transgression


class NearestPose(Record):
    """The nearest pose to a target that the tip can reach."""

    q: tuple[float, ...]
    """(n,) joint positions there [rad or m]."""
    position: tuple[float, float, float]
    """Of the tip [m], in the world frame."""
    position_error: float
    """From the target [m]."""
    angle_error: float
    """From the target [rad]."""


class Reaction(Record):
    """The reaction to an obstacle that appears in the way; of a leg, in the time from its beginning."""

    obstacle: str
    """Its name."""
    appears_at: float
    """When [s]."""
    way: str = ""
    """How the motion goes on: ``swerved``, ``stopped and planned anew``; empty if it does not go on.

    ``gave way with more than its drive can do, and planned anew`` is a motion that the certificate refutes.
    """
    stopped_at: float | None = None
    """When the machine is at rest [s]; None if it does not stop."""

    def later(self, time: float) -> Reaction:
        """The same in the time of a motion in which the leg begins at `time` [s]."""
        stopped_at = None if self.stopped_at is None else self.stopped_at + time
        return self.model_copy(update={"appears_at": self.appears_at + time, "stopped_at": stopped_at})

    @property
    def words(self) -> str:
        """When the obstacle appears, and how the motion goes on, in words."""
        return f"{self.obstacle} appears at {self.appears_at:.2f} s: {self.reply}"

    @property
    def reply(self) -> str:
        """What the machine does, in words: ``stopped and planned anew, at rest at 2.40 s``."""
        stopped = "" if self.stopped_at is None else f", at rest at {self.stopped_at:.2f} s"
        return f"{self.way or 'no way to stop in time'}{stopped}"


class RecordingNotes(Record):
    """What a recording of a motion driven by hand leaves out."""

    dt: float
    """Between its samples [s]."""
    notes: tuple[str, ...]
    """What a scene file cannot express of the obstacles, in words."""


class FastMotion(Record):
    """A fast motion to the goal, which a search for another objective found first."""

    duration: Figure
    """How long it takes [s]."""
    cost: Figure
    """What it costs by the objective of the plan, in the unit of that."""


class Findings(Record):
    """The numbers behind a plan's reason, and how its motion was found."""

    obstruction: Obstruction | None = None
    """What is in the way, if anything is."""
    detours: tuple[Obstruction, ...] = ()
    """What each detour goes around, with the part of the path that it leaves out."""
    joints: tuple[str, ...] = ()
    """Names of the joints outside their limits, or at them in the nearest pose."""
    nearest: NearestPose | None = None
    """The nearest pose, if the target is out of reach."""
    left_out: tuple[str, ...] = ()
    """Why some goals of a list are left out of the search, one sentence for each: out of reach, in a collision, ..."""
    way: str = ""
    """How the goal was reached: ``straight``, ``sampled`` and so on."""
    allowed_time: Figure | None = None
    """How long a motion to a goal was allowed to take, if its objective is not the time, with all waits before it [s].

    None also if the motion takes longer because of the limit of the tip's speed, and if the machine swerved.
    """
    fast: FastMotion | None = None
    """The motion from which the search for another objective than the time learnt how long a motion may take.

    It touches nothing, and is not always the fastest. None if none was needed or found, beside obstacles that move or
    appear, and with a limit of the tip's speed.
    """
    attempts: int = 0
    """How many attempts the local law made."""
    closest_distance: float | None = None
    """From the goal in the attempt that came closest [m]."""
    iterations: int = 0
    """Of the law as printed."""
    waits: float = 0.0
    """For moving obstacles to pass [s]."""
    reactions: tuple[Reaction, ...] = ()
    """To obstacles that appear."""
    recording: RecordingNotes | None = None
    """Of a motion that was driven by hand."""
    zones: tuple[Transgression, ...] = ()
    """Visits to zones in a motion that was driven by hand."""


NOTHING = Findings()
