"""The searches for a detour that failed, and when to search again."""

from __future__ import annotations

import numpy as np

# The numbers are chosen; validation/placements.py drives machines with them.
_FURTHER = 0.1  # s of the plan beyond the place where the machine was stuck, after which it is free again
_MOST = 4  # failed searches in a row after which the machine counts as blocked
_LONGEST_BREAK = 16.0  # s, longest break between two failed searches; it doubles from 1 s on
_CHANGE_COUNTS = 1.0  # s after a failure, from which a change of the surroundings leads to another search


class Attempts:
    """The failed searches for a detour at one place of a plan.

    Attributes
    ----------
    failed: how many in a row found nothing, or found a detour that led nowhere.
    blocked: why there is no detour, in words, once several searches failed; otherwise empty.
    revision: of the surroundings for which the last one failed.
    """

    def __init__(self) -> None:
        self.failed, self.blocked, self.revision = 0, "", -1
        self._retrying = False  # the plan is tried once more, although no detour was found
        self._stuck_at = -np.inf  # s of the plan
        self._failed_at = self._again_at = 0.0  # s: of the last failure, and when to search again
        self._may_succeed = True  # another search, with more effort

    def note(self, reason: str, revision: int, now: float, *, final: bool = False) -> None:
        """Count a search that failed `now` [s]. After several, or if no effort helps (`final`), there is a break."""
        self.failed = max(self.failed + 1, _MOST if final else 0)
        self._failed_at, self.revision, self._may_succeed, self._retrying = now, revision, not final, False
        if self.failed >= _MOST:
            self.blocked = reason
            self._again_at = now + min(2.0 ** (self.failed - _MOST), _LONGEST_BREAK)

    def note_ahead(self, place: float) -> None:
        """Note that a search for a detour from before `place` [s of the plan] failed: others may take more effort."""
        self.failed, self._stuck_at = max(self.failed, 1), place

    def begin(self, place: float) -> None:
        """Note that the machine leaves the plan, or waits for a detour, at `place` [s of the plan]."""
        self._stuck_at, self._retrying = place, False

    def retry(self) -> None:
        """Note that the plan is tried once more, although no detour was found."""
        self._retrying = True

    def go_on(self) -> None:
        """Note that the machine goes on along its plan or a detour."""
        self.blocked, self._retrying = "", False

    def get_past(self, clock: float) -> None:
        """Begin anew if the plan's `clock` [s] is beyond the place where the machine was stuck."""
        if clock > self._stuck_at + _FURTHER:
            self.failed, self._again_at = 0, 0.0

    def blocks(self, revision: int) -> bool:
        """Whether nothing is to be tried now: no detour was found for this `revision` of the surroundings."""
        return bool(self.blocked) and revision == self.revision and not self._retrying

    def may_search(self, revision: int, now: float) -> bool:
        """Whether to search again `now` [s]: after the break, or for other surroundings."""
        return now >= self._again_at or (revision != self.revision and now > self._failed_at + _CHANGE_COUNTS)

    def may_retry(self, now: float) -> bool:
        """Whether to try the plan once more `now` [s], and to search again if that leads nowhere."""
        return self._may_succeed and now >= self._again_at
