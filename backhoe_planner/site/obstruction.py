"""An obstruction of a motion: one record, from where it is found to where it is printed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pydantic import ConfigDict, with_config

from backhoe_planner.digits import length_text

ObstructionKind = Literal["obstacle", "machine", "joint"]


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True)
class Obstruction:
    """The tightest spot between a link and what it must keep away from, or a joint at its limit.

    Attributes
    ----------
    kind: ``obstacle`` of the site, ``machine`` for another link of the machine, ``joint`` for a joint's limit.
    obstacle: name of the obstacle, of that other link, or of the joint.
    link: name of the link that comes near; empty for a joint.
    distance: signed, negative inside [m]; for a joint, the distance to its limit [rad or m]. A certificate
        gives the proven lower bound.
    margin: `distance` minus the clearance that must be kept [m]; for a joint, `distance`.
    time: when [s]; 0 if nothing moves.
    tracking: how much of the distance the machine's tracking error can use up; the margin excludes it [m].
    path_from, path_to: the part of the path that it concerns [m]; None if it concerns none.
    """

    kind: ObstructionKind
    obstacle: str
    link: str
    distance: float
    margin: float
    time: float = 0.0
    path_from: float | None = None
    path_to: float | None = None
    tracking: float = 0.0

    @classmethod
    def joint_limit(cls, joint: str, distance: float = 0.0) -> Obstruction:
        """A joint that is `distance` [rad or m] before its limit, or beyond it (negative)."""
        return cls("joint", joint, "", distance, distance)

    @property
    def name(self) -> str:
        """For a sentence: ``gas pipe``, ``the machine itself (boom)``, ``the limit of joint boom``."""
        if self.kind == "machine":
            return f"the machine itself ({self.obstacle})"
        return f"the limit of joint {self.obstacle}" if self.kind == "joint" else self.obstacle

    def __str__(self) -> str:
        """`name` and the link: ``gas pipe (at bucket)``."""
        return f"{self.name} (at {self.link})" if self.link else self.name

    def describe(self) -> str:
        """How close it is: ``bucket is 0.140 m inside rock``."""
        if self.kind == "joint":
            return f"{self.obstacle} is {'beyond' if self.margin < 0.0 else 'at'} its limit"
        if self.distance < 0.0:
            return f"{self.link} is {length_text(-self.distance)} inside {self.name}"
        than = "closer than allowed" if self.margin < 0.0 else "more than the least allowed"
        return f"{self.link} is {length_text(self.distance)} from {self.name}, {length_text(abs(self.margin))} {than}"


@dataclass(frozen=True)
class Pair:
    """Two convex pieces that must keep apart.

    Attributes
    ----------
    link: name of the link.
    kind: ``obstacle``, or ``machine`` if both pieces are the machine's.
    obstacle: name of the obstacle, or of the machine's other link.
    piece: index into the robot's pieces, for ``machine`` into its `self_pieces`.
    clearance: signed distance to be kept [m], including `tracking`.
    tracking: the part of the clearance for the machine's tracking error [m].
    """

    link: str
    kind: ObstructionKind
    obstacle: str
    piece: int
    clearance: float
    tracking: float = 0.0

    @property
    def name(self) -> str:
        """What the link must keep away from, for a sentence; see `Obstruction`."""
        return self.at(0.0).name

    def at(self, distance: float, *, time: float = 0.0) -> Obstruction:
        """The obstruction by this pair, `distance` apart [m] at `time` [s]."""
        margin = distance - self.clearance
        return Obstruction(self.kind, self.obstacle, self.link, distance, margin, time, tracking=self.tracking)
