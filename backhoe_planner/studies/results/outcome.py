"""What came of one row of a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

Verdict = Literal["verified", "failed", "invalid", "crashed", "error"]
VERDICTS: tuple[Verdict, ...] = ("verified", "failed", "invalid", "crashed", "error")


@dataclass(frozen=True)
class Outcome:
    """What came of one row.

    Attributes
    ----------
    row: its number.
    verdict: ``verified`` or ``failed`` as the plan says; ``invalid`` where its values make no scene or job for the
        machine, ``crashed`` where the process that planned it died twice, ``error`` where planning raised an
        exception, which is a fault of the planner.
    reason: of a failed plan; else that is the verdict, and nothing where it is verified.
    message: the same in a sentence.
    metrics: what is kept of the plan, by name.
    timing: what depends on the computer: `processor` and `wall` time [s], `host`, `process`.
    plan: the plan's file, where it is kept.
    """

    row: int
    verdict: Verdict
    reason: str = ""
    message: str = ""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    timing: Mapping[str, Any] = field(default_factory=dict)
    plan: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """All but the plan, as plain data."""
        return {
            "row": self.row, "verdict": self.verdict, "reason": self.reason, "message": self.message,
            "metrics": dict(self.metrics), "timing": dict(self.timing),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Outcome:
        """The outcome of which `to_dict` made this; KeyError, TypeError or ValueError where none did."""
        found = cls(
            int(content["row"]), content["verdict"], str(content["reason"]), str(content["message"]),
            dict(content["metrics"]), dict(content["timing"]),
        )  # fmt: skip
        if found.verdict not in VERDICTS:
            raise ValueError(f"{found.verdict!r} is no verdict")
        return found

    def without_plan(self) -> Outcome:
        """The same, with nothing that is large."""
        return self if self.plan is None else replace(self, plan=None)


def crashed(row: int) -> Outcome:
    """A row of which the process died, twice."""
    message = "the process that planned it ended without a word, twice: out of memory, or a fault in a library"
    return Outcome(row, "crashed", "crashed", message)
