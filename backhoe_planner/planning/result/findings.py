"""What a planner found out on the way to a motion, beside the motion itself."""

from __future__ import annotations

from backhoe_planner.files.records import Figure, Record
from backhoe_planner.site import Obstruction, Transgression


class NearestPose(Record):
    """The nearest to a target that the tip can get to."""

    q: tuple[float, ...]
    """(n,) joint positions there [rad or m]."""
    position: tuple[float, float, float]
    """Of the tip [m], world."""
    position_error: float
    """From the target [m]."""
    angle_error: float
    """From the target [rad]."""


class Reaction(Record):
    """What was done about an obstacle that appears in the way."""

    obstacle: str
    """Its name."""
    appears_at: float
    """When [s]."""
    way: str = ""
    """How the motion goes on: ``swerved``, ``stopped and planned anew``; empty where it does not."""
    stopped_at: float | None = None
    """When the machine stands [s]; None where it does not stop."""


class RecordingNotes(Record):
    """What a recording of a motion driven by hand leaves out."""

    dt: float
    """Between its samples [s]."""
    notes: tuple[str, ...]
    """What a scene file cannot say of the obstacles, in words."""


class Findings(Record):
    """The numbers behind a plan's reason, and how its motion was found."""

    obstruction: Obstruction | None = None
    """What is in the way, where something is."""
    detours: tuple[Obstruction, ...] = ()
    """What each detour goes round, with the part of the path that it leaves out."""
    joints: tuple[str, ...] = ()
    """Names of the joints outside their limits, or at them in the nearest pose."""
    nearest: NearestPose | None = None
    """Where the target is out of reach."""
    way: str = ""
    """How the goal was reached: ``straight``, ``sampled`` and so on."""
    allowed_time: Figure | None = None
    """How long a motion to a goal for another objective than the time might take, with all waits before it [s].

    None also where it takes longer as the tip is to be slow, and where the machine swerved.
    """
    attempts: int = 0
    """How many attempts the local law made."""
    closest_distance: float | None = None
    """From the goal, of the attempt that came closest [m]."""
    iterations: int = 0
    """Of the law as printed."""
    waits: float = 0.0
    """For what moves to pass [s]."""
    reactions: tuple[Reaction, ...] = ()
    """To obstacles that appear."""
    recording: RecordingNotes | None = None
    """Of a motion that was driven by hand."""
    zones: tuple[Transgression, ...] = ()
    """Visits to zones, of a motion that was driven by hand."""


NOTHING = Findings()
