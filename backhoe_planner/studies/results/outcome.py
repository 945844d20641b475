"""The result of one row of a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

Verdict = Literal["verified", "failed", "invalid", "crashed", "error"]
VERDICTS: tuple[Verdict, ...] = ("verified", "failed", "invalid", "crashed", "error")


@dataclass(frozen=True)
class Outcome:
    """The result of one row.

    Attributes
    ----------
    row: its number.
    verdict: ``verified`` or ``failed`` for a plan; ``invalid`` if its values make no valid scene or job for the
        machine, ``crashed`` if the process that planned it died twice, ``error`` if planning raised an
        exception, which is a fault of the planner.
    reason: of a failed plan; empty if verified; otherwise the same as the verdict.
    message: the same in a sentence.
    metrics: the figures of the plan that are kept, by name.
    timing: the values that depend on the computer: `processor` and `wall` time [s], `host`, `process`.
    plan: the content of the plan's file, if it is kept.
    """

    row: int
    verdict: Verdict
    reason: str = ""
    message: str = ""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    timing: Mapping[str, Any] = field(default_factory=dict)
    plan: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Everything except the plan, as plain data."""
        return {
            "row": self.row, "verdict": self.verdict, "reason": self.reason, "message": self.message,
            "metrics": dict(self.metrics), "timing": dict(self.timing),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Outcome:
        """The outcome that `to_dict` made this from; KeyError, TypeError or ValueError if it is not such a record."""
        found = cls(
            int(content["row"]), content["verdict"], str(content["reason"]), str(content["message"]),
            dict(content["metrics"]), dict(content["timing"]),
        )  # fmt: skip
        if found.verdict not in VERDICTS:
            raise ValueError(f"{found.verdict!r} is no verdict")
        return found

    def without_plan(self) -> Outcome:
        """The same without the plan, which is large."""
        return self if self.plan is None else replace(self, plan=None)


def crashed(row: int) -> Outcome:
    """The outcome of a row whose process died twice."""
    message = "the planning process died twice without an error message: out of memory, or a fault in a library"
    return Outcome(row, "crashed", "crashed", message)
